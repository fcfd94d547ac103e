// Number formats in the browser's locale.

import { locale } from "/texts.js";

const POINT = (1.5).toLocaleString(locale)[1];

/** Fixed decimals, with a minus sign (not a hyphen) and no negative zero. */
export function fixed(value, digits = 3) {
  const text = Math.abs(value).toFixed(digits).replace(".", POINT);
  return value < 0 && /[1-9]/.test(text) ? "−" + text : text;
}

/** The same with a sign, except zero. */
export function signed(value, digits = 3) {
  const text = fixed(value, digits);
  return value > 0 && /[1-9]/.test(text) ? "+" + text : text;
}

/** A number with so many significant digits, as the reports have them. */
export function significant(value, digits) {
  const size = Math.floor(Math.log10(Math.abs(value)));
  return Number.isFinite(size) ? fixed(value, Math.max(0, digits - 1 - size)) : fixed(value, digits - 1);
}

/** A count with thousands separators. */
export const count = (value) => value.toLocaleString(locale);

/** Minutes of a plan, in the format of `dbbd plan`. */
export const minutes = (s) => fixed(s / 60, 1);

/** Time of day. */
export const timeOfDay = (ms) => new Date(ms).toLocaleTimeString(locale);

/** Elapsed time, to the second. */
export function clock(s) {
  const [h, m] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return `${h ? h + " h " : ""}${h || m ? m + " min " : ""}${Math.floor(s % 60)} s`;
}

/** Date and time. */
export const dateAndTime = (ms) => new Date(ms).toLocaleString(locale);

/** A date `YYYY-MM-DD`. */
export const day = (date) => new Date(date).toLocaleDateString(locale, { dateStyle: "medium", timeZone: "UTC" });

/** @type {[Intl.RelativeTimeFormatUnit, number][]} */
const STEPS = [["year", 31_557_600], ["month", 2_629_800], ["day", 86_400], ["hour", 3600], ["minute", 60], ["second", 1]];

/** How long ago, as "3 days ago". */
export function age(ms) {
  const s = Math.max(0, (Date.now() - ms) / 1000);
  const [unit, length] = STEPS.find(([, length]) => s >= length) ?? STEPS.at(-1);
  return new Intl.RelativeTimeFormat(locale, { numeric: "auto" }).format(-Math.floor(s / length), unit);
}
