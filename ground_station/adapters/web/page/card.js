// The card of what is selected: a drone, an order, the truck, all drones, help or sign-in.

import { button, html, icon, svg } from "./dom.js";
import { editForm } from "./forms.js";
import { truckWords } from "./map.js";
import { mini } from "./panels.js";
import { command, me, mayCommand, reasons } from "./people.js";
import { age, ageOf, clock, CLOSED, fromWords, inTime, isFlying, isSilent, kindOf, number, ORDER_WORDS, orderKind, phaseWords, seconds, UNKNOWN, wattHours, windowWords } from "./words.js";

const RISK_DECADES = { from: 1, to: 5 }; // the scale: 1 in 10 to 1 in 100,000
const HOLD_REASONS = ["Check the drone", "Pad not clear", "Weather", "Other"];
const OUT_REASONS = ["Motor or propeller", "Battery", "Autopilot or computer", "Damaged", "Other"];
const OUT = "out of service: ";
const CANCEL_REASONS = ["Customer asked", "Not at home", "Cannot be flown today", "Wrong address", "Other"];
const RETURN_REASONS = ["Not at home", "Pad blocked", "Wrong address", "Customer refused it", "Other"];
const SETTLE_REASONS = ["Driver has looked", "Customer has confirmed", "Seen at the depot", "Other"];
const KEYS = [["A", "next item that needs you"], ["Enter", "its card"], ["L", "launch the selected drone, twice"], ["J, K", "next, previous drone"], ["/", "search orders"], ["N", "new order"], ["1 2 3", "map, orders, driver's list"], ["F, C", "show all, centre the selection"], ["+ \u2212 and arrows", "zoom, move"], ["R", "show or hide the reachable area"], ["T", "dark, light or the system's colours"], ["Space", "replay: play, pause"], [", .", "replay: 10 s back, forward"], ["< >", "replay: slower, faster"], ["M", "replay: to the next event"], ["Esc", "close"]];

const close = () => button("", "close", "", { class: "icon-only", "aria-label": "Close" }, "close");
export const header = (title, more, sign = null, kind = "age") => html("header", {}, sign, html("div", {}, html("h2", {}, title), more && html("p", { class: kind }, more)), close());
const facts = (rows) => html("dl", { class: "facts" }, rows.filter(([, value]) => value).map(([name, value]) => html("div", {}, html("dt", {}, name), html("dd", {}, value))));
const link = (id, words = id) => button(words, "select", id, { class: "plain" });

function stepper(steps, at) {
  return html("ol", { class: "steps" }, steps.map(([name, time], k) => html("li", { class: k < at ? "past" : k === at ? "now" : "" }, html("b", {}, name), html("span", {}, time || "\u00a0"))));
}

export function cardOf(picture, shared) {
  const { selected } = shared;
  const { drones = {}, orders = {}, truck } = picture;
  if (selected === "help") return helpCard();
  if (selected === "sign-in" && me.isThere && !me.name) return signInCard();
  if (selected === "handover") return handoverCard(picture);
  if (selected === "all" && mayCommand()) return allCard(shared);
  if (drones[selected]) return droneCard(selected, drones[selected], picture, shared);
  if (orders[selected]) return orderCard(selected, orders[selected], picture, shared);
  if (selected === "truck" && truck) return truckCard(truck, picture, shared);
  return null;
}

// --- drone ----------------------------------------------------------------------------------------

function droneCard(name, drone, picture, { nowUs, history, asking, alerts }) {
  const silent = isSilent(drone, nowUs);
  const at = { load: 0, ready: 0, out: 1, drop: 2, back: 3 }[kindOf(drone)];
  const time = (us) => (us ? clock(us) : "");
  const told = drone.heard_us === undefined ? UNKNOWN : silent ? `Last contact ${seconds(drone.heard_us)}, ${age(ageOf(drone, nowUs))} ago: all below is as reported then` : `Reported ${age(ageOf(drone, nowUs))} ago`;
  const words = silent ? "No contact" : phaseWords(drone.phase);
  return [
    header([name, " ", html("span", {}, words)], told, mini(drone, silent ? "silent" : ""), silent ? "age old" : "age"),
    stepper([["Load", ""], ["Out", time(drone.launch_us)], ["Drop", drone.delivered ? "done" : time(drone.drop_us)], ["Back", ""], ["Land", time(drone.land_us)]], at),
    riskPart(drone, picture, silent),
    energyPart(drone, history),
    facts([
      ["Order", drone.order ? link(drone.order, [drone.order, picture.orders?.[drone.order]?.address].filter(Boolean).join(", ")) : "none"],
      ["Hold", drone.hold ?? ""], ["In place of", drone.in_place_of ?? ""], ["Pack", drone.pack ?? ""],
      ["Ends at", drone.diverted_to ?? (drone.asked ? `${drone.home ?? UNKNOWN}; ${drone.asked} requested` : drone.home ?? (drone.order ? "the depot" : ""))],
      ["Height, speed", drone.at ? `${number(drone.height_rel_m, 0, "m")}, ${number(drone.ground_speed_mps, 1, "m/s")}` : UNKNOWN],
      ["Wind there", drone.wind_to_ne_mps ? `${Math.hypot(...drone.wind_to_ne_mps).toFixed(1)} m/s ${fromWords(drone.wind_to_ne_mps)}` : UNKNOWN],
      ["Route", drone.way?.out || drone.way?.home ? (drone.way.straight ? "straight lines: its route is not reported" : "as uploaded") : ""],
      ["Message", drone.says ?? ""],
    ]),
    html("div", { class: "why" }, html("h3", {}, "Last decision"), drone.why ? html("p", {}, html("time", {}, seconds(drone.why_us)), html("span", { class: "decision" }, drone.why)) : html("p", { class: "muted" }, "No decision on this flight yet")),
    ["hold", "out"].includes(asking?.kind) && asking.subject === name ? holdForm(name, asking.kind === "out") : droneCommands(name, drone, picture, silent, alerts.get(name)),
  ];
}

function riskPart(drone, { max_loss: limit, risk_limit: limitWords }, silent) {
  if (!drone.risk) return html("div", { class: "promise" }, html("h3", {}, "Risk of not coming home"), html("p", { class: "muted" }, UNKNOWN, limitWords ? ` (limit ${limitWords})` : ""));
  return html("div", { class: "promise" }, html("h3", {}, "Risk of not coming home"),
    html("p", { class: "big risk" }, drone.risk, html("small", {}, limitWords ? `limit ${limitWords}` : "limit not reported yet")),
    limit && riskScale(1 - drone.p_home, limit, `risk ${drone.risk}, limit ${limitWords}; dot: by the model`), limit && html("p", { class: "muted ends" }, html("span", {}, "more"), html("span", {}, "dot: by the model"), html("span", {}, "less risk")),
    drone.risk_now && html("p", { class: "muted" }, silent ? "as reported then" : `If it turned back now: ${drone.risk_now} (limit ${limitWords || UNKNOWN})`));
}

// Risk on a log axis, with its limit.
function riskScale(loss, limit, words) {
  const { from, to } = RISK_DECADES;
  const at = (value) => 4 + (92 * (Math.min(to, Math.max(from, -Math.log10(Math.max(value, 1e-9)))) - from)) / (to - from);
  return svg("svg", { viewBox: "0 0 100 13", class: "scale", role: "img", "aria-label": words },
    svg("rect", { x: 4, y: 4, width: at(limit) - 4, height: 3, class: "bad" }), svg("rect", { x: at(limit), y: 4, width: 96 - at(limit), height: 3, class: "good" }),
    svg("line", { x1: at(limit), x2: at(limit), y1: 2, y2: 9, class: "limit" }), svg("circle", { cx: at(loss), cy: 5.5, r: 2.4, class: "dot" }));
}

function energyPart(drone, history) {
  const { margin_wh: spareWh, energy_left_wh: left, energy_needed_wh: need, full_wh: full, reserve_wh: reserve } = drone;
  if (spareWh === undefined) return html("div", { class: "promise" }, html("h3", {}, "Energy"), html("p", { class: "muted" }, left === undefined ? UNKNOWN : `${left.toFixed(0)} Wh left; spare ${UNKNOWN}`));
  const share = (wh) => Math.max(0, Math.min(100, (100 * wh) / full));
  const used = full === undefined || left === undefined ? null : Math.max(0, full - left);
  return html("div", { class: "promise" }, html("h3", {}, "Energy"),
    html("p", { class: "big spare-figure" }, wattHours(spareWh), html("small", {}, `${drone.spare_min === undefined ? "" : `${Math.round(drone.spare_min)} min `}to spare at landing`)),
    full && need !== undefined && svg("svg", { viewBox: "0 0 100 8", class: "energy", preserveAspectRatio: "none", role: "img", "aria-label": `${left.toFixed(0)} of ${full.toFixed(0)} Wh left, ${need.toFixed(0)} needed` },
      svg("rect", { width: 100, height: 8, class: "track" }), svg("rect", { width: share(Math.min(need, left)).toFixed(1), height: 8, class: "need" }), spareWh > 0 && svg("rect", { x: share(need).toFixed(1), width: share(spareWh).toFixed(1), height: 8, class: "spare" })),
    need !== undefined && html("p", { class: "legend" }, html("span", {}, html("i", { class: "need" }), `needed ${need.toFixed(0)}${reserve ? `, of it reserve ${reserve.toFixed(0)}` : ""}`), html("span", {}, html("i", { class: "spare" }), `spare ${Math.max(0, Math.round(spareWh))}`), used !== null && html("span", {}, html("i"), `used ${used.toFixed(0)}`)),
    spark(history));
}

function spark(history) {
  const samples = (history ?? []).filter((one) => one.margin_wh !== undefined);
  if (samples.length < 2) return null;
  const [from, to] = [samples[0].t_us, samples.at(-1).t_us];
  const most = Math.max(1, ...samples.map((one) => one.margin_wh));
  const points = samples.map((one) => `${(2 + (96 * (one.t_us - from)) / (to - from || 1)).toFixed(1)},${(28 - (24 * Math.max(0, one.margin_wh)) / most).toFixed(1)}`);
  return [svg("svg", { viewBox: "0 0 100 30", class: "spark", preserveAspectRatio: "none", "aria-hidden": "true" }, svg("path", { d: `M${points.join("L")}L98,28L2,28Z`, class: "under" }), svg("path", { d: `M${points.join("L")}`, class: "over" }), svg("line", { x1: 2, x2: 98, y1: 28, y2: 28, class: "base" })),
    html("p", { class: "muted ends" }, html("span", {}, `Spare since ${clock(from)}`), html("span", {}, "now"))];
}

function droneCommands(name, drone, { holds = [] }, silent, alert) {
  if (!mayCommand()) return null;
  const waits = alert === "your_turn" && drone.order && kindOf(drone) !== "out" && !drone.armed;
  return html("footer", {}, silent && html("p", { class: "muted" }, `A command may not arrive: no contact with ${name}.`),
    waits ? html("form", { class: "acts", "data-key": "launch" }, html("input", { type: "text", name: "pack", maxlength: 32, size: 8, autocomplete: "off", "aria-label": "Pack fitted", placeholder: "Pack fitted" }), command(`Launch ${name}`, { do: "confirm", order: drone.order }, "primary")) : command(`Recall ${name}`, { do: "recall", vehicle: name }, "danger"),
    holds.includes(name) ? command(`Release ${name}`, { do: "release", vehicle: name }) : button("Hold\u2026", "ask", `hold ${name}`),
    drone.hold?.includes(OUT) || isFlying(drone) ? null : button("Out of service\u2026", "ask", `out ${name}`, { class: "quiet" }));
}

function holdForm(vehicle, isOut) {
  const subject = vehicle ?? "all drones";
  const words = isOut ? `Take ${subject} out of service` : `Hold ${subject}`;
  return html("form", { class: "form ask", "data-key": words }, reasons(`Why is ${subject} ${isOut ? "out of service" : "held"}?`, isOut ? OUT_REASONS : HOLD_REASONS),
    isOut && html("input", { type: "text", name: "spare", maxlength: 64, autocomplete: "off", "aria-label": "Spare in its place", placeholder: "Spare in its place, if there is one" }),
    html("div", { class: "acts" }, command(words, { do: "hold", ...(vehicle && { vehicle }), ...(isOut && { out_of_service: true }) }, "danger", true), button("Keep", "ask", "", { class: "quiet" })));
}

// --- order, truck, all ----------------------------------------------------------------------------

export const NOT_ARRIVING = { open: "not planned yet", van: "not launched yet", air: UNKNOWN };

export function arrivalOf(id, order, { drones = {}, plan }) {
  const drone = drones[order.vehicle];
  if (order.state === "assigned" && drone?.order === id && drone.drop_us) return drone.drop_us;
  const sortie = plan?.sorties?.find((one) => one.order === id && one.state !== "lost");
  if (sortie?.drop_us) return sortie.drop_us;
  return Object.values(plan?.stops ?? {}).find((stop) => stop.serves?.includes(id))?.arrive_us;
}

export const carrierOf = (id, order, { plan }) => order.vehicle ?? plan?.sorties?.find((one) => one.order === id)?.vehicle
  ?? (Object.values(plan?.stops ?? {}).some((stop) => stop.serves?.includes(id)) ? "truck" : undefined);

function orderCard(id, order, picture, { nowUs, asking, record }) {
  const kind = orderKind(order, picture.drones);
  const by = carrierOf(id, order, picture);
  const arrives = arrivalOf(id, order, picture);
  const isOver = [...CLOSED, "stuck"].includes(kind);
  const form = asking?.subject === id && (["cancel", "return"].includes(asking.kind) ? cancelForm(id, asking.kind === "return") : asking.kind === "settle" ? settleForm(id, asking.settled) : asking.kind === "edit" ? editForm(id, order) : null);
  const own = record?.id === id ? record : null;
  return [
    header([order.customer ?? id, order.priority ? html("span", { class: "chip prio" }, "Priority") : null], [order.customer && id, `${order.mass_kg.toFixed(2)} kg`, by ? `by ${by}` : "by no vehicle yet"].filter(Boolean).join(" \u00b7 ")),
    stepper([["Received", ""], ["Loaded", ""], ["In the air", ""], [isOver && kind !== "stuck" ? ORDER_WORDS[kind] : "Delivered", ""]], { open: 0, van: 1, air: 2, stuck: 2, delivered: 4, cancelled: 3, returned: 3 }[kind]),
    html("div", { class: "promise" }, html("h3", {}, isOver ? "State" : "Arrives"), html("p", { class: "big" }, isOver ? ORDER_WORDS[kind] : arrives ? inTime(arrives, nowUs) : NOT_ARRIVING[kind]), order.why && html("p", { class: "muted" }, order.why)),
    proofPart(own?.proof),
    facts([["Window", windowWords(order, nowUs)], ["Address", order.address], ["Contact", order.phone && html("a", { href: `tel:${order.phone.replaceAll(" ", "")}` }, order.phone)], ["Note", order.note], ["Attempts", own?.attempts && String(own.attempts)], ["Position", order.at.map((degrees) => degrees.toFixed(5)).join(", ")], ["Confirmed", order.confirmed_by && `launch by ${order.confirmed_by}`], ["Drone", order.vehicle && link(order.vehicle)]]),
    form || orderCommands(id, kind),
    own && html("div", { class: "why" }, html("h3", {}, "History"), own.history.map(({ at_us: at, by, text }) => html("p", {}, html("time", {}, seconds(at)), html("span", {}, [by, text].filter(Boolean).join(": "))))),
  ];
}

// The confirmed release: when, where, and the evidence as the vehicle reported it.
function proofPart(proof) {
  if (!proof) return null;
  const place = proof.lat_deg === undefined ? "position not reported" : `at ${proof.lat_deg.toFixed(6)}, ${proof.lon_deg.toFixed(6)}`;
  return html("div", { class: "promise proof" }, html("h3", {}, "Proof of delivery"), html("p", { class: "big" }, seconds(proof.at_us)),
    html("p", { class: "muted" }, [proof.vehicle, place].filter(Boolean).join(", ")), html("p", {}, proof.evidence), proof.photo && html("p", { class: "muted" }, proof.photo));
}

function orderCommands(id, kind) {
  if (!mayCommand()) return null;
  const settle = ["stuck", "van", "air"].includes(kind) && [["delivered", "Delivered\u2026"], ["lost", "Lost\u2026"], ["back", "Came back\u2026"]].map(([end, words]) => button(words, "ask", `settle ${id} ${end}`));
  const cancel = ["open", "stuck", "van"].includes(kind) && [button("To sender\u2026", "ask", `return ${id}`), button("Cancel order\u2026", "ask", `cancel ${id}`, { class: "danger quiet" })];
  const edit = ["open", "stuck", "van", "air"].includes(kind) && button("Edit\u2026", "ask", `edit ${id}`);
  return settle || cancel || edit ? html("footer", {}, edit, settle, cancel) : null;
}

function cancelForm(id, toSender) {
  const [words, choices, name] = toSender ? ["returned to its sender", RETURN_REASONS, `Return ${id} to sender`] : ["cancelled", CANCEL_REASONS, `Cancel ${id}`];
  return html("form", { class: "form ask", "data-key": name }, reasons(`Why is ${id} ${words}?`, choices),
    html("div", { class: "acts" }, command(name, { do: "cancel", order: id, ...(toSender && { to_sender: true }) }, "danger", true), button("Keep it", "ask", "", { class: "quiet" })));
}

function settleForm(id, settled) {
  const words = { delivered: "as delivered", lost: "as lost", back: "as come back" }[settled];
  return html("form", { class: "form ask", "data-key": `settle ${id}` }, reasons(`How do you know that ${id} counts ${words}?`, SETTLE_REASONS),
    html("div", { class: "acts" }, command(`Settle ${id} ${words}`, { do: "settle", order: id, settled }, "danger", true), button("Not now", "ask", "", { class: "quiet" })));
}

function truckCard(truck, { plan }, { nowUs }) {
  const stops = (plan?.route ?? []).map((id) => [id, plan.stops[id]]).filter(([, stop]) => stop);
  return [
    header(["Truck ", html("span", {}, phaseWords(truck.phase))], truck.heard_us === undefined ? UNKNOWN : `Reported ${age(ageOf(truck, nowUs))} ago`, icon("truck")),
    html("div", { class: "promise" }, html("h3", {}, truck.phase === "driving" ? "Next stop" : "At"), html("p", { class: "big" }, truck.stop ?? UNKNOWN), html("p", { class: "muted" }, truckWords(truck, nowUs))),
    truck.waits_for?.length ? html("div", { class: "why" }, html("h3", {}, "Waits for"), truck.waits_for.map((words) => html("p", {}, words))) : null,
    html("div", { class: "why" }, html("h3", {}, "Stops"), stops.map(([id, stop]) => html("p", { class: stop.departed_us ? "muted" : "" }, html("time", {}, stop.arrive_us ? clock(stop.arrived_us ?? stop.arrive_us) : "not started"), html("span", {}, id)))),
  ];
}

function allCard({ asking }) {
  return [header("All drones", "Two steps each"),
    html("div", { class: "why" }, html("p", {}, "Recall brings every drone in the air home and holds it. Hold keeps every drone on the ground.")),
    asking?.kind === "hold" && !asking.subject ? holdForm(null) : html("footer", {}, command("Recall all", { do: "recall" }, "danger"), button("Hold all\u2026", "ask", "hold"), command("Release all", { do: "release" }))];
}

// What the next dispatcher has to know: the rest is in the lists.
function handoverCard(picture) {
  const { drones = {}, orders = {}, handover, notes = [], attention = [] } = picture;
  const named = (state) => Object.keys(orders).filter((id) => orders[id].state === state);
  const part = (title, rows) => rows.length ? html("div", { class: "why" }, html("h3", {}, title), rows.map((words) => html("p", {}, html("span", {}, words)))) : null;
  const flying = Object.entries(drones).filter(([, drone]) => isFlying(drone)).map(([name, drone]) => [name, phaseWords(drone.phase), drone.order, drone.land_us && `lands ${clock(drone.land_us)}`].filter(Boolean).join(", "));
  const loaded = named("assigned").filter((id) => !isFlying(drones[orders[id].vehicle] ?? {})).map((id) => `${id} on ${orders[id].vehicle}`);
  const told = (handover?.notes ?? []).map(({ at_us: at, by, text }) => `${clock(at)} ${by}: ${text}`);
  const state = !handover ? "No hand-over yet" : handover.accepted_by ? `Accepted by ${handover.accepted_by} at ${clock(handover.accepted_us)}` : `Handed over by ${handover.by} at ${clock(handover.at_us)}, not accepted yet`;
  return [header("Hand-over", state), part("Notes", told), part("In the air", flying), part("Loaded", loaded), part("Open orders", [named("open").join(", ")].filter(Boolean)),
    part("Needs the next dispatcher", attention.filter((item) => item.key !== "handover").map((item) => item.title)), part("Holds", notes),
    mayCommand() && html("form", { class: "form ask", "data-key": "handover" }, html("input", { type: "text", name: "note", maxlength: 200, autocomplete: "off", "aria-label": "Note", placeholder: "What the next dispatcher has to know" }),
      html("div", { class: "acts" }, command("Hand over", { do: "hand_over" }, "primary"), handover && !handover.accepted_by && handover.by !== me.name ? command("Accept the shift", { do: "accept" }) : null))];
}

function helpCard() {
  return [header("Keys"), html("dl", { class: "facts keys" }, KEYS.map(([key, words]) => html("div", {}, html("dt", {}, html("kbd", {}, key)), html("dd", {}, words)))),
    html("div", { class: "why" }, html("h3", {}, "Base map"), html("p", {}, "Streets need a base map: ground-station map --basemap town.pmtiles"))];
}

function signInCard() {
  return [header("Sign in"), html("form", { class: "form", "data-submit": "sign-in", "data-key": "sign-in" }, html("label", { class: "wide" }, "Token", html("input", { id: "token", type: "password", autocomplete: "off" })),
    html("p", { id: "who-trouble", class: "wide age old", role: "status" }, me.trouble), button("Sign in", "sign-in", "", { id: "use-token", class: "primary" }))];
}

