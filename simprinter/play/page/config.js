// printer.cfg: read, changed, written as a whole, and a restart.

export class Config {
  constructor(details, text, save, load, told, restart) {
    Object.assign(this, { details, text, told, restart });
    this.mark = "";
    details.addEventListener("toggle", () => { if (details.open && !this.isChanged()) this.load(); });
    save.addEventListener("click", () => this.save());
    load.addEventListener("click", () => this.load());
  }

  isChanged() {
    return Boolean(this.mark) && this.text.value !== this.known;
  }

  // After a restart there may be another one.
  refresh() {
    if (this.details.open && !this.isChanged()) this.load();
  }

  async load() {
    try {
      const answer = await fetch("/printer.cfg", { cache: "no-store" });
      if (!answer.ok) throw new Error(`it cannot be read (${answer.status})`);
      this.mark = answer.headers.get("ETag");
      this.text.value = await answer.text();
      this.known = this.text.value;
      this.tell("");
    } catch (error) {
      this.tell(error.message);
    }
  }

  async save() {
    try {
      const answer = await fetch("/printer.cfg", { method: "PUT", headers: { "If-Match": this.mark }, body: this.text.value });
      if (answer.status === 412) throw new Error("it has changed meanwhile: copy what you wrote, and read it again");
      if (!answer.ok) throw new Error(`it was not written (${answer.status})`);
      this.mark = answer.headers.get("ETag");
      this.known = this.text.value;
      this.tell("written; klippy restarts");
      this.restart();
    } catch (error) {
      this.tell(error.message);
    }
  }

  tell(text) {
    this.told.textContent = text;
  }
}
