// Klippy, through the websocket of the real Moonraker.

const RETRY_MS = 1000;
const LOOK_MS = 1500;

export class Moonraker extends EventTarget {
  constructor() {
    super();
    this.url = "";
    // Sections whose status is shown
    this.watched = [];
    this.isOpen = false;
    this.klippy = "away";
    this.message = "";
    this.status = {};
    this.number = 0;
    this.waiting = new Map();
    setInterval(() => { if (this.isOpen && this.klippy !== "ready") this.look(); }, LOOK_MS);
  }

  connect(url) {
    if (url === this.url) return;
    this.url = url;
    this.open();
  }

  open() {
    const socket = new WebSocket(this.url.replace("http", "ws") + "/websocket");
    this.socket = socket;
    socket.onopen = () => { this.isOpen = true; this.look(); };
    socket.onclose = () => {
      this.isOpen = false;
      for (const { reject } of this.waiting.values()) reject(new Error("Moonraker is away"));
      this.waiting.clear();
      this.become("away", "");
      setTimeout(() => this.open(), RETRY_MS);
    };
    socket.onmessage = (event) => this.receive(JSON.parse(event.data));
  }

  tell(kind, detail) {
    this.dispatchEvent(new CustomEvent(kind, { detail }));
  }

  call(method, params = {}) {
    if (!this.isOpen) return Promise.reject(new Error("Moonraker is away"));
    const id = ++this.number;
    this.socket.send(JSON.stringify({ jsonrpc: "2.0", id, method, params }));
    return new Promise((resolve, reject) => this.waiting.set(id, { resolve, reject }));
  }

  receive(message) {
    const waiting = this.waiting.get(message.id);
    if (waiting) {
      this.waiting.delete(message.id);
      if (message.error) waiting.reject(new Error(message.error.message));
      else waiting.resolve(message.result);
    } else if (message.method === "notify_gcode_response") {
      this.tell("lines", message.params[0].split("\n"));
    } else if (message.method === "notify_status_update") {
      this.take(message.params[0]);
    } else if (message.method === "notify_klippy_disconnected") {
      // Whoever asks may be told "ready" of the one that follows, which is to be
      // subscribed to anew
      this.become("away", "");
      this.look();
    } else if (/^notify_klippy_/.test(message.method || "")) {
      this.look();
    }
  }

  take(status) {
    for (const [name, fields] of Object.entries(status)) {
      this.status[name] = { ...this.status[name], ...fields };
    }
    this.tell("status", this.status);
  }

  // Ask how klippy is, and what it has when it has become ready.
  async look() {
    try {
      const info = await this.call("server.info");
      let message = "";
      if (info.klippy_connected && info.klippy_state !== "ready") {
        message = (await this.call("printer.info")).state_message;
      }
      const state = info.klippy_connected ? info.klippy_state : "away";
      if (state === "ready" && this.klippy !== "ready") await this.begin();
      this.become(state, message);
    } catch (error) {
      this.become("away", error.message);
    }
  }

  become(klippy, message) {
    this.klippy = klippy;
    this.message = message;
    this.tell("state", klippy);
  }

  async begin() {
    const { objects } = await this.call("printer.objects.list");
    const wanted = { toolhead: ["homed_axes", "position"], idle_timeout: ["state"] };
    for (const name of objects) if (this.watched.includes(name.split(" ")[0])) wanted[name] = null;
    this.status = {};
    const { status } = await this.call("printer.objects.subscribe", { objects: wanted });
    this.help = await this.call("printer.gcode.help");
    const { gcode_store: store } = await this.call("server.gcode_store", { count: 200 });
    this.tell("ready", store);
    this.take(status);
  }

  // Run G-code; the console shows what comes of it.
  async run(script) {
    this.tell("sent", script);
    try {
      await this.call("printer.gcode.script", { script });
    } catch (error) {
      // What klippy refuses stands in the console already
      if (!this.isOpen || this.klippy !== "ready") this.tell("lines", [`!! ${error.message}`]);
    }
  }

  // Beside the G-code that is running.
  stop() {
    return this.call("printer.emergency_stop").catch(() => {});
  }

  // After a shutdown the boards have to be reset, too.
  restart() {
    const how = this.klippy === "shutdown" ? "printer.firmware_restart" : "printer.restart";
    return this.call(how).catch((error) => this.tell("lines", [`!! ${error.message}`]));
  }
}
