// Moves a base ball or an obstacle of the job, in the view or by typing. Each change is tried: the service plans the changed job, and
// its checks are shown. What is kept is written into the job.

import { $, attempt, make, say } from "/frame.js";
import { ask } from "/link.js";
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

/** @typedef {{ name: string, at: number[], moveBy: (by: number[]) => void }} Movable */

/** @type {{ robot: string, place: (movable: number, by: number[]) => void, planned: (scene: any) => void, restore: () => void }} */
let context;
/** @type {any} the keys of the job that can be moved */
let job = null;
let saved = "";
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
    moveBy: (by) => (ball.xyz_mm = ball.xyz_mm.map((value, axis) => value + by[axis])),
  }));
  const points = { box: ["low_mm", "high_mm"], cylinder: ["from_mm", "to_mm"] };
  const obstacles = (job.obstacle ?? []).map((one, i) => ({
    name: `${t("move.obstacle")} ${i + 1}: ${one.name ?? one.shape}`,
    at: one.shape === "floor" ? [0, 0, one.z_mm] : one[points[one.shape]?.[0] ?? "from_mm"],
    moveBy(by) {
      if (one.shape === "floor") one.z_mm += by[2];
      for (const key of points[one.shape] ?? []) one[key] = one[key].map((value, axis) => value + by[axis]);
    },
  }));
  return [...balls, ...obstacles];
}

/** @param {typeof context} now */
export async function open(now) {
  context = now;
  job = (await ask("GET", `/workbench/${now.robot}/job`)).job;
  $("move").hidden = !job?.centre || !may("plan");
  if (!job?.centre) return;
  saved = keys();
  const chosen = $("move-what").value;
  refresh();
  if (chosen) $("move-what").value = chosen;
  show();
}

const keys = () => JSON.stringify({ centre: job.centre.map((ball) => ({ xyz_mm: ball.xyz_mm.map(rounded) })), obstacle: job.obstacle });
const rounded = (value) => Math.round(10 * value) / 10;

function refresh() {
  movables = list();
  const chosen = $("move-what").value;
  $("move-what").replaceChildren(...movables.map((one, at) => new Option(one.name, String(at))));
  if (chosen) $("move-what").value = chosen;
}

function show() {
  const one = movables[Number($("move-what").value)];
  if (!one) return;
  AXES.forEach((axis, i) => ($(`move-${axis}`).value = fixed(one.at[i], 1)));
  const changed = keys() !== saved;
  $("move-save").disabled = !changed;
  $("move-reset").disabled = !changed;
}

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
    const found = await ask("POST", `/workbench/${context.robot}/trial`, JSON.parse(keys()));
    results(found);
    if (found.scene) context.planned(found.scene);
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
for (const [i, axis] of AXES.entries()) {
  $(`move-${axis}`).addEventListener("change", () => {
    const at = Number($("move-what").value);
    const wanted = Number($(`move-${axis}`).value.replace(",", ".").replace("−", "-"));
    if (!Number.isFinite(wanted) || !movables[at]) return show();
    moveBy(at, AXES.map((_, own) => (own === i ? wanted - movables[at].at[i] : 0)));
  });
}
$("move-save").addEventListener("click", () =>
  attempt(async () => {
    await ask("PUT", `/workbench/${context.robot}/job`, JSON.parse(keys()));
    saved = keys();
    show();
    say(t("form.saved"));
    window.dispatchEvent(new Event("focus"));
  }),
);
$("move-reset").addEventListener("click", () =>
  attempt(async () => {
    $("move-found").replaceChildren();
    await open(context);
    context.restore();
  }),
);
