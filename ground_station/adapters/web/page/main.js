// Main module of the page: draws the server's data and handles user input.

import { $, remembering, say, set } from "./dom.js";
import { Past } from "./past.js";
import { drawDeeds, me, startPeople } from "./people.js";
import { ask as askServer } from "./server.js";
import { clock, moment } from "./words.js";
import { listen } from "./stream.js";
import { View } from "./view.js";
import { Drawing } from "./draw.js";
import { drawLists } from "./lists.js";
import { drawDetail } from "./detail.js";
import { bindKeys } from "./keys.js";

const ASK_MS = 2000; // interval for the selected drone's history and reachable area
const SIGN_IN = "sign in to see the fleet";
const QUIET_MS = 4000; // the server sends at least once per second

const seen = { picture: {}, aheadUs: 0, heardMs: null, selected: decodeURIComponent(location.hash.slice(1)) || null };
const when = remembering();
let [fitted, waiting, reachWanted, basemap, past] = [false, false, true, null, null];

const nowUs = () => seen.pastUs ?? Date.now() * 1000 + seen.aheadUs;

function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    const second = Math.floor(nowUs() / 1e6);
    const shared = { ...seen, select, nowUs: nowUs(), reach: reachWanted ? seen.reach : null };
    when("clock", [second, seen.heardMs === null], sayTime);
    drawing.draw(seen.picture, shared);
    drawLists(seen.picture, shared);
    when("detail", [seen.picture.drones?.[seen.selected], seen.picture.orders?.[seen.selected], seen.selected, seen.history, second], () =>
      drawDetail(seen.picture, shared));
    when("deeds", [seen.picture.drones?.[seen.selected]?.phase, seen.picture.orders?.[seen.selected]?.state, seen.selected, me.mayOrder], () =>
      drawDeeds(seen.picture, seen.selected));
    when("basemap", [basemap, view.x, view.y, view.zoom, view.width, view.height], () => basemap?.follow());
  });
}

// Shows the displayed time in header and time bar.
function sayTime() {
  if (seen.heardMs === null) return;
  say($("#clock"), clock(nowUs()));
  if (past) say($("#time-words"), moment(nowUs()));
}

function select(name) {
  seen.selected = name;
  seen.history = seen.reach = null;
  history.replaceState(null, "", name ? `#${encodeURIComponent(name)}` : location.pathname);
  ask();
  redraw();
}

async function answer(question) {
  const when = past ? `&t_us=${past.tUs}` : "";
  const found = await askServer(`/${question}.json?vehicle=${encodeURIComponent(seen.selected)}${when}`);
  return found?.status === 200 ? found.json() : null; // 204: unknown
}

async function ask() {
  const asked = seen.selected;
  if (!seen.picture.drones?.[asked]) return;
  const [promise, reach] = await Promise.all([answer("history"), answer("reach")]);
  if (asked !== seen.selected) return;
  [seen.history, seen.reach] = [promise, reach];
  redraw();
}

function places() {
  const { site = {}, orders = {}, drones = {}, plan } = seen.picture;
  const lists = [orders, drones, plan?.stops ?? {}].flatMap((table) => Object.values(table).map((one) => one.at));
  return [site.depot, ...Object.values(site.rally ?? {}), ...lists].filter(Boolean);
}

function fit() {
  view.fit(places());
}

function centre() {
  const { drones, orders } = seen.picture;
  const at = (drones?.[seen.selected] ?? orders?.[seen.selected])?.at;
  if (at) view.centre(at);
}

function stepThrough(names, by) {
  if (!names.length) return;
  const at = names.indexOf(seen.selected);
  select(names[(at + by + names.length) % names.length]);
  centre();
}

const dark = () => document.documentElement.dataset.theme === "dark"
  || (!document.documentElement.dataset.theme && matchMedia("(prefers-color-scheme: dark)").matches);

function theme() {
  const root = document.documentElement;
  const after = { undefined: "dark", dark: "light", light: undefined }[root.dataset.theme];
  if (after) root.dataset.theme = after;
  else delete root.dataset.theme;
  basemap?.paint(dark());
}

async function showBasemap() {
  const { openBasemap } = await import("./basemap.js");
  basemap = await openBasemap(view, dark());
  redraw();
}

async function showOutline() {
  const { openOutline } = await import("./outline.js");
  basemap = await openOutline(view);
  redraw();
}

function showGround({ basemap, outline }) {
  const shown = basemap ? showBasemap() : outline ? showOutline() : null;
  shown?.catch((error) => say($("#attribution"), `base map: ${error.message}`));
}

function show(picture, serverUs) {
  const first = seen.heardMs === null;
  Object.assign(seen, { picture, aheadUs: serverUs - Date.now() * 1000, heardMs: performance.now() });
  if (!fitted && places().length) [fitted] = [true, fit()];
  if (first) ask();
  if (first) showGround(picture);
  if (!past) picture.desk_alarm ? tell("lost", picture.desk_alarm) : tell("live", "live");
  redraw();
}

function showPast(picture, tUs) {
  seen.pastUs = tUs;
  show(picture, tUs);
  tell("past", "past");
}

function tell(kind, words) {
  set($("#link"), { class: kind });
  say($("#link"), words);
}

function everySecond() {
  const quietMs = seen.heardMs === null ? 0 : performance.now() - seen.heardMs;
  if (!past && me.mayRead && quietMs > QUIET_MS) tell("lost", `NO CONNECTION for ${Math.round(quietMs / 1000)} s: displayed data is outdated`);
  redraw();
}

const view = new View($("#place"), redraw);
const drawing = new Drawing(view, select);
bindKeys({
  view,
  fit,
  centre,
  theme,
  nextDrone: (by) => stepThrough([...document.querySelectorAll("#drones tbody tr")].map((row) => row.dataset.key), by),
  nextAlarm: () => stepThrough([...new Set((seen.picture.attention ?? []).map((one) => one.who))], 1),
  reach: () => { reachWanted = !reachWanted; redraw(); },
  close: () => {
    const open = [$("#help"), $("#who")].find((dialog) => dialog.open);
    if (open) open.close();
    else select(null);
  },
  help: () => $("#help").showModal(),
  past: () => past,
});

let [following, span] = [false, null];

// Starts to show the fleet as soon as the user has read access.
async function follow() {
  redraw();
  if (following) return;
  if (!me.mayRead) {
    tell("lost", SIGN_IN);
    return;
  }
  following = true;
  const lost = () => tell("lost", me.mayRead ? "NO CONNECTION: retrying" : SIGN_IN);
  span ??= await askServer("/span.json");
  if (span?.status === 200) past ??= new Past(await span.json(), showPast, lost);
  else await listen(show, lost, () => tell("lost", SIGN_IN));
  following = Boolean(past);
}

startPeople(follow);
setInterval(everySecond, 1000);
setInterval(ask, ASK_MS);
