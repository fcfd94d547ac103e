// Strip chart of the last minute: lowest and highest reading of each frame.

import { fixed } from "/numbers.js";

const SPAN_S = 60;
const $ = (id) => document.getElementById(id);
let frames = [];
let stroke = null;
let due = false;

/** Clears the last run. */
export function begin() {
  frames = [];
  redraw();
}

/** Adds a frame. */
export function add(frame, run) {
  stroke = run?.stroke_mm ?? null;
  // Without a mounted bar there is nothing to show.
  if (!frame.mounted) return;
  if (frames.length && frame.t_s < frames.at(-1).t_s) frames = [];
  frames.push(frame);
  while (frames[0].t_s < frame.t_s - SPAN_S) frames.shift();
  redraw();
}

function redraw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    draw();
  });
}

function draw() {
  const canvas = $("strip");
  const ratio = window.devicePixelRatio || 1;
  const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = wide * ratio;
  canvas.height = high * ratio;
  const ink = canvas.getContext("2d");
  ink.scale(ratio, ratio);
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name);
  if (!frames.length) return;
  let low = Math.min(...frames.map((f) => f.min_mm));
  let top = Math.max(...frames.map((f) => f.max_mm));
  const room = Math.max(0.005, (top - low) * 0.1);
  [low, top] = [low - room, top + room];
  const end = frames.at(-1).t_s;
  const left = 78;
  const x = (t) => left + (wide - left - 4) * (1 - (end - t) / SPAN_S);
  const y = (v) => 6 + (high - 26) * (1 - (v - low) / (top - low));
  ink.font = "13px system-ui, sans-serif";
  ink.fillStyle = colour("--soft");
  ink.strokeStyle = colour("--rule");
  for (const v of [low + room, (low + top) / 2, top - room]) {
    ink.fillText(fixed(v) + " mm", 0, y(v) + 4);
    line(ink, left, y(v), wide, y(v));
  }
  for (let back = 0; back <= SPAN_S; back += 15) {
    ink.textAlign = back ? "center" : "right";
    ink.fillText(`${fixed(-back, 0)} s`, back ? x(end - back) : wide, high - 4);
  }
  ink.textAlign = "left";
  if (stroke) {
    ink.strokeStyle = colour("--over");
    for (const v of stroke) if (v > low && v < top) line(ink, left, y(v), wide, y(v));
  }
  ink.fillStyle = colour("--mark");
  let before = null;
  for (const f of frames) {
    const from = before && f.frame === before.frame + 1 && f.t_s - before.t_s < 3 ? x(before.t_s) : x(f.t_s) - 1;
    const [upper, lower] = [y(f.max_mm), y(f.min_mm)];
    ink.fillRect(from, upper - 0.75, Math.max(1, x(f.t_s) - from), lower - upper + 1.5);
    before = f;
  }
}

function line(ink, x1, y1, x2, y2) {
  ink.beginPath();
  ink.moveTo(x1, y1);
  ink.lineTo(x2, y2);
  ink.stroke();
}

window.addEventListener("resize", redraw);
