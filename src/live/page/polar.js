// The polar plot: the magnified deviation at each dwell.

import { quantities } from "/circle.js";
import { count, signed } from "/numbers.js";
import { t } from "/texts.js";

const SVG = "http://www.w3.org/2000/svg";
/** @type {(id: string) => any} */
const $ = (id) => document.getElementById(id);
const RADIUS = 70;
// Deviation per ring, um: 1, 2, 5 and so on.
const STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const RING = 20;

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

function at(angle, radius) {
  const turn = (angle * Math.PI) / 180;
  return [radius * Math.cos(turn), -radius * Math.sin(turn)];
}

function chosen() {
  return [...points.values()].filter((p) => p.circle === circle && p.angle_deg !== null && p.deviation_mm !== null);
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
    select.replaceChildren(...circles.map((c) => new Option(c === 0 ? t("polar.chosen") : c, c)));
  }
  if (circle !== null) select.value = circle;
  const scale = STEPS[step ?? fit(list)];
  $("scale").textContent = list.length ? t("polar.scale", { um: count(scale) }) : "–";
  svg.replaceChildren();
  for (const ring of [-2, -1, 0, 1, 2]) {
    node("circle", { class: ring ? "ring" : "nominal", r: RADIUS + ring * RING }, svg);
    if (!list.length) continue;
    const [x, y] = at(45, RADIUS + ring * RING);
    node("text", { x: x + 1, y }, svg).textContent = signed(ring * scale, 0);
  }
  for (const [angle, text] of [[0, "0°"], [90, "90°"], [180, "180°"], [270, "270°"]]) {
    const [x, y] = at(angle, 114);
    node("text", { x, y: y + 2.5, "text-anchor": "middle" }, svg).textContent = text;
  }
  const far = (p) => Math.max(4, Math.min(116, RADIUS + ((p.deviation_mm * 1e3) / scale) * RING));
  for (const clockwise of [false, true]) {
    const pass = list.filter((p) => p.clockwise === clockwise);
    const kind = clockwise ? "cw" : "ccw";
    const path = pass.map((p, i) => (i ? "L" : "M") + at(p.angle_deg, far(p)).map((v) => v.toFixed(2)).join(" "));
    if (path.length > 1) node("path", { class: kind, d: path.join("") }, svg);
    for (const p of pass) {
      const [x, y] = at(p.angle_deg, far(p));
      if (clockwise) node("rect", { class: kind, x: x - 1.4, y: y - 1.4, width: 2.8, height: 2.8 }, svg);
      else node("circle", { class: kind, cx: x, cy: y, r: 1.6 }, svg);
    }
  }
  drawExpected(svg, list, scale);
  const found = quantities(list);
  for (const [name, value] of Object.entries(found)) $(`q-${name}`).textContent = value === null ? "–" : `${signed(1e3 * value, 1)} µm`;
  const last = list.at(-1);
  const text = last ? t("polar.points", { count: list.length, ring: count(scale), last: signed(last.deviation_mm * 1e3, 1) }) : t("polar.none");
  svg.setAttribute("aria-label", t("polar.label", { text }));
}

/** What is expected, and what is left of it: the measured minus the expected deviation. */
function drawExpected(svg, list, scale) {
  const known = list.filter((p) => expected.has(p.index)).map((p) => ({ ...p, expected_mm: expected.get(p.index) }));
  const radius = (mm) => Math.max(4, Math.min(116, RADIUS + ((mm * 1e3) / scale) * RING));
  const path = known.map((p, i) => (i ? "L" : "M") + at(p.angle_deg, radius(p.expected_mm)).map((v) => v.toFixed(2)).join(" "));
  if (path.length > 1) node("path", { class: "expected", d: path.join("") }, svg);
  for (const p of known) {
    const [cx, cy] = at(p.angle_deg, radius(p.deviation_mm - p.expected_mm));
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
