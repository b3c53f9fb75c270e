// Elements. Words become text nodes only: nothing that comes from outside is parsed as markup.

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

// Does a deed only if one of the things that it depends on is another one than the last time.
export function remembering() {
  const last = new Map();
  return (name, depends, deed) => {
    const before = last.get(name);
    if (before && before.every((one, k) => Object.is(one, depends[k]))) return;
    last.set(name, depends);
    deed();
  };
}

// One child of `parent` for each [key, item]: made once, told of every change, taken away at the end.
// With `look(item, key)` a child is left alone while its item is the same object and looks the same.
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

// A script of our own server, once it has run.
export function script(address) {
  return new Promise((done, failed) => {
    const element = html("script", { src: address });
    element.addEventListener("load", done);
    element.addEventListener("error", () => failed(new Error(`${address} is missing`)));
    document.head.append(element);
  });
}
