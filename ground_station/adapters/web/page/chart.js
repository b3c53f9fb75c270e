// A drone's loss probability, 1 - P(home), over time on a log axis, with the energy margin below.

import { set, svg } from "./dom.js";
import { clock } from "./words.js";

const [WIDTH, LEFT] = [320, 44];
const LOSS = { top: 14, low: 94, least: 1e-5, most: 1 };
const MARGIN = { top: 112, low: 172 };

export function drawChart(figure, samples, maxLoss) {
  const [from, to] = [samples[0].t_us, samples[samples.length - 1].t_us];
  const x = (t) => LEFT + ((t - from) / (to - from || 1)) * (WIDTH - LEFT - 6);
  const loss = samples.filter((one) => one.p_home !== undefined).map((one) => [x(one.t_us), lossY(1 - one.p_home)]);
  const margins = samples.filter((one) => one.margin_wh !== undefined);
  const least = Math.min(0, ...margins.map((one) => one.margin_wh));
  const most = Math.max(1, ...margins.map((one) => one.margin_wh));
  const marginY = (wh) => MARGIN.low - ((wh - least) / (most - least)) * (MARGIN.low - MARGIN.top);
  const picture = svg("svg", { viewBox: `0 0 ${WIDTH} 192`, role: "img" });
  picture.append(svg("title", {}, "loss, 1 - P(home), and margin over time"));
  for (const decade of [1, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5]) rule(picture, lossY(decade), decade.toString().replace("1e-5", "0.00001"), "grid");
  if (maxLoss) rule(picture, lossY(maxLoss), "", "limit");
  rule(picture, marginY(most), `${most.toFixed(0)} Wh`, "grid");
  rule(picture, marginY(0), "0", least < 0 ? "limit" : "grid");
  line(picture, loss, "loss");
  line(picture, margins.map((one) => [x(one.t_us), marginY(one.margin_wh)]), "margin");
  picture.append(svg("text", { x: LEFT, y: 9 }, "loss 1 - P(home), by the model"), svg("text", { x: LEFT, y: 107 }, "margin"));
  picture.append(svg("text", { x: LEFT, y: 188 }, clock(from)), svg("text", { x: WIDTH - 6, y: 188, class: "end" }, clock(to)));
  figure.replaceChildren(picture);
}

function lossY(loss) {
  const bounded = Math.min(LOSS.most, Math.max(LOSS.least, loss));
  return LOSS.top + (Math.log10(LOSS.most / bounded) / Math.log10(LOSS.most / LOSS.least)) * (LOSS.low - LOSS.top);
}

function rule(picture, y, words, kind) {
  picture.append(svg("line", { x1: LEFT, x2: WIDTH - 6, y1: y, y2: y, class: kind }));
  picture.append(svg("text", { x: LEFT - 4, y: y + 3, class: "end" }, words));
}

function line(picture, points, kind) {
  const shape = svg("polyline", { class: kind });
  set(shape, { points: points.map((point) => point.map((v) => v.toFixed(1)).join(",")).join(" ") });
  picture.append(shape);
}
