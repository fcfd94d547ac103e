// The residuals of a result: plot and table, linked with each other and with the view in three dimensions. A length can be left
// out, with a reason, and the result computed again.

import { $, attempt, make } from "/frame.js";
import { ask } from "/link.js";
import { signed } from "/numbers.js";
import { colour, plotIn } from "/plots.js";
import { t } from "/texts.js";

/** @type {{ robot: string, compute: (exclude: { rows: number[], reason: string | null }[]) => Promise<void> }} */
let context;
/** @type {any} */
let cell = null;
/** @type {any} */
let plot = null;
/** The rows that the result left out, by their index. @type {Map<number, any>} */
let before = new Map();
/** The rows that shall be left out, with the reason of each that has one already. @type {Map<number, string | null>} */
let marked = new Map();
/** What is drawn: lengths that are used and left out, by their index. @type {any[]} */
let rows = [];

/** @param {typeof context} now */
export function start(now) {
  context = now;
  $("residuals").addEventListener("toggle", () => attempt(async () => $("residuals").open && (await open())));
  $("exclude-form").addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(again);
  });
  $("exclude-none").addEventListener("click", () => mark([...before.keys()]));
}

/** Reads the residuals of the newest result, if they are shown. */
export async function open() {
  if (!$("residuals").open) return;
  cell = await ask("GET", `/workbench/${context.robot}/scene`);
  before = new Map(cell.excluded.map((one) => [one.index, one]));
  rows = [...cell.residuals, ...cell.excluded].sort((a, b) => a.index - b.index);
  plot ??= await plotIn($("residual-plot"), {
    label: t("residuals.label"),
    x: t("residuals.row"),
    y: t("residuals.residual"),
    digits: 0,
    hover,
    pick: (at) => toggle(rows[at].index),
    series: () => [
      { label: t("residuals.used"), stroke: colour("--mark"), paths: () => null, points: { show: true, size: 6, fill: colour("--mark") } },
      { label: t("residuals.out"), stroke: colour("--over"), paths: () => null, points: { show: true, size: 10, fill: colour("--paper"), width: 2 } },
    ],
  });
  mark([...before.keys()]);
}

/** @param {number | null} at */
function hover(at) {
  const one = at === null ? null : rows[at];
  $("residual-at").textContent = one ? t("residuals.at", { index: one.index, ball: one.ball ?? "–", um: signed(1e3 * one.residual_mm, 1) }) : t("residuals.hint");
}

/** @param {number[]} indices */
function mark(indices) {
  marked = new Map(indices.map((index) => [index, before.get(index)?.reason ?? null]));
  draw();
}

/** @param {number} index */
function toggle(index) {
  if (!marked.delete(index)) marked.set(index, before.get(index)?.reason ?? null);
  draw();
}

function draw() {
  const um = (is) => rows.map((one) => (marked.has(one.index) === is ? 1e3 * one.residual_mm : null));
  plot.show([rows.map((one) => one.index), um(false), um(true)]);
  /** @type {any} */
  const active = document.activeElement;
  const focused = active?.dataset.row;
  $("residual-rows").replaceChildren(...rows.map(line));
  if (focused) $("residual-rows").querySelector(`[data-row="${focused}"]`)?.focus();
  const indices = [...marked.keys()].sort((a, b) => a - b);
  const changed = indices.length !== before.size || indices.some((index) => !before.has(index));
  $("exclude-list").textContent = indices.length ? t("residuals.left_out", { count: indices.length, rows: indices.join(", ") }) : t("residuals.none_left_out");
  $("exclude-form").querySelector("[data-action=again]").disabled = !changed;
  $("exclude-none").disabled = !changed;
  $("exclude-why").parentElement.hidden = indices.every((index) => before.has(index));
}

function line(one) {
  const out = marked.has(one.index);
  const row = make("tr", null, { class: out ? "out" : undefined });
  const act = make("button", t(out ? "residuals.take_in" : "residuals.leave_out"), { type: "button", "data-row": String(one.index), "aria-label": `${t(out ? "residuals.take_in" : "residuals.leave_out")}: ${one.index}` });
  act.addEventListener("click", () => toggle(one.index));
  const about = before.get(one.index);
  const why = about ? [about.by, about.reason].filter(Boolean).join(": ") : "";
  const cell = make("td", null);
  cell.append(act);
  row.append(
    make("th", String(one.index), { scope: "row" }),
    make("td", String(one.ball ?? "–"), { class: "num" }),
    make("td", signed(1e3 * one.residual_mm, 1), { class: "num" }),
    cell,
    make("td", why),
  );
  return row;
}

/** Computes the result again without what is marked. */
async function again() {
  const why = $("exclude-why").value.trim() || null;
  // Rows with the same reason are one entry; what was left out before keeps its own.
  const entries = [...marked].map(([index, reason]) => ({ rows: [index], reason: before.has(index) ? reason : why }));
  await context.compute(entries);
  $("exclude-why").value = "";
}
