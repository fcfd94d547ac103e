// The reading over time: the extremes of each second of the run, and of each frame of the last minute. It can be held and zoomed.

import { $ } from "/frame.js";
import { clock, signed } from "/numbers.js";
import { colour, plotIn } from "/plots.js";
import { t } from "/texts.js";

/** Frames of this time are shown one by one, s. */
const FINE_S = 60;
/** Seconds that are kept, as the service keeps them. */
const MAX_SECONDS = 1800;
/** A longer silence is a gap in the line, s: the frames of a fast simulated cell are seconds apart. */
const GAP_S = 10;
/** Time between two drawings, ms. */
const DRAW_MS = 100;

/** @typedef {{ t_s: number, min_mm: number, max_mm: number }} Range */
/** @type {Range[]} */
let seconds = [];
/** @type {Range[]} */
let frames = [];
/** @type {[number, number] | null} */
let stroke = null;
let held = false;
/** @type {any} */
let plot = null;
let opening = false;
let drawn = 0;
let due = false;
/** @type {Range[]} */
let shown = [];

/** Clears the last run. */
export function begin() {
  seconds = [];
  frames = [];
  draw();
}

/** The run so far, after a connection. @param {Range[]} list */
export function all(list) {
  seconds = list;
  frames = [];
  draw();
}

/**
 * Joins a frame to the second that it is in.
 * @param {Range[]} list
 * @param {Range} frame
 */
export function addSecond(list, { t_s, min_mm, max_mm }) {
  const last = list.at(-1);
  if (last && Math.floor(last.t_s) === Math.floor(t_s)) {
    list[list.length - 1] = { t_s, min_mm: Math.min(last.min_mm, min_mm), max_mm: Math.max(last.max_mm, max_mm) };
  } else if (!last || last.t_s < t_s) {
    list.push({ t_s, min_mm, max_mm });
    if (list.length > MAX_SECONDS) list.shift();
  }
}

/** Adds a frame. @param {any} frame @param {any} run */
export function add(frame, run) {
  stroke = run?.stroke_mm ?? null;
  // Without a mounted bar there is nothing to show.
  if (!frame.mounted) return;
  // Another reading begins at zero.
  if (frames.length && frame.t_s < frames[frames.length - 1].t_s) begin();
  frames.push(frame);
  while (frames[0].t_s < frame.t_s - FINE_S) addSecond(seconds, /** @type {Range} */ (frames.shift()));
  draw();
}

/** The data of the plot: time, lowest and highest; null in gaps. @returns {[number[], (number | null)[], (number | null)[]]} */
function data() {
  const end = frames.at(-1)?.t_s ?? seconds.at(-1)?.t_s ?? 0;
  const span = Number($("trace-span").value);
  const from = span ? end - span : -Infinity;
  const fine = frames[0]?.t_s ?? Infinity;
  shown = [...seconds.filter((one) => one.t_s < fine), ...frames].filter((one) => one.t_s >= from);
  const x = [];
  const low = [];
  const high = [];
  let before = null;
  for (const { t_s, min_mm, max_mm } of shown) {
    if (before !== null && t_s - before > GAP_S) {
      x.push(before + GAP_S / 2);
      low.push(null);
      high.push(null);
    }
    x.push(t_s);
    low.push(min_mm);
    high.push(max_mm);
    before = t_s;
  }
  return [x, low, high];
}

async function open() {
  if (plot || opening || !$("trace").clientWidth) return;
  opening = true;
  plot = await plotIn($("trace"), {
    label: t("trace.label"),
    x: t("trace.time"),
    y: t("trace.reading"),
    hover,
    after: drawStroke,
    series: () => [
      { label: t("trace.low"), stroke: colour("--mark"), width: 1, points: { show: false } },
      { label: t("trace.high"), stroke: colour("--mark"), width: 1, points: { show: false } },
    ],
    bands: [{ series: [2, 1], fill: "rgba(110,160,230,0.45)" }],
  });
  plot.show(data());
}

/** The ends of the stroke, where they are in sight. @param {any} own */
function drawStroke(own) {
  if (!stroke) return;
  const { left, width, top, height } = own.bbox;
  own.ctx.strokeStyle = colour("--over");
  own.ctx.lineWidth = 2;
  for (const end of stroke) {
    const y = own.valToPos(end, "y", true);
    if (y < top || y > top + height) continue;
    own.ctx.beginPath();
    own.ctx.moveTo(left, y);
    own.ctx.lineTo(left + width, y);
    own.ctx.stroke();
  }
}

/** @param {number | null} at */
function hover(at) {
  const [x, low, high] = at === null || !plot ? [[], [], []] : plot.data();
  const known = at !== null && low[at] !== null && low[at] !== undefined;
  $("trace-at").textContent = known ? t("trace.at", { time: clock(x[at]), low: signed(low[at]), high: signed(high[at]) }) : t("trace.hint");
}

function draw() {
  if (due || held || document.hidden) return;
  due = true;
  setTimeout(() => {
    due = false;
    if (!plot) return open();
    if ($("trace").clientWidth) plot.show(data());
    drawn = performance.now();
  }, Math.max(0, drawn + DRAW_MS - performance.now()));
}

$("trace-hold").addEventListener("click", () => {
  held = !held;
  $("trace-hold").setAttribute("aria-pressed", String(held));
  draw();
});
$("trace-whole").addEventListener("click", () => plot?.whole());
$("trace-span").replaceChildren(
  ...[[60, "trace.minute"], [600, "trace.ten_minutes"], [0, "trace.run"]].map(([span, key]) => new Option(t(String(key)), String(span))),
);
$("trace-span").addEventListener("change", draw);
$("live").addEventListener("toggle", draw);
