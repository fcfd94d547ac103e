// Length and stroke: the number, the gauge with its zones, the alarm with its sound.

import { ask } from "/link.js";
import { fixed, signed, timeOfDay } from "/numbers.js";
import { t } from "/texts.js";

const SVG = "http://www.w3.org/2000/svg";
/** @type {(id: string) => any} */
const $ = (id) => document.getElementById(id);
const FORGET_MS = 700;

let stroke = null;
let share = 0.9;
let drawn = "";
let worst = null;
let level = "none";
let levelAt = 0;
let audio = null;

function shape(name, attributes, parent) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  parent.append(node);
  return node;
}

// The stroke takes 80 % of the width. 10 % on either side are beyond it.
function place(value) {
  const [low, high] = stroke;
  return Math.max(4, Math.min(996, 100 + (800 * (value - low)) / (high - low)));
}

function draw() {
  const svg = $("gauge");
  svg.replaceChildren();
  $("low").textContent = stroke ? signed(stroke[0], 2) + " mm" : "";
  $("high").textContent = stroke ? signed(stroke[1], 2) + " mm" : "";
  if (!stroke) return;
  const middle = (stroke[0] + stroke[1]) / 2;
  const half = (share * (stroke[1] - stroke[0])) / 2;
  const [from, to] = [place(middle - half), place(middle + half)];
  shape("rect", { class: "over", x: 0, y: 20, width: 100, height: 80 }, svg);
  shape("rect", { class: "over", x: 900, y: 20, width: 100, height: 80 }, svg);
  shape("rect", { class: "near", x: 100, y: 20, width: from - 100, height: 80 }, svg);
  shape("rect", { class: "near", x: to, y: 20, width: 900 - to, height: 80 }, svg);
  shape("rect", { class: "body", x: from, y: 20, width: to - from, height: 80 }, svg);
  if (stroke[0] < 0 && stroke[1] > 0) {
    shape("line", { class: "zero", x1: place(0), x2: place(0), y1: 20, y2: 100 }, svg);
  }
  shape("rect", { class: "band", id: "band", x: 0, y: 30, width: 0, height: 60 }, svg);
  shape("rect", { class: "hand", id: "hand", x: 0, y: 4, width: 8, height: 112 }, svg);
}

/** Sets stroke and alarm share from the state. */
export function setup(run) {
  const now = JSON.stringify([run?.stroke_mm, run?.alarm_share]);
  if (run && now !== drawn) {
    drawn = now;
    stroke = run.stroke_mm;
    share = run.alarm_share;
    draw();
  }
  if (!run) {
    $("value").textContent = "–";
    $("detail").textContent = t("length.none");
    for (const id of ["hand", "band"]) $(id)?.setAttribute("x", -2000);
    $("length").dataset.bar = "none";
    setLevel("none");
  }
}

/** Resets the gauge for a new run. */
export function begin() {
  worst = null;
  level = "none";
  showAlarm();
}

/** Shows a frame. */
export function show(frame, run) {
  $("value").textContent = signed(frame.last_mm);
  $("length").dataset.bar = frame.mounted ? "mounted" : "off";
  const length = run?.bar_length_mm ? t("length.between", { mm: fixed(run.bar_length_mm + frame.last_mm) }) : "";
  const where = stroke
    ? t("length.share", { percent: fixed((100 * (frame.last_mm - stroke[0])) / (stroke[1] - stroke[0]), 0) })
    : t("length.no_stroke");
  const invalid = frame.valid ? "" : t("length.invalid");
  const shown = frame.mounted ? [length, where, invalid] : [t("length.off")];
  $("detail").textContent = shown.filter(Boolean).join(" · ");
  if (stroke && $("hand")) {
    $("hand").setAttribute("x", place(frame.last_mm) - 4);
    $("band").setAttribute("x", place(frame.min_mm));
    $("band").setAttribute("width", Math.max(1, place(frame.max_mm) - place(frame.min_mm)));
    $("gauge").setAttribute("aria-label", t("gauge.label", { text: `${frame.mounted ? where : t("steady.off")}, ${signed(frame.last_mm)} mm` }));
    if (frame.alarm !== "none") {
      const far = Math.abs(frame.max_mm - stroke[1]) < Math.abs(frame.min_mm - stroke[0]) ? frame.max_mm : frame.min_mm;
      const beyond = (value) => Math.max(value - stroke[1], stroke[0] - value);
      if (!worst || beyond(far) > beyond(worst.value)) worst = { value: far, level: frame.alarm, at: Date.now() };
    }
  }
  // A short alarm stays visible for a moment.
  const rank = { none: 0, near: 1, over: 2 };
  if (rank[frame.alarm] >= rank[level] || performance.now() - levelAt > FORGET_MS) setLevel(frame.alarm);
}

function setLevel(now) {
  if (now !== "none") levelAt = performance.now();
  if (now === level) return;
  level = now;
  showAlarm();
  if (level !== "none") beep(level === "over" ? 880 : 520);
}

function showAlarm() {
  const box = $("alarm");
  $("length").dataset.level = level;
  $("quiet").hidden = !worst;
  box.hidden = level === "none" && !worst;
  box.dataset.level = level === "none" ? "past" : level;
  const texts = {
    over: t("alarm.over"),
    near: t("alarm.near"),
    none: worst ? t(`alarm.past_${worst.level}`, { mm: signed(worst.value), time: timeOfDay(worst.at) }) : "",
  };
  if (box.textContent !== texts[level]) box.textContent = texts[level];
}

/** Plays a short tone, unless the sound is off. */
export function beep(hertz) {
  if (!$("sound").checked || !audio) return;
  const tone = audio.createOscillator();
  tone.type = "square";
  tone.frequency.value = hertz;
  tone.connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.25);
}

setInterval(() => {
  if (level === "over") beep(880);
}, 500);
$("gauge").setAttribute("aria-label", t("gauge.label", { text: t("gauge.unknown") }));
$("sound").checked = localStorage.getItem("sound") !== "off";
// Browsers allow sound only after an action of the user.
document.addEventListener("click", () => {
  audio ??= new AudioContext();
  audio.resume();
});
$("sound").addEventListener("change", () => {
  const sound = $("sound").checked ? "on" : "off";
  localStorage.setItem("sound", sound);
  ask("POST", "/act", { act: `sound_${sound}` }).catch(() => {});
  beep(520);
});
$("quiet").addEventListener("click", () => {
  worst = null;
  showAlarm();
  ask("POST", "/act", { act: "alarm_cleared" }).catch(() => {});
});
