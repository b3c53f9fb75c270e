// Optional base map below the drawing: the user's PMTiles extract, drawn by MapLibre GL.
// Supports the Protomaps basemap schema (version 4) and OpenMapTiles (version 3), which tilemaker
// writes. The browser draws names as images, because MapLibre would request glyphs from a server,
// and there is none.

import { $, html, say, script } from "./dom.js";

const PAINTS = {
  light: { ground: "#f4f2ee", water: "#b9d3e6", green: "#dfe8d3", road: "#c9c2b6", house: "#ddd6cc", border: "#a0a0a0", name: "#3c3c3c" },
  dark: { ground: "#1d2024", water: "#17334a", green: "#22301f", road: "#3a3f46", house: "#2c2f34", border: "#666666", name: "#d0d0d0" },
};

const NAME = "name ";
const NAMES_MS = 300;
const WORDS = ["coalesce", ["get", "name"], ["get", "name:latin"]]; // the second is tilemaker's
const [FONT, HEIGHT_PX, RIM_PX, RATIO] = ["12px system-ui, sans-serif", 18, 2, 2];

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
  let names = 0;
  let paint = dark ? PAINTS.dark : PAINTS.light;
  map.on("styleimagemissing", ({ id }) => {
    if (!id.startsWith(NAME) || map.hasImage(id)) return;
    map.addImage(id, nameImage(id.slice(NAME.length), paint), { pixelRatio: RATIO });
    clearTimeout(names); // a tile that was laid out meanwhile, during a zoom, lacks the name
    names = setTimeout(() => map.refreshTiles("town"), NAMES_MS);
  });
  map.on("error", (event) => say($("#attribution"), `base map: ${event.error?.message ?? "failed"}`));
  return {
    follow: () => map.jumpTo(camera(view)),
    paint: (isDark) => {
      paint = isDark ? PAINTS.dark : PAINTS.light;
      map.setStyle(styleOf(paint, header), { diff: false }); // a new style: redraws names
    },
  };
}

// Draws a name in the page's font, with an outline in the background colour.
function nameImage(words, paint) {
  const pen = new OffscreenCanvas(1, 1).getContext("2d");
  pen.font = FONT;
  const width = Math.ceil(pen.measureText(words).width) + 2 * RIM_PX;
  [pen.canvas.width, pen.canvas.height] = [width * RATIO, HEIGHT_PX * RATIO];
  pen.scale(RATIO, RATIO);
  Object.assign(pen, { font: FONT, textBaseline: "middle", lineJoin: "round", lineWidth: 2 * RIM_PX });
  [pen.strokeStyle, pen.fillStyle] = [paint.ground, paint.name];
  pen.strokeText(words, RIM_PX, HEIGHT_PX / 2);
  pen.fillText(words, RIM_PX, HEIGHT_PX / 2);
  return pen.getImageData(0, 0, width * RATIO, HEIGHT_PX * RATIO);
}

const camera = (view) => ({ center: [view.longitude, view.latitude], zoom: view.zoom });

// The extract's attribution as text: markup in it is shown, not interpreted.
async function attribute(archive) {
  const { attribution } = await archive.getMetadata();
  const words = new DOMParser().parseFromString(String(attribution ?? ""), "text/html").body.textContent;
  say($("#attribution"), words.trim() || "base map without attribution");
}

function styleOf(paint, header) {
  // `sources`: name of the layer in each schema.
  const layers = (sources, type, colours, more = {}) => sources.map((source) =>
    ({ id: `${source}-${type}`, type, source: "town", "source-layer": source, paint: colours, ...more }));
  const names = (sources, layout, minzoom) => sources.map((source) => ({
    id: `${source}-names`,
    type: "symbol",
    source: "town",
    "source-layer": source,
    minzoom,
    filter: ["any", ["has", "name"], ["has", "name:latin"]],
    layout: { "icon-image": ["concat", NAME, WORDS], "icon-padding": 4, ...layout },
  }));
  const only = (...types) => ({ filter: ["in", ["geometry-type"], ["literal", types]] });
  const wide = (thin, thick) => ["interpolate", ["linear"], ["zoom"], 10, thin, 17, thick];
  const alongRoad = { "symbol-placement": "line", "icon-rotation-alignment": "map", "icon-keep-upright": true };
  return {
    version: 8,
    sources: { town: { type: "vector", url: `pmtiles://${location.origin}/basemap.pmtiles`, maxzoom: header.maxZoom } },
    layers: [
      { id: "ground", type: "background", paint: { "background-color": paint.ground } },
      // In OpenMapTiles `landuse` is built-up area, not green space.
      ...layers(["landuse"], "fill", { "fill-color": paint.green }, { filter: ["!", ["has", "class"]] }),
      ...layers(["landcover", "park"], "fill", { "fill-color": paint.green }),
      ...layers(["water"], "fill", { "fill-color": paint.water }, only("Polygon", "MultiPolygon")),
      ...layers(["water", "waterway"], "line", { "line-color": paint.water, "line-width": wide(0.5, 4) }, only("LineString", "MultiLineString")),
      ...layers(["buildings", "building"], "fill", { "fill-color": paint.house }),
      ...layers(["roads", "transportation"], "line", { "line-color": paint.road, "line-width": wide(0.5, 6) }),
      ...layers(["boundaries", "boundary"], "line", { "line-color": paint.border, "line-dasharray": [3, 2] }),
      ...names(["roads", "transportation_name"], alongRoad, 14),
      ...names(["places", "place"], { "symbol-sort-key": ["coalesce", ["get", "sort_key"], ["get", "rank"], 0] }, 0),
    ],
  };
}
