// Details of one drone or order; for a drone also its loss probability over time.

import { $, html, keyed, say } from "./dom.js";
import { drawChart } from "./chart.js";
import { ago, clock, figure, homeWords, measure } from "./words.js";

export function drawDetail(picture, { selected, history, nowUs }) {
  const panel = $("#detail");
  const drone = picture.drones?.[selected];
  const order = picture.orders?.[selected];
  panel.hidden = !drone && !order;
  if (panel.hidden) return;
  if (!panel.firstChild) panel.append(html("h2"), html("figure"), html("dl"));
  const [head, chart, list] = panel.children;
  say(head, selected);
  const rows = drone ? droneRows(drone, nowUs) : orderRows(order);
  const make = (key) => html("div", {}, html("dt", {}, key), html("dd"));
  keyed(list, rows.map((row) => [row[0], row]), make, (row, [, words]) => say(row.children[1], words));
  chart.hidden = !drone || !history?.length;
  if (!chart.hidden) drawChart(chart, history, picture.max_loss);
}

function droneRows(drone, nowUs) {
  const alarms = (drone.alarms ?? []).map((words, k) => [k ? `alarm (${k + 1})` : "alarm", words]);
  return [
    ...alarms,
    ["phase", drone.phase],
    ["reason", drone.why ? `${drone.why} (${clock(drone.why_us)})` : "no decision on this flight yet"],
    ["status", drone.says ?? ""],
    ["P(home)", homeWords(drone.p_home, drone.p_home_limit)],
    ["P(home), turning back", homeWords(drone.p_home_now, drone.p_home_limit)],
    ["P(delivered, home)", drone.p_success === undefined ? "-" : figure(Math.min(drone.p_success, drone.p_home_limit ?? 1), 3)],
    ["margin", measure(drone.margin_wh, 1, "Wh")],
    ["energy left", measure(drone.energy_left_wh, 1, "Wh")],
    ["order", drone.order ? `${drone.order}${drone.delivered ? ", delivered" : ""}` : "-"],
    ["ends at", drone.asked ? `${drone.home ?? "-"}, requested: ${drone.asked}` : drone.home ?? "-"],
    ["route", wayWords(drone.way)],
    ["height, speed", `${measure(drone.height_rel_m, 0, "m")}, ${measure(drone.ground_speed_mps, 1, "m/s")}`],
    ["last message", ago(drone.heard_us, nowUs)],
  ];
}

function wayWords(way) {
  if (!way?.out && !way?.home) return "-";
  return way.straight ? "straight lines: route not reported" : "onboard route";
}

function orderRows(order) {
  return [
    ["state", order.state],
    ["reason", order.why ?? ""],
    ["by", order.vehicle ?? "-"],
    ["mass", measure(order.mass_kg, 2, "kg")],
    ["note", order.note ?? ""],
    ["position", order.at.map((degrees) => degrees.toFixed(5)).join(", ")],
  ];
}
