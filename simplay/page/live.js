// What the simulation itself shows: frames of the machine, and its terminal.

const RETRY_MS = 1000;
// Frames come 20 times a second; without any for so long it is switched off
const SILENT_MS = 3000;

export class Live extends EventTarget {
  constructor() {
    super();
    this.frames = 0;
    this.isOpen = false;
    this.lastFrame = 0;
    this.connect();
    setInterval(() => this.tell("pulse", null), 500);
  }

  // Whether the simulated machine lives.
  get moves() {
    return this.isOpen && performance.now() - this.lastFrame < SILENT_MS;
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/live`);
    this.socket = socket;
    socket.onopen = () => { this.isOpen = true; };
    socket.onclose = () => {
      this.isOpen = false;
      setTimeout(() => this.connect(), RETRY_MS);
    };
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.kind === "frame") {
        this.frames += 1;
        this.lastFrame = performance.now();
      }
      this.tell(message.kind, message);
    };
  }

  tell(kind, detail) {
    this.dispatchEvent(new CustomEvent(kind, { detail }));
  }

  // Do what could be typed at the terminal.
  order(line) {
    this.send({ do: line });
  }

  choose(scene) {
    this.send({ scene });
  }

  send(message) {
    if (this.isOpen) this.socket.send(JSON.stringify(message));
  }
}
