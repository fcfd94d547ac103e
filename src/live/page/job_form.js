// The form of a job: what is typed becomes keys of job.toml; the service checks them as the command line does.

import { make } from "/frame.js";
import { ask } from "/link.js";
import { t } from "/texts.js";

/** @typedef {any[]} Field name, how it is read, whether it may be empty, and what a new job begins with */

const BAR = [
  ["length_mm", "number", false, "300"],
  ["stroke_low_mm", "number", false, "-5"],
  ["stroke_high_mm", "number", false, "5"],
  ["margin_mm", "number", true, "0.5"],
  ["sigma_um", "number", true, "2"],
  ["length_u_mm", "number", true, ""],
  ["temperature_c", "number", true, ""],
  ["expansion_per_k", "number", true, ""],
  ["serial", "text", true, ""],
  ["certificate", "text", true, ""],
  ["certified_on", "text", true, ""],
  ["certified_by", "text", true, ""],
];
const BALL = [
  ["x_mm", "number", false, "1300"],
  ["y_mm", "number", false, "0"],
  ["z_mm", "number", false, "800"],
];
const CIRCLE = [
  ["centre", "number", false, "1"],
  ["plane", ["XY", "XZ", "YZ"], false, "XY"],
  ["points", "number", false, "40"],
  ["orientation", ["seed", "fixed", "random", "turning", "optimal"], true, "seed"],
  ["amplitude_deg", "number", true, "25"],
  ["tilt_deg", "number", true, "30"],
  ["start_deg", "number", true, "0"],
  ["arc_deg", "number", true, "360"],
];
const NEW_CIRCLES = [
  { centre: 1, plane: "XY", points: 40, orientation: "seed", amplitude_deg: 25, tilt_deg: 30 },
  { centre: 1, plane: "XZ", points: 40, orientation: "seed", amplitude_deg: 25, tilt_deg: 30, start_deg: -18, arc_deg: 216 },
  { centre: 1, plane: "YZ", points: 40, orientation: "seed", amplitude_deg: 25, tilt_deg: 30, start_deg: -18, arc_deg: 216 },
];

let made = 0;

/** A labelled field. @param {Field} of */
function field(of, value) {
  const [name, kind] = of;
  const id = `f${++made}`;
  const label = make("label", null, { for: id });
  label.append(make("span", t(`field.${name}`)));
  let input;
  if (Array.isArray(kind)) {
    input = make("select", null, { id });
    // A value of a hand-written job that the form does not offer stays.
    const all = value && !kind.includes(value) ? [...kind, value] : kind;
    input.append(...all.map((one) => new Option(one, one, false, one === value)));
  } else {
    input = make("input", null, { id, type: "text", autocomplete: "off", inputmode: kind === "number" ? "decimal" : undefined });
    input.value = value ?? "";
  }
  input.dataset.name = name;
  label.append(input);
  return label;
}

function wrong(input, text) {
  input.setAttribute("aria-invalid", "true");
  input.focus();
  throw new Error(text);
}

/** The value of a field; null if it is empty. @param {any} parent @param {Field} of */
function value(parent, of) {
  const [name, kind, optional] = of;
  const input = parent.querySelector(`[data-name="${name}"]`);
  input.removeAttribute("aria-invalid");
  const text = input.value.trim();
  if (!text) return optional ? null : wrong(input, t("form.missing", { field: t(`field.${name}`) }));
  if (kind !== "number") return text;
  const number = Number(text.replace(",", "."));
  return Number.isFinite(number) ? number : wrong(input, t("form.number", { field: t(`field.${name}`) }));
}

/** A list of rows that can be added and removed. */
function list(title, fields, rows) {
  const set = make("fieldset", null, { class: "list" });
  set.append(make("legend", t(title)));
  const all = make("div", null);
  const add = (row) => {
    const line = make("div", null, { class: "fields line", role: "group", "aria-label": t(title) });
    line.append(...fields.map((one) => field(one, row ? row[one[0]] : one[3])));
    const remove = make("button", t("form.remove"), { type: "button" });
    remove.addEventListener("click", () => line.remove());
    line.append(remove);
    all.append(line);
  };
  rows.forEach(add);
  const more = make("button", t("form.add"), { type: "button" });
  more.addEventListener("click", () => add(null));
  set.append(all, more);
  return { set, values: () => [...all.children].map((line) => Object.fromEntries(fields.map((one) => [one[0], value(line, one)]))) };
}

/**
 * Fills a form with a job, or with that of a new robot.
 * @param {HTMLFormElement} form
 * @param {{ job: any, save: (name: string | null, keys: any) => Promise<void> }} options
 */
export async function jobForm(form, { job, save }) {
  const [{ robots }, { protocols }] = await Promise.all([ask("GET", "/robots"), ask("GET", "/protocols")]);
  const bar = job?.bar;
  const head = make("div", null, { class: "fields" });
  const nameField = ["name", "text", false];
  const robotField = ["robot", robots, false];
  const serialField = ["serial", "text", true];
  const protocolField = ["protocol", protocols.map((one) => one.id), true];
  if (!job) head.append(field(nameField, "robot-1"));
  head.append(field(robotField, job?.robot ?? "kr60ha"), field(serialField, job?.serial));
  const barSet = make("fieldset", null, { class: "list" });
  const barFields = make("div", null, { class: "fields" });
  const ofBar = (name, initial) => {
    if (!bar) return initial;
    if (name === "stroke_low_mm") return bar.stroke_mm[0];
    return name === "stroke_high_mm" ? bar.stroke_mm[1] : bar[name];
  };
  barFields.append(...BAR.map((one) => field(one, ofBar(one[0], one[3]))), field(protocolField, bar?.protocol ?? "dbb-cobs-1"));
  barSet.append(make("legend", t("form.bar")), barFields);
  const ballRow = (ball) => ({ x_mm: ball.xyz_mm[0], y_mm: ball.xyz_mm[1], z_mm: ball.xyz_mm[2] });
  const balls = list("form.balls", BALL, job ? job.centre.map(ballRow) : [ballRow({ xyz_mm: [1300, 0, 800] })]);
  const circles = list("form.circles", CIRCLE, job ? (job.circle ?? []) : NEW_CIRCLES);
  const problem = make("p", "", { role: "alert", class: "problem" });
  const submit = make("button", t(job ? "form.save" : "form.create"), { class: "main", "data-action": "save" });
  form.replaceChildren(head, barSet, balls.set, circles.set, problem, submit);
  form.onsubmit = async (event) => {
    event.preventDefault();
    problem.textContent = "";
    try {
      const inBar = Object.fromEntries(BAR.map((one) => [one[0], value(barFields, one)]));
      const { stroke_low_mm, stroke_high_mm, ...rest } = inBar;
      const keys = {
        robot: value(head, robotField),
        serial: value(head, serialField),
        bar: { ...rest, stroke_mm: [stroke_low_mm, stroke_high_mm], protocol: value(barFields, protocolField) },
        centre: balls.values().map(({ x_mm, y_mm, z_mm }, at) => ({ id: at + 1, xyz_mm: [x_mm, y_mm, z_mm] })),
        circle: circles.values(),
      };
      if (!job) keys.obstacle = [{ shape: "floor", z_mm: 0 }];
      await save(job ? null : value(head, nameField), keys);
    } catch (error) {
      problem.textContent = error.message;
    }
  };
}
