// What came of a command: its result in large figures, and the report's picture.

const NEVER = /(?!)/;

export class Result {
  constructor(card, section, picture, link) {
    Object.assign(this, { card, section, picture, link });
    this.formula = "";
    this.know({ cards: [], verdict: "", report: "", report_folder: "", moonraker: "" });
  }

  // What there is to look for, see played.py; the last line that is told counts.
  know({ cards, verdict, report, report_folder: folder, moonraker }) {
    this.cards = cards.map(([pattern, ...shown]) => [new RegExp(pattern), ...shown]);
    this.verdict = verdict ? new RegExp(verdict) : NEVER;
    this.report = report ? new RegExp(report) : NEVER;
    this.folder = `${moonraker}/server/files/config/${folder}`;
  }

  forget() {
    this.card.hidden = true;
    this.section.hidden = true;
  }

  // A line of the console.
  take(line) {
    const text = line.replace(/^\/\/ /, "");
    for (const [pattern, label, sign, digits] of this.cards) {
      const found = pattern.exec(text);
      if (found) this.found(label, text, `${sign}${Number(found[1]).toFixed(digits)} mm`, found[2]);
    }
    const verdict = this.verdict.exec(text);
    if (verdict && this.how) this.how.textContent = verdict[1];
    const report = this.report.exec(text);
    if (report) this.draw(report[1]);
  }

  found(label, text, figures, uncertainty) {
    // The uncertainty comes in a line of its own, behind that of the formula
    if (uncertainty) this.show(label, this.formula || text, `${figures} ± ${uncertainty}`);
    else this.show(label, (this.formula = text), figures);
  }

  show(name, line, text) {
    const figures = Object.assign(document.createElement("p"), { className: "big", textContent: text });
    const label = Object.assign(document.createElement("p"), { className: "label", textContent: name });
    this.how = Object.assign(document.createElement("p"), { className: "quiet", textContent: line });
    this.card.replaceChildren(label, figures, this.how);
    this.card.hidden = false;
  }

  draw(name) {
    this.picture.src = this.link.href = `${this.folder}/${name}`;
    this.section.hidden = false;
  }
}
