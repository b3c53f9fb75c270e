// Forms that add and change orders: one, or those of a file. What can be said of them is said before they are saved.

import { button, html, icon } from "./dom.js";
import { header } from "./card.js";
import { live, me, send } from "./people.js";
import { post } from "./server.js";

const CHECK_MS = 400;
const KB = 1024;
const MOST_FILE_BYTES = 700 * KB; // of the server's limit of 1 MiB, in base64
const form = { verdict: null, file: null, timer: 0 };

export const startForm = (number) => Object.assign(form, { id: number, verdict: null, file: null, before: null });
export const hasForm = () => Boolean(fieldsNow());

// Fields of an order: column, words, attributes, class.
const FIELDS = [["customer", "Customer", { maxlength: 100 }], ["phone", "Phone", { type: "tel", maxlength: 40 }], ["address", "Address", { maxlength: 200 }, "wide"],
  ["window_from", "From", { type: "datetime-local" }, "wide"], ["window_to", "To", { type: "datetime-local" }, "wide"],
  ["mass_kg", "Weight, kg", { inputmode: "decimal" }], ["priority", "Priority", {}],
  ["lat_deg", "Latitude", { inputmode: "decimal" }], ["lon_deg", "Longitude", { inputmode: "decimal" }], ["alt_amsl_m", "Ground height, m (empty: the day's)", { inputmode: "decimal" }, "wide"],
  ["note", "Note for the drop", { maxlength: 500 }, "wide"]];
const NUMBERS = ["mass_kg", "lat_deg", "lon_deg", "alt_amsl_m"];
const TIMES = ["window_from", "window_to"];
const fieldsNow = () => document.querySelector("#card form.order-form")?.elements;

function inputs(values) {
  return FIELDS.map(([name, words, attributes, kind = ""]) => html("label", { class: kind }, words, name === "priority"
    ? html("select", { name }, ["normal", "urgent"].map((one) => html("option", { value: one, selected: one === values.priority }, one)))
    : html("input", { type: "text", name, autocomplete: "off", "data-check": true, value: values[name] ?? null, ...attributes })));
}

export function newOrderCard() {
  return [header("New order", "At the desk as soon as you save it"),
    html("form", { class: "form order-form", "data-key": "new", "data-submit": "save-order" },
      html("label", { class: "wide" }, "Order", html("input", { type: "text", name: "id", autocomplete: "off", "data-check": true, maxlength: 40, value: form.id })),
      inputs({}), html("p", { class: "muted wide" }, "Click the map to set the pin."), verdict()),
    html("footer", {}, button("Save order", "save-order", "", { class: "primary", disabled: !live.now || !form.verdict?.ok }), button("Discard", "close", "", { class: "quiet" }))];
}

// What the state does not permit, the desk refuses with its reason.
export function editForm(id, order) {
  form.before ??= valuesOf(order);
  return html("form", { class: "form order-form", "data-key": `edit ${id}`, "data-submit": "save-change" }, html("h3", { class: "wide" }, `Change ${id}`), inputs(form.before),
    html("p", { class: "muted wide" }, "A new place or weight takes the order from a drone on the ground and plans it again."), form.verdict && verdict(),
    html("div", { class: "acts wide" }, button("Save change", "save-change", "", { class: "primary", disabled: !live.now || form.verdict?.ok === false }), button("Discard", "ask", "", { class: "quiet" })));
}

function valuesOf({ customer = "", phone = "", address = "", note = "", mass_kg: kg, priority, earliest_us: from, latest_us: to, at }) {
  return { customer, phone, address, note, mass_kg: String(kg), priority: priority ? "urgent" : "normal", lat_deg: String(at[0]), lon_deg: String(at[1]), alt_amsl_m: "", window_from: localValue(from), window_to: localValue(to) };
}

const localValue = (us) => (us === undefined ? "" : new Date(us / 1000 - 60_000 * new Date(us / 1000).getTimezoneOffset()).toISOString().slice(0, 16));
const isoValue = (local) => (local ? new Date(local).toISOString().replace(/\.\d+/, "") : ""); // in the zone of this browser

const verdict = () => html("p", { class: `verdict wide${form.verdict && !form.verdict.ok ? " bad" : ""}`, role: "status" }, form.verdict ? [icon(form.verdict.can ? "tick" : "caution"), html("span", {}, form.verdict.words)] : "Give position and weight: the desk then says whether it can be flown.");

export function setPin([lat, lon], redraw) {
  const fields = fieldsNow();
  [fields.lat_deg.value, fields.lon_deg.value] = [lat.toFixed(6), lon.toFixed(6)];
  checkSoon(redraw);
}

export function pin() {
  const fields = fieldsNow();
  const at = fields && [Number(fields.lat_deg.value), Number(fields.lon_deg.value)];
  return at && at.every(Number.isFinite) && at[0] ? at : null;
}

function cells() {
  const fields = fieldsNow();
  const read = ([name]) => [name, NUMBERS.includes(name) ? fields[name].value.trim().replace(",", ".") : TIMES.includes(name) ? isoValue(fields[name].value) : fields[name].value.trim()];
  return Object.fromEntries([...(fields.id ? [["id", fields.id.value.trim()]] : []), ...FIELDS.map(read)]);
}

// The fields that differ from the order's; an empty one removes the value.
function changes() {
  const before = { ...form.before, ...Object.fromEntries(TIMES.map((name) => [name, isoValue(form.before[name])])) };
  return Object.fromEntries(Object.entries(cells()).filter(([name, value]) => value !== before[name]));
}

const given = (table) => Object.fromEntries(Object.entries(table).filter(([, value]) => value));

export function checkSoon(redraw) {
  clearTimeout(form.timer);
  form.timer = setTimeout(async () => {
    if (!fieldsNow()) return;
    const asked = given(cells());
    if (!asked.mass_kg || !asked.lat_deg || !asked.lon_deg) return;
    form.verdict = await checked({ do: "add", cells: { id: "changed", ...asked }, check: true });
    redraw();
  }, CHECK_MS);
}

async function checked(deed) {
  const answer = await post("/commands", deed);
  const found = await answer?.json().catch(() => null);
  if (!found) return { ok: false, words: "No connection: not checked" };
  if (!answer.ok) return { ok: false, words: found.error };
  const words = [...found.checks, ...found.messages].join(" ") || "The day is not known to the map: not checked";
  return { ok: true, can: !found.checks.length, words };
}

export async function saveOrder() {
  const asked = given(cells());
  return (await send(`Order ${asked.id}`, { do: "add", cells: asked })) ? asked.id : null;
}

export const saveChange = (id) => send(`Change of ${id}`, { do: "change", order: id, cells: changes() });

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
