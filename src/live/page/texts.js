// The texts of the page in the language of the browser or the chosen language. One file per language.

const all = await (await fetch("/texts.json")).json();
const wanted = [localStorage.getItem("language"), ...navigator.languages.map((tag) => tag.slice(0, 2)), "en"];

/** The language of the page. */
export const language = wanted.find((tag) => tag in all);

/** The browser's locale of this language: it writes numbers and dates. */
export const locale = navigator.languages.find((tag) => tag.slice(0, 2) === language) ?? language;

/** All languages with their own names. */
export const languages = Object.entries(all).map(([tag, texts]) => [tag, texts.language]);

/** The text of a key, with values for its names in braces. An unknown key is returned unchanged. */
export function t(key, values = {}) {
  const text = all[language][key] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

/** The address of a file that was made: a page opens in the language of this one. @param {string} address */
export const spoken = (address) => (address.endsWith(".html") ? `${address}?lang=${language}` : address);

/** Whether a text exists. */
export const known = (key) => key in all[language];

/** Changes the language of the page. */
export function choose(tag) {
  localStorage.setItem("language", tag);
  location.reload();
}

document.documentElement.lang = language;
/** @type {(selector: string) => NodeListOf<any>} */
const nodes = (selector) => document.querySelectorAll(selector);
for (const node of nodes("[data-text]")) node.textContent = t(node.dataset.text);
for (const node of nodes("[data-label]")) node.setAttribute("aria-label", t(node.dataset.label));
for (const node of nodes("[data-title]")) node.title = t(node.dataset.title);
