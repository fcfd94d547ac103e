// Runs, their results, and the jobs that compute them.

import { ask } from "/link.js";
import { count, dateAndTime, fixed } from "/numbers.js";
import { known, spoken, t } from "/texts.js";

/** @type {(id: string) => any} */
const $ = (id) => document.getElementById(id);
const KINDS = ["identify", "circle", "sync"];

let jobs = new Map();
/** @type {(text: string) => void} */
let say = () => {};

/** Sets the function that shows messages. */
export function start(report) {
  say = report;
}

function make(name, text, attributes = {}) {
  const node = document.createElement(name);
  if (text !== null) node.textContent = text;
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return node;
}

/** Reloads the list of runs. */
export async function refresh() {
  const { runs } = await ask("GET", "/runs");
  const rows = runs.slice(0, 50).map(row);
  if (!rows.length) {
    const none = make("tr", null);
    none.append(make("td", t("results.none"), { colspan: "6" }));
    rows.push(none);
  }
  $("runs").replaceChildren(...rows);
}

function row(run) {
  const line = make("tr", null);
  line.append(make("th", run.name, { scope: "row" }));
  const when = run.started_unix_ms ? dateAndTime(run.started_unix_ms) : "";
  const cell = (key, text) => make("td", text, { "data-head": t(key) });
  line.append(cell("results.started", when));
  const reason = run.ended?.reason;
  const ended = reason ? ": " + (known(`ending.${reason}`) ? t(`ending.${reason}`) : reason) : "";
  line.append(cell("results.state", t(`runs.${run.state}`) + ended));
  const size = fixed(run.bytes / 1e6, 1);
  line.append(cell("results.recorded", run.ended ? t("results.samples", { samples: count(run.ended.samples), size }) : t("results.size", { size })));
  const act = cell("results.evaluate", null);
  // A run of a check is no calibration.
  if (run.is_check) act.append(make("span", t("runs.check")), " ");
  for (const kind of KINDS.filter((kind) => !run.is_check || kind === "sync")) {
    const label = t("kind.of", { kind: t(`kind.${kind}`), run: run.name });
    const button = make("button", t(`kind.${kind}`), { type: "button", "aria-label": label, "data-kind": kind });
    button.disabled = run.state === "running";
    button.addEventListener("click", () => submit(kind, run.name));
    act.append(button);
  }
  const results = cell("results.results", null);
  const base = `/api/v1/runs/${run.name}`;
  for (const result of run.results.filter((one) => /\.(html|json|csv|toml)$/.test(one.file))) {
    const link = make("a", result.file, { href: spoken(`${base}/${result.kind}/${result.file}`), target: "_blank", rel: "noopener" });
    results.append(link, " ");
  }
  results.append(make("a", t("results.capture"), { href: `${base}/capture`, download: "" }));
  line.append(act, results);
  return line;
}

async function submit(kind, run) {
  try {
    show(await ask("POST", "/jobs", kind === "identify" ? { kind, run, prior: "datasheet" } : { kind, run }));
    say(t("jobs.started", { kind: t(`kind.${kind}`), run }));
  } catch (error) {
    say(error.message);
  }
}

/** Updates a job. */
export function show(job) {
  const before = jobs.get(job.id)?.state;
  // Those of a step are shown there.
  if (job.step) return;
  jobs.set(job.id, job);
  drawJobs();
  const over = !["waiting", "running"].includes(job.state);
  if (over && before !== job.state) {
    refresh().catch((error) => say(error.message));
    if (before) say(line(job));
  }
}

/** Sets all jobs after a connection. */
export async function refreshJobs() {
  const list = (await ask("GET", "/jobs")).jobs;
  jobs = new Map(list.reverse().filter((job) => !job.step).map((job) => [job.id, job]));
  drawJobs();
}

function line(job) {
  const state = t(`job.${job.state}`, { percent: job.percent });
  return t("jobs.line", { kind: t(`kind.${job.kind}`), run: job.run, state });
}

function drawJobs() {
  const newest = [...jobs.values()].reverse().slice(0, 8);
  if (!newest.length) return;
  const items = newest.map((job, at) => {
    const item = make("li", `${line(job)} (${fixed(job.elapsed_s, 0)} s) `);
    if (job.state === "running") {
      const label = t("jobs.progress", { kind: t(`kind.${job.kind}`), run: job.run });
      item.append(make("progress", null, { max: "100", value: String(job.percent), "aria-label": label }));
    }
    if (["waiting", "running"].includes(job.state)) {
      const button = make("button", t("jobs.cancel"), { type: "button", "aria-label": t("jobs.cancel_label", { id: job.id }) });
      button.addEventListener("click", () => ask("POST", `/jobs/${job.id}/cancel`).then(show, (error) => say(error.message)));
      item.append(button);
    }
    const shown = at === 0 ? job.log.slice(-12) : job.log.slice(-2);
    if (shown.length) item.append(make("pre", shown.join("\n"), at === 0 ? { tabindex: "0", role: "region", "aria-label": t("jobs.output") } : {}));
    return item;
  });
  $("jobs").replaceChildren(...items);
}
