// Draws everything with a position (ground, routes, drones) as SVG in the view's pixels.

import { $, keyed, remembering, say, set, svg } from "./dom.js";
import { truckWords, windWords } from "./words.js";

const [NONE, NO_WINDS] = [{}, []];
const LAYERS = ["areas", "route", "stops", "reach", "ways", "orders", "rally", "drive", "truck", "drones"];
const LEGS = ["out", "home"];
const WAYS = [...LEGS, "asked", "now"];
const ORDER_SHAPES = {
  open: "M-5,0a5,5 0 1,0 10,0a5,5 0 1,0 -10,0",
  assigned: "M-6,-6h12v12h-12z",
  delivered: "M-5,0l4,4l6,-8",
  stuck: "M-6,-6L6,6M-6,6L6,-6",
  cancelled: "M-4,0h8",
};
const ARROW = "M0,-13L8,9L0,4L-8,9Z";
const WAITING = "M0,-7L7,0L0,7L-7,0Z"; // a drone with unknown course: a diamond

export class Drawing {
  constructor(view, select) {
    this.view = view;
    this.select = select;
    this.groups = Object.fromEntries(LAYERS.map((name) => [name, svg("g", { class: name })]));
    this.map = $("#map");
    this.if = remembering();
    this.map.append(...Object.values(this.groups));
  }

  draw(picture, { selected, reach, nowUs }) {
    const { site = NONE, plan, drones = NONE, orders = NONE, truck, winds = NO_WINDS } = picture;
    const drawing = this.view.settle();
    const second = Math.floor(nowUs / 1e6);
    const { placed } = this.view; // positions in this drawing
    this.if("ground", [placed], () => { this.map.style.transform = placed; });
    this.if("areas", [site, drawing], () => this.#areas(site.areas ?? []));
    this.if("plan", [plan, drawing], () => this.#plan(plan));
    this.if("ways", [drones, selected, drawing], () => this.#ways(drones, selected));
    this.if("reach", [reach, drawing], () => this.#reach(reach));
    this.if("orders", [orders, selected, drawing], () => this.#orders(orders, selected));
    this.if("rally", [site, drawing], () => this.#rally(site));
    this.if("truck", [truck, second, drawing], () => this.#truck(truck, nowUs));
    this.if("drones", [drones, selected, drawing], () => this.#drones(drones, selected));
    this.if("wind", [winds], () => this.#wind(winds));
    this.if("scale", [this.view.metresPerPixel], () => this.#scale());
  }

  #areas(areas) {
    const make = () => svg("g", {}, svg("polygon"), svg("text"));
    keyed(this.groups.areas, areas.map((area, k) => [String(k), area]), make, (group, area) => {
      const [shape, label] = group.children;
      set(group, { class: area.height_m === undefined ? "no-fly" : "obstacle" });
      set(shape, { points: this.view.path(area.ring) });
      const [x, y] = this.view.at(area.ring[0]);
      set(label, { x, y });
      const height = area.height_m === undefined ? "no fly" : `${area.height_m.toFixed(0)} m`;
      say(label, this.view.zoom > 13 ? `${area.name} ${height}` : "");
    });
  }

  #plan(plan) {
    const stops = plan?.stops ?? {};
    const places = (plan?.route ?? []).filter((id) => stops[id]).map((id) => stops[id].at);
    keyed(this.groups.route, places.length ? [["route", places]] : [], () => svg("polyline"), (line) =>
      set(line, { points: this.view.path(places) }));
    const make = () => svg("g", {}, svg("rect", { x: -4, y: -4, width: 8, height: 8 }), svg("text", { x: 7, y: 12 }));
    keyed(this.groups.stops, Object.entries(stops), make, (group, stop, id) => {
      this.#move(group, stop.at);
      const ends = id === plan.route[0] || id === plan.route.at(-1); // the depot's label is there
      say(group.children[1], this.view.zoom > 12 && !ends ? id : "");
    });
  }

  // All routes of a kind are one path: separate elements are too slow for hundreds of drones.
  #ways(drones, selected) {
    const kinds = new Map();
    for (const [name, { way = NONE }] of Object.entries(drones))
      for (const kind of WAYS.filter((one) => way[one]?.length)) {
        const look = wayLook(kind, way, name === selected);
        if (!kinds.has(look)) kinds.set(look, []);
        kinds.get(look).push(way[kind]);
      }
    keyed(this.groups.ways, kinds, (look) => svg("path", { class: look }), (path, lines) => {
      const { number } = this.view.drawn;
      if (isSame(path.lines, lines) && path.drawing === number) return;
      [path.lines, path.drawing] = [lines, number];
      set(path, { d: lines.map((points) => `M${this.view.path(points)}`).join("") });
    });
  }

  #reach(ring) {
    keyed(this.groups.reach, ring ? [["ring", ring]] : [], () => svg("polygon"), (shape) =>
      set(shape, { points: this.view.path(ring) }));
  }

  #orders(orders, selected) {
    const make = (id) => this.#button(id, svg("g", {}, svg("path"), svg("text", { x: 8, y: 4 }), svg("title")));
    keyed(this.groups.orders, Object.entries(orders), make, (group, order, id) => {
      set(group, { class: `order ${order.state}${id === selected ? " chosen" : ""}` });
      set(group.children[0], { d: ORDER_SHAPES[order.state] ?? ORDER_SHAPES.open });
      say(group.children[1], this.view.zoom > 14.5 || id === selected ? id : "");
      say(group.children[2], `${id}: ${order.state}`);
      this.#move(group, order.at);
    }, (order, id) => this.#look(id, selected));
  }

  #rally(site) {
    const places = Object.entries(site.rally ?? {}).map(([name, at]) => [name, { at, depot: false }]);
    if (site.depot) places.push(["depot", { at: site.depot, depot: true }]);
    const make = () => svg("g", {}, svg("path"), svg("text", { x: 10, y: 4 }));
    keyed(this.groups.rally, places, make, (group, place, name) => {
      set(group, { class: place.depot ? "depot" : "rally-point" });
      set(group.children[0], { d: place.depot ? "M-7,7v-8l7,-7l7,7v8z" : "M-8,6L0,-8L8,6Z" });
      say(group.children[1], name);
      this.#move(group, place.at);
    });
  }

  // Without a reported position it is interpolated between its stops by the plan's times.
  #truck(truck, nowUs) {
    const drive = truck?.drive;
    const at = truck?.at ?? (drive && alongDrive(drive, nowUs));
    keyed(this.groups.drive, drive ? [["drive", drive]] : [], () => svg("polyline"), (line) =>
      set(line, { points: this.view.path([drive.start, drive.end]) }));
    const make = () => svg("g", {}, svg("rect", { x: -11, y: -7, width: 22, height: 14, rx: 2 }), svg("text", { x: 14, y: -8 }));
    keyed(this.groups.truck, at ? [["truck", truck]] : [], make, (group) => {
      set(group, { class: [truck.alarms?.length && "alarm", drive && "by-plan"].filter(Boolean).join(" ") });
      say(group.children[1], `truck ${truckWords(truck, nowUs)}`);
      this.#move(group, at);
    });
  }

  #drones(drones, selected) {
    const make = (name) => this.#button(name, svg("g", {},
      svg("circle", { r: 15 }), svg("path"), svg("text", { x: 13, y: -9 }), svg("text", { class: "mark", x: -22, y: 5 })));
    keyed(this.groups.drones, Object.entries(drones).filter(([, drone]) => drone.at), make, (group, drone, name) => {
      const alarm = drone.alarms?.length > 0;
      const marks = [alarm && "alarm", name === selected && "chosen", !drone.present && "silent", drone.armed && "armed"];
      set(group, { class: ["drone", ...marks.filter(Boolean)].join(" ") });
      const turned = drone.course_deg === undefined || !drone.armed;
      set(group.children[1], { d: turned ? WAITING : ARROW, transform: `rotate(${turned ? 0 : drone.course_deg.toFixed(0)})` });
      say(group.children[2], name);
      say(group.children[3], alarm ? "!" : "");
      this.#move(group, drone.at);
    }, (drone, name) => this.#look(name, selected));
  }

  #wind(winds) {
    const make = () => svg("g", {}, svg("ellipse"), svg("line", { x1: 0, y1: 0 }));
    keyed($("#wind"), [["ring", null], ...winds.map((wind) => [wind.source, wind])],
      (key) => (key === "ring" ? svg("circle", { r: 50, class: "ring" }) : make()),
      (group, wind) => wind && drawWind(group, wind));
    say($("#wind-words"), winds.map(windWords).join("; "));
  }

  #scale() {
    const metres = niceLength(this.view.metresPerPixel * 120);
    const bar = $("#scale");
    bar.style.width = `${metres / this.view.metresPerPixel}px`;
    say(bar, metres >= 1000 ? `${metres / 1000} km` : `${metres} m`);
  }

  // Further inputs on which an element's appearance depends.
  #look(name, selected) {
    return this.view.drawn.number * (name === selected ? -1 : 1);
  }

  #move(group, at) {
    const [x, y] = this.view.at(at);
    set(group, { transform: `translate(${x.toFixed(1)},${y.toFixed(1)})` });
  }

  #button(name, group) {
    group.addEventListener("click", () => this.select(name));
    return group;
  }
}

function wayLook(kind, way, isChosen) {
  const straight = way.straight && LEGS.includes(kind);
  return `way-${kind}${straight ? " straight" : ""}${isChosen ? " chosen" : ""}`;
}

const isSame = (before, after) => before?.length === after.length && after.every((one, k) => one === before[k]);

export function alongDrive({ start, end, left_us: left, arrive_us: arrive }, nowUs) {
  const share = arrive > left ? Math.min(1, Math.max(0, (nowUs - left) / (arrive - left))) : 1;
  return start.map((from, k) => from + share * (end[k] - from));
}

const PX_PER_MPS = 5; // 10 m/s reach the ring

// An arrow in the direction that the wind blows to, with the 1-sigma ellipse at its tip.
function drawWind(group, { to_ne_mps: [north, east], cov_m2ps2: [nn, ne, ee] }) {
  const [x, y] = [east * PX_PER_MPS, -north * PX_PER_MPS];
  const middle = (nn + ee) / 2;
  const apart = Math.hypot((nn - ee) / 2, ne);
  const turned = (Math.atan2(2 * ne, ee - nn) / 2) * (180 / Math.PI); // angle of the major axis, from east to north
  const [ellipse, line] = group.children;
  set(line, { x2: x.toFixed(1), y2: y.toFixed(1) });
  set(ellipse, {
    rx: (Math.sqrt(middle + apart) * PX_PER_MPS).toFixed(1),
    ry: (Math.sqrt(Math.max(middle - apart, 0)) * PX_PER_MPS).toFixed(1),
    transform: `translate(${x.toFixed(1)},${y.toFixed(1)}) rotate(${(-turned).toFixed(0)})`,
  });
}

function niceLength(metres) {
  const power = 10 ** Math.floor(Math.log10(metres));
  return power * [5, 2, 1].find((times) => times * power <= metres);
}
