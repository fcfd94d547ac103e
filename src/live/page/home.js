// The first page: the robots of the working directory with their last decisions; a new robot; the demo.

import { $, afterSignIn, attempt, make, quietly } from "/frame.js";
import { jobForm } from "/job_form.js";
import { ask } from "/link.js";
import { age } from "/numbers.js";
import { SPEEDS, verdictLine } from "/sentence.js";
import { t } from "/texts.js";
import { may } from "/users.js";

/** @param {any} robot */
function row(robot) {
  const item = make("li", null);
  const link = make("a", robot.name, { href: `/robot/${encodeURIComponent(robot.name)}`, class: "name" });
  const about = make("p", [robot.robot, robot.simulated_readings && t("simulated.result")].filter(Boolean).join(" · "), { class: "small" });
  const decision = verdictLine(robot);
  decision.prepend(make("span", `${t(`step.${robot.step}`)}: `));
  const when = robot.changed_unix_ms ? make("p", age(robot.changed_unix_ms), { class: "small" }) : "";
  item.append(link, about, decision, when);
  return item;
}

async function refresh() {
  const { robots } = await ask("GET", "/workbench");
  $("robots").replaceChildren(...robots.map(row));
  $("empty").hidden = robots.length > 0;
}

$("speed").replaceChildren(...SPEEDS.map((speed) => new Option(t("speed.value", { speed }), String(speed), false, speed === 20)));
$("demo").addEventListener("click", () =>
  attempt(async () => {
    const { name } = await ask("POST", "/demo", {});
    // The page of the robot goes on by itself until the program halts.
    sessionStorage.setItem("demo", JSON.stringify({ name, speed: Number($("speed").value) }));
    location.href = `/robot/${name}`;
  }),
);
$("new").addEventListener("click", () =>
  attempt(async () => {
    const form = $("new-form");
    const open = (is) => {
      form.hidden = !is;
      $("new").setAttribute("aria-expanded", String(is));
    };
    if (!form.hidden) return open(false);
    await jobForm(form, {
      robot: null,
      job: null,
      sha256: null,
      send: (keys, name) => ask("POST", "/workbench", { name, job: keys }),
      saved: (name) => (location.href = `/robot/${encodeURIComponent(name)}`),
    });
    // Not before: what is typed into the old fields would be lost.
    open(true);
  }),
);
window.addEventListener("dbbd:user", () => {
  for (const id of ["new", "demo"]) $(id).disabled = !may("plan");
});
afterSignIn(() => quietly(refresh));
window.addEventListener("focus", () => quietly(refresh));
quietly(refresh);
