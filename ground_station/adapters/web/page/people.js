// The person at the page, and commands. Each command takes two steps, and names what it moves.

import { $, html, say, set } from "./dom.js";
import { ask, post, token } from "./server.js";

const ASK_MS = 3000;
const ARMED_MS = 5000;
const APART_MS = 300; // a double click counts as one click
const RESULT_MS = 30_000;

export const me = { mayOrder: false, mayRead: true, isThere: false, trouble: "" };
export const live = { now: true, past: false, desk: true }; // without data commands are off; the past has none
const armed = { deed: null, ms: -Infinity };
let [redraw, resultTimer] = [() => {}, 0];

// Without a desk a confirmed launch would wait; a recall goes to the drone itself.
const canSend = (deed) => live.now && (live.desk || deed.do !== "confirm");
export const mayCommand = () => me.mayOrder && !live.past;

// Calls `changed()` when the user or the access rights have changed.
export async function startPeople(changed, draw) {
  redraw = draw;
  setInterval(() => look(changed), ASK_MS);
  await look(changed);
  changed();
}

export async function signIn(value, changed) {
  token.set(value);
  Object.assign(me, { name: undefined, trouble: "" });
  await look(changed);
  if (!me.name && value) me.trouble = "no valid token";
  redraw();
  return Boolean(me.name);
}

async function look(changed) {
  const answer = await ask("/me.json");
  if (!answer?.ok) return; // no connection: the stream reports it
  const told = await answer.json();
  const before = JSON.stringify(me);
  if (me.name && !told.name && token.get()) me.trouble = `the token of ${me.name} is no longer valid: sign in again`;
  if (told.name) me.trouble = "";
  Object.assign(me, { name: told.name, role: told.role, mayOrder: told.may_order, mayRead: Boolean(told.name) || !told.token_to_read, isThere: told.people });
  if (before !== JSON.stringify(me)) changed();
}

// A command of the map: `deed` as POSTed; null for a viewer and in a replay. With `needsReason` the reason
// is read from the form around the button.
export function command(words, deed, kind = "", needsReason = false) {
  if (!mayCommand()) return null;
  const key = JSON.stringify(deed);
  const isArmed = armed.deed === key && performance.now() - armed.ms < ARMED_MS;
  return html("button", { type: "button", class: `deed ${kind}${isArmed ? " armed" : ""}`, "data-do": "command", "data-with": key, "data-words": words, "data-reason": needsReason, disabled: !canSend(deed) },
    isArmed ? `Again to ${words.charAt(0).toLowerCase()}${words.slice(1)}` : words);
}

export async function commandClicked(element) {
  const [key, words] = [element.dataset.with, element.dataset.words];
  const nowMs = performance.now();
  const deed = JSON.parse(key);
  if (!canSend(deed) || !mayCommand()) return;
  if (armed.deed === key && nowMs - armed.ms < APART_MS) return;
  for (const name of ["spare", "pack", "note"]) {
    const value = element.closest("form")?.querySelector(`[name=${name}]`)?.value.trim();
    if (value) deed[name] = value;
  }
  if (element.hasAttribute("data-reason")) {
    deed.reason = reasonOf(element.closest("form"));
    if (!deed.reason) return tell(`${words}: give a reason first`, "lost");
  }
  if (armed.deed !== key || nowMs - armed.ms >= ARMED_MS) {
    Object.assign(armed, { deed: key, ms: nowMs });
    setTimeout(redraw, ARMED_MS + 20);
    return redraw();
  }
  armed.deed = null;
  return send(words, deed);
}

function reasonOf(form) {
  const chosen = form.querySelector("input[type=radio]:checked")?.value ?? "";
  return chosen === "Other" ? form.querySelector("[name=other]").value.trim() : chosen;
}

// Posts a command and shows the result; returns it, or null.
export async function send(words, deed) {
  tell(`${words}: sent, no reply yet`, "");
  const answer = await post("/commands", deed);
  const found = await answer?.json().catch(() => ({ error: `status ${answer.status}` }));
  if (!answer) tell(`${words}: no connection, result unknown`, "lost");
  else if (answer.status === 401) tell(`${words}: refused: the token is no longer valid`, "lost");
  else if (!answer.ok) tell(`${words}: refused: ${found.error}`, "lost");
  else tell(`${words}: ${[...found.checks, ...found.messages].join("; ") || "done"}`, found.checks.length ? "lost" : "");
  redraw();
  return answer?.ok ? found : null;
}

export function tell(words, kind) {
  set($("#result"), { class: kind });
  say($("#result"), words);
  $("#result").hidden = !words;
  clearTimeout(resultTimer);
  if (words) resultTimer = setTimeout(() => tell("", ""), RESULT_MS);
}

// The choice of a reason.
export function reasons(words, choices) {
  return [html("h3", {}, words), html("div", { class: "choices" }, choices.map((one, k) =>
    html("label", {}, html("input", { type: "radio", name: "why", value: one, checked: k === 0 }), one))),
  html("input", { type: "text", name: "other", maxlength: 200, autocomplete: "off", "aria-label": "Other reason", placeholder: "Other reason" })];
}

