// A typed number: its text becomes a number in the unit of its field, or the key of a text that says why it is none.

/** What may be typed behind a number in a field of a unit, each with the power of ten that converts it. @type {Record<string, Record<string, number>>} */
const UNITS = {
  "": {},
  mm: { mm: 0, µm: -3, um: -3, cm: 1, m: 3 },
  µm: { µm: 0, um: 0, mm: 3 },
  "°": { "°": 0, deg: 0 },
  "°C": { "°C": 0, C: 0 },
  "1/K": { "1/K": 0, "/K": 0 },
};
/** Beyond it a number does not hold each whole one; nothing here is so large, and no message shows so many digits. */
const MAX_SIZE = 2 ** 53;
const NUMBER = /^([+\-−]?)(\d+(?:[.,]\d+)?|[.,]\d+)(?:e([+\-−]?\d+))?\s*(.*)$/i;

/** What a field takes: its unit ("" for none), whether it may be empty, whether only whole numbers, how many numbers if it is a list, and
 * the range in that unit.
 * @typedef {{ unit: string, optional?: boolean, whole?: boolean, count?: number, range?: { low: number, high: number, aboveLow?: boolean } }} NumberField */

/**
 * Reads the text of a field; an empty one is null.
 * @param {string} text
 * @param {NumberField} field
 * @returns {{ value?: number | number[] | null, reason?: string }}
 */
export function parseNumber(text, field) {
  if (!text.trim()) return field.optional ? { value: null } : { reason: "wrong.missing" };
  if (!field.count) return one(text.trim(), field);
  const all = text.trim().split(text.includes(";") ? ";" : /\s+/).map((part) => one(part.trim(), field));
  if (all.length !== field.count) return { reason: "wrong.count" };
  const wrong = all.find(({ reason }) => reason);
  return wrong ?? { value: all.map(({ value }) => value) };
}

/** @param {string} text @param {NumberField} field @returns {{ value?: number, reason?: string }} */
function one(text, { unit, whole, range }) {
  // A keyboard has either of the two signs for micro.
  const parts = NUMBER.exec(text.replace("μ", "µ"));
  if (!parts) return { reason: "wrong.number" };
  const [, sign, digits, exponent = "0", typed] = parts;
  const powers = UNITS[unit];
  if (typed && !Object.hasOwn(powers, typed)) {
    if (/^[.,'’]?\d/.test(typed)) return { reason: "wrong.ambiguous" };
    if (!/^[\p{L}°/]/u.test(typed)) return { reason: "wrong.number" };
    return { reason: unit ? "wrong.unit" : "wrong.no_unit" };
  }
  // In "2e-11/K" the last 1 may be of the exponent or of the unit.
  if (typed === "/K" && /(^|\d)1\/K$/.test(text)) return { reason: "wrong.ambiguous" };
  const ascii = (part) => part.replace("−", "-");
  // The power of ten is written, not multiplied: no digit changes.
  const power = Number(ascii(exponent)) + (typed ? powers[typed] : 0);
  const value = Number(`${ascii(sign)}${digits.replace(",", ".")}e${power}`);
  // Too large for a number, or so small that it would become nothing.
  if (!Number.isFinite(value) || (value === 0 && /[1-9]/.test(digits))) return { reason: "wrong.number" };
  if (Math.abs(value) > MAX_SIZE) return { reason: "wrong.large" };
  if (whole && !Number.isInteger(value)) return { reason: "wrong.whole" };
  if (range && (value < range.low || value > range.high || (range.aboveLow && value === range.low))) {
    return { reason: range.aboveLow ? "wrong.range_above" : "wrong.range" };
  }
  // There is no negative zero.
  return { value: value + 0 };
}
