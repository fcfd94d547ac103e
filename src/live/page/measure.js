// The step Measure: reads the stream, shows the state, connects, starts and stops.

import { $, afterSignIn, attempt, quietly, say, turnTheme } from "/frame.js";
import { known, t } from "/texts.js";
import { ask, hear } from "/link.js";
import { may } from "/users.js";
import { SPEEDS } from "/sentence.js";
import { clock, count, fixed, minutes, signed } from "/numbers.js";
import * as gauge from "/gauge.js";
import * as mounting from "/mounting.js";
import * as polar from "/polar.js";
import * as trace from "/trace.js";
import * as runs from "/runs.js";

let status = null;
let plans = [];
let lost = 0;
let named = false;
let seenState = null;
// Whether to connect to the bar again after the run.
let connected = false;
// The run whose bar was reported as mounted.
let mountedIn = null;
// Why what is shown is old: the service cannot be reached, the bar is away.
let stale = { down: false, away: false };

function set(id, text, bad = false) {
  if ($(id).textContent !== text) $(id).textContent = text;
  $(id).classList.toggle("bad", bad);
}

function clockText(run) {
  if (run.device_s === null) return t("run.clock_host");
  const ahead = run.clock_ahead_ms ?? 0;
  return t("run.clock_bar", { ahead: Math.abs(ahead) < 1000 ? `${signed(ahead, 1)} ms` : `${signed(ahead / 1000, 0)} s` });
}

/** Whether the bar is away. */
const isAway = (now) => !!(now?.run ?? now?.reading)?.gone;

/** @param {{ down?: boolean, away?: boolean }} changed */
function showStale(changed) {
  const now = { ...stale, ...changed };
  if (now.away && !stale.away) gauge.beep(880);
  stale = now;
  document.body.classList.toggle("stale", now.down || now.away);
  set("link", now.down ? t("link.down") : "");
  set("away", now.away ? t("alarm.away") : "");
}

function stateText(now) {
  if (isAway(now)) return t("state.gone");
  if (now.reading) return t("state.reading");
  if (now.state === "no_device") {
    const { port } = now.device;
    return `${t("state.no_device")}: ${port ? t("state.port_away", { port }) : t("state.no_port")}`;
  }
  return t(`state.${now.state}`) + (now.state === "failed" && now.reason ? `: ${now.reason}` : "");
}

function ending(text) {
  return known(`ending.${text}`) ? t(`ending.${text}`) : text;
}

function showNext(run) {
  const { next, left_s } = run;
  set("time-left", left_s === null ? "–" : t("run.left_value", { time: clock(left_s) }));
  if (next) {
    const angle = next.angle_deg === null ? null : fixed(next.angle_deg, 0);
    set("next", angle === null ? t("run.next_value", { index: next.index }) : t("run.next_angle", { index: next.index, circle: next.circle, angle }));
  } else {
    set("next", run.poses ? t("run.next_none") : "–");
  }
}

function showRun(run) {
  $("poses").max = run.poses || 1;
  $("poses").value = run.poses ? Math.min(run.dwells, run.poses) : 0;
  set("poses-text", run.poses ? t("run.poses", { done: run.dwells, all: run.poses }) : t("run.dwells", { done: run.dwells }));
  showNext(run);
  set("elapsed", clock(run.elapsed_s));
  set("samples", count(run.samples));
  set("rate", t("run.rate_value", { hz: fixed(run.rate_hz, 0) }), run.elapsed_s > 3 && run.rate_hz === 0);
  const losses = [[run.missing, "run.missing"], [run.lost_bytes, "run.lost"]].filter(([n]) => n);
  set("gaps", [count(run.gaps), ...losses.map(([n, key]) => t(key, { count: n }))].join(", "), losses.length > 0);
  const silent = run.elapsed_s > 3 && run.bytes === 0;
  const strange = run.bytes > 1000 && !run.in_step && !run.rejected;
  const trouble = silent ? t("run.silent") : strange ? t("run.strange") : "";
  const counts = [[run.faults, null], [run.rejected, "run.refused"], [run.unanswered, "run.unanswered"]].filter(([n]) => n);
  set("faults", trouble || counts.map(([n, key]) => (key ? t(key, { count: n }) : String(n))).join(", ") || "0", !!trouble || run.faults > 0);
  set("clock", clockText(run));
  set("delivery", lost ? t("run.delivery_lost", { count: lost }) : t("run.delivery_whole"), lost > 0);
}

function archiveText({ confirmed, waiting, refused, reason }) {
  const state = t("archive.state", { confirmed: count(confirmed), spooled: count(waiting - refused), refused: count(refused) });
  return reason ? `${state}. ${reason}` : state;
}

function showStatus(now) {
  const before = status;
  status = now;
  const { run, reading, last } = now;
  $("state").dataset.state = isAway(now) ? "gone" : now.state;
  showStale({ away: isAway(now) });
  $("simulated").hidden = !(run ?? reading)?.simulated;
  set("state", stateText(now));
  set("version", t("version", { version: now.version }));
  gauge.setup(run ?? reading);
  mounting.show((run ?? reading)?.mounting);
  document.body.dataset.run = run ? "on" : "off";
  $("mark").disabled = !run;
  $("stop").hidden = !run || !may("measure");
  for (const id of ["connect", "disconnect", "zero"]) $(id).disabled = !may("measure");
  // Before the first pose the program halts for the bar.
  $("at-halt").hidden = !run || run.dwells > 0 || mountedIn === run.name;
  $("connect").hidden = !!run || !!reading;
  $("disconnect").hidden = !reading;
  $("zero").hidden = !reading?.can_zero;
  permit();
  set("run-name", run ? run.name : last ? t("run.over", { name: last.name }) : t("run.none"));
  set("run-plan", run?.plan ? t("run.plan", { plan: run.plan, robot: run.robot ?? "–" }) : "");
  const over = last && t("run.last", { name: last.name, samples: count(last.samples), ending: ending(last.ending) });
  set("last", over || "", last?.failed);
  set("archive", now.archive ? archiveText(now.archive) : "", now.archive?.waiting > 0);
  if (run) showRun(run);
  if (before?.run && !run && connected) quietly(connect);
  if (before?.run?.plan !== run?.plan) expect(expectation.plan, expectation.list);
  if (now.state !== seenState) {
    seenState = now.state;
    runs.refresh().catch(() => {});
  }
  if (!named && !run) {
    const d = new Date();
    const two = (n) => String(n).padStart(2, "0");
    $("name").value = `run-${d.getFullYear()}${two(d.getMonth() + 1)}${two(d.getDate())}-${two(d.getHours())}${two(d.getMinutes())}${two(d.getSeconds())}`;
    named = true;
  }
  choosePort();
  window.dispatchEvent(new CustomEvent("dbbd:status", { detail: now }));
}

/** @returns {any[]} */
const checks = () => [...document.querySelectorAll("#checks input")];

// The start button is enabled when the check list is complete.
function permit() {
  const ready = checks().every((box) => box.checked);
  $("start").disabled = !!status?.run || !ready || !may("measure");
  $("start-hint").hidden = !!status?.run || ready;
}

function showPlan() {
  const plan = plans.find((one) => one.name === $("plan").value);
  const values = plan && { robot: plan.robot ?? "–", length: fixed(plan.bar_length_mm, 1), circles: plan.circles, poses: plan.poses, minutes: minutes(plan.duration_s) };
  set("plan-for", plan ? t("plan.for", values) : t("plan.none_hint"));
}

async function connect() {
  await ask("POST", "/reading", { plan: $("plan").value || null, speed: speed() });
  connected = true;
}

/** Whether the next run of this page reads a simulated cell; the bar of the service stays as it is. */
let simulates = false;

/** The speed of the simulated cell; null for a real one. */
const speed = () => (simulates || status?.device.port === "sim" ? Number($("speed").value) : null);

function choosePort() {
  const { port, protocol } = status.device;
  if (port && ![...$("port").options].some((o) => o.value === port)) $("port").add(new Option(port, port));
  if (document.activeElement !== $("port")) $("port").value = simulates ? "sim" : (port ?? "");
  $("sim-speed").hidden = speed() === null;
  if (protocol && ![...$("protocol").options].some((o) => o.value === protocol)) $("protocol").add(new Option(protocol, protocol));
  if (document.activeElement !== $("protocol")) $("protocol").value = protocol ?? "";
}

async function lists() {
  const [all, { ports }, { protocols }] = await Promise.all(["/plans", "/ports", "/protocols"].map((p) => ask("GET", p)));
  plans = all.plans;
  const chosen = $("plan").value;
  const text = ({ name, error, poses, duration_s }) => (error ? t("plan.unusable", { name }) : t("plan.option", { name, poses, minutes: minutes(duration_s) }));
  $("plan").replaceChildren(new Option(t("plan.none"), ""), ...plans.map((p) => new Option(text(p), p.name)));
  [...$("plan").options].forEach((o, i) => (o.disabled = i > 0 && !!plans[i - 1].error));
  $("plan").value = chosen || plans.find((p) => !p.error)?.name || "";
  $("port").replaceChildren(new Option(t("port.none"), ""), new Option(t("port.sim"), "sim"), ...ports.map((p) => new Option(`${p.by_id ?? p.port} ${p.description}`, p.by_id ?? p.port)));
  $("protocol").replaceChildren(new Option(t("protocol.plan"), ""), ...protocols.map((p) => new Option(p.title, p.id)));
  showPlan();
  if (status) choosePort();
}

const greet = () => quietly(() => Promise.all([lists(), runs.refresh(), runs.refreshJobs()]));

const reopen = hear({
  status: showStatus,
  frame(frame) {
    const shown = status?.run ?? status?.reading;
    gauge.show(frame, shown);
    trace.add(frame, shown);
  },
  point: polar.add,
  points: polar.all,
  trace: trace.all,
  mounting: mounting.add,
  begin() {
    gauge.begin();
    polar.begin();
    trace.begin();
    mounting.begin();
    lost = 0;
    named = false;
  },
  job(job) {
    runs.show(job);
    window.dispatchEvent(new CustomEvent("dbbd:job", { detail: job }));
  },
  lost(what) {
    lost += what.messages;
    // The lost messages may include points.
    ask("GET", "/points").then(({ points }) => polar.all(points), () => {});
  },
  up() {
    showStale({ down: false });
    greet();
    window.dispatchEvent(new Event("dbbd:up"));
  },
  down() {
    showStale({ down: true });
    // A refusal opens the sign-in.
    ask("GET", "/status").catch(() => {});
  },
});

runs.start(say);
async function begin(checked) {
  // A simulated cell ends with its program.
  connected = !!status?.reading && speed() === null;
  await ask("POST", "/run", { name: $("name").value, plan: $("plan").value || null, checked, speed: speed() });
  // Each run has a new check list.
  checks().forEach((box) => (box.checked = false));
  permit();
}

$("start-form").addEventListener("submit", (event) => {
  event.preventDefault();
  attempt(() => begin(checks().filter((box) => box.checked).map((box) => box.value)));
});
$("mounted").addEventListener("click", () =>
  attempt(async () => {
    await ask("POST", "/act", { act: "bar_mounted" });
    mountedIn = status?.run?.name ?? null;
    $("at-halt").hidden = true;
  }),
);
$("mark-form").addEventListener("submit", (event) => {
  event.preventDefault();
  attempt(async () => {
    await ask("POST", "/run/mark", { text: $("remark").value });
    $("remark").value = "";
    say(t("remark.written"));
  });
});
$("stop").addEventListener("click", () => $("confirm").showModal());
$("confirm").addEventListener("close", () => {
  if ($("confirm").returnValue === "yes") attempt(() => ask("POST", "/run/stop"));
  $("confirm").returnValue = "";
});
$("checks").addEventListener("change", permit);
$("plan").addEventListener("change", () => {
  showPlan();
  // Shows the stroke of the plan.
  if (status?.reading) attempt(connect);
});
$("connect").addEventListener("click", () => attempt(connect));
$("disconnect").addEventListener("click", () => {
  connected = false;
  attempt(() => ask("DELETE", "/reading"));
});
$("zero").addEventListener("click", () =>
  attempt(async () => {
    await ask("POST", "/reading/zero");
    say(t("zeroed"));
  }),
);
for (const id of ["port", "protocol"]) {
  $(id).addEventListener("change", () => {
    if (id === "port") simulates = $(id).value === "sim";
    choosePort();
    if ($(id).value && $(id).value !== "sim") attempt(() => ask("PUT", "/device", { [id]: $(id).value }));
  });
}
afterSignIn(reopen);
window.addEventListener("dbbd:user", () => (status ? showStatus(status) : permit()));
$("speed").replaceChildren(...SPEEDS.map((one) => new Option(t("speed.value", { speed: one }), String(one), false, one === 20)));
$("live").addEventListener("toggle", () => window.dispatchEvent(new Event("resize")));
permit();
document.addEventListener("keydown", (/** @type {any} */ event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
  const keys = { m: () => $("remark").focus(), "+": () => polar.magnify(-1), "-": () => polar.magnify(1), 0: () => polar.magnify(null), d: turnTheme };
  const act = keys[event.key.toLowerCase()];
  if (act) {
    event.preventDefault();
    act();
  }
});

let expectation = { plan: "", list: [] };

/** What an identified robot shows at the rows of a plan. @param {string} plan @param {any[]} list */
export function expect(plan, list) {
  expectation = { plan, list };
  polar.expect(status?.run && status.run.plan !== plan ? [] : list);
}

/** The state of the service as the stream gave it last; null before. */
export const now = () => status;

/** Chooses a plan and shows the live part. @param {string} plan */
export function open(plan) {
  $("live").open = true;
  if (plan && [...$("plan").options].some((one) => one.value === plan)) $("plan").value = plan;
  showPlan();
}

/** Reads the lists again: a plan was made. */
export const refreshLists = () => lists();

/** Connects to the bar. */
export { connect };

/** Chooses a simulated cell for the next run of this page, at a speed or at the one that is chosen. @param {number} [value] */
export function simulate(value) {
  if (value) $("speed").value = String(value);
  simulates = true;
  choosePort();
}

/** The bar of the simulated cell is mounted: its program goes on, and the run begins. */
export const confirmHalt = () => begin(["bar_mounted"]);

/** The first item of the check list that is open; null if the run may start. @returns {any} */
export const openCheck = () => checks().find((box) => !box.checked) ?? null;

/** Starts the run of the form. */
export const startRun = () => $("start-form").requestSubmit();
