// The form of a job: what is typed becomes keys of job.toml; the service checks them as the command line does. What is not saved yet
// outlives a reload of the page.

import { make } from "/frame.js";
import { changedKeys, freeId } from "/job_changes.js";
import { ask } from "/link.js";
import { readNumber, right, wrong } from "/number_field.js";
import { t } from "/texts.js";

/**
 * A field with a unit is for numbers, one without for a text or one of its choices. Its key in the job is its name, or place `at` of
 * the list `key`.
 * @typedef {{ name: string, unit?: string, whole?: boolean, range?: { low: number, high: number }, count?: number, choices?: string[], optional?: boolean, key?: string, at?: number }} Field
 */

/** @type {Field[]} */
const BAR = [
  { name: "length_mm", unit: "mm" },
  { name: "stroke_low_mm", unit: "mm", key: "stroke_mm", at: 0 },
  { name: "stroke_high_mm", unit: "mm", key: "stroke_mm", at: 1 },
  { name: "margin_mm", unit: "mm", optional: true },
  { name: "sigma_um", unit: "µm", optional: true },
  { name: "length_u_mm", unit: "mm", optional: true },
  { name: "temperature_c", unit: "°C", optional: true },
  { name: "expansion_per_k", unit: "1/K", optional: true },
  { name: "serial", optional: true },
  { name: "certificate", optional: true },
  { name: "certified_on", optional: true },
  { name: "certified_by", optional: true },
];
/** @type {Field[]} */
const TOOL = [
  { name: "tool_x_mm", unit: "mm", key: "ball_mm", at: 0 },
  { name: "tool_y_mm", unit: "mm", key: "ball_mm", at: 1 },
  { name: "tool_z_mm", unit: "mm", key: "ball_mm", at: 2 },
  { name: "ball_u_mm", unit: "mm", optional: true },
];
/** @type {Field[]} */
const BALL = [
  { name: "x_mm", unit: "mm", key: "xyz_mm", at: 0 },
  { name: "y_mm", unit: "mm", key: "xyz_mm", at: 1 },
  { name: "z_mm", unit: "mm", key: "xyz_mm", at: 2 },
  { name: "taught_deg", unit: "°", count: 6, optional: true },
];
/** What the points of a circle can be: fewer are no circle, and a dwell has a number of one byte. */
const POINTS = { low: 3, high: 255 };
/** @type {Field[]} */
const CIRCLE = [
  { name: "centre", unit: "", whole: true, optional: true },
  { name: "plane", choices: ["XY", "XZ", "YZ"], optional: true },
  { name: "points", unit: "", whole: true, range: POINTS },
  { name: "orientation", choices: ["seed", "fixed", "random", "turning", "optimal"], optional: true },
  { name: "amplitude_deg", unit: "°", optional: true },
  { name: "tilt_deg", unit: "°", optional: true },
  { name: "start_deg", unit: "°", optional: true },
  { name: "arc_deg", unit: "°", optional: true },
];
const NEW_BALL = { xyz_mm: [1300, 0, 800] };
const NEW_CIRCLE = { centre: 1, plane: "XY", points: 40, orientation: "seed", amplitude_deg: 25, tilt_deg: 30, start_deg: 0, arc_deg: 360 };
/** Where the tool ball is, nobody but the user knows. */
const NEW_JOB = {
  name: "robot-1",
  robot: "kr60ha",
  bar: { length_mm: 300, stroke_mm: [-5, 5], margin_mm: 0.5, sigma_um: 2, protocol: "dbb-cobs-1" },
  centre: [NEW_BALL],
  circle: [NEW_CIRCLE, { ...NEW_CIRCLE, plane: "XZ", start_deg: -18, arc_deg: 216 }, { ...NEW_CIRCLE, plane: "YZ", start_deg: -18, arc_deg: 216 }],
};

let made = 0;
/** Whether the form has what is not saved. */
let unsaved = false;
window.addEventListener("beforeunload", (event) => unsaved && event.preventDefault());

/** What a field shows of a table of the job. @param {Field} of @param {any} table */
function shown({ name, key = name, at }, table) {
  const value = at === undefined ? table?.[key] : table?.[key]?.[at];
  return Array.isArray(value) ? value.join("; ") : String(value ?? "");
}

/** @param {Field[]} fields @param {any} table @returns {Record<string, string>} */
const textsOf = (fields, table) => Object.fromEntries(fields.map((one) => [one.name, shown(one, table)]));

/** A field in its label. @param {Field} of @param {string} text */
function field({ name, unit, count, choices, optional }, text) {
  const id = `f${++made}`;
  const label = make("label", null, { for: id });
  label.append(make("span", t(`field.${name}`)));
  let input;
  if (choices) {
    input = make("select", null, { id });
    // What a hand-written job has besides the choices stays, and so does a key that it does not have.
    const all = new Set([...(optional ? [""] : []), ...choices, text]);
    input.append(...[...all].map((one) => new Option(one || "–", one, false, one === text)));
  } else {
    input = make("input", null, { id, type: "text", autocomplete: "off", inputmode: unit === undefined || count ? undefined : "decimal" });
    input.defaultValue = text;
  }
  input.dataset.name = name;
  label.append(input);
  return { label, input };
}

/** The value of a field; null if it is empty and may be. @param {any} input @param {Field} of */
function value(input, { unit, whole, range, count, optional }) {
  if (unit !== undefined) return readNumber(input, { unit, whole, range, count, optional });
  right(input);
  const text = input.value.trim();
  if (!text && !optional) wrong(input, t("wrong.missing"));
  return text || null;
}

/** The fields of a table of the job, or of a row of a list. @param {Field[]} fields @param {Record<string, string>} texts */
function group(fields, texts) {
  const all = fields.map((of) => ({ of, ...field(of, texts[of.name]) }));
  return {
    labels: all.map(({ label }) => label),
    input: (name) => all.find(({ of }) => of.name === name).input,
    of: (wanted) => all.filter(({ of: { name, key = name } }) => key === wanted).map(({ input }) => input),
    typed: () => Object.fromEntries(all.map(({ of, input }) => [of.name, input.value])),
    keys() {
      /** @type {any} */
      const keys = {};
      for (const { of, input } of all) {
        const { name, key = name, at } = of;
        if (at === undefined) keys[key] = value(input, of);
        else (keys[key] ??= [])[at] = value(input, of);
      }
      // An optional list is there as a whole, or not at all.
      for (const { of, input } of all) {
        const numbers = of.at === undefined ? null : keys[of.key ?? of.name];
        if (!numbers) continue;
        if (numbers.every((number) => number === null)) keys[of.key ?? of.name] = null;
        else if (numbers[of.at] === null) wrong(input, t("wrong.missing"));
      }
      return keys;
    },
  };
}

/** @param {string} title @param {any[]} nodes */
function fieldset(title, ...nodes) {
  const set = make("fieldset", null, { class: "list" });
  set.append(make("legend", t(title)), ...nodes);
  return set;
}

/** @param {Node[]} labels */
function grid(labels) {
  const all = make("div", null, { class: "fields" });
  all.append(...labels);
  return all;
}

/**
 * Rows that can be added and removed. A row of the file has `row`, its index there; a base ball has its id.
 * @typedef {{ row?: number, id?: number, typed: Record<string, string> }} Row
 * @param {string} title
 * @param {Field[]} fields
 * @param {Row[]} rows
 * @param {(ids: number[]) => Row} another
 * @param {() => void} changed
 */
function list(title, fields, rows, another, changed) {
  let lines = [];
  const all = make("div", null);
  /** @param {Row} of */
  const add = ({ row, id, typed }) => {
    const of = group(fields, typed);
    const name = id === undefined ? t(title) : `${t("scene.ball")} ${id}`;
    const node = make("div", null, { class: "fields line", role: "group", "aria-label": name });
    const remove = make("button", t("form.remove"), { type: "button" });
    node.append(id === undefined ? "" : make("strong", name), ...of.labels, remove);
    const line = { row, id, ...of };
    remove.addEventListener("click", () => {
      lines = lines.filter((one) => one !== line);
      node.remove();
      changed();
    });
    lines.push(line);
    all.append(node);
  };
  rows.forEach(add);
  const ids = () => lines.map(({ id }) => id);
  const more = make("button", t("form.add"), { type: "button" });
  more.addEventListener("click", () => {
    add(another(ids()));
    changed();
  });
  return {
    set: fieldset(title, all, more),
    ids,
    lines: () => lines,
    typed: () => lines.map(({ row, id, typed }) => ({ row, id, typed: typed() })),
    keys: () => lines.map(({ row, id, keys }) => ({ row, id, ...keys() })),
  };
}

/**
 * Fills a form with a job that was read, or with a new one. A robot that is new has no name yet. `send` gets the keys that were
 * changed, `saved` what follows.
 * @param {HTMLFormElement} form
 * @param {{ robot: string | null, job: any, sha256: string | null, send: (keys: any, name: string) => Promise<void>, saved: (name: string) => unknown }} options
 */
export async function jobForm(form, { robot, job, sha256, send, saved }) {
  const [{ robots }, { protocols }] = await Promise.all([ask("GET", "/robots"), ask("GET", "/protocols")]);
  /** @type {Field[]} */
  const headFields = [...(robot ? [] : [{ name: "name" }]), { name: "robot", choices: robots }, { name: "serial", optional: true }];
  /** @type {Field[]} */
  const barFields = [...BAR, { name: "protocol", choices: protocols.map((one) => one.id), optional: true }];
  // The tool ball of a job that has none is in its robot file.
  /** @type {Field[]} */
  const toolFields = job && !job.tool?.ball_mm ? TOOL.map((one) => ({ ...one, optional: true })) : TOOL;
  const first = job ?? NEW_JOB;
  const row = (at) => (job ? at : undefined);
  const begin = {
    head: textsOf(headFields, first),
    bar: textsOf(barFields, first.bar),
    tool: textsOf(TOOL, first.tool),
    centre: (first.centre ?? []).map((ball, at) => ({ row: row(at), id: ball.id ?? at + 1, typed: textsOf(BALL, ball) })),
    circle: (first.circle ?? []).map((circle, at) => ({ row: row(at), id: undefined, typed: textsOf(CIRCLE, circle) })),
  };
  const store = `job-form:${robot ?? ""}`;
  const kept = JSON.parse(sessionStorage.getItem(store));
  unsaved = !!kept && kept.sha256 === sha256;
  if (kept && !unsaved) sessionStorage.removeItem(store);
  const now = unsaved ? kept.typed : begin;

  const head = group(headFields, now.head);
  const bar = group(barFields, now.bar);
  const tool = group(toolFields, now.tool);
  const keep = () => {
    const typed = { head: head.typed(), bar: bar.typed(), tool: tool.typed(), centre: balls.typed(), circle: circles.typed() };
    unsaved = JSON.stringify(typed) !== JSON.stringify(begin);
    if (unsaved) sessionStorage.setItem(store, JSON.stringify({ sha256, typed }));
    else sessionStorage.removeItem(store);
  };
  const balls = list("form.balls", BALL, now.centre, (ids) => ({ id: freeId(ids), typed: textsOf(BALL, NEW_BALL) }), keep);
  const circles = list("form.circles", CIRCLE, now.circle, () => ({ typed: textsOf(CIRCLE, NEW_CIRCLE) }), keep);
  const problem = make("p", "", { role: "alert", class: "problem", lang: "en" });
  const before = make("p", unsaved ? t("form.unsaved") : kept ? t("form.outdated") : "", { role: "status", class: "note" });
  const note = make("p", "", { role: "status", class: "note" });
  const submit = make("button", t(job ? "form.save" : "form.create"), { class: "main", "data-action": "save" });
  const hint = make("p", t("form.hint"), { class: "small" });
  form.replaceChildren(
    before, grid(head.labels), fieldset("form.bar", grid(bar.labels)), fieldset("form.tool", hint, grid(tool.labels)), balls.set, circles.set, problem, note, submit,
  );
  const forget = () => {
    unsaved = false;
    before.textContent = "";
    sessionStorage.removeItem(store);
  };
  /** The field of the key that a refusal begins with; of several one that was changed. @param {string} text */
  const refused = (text) => {
    const [, circle, key] = /^(?:circle (\d+): )?(\w+)(?: in \w+)? = /.exec(text) ?? [];
    const groups = [head, bar, tool, ...balls.lines(), ...(circle ? circles.lines().slice(Number(circle) - 1, Number(circle)) : circles.lines())];
    const inputs = groups.flatMap((group) => group.of(key));
    return inputs.find((input) => input.value !== input.defaultValue) ?? inputs[0];
  };
  form.oninput = keep;
  form.onsubmit = async (event) => {
    event.preventDefault();
    problem.textContent = "";
    note.textContent = "";
    try {
      const { name, ...top } = head.keys();
      const typed = { ...top, bar: bar.keys(), tool: tool.keys(), centre: balls.keys(), circle: circles.keys() };
      typed.circle.forEach(({ centre }, at) => {
        const ball = centre ?? 1;
        if (!balls.ids().includes(ball)) wrong(circles.lines()[at].input("centre"), t("wrong.ball", { ball }));
      });
      const keys = changedKeys(job ?? {}, typed);
      if (!job) keys.obstacle = [{ shape: "floor", z_mm: 0 }];
      if (Object.keys(keys).length) {
        await send(keys, name);
        forget();
        await saved(name);
      } else {
        forget();
        note.textContent = t("form.unchanged");
      }
    } catch (error) {
      if (error.shown) return;
      // The service speaks English, and names the key that it refuses: its field has the message.
      const input = refused(error.message);
      if (!input) return (problem.textContent = error.message);
      try {
        wrong(input, error.message, "en");
      } catch {
        // It is said.
      }
    }
  };
}
