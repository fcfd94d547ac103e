// The step Correct: a program is dropped, each point's shift is shown, the corrected set is downloaded.

import { $, attempt, make, say } from "/frame.js";
import { ask } from "/link.js";
import { fixed, signed } from "/numbers.js";
import { t } from "/texts.js";
import { zip } from "/zip.js";

/** Largest upload, bytes; the service refuses more. */
const MOST = 2e6;

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
  if (all.reduce((sum, file) => sum + file.size, 0) > MOST) throw new Error(t("correct.too_large"));
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

let shownJob = null;
let made = null;

/** Shows what was corrected. @param {any} report the step of the service */
export async function show(report) {
  made = report.state === "done" ? report : null;
  $("download").hidden = !made;
  const job = report.job;
  if (!job || job.kind !== "compensate" || !["done", "doubt"].includes(job.state)) {
    if (report.state !== "done") $("shifts").hidden = true;
    return;
  }
  if (shownJob === job.id) return;
  shownJob = job.id;
  const answer = await ask("GET", `/jobs/${job.id}/answer`);
  if (!answer) return;
  const cells = (point) => [point.name, String(point.line), signed(point.shift_mm, 3), fixed(point.turn_deg, 4)];
  $("shift-rows").replaceChildren(
    ...answer.points.map((point) => {
      const row = make("tr", null);
      const [name, ...rest] = cells(point);
      row.append(make("th", name, { scope: "row" }), ...rest.map((text) => make("td", text, { class: "num" })));
      return row;
    }),
  );
  $("shift-summary").textContent = t("correct.summary", {
    points: answer.points.length, mean: fixed(answer.mean_shift_mm, 3), most: fixed(answer.largest_shift_mm, 3), left: answer.left,
  });
  $("shifts").hidden = false;
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
