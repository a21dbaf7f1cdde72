// A close-up of the two things that are nearest to each other.

import { clamp, clear, draw } from "./svg.js";

const SIZE = 240;
// Height of the lower one's surface in the picture; the gap is drawn this high
const GROUND = 150, GAP = 70;
// mm: further off there is nothing to see; px of one mm at least and at most
const FAR = 30, COARSE = 2.2, FINE = 4000;
// mm that are in it anyhow: half a gap this small still is a gap
const LEAST = 0.004;

export class Lens {
  constructor(svg, words) {
    this.svg = svg;
    this.words = words;
    this.scale = COARSE;
    this.site = "";
  }

  build(parts) {
    this.parts = parts;
  }

  // `axis`: the one that is shown.
  show(frame, axis) {
    clear(this.svg);
    const near = frame.near.filter(([, distance]) => distance < FAR);
    // What is below something else's surface by more is no contact of today
    near.sort((a, b) => Math.abs(a[1]) - Math.abs(b[1]));
    if (!near.length) {
      this.words.textContent = "nothing is near";
      draw(this.svg, "text", { x: SIZE / 2, y: SIZE / 2, "text-anchor": "middle" }, "nothing is near");
      return;
    }
    const [site, distance, pressed] = near[0];
    const touched = pressed || frame.touches.some((touch) => touch[0] === site);
    const wanted = clamp(COARSE, GAP / Math.max(Math.abs(distance), LEAST), FINE);
    // It comes nearer little by little, as the eye follows; what moves away stays in it
    const isNearer = site === this.site && wanted > this.scale;
    this.scale = isNearer ? this.scale * Math.pow(wanted / this.scale, 0.4) : wanted;
    this.site = site;
    const met = this.parts.sites[site];
    const { upper, lower } = met;
    this.beside = this.besides(met, frame, axis);
    this.lower(met, touched);
    this.upper(met, distance, touched, frame);
    this.measure(distance);
    const how = distance < 0 ? "pressed" : "apart";
    this.words.textContent = `${upper} and ${lower}: ${Math.abs(distance).toFixed(3)} mm ${how}`;
  }

  // How far the lower one's middle is from that of the upper one, mm.
  besides(met, frame, axis) {
    const lower = this.met(met);
    if (!lower) return 0;
    const probe = met.presser === "nozzle" ? null : this.parts.probes[met.whose];
    const tip = frame.tips[probe ? Number(probe.on_second) : met.whose];
    return lower[axis] - tip[axis === "x" ? 0 : 1] - (probe ? probe[`${axis}_offset`] : 0);
  }

  // The pin or the membrane of a site, null: the bed.
  met({ on, which }) {
    return { pin: this.parts.pins, membrane: this.parts.membranes }[on]?.[which] || null;
  }

  x(mm) { return SIZE / 2 + mm * this.scale; }

  rect(kind, left, right, top, bottom) {
    const [x, width] = [clamp(-20, this.x(left), SIZE + 20), clamp(-20, this.x(right), SIZE + 20)];
    draw(this.svg, "rect", { x, y: top, width: Math.max(0, width - x), height: Math.max(0, bottom - top), rx: 2, class: kind });
  }

  lower(met, touched) {
    const part = this.met(met);
    const kind = touched ? " touching" : "";
    if (met.on === "pin") this.rect(`pin${kind}`, this.beside - part.radius, this.beside + part.radius, GROUND, SIZE + 5);
    else if (met.on === "membrane") {
      const half = part.radius || part.half_x;
      const bottom = Math.min(SIZE + 5, GROUND + part.thickness * this.scale);
      this.rect("bed", -400, 400, bottom, SIZE + 5);
      this.rect(`membrane${kind}`, this.beside - half, this.beside + half, GROUND, bottom);
    } else this.rect(`bed${kind}`, -400, 400, GROUND, SIZE + 5);
  }

  upper({ presser, whose }, distance, touched, frame) {
    const bottom = clamp(-10, GROUND - distance * this.scale, SIZE);
    const kind = touched ? " touching" : "";
    if (presser === "nozzle") this.nozzle(bottom, kind, whose ? 0 : frame.dirt);
    else if (presser === "body") {
      const { half_width: half, switch_offset, pretravel } = this.parts.probes[whose];
      this.rect("plunger", -0.9, 0.9, -10, bottom + (switch_offset + pretravel) * this.scale);
      this.rect(`probe${kind}`, -half, half, -10, bottom);
    } else if (presser === "coil") {
      this.rect(`probe${kind}`, -4, 4, -10, bottom);
    } else {
      const probe = this.parts.probes[whose];
      const body = bottom - (probe.switch_offset + probe.pretravel) * this.scale;
      this.rect(`plunger${kind}`, -0.9, 0.9, -10, bottom);
      if (body > -10) this.rect("probe", -probe.half_width, probe.half_width, -10, body);
    }
  }

  nozzle(bottom, kind, dirt) {
    const hung = Math.min(dirt * this.scale, SIZE);
    const tip = bottom - hung;
    const height = Math.min(3.2 * this.scale, tip + 10);
    const slope = (height / this.scale) * 0.69;
    const points = [[-0.2, tip], [0.2, tip], [0.2 + slope, tip - height], [-0.2 - slope, tip - height]];
    if (dirt) this.rect("dirt", -0.3, 0.3, tip, bottom);
    draw(this.svg, "polygon", {
      points: points.map(([mm, y]) => `${clamp(-60, this.x(mm), SIZE + 60).toFixed(1)},${y.toFixed(1)}`).join(" "),
      class: `nozzle${kind}`,
    });
  }

  measure(distance) {
    const bottom = clamp(12, GROUND - distance * this.scale, SIZE - 12);
    const x = SIZE - 62;
    draw(this.svg, "path", { class: "measure", d: `M${x - 8} ${GROUND}H${x + 8}M${x - 8} ${bottom}H${x + 8}M${x} ${GROUND}V${bottom}` });
  }
}
