// Coasts and borders of the world if there is no base map: Natural Earth, scale 1:50 million.

import { $, say, script, set, svg } from "./dom.js";

const ADDRESS = "/assets/countries-50m.json";
const SCRIPTS = ["topojson-client", "d3-array", "d3-geo"]; // in this order: each depends on the previous one
const NEAREST_ZOOM = 8; // at higher zoom its lines are kilometres off
const PATH_PX = 512 * 2 ** 6; // width of the world in path coordinates

export async function openOutline(view, otherwise) {
  const found = await fetch(ADDRESS);
  if (!found.ok) throw new Error(`${ADDRESS}: ${found.status}`);
  for (const name of SCRIPTS) await script(`/assets/${name}.js`);
  const drawing = drawn(await found.json());
  $("#basemap").append(svg("svg", { id: "outline" }, drawing));
  const follow = () => {
    const seen = view.zoom <= NEAREST_ZOOM;
    set(drawing, { display: seen ? "inline" : "none" });
    say($("#attribution"), seen ? "Outline: Natural Earth" : otherwise);
    if (!seen) return;
    const [x, y] = [view.width / 2 - view.x * view.scale, view.height / 2 - view.y * view.scale];
    set(drawing, { transform: `translate(${x.toFixed(1)},${y.toFixed(1)}) scale(${view.scale / PATH_PX})` });
  };
  return { follow, paint: () => {} }; // uses the page's colours
}

function drawn(topology) {
  const { d3, topojson } = globalThis;
  const { land, countries } = topology.objects;
  const mercator = d3.geoMercator().scale(PATH_PX / (2 * Math.PI)).translate([PATH_PX / 2, PATH_PX / 2]).precision(0);
  const path = d3.geoPath(mercator);
  const borders = topojson.mesh(topology, countries, (one, other) => one !== other);
  return svg("g", {},
    svg("path", { class: "land", d: path(topojson.feature(topology, land)) }),
    svg("path", { class: "borders", d: path(borders) }));
}
