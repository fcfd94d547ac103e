// The texts of the page in the language of the browser, or in the one that was chosen: one file for each language.

const all = await (await fetch("/texts.json")).json();
const wanted = [localStorage.getItem("language"), ...navigator.languages.map((tag) => tag.slice(0, 2)), "en"];

/** The language of the page. */
export const language = wanted.find((tag) => tag in all);

/** All languages, each with its own name. */
export const languages = Object.entries(all).map(([tag, texts]) => [tag, texts.language]);

/** The text of a key, with values for its names in braces; an unknown key is shown as it is. */
export function t(key, values = {}) {
  const text = all[language][key] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => values[name] ?? "");
}

/** Whether there is such a text. */
export const known = (key) => key in all[language];

/** The page of another language. */
export function choose(tag) {
  localStorage.setItem("language", tag);
  location.reload();
}

document.documentElement.lang = language;
for (const node of document.querySelectorAll("[data-text]")) node.textContent = t(node.dataset.text);
for (const node of document.querySelectorAll("[data-label]")) node.setAttribute("aria-label", t(node.dataset.label));
for (const node of document.querySelectorAll("[data-title]")) node.title = t(node.dataset.title);
