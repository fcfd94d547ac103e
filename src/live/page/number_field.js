// A field for typed numbers: it gives them in its unit, or says beside itself what is wrong, and nothing is sent.

import { make } from "/frame.js";
import { parseNumber } from "/number_text.js";
import { t } from "/texts.js";

/** Takes away what was said beside a field. @param {any} input */
export function right(input) {
  input.removeAttribute("aria-invalid");
  input.removeAttribute("aria-describedby");
  document.getElementById(`${input.id}-wrong`)?.remove();
}

/** Says beside a field why it is wrong, and throws. @param {any} input @param {string} text @param {string} [lang] @returns {never} */
export function wrong(input, text, lang) {
  right(input);
  const id = `${input.id}-wrong`;
  // Beside the label: in it, the text would be part of the field's name.
  input.closest("label").after(make("span", text, { id, role: "alert", class: "problem", lang }));
  input.setAttribute("aria-invalid", "true");
  input.setAttribute("aria-describedby", id);
  input.addEventListener("input", () => right(input), { once: true });
  input.focus();
  input.scrollIntoView({ block: "center" });
  throw Object.assign(new Error(text), { shown: true });
}

/**
 * The number of a field, or its list of numbers; null if it is empty and may be. Throws if it is wrong.
 * @param {any} input
 * @param {import("./number_text.js").NumberField} field
 * @returns {any}
 */
export function readNumber(input, field) {
  const { value, reason } = parseNumber(input.value, field);
  const { unit, count, range } = field;
  if (reason) wrong(input, t(reason, { unit, count, low: range?.low, high: range && `${range.high} ${unit}`.trim() }));
  right(input);
  return value;
}
