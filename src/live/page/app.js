// The page: it reads the stream, shows the state, starts and stops.

import { ask, hear } from "/link.js";
import { clock, count, fixed, minutes, signed } from "/numbers.js";
import * as gauge from "/gauge.js";
import * as polar from "/polar.js";
import * as strip from "/strip.js";
import * as runs from "/runs.js";

const $ = (id) => document.getElementById(id);
const STATES = { no_device: "no device", idle: "ready", running: "running", failed: "failed" };

let status = null;
let lost = 0;
let named = false;
let seenState = null;

function say(text) {
  $("message").textContent = text;
}

function set(id, text, bad = false) {
  if ($(id).textContent !== text) $(id).textContent = text;
  $(id).classList.toggle("bad", bad);
}

function clockText(run) {
  if (run.device_s === null) return "of the host (the bar has none, or nothing came yet)";
  const ahead = run.clock_ahead_ms ?? 0;
  const text = Math.abs(ahead) < 1000 ? `${signed(ahead, 1)} ms` : `${signed(ahead / 1000, 0)} s`;
  return `of the bar, ${text} against the host`;
}

function showStatus(now) {
  status = now;
  const run = now.run;
  const gone = run?.gone ?? false;
  $("state").dataset.state = gone ? "gone" : now.state;
  set("state", gone ? "the port is away, waiting for it" : STATES[now.state] + (now.reason ? ": " + now.reason : ""));
  document.title = run ? `${run.name} · dbbd` : "dbbd";
  set("version", "version " + now.version);
  gauge.setup(run);
  $("stop").disabled = $("mark").disabled = !run;
  $("start").disabled = !!run;
  set("run-name", run ? run.name : now.last ? `${now.last.name} (over)` : "none");
  set("run-plan", run?.plan ? `by the plan “${run.plan}”` : "");
  set("last", now.last ? `Last run: ${now.last.name}, ${count(now.last.samples)} samples; ${now.last.ending}.` : "", now.last?.failed);
  if (run) {
    $("poses").max = run.poses || 1;
    $("poses").value = run.poses ? Math.min(run.dwells, run.poses) : 0;
    set("poses-text", run.poses ? `${run.dwells} of ${run.poses} poses` : `${run.dwells} dwells; no plan`);
    set("elapsed", clock(run.elapsed_s));
    set("samples", count(run.samples));
    set("rate", `${fixed(run.rate_hz, 0)} a second`, run.elapsed_s > 3 && run.rate_hz === 0);
    const losses = run.missing + run.lost_bytes;
    set("gaps", `${run.gaps}${run.missing ? `, ${run.missing} samples missing` : ""}${run.lost_bytes ? `, ${run.lost_bytes} bytes lost` : ""}`, losses > 0);
    const silent = run.elapsed_s > 3 && run.bytes === 0;
    const strange = run.bytes > 1000 && !run.in_step && !run.rejected;
    const trouble = silent ? "nothing is received" : strange ? "the data are not of this protocol" : "";
    const counts = [[run.faults, ""], [run.rejected, " refused"], [run.unanswered, " unanswered"]];
    const shown = counts.filter(([count]) => count).map(([count, what]) => count + what).join(", ") || "0";
    set("faults", trouble || shown, !!trouble || run.faults > 0);
    set("clock", clockText(run));
    set("delivery", lost ? `${lost} messages were lost: this connection is slow` : "complete", lost > 0);
  }
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
}

function choosePort() {
  const { port, protocol } = status.device;
  if (port && ![...$("port").options].some((o) => o.value === port)) $("port").add(new Option(port, port));
  if (document.activeElement !== $("port")) $("port").value = port ?? "";
  if (protocol && ![...$("protocol").options].some((o) => o.value === protocol)) $("protocol").add(new Option(protocol, protocol));
  if (document.activeElement !== $("protocol")) $("protocol").value = protocol ?? "";
}

async function lists() {
  const [{ plans }, { ports }, { protocols }] = await Promise.all(["/plans", "/ports", "/protocols"].map((p) => ask("GET", p)));
  const chosen = $("plan").value;
  const text = (p) => (p.error ? `${p.name} (cannot be used)` : `${p.name}: ${p.poses} poses, ${minutes(p.duration_s)}`);
  $("plan").replaceChildren(new Option("no plan", ""), ...plans.map((p) => new Option(text(p), p.name)));
  [...$("plan").options].forEach((o, i) => (o.disabled = i > 0 && !!plans[i - 1].error));
  $("plan").value = chosen || plans.find((p) => !p.error)?.name || "";
  $("port").replaceChildren(new Option("none", ""), new Option("sim: a simulated cell", "sim"), ...ports.map((p) => new Option(`${p.by_id ?? p.port} ${p.description}`, p.by_id ?? p.port)));
  $("protocol").replaceChildren(new Option("of the plan", ""), ...protocols.map((p) => new Option(p.title, p.id)));
  if (status) choosePort();
}

async function attempt(work) {
  try {
    say("");
    await work();
  } catch (error) {
    if (error.status === 401) askToken();
    else say(error.status ? error.message : "no connection to dbbd");
  }
}

const greet = () => attempt(() => Promise.all([lists(), runs.refresh(), runs.refreshJobs()]));

function askToken() {
  if (!$("ask").open) $("ask").showModal();
}

const reopen = hear({
  status: showStatus,
  frame(frame) {
    gauge.show(frame, status?.run);
    strip.add(frame, status?.run);
  },
  point: polar.add,
  points: polar.all,
  begin() {
    gauge.begin();
    polar.begin();
    strip.begin();
    lost = 0;
    named = false;
  },
  job: runs.show,
  lost(what) {
    lost += what.messages;
    // Points may be among what was lost.
    ask("GET", "/points").then(({ points }) => polar.all(points), () => {});
  },
  up() {
    document.body.classList.remove("stale");
    set("link", "");
    greet();
  },
  down() {
    document.body.classList.add("stale");
    set("link", "no connection: the values are old");
    ask("GET", "/status").catch((error) => error.status === 401 && askToken());
  },
});

runs.start(say);
$("start-form").addEventListener("submit", (event) => {
  event.preventDefault();
  attempt(() => ask("POST", "/run", { name: $("name").value, plan: $("plan").value || null }));
});
$("mark-form").addEventListener("submit", (event) => {
  event.preventDefault();
  attempt(async () => {
    await ask("POST", "/run/mark", { text: $("remark").value });
    $("remark").value = "";
    say("The remark was written.");
  });
});
$("stop").addEventListener("click", () => attempt(() => ask("POST", "/run/stop")));
for (const id of ["port", "protocol"]) {
  $(id).addEventListener("change", () => $(id).value && attempt(() => ask("PUT", "/device", { [id]: $(id).value })));
}
$("token-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  try {
    await ask("POST", "/session", { token: $("token").value });
    $("token").value = "";
    $("ask").close();
    reopen();
  } catch (error) {
    set("wrong", error.message);
  }
});

function theme(dark) {
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  $("theme").textContent = dark ? "Light" : "Dark";
}
function turnTheme() {
  const dark = document.documentElement.dataset.theme !== "dark";
  localStorage.setItem("theme", dark ? "dark" : "light");
  theme(dark);
}
const kept = localStorage.getItem("theme");
theme(kept ? kept === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
$("theme").addEventListener("click", turnTheme);
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
  const keys = { m: () => $("remark").focus(), "+": () => polar.magnify(-1), "-": () => polar.magnify(1), 0: () => polar.magnify(null), d: turnTheme };
  const act = keys[event.key.toLowerCase()];
  if (act) {
    event.preventDefault();
    act();
  }
});
