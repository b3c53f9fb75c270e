// Sign-in and commands. Each command needs two clicks: the first asks for confirmation.

import { $, html, keyed, say, set } from "./dom.js";
import { ask, post, token } from "./server.js";

const ASK_MS = 3000;
const ARMED_MS = 5000;
const APART_MS = 300; // a double click counts as one click

export const me = { mayOrder: false, mayRead: true, isThere: false };

// Calls `changed()` when the user or the access rights have changed.
export async function startPeople(changed) {
  $("#sign-in").addEventListener("click", () => $("#who").showModal());
  $("#sign-out").addEventListener("click", () => signIn(null, changed));
  $("#use-token").addEventListener("click", () => signIn($("#token").value.trim(), changed));
  $("#token").addEventListener("keydown", (event) => event.key === "Enter" && signIn($("#token").value.trim(), changed));
  setInterval(() => look(changed), ASK_MS);
  await look(changed);
  changed();
}

async function signIn(value, changed) {
  token.set(value);
  $("#token").value = "";
  say($("#who-trouble"), "");
  me.name = undefined;
  await look(changed);
  if (me.name) $("#who").close();
  else if (value) say($("#who-trouble"), "no valid token");
}

async function look(changed) {
  const answer = await ask("/me.json");
  if (!answer?.ok) return; // no connection: the stream reports it
  const told = await answer.json();
  const before = JSON.stringify(me);
  const revoked = me.name && !told.name && token.get();
  if (revoked) say($("#person"), `the token of ${me.name} is no longer valid: sign in again`);
  else say($("#person"), told.name ? `${told.name}, ${told.role}` : revokedWords());
  Object.assign(me, {
    name: told.name,
    mayOrder: told.may_order,
    mayRead: Boolean(told.name) || !told.token_to_read,
    isThere: told.people,
  });
  set($("#person"), { class: revoked || (!told.name && revokedWords()) ? "lost" : "" });
  $("#sign-in").hidden = !me.isThere || Boolean(me.name);
  $("#sign-out").hidden = !me.name;
  if (before !== JSON.stringify(me)) changed();
}

// The message remains until a user signs in.
const revokedWords = () => (token.get() ? $("#person").textContent : "");

const ALL = [
  ["recall all", { do: "recall" }],
  ["hold all", { do: "hold" }],
  ["release all", { do: "release" }],
];

// Commands available for the selection.
export function drawDeeds(picture, selected) {
  const panel = $("#deeds");
  panel.hidden = !me.mayOrder;
  if (panel.hidden) return;
  const deeds = [...deedsOf(picture, selected), ...ALL];
  keyed($("#deed-buttons"), deeds.map(([words, deed]) => [words, deed]), button, () => {});
}

function deedsOf(picture, selected) {
  const order = picture.orders?.[selected];
  if (picture.drones?.[selected])
    return ["recall", "hold", "release"].map((what) => [`${what} ${selected}`, { do: what, vehicle: selected }]);
  if (!order) return [];
  const confirm = order.state === "assigned" ? [[`launch ${selected}`, { do: "confirm", order: selected }]] : [];
  const ends = ["assigned", "stuck"].includes(order.state) ? ["delivered", "lost", "back"] : [];
  return [...confirm, ...ends.map((settled) => [`settle ${selected}: ${settled}`, { do: "settle", order: selected, settled }])];
}

function button(words, deed) {
  const made = html("button", { type: "button" }, words);
  let armedMs = -Infinity;
  const disarm = () => {
    armedMs = -Infinity;
    set(made, { class: "" });
    say(made, words);
  };
  made.addEventListener("click", () => {
    const nowMs = performance.now();
    if (nowMs - armedMs < APART_MS) return;
    if (nowMs - armedMs < ARMED_MS) {
      disarm();
      order(words, deed);
      return;
    }
    armedMs = nowMs;
    set(made, { class: "armed" });
    say(made, `${words}? click again`);
    setTimeout(() => performance.now() - armedMs >= ARMED_MS && disarm(), ARMED_MS + 50);
  });
  return made;
}

async function order(words, deed) {
  const reason = $("#reason").value.trim();
  const needs = ["hold", "settle"].includes(deed.do);
  if (needs && !reason) return told(words, ["enter a reason first"], "lost");
  told(words, ["..."], "");
  const answer = await post("/deeds", needs ? { ...deed, reason } : deed);
  if (answer === null) return told(words, ["NO CONNECTION: result unknown"], "lost");
  if (answer.status === 401) return told(words, ["refused: the token is no longer valid"], "lost");
  const found = await answer.json().catch(() => ({ trouble: `error ${answer.status}` }));
  if (!answer.ok) return told(words, [`refused: ${found.trouble}`], "lost");
  if (needs) $("#reason").value = "";
  told(words, [...found.look, ...found.words], found.look.length ? "lost" : "");
}

function told(words, answers, kind) {
  set($("#deed-answer"), { class: kind });
  say($("#deed-answer"), `${words}: ${answers.join("; ") || "done"}`);
}
