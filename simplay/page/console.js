// The console: lines, and an input with history and completion.

import { follow } from "./follow.js";

const MOST_LINES = 400, MOST_COMMANDS = 100;

export class Console {
  constructor(lines, form, input, proposals, send) {
    Object.assign(this, { lines, input, proposals, send });
    this.follow = follow(lines);
    this.commands = [];
    // The line of the last result since something was sent
    this.result = null;
    // Whether there was an error since
    this.failed = false;
    // By command: names and meanings
    this.parameters = {};
    this.history = JSON.parse(sessionStorage.getItem("history") || "[]");
    this.place = this.history.length;
    this.chosen = -1;
    this.found = [];
    // Closed with Escape: Tab leaves the field until something is typed
    this.isDismissed = false;
    form.addEventListener("submit", (event) => { event.preventDefault(); this.submit(); });
    input.addEventListener("keydown", (event) => this.key(event));
    input.addEventListener("input", () => { this.isDismissed = false; this.propose(false); });
    input.addEventListener("blur", () => this.close());
  }

  // Names and helps of all commands there are; of some, what their parameters mean; how
  // those begin that come first when one completes.
  know(help, { parameters, first }) {
    this.parameters = parameters;
    const names = Object.keys(help).filter((name) => !name.startsWith("_"));
    const rank = (name) => (first.some((begin) => name.startsWith(begin)) ? 0 : 1);
    names.sort((a, b) => rank(a) - rank(b) || a.localeCompare(b));
    this.commands = names.map((name) => [name, help[name]]);
  }

  clear() {
    this.lines.replaceChildren();
    this.result = null;
    this.failed = false;
  }

  // A line as klippy sends it; `isResult`: whether it tells what a command has found.
  add(line, isResult) {
    if (line.startsWith("// action:")) return;
    const text = line.replace(/^\/\/ ?/, "");
    const kind = line.startsWith("!!") ? "error" : isResult || /-->|\+-\d/.test(text) ? "result" : "";
    const shown = this.put(text, kind);
    if (kind === "error") this.failed = true;
    if (kind !== "result") return;
    // The last one of a command is its result
    if (this.result) this.result.className = "";
    this.result = shown;
  }

  sent(script) {
    this.result = null;
    this.failed = false;
    this.put(`> ${script.replaceAll("\n", "\n> ")}`, "sent");
  }

  // Colour the lines that have a text in them.
  warn(texts) {
    for (const line of this.lines.children) {
      if (!line.className && texts.some((text) => line.textContent.includes(text))) line.className = "warning";
    }
  }

  put(text, kind) {
    const { lines } = this;
    const line = document.createElement("div");
    line.textContent = text;
    line.className = kind;
    lines.append(line);
    while (lines.childElementCount > MOST_LINES) lines.firstChild.remove();
    this.follow();
    return line;
  }

  submit() {
    const script = this.input.value.trim();
    this.close();
    if (!script) return;
    this.history = [...this.history.filter((old) => old !== script), script].slice(-MOST_COMMANDS);
    sessionStorage.setItem("history", JSON.stringify(this.history));
    this.place = this.history.length;
    this.input.value = "";
    this.send(script);
  }

  key(event) {
    const isOpen = !this.proposals.hidden;
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    const completes = event.key === "Tab" && !event.shiftKey && this.input.value && !this.isDismissed;
    if (completes && (isOpen || this.propose(true))) {
      event.preventDefault();
      this.complete();
    } else if (event.key === "Escape" && isOpen) {
      event.preventDefault();
      this.isDismissed = true;
      this.close();
    } else if (event.key === "Enter" && isOpen && this.chosen >= 0) {
      event.preventDefault();
      this.take(this.chosen);
    } else if (step && isOpen && (step > 0 || this.chosen >= 0)) {
      event.preventDefault();
      this.choose(this.chosen + step);
    } else if (step) {
      event.preventDefault();
      this.close();
      this.place = Math.max(0, Math.min(this.history.length, this.place + step));
      this.input.value = this.history[this.place] || "";
    }
  }

  // What may stand where the last word is: [name, meaning], and what follows a name.
  candidates() {
    const typed = this.input.value.toUpperCase();
    const [, before, word] = /^(.*?)(\S*)$/.exec(typed);
    this.before = this.input.value.slice(0, before.length);
    const [command, ...given] = before.trim().split(/\s+/);
    if (!command) return { word, all: this.commands, ending: " " };
    const names = new Set(given.map((text) => text.split("=")[0]));
    const all = Object.entries(this.parameters[command] || {}).filter(([name]) => !names.has(name));
    return { word, all, ending: "=" };
  }

  // Show what begins with, or has in it, what was typed; whether there is any.
  propose(isAsked) {
    const { word, all, ending } = this.candidates();
    const least = ending === "=" ? 0 : isAsked ? 1 : 2;
    const begins = word.length >= least ? all.filter(([name]) => name.startsWith(word)) : [];
    const holds = word.length >= Math.max(least, 1) ? all.filter(([name]) => name.indexOf(word) > 0) : [];
    this.found = [...begins, ...holds].slice(0, 14);
    this.ending = ending;
    if (!this.found.length || (ending === " " && begins.length === 1 && begins[0][0] === word)) {
      this.close();
      return false;
    }
    this.proposals.replaceChildren(...this.found.map(([name, help], index) => {
      const row = document.createElement("div");
      row.setAttribute("role", "option");
      row.id = `proposal-${index}`;
      row.append(name, " ");
      row.append(Object.assign(document.createElement("span"), { textContent: help || "" }));
      row.addEventListener("mousedown", (event) => { event.preventDefault(); this.take(index); });
      return row;
    }));
    this.proposals.hidden = false;
    this.input.setAttribute("aria-expanded", "true");
    this.chosen = -1;
    return true;
  }

  choose(index) {
    this.chosen = Math.max(-1, Math.min(this.found.length - 1, index));
    [...this.proposals.children].forEach((row, i) => {
      row.setAttribute("aria-selected", String(i === this.chosen));
      if (i === this.chosen) row.scrollIntoView({ block: "nearest" });
    });
    this.input.setAttribute("aria-activedescendant", this.chosen < 0 ? "" : `proposal-${this.chosen}`);
  }

  // As far as all that is proposed agrees, or to what is chosen.
  complete() {
    if (this.chosen >= 0 || this.found.length === 1) {
      this.take(Math.max(0, this.chosen));
      return;
    }
    const { word } = this.candidates();
    const names = this.found.map(([name]) => name).filter((name) => name.startsWith(word));
    let common = names[0] || word;
    while (names.some((name) => !name.startsWith(common))) common = common.slice(0, -1);
    if (common.length > word.length) this.input.value = this.before + common;
    else this.choose(this.chosen + 1);
  }

  take(index) {
    this.candidates();
    this.input.value = `${this.before}${this.found[index][0]}${this.ending}`;
    this.close();
    // The parameters of a command that was taken
    if (this.ending === " ") this.propose(true);
  }

  close() {
    this.proposals.hidden = true;
    this.chosen = -1;
    this.input.setAttribute("aria-expanded", "false");
    this.input.setAttribute("aria-activedescendant", "");
  }
}
