// Forms that add orders: one, or those of a file. What can be said of them is said before they are saved.

import { button, html, icon } from "./dom.js";
import { header } from "./card.js";
import { live, me, send } from "./people.js";
import { post } from "./server.js";

const CHECK_MS = 400;
const KB = 1024;
const MOST_FILE_BYTES = 700 * KB; // of the server's limit of 1 MiB, in base64
const form = { verdict: null, file: null, timer: 0 };

export const startForm = (number) => Object.assign(form, { id: number, verdict: null, file: null });

export function newOrderCard() {
  const field = (name, words, attributes = {}, kind = "") => html("label", { class: kind }, words, html("input", { type: "text", name, autocomplete: "off", "data-check": true, ...attributes }));
  return [header("New order", "At the desk as soon as you save it"),
    html("form", { class: "form", "data-key": "new", "data-submit": "save-order" },
      field("id", "Order", { value: form.id, maxlength: 40 }), field("mass_kg", "Weight, kg", { inputmode: "decimal" }),
      field("lat_deg", "Latitude", { inputmode: "decimal" }), field("lon_deg", "Longitude", { inputmode: "decimal" }),
      html("p", { class: "muted wide" }, "Click the map to set the pin."),
      field("alt_amsl_m", "Ground height, m (empty: the day's)", { inputmode: "decimal" }, "wide"),
      field("note", "Note for the drop", { maxlength: 500 }, "wide"), verdict()),
    html("footer", {}, button("Save order", "save-order", "", { class: "primary", disabled: !live.now || !form.verdict?.ok }), button("Discard", "close", "", { class: "quiet" }))];
}

const verdict = () => html("p", { class: `verdict wide${form.verdict && !form.verdict.ok ? " bad" : ""}`, role: "status" }, form.verdict ? [icon(form.verdict.can ? "tick" : "caution"), html("span", {}, form.verdict.words)] : "Give position and weight: the desk then says whether it can be flown.");

export function setPin([lat, lon], redraw) {
  const fields = document.querySelector('#card form[data-key="new"]')?.elements;
  if (!fields) return;
  [fields.lat_deg.value, fields.lon_deg.value] = [lat.toFixed(6), lon.toFixed(6)];
  checkSoon(redraw);
}

export function pin() {
  const fields = document.querySelector('#card form[data-key="new"]')?.elements;
  const at = fields && [Number(fields.lat_deg.value), Number(fields.lon_deg.value)];
  return at && at.every(Number.isFinite) && at[0] ? at : null;
}

function cells() {
  const fields = document.querySelector('#card form[data-key="new"]').elements;
  return Object.fromEntries(["id", "mass_kg", "lat_deg", "lon_deg", "alt_amsl_m", "note"].map((name) => [name, fields[name].value.trim()])
    .map(([name, value]) => [name, ["id", "note"].includes(name) ? value : value.replace(",", ".")]).filter(([, value]) => value));
}

export function checkSoon(redraw) {
  clearTimeout(form.timer);
  form.timer = setTimeout(async () => {
    const asked = cells();
    if (!asked.mass_kg || !asked.lat_deg || !asked.lon_deg) return;
    form.verdict = await checked({ do: "add", cells: asked, check: true });
    redraw();
  }, CHECK_MS);
}

async function checked(deed) {
  const answer = await post("/deeds", deed);
  const found = await answer?.json().catch(() => null);
  if (!found) return { ok: false, words: "No connection: not checked" };
  if (!answer.ok) return { ok: false, words: found.trouble };
  const words = found.words.join(" ") || "The day is not known to the map: not checked";
  return { ok: true, can: !words.includes("cannot be flown"), words };
}

export async function saveOrder() {
  const asked = cells();
  return (await send(`Order ${asked.id}`, { do: "add", cells: asked })) ? asked.id : null;
}

// --- a file ---------------------------------------------------------------------------------------

export function importCard() {
  return [header("Import orders", "CSV with commas, semicolons or tabs; Excel; GeoJSON. All rows or none"),
    html("form", { class: "form", "data-key": "import" }, html("label", { class: "wide" }, "File", html("input", { type: "file", id: "file", accept: ".csv,.txt,.tsv,.xlsx,.geojson" })),
      form.verdict && html("p", { class: `verdict wide${form.verdict.ok ? "" : " bad"}`, role: "status" }, form.verdict.words)),
    html("footer", {}, button("Import", "save-file", "", { class: "primary", disabled: !live.now || !form.verdict?.ok }), button("Discard", "close", "", { class: "quiet" }))];
}

export async function fileChosen(file, redraw) {
  form.file = null;
  if (file.size > MOST_FILE_BYTES) form.verdict = { ok: false, words: `${file.name}: ${(file.size / KB).toFixed(0)} KiB, expected at most ${MOST_FILE_BYTES / KB} KiB: use ground-station order import` };
  else {
    const bytes = new Uint8Array(await file.arrayBuffer());
    let text = "";
    for (const byte of bytes) text += String.fromCharCode(byte);
    form.file = { do: "import", file: file.name.replace(/[/\\]/g, "_").slice(-80), content: btoa(text) };
    form.verdict = await checked({ ...form.file, check: true });
  }
  redraw();
}

export const saveFile = () => (form.file ? send(`Import of ${form.file.file}`, form.file) : null);
export const mayAdd = () => me.mayOrder && !live.past;
