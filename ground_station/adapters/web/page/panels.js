// The bar, the attention list, the list of drones, the map's tools and the tabs.

import { button, html, icon, svg } from "./dom.js";
import { glyph, windCard } from "./map.js";
import { command, me } from "./people.js";
import { age, ageOf, byName, clock, date, fromDeg, inTime, isFlying, isSilent, kindOf, ORDER_WORDS, orderKind, phaseWords, plural, seconds, spare, timed, UNKNOWN } from "./words.js";

export const LEVELS = ["warning", "caution", "your_turn"];
const LOW_SPARE_TIMES = 2; // spare below this many times the limit is set in bold
const STACK = ["delivered", "air", "van", "open"];

export function counts({ orders = {}, drones = {} }) {
  const found = {};
  for (const order of Object.values(orders)) {
    const kind = orderKind(order, drones);
    found[kind] = (found[kind] ?? 0) + 1;
  }
  return found;
}

export function topBar(picture, { nowUs, link, view, isPast }) {
  const { plan, drones = {}, truck, fleet } = picture;
  const found = counts(picture);
  const total = Object.values(found).reduce((a, b) => a + b, 0) - (found.cancelled ?? 0) - (found.returned ?? 0);
  const flying = Object.values(drones).filter(isFlying).length;
  const figure = (name, value, more, kind = "") => html("div", { class: `figure ${kind}` }, html("dt", {}, name), html("dd", {}, value, more && html("small", {}, more)));
  let x = 0;
  const stack = STACK.map((kind) => {
    const wide = total ? (100 * (found[kind] ?? 0)) / total : 0;
    return svg("rect", { x: (x += wide) - wide, width: wide, height: 4, class: kind });
  });
  const ends = plan?.end_us;
  return [
    html("div", { class: "brand" }, svg("svg", { viewBox: "0 0 28 28", class: "logo", "aria-hidden": "true" }, svg("path", { d: "M3 20C9 20 10 8 16 8s6 6 9 6", class: "l1" }), svg("path", { d: "M3 14C8 14 10 20 15 20s7-3 10-3", class: "l2" })),
      html("div", {}, html("h1", { id: "title" }, fleet ?? "Leeway"), html("small", {}, [nowUs ? date(nowUs) : "", plan?.title].filter(Boolean).join(", ")))),
    html("div", { class: "switch", role: "group", "aria-label": "View" }, [["map", "Map"], ["orders", "Orders"]].map(([key, words], k) => button(words, "view", key, { "aria-pressed": String(view === key), title: `Key ${k + 1}` }))),
    html("dl", { class: "figures" },
      html("div", { class: "figure wide" }, html("dt", {}, "Delivered"), html("dd", {}, `${found.delivered ?? 0} of ${total}`, svg("svg", { viewBox: "0 0 100 4", class: "stack", preserveAspectRatio: "none", role: "img", "aria-label": STACK.map((kind) => `${found[kind] ?? 0} ${ORDER_WORDS[kind].toLowerCase()}`).join(", ") }, stack))),
      figure("In the air", String(flying), `of ${plural(Object.keys(drones).length, "drone")}`),
      truck && figure("Truck", truck.phase === "driving" ? "Driving" : truck.stop ?? UNKNOWN, truck.phase === "driving" ? `to ${truck.stop ?? "its next stop"}` : truck.leaves_us ? (truck.leaves_us < nowUs ? `was due ${clock(truck.leaves_us)}` : `leaves ${inTime(truck.leaves_us, nowUs)}`) : ""),
      ends && figure("Day ends", clock(ends + 1e6 * Math.max(0, plan.late_s ?? 0)), `plan ${clock(ends)}`)),
    html("div", { class: "right" },
      !isPast && me.mayOrder && [button("Hand over\u2026", "select", "handover", { class: "quiet" }), button("All drones\u2026", "select", "all", { class: "all" })],
      html("div", { id: "link", class: `link ${link.kind}` }, html("b", {}, link.words), html("span", {}, link.more)),
      html("time", { id: "clock" }, nowUs ? seconds(nowUs) : ""),
      html("span", { id: "person", class: me.trouble ? "lost" : "" }, me.trouble || (me.name ? `${me.name}, ${me.role}` : "")),
      me.isThere && !me.name && button("Sign in", "select", "sign-in", { id: "sign-in" }),
      me.name && button("Sign out", "sign-out", "", { id: "sign-out", class: "quiet" })),
  ];
}

// --- the attention list ---------------------------------------------------------------------------

export function needsYou(items, { nowUs, seen, isPast, selected, picture }) {
  return [
    html("h2", {}, isPast ? `Needed you at ${clock(nowUs)}` : "Needs you", html("span", { class: `badge${items.length ? "" : " none"}` }, String(items.length)), html("small", {}, "A: next")),
    items.length ? items.map((item) => attentionItem(item, seen, isPast, selected, picture.orders)) : html("p", { class: "calm" }, icon("tick"), "Nothing needs you"),
  ];
}

function attentionItem(item, seen, isPast, selected, orders) {
  const folded = seen.get(item.key) === item.level;
  const acts = isPast ? [] : item.acts ?? [];
  return html("article", { class: `alert ${item.level}${folded ? " folded" : ""}${item.who === selected ? " chosen" : ""}`, "data-key": item.key, "aria-label": item.title },
    html("div", { class: "sign" }, icon(item.level)),
    html("div", { class: "what" },
      html("h3", {}, button(item.title, "show", item.who, { class: "plain" }), item.since_us && html("time", {}, `since ${seconds(item.since_us)}`)),
      !folded && item.words && html("p", {}, timed(item.words, item.times)),
      !folded && !isPast && html("div", { class: "acts" }, acts.map((act) => actionButton(act, item, orders?.[item.who])), button("Seen", "seen", item.key, { class: "quiet" }))));
}

function actionButton(act, { who }, order) {
  const [does, subject] = act.split(" ");
  switch (does) {
    case "show": return button("Show", "show", who);
    case "launch": return command(`Launch ${who}`, { do: "confirm", order: subject }, "primary");
    case "call": return order?.phone && html("a", { class: "button", href: `tel:${order.phone.replaceAll(" ", "")}` }, "Call");
    case "edit": return me.mayOrder && button("Move\u2026", "ask", `edit ${subject}`);
    case "recall": return command(`Recall ${who}`, { do: "recall", vehicle: who }, "danger");
    case "release": return command(`Release ${who}`, { do: "release", vehicle: who });
    case "hold": return me.mayOrder && button("Hold\u2026", "ask", `hold ${who}`);
    case "hold_all": return me.mayOrder && button("Hold all\u2026", "select", "all");
    case "settle": return me.mayOrder && button({ delivered: "Delivered\u2026", lost: "Lost\u2026", back: "Came back\u2026" }[subject], "ask", `settle ${who} ${subject}`);
    case "accept": return command("Accept the shift", { do: "accept" }, "primary");
    case "return": return me.mayOrder && button("To sender\u2026", "ask", `return ${who}`);
    default: return null;
  }
}

// --- drones ---------------------------------------------------------------------------------------

export const listOrder = (drones, alerts) => Object.keys(drones).sort((a, b) => rankOf(drones[a], alerts.get(a)) - rankOf(drones[b], alerts.get(b)) || (drones[a].land_us ?? 0) - (drones[b].land_us ?? 0) || byName(a, b));
const rankOf = (drone, alert) => (alert ? LEVELS.indexOf(alert) : isFlying(drone) ? 3 : 4);

export const mini = (drone, look = "") => svg("svg", { viewBox: "-19 -19 38 38", class: `mini drone ${kindOf(drone)} ${look}`, "aria-hidden": "true" }, glyph(drone));

export function placeWords(drone, orders) {
  const order = orders?.[drone.order];
  if (drone.diverted_to) return `diverts to ${drone.diverted_to}`;
  if (drone.order && !drone.delivered) return [drone.order, order?.address].filter(Boolean).join(", ");
  return drone.home ? `${drone.home}, empty` : isFlying(drone) ? "coming back, empty" : "no order";
}

export function droneRow(name, drone, { orders, nowUs, alert, selected, lowWh }) {
  const silent = isSilent(drone, nowUs);
  const flies = isFlying(drone);
  const when = silent && flies ? (drone.land_us ? `${clock(drone.land_us)} by plan` : "") : flies && drone.land_us ? `lands ${inTime(drone.land_us, nowUs)}` : alert === "your_turn" && kindOf(drone) === "ready" ? "your launch" : "";
  const share = flightShare(drone, nowUs);
  return [html("button", { type: "button", class: `row ${alert ?? ""}`, "aria-pressed": String(selected), "data-do": "select", "data-with": name },
    mini(drone, `${silent ? "silent" : ""} ${alert ?? ""}`),
    html("span", { class: "name" }, html("b", {}, name), " ", html("span", {}, silent ? "No contact" : phaseWords(drone.phase))),
    html("span", { class: "when" }, when),
    html("span", { class: "where" }, placeWords(drone, orders)),
    html("span", { class: `spare${(drone.margin_wh ?? Infinity) < LOW_SPARE_TIMES * lowWh ? " tight" : ""}` }, silent ? `${age(ageOf(drone, nowUs))} old` : spare(drone)),
    svg("svg", { viewBox: "0 0 100 4", class: "progress", preserveAspectRatio: "none", "aria-hidden": "true" }, svg("rect", { width: 100, height: 4, class: "track" }), share !== null && svg("rect", { width: (100 * share).toFixed(0), height: 4, class: "part" })))];
}

export function flightShare(drone, nowUs) {
  if (!drone.launch_us || !drone.land_us || drone.land_us <= drone.launch_us) return null;
  return Math.min(1, Math.max(0, (nowUs - drone.launch_us) / (drone.land_us - drone.launch_us)));
}

// --- the map's tools ------------------------------------------------------------------------------

export function mapTools(picture, hidden) {
  const card = windCard(picture.winds);
  const layers = [["wind", "Wind"], ["ways", "Routes"], ["orders", "Orders"], ["zones", "Zones"]];
  return [
    html("div", { class: "tools" }, [["plus", "Zoom in"], ["minus", "Zoom out"], ["fit", "Show all (F)"]].map(([name, words]) => button("", "zoom", name, { class: "icon-only", "aria-label": words }, name))),
    html("div", { class: "layers", role: "group", "aria-label": "Layers" }, layers.map(([key, words]) => button(words, "layer", key, { "aria-pressed": String(!hidden.has(key)) }))),
    card && html("div", { class: "wind-card", title: `from ${fromDeg(card.wind.to_ne_mps).toFixed(0)}\u00b0; ${card.wind.source}` }, svg("svg", { viewBox: "-20 -20 40 40", "aria-hidden": "true" }, card.rose),
      html("p", {}, html("b", {}, card.words), ` ${card.from}`, html("br"), html("small", {}, card.planned ? card.plannedWords : card.wind.source))),
  ];
}

export function phoneTabs(view, count) {
  return [["map", "Map", "map"], ["needs", "Needs you", "warning"], ["drones", "Drones", "drone"], ["orders", "Orders", "box"], ["day", "Day", "clock"]].map(([key, words, sign]) =>
    html("button", { type: "button", "aria-current": view === key ? "page" : null, "data-do": "view", "data-with": key }, icon(sign), key === "needs" && count ? html("span", { class: "badge" }, String(count)) : null, html("span", {}, words)));
}

export function emptyState(fleet, ageWords) {
  const way = (sign, title, words, code) => html("li", {}, icon(sign), html("div", {}, html("b", {}, title), html("p", {}, words), code && html("code", {}, code)));
  return html("div", { class: "empty" }, html("h2", {}, "No day is loaded"), html("p", {}, `The map of \u201c${fleet ?? "the fleet"}\u201d is connected (${ageWords} ago). It waits for a plan or for the first order.`),
    html("ol", {}, way("box", "Add orders", "One by one, or from a CSV or Excel file."), way("truck", "Start the desk on a day", "On the ground station:", "ground-station dispatch --day town"), way("clock", "Look at a day that is over", "Open a run folder or a store:", "ground-station map --replay logs/day-town")),
    me.mayOrder && html("div", { class: "acts" }, button("Add order", "select", "new", { class: "primary" }, "plus"), button("Import orders\u2026", "select", "import")));
}

