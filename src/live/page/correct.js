// The step Correct: a program is dropped, each point's shift is shown, the corrected set is downloaded.

import { $, attempt, make, say } from "/frame.js";
import { ask } from "/link.js";
import { fixed, signed } from "/numbers.js";
import { t } from "/texts.js";
import { zip } from "/zip.js";

/** Largest upload, bytes; the service refuses more. */
const MAX_BYTES = 2e6;

/** @type {{ robot: string, changed: () => Promise<void> }} */
let context;

/** One character a byte: a program keeps the bytes of its own code page. @param {ArrayBuffer} buffer */
function bytesOf(buffer) {
  let text = "";
  for (const byte of new Uint8Array(buffer)) text += String.fromCharCode(byte);
  return text;
}

async function upload(files) {
  const all = [...files];
  if (!all.length) return;
  if (all.reduce((sum, file) => sum + file.size, 0) > MAX_BYTES) throw new Error(t("correct.too_large"));
  // `$config.dat` has no plain name.
  const named = await Promise.all(all.map(async (file) => ({ name: file.name.replace(/^\$/, ""), bytes: bytesOf(await file.arrayBuffer()) })));
  await ask("PUT", `/workbench/${context.robot}/program`, { files: named });
  say(t("correct.uploaded", { count: named.length }));
  await context.changed();
}

/** @param {{ robot: string, changed: () => Promise<void> }} now */
export function start(now) {
  context = now;
  $("program").addEventListener("change", () => attempt(() => upload($("program").files)));
  const drop = $("drop");
  for (const kind of ["dragenter", "dragover"]) {
    drop.addEventListener(kind, (event) => {
      event.preventDefault();
      drop.classList.add("over");
    });
  }
  drop.addEventListener("dragleave", () => drop.classList.remove("over"));
  drop.addEventListener("drop", (event) => {
    event.preventDefault();
    drop.classList.remove("over");
    attempt(() => upload(event.dataTransfer.files));
  });
  $("download").addEventListener("click", () => attempt(download));
}

/** The corrected points by the number of their job. @type {Map<number, any>} */
let answers = new Map();
let made = null;
/** Whether all programs are corrected, one after the other. */
let goesOn = false;

/** Corrects the uploaded programs, one after the other. */
export async function begin() {
  goesOn = true;
  answers = new Map();
  await next();
}

async function next() {
  await ask("POST", `/workbench/${context.robot}/steps/correct`, {});
  await context.changed();
}

/** Shows what was corrected. @param {any} report the step of the service */
export async function show(report) {
  made = report.state === "done" ? report : null;
  $("download").hidden = !made;
  const { job } = report;
  const over = job?.kind === "compensate" && ["done", "warned"].includes(job.state);
  if (over && !answers.has(job.id)) {
    answers.set(job.id, null);
    answers.set(job.id, await ask("GET", `/jobs/${job.id}/answer`));
    table();
    if (goesOn && report.state === "ready") return next();
  }
  if (report.state !== "running" && !(goesOn && report.state === "ready" && over)) goesOn = false;
}

function table() {
  const all = [...answers.values()].filter(Boolean);
  const points = all.flatMap((answer) => answer.points);
  $("shift-rows").replaceChildren(
    ...points.map((point) => {
      const row = make("tr", null);
      const rest = [String(point.line), signed(point.shift_mm, 3), fixed(point.turn_deg, 4)];
      row.append(make("th", point.name, { scope: "row" }), ...rest.map((text) => make("td", text, { class: "num" })));
      return row;
    }),
  );
  const mean = points.reduce((sum, point) => sum + point.shift_mm, 0) / Math.max(1, points.length);
  const most = points.reduce((most, point) => Math.max(most, point.shift_mm), 0);
  const left = all.reduce((sum, answer) => sum + answer.left, 0);
  const says = [t("correct.summary", { points: points.length, mean: fixed(mean, 3), most: fixed(most, 3), left }), predicted(all)];
  $("shift-summary").textContent = says.filter(Boolean).join(" ");
  $("shifts").hidden = !all.length;
}

/** What is predicted of the tools of all programs at their points. @param {any[]} all */
function predicted(all) {
  const known = all.filter((answer) => answer.predicted_position_uncertainty_mm);
  const points = known.reduce((sum, answer) => sum + answer.points.length, 0);
  if (!points) return null;
  const mean = (when) => known.reduce((sum, answer) => sum + answer.points.length * answer.predicted_position_uncertainty_mm[when].mean, 0) / points;
  return t("correct.predicted", { before: fixed(mean("before"), 3), after: fixed(mean("after"), 3) });
}

async function download() {
  const { directory, files } = made;
  const load = async (name) => {
    const answer = await fetch(`/api/v1/workbench/${context.robot}/files/${directory}/${name}`);
    if (!answer.ok) throw new Error(`${name}: ${answer.statusText}`);
    return { name, bytes: new Uint8Array(await answer.arrayBuffer()) };
  };
  const link = make("a", null, { download: `${context.robot}-${directory}.zip` });
  link.href = URL.createObjectURL(zip(await Promise.all(files.map(load))));
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
