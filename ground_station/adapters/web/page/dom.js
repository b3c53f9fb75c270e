// DOM helpers. Texts become text nodes only: external data is never parsed as markup.
// Events are delegated: elements name their action in `data-do`, so an update never loses a listener.

const SVG = "http://www.w3.org/2000/svg";

export const $ = (selector) => document.querySelector(selector);
export const html = (tag, attributes = {}, ...children) => filled(document.createElement(tag), attributes, children);
export const svg = (tag, attributes = {}, ...children) => filled(document.createElementNS(SVG, tag), attributes, children);

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.flat(4).filter((one) => one !== null && one !== undefined && one !== false && one !== ""));
  return element;
}

export function set(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    const text = String(value);
    if (element.getAttribute(name) !== text) element.setAttribute(name, text);
  }
}

export function say(element, words) {
  if (element.textContent !== words) element.textContent = words;
}

// Makes the children of `parent` equal to `children`, and keeps elements that are alike: focus, typed
// text and scroll positions survive an update. Elements are matched by data-key, else by position.
export function morph(parent, children) {
  const after = children.flat(4).filter((one) => one !== null && one !== undefined && one !== false && one !== "")
    .map((one) => (typeof one === "string" ? document.createTextNode(one) : one));
  const named = new Map([...parent.children].filter((one) => one.dataset?.key).map((one) => [one.dataset.key, one]));
  let here = parent.firstChild;
  for (const fresh of after) {
    const key = fresh.dataset?.key;
    let old = key ? named.get(key) : here;
    if (key && old && old !== here) {
      const focused = document.activeElement; // a move takes the focus away
      parent.insertBefore(old, here);
      if (old.contains(focused)) focused.focus({ preventScroll: true });
    }
    if (!key && old?.dataset?.key && after.some((one) => one.dataset?.key === old.dataset.key)) old = null;
    if (old && alike(old, fresh)) {
      here = old.nextSibling;
      if (old.nodeType === Node.TEXT_NODE) say(old, fresh.data);
      else {
        attributesOf(old, fresh);
        if (!old.hasAttribute("data-own")) morph(old, [...fresh.childNodes]);
      }
    } else parent.insertBefore(fresh, here);
  }
  while (here) {
    const next = here.nextSibling;
    here.remove();
    here = next;
  }
}

const alike = (old, fresh) => old.nodeType === fresh.nodeType && old.nodeName === fresh.nodeName && old.dataset?.key === fresh.dataset?.key;

function attributesOf(old, fresh) {
  for (const { name } of [...old.attributes]) if (!fresh.hasAttribute(name) && name !== "open") old.removeAttribute(name);
  for (const { name, value } of fresh.attributes) if (old.getAttribute(name) !== value) old.setAttribute(name, value);
}

// Calls a function only if one of its dependencies has changed since the last call.
export function remembering() {
  const last = new Map();
  return (name, depends, deed) => {
    const before = last.get(name);
    if (before && before.length === depends.length && before.every((one, k) => Object.is(one, depends[k]))) return;
    last.set(name, depends);
    deed();
  };
}

// Keeps one child of `parent` per [key, item]: created once, updated on change, removed at the end.
// With `look(item, key)` a child is not updated while item and result of `look` are unchanged.
export function keyed(parent, entries, make, update, look) {
  const there = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  let before = null;
  for (const [key, item] of entries) {
    let child = there.get(key);
    there.delete(key);
    if (!child) {
      child = make(key, item);
      child.dataset.key = key;
    }
    const looks = look?.(item, key);
    if (!look || child.shownItem !== item || child.shownLook !== looks) {
      update(child, item, key);
      [child.shownItem, child.shownLook] = [item, looks];
    }
    const next = before ? before.nextElementSibling : parent.firstElementChild;
    if (next !== child) parent.insertBefore(child, next);
    before = child;
  }
  for (const child of there.values()) child.remove();
}

// Resolves after a script from this server has run.
export function script(address) {
  return new Promise((done, failed) => {
    const element = html("script", { src: address });
    element.addEventListener("load", done);
    element.addEventListener("error", () => failed(new Error(`${address} is missing`)));
    document.head.append(element);
  });
}

// Icons of 16 px, one path each; stroke only.
export const ICONS = {
  warning: "M8 1.8L15 14.2H1Z M8 6v4 M8 12v.4",
  your_turn: "M5 1.8l9 6.2-9 6.2z",
  caution: "M8 1.2L14.8 8 8 14.8 1.2 8Z M8 4.8v3.8 M8 10.8v.4",
  close: "M3.5 3.5l9 9M12.5 3.5l-9 9",
  plus: "M8 3v10M3 8h10",
  minus: "M3 8h10",
  fit: "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4",
  truck: "M1 4h8.5v7.5H1Z M9.5 6.5H13l2 2.6v2.4H9.5 M4 11.5a1.5 1.5 0 1 0 .1 0M12 11.5a1.5 1.5 0 1 0 .1 0",
  drone: "M3.5 3.5l9 9M12.5 3.5l-9 9M1.2 3.4a2.2 2.2 0 1 0 4.4 0a2.2 2.2 0 1 0-4.4 0M10.4 3.4a2.2 2.2 0 1 0 4.4 0a2.2 2.2 0 1 0-4.4 0M1.2 12.6a2.2 2.2 0 1 0 4.4 0a2.2 2.2 0 1 0-4.4 0M10.4 12.6a2.2 2.2 0 1 0 4.4 0a2.2 2.2 0 1 0-4.4 0",
  box: "M2 4.5L8 1.8l6 2.7v7L8 14.2l-6-2.7Z M2 4.5L8 7.2l6-2.7 M8 7.2v7",
  map: "M1.8 3.6l4-1.6 4.4 1.8 4-1.6v10.2l-4 1.6-4.4-1.8-4 1.6Z M5.8 2v10.2 M10.2 3.8V14",
  clock: "M8 1.6a6.4 6.4 0 1 0 .1 0 M8 4.4V8l2.6 1.8",
  tick: "M2.5 8.5l3.6 3.6 7.4-8",
};
export const icon = (name) => svg("svg", { viewBox: "0 0 16 16", class: "icon", "aria-hidden": "true" }, svg("path", { d: ICONS[name] }));

// A button whose click calls the action `does` with `argument` (main.js).
export const button = (words, does, argument = "", attributes = {}, sign = null) =>
  html("button", { type: "button", "data-do": does, "data-with": argument, ...attributes }, sign && icon(sign), words);
