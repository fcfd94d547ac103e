// Numbers as a reader wants them, everywhere on the page, in the page's language.

import { language } from "/texts.js";

const POINT = (1.5).toLocaleString(language)[1];

/** With fixed decimals, a true minus sign and no minus zero. */
export function fixed(value, digits = 3) {
  const text = Math.abs(value).toFixed(digits).replace(".", POINT);
  return value < 0 && /[1-9]/.test(text) ? "−" + text : text;
}

/** The same with its sign; zero has none. */
export function signed(value, digits = 3) {
  const text = fixed(value, digits);
  return value > 0 && /[1-9]/.test(text) ? "+" + text : text;
}

/** A count, in thousands. */
export const count = (value) => value.toLocaleString(language);

/** Minutes of a plan, as `dbbd plan` gives them. */
export const minutes = (s) => fixed(s / 60, 1);

/** A time of the day. */
export const timeOfDay = (ms) => new Date(ms).toLocaleTimeString(language);

/** A time that goes on, to the second. */
export function clock(s) {
  const [h, m] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return `${h ? h + " h " : ""}${h || m ? m + " min " : ""}${Math.floor(s % 60)} s`;
}
