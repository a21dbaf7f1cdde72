// Questions of a command: lines `// action:prompt_...` become buttons.

const LINE = /^\/\/ action:prompt_(\S+) *(.*)/;
const END = 'RESPOND type="command" msg="action:prompt_end"';
// Labels of buttons that move the toolhead, and of the one that changes by how much
const JOG = /^([XYZ])([+-])([\d.]+) mm$/;
const STEPS = /^Steps of ([\d.]+) mm$/;
const isOfPad = (text) => JOG.test(text.split("|")[0]) || STEPS.test(text.split("|")[0]);

export class Dialog {
  // `send` runs G-code. `turn` is told along which axis the toolhead is to move: "x", "y",
  // or "" where none is asked for.
  constructor(card, send, turn) {
    Object.assign(this, { card, send, turn });
    this.steps = { gcode: "", widths: [], wanted: 0 };
    this.forget();
  }

  forget() {
    this.building = null;
    this.group = null;
    this.hide();
  }

  take(line) {
    const [, kind, text] = LINE.exec(line) || [];
    if (kind === "begin") {
      this.building = { headline: text, texts: [], groups: [], footer: [] };
      this.group = null;
    } else if (kind === "end") this.forget();
    else if (kind && this.building) this.part(kind, text);
  }

  part(kind, text) {
    const { building } = this;
    if (kind === "text") building.texts.push(text);
    else if (kind === "button_group_start") building.groups.push((this.group = []));
    else if (kind === "button_group_end") this.group = null;
    else if (kind === "button" && this.group) this.group.push(text);
    else if (kind === "button") building.groups.push([text]);
    else if (kind === "footer_button") building.footer.push(text);
    else if (kind === "show") this.show(building);
  }

  show({ headline, texts, groups, footer }) {
    const { activeElement } = document;
    // Who types is not interrupted; who presses buttons goes on with them
    const takesFocus = this.card.contains(activeElement) || activeElement === document.body;
    const label = this.card.contains(activeElement) ? activeElement.textContent : "";
    const title = document.createElement("h3");
    title.textContent = headline;
    const close = document.createElement("button");
    close.textContent = "✕";
    close.setAttribute("aria-label", "Close the dialog");
    close.style.float = "right";
    close.addEventListener("click", () => this.send(END));
    const parts = texts.map((text) => Object.assign(document.createElement("p"), { textContent: text }));
    const jogs = groups.filter((group) => group.every(isOfPad)).flat();
    const rows = groups.filter((group) => !group.every(isOfPad)).map((group) => this.row(group, ""));
    const pad = jogs.length ? [this.pad(jogs)] : [];
    this.card.replaceChildren(close, title, ...parts, ...pad, ...rows, this.row(footer, "footer"));
    this.card.hidden = false;
    const isFlat = jogs.some((text) => text.startsWith("X")) && jogs.some((text) => text.startsWith("Y"));
    const isNew = headline !== this.headline;
    this.headline = headline;
    // Which way the user goes on is seen when he moves
    if (isNew || !isFlat) this.turn(isFlat ? "x" : "");
    if (!takesFocus) return;
    const buttons = [...this.card.querySelectorAll(".row button")];
    (buttons.find((button) => button.textContent === label) || this.card).focus();
  }

  row(buttons, kind) {
    const row = document.createElement("div");
    row.className = `row ${kind}`;
    row.append(...buttons.map((text) => this.button(text)));
    return row;
  }

  button(text) {
    const [label, gcode, colour] = text.split("|");
    const button = document.createElement("button");
    button.textContent = label;
    button.dataset.runs = gcode || label;
    button.className = colour || "";
    button.addEventListener("click", () => this.send(gcode || label));
    return button;
  }

  // The toolhead is moved with a cross, Z beside it, and a chooser of the step.
  pad(jogs) {
    const pad = document.createElement("div");
    pad.className = "pad";
    const cross = document.createElement("div");
    cross.className = "cross-of-buttons";
    let width = 0;
    for (const text of jogs) {
      const [, axis, sign, by] = JOG.exec(text.split("|")[0]) || [];
      if (!axis) continue;
      width = Number(by);
      const button = this.button(text);
      button.classList.add("jog", `${axis.toLowerCase()}-${sign === "+" ? "more" : "less"}`);
      if (axis !== "Z") button.addEventListener("click", () => this.turn(axis.toLowerCase()));
      cross.append(button);
    }
    pad.append(cross);
    const other = jogs.find((text) => STEPS.test(text.split("|")[0]));
    if (other) pad.append(this.chooser(width, other));
    return pad;
  }

  // Steps that were offered so far at this place: a dialog names the one that is in
  // force, and one other.
  chooser(width, other) {
    const [label, gcode] = other.split("|");
    const begin = gcode.replace(/[\d.]+$/, "");
    const { steps } = this;
    if (steps.gcode !== begin) Object.assign(steps, { gcode: begin, widths: [], wanted: 0 });
    // One that was asked for and is not in force is too wide here
    const isRefused = steps.wanted && steps.wanted !== width;
    const known = new Set([...steps.widths, width, Number(STEPS.exec(label)[1])]);
    if (isRefused) known.delete(steps.wanted);
    steps.widths = [...known].sort((a, b) => b - a);
    steps.wanted = 0;
    const row = this.row(steps.widths.map((mm) => `${mm} mm|${begin}${mm}`), "steps");
    row.setAttribute("role", "group");
    row.setAttribute("aria-label", "Step");
    row.prepend(Object.assign(document.createElement("span"), { className: "label", textContent: "Step" }));
    row.querySelectorAll("button").forEach((button, i) => {
      const isInForce = steps.widths[i] === width;
      button.setAttribute("aria-pressed", String(isInForce));
      if (isInForce) button.className = "primary";
      button.addEventListener("click", () => { steps.wanted = steps.widths[i]; });
    });
    return row;
  }

  hide() {
    const hadFocus = this.card.contains(document.activeElement);
    this.card.hidden = true;
    this.card.replaceChildren();
    // Each dialog takes the place of another one
    setTimeout(() => { if (this.card.hidden) { this.headline = ""; this.turn(""); } }, 1000);
    if (hadFocus) document.getElementById("input").focus();
  }
}
