// What came of a command: its result in large figures, and the report's picture.

// [what the console says, the label above the figures, what is in front of them]; the
// last line that is told counts
const RESULTS = [
  [/--> new offset=(-?[\d.]+)(?: \+-([\d.]+))?/, "new Z offset"],
  [/--> new switch_offset=(-?[\d.]+)/, "new switch_offset"],
  [/--> correction=(-?[\d.]+)/, "correction of the probe"],
  [/^AUTO_Z_CALIBRATE: .*probe_z_correction: (-?[\d.]+)/, "correction of the probe"],
  [/^AUTO_Z_PROBE: .*triggered at z=(-?[\d.]+)/, "the bed sensor has triggered at Z"],
  [/^AUTO_Z_HOME_Z: .*which is z=(-?[\d.]+)/, "where the bed sensor triggers is Z"],
  [/^Result(?: is|: .*) z=(-?[\d.]+)/, "triggered at Z"],
  [/^probe z accuracy results: .*standard deviation ([\d.]+)/, "touches of the nozzle: standard deviation", "", 4],
  [/^probe accuracy results: .*standard deviation ([\d.]+)/, "touches: standard deviation", "", 4],
  [/^CALIBRATE_Z_ACCURACY: one CALIBRATE_Z: \+-([\d.]+)/, "one CALIBRATE_Z", "± ", 4],
];
const VERDICT = /^CALIBRATE_Z_ACCURACY: (verdict: .*)/;
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
    const text = line.replace(/^\/\/ /, "");
    for (const [pattern, label, sign = "", digits = 3] of RESULTS) {
      const found = pattern.exec(text);
      if (found) this.found(label, text, `${sign}${Number(found[1]).toFixed(digits)} mm`, found[2]);
    }
    const verdict = VERDICT.exec(text);
    if (verdict && this.how) this.how.textContent = verdict[1];
    const report = REPORT.exec(text);
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
    this.picture.src = this.link.href = `${this.url}/server/files/config/z_calibration/${name}`;
    this.section.hidden = false;
  }
}
