// Runs, their results, and the jobs that compute them.

import { ask } from "/link.js";
import { count, fixed } from "/numbers.js";

const $ = (id) => document.getElementById(id);
const STATES = { running: "running", ended: "ended", ended_early: "ended early" };
const JOBS = { waiting: "waiting", running: "running", done: "done", doubt: "done, with a doubt", failed: "failed", cancelled: "cancelled" };
const KINDS = { identify: "Identify", circle: "Circular test", sync: "Match" };

let jobs = new Map();
let say = () => {};

/** Where messages go. */
export function start(report) {
  say = report;
}

function make(name, text, attributes = {}) {
  const node = document.createElement(name);
  if (text !== null) node.textContent = text;
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return node;
}

/** Reads the list of runs anew. */
export async function refresh() {
  const { runs } = await ask("GET", "/runs");
  $("runs").replaceChildren(...runs.slice(0, 50).map(row));
}

function row(run) {
  const line = make("tr", null);
  line.append(make("th", run.name, { scope: "row" }));
  const when = run.started_unix_ms ? new Date(run.started_unix_ms).toLocaleString() : "";
  line.append(make("td", when));
  line.append(make("td", `${STATES[run.state]}${run.ended ? ": " + run.ended.reason : ""}`));
  const size = `${fixed(run.bytes / 1e6, 1)} MB`;
  line.append(make("td", run.ended ? `${count(run.ended.samples)} samples, ${size}` : size));
  const act = make("td", null);
  for (const [kind, text] of Object.entries(KINDS)) {
    const button = make("button", text, { type: "button", "aria-label": `${text}: run ${run.name}`, "data-kind": kind });
    button.disabled = run.state === "running";
    button.addEventListener("click", () => submit(kind, run.name));
    act.append(button);
  }
  const results = make("td", null);
  const base = `/api/v1/runs/${run.name}`;
  for (const result of run.results.filter((one) => /\.(html|json|csv|toml)$/.test(one.file))) {
    const link = make("a", result.file, { href: `${base}/${result.kind}/${result.file}`, target: "_blank", rel: "noopener" });
    results.append(link, " ");
  }
  results.append(make("a", "capture", { href: `${base}/capture`, download: "" }));
  line.append(act, results);
  return line;
}

async function submit(kind, run) {
  try {
    show(await ask("POST", "/jobs", kind === "identify" ? { kind, run, prior: "datasheet" } : { kind, run }));
    say(`${KINDS[kind]} of ${run} was started.`);
  } catch (error) {
    say(error.message);
  }
}

/** A job began, printed something or ended. */
export function show(job) {
  const before = jobs.get(job.id)?.state;
  jobs.set(job.id, job);
  drawJobs();
  const over = !["waiting", "running"].includes(job.state);
  if (over && before !== job.state) {
    refresh().catch((error) => say(error.message));
    if (before) say(`${KINDS[job.kind]} of ${job.run}: ${JOBS[job.state]}.`);
  }
}

/** All jobs, after a connection. */
export async function refreshJobs() {
  const list = (await ask("GET", "/jobs")).jobs;
  jobs = new Map(list.reverse().map((job) => [job.id, job]));
  drawJobs();
}

function drawJobs() {
  const newest = [...jobs.values()].reverse().slice(0, 8);
  if (!newest.length) return;
  const items = newest.map((job, at) => {
    const item = make("li", `${KINDS[job.kind]} of ${job.run}: ${JOBS[job.state]} (${fixed(job.elapsed_s, 0)} s) `);
    if (["waiting", "running"].includes(job.state)) {
      const button = make("button", "Cancel", { type: "button", "aria-label": `Cancel job ${job.id}` });
      button.addEventListener("click", () => ask("POST", `/jobs/${job.id}/cancel`).then(show, (error) => say(error.message)));
      item.append(button);
    }
    const shown = at === 0 ? job.log.slice(-12) : job.log.slice(-2);
    if (shown.length) item.append(make("pre", shown.join("\n"), at === 0 ? { tabindex: "0", "aria-label": "Output of the job" } : {}));
    return item;
  });
  $("jobs").replaceChildren(...items);
}
