// Questions of a command: lines `// action:prompt_...` become buttons.

const LINE = /^\/\/ action:prompt_(\S+) *(.*)/;
const END = 'RESPOND type="command" msg="action:prompt_end"';

export class Dialog {
  // `send` runs G-code.
  constructor(card, send) {
    this.card = card;
    this.send = send;
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
    const rows = groups.map((group) => this.row(group, ""));
    this.card.replaceChildren(close, title, ...parts, ...rows, this.row(footer, "footer"));
    this.card.hidden = false;
    if (!takesFocus) return;
    const buttons = [...this.card.querySelectorAll(".row button")];
    (buttons.find((button) => button.textContent === label) || this.card).focus();
  }

  row(buttons, kind) {
    const row = document.createElement("div");
    row.className = `row ${kind}`;
    row.append(...buttons.map((text) => {
      const [label, gcode, colour] = text.split("|");
      const button = document.createElement("button");
      button.textContent = label;
      button.dataset.runs = gcode || label;
      button.className = colour || "";
      button.addEventListener("click", () => this.send(gcode || label));
      return button;
    }));
    return row;
  }

  hide() {
    const hadFocus = this.card.contains(document.activeElement);
    this.card.hidden = true;
    this.card.replaceChildren();
    if (hadFocus) document.getElementById("input").focus();
  }
}
