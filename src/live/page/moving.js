// Moves a base ball or an obstacle of the job, in the view or by typing. Each change is tried: the service plans the changed job, and
// its checks are shown. What is kept is written into the job.

import { $, attempt, make, quietly, say } from "/frame.js";
import { changedKeys } from "/job_changes.js";
import { ask } from "/link.js";
import { readNumber, right } from "/number_field.js";
import { fixed, significant } from "/numbers.js";
import { t } from "/texts.js";
import { may } from "/users.js";

/** What of a plan is shown while something is moved. */
const SHOWN = ["axis_margin_deg", "wrist_deg", "clearance_mm", "stroke_risk", "run_risk"];
/** Smaller risks are not told apart. */
const MIN_RISK = 1e-6;
/** A trial begins when nothing has moved for this time, ms. */
const WAIT_MS = 350;
/** A cylinder whose end is so near below a ball is its post, mm. */
const POST_MM = 5;
const AXES = ["x", "y", "z"];
const PLACE = { unit: "mm" };

/** @typedef {{ name: string, at: number[], moveBy: (by: number[]) => void }} Movable */

/** @type {{ robot: string, place: (movable: number, by: number[]) => void, planned: (scene: any) => void, restore: () => void }} */
let context;
/** @type {{ job: any, sha256: string }} the file that was read */
let read;
/** @type {any} the job with what was moved */
let job = null;
/** @type {Movable[]} */
let movables = [];
let waiting = 0;
let trying = false;
let again = false;

/** The balls and obstacles of a job, in the order in which the view draws them. */
function list() {
  const balls = job.centre.map((ball, i) => ({
    name: `${t("scene.ball")} ${ball.id ?? i + 1}`,
    at: ball.xyz_mm,
    moveBy: (by) => (ball.xyz_mm = moved(ball.xyz_mm, by)),
  }));
  const points = { box: ["low_mm", "high_mm"], cylinder: ["from_mm", "to_mm"] };
  const obstacles = (job.obstacle ?? []).map((one, i) => ({
    name: `${t("move.obstacle")} ${i + 1}: ${one.name ?? one.shape}`,
    at: one.shape === "floor" ? [0, 0, one.z_mm] : one[points[one.shape]?.[0] ?? "from_mm"],
    moveBy(by) {
      if (one.shape === "floor") [one.z_mm] = moved([one.z_mm], [by[2]]);
      for (const key of points[one.shape] ?? []) one[key] = moved(one[key], by);
    },
  }));
  return [...balls, ...obstacles];
}

/** What is not moved stays as it is in the file; a sum is written without its noise. @param {number[]} place @param {number[]} by */
const moved = (place, by) => place.map((value, axis) => (by[axis] ? Math.round(1e6 * (value + by[axis])) / 1e6 : value));

/** @param {typeof context} now */
export async function open(now) {
  context = now;
  read = await ask("GET", `/workbench/${now.robot}/job`);
  job = structuredClone(read.job);
  $("move").hidden = !job?.centre || !may("plan");
  if (!job?.centre) return;
  const chosen = $("move-what").value;
  refresh();
  if (chosen) $("move-what").value = chosen;
  show();
}

/** The keys of the job that were changed. */
function keys() {
  const rows = (list) => (list ?? []).map((one, row) => ({ row, ...one }));
  return changedKeys(read.job, { centre: rows(job.centre), obstacle: rows(job.obstacle) });
}

/** A coordinate with all its decimals, and at least one. */
const written = (mm) => fixed(mm, Math.max(1, (String(mm).split(".")[1] ?? "").length));

function refresh() {
  movables = list();
  const chosen = $("move-what").value;
  $("move-what").replaceChildren(...movables.map((one, at) => new Option(one.name, String(at))));
  if (chosen) $("move-what").value = chosen;
}

function show() {
  const one = movables[Number($("move-what").value)];
  if (!one) return;
  AXES.forEach((axis, i) => {
    right($(`move-${axis}`));
    $(`move-${axis}`).value = written(one.at[i]);
  });
  const changed = Object.keys(keys()).length > 0;
  $("move-save").disabled = !changed;
  $("move-reset").disabled = !changed;
}

/** The place in the fields; while one of them is wrong nothing is moved or saved. */
const typed = () => AXES.map((axis) => readNumber($(`move-${axis}`), PLACE));

/** The post under a ball stays under it. @param {number} at */
function together(at) {
  const ball = job.centre[at]?.xyz_mm;
  const under = (one) => ball && one.shape === "cylinder" && Math.hypot(one.to_mm[0] - ball[0], one.to_mm[1] - ball[1]) < POST_MM;
  const posts = (job.obstacle ?? []).flatMap((one, i) => (under(one) ? [job.centre.length + i] : []));
  return [at, ...posts];
}

/** Moves one by a vector, mm. @param {number} at @param {number[]} by */
export function moveBy(at, by) {
  for (const one of together(at)) {
    movables[one].moveBy(by);
    context.place(one, by);
  }
  refresh();
  $("move-what").value = String(at);
  show();
  clearTimeout(waiting);
  waiting = setTimeout(() => attempt(tryIt), WAIT_MS);
}

/** Plans the changed job; one trial after the other. */
async function tryIt() {
  if (trying) return (again = true);
  trying = true;
  $("move-found").replaceChildren(make("li", t("move.trying")));
  try {
    const found = await ask("POST", `/workbench/${context.robot}/trial`, keys());
    results(found);
    if (found.scene) context.planned(found.scene);
  } catch (error) {
    $("move-found").replaceChildren();
    throw error;
  } finally {
    trying = false;
    if (again) {
      again = false;
      attempt(tryIt);
    }
  }
}

/** Risks and angles of the changed plan, each with its limit; or why it is refused. @param {any} found */
function results(found) {
  const lines = [];
  const line = (good, text) => {
    const item = make("li", null, { class: good ? "good" : "bad" });
    item.append(make("span", good ? "✓" : "✕", { "aria-hidden": "true" }), " ", make("span", text));
    lines.push(item);
  };
  // A risk is never printed as nothing.
  const risk = (number) => (number < MIN_RISK ? `< ${fixed(MIN_RISK, 6)}` : significant(number, 2));
  const value = (quantity, number) => (quantity.endsWith("risk") ? risk(number) : fixed(number, 1));
  if (found.checks) {
    for (const { quantity, worst, limit, row } of found.checks.filter((check) => SHOWN.includes(check.quantity))) {
      const good = quantity.endsWith("risk") ? worst <= limit : worst >= limit;
      line(good, t("move.check", { what: t(`quantity.${quantity}`), value: value(quantity, worst), limit: value(quantity, limit), row }));
    }
    const p95 = found.predictions?.identified_mm?.p95;
    if (p95) line(true, t("move.predicted", { mm: significant(p95, 2) }));
  } else {
    for (const one of found.findings.filter((one) => one.severity === "error").slice(0, 4)) line(false, `${one.code} ${one.text}`);
  }
  $("move-found").replaceChildren(...lines);
}

$("move-what").addEventListener("change", show);
for (const axis of AXES) {
  $(`move-${axis}`).addEventListener("change", () =>
    attempt(async () => {
      const wanted = typed();
      const at = Number($("move-what").value);
      if (movables[at]) moveBy(at, wanted.map((mm, axis) => mm - movables[at].at[axis]));
    }),
  );
}
$("move-save").addEventListener("click", () =>
  attempt(async () => {
    typed();
    await ask("PUT", `/workbench/${context.robot}/job`, { sha256: read.sha256, keys: keys() });
    await open(context);
    window.dispatchEvent(new Event("focus"));
    say(t("form.saved"));
  }),
);
// The form has saved another job: it is read again unless something is moved.
window.addEventListener("dbbd:job-saved", () => $("move-save").disabled && quietly(() => open(context)));
$("move-reset").addEventListener("click", () =>
  attempt(async () => {
    $("move-found").replaceChildren();
    await open(context);
    context.restore();
  }),
);
