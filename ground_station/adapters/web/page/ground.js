// Ground without a base map, from the day: a grid, distance rings about the depot, and a soft hull of its places.

import { svg } from "./dom.js";
import { niceLength } from "./view.js";

const METRES_PER_DEG = 111_320;
const MAX_LINES = 60;

export function drawGround(view, depot, places) {
  if (!depot) return { shapes: [], rings: [] };
  const cosine = Math.cos((depot[0] * Math.PI) / 180) || 1e-6;
  const point = (north, east) => view.at([depot[0] + north / METRES_PER_DEG, depot[1] + east / METRES_PER_DEG / cosine]);
  const [top, left] = view.position([-view.width / 2, -view.height / 2]);
  const [low, right] = view.position([1.5 * view.width, 1.5 * view.height]);
  const north = [low, top].map((lat) => (lat - depot[0]) * METRES_PER_DEG);
  const east = [left, right].map((lon) => (lon - depot[1]) * METRES_PER_DEG * cosine);
  const step = [100, 1000, 10_000, 100_000].find((m) => m / view.metresPerPixel > 25 && (north[1] - north[0]) / m < MAX_LINES) ?? 1e6;
  const lines = [];
  const line = (a, b) => lines.push(`M${a.map((v) => v.toFixed(1))}L${b.map((v) => v.toFixed(1))}`);
  for (let m = Math.ceil(east[0] / step) * step; m < east[1]; m += step) line(point(north[0], m), point(north[1], m));
  for (let m = Math.ceil(north[0] / step) * step; m < north[1]; m += step) line(point(m, east[0]), point(m, east[1]));
  const hull = hullOf(places.map((place) => view.at(place)));
  const outline = hull.length ? `M${hull.map((p) => p.map((v) => v.toFixed(1)).join(",")).join("L")}Z` : "";
  const wide = Math.min(120, Math.max(16, 90 / view.metresPerPixel));
  const apart = niceLength(view.metresPerPixel * 200);
  const rings = [1, 2, 3].map((k) => ({ at: point(k * apart, 0), r: (k * apart) / view.metresPerPixel, words: distance(k * apart) }));
  const [x, y] = view.at(depot);
  return {
    shapes: [
      svg("path", { d: outline, class: "service edge", "stroke-width": wide + 3 }),
      svg("path", { d: outline, class: "service", "stroke-width": wide }),
      svg("path", { d: lines.join(""), class: "graticule" }),
      ...rings.map(({ r }) => svg("circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: r.toFixed(1), class: "ring" })),
    ],
    rings,
  };
}

export const distance = (metres) => (metres >= 1000 ? `${metres / 1000} km` : `${metres} m`);

// Convex hull (Andrew's monotone chain).
export function hullOf(points) {
  const turn = (a, b, c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (list) => {
    const hull = [];
    for (const p of list) {
      while (hull.length > 1 && turn(hull.at(-2), hull.at(-1), p) <= 0) hull.pop();
      hull.push(p);
    }
    return hull.slice(0, -1);
  };
  return sorted.length < 2 ? sorted : [...half(sorted), ...half(sorted.reverse())];
}
