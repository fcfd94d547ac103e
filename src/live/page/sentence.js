// The sentence of a step: its verdict by colour, word and shape.

import { make } from "/frame.js";
import { count, fixed } from "/numbers.js";
import { known, t } from "/texts.js";

/** Speeds of a simulated cell: device time per host time. */
export const SPEEDS = [1, 5, 20, 50];

const SHAPES = { pass: "✓", fail: "✕", undecided: "?", none: "•" };

/** Digits after the point of a value by the unit in its name. */
function shown(name, value) {
  if (value === null || value === undefined) return "–";
  if (typeof value !== "number") return String(value);
  if (name.endsWith("_mm")) return fixed(value, 3);
  if (name.endsWith("_um")) return fixed(value, 1);
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

/** @param {"pass" | "fail" | "undecided" | "none"} verdict @param {string} text */
export function verdictLine(verdict, text) {
  const line = make("p", null, { class: "verdict", "data-verdict": verdict });
  line.append(make("span", SHAPES[verdict], { class: "shape", "aria-hidden": "true" }), " ");
  if (verdict !== "none") line.append(make("strong", t(`verdict.${verdict}`)), " ");
  line.append(make("span", text));
  return line;
}
