/* The page in the reader's language: that of `?lang=`, which the workbench adds, else the browser's. Its texts are English; those of another
   language are found by the English ones, where a name in braces stands for a value: `n`, `n2` and so on for a number. Prose without a
   text stays English, and is marked so. */
"use strict";
const spoken = (() => {
  const { texts: all, codes } = JSON.parse(document.getElementById("texts").textContent);
  const asked = [new URLSearchParams(location.search).get("lang") ?? "", ...navigator.languages];
  const language = asked.map(tag => tag.slice(0, 2)).find(tag => tag === "en" || tag in all) ?? "en";
  if (language === "en") return text => text;
  const texts = all[language], locale = asked.find(tag => tag.length > 2 && tag.slice(0, 2) === language) ?? language;
  const point = (1.5).toLocaleString(locale)[1];
  const patterns = Object.keys(texts).filter(key => key.includes("{")).map(key => {
    const names = [];
    const value = (_, name) => (names.push(name), /^n\d?$/.test(name) ? "([−+±-]?[\\d.]+(?:e[−+-]?\\d+)?|–)" : "(.+?)");
    return { key, names, form: new RegExp("^" + key.replace(/[.*+?^$()|[\]\\]/g, "\\$&").replace(/\{(\w+)\}/g, value) + "$") };
  });
  /* The patterns that say most come first. */
  const said = ({ key }) => key.replace(/\{\w+\}/g, "").length;
  patterns.sort((one, other) => said(other) - said(one));

  /* Numbers and dates as the locale writes them. */
  function numbers(text) {
    if (/^\d{4}-\d\d-\d\d$/.test(text)) return new Date(text).toLocaleDateString(locale, { dateStyle: "medium", timeZone: "UTC" });
    if (/^\d{4}-\d\d-\d\dT[\d:.]+Z$/.test(text)) return new Date(text).toLocaleString(locale);
    return text.replace(/(\d),(?= [−-]?\d)/g, "$1;").replace(/(^|[^\d.\w])(\d+)\.(\d+)(?![\d.])/g, `$1$2${point}$3`);
  }

  /* Prose has a text of its own; names and numbers are no words. */
  const isProse = value => value.split(" ").filter(word => /^\W*[a-z]{3,}\W*$/i.test(word)).length > 2;

  /* The text in the language; undefined if there is none. */
  function found(text) {
    if (Object.hasOwn(texts, text)) return texts[text];
    for (const { key, names, form } of patterns) {
      const values = form.exec(text)?.slice(1).map(value => found(value) ?? (isProse(value) ? undefined : numbers(value)));
      if (values && !values.includes(undefined)) return texts[key].replace(/\{(\w+)\}/g, (_, name) => values[names.indexOf(name)]);
    }
    /* The name of a file is no word. */
    return /[a-zß-ü]{3}/i.test(text) && !/^\S+\.\w+$/.test(text) ? undefined : numbers(text);
  }
  const inWords = text => found(text) ?? numbers(text);

  const walker = document.createTreeWalker(document.documentElement, NodeFilter.SHOW_TEXT);
  const nodes = [];
  while (walker.nextNode()) nodes.push(walker.currentNode);
  for (const node of nodes) {
    const parent = node.parentElement, text = node.data.trim().replace(/\s+/g, " ");
    if (!text || parent.closest("script, style, code, .mono, [translate=no]")) continue;
    const translated = found(text);
    if (translated !== undefined) node.data = node.data.match(/^\s*/)[0] + translated + node.data.match(/\s*$/)[0];
    else if (!isProse(text)) continue;
    else if (!(parent instanceof HTMLElement) || parent.childNodes.length === 1) parent.setAttribute("lang", "en");
    else {
      const part = document.createElement("span");
      part.lang = "en";
      node.replaceWith(part);
      part.append(node);
    }
  }
  /* A finding says what it is by its code. */
  for (const code of document.querySelectorAll("code.code")) {
    const [title] = codes[language]?.[code.textContent] ?? [];
    if (!title) continue;
    const words = document.createElement("b");
    words.textContent = title + ":";
    code.after(" ", words);
  }
  for (const named of document.querySelectorAll("[aria-label]")) named.setAttribute("aria-label", named.getAttribute("aria-label").split(". ").map(inWords).join(". "));
  document.documentElement.lang = locale;
  return inWords;
})();
