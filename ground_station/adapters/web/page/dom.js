// DOM helpers. Texts become text nodes only: external data is never parsed as markup.

const SVG = "http://www.w3.org/2000/svg";

export const $ = (selector) => document.querySelector(selector);

export function html(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

export function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

function filled(element, attributes, children) {
  set(element, attributes);
  element.append(...children);
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

// Calls a function only if one of its dependencies has changed since the last call.
export function remembering() {
  const last = new Map();
  return (name, depends, deed) => {
    const before = last.get(name);
    if (before && before.every((one, k) => Object.is(one, depends[k]))) return;
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
