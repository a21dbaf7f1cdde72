// The machine from above: the way of the toolhead, and the last touches as dots.

import { clear, draw, named, set } from "./svg.js";

const SIZE = 340, EDGE = 22;
// Places of the way, and touches, that are shown
export const WAY = 900, DOTS = 80;

export class Top {
  constructor(svg, words) {
    this.svg = svg;
    this.words = words;
    this.forget();
  }

  forget() {
    this.way = [];
    this.dots = [];
    this.active = 0;
  }

  build(parts) {
    this.forget();
    this.parts = parts;
    clear(this.svg);
    const { bed, pins, probes, membranes } = parts;
    const docks = probes.filter((probe) => probe.dock);
    const xs = [bed.x_min, bed.x_max], ys = [bed.y_min, bed.y_max];
    for (const thing of [...pins, ...docks.map(({ dock }) => dock)]) { xs.push(thing.x - 8, thing.x + 8); ys.push(thing.y - 8, thing.y + 8); }
    const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    this.scale = (SIZE - 2 * EDGE) / Math.max(right - left, high - low);
    this.origin = [left, high];
    this.bed = draw(this.svg, "rect", {
      x: this.x(bed.x_min), y: this.y(bed.y_max), rx: 4,
      width: (bed.x_max - bed.x_min) * this.scale, height: (bed.y_max - bed.y_min) * this.scale,
      class: "bed", opacity: 0.35,
    });
    for (let x = bed.x_min; x <= bed.x_max; x += 50) draw(this.svg, "text", { x: this.x(x), y: SIZE - 6, "text-anchor": "middle" }, `${Math.round(x)}`);
    for (let y = bed.y_min; y <= bed.y_max; y += 50) draw(this.svg, "text", { x: 3, y: this.y(y) + 4 }, `${Math.round(y)}`);
    pins.forEach((pin, number) => {
      draw(this.svg, "circle", { cx: this.x(pin.x), cy: this.y(pin.y), r: 5, class: "pin" });
      draw(this.svg, "text", { x: this.x(pin.x) + 8, y: this.y(pin.y) + 4 }, named("pin", pin.signal, number));
    });
    docks.forEach(({ dock, signal }) => {
      draw(this.svg, "rect", { x: this.x(dock.x) - 8, y: this.y(dock.y) - 5, width: 16, height: 10, class: "dock" });
      draw(this.svg, "text", { x: this.x(dock.x) + 11, y: this.y(dock.y) + 4 }, named("dock", signal, probes.length - 1));
    });
    this.membranes = membranes.map((membrane) => draw(this.svg, "circle", {
      cx: this.x(membrane.x), cy: this.y(membrane.y), r: (membrane.radius || membrane.half_x) * this.scale, class: "membrane",
    }));
    this.line = draw(this.svg, "polyline", { class: "way" });
    this.marks = draw(this.svg, "g");
    // Each with its probe beside the nozzle
    this.probes = [...probes, ...(parts.inductive ? [parts.inductive] : [])].map(() => (
      draw(this.svg, "rect", { width: 8, height: 8, class: "probe" })));
    this.others = draw(this.svg, "g");
    this.head = draw(this.svg, "path", { class: "cross", d: "M-9 0H9M0 -9V9M-5 0A5 5 0 1 0 5 0A5 5 0 1 0 -5 0" });
  }

  x(mm) { return EDGE + (mm - this.origin[0]) * this.scale; }
  y(mm) { return EDGE + (this.origin[1] - mm) * this.scale; }

  show(frame, tip) {
    if (!this.parts) return;
    // The other carriage goes its own way
    if (frame.active !== this.active) [this.way, this.active] = [[], frame.active];
    for (const [x, y] of frame.way) this.step(x, y);
    set(this.line, { points: this.way.map(([x, y]) => `${this.x(x).toFixed(1)},${this.y(y).toFixed(1)}`).join(" ") });
    set(this.head, { transform: `translate(${this.x(tip.x).toFixed(1)} ${this.y(tip.y).toFixed(1)})` });
    clear(this.others);
    frame.tips.forEach(([x, y], number) => {
      if (number !== frame.active) draw(this.others, "path", { class: "cross", opacity: 0.4, d: `M${this.x(x) - 6} ${this.y(y)}h12m-6 -6v12` });
    });
    this.probes.forEach((mark, number) => {
      const probe = this.parts.probes[number] || this.parts.inductive;
      const isShown = number === this.parts.probes.length || frame.probes[number] === "attached";
      const [x, y] = frame.tips[Number(probe.on_second || false)];
      set(mark, { visibility: isShown ? "visible" : "hidden", x: this.x(x + probe.x_offset) - 4, y: this.y(y + probe.y_offset) - 4 });
    });
    this.membranes.forEach((mark, number) => set(mark, { visibility: frame.laid[number] ? "visible" : "hidden" }));
    for (const touch of frame.touches) this.dot(touch);
  }

  step(x, y) {
    const last = this.way[this.way.length - 1];
    if (last && Math.hypot(x - last[0], y - last[1]) < 0.3) return;
    this.way.push([x, y]);
    if (this.way.length > WAY) this.way.splice(0, this.way.length - WAY);
  }

  dot([site, x, y, deep]) {
    const { presser, whose, upper, lower } = this.parts.sites[site];
    const probe = { nozzle: null, coil: this.parts.inductive, body: this.parts.probes[whose], plunger: this.parts.probes[whose] }[presser];
    const place = probe ? [x + probe.x_offset, y + probe.y_offset] : [x, y];
    const kind = { nozzle: "nozzle", body: "body" }[presser] || "probe";
    const words = `${upper} on ${lower} at X${x.toFixed(1)} Y${y.toFixed(1)}, ${deep.toFixed(3)} mm deep`;
    // Touches of one place do not hide each other
    const spread = (this.dots.length % 5) * 1.6 - 3.2;
    const dot = draw(this.marks, "circle", { cx: this.x(place[0]) + spread, cy: this.y(place[1]) + spread / 2, r: 3.4, class: `dot ${kind}` });
    draw(dot, "title", {}, words);
    this.dots.push(dot);
    while (this.dots.length > DOTS) this.dots.shift().remove();
    this.words.textContent = `Last touch: ${words}`;
  }
}
