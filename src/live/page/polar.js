// The plot of the lengths: the magnified deviation at each dwell, of a circle over its angle, of chosen poses over their rows.

import { quantities } from "/circle.js";
import { count, signed } from "/numbers.js";
import { t } from "/texts.js";

const SVG = "http://www.w3.org/2000/svg";
/** @type {(id: string) => any} */
const $ = (id) => document.getElementById(id);
/** @typedef {{ index: number, angle_deg: number | null, deviation_mm: number, clockwise: boolean }} Dwell */

const RADIUS = 70;
// Deviation per ring, um: 1, 2, 5 and so on.
const STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const RING = 20;
/** Distance of the lines of chosen poses, and half their length: they have the place that a circle takes. */
const LINE = 40;
const HALF_LINE = 105;
const FARTHEST = 116;

let points = new Map();
let circle = null;
let step = null;

/** What an identified robot shows at the rows of the plan, mm. @type {Map<number, number>} */
let expected = new Map();

/** Sets what is expected at the rows of the plan; an empty list where nothing is known. @param {{ index: number, deviation_mm: number }[]} list */
export function expect(list) {
  expected = new Map(list.map((one) => [one.index, one.deviation_mm]));
  $("polar-expected").hidden = !expected.size;
  draw();
}

/** Clears the last run. */
export function begin() {
  points = new Map();
  circle = null;
  draw();
}

/** Sets all dwells after a connection. */
export function all(list) {
  points = new Map(list.map((point) => [point.dwell, point]));
  circle = list.at(-1)?.circle ?? null;
  draw();
}

/** Adds a dwell. */
export function add(point) {
  points.set(point.dwell, point);
  if (point.circle !== null && point.circle !== circle) circle = point.circle;
  draw();
}

function node(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  parent.append(made);
  return made;
}

/** The place of a deviation in rings at an angle. @param {number} angle_deg @param {number} rings */
function atAngle(angle_deg, rings) {
  const turn = (angle_deg * Math.PI) / 180;
  const radius = Math.max(4, Math.min(FARTHEST, RADIUS + rings * RING));
  return [radius * Math.cos(turn), -radius * Math.sin(turn)];
}

/** The place of a deviation in lines at a share of the rows, 0 to 1. @param {number} share @param {number} lines */
function atShare(share, lines) {
  return [HALF_LINE * (2 * share - 1), Math.max(-FARTHEST, Math.min(FARTHEST, -lines * LINE))];
}

/** Whether the plot has a circle; else it has poses that were chosen, which have no angle. */
const isCircle = () => circle !== 0;

/** The dwells of the plot. A reference pose is on no circle. @returns {Dwell[]} */
function chosen() {
  return [...points.values()].filter((p) => p.circle === circle && p.deviation_mm !== null && (!isCircle() || p.angle_deg !== null));
}

// The step at which the farthest point is two rings from zero.
function fit(list) {
  const most = Math.max(0, ...list.map((p) => Math.abs(p.deviation_mm))) * 1e3;
  return Math.max(0, STEPS.findIndex((um) => 2 * um >= most));
}

function draw() {
  const svg = $("plot");
  const list = chosen();
  const circles = [...new Set([...points.values()].map((p) => p.circle).filter((c) => c !== null))];
  const select = $("circle");
  if (select.options.length !== circles.length) {
    select.replaceChildren(...circles.map((c) => new Option(c === 0 ? t("polar.chosen") : `${t("polar.circle")} ${c}`, c)));
  }
  if (circle !== null) select.value = circle;
  const scale = STEPS[step ?? fit(list)];
  $("scale").textContent = list.length ? t("polar.scale", { um: count(scale) }) : "–";
  svg.replaceChildren();
  const rows = list.map((p) => p.index);
  const [first, last] = [Math.min(...rows), Math.max(...rows)];
  /** @type {(p: Dwell, mm: number) => number[]} */
  const place = (p, mm) => {
    const rings = (1e3 * mm) / scale;
    return isCircle() ? atAngle(p.angle_deg ?? 0, rings) : atShare((p.index - first) / Math.max(1, last - first), rings);
  };
  (isCircle() ? drawRings : drawLines)(svg, list.length ? scale : null);
  for (const clockwise of [false, true]) {
    const pass = list.filter((p) => p.clockwise === clockwise);
    const kind = clockwise ? "cw" : "ccw";
    const places = pass.map((p) => place(p, p.deviation_mm));
    drawWay(svg, kind, places);
    for (const [x, y] of places) {
      if (clockwise) node("rect", { class: kind, x: x - 1.4, y: y - 1.4, width: 2.8, height: 2.8 }, svg);
      else node("circle", { class: kind, cx: x, cy: y, r: 1.6 }, svg);
    }
  }
  drawExpected(svg, list, place);
  for (const one of document.querySelectorAll("#polar [data-of=circle]")) /** @type {HTMLElement} */ (one).hidden = !isCircle();
  const found = quantities(list);
  for (const [name, value] of Object.entries(found)) $(`q-${name}`).textContent = value === null ? "–" : `${signed(1e3 * value, 1)} µm`;
  const newest = list.at(-1);
  const text = newest ? t("polar.points", { count: list.length, ring: count(scale), last: signed(newest.deviation_mm * 1e3, 1) }) : t("polar.none");
  svg.setAttribute("aria-label", t("polar.label", { text }));
}

function drawRings(svg, scale) {
  for (const ring of [-2, -1, 0, 1, 2]) {
    node("circle", { class: ring ? "ring" : "nominal", r: RADIUS + ring * RING }, svg);
    if (scale === null) continue;
    const [x, y] = atAngle(45, ring);
    node("text", { x: x + 1, y }, svg).textContent = signed(ring * scale, 0);
  }
  for (const angle of [0, 90, 180, 270]) {
    const [x, y] = atAngle(angle, (114 - RADIUS) / RING);
    node("text", { x, y: y + 2.5, "text-anchor": "middle" }, svg).textContent = `${angle}°`;
  }
}

function drawLines(svg, scale) {
  for (const line of [-2, -1, 0, 1, 2]) {
    const [[x1, y1], [x2, y2]] = [atShare(0, line), atShare(1, line)];
    node("line", { class: line ? "ring" : "nominal", x1, y1, x2, y2 }, svg);
    if (scale !== null) node("text", { x: x1 - 1, y: y1 - 1.5, "text-anchor": "middle" }, svg).textContent = signed(line * scale, 0);
  }
}

/** The way from point to point; chosen poses have none that would say something. */
function drawWay(svg, kind, places) {
  const path = places.map((place, i) => (i ? "L" : "M") + place.map((v) => v.toFixed(2)).join(" "));
  if (isCircle() && path.length > 1) node("path", { class: kind, d: path.join("") }, svg);
}

/** What is expected, and what is left of it: the measured minus the expected deviation. */
function drawExpected(svg, list, place) {
  const known = list.filter((p) => expected.has(p.index)).map((p) => ({ ...p, expected_mm: expected.get(p.index) }));
  drawWay(svg, "expected", known.map((p) => place(p, p.expected_mm)));
  for (const p of known) {
    const [cx, cy] = place(p, p.deviation_mm - p.expected_mm);
    node("circle", { class: "after", cx, cy, r: 1.4 }, svg);
  }
}

/** Changes the scale by a number of steps (negative magnifies), or fits it if null. */
export function magnify(by) {
  step = by === null ? null : Math.max(0, Math.min(STEPS.length - 1, (step ?? fit(chosen())) + by));
  $("auto").setAttribute("aria-pressed", String(step === null));
  draw();
}

$("circle").addEventListener("change", (event) => {
  circle = Number(event.target.value);
  draw();
});
$("more").addEventListener("click", () => magnify(-1));
$("less").addEventListener("click", () => magnify(1));
$("auto").addEventListener("click", () => magnify(null));
draw();
