// What came of a command: its result in large figures, and the report's picture.

const NEVER = /(?!)/;
// Klippy says so when it ends and when it begins
const RESTARTS = /^Klipper state: /;

export class Result {
  constructor(card, section, picture, link) {
    Object.assign(this, { card, section, picture, link });
    this.formula = "";
    this.warnings = [];
    this.know({ cards: [], verdict: "", report: "", report_folder: "", moonraker: "" });
  }

  // What there is to look for, see played.py; the last line that is told counts.
  know({ cards, verdict, report, report_folder: folder, moonraker }) {
    this.cards = cards.map(([pattern, ...shown]) => [new RegExp(pattern), ...shown]);
    this.verdict = verdict ? new RegExp(verdict) : NEVER;
    this.report = report ? new RegExp(report) : NEVER;
    this.folder = `${moonraker}/server/files/config/${folder}`;
  }

  get isShown() {
    return !this.card.hidden;
  }

  // What was found holds no longer.
  takeBack() {
    this.card.hidden = true;
  }

  // Of another printer, or before a restart.
  forget() {
    this.takeBack();
    this.section.hidden = true;
  }

  // G-code that was sent: what is homed anew is another Z.
  sent(script) {
    if (/\bG28\b/i.test(script)) this.takeBack();
  }

  // A line of the console; whether it tells what a command has found.
  take(line) {
    const text = line.replace(/^\/\/ /, "");
    if (line.startsWith("!!")) this.takeBack();
    if (RESTARTS.test(text)) this.forget();
    let isFound = false;
    for (const [pattern, label, sign, digits] of this.cards) {
      const found = pattern.exec(text);
      if (!found) continue;
      this.found(label, text, `${sign}${Number(found[1]).toFixed(digits)} mm`, found[2]);
      isFound = true;
    }
    const verdict = this.verdict.exec(text);
    if (verdict && this.how) this.how.textContent = verdict[1];
    const report = this.report.exec(text);
    if (report) this.draw(report[1]);
    return isFound;
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
    this.doubts = document.createElement("div");
    this.card.replaceChildren(label, figures, this.how, this.doubts);
    this.card.hidden = false;
    this.warn(this.warnings);
  }

  // What the run has warned of that has found it.
  warn(texts) {
    const isShown = this.doubts?.childElementCount === texts.length;
    if (isShown && texts.join() === this.warnings.join()) return;
    this.warnings = texts;
    this.card.classList.toggle("doubtful", texts.length > 0);
    const lines = texts.map((text) => Object.assign(document.createElement("p"), { textContent: `Warning: ${text}` }));
    if (this.doubts) this.doubts.replaceChildren(...lines);
  }

  draw(name) {
    this.picture.src = this.link.href = `${this.folder}/${name}`;
    this.section.hidden = false;
  }
}
