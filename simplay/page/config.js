// printer.cfg: read, changed, written as a whole, and a restart.

export class Config {
  constructor(details, text, save, load, told, restart) {
    Object.assign(this, { details, text, told, restart });
    this.mark = "";
    // What was written: "written", then "restarting" until klippy has read it
    this.stage = "";
    details.addEventListener("toggle", () => { if (details.open && !this.isChanged()) this.load(); });
    save.addEventListener("click", () => this.save());
    load.addEventListener("click", () => this.load());
  }

  isChanged() {
    return Boolean(this.mark) && this.text.value !== this.known;
  }

  // After a restart there may be another one.
  refresh() {
    if (this.details.open && !this.isChanged()) this.load(false);
  }

  // Another printer has another file, whatever was typed for this one.
  forget() {
    this.mark = "";
    this.stage = "";
    this.tell("");
  }

  async load(isAsked = true) {
    try {
      const answer = await fetch("/printer.cfg", { cache: "no-store" });
      if (!answer.ok) throw new Error(`it cannot be read (${answer.status})`);
      this.mark = answer.headers.get("ETag");
      this.text.value = await answer.text();
      this.known = this.text.value;
      if (isAsked) this.tell("");
    } catch (error) {
      this.tell(error.message, "bad-text");
    }
  }

  async save() {
    try {
      const answer = await fetch("/printer.cfg", { method: "PUT", headers: { "If-Match": this.mark }, body: this.text.value });
      if (answer.status === 412) throw new Error("it has changed meanwhile: copy what you wrote, and read it again");
      if (!answer.ok) throw new Error(`it was not written (${answer.status})`);
      this.mark = answer.headers.get("ETag");
      this.known = this.text.value;
      this.stage = "written";
      this.tell("written; klippy restarts");
      this.restart();
    } catch (error) {
      this.tell(error.message, "bad-text");
    }
  }

  // How klippy is: whether it takes what was written.
  klippy(state, message) {
    if (this.stage === "written" && state !== "ready" && state !== "error") this.stage = "restarting";
    if (this.stage !== "restarting" || !["ready", "error", "shutdown"].includes(state)) return;
    this.stage = "";
    if (state === "ready") {
      this.tell("klippy has read it, and is ready", "good-text");
      return;
    }
    this.tell(`klippy refuses it: ${message.split("\n")[0]}`, "bad-text");
    this.told.scrollIntoView({ block: "nearest" });
  }

  tell(text, kind = "quiet") {
    this.told.textContent = text;
    this.told.className = kind;
  }
}
