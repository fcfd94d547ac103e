// The mounting of the bar: stability and findings.

import { ask } from "/link.js";
import { fixed, timeOfDay } from "/numbers.js";
import { known, t } from "/texts.js";
import { beep } from "/gauge.js";

/** @type {(id: string) => any} */
const $ = (id) => document.getElementById(id);
const MOST = 3;
let found = [];
let seen = 0;

/** Shows the mounting from the state; null if no bar is read. */
export function show(mounting) {
  const state = mounting?.state;
  $("steady-row").hidden = !state;
  if (!state) return;
  const text = t(`steady.${state}`);
  if ($("steady").textContent !== text) $("steady").textContent = text;
  $("steady").dataset.steady = state;
  const parts = [
    mounting.scatter_um === null ? "" : t("steady.scatter", { um: fixed(mounting.scatter_um, 1) }),
    mounting.drift_um_s === null ? "" : t("steady.drift", { um: fixed(mounting.drift_um_s, 1) }),
    mounting.temperature_c === null ? "" : t("steady.temperature", { c: fixed(mounting.temperature_c, 1) }),
  ];
  $("steady-detail").textContent = parts.filter(Boolean).join(" · ");
  all(mounting.findings);
}

/** Adds a finding. */
export function add(finding) {
  if (finding.unix_ms <= seen) return;
  seen = finding.unix_ms;
  found = [...found.filter((one) => one.code !== finding.code), finding].slice(-MOST);
  draw();
  beep(660);
}

function all(findings) {
  findings.forEach(add);
}

function draw() {
  const items = found.map((finding) => {
    const item = document.createElement("li");
    const text = known(finding.code) ? t(finding.code, { um: fixed(Math.abs(finding.size_um), finding.code === "W0281" ? 1 : 0) }) : finding.text;
    item.textContent = `${text} (${finding.code}, ${t("mounting.at", { time: timeOfDay(finding.unix_ms) })})`;
    return item;
  });
  $("mounting-list").replaceChildren(...items);
  $("mounting").hidden = !items.length;
}

$("mounting-clear").addEventListener("click", () => {
  found = [];
  draw();
  ask("POST", "/act", { act: "alarm_cleared" }).catch(() => {});
});

/** Clears the last run. */
export function begin() {
  found = [];
  draw();
}
