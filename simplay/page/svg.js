// Elements of a drawing.

const SVG = "http://www.w3.org/2000/svg";

// One below `parent`, with attributes and, for a text, its content.
export function draw(parent, name, attributes = {}, text = "") {
  const element = document.createElementNS(SVG, name);
  set(element, attributes);
  if (text) element.textContent = text;
  parent.append(element);
  return element;
}

export function set(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, typeof value === "number" ? value.toFixed(2) : value);
  }
}

export function clear(element) {
  element.replaceChildren();
}

export const clamp = (low, value, high) => Math.max(low, Math.min(high, value));

// What meets what, in words; the site's name is that of simprinter/world/truth.py.
export const SITES = {
  nozzle_pin: ["nozzle", "pin"],
  body_pin: ["probe's body", "pin"],
  plunger_pin: ["plunger", "pin's housing"],
  probe_bed: ["plunger", "bed"],
  body_bed: ["probe's body", "bed"],
  nozzle_bed: ["nozzle", "bed"],
  nozzle_membrane: ["nozzle", "membrane"],
  inductive_bed: ["sensing range", "bed"],
};
