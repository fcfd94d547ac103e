// Number formats in the language of the page.

import { language } from "/texts.js";

const POINT = (1.5).toLocaleString(language)[1];

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

/** A count with thousands separators. */
export const count = (value) => value.toLocaleString(language);

/** Minutes of a plan, in the format of `dbbd plan`. */
export const minutes = (s) => fixed(s / 60, 1);

/** Time of day. */
export const timeOfDay = (ms) => new Date(ms).toLocaleTimeString(language);

/** Elapsed time, to the second. */
export function clock(s) {
  const [h, m] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return `${h ? h + " h " : ""}${h || m ? m + " min " : ""}${Math.floor(s % 60)} s`;
}
