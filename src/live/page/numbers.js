// Numbers as a reader wants them, everywhere on the page.

/** With fixed decimals, a true minus sign and no minus zero. */
export function fixed(value, digits = 3) {
  const text = Math.abs(value).toFixed(digits);
  return value < 0 && Number(text) !== 0 ? "−" + text : text;
}

/** The same with its sign; zero has none. */
export function signed(value, digits = 3) {
  const text = fixed(value, digits);
  return value > 0 && Number(text) !== 0 ? "+" + text : text;
}

/** A count, in thousands. */
export const count = (value) => value.toLocaleString("en");

/** How long a plan takes, as `dbbd plan` says it. */
export const minutes = (s) => `${fixed(s / 60, 1)} min`;

/** A time that goes on, to the second. */
export function clock(s) {
  const [h, m] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return `${h ? h + " h " : ""}${h || m ? m + " min " : ""}${Math.floor(s % 60)} s`;
}
