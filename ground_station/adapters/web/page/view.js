// Viewport of the map: Web Mercator (EPSG:3857), the world 512 px wide at zoom 0, as in MapLibre.

const TILE = 512;
const MOST_ZOOM = 20;
const FAR_PX = 20000; // SVG coordinates are single precision: 0.002 px there
const MOST_STRETCH = 1; // zoom levels by which a drawing is scaled before it is redrawn
const CLICK_PX = 6; // a pointer that moves further drags
const REST_MS = 120; // delay after the last zoom step until everything is redrawn
const EARTH_M = 40075016.7; // equator length of EPSG:3857

export function unit([lat, lon]) {
  const sine = Math.sin((lat * Math.PI) / 180);
  return [0.5 + lon / 360, 0.5 - Math.log((1 + sine) / (1 - sine)) / (4 * Math.PI)];
}

// Elements are drawn relative to an anchor, and panning moves the drawing as one element. While zooming,
// the drawing is also scaled; it is redrawn when the motion has ended.
export class View {
  constructor(element, moved) {
    this.element = element;
    this.moved = moved;
    [this.x, this.y, this.zoom] = [0.5, 0.5, 1];
    this.width = this.height = 1;
    this.drawn = { x: 0.5, y: 0.5, zoom: null, number: 0 };
    this.movedMs = -REST_MS;
    new ResizeObserver(() => this.resize()).observe(element);
    this.resize();
    this.#followPointers();
  }

  resize() {
    [this.width, this.height] = [this.element.clientWidth || 1, this.element.clientHeight || 1];
    this.drawn.zoom = null; // labels and ground depend on the size
    this.moved();
  }

  get scale() {
    return TILE * 2 ** this.zoom;
  }

  get latitude() {
    return (Math.atan(Math.sinh(Math.PI * (1 - 2 * this.y))) * 180) / Math.PI;
  }

  get longitude() {
    return (this.x - 0.5) * 360;
  }

  get metresPerPixel() {
    return (EARTH_M * Math.cos((this.latitude * Math.PI) / 180)) / this.scale;
  }

  // Starts a new drawing when the current one is no longer usable. Returns the drawing's number: if it
  // changes, everything is redrawn, because `at` refers to it.
  settle() {
    const far = Math.max(Math.abs(this.x - this.drawn.x), Math.abs(this.y - this.drawn.y)) * this.scale;
    if (far > FAR_PX || this.#outgrown())
      this.drawn = { x: this.x, y: this.y, zoom: this.zoom, number: this.drawn.number + 1 };
    return this.drawn.number;
  }

  #outgrown() {
    const { x, y, zoom } = this.drawn;
    if (zoom === this.zoom && x === this.x && y === this.y) return false;
    const rests = performance.now() - this.movedMs >= REST_MS;
    return zoom === null || rests || Math.abs(this.zoom - zoom) > MOST_STRETCH;
  }

  // CSS transform of the drawing: position of its anchor in pixels, and its scale.
  get placed() {
    const [x, y] = [
      (this.drawn.x - this.x) * this.scale + this.width / 2,
      (this.drawn.y - this.y) * this.scale + this.height / 2,
    ];
    return `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) scale(${(2 ** (this.zoom - this.drawn.zoom)).toFixed(5)})`;
  }

  // Converts a position to pixels of the drawing, relative to the anchor.
  at(point) {
    const [x, y] = unit(point);
    const scale = TILE * 2 ** this.drawn.zoom;
    return [(x - this.drawn.x) * scale, (y - this.drawn.y) * scale];
  }

  path(points) {
    return points.map((point) => this.at(point).map((v) => v.toFixed(1)).join(",")).join(" ");
  }

  pan(right, down) {
    this.x += right / this.scale;
    this.y += down / this.scale;
    this.#touch();
  }

  zoomBy(steps, [px, py] = [this.width / 2, this.height / 2]) {
    const before = this.scale;
    this.zoom = Math.min(MOST_ZOOM, Math.max(0, this.zoom + steps));
    const moved = 1 / before - 1 / this.scale;
    this.x += (px - this.width / 2) * moved;
    this.y += (py - this.height / 2) * moved;
    this.#touch();
  }

  #touch() {
    const half = Math.min(0.5, this.height / 2 / this.scale); // MapLibre shows nothing beyond the poles, either
    this.y = Math.min(1 - half, Math.max(half, this.y));
    this.movedMs = performance.now();
    clearTimeout(this.rest);
    this.rest = setTimeout(this.moved, REST_MS + 1);
    this.moved();
  }

  // Converts a pixel of the viewport to a position.
  position([px, py]) {
    const [x, y] = [this.x + (px - this.width / 2) / this.scale, this.y + (py - this.height / 2) / this.scale];
    return [(Math.atan(Math.sinh(Math.PI * (1 - 2 * y))) * 180) / Math.PI, (x - 0.5) * 360];
  }

  centre(point) {
    [this.x, this.y] = unit(point);
    this.#touch();
  }

  // Shows all points; `pad`: pixels that are covered at left, right, top and bottom.
  fit(points, pad = [60, 60, 50, 50]) {
    if (!points.length) return;
    const units = points.map(unit);
    const [xs, ys] = [units.map((u) => u[0]), units.map((u) => u[1])];
    const [left, right, top, low] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const [wide, high] = [Math.max(60, this.width - pad[0] - pad[1]), Math.max(60, this.height - pad[2] - pad[3])];
    const room = Math.min(wide / (right - left || 1e-9), high / (low - top || 1e-9));
    this.zoom = Math.min(17, Math.max(0, Math.log2(room / TILE)));
    this.x = (left + right) / 2 + (pad[1] - pad[0]) / 2 / this.scale;
    this.y = (top + low) / 2 + (pad[3] - pad[2]) / 2 / this.scale;
    this.drawn.zoom = null;
    this.moved();
  }

  #followPointers() {
    const held = new Map();
    const place = (event) => {
      const { left, top } = this.element.getBoundingClientRect();
      return [event.clientX - left, event.clientY - top];
    };
    const spread = () => {
      const [a, b] = [...held.values()];
      return Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
    };
    let pressed = null;
    this.element.addEventListener("pointerdown", (event) => {
      if (event.target.closest("button, a, input")) return;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      pressed = held.size === 1 ? [event.clientX, event.clientY] : null;
    });
    this.element.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const wide = held.size === 2 ? spread() : 0;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (wide) this.zoomBy(Math.log2(spread() / wide));
      else if (held.size === 1) this.pan(before[0] - event.clientX, before[1] - event.clientY);
    });
    this.element.addEventListener("pointerup", (event) => {
      const far = pressed ? Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) : Infinity;
      if (held.has(event.pointerId) && far < CLICK_PX) this.clicked?.(place(event), event.pointerType !== "mouse");
      pressed = null;
    });
    for (const end of ["pointerup", "pointercancel", "pointerleave"])
      this.element.addEventListener(end, (event) => held.delete(event.pointerId));
    this.element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoomBy(-event.deltaY / 300, place(event));
    }, { passive: false });
  }
}

// The greatest 1, 2 or 5 times a power of ten that is not above `metres`.
export function niceLength(metres) {
  const power = 10 ** Math.floor(Math.log10(metres));
  return power * [5, 2, 1].find((times) => times * power <= metres);
}
