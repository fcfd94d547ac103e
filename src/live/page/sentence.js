// The sentence of a step: its verdict by colour, word and shape.

import { make } from "/frame.js";
import { count, day, fixed, significant } from "/numbers.js";
import { known, t } from "/texts.js";

/** Speeds of a simulated cell: device time per host time. */
export const SPEEDS = [1, 5, 20, 50];

const SHAPES = { pass: "✓", fail: "✕", undecided: "?", none: "•" };

const TWO_DIGITS = ["u_mm", "before_mm", "after_mm", "error_mm", "upper_mm", "tolerance_mm", "predicted_mm"];

/** Digits after the point of a value by the unit in its name. */
function shown(name, value) {
  if (value === null || value === undefined) return "–";
  if (name === "until" || name === "measured") return day(value);
  if (name === "headline") return headline(value);
  if (name === "tool_mm") return `(${value.map((mm) => fixed(mm, 1)).join(fixed(0.5, 1).includes(",") ? "; " : ", ")})`;
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

/** Error, uncertainty and tool of a calibration, with which every sentence about its result begins. @param {Record<string, any>} parts */
function headline(parts) {
  const shownParts = Object.fromEntries(Object.entries(parts).map(([name, value]) => [name, shown(name, value)]));
  const payload = t(parts.payload_kg === null ? "headline.no_payload" : "headline.payload", shownParts);
  return t("headline", { ...shownParts, payload });
}

/** @param {{ text: string, values: Record<string, unknown> | null }} report */
function sentence({ text, values }) {
  const shownValues = Object.fromEntries(Object.entries(values ?? {}).map(([name, value]) => [name, shown(name, value)]));
  const reason = values?.reason;
  if (reason && known(`ending.${reason}`)) shownValues.reason = t(`ending.${reason}`);
  return t(`say.${text}`, shownValues);
}

/**
 * The verdict of a step by colour, word and shape. The word is that of its sentence or of the step, if there is one.
 * @param {{ verdict: "pass" | "fail" | "undecided" | "none", step: string, text: string, values: any }} report
 */
export function verdictLine(report) {
  const { verdict, step, text } = report;
  const line = make("p", null, { class: "verdict", "data-verdict": verdict });
  line.append(make("span", SHAPES[verdict], { class: "shape", "aria-hidden": "true" }), " ");
  const word = [`verdict.${text}`, `verdict.${step}.${verdict}`, `verdict.${verdict}`].find(known);
  if (verdict !== "none") line.append(make("strong", t(word)), " ");
  line.append(make("span", sentence(report)));
  return line;
}

/** What to do next, and for how long a result may be used where that is known. @param {any} report @returns {HTMLElement[]} */
export function after({ step, text, values }) {
  const lines = [];
  // The sentence of a result says it.
  if (step === "check" && values?.until) lines.push(make("p", t("valid.until", { until: day(values.until) }), { "data-validity": "" }));
  const key = `next.${text}`;
  if (known(key)) {
    const line = make("p", null, { class: "next" });
    line.append(make("strong", t("next")), " ", t(key));
    lines.push(line);
  }
  return lines;
}
