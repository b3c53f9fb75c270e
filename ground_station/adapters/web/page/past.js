// The time bar: requests the picture of a selected or replayed past time.

import { $, html, say, set, svg } from "./dom.js";
import { ask } from "./server.js";
import { moment } from "./words.js";

const STEP_US = 10e6;
const TICK_MS = 200; // equal to the update interval of the live map
const SPEEDS = [1, 5, 20, 60];

// `show(picture, time in us)` for each picture; `lost()` if the server does not respond.
export class Past {
  constructor(span, show, lost) {
    Object.assign(this, { span, show, lost, tUs: span.from_us, playing: false, speed: 20, asking: false });
    this.bar = $("#time");
    set(this.bar, { min: span.from_us, max: span.to_us, step: 1e6, value: span.from_us });
    this.bar.addEventListener("input", () => this.go(Number(this.bar.value)));
    $("#play").addEventListener("click", () => this.toggle());
    for (const [id, by] of [["#back", -1], ["#forward", 1]]) $(id).addEventListener("click", () => this.step(by));
    $("#next-mark").addEventListener("click", () => this.nextMark());
    $("#speed").append(...SPEEDS.map((times) => html("option", { value: times }, `${times}\u00d7`)));
    $("#speed").value = this.speed;
    $("#speed").addEventListener("change", () => { this.speed = Number($("#speed").value); });
    this.#marks();
    $("#past").hidden = false;
    setInterval(() => this.#tick(), TICK_MS);
    this.go(span.from_us);
  }

  go(tUs) {
    this.tUs = Math.round(Math.min(this.span.to_us, Math.max(this.span.from_us, tUs)));
    this.bar.value = this.tUs;
    this.#ask();
  }

  step(by) {
    this.go(this.tUs + by * STEP_US);
  }

  toggle() {
    this.playing = !this.playing && this.tUs < this.span.to_us;
    this.lastMs = performance.now();
    say($("#play"), this.playing ? "Pause" : "Play");
  }

  faster(by) {
    const at = SPEEDS.indexOf(this.speed) + by;
    this.speed = SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, at))];
    $("#speed").value = this.speed;
  }

  nextMark() {
    const next = this.span.marks.find((one) => one.t_us > this.tUs);
    if (next) this.go(next.t_us);
  }

  #tick() {
    if (!this.playing) return;
    const nowMs = performance.now();
    this.go(this.tUs + (nowMs - this.lastMs) * 1e3 * this.speed);
    this.lastMs = nowMs;
    if (this.tUs >= this.span.to_us) this.toggle();
  }

  // One request at a time; afterwards the latest selected time is requested.
  async #ask() {
    if (this.asking) return;
    this.asking = true;
    let shownUs = null;
    while (shownUs !== this.tUs) {
      shownUs = this.tUs;
      const found = await ask(`/moment.json?t_us=${shownUs}`);
      if (found?.ok) this.show(await found.json(), shownUs);
      else this.lost();
    }
    this.asking = false;
  }

  #marks() {
    const { from_us: from, to_us: to, marks } = this.span;
    const lines = marks.map((one) => {
      const x = (100 * (one.t_us - from)) / (to - from);
      const line = svg("line", { x1: x, x2: x, y1: 0, y2: 10 }, svg("title", {}, `${moment(one.t_us)} ${one.words}`));
      line.addEventListener("click", () => this.go(one.t_us));
      return line;
    });
    $("#marks").append(...lines);
  }
}
