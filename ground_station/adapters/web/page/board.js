// The orders as a table by state, and the driver's list, which prints and exports the same rows.

import { button, html, keyed, morph, set } from "./dom.js";
import { arrivalOf, carrierOf, NOT_ARRIVING } from "./card.js";
import { mayAdd } from "./forms.js";
import { byName, clock, CLOSED, ORDER_WORDS, orderKind, windowWords } from "./words.js";

const GROUPS = ["stuck", "air", "van", "open", ...CLOSED];
const COLUMNS = ["Order", "Customer", "Address", "Window", "Arrives", "By", "Weight", "Note"];
const DRIVER_COLUMNS = ["Stop", "Arrive", "Leave", "Do", "Order", "Drone", "kg", "Window", "Priority", "Customer", "Address", "Phone", "Note"];
const find = { text: "", chip: "all" };

export const setSearch = (text) => { find.text = text.toLowerCase(); };
export const setChip = (chip) => { find.chip = chip; };

export function drawBoard(board, picture, { nowUs, selected }) {
  const { orders = {}, drones = {} } = picture;
  const rows = Object.entries(orders).map(([id, order]) => ({ id, order, kind: orderKind(order, drones), arrives: arrivalOf(id, order, picture), by: carrierOf(id, order, picture) }));
  const count = (kind) => rows.filter((row) => row.kind === kind).length;
  const chip = (key, words, n) => button([words, html("b", {}, String(n))], "chip", key, { class: "chip", "aria-pressed": String(find.chip === key) });
  const has = (row) => [row.id, row.order.customer, row.order.address, row.order.note, row.by].some((words) => words?.toLowerCase().includes(find.text));
  const shown = rows.filter((row) => (find.chip === "all" || row.kind === find.chip) && (!find.text || has(row)));
  morph(board, [html("div", { class: "board-head", "data-key": "head" },
    html("label", { class: "find" }, html("input", { type: "search", id: "search", placeholder: "Order, name, street", "aria-label": "Search orders" })),
    chip("all", "All", rows.length), GROUPS.filter((kind) => count(kind)).map((kind) => chip(kind, ORDER_WORDS[kind], count(kind))),
    html("div", { class: "right" }, mayAdd() && [button("Add order", "select", "new", { class: "primary" }, "plus"), button("Import\u2026", "select", "import")], button("Driver's list", "view", "driver"))),
  html("div", { class: "table", "data-key": "table", tabindex: 0, role: "region", "aria-label": "Table of orders" }, html("table", { "data-own": true }))]);
  const table = board.querySelector("table");
  if (!table.tHead) table.append(html("thead", {}, html("tr", {}, COLUMNS.map((words) => html("th", { scope: "col" }, words)))));
  const groups = GROUPS.map((kind) => [kind, shown.filter((row) => row.kind === kind).sort((a, b) => (a.arrives ?? Infinity) - (b.arrives ?? Infinity) || byName(a.id, b.id))]).filter(([, list]) => list.length);
  keyedBodies(table, groups, nowUs, selected);
}

function keyedBodies(table, groups, nowUs, selected) {
  const bodies = new Map([...table.tBodies].map((body) => [body.dataset.kind, body]));
  for (const [kind, list] of groups) {
    const body = bodies.get(kind) ?? html("tbody", { "data-kind": kind });
    bodies.delete(kind);
    table.append(body);
    const entries = [[`group ${kind}`, { kind, n: list.length }], ...list.map((row) => [row.id, row])];
    keyed(body, entries, () => html("tr"), (tr, row, key) => {
      if (row.n) return morph(tr, [html("th", { colspan: COLUMNS.length, scope: "rowgroup" }, ORDER_WORDS[row.kind], html("span", {}, String(row.n)))]), set(tr, { class: "group" });
      set(tr, { class: `${row.kind}${key === selected ? " chosen" : ""}`, "data-do": "select", "data-with": key });
      if (tr.drawn && tr.drawn.order === row.order && tr.drawn.arrives === row.arrives && tr.drawn.by === row.by && tr.drawn.kind === row.kind) return undefined;
      tr.drawn = row;
      const { order } = row;
      return morph(tr, [
        html("td", {}, html("span", { class: `mark ${row.kind}` }), button(key, "select", key, { class: "plain" })),
        html("td", {}, order.customer && html("b", {}, order.customer), order.priority && html("span", { class: "chip prio" }, "Priority")),
        html("td", {}, order.address ?? ""),
        html("td", { class: "num" }, windowWords(order, nowUs)),
        html("td", { class: "num" }, [...CLOSED, "stuck"].includes(row.kind) ? "" : row.arrives ? html("b", {}, clock(row.arrives)) : NOT_ARRIVING[row.kind]),
        html("td", {}, row.by ?? ""), html("td", { class: "num" }, `${order.mass_kg.toFixed(2)} kg`), html("td", { class: "note" }, order.why || order.note || "")]);
    });
  }
  for (const body of bodies.values()) body.remove();
}

// --- the driver's list ----------------------------------------------------------------------------

// The rows of `ground-station manifest`, in the zone of this browser.
export function driverRows({ manifest = [], orders = {} }, nowUs) {
  const time = (us) => (us ? clock(us) : "not started");
  return manifest.map(({ stop, arrive_us: arrive, leave_us: leave, does, order: id, drone = "" }) => {
    const { mass_kg: kg, customer = "", address = "", phone = "", note = "", priority, ...order } = orders[id] ?? {};
    return [stop, time(arrive), time(leave), does, id, drone, kg === undefined ? "" : kg.toFixed(2), windowWords(order, nowUs), priority ? "urgent" : "", customer, address, phone, note];
  });
}

export function driverCsv(picture, nowUs) {
  const harmless = (value) => (/^[=@\t\r]|^[+-](?![\d ()/-]*$)/.test(value) ? `'${value}` : value); // no formula for a spreadsheet
  const cell = (value) => (/[",\n;]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value);
  return [DRIVER_COLUMNS, ...driverRows(picture, nowUs)].map((cells) => cells.map((value) => cell(harmless(String(value)))).join(",")).join("\r\n");
}

export function drawDriverList(board, picture, nowUs) {
  const rows = driverRows(picture, nowUs);
  morph(board, [
    html("div", { class: "board-head", "data-key": "driver-head" }, html("h2", {}, "Driver's list"), html("div", { class: "right" }, button("Print", "print", "", { class: "primary" }), button("CSV", "csv"), button("Orders", "view", "orders"))),
    html("div", { class: "table driver", "data-key": "driver", tabindex: 0, role: "region", "aria-label": "Driver's list" },
      html("p", { class: "print-head" }, `${picture.fleet ?? ""}, ${picture.plan?.title ?? "no plan with a truck"}. Printed ${clock(nowUs)}.`),
      rows.length ? html("table", {}, html("thead", {}, html("tr", {}, DRIVER_COLUMNS.map((words) => html("th", { scope: "col" }, words)))), html("tbody", {}, rows.map((cells, k) => html("tr", {}, cells.map((value, column) => html("td", {}, column < 3 && k && rows[k - 1][0] === cells[0] ? "" : value))))))
        : html("p", { class: "calm" }, "No stop has work for the driver."))]);
}

export function saveFile(name, words) {
  const address = URL.createObjectURL(new Blob(["\ufeff", words], { type: "text/csv" }));
  const anchor = html("a", { href: address, download: name });
  document.body.append(anchor);
  anchor.click();
  anchor.remove();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

