// What all pages share: theme, language, sign-in, messages, and the making of elements.

import { ask } from "/link.js";
import { choose, language, languages, t } from "/texts.js";

/** An element of the page by its id; every page has those that its script names. @type {(id: string) => any} */
export const $ = (id) => document.getElementById(id);

/**
 * An element with a text (null: none) and attributes; undefined attributes are left out.
 * @param {string} name
 * @param {string | null} text
 * @param {Record<string, string | undefined>} [attributes]
 * @returns {any}
 */
export function make(name, text, attributes = {}) {
  const node = document.createElement(name);
  if (text !== null) node.textContent = text;
  for (const [key, value] of Object.entries(attributes)) if (value !== undefined) node.setAttribute(key, value);
  return node;
}

/** Shows a message; an empty one clears it. The service speaks English. @param {string} text @param {string} [lang] */
export function say(text, lang = language) {
  $("message").lang = lang;
  $("message").textContent = text;
}

/** Does something, and shows why it cannot be done. @param {() => Promise<unknown>} work */
async function show(work) {
  try {
    await work();
    return true;
  } catch (error) {
    // A 401 opens the sign-in; a wrong field shows its reason itself.
    if (error.status === 401 || error.shown) return false;
    if (error.status) say(error.message, "en");
    else say(error instanceof TypeError ? t("link.none") : String(error));
    return false;
  }
}

/** Does what the user asked for: what was said before is over. @param {() => Promise<unknown>} work */
export async function attempt(work) {
  say("");
  await show(work);
}

/** What the page said last without being asked. */
let unasked = "";

/** Does what nobody asked for: an answer to the user stays, and its own complaint goes when it succeeds. @param {() => Promise<unknown>} work */
export async function quietly(work) {
  const before = $("message").textContent;
  if (await show(work)) {
    if (unasked && $("message").textContent === unasked) say("");
    unasked = "";
  } else if ($("message").textContent !== before) {
    unasked = $("message").textContent;
  }
}

/** @type {(() => void)[]} */
const entered = [];

/** Calls a function after each sign-in. @param {() => void} work */
export const afterSignIn = (work) => entered.push(work);

// The first request without a token, also that of the stream, opens the sign-in.
window.addEventListener("dbbd:sign-in", () => {
  if (!$("ask").open) $("ask").showModal();
});
$("token-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  try {
    await ask("POST", "/session", { token: $("token").value });
    $("token").value = "";
    $("wrong").textContent = "";
    $("ask").close();
    for (const work of entered) work();
  } catch (error) {
    $("wrong").textContent = error.message;
  }
});

function theme(dark) {
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  $("theme").textContent = t(dark ? "theme.light" : "theme.dark");
}

/** Changes between light and dark. */
export function turnTheme() {
  const dark = document.documentElement.dataset.theme !== "dark";
  localStorage.setItem("theme", dark ? "dark" : "light");
  theme(dark);
  window.dispatchEvent(new Event("dbbd:theme"));
}
const kept = localStorage.getItem("theme");
theme(kept ? kept === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
$("theme").addEventListener("click", turnTheme);
$("language").replaceChildren(...languages.map(([tag, name]) => new Option(name, tag, false, tag === language)));
$("language").addEventListener("change", () => choose($("language").value));
