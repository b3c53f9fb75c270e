// Draws everything with a position as SVG in the view's pixels, bottom to top; then the labels.

import { $, ICONS, keyed, morph, remembering, say, set, svg } from "./dom.js";
import { distance, drawGround } from "./ground.js";
import { placeLabels } from "./labels.js";
import { niceLength } from "./view.js";
import { age, ageOf, clock, CLOSED, fromWords, inTime, isFlying, isSilent, kindOf, orderKind, shortId, spare } from "./words.js";

const NONE = {};
const LAYERS = ["ground", "wind", "areas", "reach", "route", "ways", "orders", "clusters", "stops", "rally", "drive", "truck", "ghosts", "drones", "pin", "labels"];
const CLUSTER_PX_PER_M = 0.42;
const [CLUSTER_PX, WIND_PX, WIND_PX_PER_MPS] = [58, 120, 4];
const STOP_CLEARANCE_PX = 27;
const FEW_DRONES = 40;
const MOST_ORDER_LABELS = 200; // of more, only those that are stuck, loaded or in the air have one
const [RING_R, DISC_R] = [12.5, 9.8];
const ROUND = 2 * Math.PI * RING_R;
const PARKED_MOST = 12; // more drones on the ground at one place are drawn at their positions
const METRES_PER_DEG = 111_320;
const SHAPES = {
  open: "M-5,0a5,5 0 1,0 10,0a5,5 0 1,0 -10,0",
  van: "M-5,-5h10v10h-10z",
  air: "M-5.5,-5.5h11v11h-11z",
  delivered: "M-4.2,.2L-1.2,3.2L4.4,-3.2",
  cancelled: "M-4,-4L4,4M4,-4L-4,4",
  stuck: "M0,-7L7,0L0,7L-7,0Z",
};
const SIGNS = { ready: "M-3.5,-5L5,0L-3.5,5Z", load: "M-4,-4h8v8h-8z", drop: "M0,-5.5v8M-4,-1L0,3.6L4,-1M-4.5,6h9" };
const DART = "M0,-7.4L5.6,6L0,2.9L-5.6,6Z";
const ORDER_RANK = { stuck: 3, air: 4, van: 4, open: 7, cancelled: 8, returned: 8, delivered: 9 };

export class Drawing {
  constructor(view) {
    this.view = view;
    this.groups = Object.fromEntries(LAYERS.map((name) => [name, svg("g", { class: name })]));
    this.map = $("#map");
    this.if = remembering();
    this.map.append(...Object.values(this.groups));
    this.hidden = new Set();
    [this.ways, this.anchors, this.hits] = [new WeakMap(), new Map(), []];
  }

  draw(picture, shared) {
    const { site = NONE, plan, drones = NONE, orders = NONE, truck, winds = [] } = picture;
    const { selected, reach, nowUs, alerts, plainGround, pin } = shared;
    const drawing = this.view.settle();
    const second = Math.floor(nowUs / 1e6);
    this.shared = shared;
    const { placed } = this.view;
    this.if("placed", [placed], () => { this.map.style.transform = placed; });
    this.if("ground", [drawing, site, plan, plainGround, orders], () => this.#ground(picture, plainGround));
    this.if("wind", [winds, drawing], () => this.#wind(winds[1]));
    this.if("areas", [site, drawing], () => this.#areas(site.areas ?? []));
    this.if("route", [plan, truck, drawing], () => this.#route(plan, truck));
    this.if("ways", [drones, selected, drawing], () => this.#ways(drones, selected));
    this.if("reach", [reach, drawing], () => this.#reach(reach));
    this.if("orders", [orders, drones, selected, drawing], () => this.#orders(orders, drones, selected));
    this.if("rally", [site, drawing], () => this.#rally(site));
    this.if("pin", [pin?.[0], pin?.[1], drawing], () => this.#pin(pin));
    this.if("truck", [truck, second, selected, drawing], () => this.#truck(truck, nowUs, selected));
    this.if("drones", [drones, truck, selected, drawing, alerts, second], () => this.#drones(picture, shared));
    this.if("scale", [this.view.metresPerPixel], () => this.#scale());
  }

  drawLabels(picture, shared) {
    const { drones, orders, plan, site, truck } = picture;
    const { selected, alerts, reach, second } = shared;
    const moved = this.drawnWith !== this.view.drawn.number;
    const many = (this.shown?.length ?? 0) > FEW_DRONES; // then once a second
    this.if("labels", [many && !moved ? second : drones, orders, plan, site, truck, selected, this.view.drawn.number, second, alerts, reach, this.hidden.size], () => this.#labels(picture, shared));
    this.drawnWith = this.view.drawn.number;
  }

  toggle(layer) {
    this.hidden.has(layer) ? this.hidden.delete(layer) : this.hidden.add(layer);
    set(this.map, { class: [...this.hidden].map((name) => `no-${name}`).join(" ") });
  }

  // Symbols at a pixel of the viewport, top first; with a finger the area is larger.
  symbolsAt([px, py], touch) {
    const { drawn, scale, x, y, width, height, zoom } = this.view;
    const stretch = 2 ** (zoom - drawn.zoom);
    const at = [(px - width / 2 - (drawn.x - x) * scale) / stretch, (py - height / 2 - (drawn.y - y) * scale) / stretch];
    const far = (one) => Math.hypot(one.x - at[0], one.y - at[1]);
    return this.hits.filter((one) => far(one) <= Math.max(one.r, touch ? 22 : 12))
      .sort((a, b) => a.rank - b.rank || far(a) - far(b)).map((one) => one.id);
  }

  #ground({ site = NONE, orders = NONE, plan }, plainGround) {
    const places = [...Object.values(orders), ...Object.values(plan?.stops ?? NONE)].map((one) => one.at);
    const { shapes, rings } = plainGround ? drawGround(this.view, site.depot ?? places[0], places) : { shapes: [], rings: [] };
    this.rings = rings;
    this.groups.ground.replaceChildren(...shapes);
  }

  // One arrow per 120 px where the fleet measures the wind.
  #wind(field) {
    const arrows = [];
    if (field) {
      const [north, east] = field.to_ne_mps;
      const speed = Math.hypot(north, east) || 1e-6;
      const [ux, uy, long] = [east / speed, -north / speed, Math.min(26, 8 + WIND_PX_PER_MPS * speed) / 2];
      for (let x = -this.view.width; x < this.view.width; x += WIND_PX)
        for (let y = -this.view.height; y < this.view.height; y += WIND_PX) {
          const [tx, ty] = [x + ux * long, y + uy * long];
          const barb = (sign) => `M${(tx).toFixed(1)},${ty.toFixed(1)}l${(-5 * (ux * 0.88 + sign * uy * 0.48)).toFixed(1)},${(-5 * (uy * 0.88 - sign * ux * 0.48)).toFixed(1)}`;
          arrows.push(`M${(x - ux * long).toFixed(1)},${(y - uy * long).toFixed(1)}L${tx.toFixed(1)},${ty.toFixed(1)}${barb(1)}${barb(-1)}`);
        }
    }
    morph(this.groups.wind, arrows.length ? [svg("path", { d: arrows.join(""), class: "wind-field" })] : []);
  }

  #areas(areas) {
    morph(this.groups.areas, areas.map(({ ring, height_m: height }) =>
      svg("polygon", { points: this.view.path(ring), class: height === undefined ? "no-fly" : "obstacle" })));
  }

  #reach(ring) {
    morph(this.groups.reach, ring ? [svg("polygon", { points: this.view.path(ring), class: "reach" })] : []);
  }

  // The truck's route and its stops, in straight lines: streets are not known.
  #route(plan, truck) {
    const stops = plan?.stops ?? NONE;
    const names = (plan?.route ?? []).filter((id) => stops[id]);
    const parts = names.slice(1).flatMap((id, k) => {
      const line = this.view.path([stops[names[k]].at, stops[id].at]);
      return [svg("polyline", { points: line, class: "truck-case" }), svg("polyline", { points: line, class: stops[id].arrived_us ? "truck-way past" : "truck-way" })];
    });
    morph(this.groups.route, parts);
    const here = truck?.phase === "driving" ? null : truck?.stop;
    const drawn = names.map((id, k) => [id, k]).filter(([id, k]) => id !== here && k > 0 && k < names.length - 1);
    morph(this.groups.stops, drawn.map(([id, k]) => svg("g", { class: `stop${stops[id].departed_us ? " past" : ""}`, "data-key": id, transform: this.#place(stops[id].at) },
      svg("circle", { r: 9 }), svg("text", { y: 4 }, String(k)))));
    this.stopSymbols = drawn.map(([id, k]) => ({ id, number: k, stop: stops[id] }));
  }

  // All parts of a kind are one path: separate elements are too slow for hundreds of drones.
  #ways(drones, selected) {
    const kinds = new Map();
    const add = (look, d) => (kinds.has(look) ? kinds.get(look).push(d) : kinds.set(look, [d]));
    for (const [name, drone] of Object.entries(drones)) {
      let parts = this.ways.get(drone);
      if (parts?.number !== this.view.drawn.number) this.ways.set(drone, (parts = { number: this.view.drawn.number, list: this.#wayParts(drone) }));
      for (const [kind, d] of parts.list) add(`way ${kind}${name === selected ? " chosen" : ""}`, d);
    }
    keyed(this.groups.ways, [...kinds], (look) => svg("path", { class: look }), (path, list) => set(path, { d: list.join("") }));
  }

  #wayParts({ way = NONE, at, delivered, armed }) {
    const line = (points) => `M${this.view.path(points)}`;
    const straight = way.straight ? " straight" : "";
    const found = [];
    if (way.out && !armed) found.push([`later${straight}`, line(way.out)]);
    else if (way.out && at) found.push([`flown${straight}`, line(way.out)], [`ahead${straight}`, line(restOf(way.out, at))]);
    if (way.home) found.push([`home${straight}`, line(delivered && at ? restOf(way.home, at) : way.home)]);
    if (way.asked) found.push(["asked", line(way.asked)]);
    if (way.now) found.push(["diversion", line(way.now)]);
    return found;
  }

  #orders(orders, drones, selected) {
    const clustered = 1 / this.view.metresPerPixel < CLUSTER_PX_PER_M;
    const [single, cells] = [[], new Map()];
    for (const [id, order] of Object.entries(orders)) {
      const kind = orderKind(order, drones);
      const [x, y] = this.view.at(order.at);
      const one = { id, order, kind, x, y, look: `${this.view.drawn.number} ${kind} ${id === selected}` };
      if (!clustered || id === selected || !["open", "delivered"].includes(kind)) single.push(one);
      else {
        const cell = `${Math.floor(x / CLUSTER_PX)} ${Math.floor(y / CLUSTER_PX)}`;
        cells.has(cell) ? cells.get(cell).push(one) : cells.set(cell, [one]);
      }
    }
    const clusters = [];
    for (const [cell, group] of cells) group.length > 1 ? clusters.push({ cell, group, ...this.#besideStops(mean(group, "x"), mean(group, "y")) }) : single.push(group[0]);
    [this.single, this.clusters] = [single, clusters];
    keyed(this.groups.orders, single.map((one) => [one.id, one.order]), () => svg("g", {}), () => {}, () => 0);
    const nodes = new Map([...this.groups.orders.children].map((node) => [node.dataset.key, node]));
    for (const one of single) {
      const node = nodes.get(one.id);
      if (node.drawnLook === one.look && node.drawnOrder === one.order) continue;
      [node.drawnLook, node.drawnOrder] = [one.look, one.order];
      set(node, { class: `order ${one.kind}${one.id === selected ? " chosen" : ""}`, transform: `translate(${one.x.toFixed(1)},${one.y.toFixed(1)})` });
      morph(node, [one.id === selected && svg("circle", { r: 11, class: "halo" }), one.order.priority && svg("circle", { r: 8.5, class: "prio" }), svg("path", { d: SHAPES[one.kind] ?? SHAPES.open, class: "shape" })]);
    }
    morph(this.groups.clusters, clusters.map(({ cell, group, x, y }) => {
      const r = 11 + Math.min(5, group.length);
      const share = group.filter((one) => one.kind === "delivered").length / group.length;
      return svg("g", { class: "cluster", "data-key": cell, transform: `translate(${x.toFixed(1)},${y.toFixed(1)})` },
        svg("circle", { r, class: "cluster-ground" }),
        svg("circle", { r, class: "cluster-done", "stroke-dasharray": `${(2 * Math.PI * r * share).toFixed(1)} 999`, transform: "rotate(-90)" }),
        svg("text", { y: 4 }, String(group.length)));
    }));
  }

  // A cluster stands beside a stop, not under it.
  #besideStops(x, y) {
    for (const { stop } of this.stopSymbols ?? []) {
      const [sx, sy] = this.view.at(stop.at);
      const far = Math.hypot(x - sx, y - sy) || 1;
      if (far < STOP_CLEARANCE_PX) [x, y] = [sx + ((x - sx) * STOP_CLEARANCE_PX) / far, sy + ((y - sy) * STOP_CLEARANCE_PX) / far];
    }
    return { x, y };
  }

  #rally(site) {
    const places = Object.entries(site.rally ?? NONE).map(([name, at]) => [name, at, "M-8,6L0,-8L8,6Z"]);
    if (site.depot) places.push(["Depot", site.depot, "M-9,9v-9l9,-9l9,9v9z"]);
    morph(this.groups.rally, places.map(([name, at, d]) => svg("g", { class: name === "Depot" ? "depot" : "rally-point", "data-key": name, transform: this.#place(at) }, svg("path", { d }))));
  }

  #pin(at) {
    morph(this.groups.pin, at ? [svg("path", { class: "pin", d: "M0,0L-7,-14a8,8 0 1,1 14,0Z", transform: this.#place(at) })] : []);
  }

  // Without a reported position it is interpolated between its stops by the plan's times.
  #truck(truck, nowUs, selected) {
    const drive = truck?.drive;
    const at = truck?.at ?? (drive && alongDrive(drive, nowUs));
    morph(this.groups.drive, drive ? [svg("polyline", { points: this.view.path([drive.start, drive.end]) })] : []);
    this.truckAt = at ? this.view.at(at) : null;
    morph(this.groups.truck, at ? [svg("g", { class: `box${drive ? " by-plan" : ""}${selected === "truck" ? " chosen" : ""}`, transform: this.#place(at) },
      svg("rect", { x: -17, y: -11, width: 34, height: 22, rx: 6 }), svg("path", { d: ICONS.truck, transform: "translate(-9.6,-9.4) scale(1.2)" }))] : []);
  }

  #drones({ drones = NONE }, { selected, nowUs, alerts }) {
    const shown = Object.entries(drones).filter(([, drone]) => drone.at).map(([name, drone]) => ({ name, drone, at: this.view.at(drone.at) }));
    this.#arrangeParked(shown);
    const ghosts = [];
    keyed(this.groups.drones, shown.map((one) => [one.name, one]), () => svg("g", {}), (group, { name, drone, at: [x, y] }) => {
      const silent = isSilent(drone, nowUs);
      const look = ["drone", kindOf(drone), alerts.get(name), silent && "silent", name === selected && "chosen", drone.diverted_to && "diverted"].filter(Boolean).join(" ");
      set(group, { transform: `translate(${x.toFixed(1)},${y.toFixed(1)})`, class: look });
      const figures = [drone.energy_left_wh, drone.energy_needed_wh, drone.course_deg].map((value) => value?.toFixed(0));
      const drawn = `${look} ${figures}`;
      if (group.drawn !== drawn) morph(group, glyph(drone, { halo: name === selected, alert: alerts.get(name) }));
      group.drawn = drawn;
    });
    for (const one of shown) if (isSilent(one.drone, nowUs) && isFlying(one.drone)) ghosts.push(this.#ghost(one, nowUs));
    this.ghosts = ghosts.filter(Boolean);
    morph(this.groups.ghosts, this.ghosts.map((one) => one.shape));
    this.shown = shown;
  }

  // Drones on the ground at one place stand side by side below it.
  #arrangeParked(shown) {
    const parked = shown.filter((one) => !isFlying(one.drone) && !one.drone.armed);
    const groups = [];
    for (const one of parked) {
      const near = groups.find((group) => Math.hypot(group[0].at[0] - one.at[0], group[0].at[1] - one.at[1]) < 24);
      near ? near.push(one) : groups.push([one]);
    }
    for (const group of groups.filter((one) => one.length <= PARKED_MOST)) {
      const [x, y] = group[0].at;
      const below = this.truckAt && Math.hypot(this.truckAt[0] - x, this.truckAt[1] - y) < 40;
      if (group.length === 1 && !below) continue;
      group.forEach((one, k) => { one.at = [(below ? this.truckAt[0] : x) - 18 + 36 * (k % 4), (below ? this.truckAt[1] + 31 : y) + 34 * Math.floor(k / 4)]; });
    }
  }

  // Where a silent drone would be by its speed and route: never drawn as if it were known.
  #ghost({ drone, at }, nowUs) {
    const way = drone.way?.now ?? (drone.delivered || kindOf(drone) === "back" ? drone.way?.home : drone.way?.out);
    if (!way) return null;
    let left = (ageOf(drone, nowUs) * (drone.ground_speed_mps ?? 0)) / this.view.metresPerPixel;
    let here = at;
    for (const next of restOf(way, drone.at).slice(1).map((point) => this.view.at(point))) {
      const far = Math.hypot(next[0] - here[0], next[1] - here[1]);
      if (far > left) { here = here.map((v, k) => v + ((next[k] - v) * left) / far); break; }
      [here, left] = [next, left - far];
    }
    const shape = svg("g", {}, svg("path", { d: `M${at.map((v) => v.toFixed(1))}L${here.map((v) => v.toFixed(1))}`, class: "ghost-way" }),
      svg("circle", { cx: here[0].toFixed(1), cy: here[1].toFixed(1), r: 8, class: "ghost" }));
    return { shape, at: here };
  }

  #labels({ orders = NONE, site = NONE, truck }, { selected, nowUs, alerts, reach, covered }) {
    const [wanted, hard, soft, hits] = [[], [], [], []];
    const box = (x, y, r) => [x - r, y - r, x + r, y + r];
    const hidden = (layer) => this.hidden.has(layer);
    const many = (this.shown?.length ?? 0) > FEW_DRONES;
    for (const { name, drone, at: [x, y] } of this.shown ?? []) {
      const alert = alerts.get(name);
      hard.push(box(x, y, 15));
      hits.push({ id: name, x, y, r: 16, rank: name === selected ? 0 : 1 });
      const tag = `tag ${isSilent(drone, nowUs) ? "old " : ""}${alert ?? ""}`;
      wanted.push({ id: `drone ${name}`, rank: name === selected ? 0 : alert ? 0.5 : 2, x, y, r: 17, words: name, more: many && !alert && name !== selected && !isSilent(drone, nowUs) ? "" : droneWords(drone, nowUs, alert, name === selected), tag, must: true });
    }
    if (this.truckAt) {
      const [x, y] = this.truckAt;
      hard.push([x - 17, y - 11, x + 17, y + 11]);
      hits.push({ id: "truck", x, y, r: 18, rank: 2 });
      wanted.push({ id: "truck", rank: 1, x, y, r: 19, words: "Truck", more: truckWords(truck, nowUs), tag: "tag truck-tag", must: true });
    }
    for (const { id, stop, number } of this.stopSymbols ?? []) {
      const [x, y] = this.view.at(stop.at);
      soft.push(box(x, y, 10));
      hits.push({ id: "truck", x, y, r: 10, rank: 4 });
      wanted.push({ id: `stop ${number}`, rank: 5, x, y, r: 12, words: stop.arrive_us ? clock(stop.arrived_us ?? stop.arrive_us) : id, kind: "halt" });
    }
    for (const { at: [x, y] } of this.ghosts ?? []) wanted.push({ id: `ghost ${x}`, rank: 4.4, x, y, r: 10, words: "by plan", kind: "faint" });
    if (!hidden("orders")) {
      for (const { id, order, kind, x, y } of this.single ?? []) {
        soft.push(box(x, y, 6));
        hits.push({ id, x, y, r: 10, rank: id === selected ? 2.5 : 3 });
        if (id === selected || ORDER_RANK[kind] < 5 || (this.single.length < MOST_ORDER_LABELS)) wanted.push({ id: `order ${id}`, rank: id === selected ? 0 : ORDER_RANK[kind], x, y, r: 8, words: id === selected ? id : shortId(id), kind: CLOSED.includes(kind) ? "faint" : "ord" });
      }
      for (const { cell, group, x, y } of this.clusters ?? []) {
        soft.push(box(x, y, 18));
        hits.push({ id: `cluster ${cell}`, x, y, r: 18, rank: 5, members: group.map((one) => one.id) });
      }
    }
    if (!hidden("zones"))
      for (const area of site.areas ?? []) {
        const [x, y] = this.view.at(area.ring.reduce((a, b) => (a[0] > b[0] ? a : b)));
        wanted.push({ id: `area ${area.name}`, rank: 6, x, y, r: 4, words: area.height_m === undefined ? `No-fly: ${area.name}` : `${area.name} ${area.height_m.toFixed(0)} m`, kind: area.height_m === undefined ? "zone" : "faint" });
      }
    for (const { at: [x, y], words } of this.rings ?? []) wanted.push({ id: `ring ${words}`, rank: 9.5, x, y, r: 3, words, kind: "faint" });
    const places = Object.entries(site.rally ?? NONE).concat(site.depot ? [["Depot", site.depot]] : []);
    for (const [name, at] of places) {
      const [x, y] = this.view.at(at);
      soft.push(box(x, y, 9));
      wanted.push({ id: `place ${name}`, rank: 4.5, x, y, r: 11, words: name, kind: "halt" });
    }
    const edge = reach?.map((point) => this.view.at(point)).reduce((a, b) => (a[1] < b[1] ? a : b));
    if (edge) wanted.push({ id: "reach", rank: 0.8, x: edge[0], y: edge[1], r: 4, words: `${selected} can land inside`, kind: "blue" });
    this.hits = hits;
    const { drawn, scale, x, y, width, height } = this.view;
    const [left, top] = [(x - drawn.x) * scale - width / 2, (y - drawn.y) * scale - height / 2];
    for (const [a, b, c, d] of covered()) hard.push([left + a, top + b, left + c, top + d]);
    const labels = placeLabels(wanted, hard, soft, [left + 4, top + 4, left + width - 4, top + height - 4], this.anchors);
    keyed(this.groups.labels, labels.map((one) => [one.id, one]), () => svg("g", {}), (group, one) => {
      set(group, { class: `label ${one.tag ?? one.kind ?? ""}`, transform: `translate(${one.left.toFixed(1)},${one.top.toFixed(1)})` });
      morph(group, [one.tag && svg("rect", { width: one.width.toFixed(1), height: one.height, rx: 5 }),
        svg("text", { x: one.tag ? 6 : 1, y: one.tag ? 14 : 13 }, one.words, one.more && svg("tspan", { dx: 6, class: "more" }, one.more))]);
    });
  }

  members(id) {
    return this.hits.find((one) => one.id === id)?.members;
  }

  #scale() {
    const metres = niceLength(this.view.metresPerPixel * 140);
    const wide = metres / this.view.metresPerPixel;
    const [bar, words] = $("#scale").children;
    set(bar, { width: wide.toFixed(0) });
    set(bar.firstElementChild, { d: `M1,0V5H${(wide - 1).toFixed(0)}V0` });
    say(words, distance(metres));
  }

  #place(at) {
    const [x, y] = this.view.at(at);
    return `translate(${x.toFixed(1)},${y.toFixed(1)})`;
  }
}

const mean = (group, axis) => group.reduce((sum, one) => sum + one[axis], 0) / group.length;

function droneWords(drone, nowUs, alert, isChosen) {
  if (isSilent(drone, nowUs)) return `${age(ageOf(drone, nowUs))} ago`;
  if (alert === "your_turn" && kindOf(drone) === "ready") return "launch?";
  const lands = isFlying(drone) && drone.land_us ? `lands ${inTime(drone.land_us, nowUs)}` : "";
  return isChosen && drone.margin_wh !== undefined ? [spare(drone), lands].filter(Boolean).join(", ") : lands;
}

export function truckWords(truck, nowUs) {
  if (!truck) return "";
  if (truck.phase === "driving") {
    const arrive = truck.drive?.arrive_us;
    return `to ${truck.stop ?? "its next stop"}${truck.at ? "" : ", by plan"}${arrive ? `, arrives ${inTime(arrive, nowUs)}` : ""}`;
  }
  const leaves = truck.leaves_us;
  const late = leaves !== undefined && leaves < nowUs;
  return `${truck.stop ?? ""}${leaves === undefined ? "" : late ? `, was due ${clock(leaves)}` : `, leaves ${inTime(leaves, nowUs)}`}`;
}

// One drone: ring = energy left, notch = energy needed to land on the reserve, sign = state, dart = course.
export function glyph(drone, { halo = false, alert } = {}) {
  const full = drone.full_wh;
  const left = full ? Math.min(1, (drone.energy_left_wh ?? 0) / full) : 0;
  const notch = full && drone.energy_needed_wh !== undefined ? Math.min(1, Math.max(0, drone.energy_needed_wh / full)) * 2 * Math.PI : null;
  const kind = kindOf(drone);
  const sign = SIGNS[kind] ?? (drone.course_deg === undefined ? SIGNS.load : DART);
  return [
    halo && svg("circle", { r: 20, class: "halo" }), alert && svg("circle", { r: 18, class: "alert-halo" }), drone.diverted_to && svg("circle", { r: 16.5, class: "second-halo" }),
    svg("circle", { r: 15, class: "disc-edge" }), svg("circle", { r: RING_R, class: "ring-ground" }),
    svg("circle", { r: RING_R, class: "ring-left", "stroke-dasharray": `${(ROUND * left).toFixed(1)} ${ROUND.toFixed(1)}`, transform: "rotate(-90)" }),
    notch !== null && svg("line", { x1: (Math.sin(notch) * DISC_R).toFixed(1), y1: (-Math.cos(notch) * DISC_R).toFixed(1), x2: (Math.sin(notch) * 15.2).toFixed(1), y2: (-Math.cos(notch) * 15.2).toFixed(1), class: "notch" }),
    svg("circle", { r: DISC_R, class: "disc" }),
    svg("path", { d: sign, class: kind === "drop" ? "sign" : "dart", transform: sign === DART ? `rotate(${drone.course_deg.toFixed(0)})` : null }),
  ];
}

// The rest of a route from a position on: from its nearest leg.
export function restOf(route, at) {
  const cosine = Math.cos((at[0] * Math.PI) / 180);
  const flat = route.map(([lat, lon]) => [(lat - at[0]) * METRES_PER_DEG, (lon - at[1]) * METRES_PER_DEG * cosine]);
  let [nearest, least] = [0, Infinity];
  for (let k = 0; k + 1 < flat.length; k++) {
    const [[n, e], [dn, de]] = [flat[k], [flat[k + 1][0] - flat[k][0], flat[k + 1][1] - flat[k][1]]];
    const share = Math.min(1, Math.max(0, -(n * dn + e * de) / (dn * dn + de * de || 1)));
    const far = Math.hypot(n + share * dn, e + share * de);
    if (far < least) [nearest, least] = [k, far];
  }
  return [at, ...route.slice(nearest + 1)];
}

export function alongDrive({ start, end, left_us: left, arrive_us: arrive }, nowUs) {
  const share = arrive > left ? Math.min(1, Math.max(0, (nowUs - left) / (arrive - left))) : 1;
  return start.map((from, k) => from + share * (end[k] - from));
}

// The wind card: measured wind, else the planned one.
export function windCard(winds = []) {
  const [planned, measured] = winds;
  const wind = measured ?? planned;
  if (!wind) return null;
  const speed = (one) => `${Math.hypot(...one.to_ne_mps).toFixed(1)} m/s`;
  const arrow = (one, kind) => one && svg("path", { d: "M0,12v-24M-5.5,-5L0,-12L5.5,-5", class: kind, transform: `rotate(${((Math.atan2(one.to_ne_mps[1], one.to_ne_mps[0]) * 180) / Math.PI).toFixed(0)})` });
  return { wind, planned: measured && planned, words: `${speed(wind)}`, from: fromWords(wind.to_ne_mps), plannedWords: planned ? `planned ${speed(planned)} ${fromWords(planned.to_ne_mps)}` : "", rose: [svg("circle", { r: 18, class: "rose" }), arrow(measured && planned, "plan"), arrow(wind, "told")] };
}

