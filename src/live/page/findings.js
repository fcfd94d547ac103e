// A finding with its cause and its cure. Those that are not in the language of the page are English, and marked so.

import { make } from "/frame.js";
import { language, t } from "/texts.js";

/** Title and cure by code, in the language of the page. @type {Promise<Record<string, [string, string]>>} */
const codes = language === "en" ? Promise.resolve({}) : fetch("/codes.json").then((answer) => answer.json()).then((all) => all[language] ?? {});

/** @param {any} one @returns {Promise<HTMLElement>} */
export async function finding(one) {
  const [title, cure] = (await codes)[one.code] ?? [];
  const item = make("li", null, { class: one.severity });
  const place = one.file ? `${one.file}${one.line ? `:${one.line}` : ""}: ` : "";
  const english = language === "en" ? undefined : "en";
  item.append(make("strong", `${t(`severity.${one.severity}`)} ${one.code}${title ? `: ${title}` : ""}`), " ", make("span", place + one.text, { lang: english }));
  const paragraph = (key, text, lang) => {
    if (!text) return;
    const line = make("p", `${t(`finding.${key}`)}: `, { class: "small" });
    line.append(make("span", text, { lang }));
    item.append(line);
  };
  paragraph("help", one.help, english);
  // Where the title is translated, it says what happened; the English cause would repeat it.
  if (!title) paragraph("cause", one.cause, english);
  paragraph("cure", cure ?? one.cure, cure ? undefined : english);
  return item;
}
