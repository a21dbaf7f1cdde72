// What hands do to the machine: buttons for the commands of the terminal.

import { named } from "./svg.js";

const NAMES = {
  z_endstop: "Z endstop", y_endstop: "Y endstop", x_endstop: "X endstop", probe: "probe",
  bed_sensor: "bed sensor", membrane: "membrane",
};

// What is told with a time happened to the machine; all else answers somebody.
export const isTimed = (line) => /^ *\d+\.\d s/.test(line);

export class Hands {
  constructor(place, told, order) {
    Object.assign(this, { place, told, order });
    this.lamps = new Map();
  }

  build({ commands, wires, parts }) {
    this.lamps.clear();
    const rows = [...wires].reverse().map((wire) => this.wire(wire, parts));
    const has = (name) => commands.includes(name);
    // Of several, all but the first are named
    const these = (things, name) => things.map(({ signal }, number) => [named(name, signal, number), number ? ` ${signal}` : ""]);
    for (const [name, which] of has("attach") ? these(parts.probes, "Probe") : []) {
      rows.push(this.row(name, [["Put on", `attach${which}`], ["Take off", `off${which}`], ["Let it drop", `drop${which}`]]));
    }
    for (const [name, which] of has("lay") ? these(parts.membranes, "Membrane") : []) {
      rows.push(this.row(name, [["Lay on the bed", `lay${which}`], ["Take away", `take${which}`]]));
    }
    rows.push(
      this.amount("Plastic below the nozzle, mm", "dirt", 0.05, 0, 0.3, "Add", [["Wipe off", "dirt 0"]]),
      this.amount("Longer nozzle, by mm", "nozzle", 0.15, -0.5, 0.5, "Put in", [["First nozzle", "nozzle 0"]]),
      this.amount("Thicker plate, by mm", "plate", 0.2, -0.5, 0.5, "Lay on", [["First plate", "plate 0"]]),
      this.row("All faults", [["Repair everything", "repair"]]),
      this.row("True gap", [["Measure it again", "gap"]]),
    );
    this.place.replaceChildren(...rows);
  }

  wire(wire, parts) {
    const pin = parts.pins.findIndex(({ signal }) => signal === wire);
    const name = pin < 0 ? NAMES[wire] || wire : named("pin", wire, pin);
    const row = this.row(name, [["Press", `press ${wire}`], ["Break", `break ${wire}`], ["Short", `short ${wire}`], ["Late", `late ${wire} 0.1`]]);
    row.lastChild.title = "triggers 0.1 mm too deep";
    row.firstChild.className = "lamp";
    row.dataset.wire = wire;
    this.lamps.set(wire, row.firstChild);
    return row;
  }

  row(name, buttons) {
    const row = document.createElement("div");
    row.className = "row";
    row.setAttribute("role", "group");
    row.setAttribute("aria-label", name);
    row.append(Object.assign(document.createElement("span"), { textContent: name }));
    for (const [label, line] of buttons) row.append(this.button(label, () => line));
    return row;
  }

  button(label, line) {
    const button = document.createElement("button");
    button.textContent = label;
    button.dataset.does = line();
    button.addEventListener("click", () => this.order(line()));
    return button;
  }

  amount(name, command, value, min, max, label, others) {
    const row = this.row(name, []);
    const input = Object.assign(document.createElement("input"), { type: "number", value, min, max, step: 0.01 });
    input.setAttribute("aria-label", name);
    row.append(input, this.button(label, () => `${command} ${input.value || 0}`));
    for (const [other, line] of others) row.append(this.button(other, () => line));
    return row;
  }

  show(frame) {
    for (const [wire, lamp] of this.lamps) lamp.classList.toggle("on", frame.on.includes(wire));
  }

  // The answer to something that was done.
  tell(line) {
    this.told.textContent = line;
    this.told.classList.toggle("bad-text", line.startsWith("!!"));
  }
}
