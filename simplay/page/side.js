// The machine from the side: with the axis on which probe and nozzle lie apart, or the
// one on which the toolhead is to be moved.

import { clamp, clear, draw, named } from "./svg.js";

const WIDTH = 640, HEIGHT = 470;
// mm to either side of the toolhead; mm below the bed and above the nozzle that are shown
const AROUND = 62, BELOW = 13, ABOVE = 46;
// What is further off than this (mm), seen in the other direction, is pale
const NEAR = 14;
// Of a nozzle and its heater, mm above the tip
const NOZZLE = [[-0.2, 0], [0.2, 0], [2.4, 3.2], [3.5, 3.2], [3.5, 6.5], [-3.5, 6.5], [-3.5, 3.2], [-2.4, 3.2]];

export class Side {
  constructor(svg) {
    this.svg = svg;
    this.middle = null;
    this.scale = 5;
  }

  // The machine's parts; `u` is the axis that is shown, `v` the other one.
  build(parts) {
    const probe = parts.probes[0] || parts.inductive;
    const isY = probe ? Math.abs(probe.y_offset) > Math.abs(probe.x_offset) : false;
    this.parts = parts;
    this.usual = isY ? "y" : "x";
    this.turn("");
    this.middle = null;
  }

  // Show an axis, "x" or "y"; "": the one on which probe and nozzle lie apart.
  turn(axis) {
    const shown = axis || this.usual;
    if (this.axes?.[0] === shown || !this.parts) return;
    this.axes = shown === "y" ? ["y", "x"] : ["x", "y"];
    this.middle = null;
  }

  at(thing) {
    return [thing[this.axes[0]], thing[this.axes[1]]];
  }

  // Where the probe is beside the nozzle.
  offset(probe) {
    return [probe[`${this.axes[0]}_offset`], probe[`${this.axes[1]}_offset`]];
  }

  // `tip`: of the carriage that has moved last.
  show(frame, tip) {
    if (!this.parts) return;
    const [u, v, z] = [...this.at(tip), tip.z];
    const heads = frame.tips.map(([x, y, z]) => ({ u: this.at({ x, y })[0], z }));
    this.middle = this.middle === null ? u : this.middle + (u - this.middle) * 0.25;
    const scale = Math.min(WIDTH / (2 * AROUND), HEIGHT / (z + BELOW + ABOVE));
    this.scale += (scale - this.scale) * 0.2;
    const pressed = new Set(frame.near.filter((near) => near[2]).map((near) => near[0]));
    for (const [site] of frame.touches) pressed.add(site);
    this.scene = { u, v, z, frame, pressed, heads };
    clear(this.svg);
    this.drawBed();
    this.parts.pins.forEach((pin, number) => this.drawPin(pin, number));
    this.parts.membranes.forEach((membrane, number) => this.drawMembrane(membrane, number));
    this.parts.probes.forEach((probe, number) => this.drawDock(probe, number));
    heads.forEach((head, number) => this.drawHead(head, number));
    if (this.parts.inductive) this.drawInductive(this.parts.inductive);
    this.parts.probes.forEach((probe, number) => this.drawProbe(probe, number));
    const words = `${this.axes[0].toUpperCase()} ${u.toFixed(1)}  ${this.axes[1].toUpperCase()} ${v.toFixed(1)}`;
    draw(this.svg, "text", { x: 10, y: 20, class: "strong" }, `nozzle truly at ${words}  Z ${z.toFixed(2)}`);
    draw(this.svg, "text", { x: WIDTH - 10, y: 20, "text-anchor": "end" }, `seen along ${this.axes[1].toUpperCase()}`);
  }

  x(u) { return WIDTH / 2 + (u - this.middle) * this.scale; }
  y(z) { return HEIGHT - (z + BELOW) * this.scale; }

  box(kind, left, right, bottom, top, more = {}) {
    const [x, y] = [this.x(left), this.y(top)];
    return draw(this.svg, "rect", {
      x, y, width: Math.max(0, this.x(right) - x), height: Math.max(0.5, this.y(bottom) - y), rx: 1.5, class: kind, ...more,
    });
  }

  // A class for what is seen at `v` in the other direction.
  depth(v, reach = NEAR) {
    return Math.abs(v - this.scene.v) > reach ? " far" : "";
  }

  // Whether something is pressed: of what comes from above, or of what is met.
  isPressed(wanted) {
    return [...this.scene.pressed].some((name) => {
      const site = this.parts.sites[name];
      return site && Object.entries(wanted).every(([key, value]) => site[key] === value);
    });
  }

  drawBed() {
    const { bed, bed_sensor } = this.parts;
    const [low, high] = [bed[`${this.axes[0]}_min`], bed[`${this.axes[0]}_max`]];
    const touching = this.isPressed({ on: "bed" }) ? " touching" : "";
    this.box("bed", low, high, bed.z0 - 3, bed.z0);
    if (touching) this.box("touching", low, high, bed.z0 - 0.5, bed.z0);
    for (let u = Math.ceil(low / 10) * 10; u <= high; u += 10) {
      const x = this.x(u);
      if (x < 0 || x > WIDTH) continue;
      draw(this.svg, "line", { x1: x, x2: x, y1: this.y(bed.z0 - 3), y2: this.y(bed.z0 - 3.8), class: "outline" });
      if (u % 50 === 0) draw(this.svg, "text", { x, y: this.y(bed.z0 - 3.8) + 12, "text-anchor": "middle" }, `${u}`);
    }
    if (bed_sensor) {
      const on = this.scene.frame.on.includes("bed_sensor") ? " touching" : "";
      for (const u of [low + 20, (low + high) / 2, high - 20]) this.box(`metal${on}`, u - 5, u + 5, bed.z0 - 5, bed.z0 - 3);
    }
  }

  drawPin(pin, number) {
    const [u, v] = this.at(pin);
    const isPressed = this.isPressed({ on: "pin", which: number });
    const sunk = isPressed ? 0.4 : 0;
    const far = this.depth(v, 35);
    this.box(`metal${far}`, u - 7, u + 7, pin.z - 9, pin.z - 3);
    this.box(`pin${far}${isPressed ? " touching" : ""}`, u - pin.radius, u + pin.radius, pin.z - 3, pin.z - sunk);
  }

  drawMembrane(membrane, number) {
    const { bed } = this.parts;
    if (!this.scene.frame.laid[number]) return;
    const [u, v] = this.at(membrane);
    const half = membrane.radius || membrane[`half_${this.axes[0]}`];
    const touching = this.isPressed({ on: "membrane", which: number }) ? " touching" : "";
    this.box(`membrane${touching}${this.depth(v, half + 6)}`, u - half, u + half, bed.z0, bed.z0 + Math.max(membrane.thickness, 0.9));
  }

  drawDock(probe, number) {
    const { dock } = probe;
    if (!dock) return;
    const [u, v] = this.at(dock);
    const [du] = this.offset(probe);
    const z = dock.lifted ? this.scene.z : dock.z;
    const far = this.depth(v, 25);
    const bottom = z - probe.body_drop;
    this.box(`dock${far}`, u + du - 9, u + du + 9, bottom - 1, bottom + 1.5);
    this.box(`dock${far}`, u + du + 7, u + du + 9, bottom, bottom + 14);
    draw(this.svg, "text", { x: this.x(u + du), y: this.y(bottom - 1) + 12, "text-anchor": "middle" }, named("dock", probe.signal, number));
    if (this.scene.frame.probes[number] === "docked") this.probeAt(probe, number, u + du, bottom + 1.5, far);
  }

  drawHead({ u, z }, number) {
    const { frame } = this.scene;
    const touching = this.isPressed({ presser: "nozzle", whose: number });
    this.box("metal", u - 11, u + 11, z + 6.5, z + 14);
    this.box("head", u - 14, u + 14, z + 16, z + 40, { rx: 6 });
    for (const dz of [22, 28, 34]) this.box("metal", u - 9, u + 9, z + dz, z + dz + 2);
    const points = NOZZLE.map(([du, dz]) => `${this.x(u + du).toFixed(2)},${this.y(z + dz).toFixed(2)}`);
    draw(this.svg, "polygon", { points: points.join(" "), class: `nozzle${touching ? " touching" : ""}` });
    // The second nozzle stays clean
    if (frame.dirt && !number) this.box("dirt", u - 0.7, u + 0.7, z - Math.max(frame.dirt, 0.25), z + 0.6);
  }

  drawInductive(inductive) {
    const { pressed, frame, heads: [{ u, z }] } = this.scene;
    const [du] = this.offset(inductive);
    const on = pressed.has("inductive_bed") || frame.on.includes(inductive.signal) ? " touching" : "";
    const bottom = z + Math.max(0.5, 2.5 - inductive.sense_distance);
    this.box("metal", u + du - 5, u + du + 5, bottom + 2, bottom + 26);
    this.box(`probe${on}`, u + du - 5, u + du + 5, bottom, bottom + 2);
  }

  drawProbe(probe, number) {
    const { frame, heads } = this.scene;
    const { u, z } = heads[probe.on_second ? 1 : 0];
    const [du] = this.offset(probe);
    const state = frame.probes[number];
    if (state === "attached") {
      this.box("head", u + Math.min(0, du), u + Math.max(0, du) + 2, z + 16, z + 22);
      this.box("head", u + du - 5, u + du + 5, z + 4, z + 20);
      this.probeAt(probe, number, u + du, z - probe.body_drop, "");
    } else {
      this.box("head far", u + du - 5, u + du + 5, z + 10, z + 20);
      const name = named("probe", probe.signal, number);
      const words = { lost: `the ${name} lies somewhere`, docked: `${name} put away` }[state];
      if (!probe.dock || state === "lost") this.lying(words, state === "lost", number);
    }
  }

  // One that the toolhead does not carry, in a corner of the picture.
  lying(words, isLost, number) {
    const [x, y] = [WIDTH - 70, 60 + 70 * number];
    const group = draw(this.svg, "g", { transform: `translate(${x} ${y}) rotate(${isLost ? 74 : 0})` });
    draw(group, "rect", { x: -14, y: -14, width: 28, height: 26, rx: 3, class: "probe" });
    draw(group, "rect", { x: -3, y: 12, width: 6, height: 5, class: "plunger" });
    draw(this.svg, "text", { x, y: y + 34, "text-anchor": "middle" }, words);
  }

  // Body and plunger; `z` is the body's bottom.
  probeAt(probe, number, u, z, far) {
    const { frame } = this.scene;
    const body = this.isPressed({ presser: "body", whose: number });
    const plunger = this.isPressed({ presser: "plunger", whose: number });
    const near = new Map(frame.near.map(([site, distance]) => [site, distance]));
    const travel = probe.switch_offset + probe.pretravel;
    const isOn = !far && frame.probes[number] === "attached";
    const pushed = isOn ? clamp(0, -(near.get(`${probe.signal}_bed`) ?? 1), travel) : 0;
    this.box(`plunger${plunger ? " touching" : ""}${far}`, u - 0.9, u + 0.9, z - travel + pushed, z + 1);
    this.box(`probe${body ? " touching" : ""}${far}`, u - probe.half_width, u + probe.half_width, z, z + 11);
  }
}

