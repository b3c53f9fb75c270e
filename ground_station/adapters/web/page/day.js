// The day as a timeline: the truck's stops above, each drone's sorties below, now as a line. On a narrow
// screen the stops are an agenda.

import { html, morph, svg } from "./dom.js";
import { arrivalOf } from "./card.js";
import { byName, clock, CLOSED, isFlying, orderKind } from "./words.js";

const [LEFT, ROW, TOP] = [62, 14.5, 22];
const NARROW_PX = 500;
const MIN_US = 60e6;
const STEPS_MIN = [5, 15, 30, 60, 120];

export function drawDay(place, picture, shared, wide) {
  if (!wide) return;
  const late = picture.plan?.late_s;
  const slip = late === undefined ? "" : late > 0 ? `${Math.round(late / 60)} min behind plan` : "on plan";
  const head = html("div", { class: "day-head" }, html("h2", {}, "Day"), html("p", { class: "key" }, picture.plan && html("span", {}, html("i", { class: "k-stop" }), "truck at stop"), html("span", {}, html("i", { class: "k-sortie" }), "sortie, dot = drop"), picture.plan && html("span", {}, html("i", { class: "k-later" }), "planned")), html("p", { class: "slip" }, slip));
  morph(place, [head, wide < NARROW_PX ? agenda(picture, shared) : chart(wide - 24, picture, shared)]);
}

// Sorties of the plan; without a plan, the flights in the air.
function sortiesOf({ plan, drones = {} }) {
  if (plan) return (plan.sorties ?? []).filter((one) => one.launch_us && one.land_us);
  return Object.entries(drones).filter(([, one]) => isFlying(one) && one.launch_us && one.land_us)
    .map(([vehicle, one]) => ({ vehicle, order: one.order, launch_us: one.launch_us, land_us: one.land_us, drop_us: one.drop_us, state: "flying" }));
}

function chart(wide, picture, { nowUs, selected, alerts }) {
  const { plan, drones = {} } = picture;
  const sorties = sortiesOf(picture);
  const stops = (plan?.route ?? []).map((id) => [id, plan.stops[id]]).filter(([, stop]) => stop?.arrive_us !== undefined).map(([id, stop]) => ({ id, a: stop.arrived_us ?? stop.arrive_us, d: stop.departed_us ?? Math.max(stop.depart_us, stop.arrived_us ?? 0), left: Boolean(stop.departed_us), here: Boolean(stop.arrived_us) && !stop.departed_us }));
  const times = [nowUs - 10 * MIN_US, nowUs + 20 * MIN_US, ...sorties.flatMap((one) => [one.launch_us, one.land_us]), ...stops.flatMap((one) => [one.a, one.d])];
  const [from, to] = [Math.min(...times), Math.max(...times)];
  const x = (us) => LEFT + ((us - from) / (to - from)) * (wide - LEFT - 8);
  const names = [...(plan ? ["Truck"] : []), ...Object.keys(drones).sort(byName)];
  const rowOf = new Map(names.map((name, k) => [name, TOP + ROW * k]));
  const high = TOP + ROW * names.length + 4;
  const shapes = [];
  const step = (STEPS_MIN.find((m) => ((to - from) / MIN_US / m) * 60 < wide - LEFT) ?? 240) * MIN_US;
  for (let t = Math.ceil(from / step) * step; t <= to; t += step) shapes.push(svg("line", { x1: x(t), x2: x(t), y1: 16, y2: high, class: "tick" }), Math.abs(x(t) - x(nowUs)) > 42 && svg("text", { x: x(t), y: 11, class: "hour-name" }, clock(t)));
  for (const name of names) shapes.push(svg("text", { x: 4, y: rowOf.get(name) + 11, class: `row-name${name === selected || (name === "Truck" && selected === "truck") ? " chosen" : ""}` }, name));
  stops.forEach((stop, k) => {
    if (k) shapes.push(svg("line", { x1: x(stops[k - 1].d), x2: x(stop.a), y1: TOP + 7, y2: TOP + 7, class: "drive" }));
    const w = Math.max(5, x(stop.d) - x(stop.a));
    shapes.push(svg("g", { class: `stop-bar${stop.left ? " past" : stop.here ? " now" : ""}`, "data-do": "select", "data-with": "truck" }, svg("title", {}, `${stop.id}, ${clock(stop.a)} to ${clock(stop.d)}`), svg("rect", { x: x(stop.a), y: TOP + 1, width: w, height: 12, rx: 3 }), w > 8 + 6.5 * stop.id.length && svg("text", { x: x(stop.a) + 5, y: TOP + 10.4 }, stop.id)));
  });
  for (const one of sorties) {
    const y = rowOf.get(one.vehicle);
    if (y === undefined) continue;
    const state = { planned: "later", flying: "now" }[one.state] ?? "past";
    const alert = (state === "now" && alerts.get(one.vehicle)) || (one.state === "lost" ? "warning" : "");
    const chosen = one.vehicle === selected || one.order === selected ? " chosen" : "";
    shapes.push(svg("g", { class: `sortie ${state} ${alert}${chosen}`, "data-do": "select", "data-with": one.order ?? one.vehicle }, svg("title", {}, `${one.order} by ${one.vehicle}, ${clock(one.launch_us)} to ${clock(one.land_us)}`),
      svg("rect", { x: x(one.launch_us).toFixed(1), y: y + 2.5, width: Math.max(4, x(one.land_us) - x(one.launch_us)).toFixed(1), height: 9.5, rx: 2.5 }), svg("circle", { cx: x(one.drop_us ?? (one.launch_us + one.land_us) / 2).toFixed(1), cy: y + 7.25, r: 1.8 })));
  }
  const n = x(nowUs);
  shapes.push(svg("line", { x1: n, x2: n, y1: 14, y2: high, class: "now-line" }), svg("rect", { x: n - 24, y: 1, width: 48, height: 14, rx: 4, class: "now-tag" }), svg("text", { x: n, y: 11.4, class: "now-text" }, clock(nowUs)));
  return svg("svg", { width: wide, height: high, role: "img", "aria-label": "Timeline of truck and drones" }, shapes);
}

function agenda(picture, { nowUs }) {
  const { plan, orders = {}, drones = {} } = picture;
  const line = (id) => html("li", {}, html("button", { type: "button", class: "line", "data-do": "select", "data-with": id }, html("span", { class: `mark ${orderKind(orders[id], drones)}` }), html("b", {}, id), orders[id].address ?? "", html("small", {}, orders[id].vehicle ?? "truck")));
  if (!plan) {
    const open = Object.keys(orders).filter((id) => ["assigned", "stuck"].includes(orders[id].state)).sort((a, b) => (arrivalOf(a, orders[a], picture) ?? Infinity) - (arrivalOf(b, orders[b], picture) ?? Infinity));
    return html("ol", { class: "agenda" }, html("li", { class: "now" }, html("time", {}, clock(nowUs)), html("div", {}, html("b", {}, "In work"), html("small", {}, `${open.length} of ${Object.keys(orders).length} orders`), html("ol", {}, open.map(line)))));
  }
  return html("ol", { class: "agenda" }, plan.route.map((id) => [id, plan.stops[id]]).filter(([, stop]) => stop).map(([id, stop]) => {
    const here = stop.arrived_us && !stop.departed_us;
    const own = [...new Set([...(stop.serves ?? []), ...(plan.sorties ?? []).filter((one) => one.launch === id).map((one) => one.order)])].filter((one) => orders[one]);
    const left = own.filter((one) => !CLOSED.includes(orders[one].state));
    return html("li", { class: here ? "now" : stop.departed_us ? "past" : "" }, html("time", {}, stop.arrive_us ? clock(stop.arrived_us ?? stop.arrive_us) : ""),
      html("div", {}, html("b", {}, id, here && stop.depart_us && html("span", {}, ` until ${clock(stop.depart_us)}`)), html("small", {}, !own.length ? "no orders" : left.length ? `${left.length} of ${own.length} still to deliver` : `all ${own.length} delivered`), here ? html("ol", {}, left.map(line)) : null));
  }));
}

