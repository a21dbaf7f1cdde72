// What came of a command: its result in large figures, and the report's picture.

const RESULT = /--> (new offset|new switch_offset|correction)=(-?[\d.]+)(?: \+-([\d.]+))?/;
const LABELS = { "new offset": "new Z offset", correction: "correction of the probe" };
const REPORT = /the report is \S*?(report-\d{8}-\d{6}\.svg)/;

export class Result {
  constructor(card, section, picture, link) {
    Object.assign(this, { card, section, picture, link });
    this.url = "";
    this.formula = "";
  }

  forget() {
    this.card.hidden = true;
    this.section.hidden = true;
  }

  // A line of the console.
  take(line) {
    const found = RESULT.exec(line);
    if (found) {
      const [, name, value, uncertainty] = found;
      // The uncertainty comes in a line of its own, behind that of the formula
      if (!uncertainty) this.formula = line.replace(/^\/\/ /, "");
      this.show(LABELS[name] || name, this.formula || line, Number(value), uncertainty);
    }
    const report = REPORT.exec(line);
    if (report) this.draw(report[1]);
  }

  show(name, line, value, uncertainty) {
    const figures = document.createElement("p");
    figures.className = "big";
    figures.textContent = `${value.toFixed(3)} mm${uncertainty ? ` ± ${uncertainty}` : ""}`;
    const label = Object.assign(document.createElement("p"), { className: "label", textContent: name });
    const how = Object.assign(document.createElement("p"), { className: "quiet", textContent: line });
    this.card.replaceChildren(label, figures, how);
    this.card.hidden = false;
  }

  draw(name) {
    this.picture.src = this.link.href = `${this.url}/server/files/config/z_calibration/${name}`;
    this.section.hidden = false;
  }
}
