// Who is signed in, what the role allows, and what users changed.

import { $, afterSignIn, attempt, make, quietly } from "/frame.js";
import { ask } from "/link.js";
import { dateAndTime } from "/numbers.js";
import { known, t } from "/texts.js";

const ROLES = ["look", "measure", "plan"];
/** @type {{ name: string | null, role: string }} */
let user = { name: null, role: "plan" };

/** Whether the user may do what a role may. @param {"look" | "measure" | "plan"} role */
export const may = (role) => ROLES.indexOf(user.role) >= ROLES.indexOf(role);

async function refresh() {
  user = await ask("GET", "/session");
  document.body.dataset.role = user.role;
  $("user").textContent = user.name === null ? "" : t("user.signed_in", { name: user.name, role: t(`role.${user.role}`) });
  $("sign-out").hidden = user.name === null;
  window.dispatchEvent(new Event("dbbd:user"));
}

async function events() {
  if (!$("events").open) return;
  const { events: all } = await ask("GET", "/events");
  const line = (one) => {
    const item = make("li", null);
    const act = known(`event.${one.act}`) ? t(`event.${one.act}`) : one.act;
    item.append(make("strong", one.user ?? t("user.owner")), " ", make("span", act), " ", make("span", dateAndTime(one.unix_ms), { class: "small" }), " ", make("code", one.path.replace("/api/v1", ""), { class: "small" }));
    return item;
  };
  $("event-list").replaceChildren(...(all.length ? all.map(line) : [make("li", t("events.none"))]));
}

$("events").addEventListener("toggle", () => attempt(events));
$("sign-out").addEventListener("click", () =>
  attempt(async () => {
    await ask("DELETE", "/session");
    location.reload();
  }),
);
window.addEventListener("dbbd:changed", () => quietly(events));
afterSignIn(() => quietly(refresh));
quietly(refresh);
