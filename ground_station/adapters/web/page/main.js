// Main module of the page: draws the server's data and handles user input.

import { $, keyed, html, morph, remembering, say, set } from "./dom.js";
import { drawBoard, drawDriverList, driverCsv, saveFile as saveCsv, setChip, setSearch } from "./board.js";
import { cardOf } from "./card.js";
import { drawDay } from "./day.js";
import { checkSoon, fileChosen, hasForm, importCard, mayAdd, newOrderCard, pin, saveChange, saveFile, saveOrder, setPin, startForm } from "./forms.js";
import { bindKeys } from "./keys.js";
import { Drawing } from "./map.js";
import { droneRow, emptyState, LEVELS, listOrder, mapTools, needsYou, phoneTabs, topBar } from "./panels.js";
import { Past } from "./past.js";
import { command, commandClicked, live, me, signIn, startPeople } from "./people.js";
import { ask as askServer } from "./server.js";
import { listen } from "./stream.js";
import { View } from "./view.js";
import { age, byName, isSilent, moment, seconds } from "./words.js";

const ASK_MS = 2000; // interval for the selected drone's history and reachable area
const TICK_MS = 250;
const QUIET_MS = 3500; // the server sends at least once per second
const WIDE_PX = 1280;
const CARD_PX = 372;
const SIGN_IN = "Sign in to see the fleet";
const FORMS = ["new", "import"];
const DAY_S = 5; // interval of the timeline
const OUT = {};
const NONE = [];

const state = { picture: {}, aheadUs: 0, heardMs: null, heardUs: 0, view: "map", selected: decodeURIComponent(location.hash.slice(1)) || null, asking: null, seen: new Map(), isLost: false, refused: false };
const when = remembering();
let [fitted, waiting, next, reachWanted, basemap, past, warned] = [false, false, 0, true, null, null, new Set()];
const sizes = { day: 0 };
const inView = new Set(); // drones whose row of the list is on the screen

// Without data the time stands still: ages then refer to the last picture.
const nowUs = () => state.pastUs ?? (state.isLost ? state.heardUs : Date.now() * 1000 + state.aheadUs);

// The page is drawn in parts, one per frame: no task of a large fleet then holds up a click.
const PARTS = [drawPanels, drawLists, drawMap, drawLabels];
let due = 0;

function redraw() {
  due = PARTS.length;
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(nextPart);
}

function nextPart() {
  const part = PARTS[next];
  next = (next + 1) % PARTS.length;
  due -= 1;
  waiting = due > 0;
  part(shared());
  if (state.focusOn && $(state.focusOn)) {
    $(state.focusOn).focus();
    state.focusOn = null;
  }
  if (waiting) requestAnimationFrame(nextPart);
}

function shared() {
  const items = state.picture.attention ?? NONE;
  when("alerts", [items], () => { state.alerts = alertsOf(items); });
  const time = nowUs();
  return { ...state, items, select, nowUs: time, second: Math.floor(time / 1e6), isPast: Boolean(past), link: linkOf(), reach: reachOf(time), plainGround: !state.picture.basemap || state.basemapBroken, pin: hasForm() ? pin() : null, covered: coveredBoxes };
}

const isEmpty = ({ orders, drones, plan }) => state.heardMs !== null && !plan && ![orders, drones].some((table) => Object.keys(table ?? {}).length);

function drawPanels(now) {
  const { picture, view: shownView, items, alerts, nowUs: time } = now;
  set(document.body, { class: `view-${shownView} mode-${past ? "replay" : state.isLost || state.refused ? "lost" : isEmpty(picture) ? "empty" : "live"}${picture.basemap && !state.basemapBroken ? " with-basemap" : ""}` });
  Object.assign(live, { now: !state.isLost && !state.refused, past: Boolean(past), desk: alerts.get("desk") !== "warning" });
  drawBand(time);
  morph($("#top"), topBar(picture, now));
  if (past) say($("#time-words"), moment(time));
  morph($("#attention"), needsYou(items, now));
  when("tabs", [shownView, items.length], () => morph($("#tabs"), phoneTabs(shownView, items.length)));
  drawCard(picture, now);
  when("announce", [items], () => announce(items));
  document.title = `${items.length && !past ? `(${items.length}) ` : ""}${picture.fleet ?? "Leeway map"}${past ? ", replay" : ""} - Leeway`;
}

function drawLists(now) {
  const { picture, selected, second, view: shownView } = now;
  when("list", [picture.drones, picture.orders, selected, second, state.isLost, state.scrolled], () => drawList(picture, now));
  $("#board").hidden = !["orders", "driver"].includes(shownView);
  if (shownView === "orders") when("board", [picture.orders, picture.drones, picture.plan, selected, state.searched, me.mayOrder, second], () => drawBoard($("#board"), picture, now));
  if (shownView === "driver") when("driver", [picture.orders, picture.manifest, second], () => drawDriverList($("#board"), picture, now.nowUs));
  when("day", [picture.plan, picture.orders, Math.floor(second / DAY_S), selected, sizes.day, shownView], () => drawDay($("#day"), picture, now, sizes.day));
}

const mapIsShown = () => state.view === "map" || matchMedia("(min-width: 701px)").matches;

function drawMap(now) {
  if (!mapIsShown()) return;
  const { picture, second } = now;
  const empty = isEmpty(picture);
  drawing.draw(picture, now);
  when("tools", [picture.winds, drawing.hidden.size, empty, empty && second], () => morph($("#overlay"), empty ? [emptyState(picture.fleet, age((now.nowUs - state.heardUs) / 1e6))] : mapTools(picture, drawing.hidden)));
  when("basemap", [basemap, view.x, view.y, view.zoom, view.width, view.height], () => basemap?.follow());
}

function drawLabels(now) {
  if (mapIsShown()) drawing.drawLabels(now.picture, now);
}

function alertsOf(items) {
  const found = new Map();
  for (const { who, level } of items) if (!found.has(who) || LEVELS.indexOf(level) < LEVELS.indexOf(found.get(who))) found.set(who, level);
  return found;
}

// Warnings are read out once; an item that was put aside comes back when it gets worse.
function announce(items) {
  const warnings = items.filter((one) => one.level === "warning");
  const fresh = warnings.filter((one) => !warned.has(one.key));
  if (fresh.length && !past) say($("#announce"), fresh.map((one) => one.title).join(". "));
  warned = new Set(warnings.map((one) => one.key));
  for (const key of state.seen.keys()) if (!items.some((one) => one.key === key)) state.seen.delete(key);
}

function linkOf() {
  if (past) return { kind: "past", words: "Replay", more: `${seconds(nowUs())}, not live` };
  if (state.refused) return { kind: "lost", words: SIGN_IN, more: "" };
  if (state.heardMs === null) return { kind: "waiting", words: "Connecting", more: "no data yet" };
  const old = dataAge();
  return state.isLost ? { kind: "lost", words: "No data", more: `for ${age(old)}` } : { kind: "live", words: "Live", more: `${age(old)} old` };
}

const dataAge = () => (performance.now() - state.heardMs) / 1000;

function drawBand(time) {
  const lost = state.isLost && !past && state.heardMs !== null;
  $("#band").hidden = !lost && !past;
  const words = past ? `Replay of ${moment(time).slice(0, -9)}: not live. Nothing on this page moves a drone.` : lost ? `No data for ${Math.round(dataAge())} s. You see ${seconds(state.heardUs)}. Drones fly on under their own rules.` : "";
  say($("#band"), words);
}

function drawList(picture, { nowUs: time, alerts, selected }) {
  const { drones = {}, orders } = picture;
  morph($("#list"), [html("h2", { "data-key": "head" }, "Drones", html("small", {}, "spare energy at landing")), html("ol", { class: "fleet", "data-key": "fleet", "data-own": true })]);
  const second = Math.floor(time / 1e6);
  const make = () => { const row = html("li"); rows.observe(row); return row; };
  keyed($("#list .fleet"), listOrder(drones, alerts).map((name) => [name, inView.has(name) ? drones[name] : OUT]), make, (row, _, name) =>
    morph(row, droneRow(name, drones[name], { orders, nowUs: time, alert: alerts.get(name), selected: name === selected, lowWh: picture.low_spare_wh ?? 10 })),
  (_, name) => `${inView.has(name) && second} ${alerts.get(name)} ${name === selected}`);
}

function drawCard(picture, shared) {
  const { selected } = state;
  const content = selected === "new" && mayAdd() ? newOrderCard() : selected === "import" && mayAdd() ? importCard() : cardOf(picture, shared);
  const card = $("#card");
  card.hidden = !content;
  if (card.dataset.shown !== selected) card.replaceChildren();
  set(card, { "data-shown": selected ?? "" });
  if (content) morph(card, content);
}

// Areas of the map, in its pixels, that panels cover.
function coveredBoxes() {
  const { left, top } = $("#place").getBoundingClientRect();
  const panels = [...document.querySelectorAll("#overlay > *, #scale, #card:not([hidden])")];
  return panels.map((one) => one.getBoundingClientRect()).filter((box) => box.width).map((box) => [box.left - left, box.top - top, box.right - left, box.bottom - top]);
}

// Nothing is known of the reach of a silent drone.
function reachOf(time) {
  const drone = state.picture.drones?.[state.selected];
  return reachWanted && drone && !isSilent(drone, time) && !state.isLost ? state.reach : null;
}

function select(name) {
  Object.assign(state, { selected: name || null, history: null, reach: null, record: null, asking: null });
  if (name === "new") startForm(nextOrderId());
  if (name === "import") startForm("");
  history.replaceState(null, "", name ? `#${encodeURIComponent(name)}` : location.pathname);
  askForSelected();
  redraw();
  if (FORMS.includes(name) || name === "sign-in") state.focusOn = "#card input";
}

function nextOrderId() {
  const last = Object.keys(state.picture.orders ?? {}).sort(byName).at(-1) ?? "T-100";
  return last.replace(/\d+$/, (digits) => String(Number(digits) + 1).padStart(digits.length, "0"));
}

async function answer(question, name, key = "vehicle") {
  const at = past ? `&t_us=${past.tUs}` : "";
  const found = await askServer(`/${question}.json?${key}=${encodeURIComponent(name)}${at}`);
  return found?.status === 200 ? found.json() : null; // 204: unknown
}

async function askForSelected() {
  const asked = state.selected;
  if (state.picture.orders?.[asked] && !past && !state.isLost) {
    const record = await answer("order", asked, "order");
    if (asked === state.selected) Object.assign(state, { record });
    return redraw();
  }
  if (!state.picture.drones?.[asked] || state.isLost) return undefined;
  const [history, reach] = await Promise.all([answer("history", asked), answer("reach", asked)]);
  if (asked !== state.selected) return undefined;
  Object.assign(state, { history, reach });
  return redraw();
}

function places() {
  const { site = {}, orders = {}, drones = {}, plan } = state.picture;
  const lists = [orders, drones, plan?.stops ?? {}].flatMap((table) => Object.values(table).map((one) => one.at));
  return [site.depot, ...Object.values(site.rally ?? {}), ...lists].filter(Boolean);
}

function fit() {
  const narrow = view.width < 500;
  const card = innerWidth > WIDE_PX && !$("#card").hidden ? CARD_PX : 0;
  view.fit(places(), narrow ? [26, 26, 30, 58] : [70, Math.max(80, card), 84, 56]);
}

function centre() {
  const { drones, orders, truck } = state.picture;
  const at = (drones?.[state.selected] ?? orders?.[state.selected] ?? (state.selected === "truck" ? truck : null))?.at;
  if (at) view.centre(at);
}

function stepThrough(names, by) {
  if (!names.length) return;
  const at = names.indexOf(state.selected);
  select(names[at < 0 ? (by > 0 ? 0 : names.length - 1) : (at + by + names.length) % names.length]);
  centre();
}

function mapClicked(at, touch) {
  if (hasForm()) return setPin(view.position(at), redraw);
  const found = drawing.symbolsAt(at, touch);
  if (!found.length) return;
  const next = found[found.indexOf(state.selected) + 1] ?? found[0];
  const members = drawing.members(next);
  if (members) return view.fit(members.map((id) => state.picture.orders[id].at));
  select(next);
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

async function showGround({ basemap: given, outline }) {
  if (!given) say($("#attribution"), "No base map given");
  try {
    if (given) basemap = await (await import("./basemap.js")).openBasemap(view, dark());
    else if (outline) basemap = await (await import("./outline.js")).openOutline(view, "No base map given");
  } catch (error) {
    state.basemapBroken = true;
    say($("#attribution"), `Base map not shown: ${error.message}`);
  }
  redraw();
}

function show(picture, serverUs) {
  const first = state.heardMs === null;
  Object.assign(state, { picture, aheadUs: serverUs - Date.now() * 1000, heardMs: performance.now(), heardUs: serverUs, isLost: false, refused: false });
  if (!fitted && places().length) {
    const now = shared();
    drawPanels(now); // the sizes of the panels first
    drawLists({ ...now, nowUs: nowUs() });
    view.resize();
    [fitted] = [true, fit()];
  }
  if (first) {
    askForSelected();
    showGround(picture);
  }
  redraw();
}

function showPast(picture, tUs) {
  state.pastUs = tUs;
  show(picture, tUs);
}

function setLost() {
  if (!me.mayRead) state.refused = true;
  redraw();
}

function everyTick() {
  if (!past && state.heardMs !== null && performance.now() - state.heardMs > QUIET_MS) state.isLost = true;
  redraw();
}

// Rows out of sight are not kept up to date, and sizes are observed: both would cost a layout per frame.
const rows = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) isIntersecting ? inView.add(target.dataset.key) : inView.delete(target.dataset.key);
  state.scrolled = {};
  redraw();
}, { root: null, rootMargin: "100px" });
new ResizeObserver(([entry]) => { sizes.day = entry.target.clientWidth; redraw(); }).observe($("#day"));
new ResizeObserver(([entry]) => document.documentElement.style.setProperty("--below", `${entry.target.offsetHeight}px`)).observe($("#attention")); // for the card on a small desk

const view = new View($("#place"), redraw);
const drawing = new Drawing(view);
view.clicked = mapClicked;

function launchSelected() {
  const item = (state.picture.attention ?? []).find((one) => one.who === state.selected && one.acts?.some((act) => act.startsWith("launch ")));
  const act = item?.acts.find((one) => one.startsWith("launch "));
  const element = act && command(`Launch ${item.who}`, { do: "confirm", order: act.split(" ")[1] });
  if (element) commandClicked(element);
}

const DEEDS = {
  select,
  show: (name) => { select(name); if (state.view !== "map") DEEDS.view("map"); centre(); },
  view: (name) => { state.view = name; redraw(); },
  close: () => select(null),
  ask: (words) => {
    const [kind, subject, settled] = words.split(" ");
    if (subject && subject !== state.selected) select(subject);
    state.asking = kind ? { kind, subject, settled } : null;
    if (kind === "edit") startForm("");
    redraw();
  },
  seen: (key) => { const item = state.picture.attention.find((one) => one.key === key); state.seen.get(key) === item?.level ? state.seen.delete(key) : state.seen.set(key, item?.level); redraw(); },
  command: async (_, element) => { if (await commandClicked(element) && element.hasAttribute("data-reason")) DEEDS.ask(""); },
  zoom: (kind) => ({ plus: () => view.zoomBy(0.5), minus: () => view.zoomBy(-0.5), fit })[kind](),
  layer: (name) => { drawing.toggle(name); redraw(); },
  chip: (name) => { setChip(name); state.searched = {}; redraw(); },
  "sign-in": async () => { if (await signIn($("#token").value.trim(), follow)) select(null); },
  "sign-out": () => signIn(null, follow),
  "save-order": async () => { const id = await saveOrder(); if (id) select(id); },
  "save-change": async () => { const id = state.asking?.subject; if (id && await saveChange(id)) { state.asking = null; askForSelected(); redraw(); } },
  "save-file": async () => { if (await saveFile()) select(null); },
  print: () => print(),
  csv: () => saveCsv("driver.csv", driverCsv(state.picture, nowUs())),
};

document.addEventListener("click", (event) => {
  const element = event.target.closest?.("[data-do]");
  if (element && !element.disabled) DEEDS[element.dataset.do](element.dataset.with, element);
});
document.addEventListener("submit", (event) => {
  event.preventDefault();
  DEEDS[event.target.dataset.submit]?.();
});
document.addEventListener("input", ({ target }) => {
  if (target.id === "search") { setSearch(target.value); state.searched = {}; redraw(); }
  if (target.hasAttribute("data-check")) checkSoon(redraw);
});
document.addEventListener("change", ({ target }) => { if (target.id === "file" && target.files[0]) fileChosen(target.files[0], redraw); });
document.addEventListener("keydown", (event) => {
  if (event.key === "Enter" && event.target.id === "token") { event.preventDefault(); DEEDS["sign-in"](); }
});

const attended = () => [...new Set((state.picture.attention ?? []).map((one) => one.who))];
bindKeys({
  a: () => stepThrough(attended(), 1),
  Enter: () => { const [first] = attended(); if (!state.selected && first) select(first); },
  l: launchSelected,
  j: () => stepThrough(listOrder(state.picture.drones ?? {}, alertsOf(state.picture.attention ?? [])), 1),
  k: () => stepThrough(listOrder(state.picture.drones ?? {}, alertsOf(state.picture.attention ?? [])), -1),
  "/": () => { DEEDS.view("orders"); state.focusOn = "#search"; },
  n: () => mayAdd() && select("new"),
  1: () => DEEDS.view("map"),
  2: () => DEEDS.view("orders"),
  3: () => DEEDS.view("driver"),
  f: fit,
  c: centre,
  r: () => { reachWanted = !reachWanted; redraw(); },
  t: theme,
  "?": () => select(state.selected === "help" ? null : "help"),
  Escape: () => (state.asking ? DEEDS.ask("") : select(null)),
}, { view, past: () => past });

let [following, spanOf] = [false, null];

// Starts to show the fleet as soon as the user has read access.
async function follow() {
  redraw();
  if (following) return;
  if (!me.mayRead) {
    state.refused = true;
    return;
  }
  following = true;
  spanOf ??= await askServer("/span.json");
  if (spanOf?.status === 200) past ??= new Past(await spanOf.json(), showPast, setLost);
  else await listen(show, setLost, () => { state.refused = true; redraw(); });
  following = Boolean(past);
}

startPeople(follow, redraw);
setInterval(everyTick, TICK_MS);
setInterval(askForSelected, ASK_MS);

