// The user's PMTiles extract below our own drawing, by MapLibre GL; only where one was given.
// Layers are those of the Protomaps basemap schema (version 4). Without labels.

import { $, html, say } from "./dom.js";

const PAINTS = {
  light: { ground: "#f4f2ee", water: "#b9d3e6", green: "#dfe8d3", road: "#ffffff", house: "#ddd6cc", border: "#a0a0a0" },
  dark: { ground: "#1d2024", water: "#17334a", green: "#22301f", road: "#3a3f46", house: "#2c2f34", border: "#666666" },
};

export async function openBasemap(view, dark) {
  const style = html("link", { rel: "stylesheet", href: "/assets/maplibre-gl.css" });
  document.head.append(style);
  const [maplibre] = await Promise.all([import("/assets/maplibre-gl.mjs"), script("/assets/pmtiles.js")]);
  maplibre.setWorkerUrl("/assets/maplibre-gl-worker.mjs");
  const { Protocol, PMTiles } = globalThis.pmtiles;
  const archive = new PMTiles(`${location.origin}/basemap.pmtiles`);
  const protocol = new Protocol();
  protocol.add(archive);
  maplibre.addProtocol("pmtiles", protocol.tile);
  const header = await archive.getHeader();
  await attribute(archive);
  const map = new maplibre.Map({
    container: $("#basemap"),
    style: styleOf(dark ? PAINTS.dark : PAINTS.light, header),
    interactive: false,
    attributionControl: false,
    ...camera(view),
  });
  map.on("error", (event) => say($("#attribution"), `base map: ${event.error?.message ?? "failed"}`));
  return {
    follow: () => map.jumpTo(camera(view)),
    paint: (isDark) => map.setStyle(styleOf(isDark ? PAINTS.dark : PAINTS.light, header)),
  };
}

const camera = (view) => ({ center: [view.longitude, view.latitude], zoom: view.zoom });

// The extract's own words, as text: markup in them is shown, not obeyed.
async function attribute(archive) {
  const { attribution } = await archive.getMetadata();
  const words = new DOMParser().parseFromString(String(attribution ?? ""), "text/html").body.textContent;
  say($("#attribution"), words.trim() || "base map without attribution");
}

function script(address) {
  return new Promise((done, failed) => {
    const element = html("script", { src: address });
    element.addEventListener("load", done);
    element.addEventListener("error", () => failed(new Error(`${address} is missing`)));
    document.head.append(element);
  });
}

function styleOf(paint, header) {
  const layer = (name, type, colours, more = {}) =>
    ({ id: `${name}-${type}`, type, source: "town", "source-layer": name, paint: colours, ...more });
  return {
    version: 8,
    sources: { town: { type: "vector", url: `pmtiles://${location.origin}/basemap.pmtiles`, maxzoom: header.maxZoom } },
    layers: [
      { id: "ground", type: "background", paint: { "background-color": paint.ground } },
      layer("landuse", "fill", { "fill-color": paint.green }),
      layer("water", "fill", { "fill-color": paint.water }, { filter: ["==", ["geometry-type"], "Polygon"] }),
      layer("buildings", "fill", { "fill-color": paint.house }),
      layer("roads", "line", { "line-color": paint.road, "line-width": ["interpolate", ["linear"], ["zoom"], 10, 0.5, 17, 6] }),
      layer("boundaries", "line", { "line-color": paint.border, "line-dasharray": [3, 2] }),
    ],
  };
}
