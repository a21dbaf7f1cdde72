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

// Of what is shown beside a thing, where there are several: its signal.
export const named = (what, signal, number) => (number ? `${what} ${signal}` : what);
