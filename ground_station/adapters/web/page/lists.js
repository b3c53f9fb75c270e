// The lists: alarms, drones, truck, upcoming sorties, orders.

import { $, html, keyed, remembering, say, set } from "./dom.js";
import { clock, figure, homeWords, truckWords } from "./words.js";

const CALM = "no alarms";
const ORDER_RANK = { stuck: 0, assigned: 1, open: 2, delivered: 3, cancelled: 4 };

const NONE = [];
const byName = new Intl.Collator(undefined, { numeric: true }).compare;
const when = remembering();

export function drawLists(picture, { selected, select, nowUs }) {
  const { attention: found = NONE, notes: said = NONE, plan, truck, fleet } = picture;
  const second = Math.floor(nowUs / 1e6);
  when("attention", [found], () => attention(found, select));
  when("notes", [said], () => notes(said));
  when("drones", [picture.drones, selected], () => drones(picture.drones ?? {}, selected, select));
  when("orders", [picture.orders, selected], () => orders(picture.orders ?? {}, selected, select));
  when("next", [plan], () => next(plan));
  when("truck", [truck, second], () => say($("#truck"), truck ? `truck: ${truckWords(truck, nowUs)}` : ""));
  when("title", [plan, fleet], () => say($("#title"), plan ? `${fleet}, ${plan.title}` : fleet ?? "Leeway"));
  when("counts", [picture.orders], () => say($("#counts"), counts(picture.orders ?? {})));
}

function attention(found, select) {
  const rows = found.length ? found.map((one) => [`${one.who} ${one.words.replace(/[\d.]+/g, "")}`, one]) : [["calm", null]];
  set($("#attention"), { class: found.length ? "alarm" : "calm" });
  const make = (key, one) => {
    const button = html("button", { type: "button" });
    if (one) button.addEventListener("click", () => select(one.who));
    return html("li", {}, button);
  };
  keyed($("#attention ol"), rows, make, (row, one) =>
    say(row.firstChild, one ? `! ${one.who}: ${one.words}` : CALM));
}

function notes(words) {
  keyed($("#notes"), words.map((one) => [one, one]), () => html("li"), say);
}

function table(selector, entries, selected, select, cells) {
  const make = (key) => {
    const row = html("tr", { tabindex: 0 });
    row.addEventListener("click", () => select(key));
    row.addEventListener("keydown", (event) => event.key === "Enter" && select(key));
    return row;
  };
  keyed($(`${selector} tbody`), entries, make, (row, item, key) => {
    const words = cells(key, item);
    while (row.children.length < words.length) row.append(html("td", {}, html("span")));
    words.forEach((word, k) => say(row.children[k].firstChild, word));
    set(row, { class: [item.alarms?.length ? "alarm" : "", key === selected ? "chosen" : "", item.state ?? ""].join(" ").trim() });
  }, (item, key) => key === selected);
}

function drones(found, selected, select) {
  const alarming = (one) => (one.alarms?.length ? 0 : 1);
  const entries = Object.entries(found).sort((a, b) =>
    alarming(a[1]) - alarming(b[1]) || byName(a[0], b[0]));
  table("#drones", entries, selected, select, (name, drone) => [
    drone.alarms?.length ? `! ${name}` : name,
    drone.phase,
    drone.order ?? "-",
    drone.asked ? `${drone.home ?? "-"} > ${drone.asked}` : drone.home ?? "-",
    figure(drone.margin_wh, 1),
    homeWords(drone.p_home, drone.p_home_limit),
  ]);
}

function orders(found, selected, select) {
  const entries = Object.entries(found).sort((a, b) =>
    ORDER_RANK[a[1].state] - ORDER_RANK[b[1].state] || byName(a[0], b[0]));
  table("#orders", entries, selected, select, (id, order) => [id, order.state, order.vehicle ?? "", order.why ?? ""]);
}

function next(plan) {
  const words = (plan?.next ?? []).map((one) =>
    `next: ${one.launch_us === undefined ? "" : `${clock(one.launch_us)} `}${one.order} by ${one.vehicle} from ${one.launch} to ${one.home}`);
  keyed($("#next"), words.map((one) => [one, one]), () => html("div"), say);
}

function counts(orders) {
  const found = {};
  for (const { state } of Object.values(orders)) found[state] = (found[state] ?? 0) + 1;
  const words = Object.entries(found).sort().map(([state, count]) => `${count} ${state}`);
  return words.join(", ") || "no orders";
}
