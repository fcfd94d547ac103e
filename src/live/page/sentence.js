// The sentence of a step: its verdict by colour, word and shape.

import { make } from "/frame.js";
import { count, fixed, significant } from "/numbers.js";
import { known, t } from "/texts.js";

/** Speeds of a simulated cell: device time per host time. */
export const SPEEDS = [1, 5, 20, 50];

const SHAPES = { pass: "✓", fail: "✕", undecided: "?", none: "•" };

const TWO_DIGITS = ["u_mm", "error_mm", "upper_mm", "tolerance_mm", "predicted_mm"];

/** Digits after the point of a value by the unit in its name. */
function shown(name, value) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return String(value);
  // An uncertainty and what is decided have two digits, as in the reports.
  if (TWO_DIGITS.includes(name)) return significant(value, 2);
  if (name.endsWith("_um")) return significant(value, 3);
  if (name.endsWith("_mm")) return fixed(value, Number.isInteger(value) ? 0 : 3);
  if (name === "k") return String(value);
  // A risk is never printed as nothing.
  if (name === "risk") return value < 0.001 ? `< ${fixed(0.001, 3)}` : fixed(value, 3);
  if (name === "minutes") return fixed(value, 1);
  return Number.isInteger(value) ? count(value) : fixed(value, 1);
}

/** @param {{ text: string, values: Record<string, unknown> | null }} report */
export function sentence({ text, values }) {
  const shownValues = Object.fromEntries(Object.entries(values ?? {}).map(([name, value]) => [name, shown(name, value)]));
  const reason = values?.reason;
  if (reason && known(`ending.${reason}`)) shownValues.reason = t(`ending.${reason}`);
  return t(`say.${text}`, shownValues);
}

/**
 * A verdict by colour, word and shape. The word is that of the step, if it has one.
 * @param {"pass" | "fail" | "undecided" | "none"} verdict
 * @param {string} text
 * @param {string} [step]
 */
export function verdictLine(verdict, text, step = "") {
  const line = make("p", null, { class: "verdict", "data-verdict": verdict });
  line.append(make("span", SHAPES[verdict], { class: "shape", "aria-hidden": "true" }), " ");
  const own = `verdict.${step}.${verdict}`;
  if (verdict !== "none") line.append(make("strong", t(known(own) ? own : `verdict.${verdict}`)), " ");
  line.append(make("span", text));
  return line;
}

/** What to do next, and for how long a result may be used where that is known. @param {any} report @returns {HTMLElement[]} */
export function after({ text, values }) {
  const lines = [];
  if (values?.validity) lines.push(make("p", values.validity, { "data-validity": "" }));
  const key = `next.${text}`;
  if (known(key)) {
    const line = make("p", null, { class: "next" });
    line.append(make("strong", t("next")), " ", t(key));
    lines.push(line);
  }
  return lines;
}
