// The page of a robot: nine steps, each with its state, what it found, one next action and its command.
// At /live there is no robot: only the step Measure is shown.

import { $, afterSignIn, attempt, make, quietly, say } from "/frame.js";
import * as correct from "/correct.js";
import { finding } from "/findings.js";
import { jobForm } from "/job_form.js";
import { ask } from "/link.js";
import * as measure from "/measure.js";
import { readNumber } from "/number_field.js";
import * as residuals from "/residuals.js";
import { after, verdictLine } from "/sentence.js";
import { spoken, t } from "/texts.js";
import { may } from "/users.js";

const STEPS = ["robot", "cell", "plan", "programs", "measure", "result", "correct", "check", "certificate"];
const MARKS = { todo: "○", ready: "▶", running: "◔", done: "✓", attention: "!" };
/** How often the files are looked at while the page is seen, ms: the command line may change them. */
const LOOK_MS = 15_000;
/** The tolerance of a check. */
const TOLERANCE = { unit: "mm", optional: true, range: { low: 0, high: 20, aboveLow: true } };

/** The robot of the page; null at /live. */
const robot = location.pathname.startsWith("/robot/") ? location.pathname.slice("/robot/".length) : null;
/** @type {any} the work as the service gave it last */
let work = null;
let drawn = "";
/** The demo that goes on by itself until its program halts. */
let pilot = null;
try {
  pilot = JSON.parse(sessionStorage.getItem("demo"));
} catch {
  // Not of this page.
}
if (pilot?.name !== robot) pilot = null;
/** Steps that the demo has begun: none is begun twice. */
const begun = new Set();
/** The bar of the demo was reported as mounted before its program halts. */
let mountedEarly = false;

/** @type {(step: string, selector: string) => any} */
const part = (step, selector) => document.querySelector(`[data-step="${step}"] ${selector}`);

function drawNav() {
  $("step-links").replaceChildren(
    ...STEPS.map((step) => {
      const item = make("li", null);
      const link = make("a", null, { href: `#step-${step}`, "data-to": step });
      link.append(make("span", MARKS.todo, { class: "mark", "aria-hidden": "true" }), " ", make("span", t(`step.${step}`)), " ", make("span", "", { class: "hidden-text" }));
      item.append(link);
      return item;
    }),
  );
}

/** The texts of the codes come later. */
function fill(list, all) {
  Promise.all(all.map(finding)).then((items) => list.append(...items));
}

function findings(report) {
  const serious = report.findings.filter((one) => one.severity !== "info");
  const info = report.findings.filter((one) => one.severity === "info");
  const nodes = [];
  // Only what is no warning is folded.
  if (serious.length) {
    const list = make("ul", null, { class: "findings" });
    fill(list, serious);
    nodes.push(list);
  }
  if (info.length) {
    const fold = make("details", null, { class: "fold" });
    const list = make("ul", null, { class: "findings" });
    fill(list, info);
    fold.append(make("summary", t("findings", { count: info.length })), list);
    nodes.push(fold);
  }
  return nodes;
}

function files(report) {
  if (!report.files.length) return [];
  const base = `/api/v1/workbench/${robot}/files/${report.directory}`;
  const link = (file, attributes = {}) => make("a", file, { href: spoken(`${base}/${file}`), target: "_blank", rel: "noopener", ...attributes });
  const pages = report.files.filter((file) => file.endsWith(".html"));
  const shown = make("p", null, { class: "row" });
  shown.append(...pages.map((file) => link(file, { class: "button" })));
  const fold = make("details", null, { class: "fold" });
  const list = make("ul", null, { class: "files" });
  list.append(
    ...report.files.map((file) => {
      const item = make("li", null);
      item.append(link(file));
      return item;
    }),
  );
  fold.append(make("summary", t("files", { count: report.files.length, directory: report.directory })), list);
  return pages.length ? [shown, fold] : [fold];
}

/** What the button of Measure does depends on the bar. */
function measureLabel(report) {
  const now = measure.now();
  if (report.state === "running" || now?.run) return t("act.watch");
  if (isRead(report)) return work?.simulated ? t("act.halt") : t("act.start");
  if (work?.simulated) return t("act.simulate");
  if (!now?.device.port) return t("act.choose_port");
  return t(report.label);
}

/** Which run a step is computed from; what was chosen before stays. */
function runChoice({ step, runs }) {
  const chosen = part(step, "[data-run]")?.value;
  const label = make("label", t("run.choose"));
  const select = make("select", null, { "data-run": "" });
  const text = ({ name, complete, samples }) => `${name}: ${t(complete ? "run.complete" : "run.incomplete", { samples: samples ?? "?" })}`;
  select.append(...runs.map((run) => new Option(text(run), run.name)));
  if (runs.some(({ name }) => name === chosen)) select.value = chosen;
  label.append(" ", select);
  return label;
}

/** Whether the bar is read against the plan of a step. */
const isRead = (report) => measure.now()?.reading?.plan === report.plan;

function drawStep(report) {
  const { step } = report;
  /** @type {any} */
  const section = document.querySelector(`[data-step="${step}"]`);
  section.dataset.state = report.state;
  part(step, ".mark").textContent = MARKS[report.state];
  part(step, ".badge").textContent = t(`state_of.${report.state}`);
  const says = [verdictLine(report), ...after(report)];
  if (report.state === "running" && report.job) {
    says.push(make("progress", null, { max: "100", value: String(report.job.percent), "aria-label": t(`step.${step}`) }));
    const cancel = make("button", t("jobs.cancel"), { type: "button" });
    cancel.addEventListener("click", () => attempt(() => ask("POST", `/jobs/${report.job.id}/cancel`)));
    says.push(cancel);
  }
  if (isLocked(step)) {
    const { name, by } = measure.now().run;
    says.push(make("p", t("lock.note", { run: name, by: by ?? t("user.owner") }), { class: "small" }));
  }
  part(step, ".says").replaceChildren(...says);
  const row = [];
  if (report.action) {
    const label = report.action === "measure" ? measureLabel(report) : t(report.label);
    const button = make("button", label, { type: "button", "data-action": "next", class: isNext(report) ? "main" : undefined });
    button.addEventListener("click", () => attempt(() => act(report)));
    // Whoever may only look sees what would be done.
    button.disabled = !may(report.action === "measure" ? "measure" : "plan") || isLocked(step);
    row.push(button);
  }
  if (report.action === "compute" && report.runs.length > 1) row.push(runChoice(report));
  if (report.command) row.push(make("code", report.command, { class: "command", "aria-label": t("command") }));
  part(step, ".act").replaceChildren(...row);
  part(step, ".more").replaceChildren(...findings(report), ...files(report));
  /** @type {any} */
  const link = document.querySelector(`[data-to="${step}"]`);
  link.dataset.state = report.state;
  link.querySelector(".mark").textContent = MARKS[report.state];
  link.querySelector(".hidden-text").textContent = t(`state_of.${report.state}`);
}

/** What a run was planned from is locked while it is on; the service refuses it, too. */
const isLocked = (step) => ["robot", "cell", "plan", "programs"].includes(step) && !!measure.now()?.run?.plan && work.steps.some((one) => one.text === "measure.running");

/** The first step that is open has the button that stands out. */
const isNext = (report) => work.steps.find((one) => !["done", "todo"].includes(one.state))?.step === report.step;

/** Puts the new state into the page; what has the focus keeps it. */
function draw() {
  const state = JSON.stringify([work, ofBar(measure.now())]);
  if (state === drawn) return;
  drawn = state;
  /** @type {any} */
  const active = document.activeElement;
  const focused = active?.dataset.action === "next" ? active.closest("[data-step]")?.dataset.step : null;
  const folds = (open) => [.../** @type {NodeListOf<any>} */ (document.querySelectorAll(`.more details${open}`))];
  const nameOf = (one) => `${one.closest("[data-step]").dataset.step}/${one.querySelector("summary").textContent}`;
  const opened = new Set(folds("[open]").map(nameOf));
  work.steps.forEach(drawStep);
  for (const one of folds("")) one.open = opened.has(nameOf(one));
  if (focused) part(focused, "[data-action=next]")?.focus();
  $("simulated-readings").hidden = !work.simulated_readings;
  $("robot-name").textContent = work.robot ? `${work.name} · ${work.robot}` : work.name;
  document.title = `${work.name} · dbbd`;
  $("scene").hidden = !work.steps.some((one) => one.plan);
  const of = (step) => work.steps.find((one) => one.step === step);
  quietly(() => correct.show(of("correct")));
  offerTolerance(of("check").values);
  const made = of("result");
  $("residuals").hidden = !made.directory;
  if (made.state === "done" && made.changed_unix_ms !== shownResult) {
    shownResult = made.changed_unix_ms;
    quietly(residuals.open);
    quietly(async () => {
      const cell = await ask("GET", `/workbench/${robot}/scene`);
      measure.expect(cell.plan, cell.expected);
    });
  }
}

/** Where this tab keeps the tolerance that was typed: a reload must not make none of it. */
const TYPED_TOLERANCE = `tolerance:${robot}`;
$("tolerance").addEventListener("input", () => sessionStorage.setItem(TYPED_TOLERANCE, $("tolerance").value));

/** Shows the tolerance that was typed, else that of the last decision: to decide again is not to drop it. @param {any} values */
function offerTolerance(values) {
  if (document.activeElement !== $("tolerance")) $("tolerance").value = sessionStorage.getItem(TYPED_TOLERANCE) ?? values?.tolerance_mm ?? "";
}

/** When the result was written whose residuals are shown. */
let shownResult = null;

/** What the buttons depend on besides the files. */
const ofBar = (now) => [now?.device.port, now?.reading?.plan, now?.run?.name].join("|");

let asked = 0;

/** Looks at the files again. */
async function refresh() {
  if (!robot) return;
  const number = ++asked;
  const answer = await ask("GET", `/workbench/${robot}`);
  // An older answer may come later.
  if (number !== asked) return;
  const before = work;
  work = answer;
  draw();
  const plans = (one) => JSON.stringify(one?.steps.map((step) => step.plan));
  if (before && plans(before) !== plans(work)) await measure.refreshLists();
  await goOn();
}

/** Does the next action of a step. */
async function act(report) {
  if (report.action === "edit") return edit();
  if (report.action === "upload") return $("program").click();
  if (report.action === "measure") return record(report);
  if (report.step === "correct") return correct.begin();
  await compute(report.step);
}

async function compute(step, options = {}) {
  // An empty one is left out.
  if (step === "check") options.tolerance_mm = readNumber($("tolerance"), TOLERANCE) ?? undefined;
  options.run = part(step, "[data-run]")?.value;
  await ask("POST", `/workbench/${robot}/steps/${step}`, options);
  await refresh();
}

async function edit() {
  const form = $("job-form");
  if (!form.hidden) return (form.hidden = true);
  const { job, sha256 } = await ask("GET", `/workbench/${robot}/job`);
  await jobForm(form, {
    robot,
    job,
    sha256,
    send: (keys) => ask("PUT", `/workbench/${robot}/job`, { sha256, keys }),
    saved: async () => {
      form.hidden = true;
      window.dispatchEvent(new Event("dbbd:job-saved"));
      say(t("form.saved"));
      await refresh();
      part("plan", "h2").scrollIntoView();
    },
  });
  // Not before: what is typed into the old fields would be lost.
  form.hidden = false;
  form.querySelector("select, input").focus();
}

/** From the port to the run, one action after the other. */
async function record(report) {
  measure.open(report.plan);
  const now = measure.now();
  if (now?.run) return $("length").focus();
  if (pilot && !isRead(report)) return (mountedEarly = true);
  if (work.simulated) {
    // Its run never reads the bar of the service: not after a reload, not on the page of another person, not without a port.
    measure.simulate(pilot?.speed);
    return isRead(report) ? measure.confirmHalt() : measure.connect();
  }
  if (!now?.device.port) return $("port").focus();
  if (!isRead(report)) return measure.connect();
  const open = measure.openCheck();
  if (open) return open.focus();
  measure.startRun();
}

/** The demo: everything up to the HALT of its program, and the result after its run. */
async function goOn() {
  $("pilot").hidden = !pilot;
  if (!pilot) return;
  const of = (step) => work.steps.find((one) => one.step === step);
  const next = ["plan", "programs", "measure", "result"].map(of).find((one) => one.state !== "done");
  if (!next) {
    pilot = null;
    sessionStorage.removeItem("demo");
    $("pilot").textContent = t("demo.over");
    $("pilot").hidden = false;
    $("live").open = false;
    $("step-result").scrollIntoView();
    return;
  }
  const now = measure.now();
  const measuring = now?.run ? "demo.running" : now?.reading ? "demo.halt" : "demo.measure";
  $("pilot").textContent = t(next.step === "measure" ? measuring : `demo.${next.step}`);
  if (next.step === "measure" && mountedEarly && isRead(next) && !now.run) {
    mountedEarly = false;
    return measure.confirmHalt();
  }
  if (next.state !== "ready" || begun.has(next.step)) return;
  if (next.step === "measure" && !now) return;
  begun.add(next.step);
  // After a reload the bar may be read already: to connect again would begin the program again.
  if (next.step === "measure" && isRead(next)) return;
  try {
    if (next.step !== "measure") return await compute(next.step);
    // The program begins and halts for the bar: the operator goes on.
    await measure.refreshLists();
    measure.open(next.plan);
    measure.simulate(pilot.speed);
    await measure.connect();
  } catch (error) {
    // The operator goes on by hand.
    pilot = null;
    $("pilot").hidden = true;
    throw error;
  }
}

window.addEventListener("dbbd:user", () => {
  drawn = "";
  if (work) draw();
});
const look = () => quietly(refresh);
let barBefore = "";
window.addEventListener("dbbd:job", (/** @type {any} */ { detail: job }) => {
  if (job.robot !== robot || !work) return;
  if (["waiting", "running"].includes(job.state)) {
    // Only the bar moves: the files are looked at when the job is over.
    const bar = part(job.step, "progress");
    if (bar) bar.value = job.percent;
  } else {
    look();
  }
});
window.addEventListener("dbbd:status", (/** @type {any} */ { detail: now }) => {
  const bar = ofBar(now);
  if (bar === barBefore) return;
  barBefore = bar;
  look();
});
for (const kind of ["focus", "pageshow", "dbbd:up"]) window.addEventListener(kind, look);
setInterval(() => document.hidden || look(), LOOK_MS);
afterSignIn(look);

if (robot) {
  $("robot-name").textContent = robot;
  drawNav();
  correct.start({ robot, changed: refresh });
  residuals.start({ robot, compute: (exclude) => compute("result", { exclude }) });
  let scene = null;
  $("scene").addEventListener("toggle", () =>
    attempt(async () => {
      if (!$("scene").open) return scene?.pause();
      scene ??= await import("/scene.js");
      await scene.open(robot);
    }),
  );
  look();
} else {
  document.body.classList.add("bare");
  $("live").open = true;
  $("robot-name").textContent = t("home.live");
  for (const step of STEPS) /** @type {any} */ (document.querySelector(`[data-step="${step}"]`)).hidden = step !== "measure";
}
