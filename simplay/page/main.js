// The page of a printer to play with: joins its parts.

import { Config } from "./config.js";
import { Console } from "./console.js";
import { Dialog } from "./dialog.js";
import { follow } from "./follow.js";
import { verdict } from "./gap.js";
import { Hands, isTimed } from "./hands.js";
import { Lens } from "./lens.js";
import { Live } from "./live.js";
import { Moonraker } from "./moonraker.js";
import { Result } from "./result.js";
import { Side } from "./side.js";
import { DOTS, Top, WAY } from "./top.js";
import { showTour } from "./tour.js";

const $ = (id) => document.getElementById(id);
const MOST_LINES = 300;
const FLASH_MS = 350;
// Of a button that every printer has
const HOME = ["Home", "G28", false];
// What a project may say in its hello; see played.py
const NOTHING = {
  scene: "", scenes: [], shortcuts: [], first: [], parameters: {}, watched: [],
  cards: [], verdict: "", report: "", report_folder: "", tour: [], words: [],
};

const live = new Live();
const moonraker = new Moonraker();
const run = (script) => moonraker.run(script);
const terminal = new Console($("console"), $("typed"), $("input"), $("proposals"), typed);
const dialog = new Dialog($("dialog"), run, (axis) => side.turn(axis));
const result = new Result($("result"), $("report"), $("report-picture"), $("report-link"));
const side = new Side($("side"));
const lens = new Lens($("lens"), $("lens-words"));
const above = new Top($("top"), $("touched"));
const hands = new Hands($("tools"), $("told"), (line) => {
  // Whoever puts something right has read what was wrong
  terminal.failed = false;
  live.order(line);
  showNext();
});
const config = new Config($("config"), $("config-text"), $("config-save"), $("config-load"), $("config-told"),
  () => moonraker.restart());

let frame = null;
let machine = null;
// When this printer was chosen, s: what was said before is of another one
let since = 0;
// Lines to come that answer what was typed into the console, and are no G-code
let answers = 0;
// For tests, and for who is curious: pictures that were drawn
globalThis.drawn = 0;
const flashes = new Map();

// The machine

live.addEventListener("hello", ({ detail }) => {
  machine = { ...NOTHING, ...detail };
  $("machine").textContent = detail.machine;
  $("address").textContent = detail.moonraker.replace("http://", "");
  showSpot(detail.spot);
  const { scene, scenes } = machine;
  const names = scenes.includes(scene) || !scene ? scenes : [...scenes, scene];
  $("scene").replaceChildren(...names.map((name) => new Option(name, name, false, name === scene)));
  $("choice").hidden = !names.length;
  for (const part of [side, lens, above]) part.build(detail.parts);
  hands.build(detail);
  $("signals").replaceChildren(...detail.wires.map((wire) => {
    const chip = document.createElement("li");
    chip.textContent = wire;
    chip.dataset.signal = wire;
    return chip;
  }));
  if (detail.lines) {
    $("lines").replaceChildren();
    detail.lines.forEach(tellLine);
  } else {
    since = Date.now() / 1000;
    result.forget();
    config.forget();
  }
  showTour($("tour"), $("tour-steps"), machine.tour);
  result.know(machine);
  moonraker.watched = machine.watched;
  moonraker.connect(detail.moonraker);
});

live.addEventListener("frame", ({ detail }) => {
  const isFirst = frame === null;
  // A frame that was not drawn yet leaves its way and its touches to this one; a
  // page that nobody sees draws none for hours
  frame = isFirst ? detail : {
    ...detail,
    way: [...frame.way, ...detail.way].slice(-WAY),
    touches: [...frame.touches, ...detail.touches].slice(-DOTS),
  };
  if (isFirst) requestAnimationFrame(drawFrame);
});

function drawFrame() {
  const shown = frame;
  frame = null;
  globalThis.drawn += 1;
  if (!machine) return;
  const now = performance.now();
  for (const [site] of shown.touches) flashes.set(site, now + FLASH_MS);
  for (const [site, until] of flashes) if (until < now) flashes.delete(site);
  const [x, y, z] = shown.way[shown.way.length - 1];
  const seen = { ...shown, near: shown.near.map(([site, distance, pressed]) => [site, distance, pressed || flashes.has(site)]) };
  above.show(shown, { x, y, z });
  side.show(seen, { x, y, z });
  lens.show(seen, side.axes[0]);
  hands.show(shown);
  showSignals(shown);
  showGap(shown.gap, shown.spot);
  showSpot(shown.spot);
  if (document.activeElement !== $("speed")) showSpeed(shown.speed);
}

function showSignals({ on, touches }) {
  const signal = (site) => machine.parts.sites[site]?.signal;
  const touched = new Set([...touches.map(([site]) => site), ...flashes.keys()].map(signal));
  for (const chip of $("signals").children) {
    chip.classList.toggle("on", on.includes(chip.dataset.signal));
    chip.classList.toggle("flash", touched.has(chip.dataset.signal));
  }
}

function showGap(told, [, , wanted]) {
  // Of a klippy that has stopped nobody knows what its Z=0 is
  const isKnown = told !== null && moonraker.klippy === "ready";
  // As it is shown: 0.020 is right
  const gap = isKnown ? Math.round(told * 1000) / 1000 + 0 : null;
  const [kind, words] = verdict(gap, wanted);
  const shown = moonraker.klippy === "shutdown" ? "not known: klippy has stopped" : words;
  $("gap").textContent = isKnown ? `${gap.toFixed(3)} mm` : "–";
  $("gap").className = `big ${kind}`;
  if ($("gap-words").textContent !== shown) $("gap-words").textContent = shown;
}

// Another one where printer.cfg has another place
function showSpot([x, y]) {
  const words = `at X${x} Y${y}`;
  if ($("point").textContent !== words) $("point").textContent = words;
}

function showSpeed(speed) {
  $("speed").value = speed;
  $("speed-shown").textContent = `${Math.round(speed)}×`;
}

$("speed").addEventListener("input", () => {
  showSpeed(Number($("speed").value));
  live.order(`speed ${$("speed").value}`);
});
$("scene").addEventListener("change", () => live.choose($("scene").value));

// The terminal

const followLines = follow($("lines"));

function tellLine(line) {
  const lines = $("lines");
  const shown = Object.assign(document.createElement("div"), { textContent: line });
  if (/CRASH|IN THE BED|^!!/.test(line)) shown.className = "bad";
  lines.append(shown);
  while (lines.childElementCount > MOST_LINES) lines.firstChild.remove();
  followLines();
}

live.addEventListener("line", ({ detail }) => {
  tellLine(detail.line);
  if (!isTimed(detail.line)) hands.tell(detail.line);
});

// Klippy

function takeLines(lines) {
  for (const line of lines) {
    const isResult = result.take(line);
    terminal.add(line, isResult);
    dialog.take(line);
  }
}

function takeSent(script) {
  terminal.sent(script);
  result.sent(script);
}

// What was typed into the console: G-code, or a command of the terminal in small letters,
// unless klippy has one of that name (but for its own HELP).
function typed(script) {
  const [word] = script.split(/\s+/);
  const isGcode = word !== "help" && word.toUpperCase() in (moonraker.help || {});
  if (!machine?.words.includes(word) || isGcode) {
    run(script);
    return;
  }
  terminal.sent(script);
  answers += 1;
  live.order(script);
}

live.addEventListener("line", ({ detail: { line } }) => {
  if (!answers || isTimed(line)) return;
  answers -= 1;
  terminal.put(line, line.startsWith("!!") ? "error" : "");
});

moonraker.addEventListener("lines", ({ detail }) => { takeLines(detail); showNext(); });
moonraker.addEventListener("sent", ({ detail }) => takeSent(detail));
moonraker.addEventListener("ready", ({ detail: store }) => {
  terminal.know(moonraker.help, machine);
  terminal.clear();
  dialog.forget();
  result.forget();
  for (const { type, message, time } of store) {
    if (time < since) continue;
    if (type === "command") takeSent(message);
    else takeLines(message.split("\n"));
  }
  terminal.put("Klipper is ready", "ready");
  config.refresh();
  showShortcuts();
});

moonraker.addEventListener("status", ({ detail }) => {
  const warnings = Object.values(detail).flatMap((fields) => fields.warnings || []);
  result.warn(warnings);
  terminal.warn(warnings);
  showProgress();
  showNext();
});

function isHomed() {
  return ["x", "y", "z"].every((axis) => (moonraker.status.toolhead?.homed_axes || "").includes(axis));
}

// What klippy is at; null: nothing, or it has stopped.
function work() {
  if (moonraker.klippy !== "ready") return null;
  const told = Object.values(moonraker.status).find((fields) => fields.phase && fields.phase !== "idle");
  // Homing, levelling, a mesh: klippy tells only that it is at work
  return told || (moonraker.status.idle_timeout?.state === "Printing" ? { phase: "at work" } : null);
}

function showProgress() {
  const busy = work();
  $("progress").hidden = !busy;
  if (!busy) return;
  const phase = busy.phase.replaceAll("_", " ");
  // Before the first touch, and where none are counted, nobody knows how far it is
  if (busy.progress) $("bar").value = busy.progress;
  else $("bar").removeAttribute("value");
  $("phase").textContent = busy.progress ? `${phase} ${Math.round(busy.progress * 100)} %` : phase;
}

// Where to look, and what to press, next.
function showNext() {
  const main = known().find(([, , standsOut]) => standsOut);
  const words = moonraker.klippy === "shutdown" ? "press Restart: klippy has stopped."
    : moonraker.klippy === "error" ? "correct printer.cfg below, then press Save and restart: klippy refuses it."
    : moonraker.klippy !== "ready" ? "wait a moment: klippy starts."
    : !$("dialog").hidden ? "answer the question below."
    : terminal.failed ? "read the red line in the console. What you have broken, Repair everything mends."
    : work() ? "watch the pictures: the printer is at work."
    : !isHomed() ? "press Home: the toolhead looks for the ends of its axes."
    : result.isShown ? "look at the true gap: it says how good the result is."
    : main ? `press ${main[0]}, and watch the true gap.`
    : "type G-code, and watch what really happens.";
  if ($("next-words").textContent !== words) $("next-words").textContent = words;
  $("to-tour").hidden = !machine?.tour.length;
  for (const button of $("shortcuts").querySelectorAll("[data-runs]")) {
    const isHome = button.dataset.runs === HOME[1];
    const isNext = isHome ? !isHomed() : isHomed() && Boolean(main) && button.dataset.runs === main[1];
    // A question has a blue button of its own
    button.classList.toggle("primary", isNext && $("dialog").hidden);
  }
}

$("to-tour").addEventListener("click", () => { $("tour").querySelector("details").open = true; });

// Shortcuts that this klippy has.
function known() {
  if (!machine || !moonraker.help) return [];
  return machine.shortcuts.filter(([, script]) => script.split(" ")[0] in moonraker.help);
}

function showShortcuts() {
  const buttons = [HOME, ...known()].map(([label, script]) => {
    const button = document.createElement("button");
    button.textContent = label;
    button.title = script;
    button.dataset.runs = script;
    button.addEventListener("click", () => run(script));
    return button;
  });
  const stop = Object.assign(document.createElement("button"), { textContent: "Emergency stop", className: "error" });
  stop.addEventListener("click", () => moonraker.stop());
  const restart = Object.assign(document.createElement("button"), { textContent: "Restart" });
  restart.title = "RESTART; FIRMWARE_RESTART after a shutdown";
  restart.addEventListener("click", () => moonraker.restart());
  $("shortcuts").replaceChildren(...buttons, restart, stop);
  showNext();
}

// Who is away

function showStates() {
  const states = {
    printer: live.moves ? "on" : "bad",
    moonraker: moonraker.isOpen ? "on" : "bad",
    klippy: moonraker.klippy === "ready" ? "on" : "bad",
  };
  for (const [name, state] of Object.entries(states)) $(`state-${name}`).className = state;
  const start = machine ? `: start it with \`${machine.program}\`` : "";
  const why = !live.isOpen ? `The playground has ended, or cannot be reached${start}. This page goes on when it is there.`
    : !moonraker.isOpen ? `Moonraker does not answer at ${moonraker.url}. This page goes on when it does.`
    : moonraker.klippy === "ready" ? ""
    : moonraker.klippy === "away" ? "klippy is away: it is switched off, or it restarts."
    : `klippy is not ready (${moonraker.klippy}): ${moonraker.message}`;
  if (moonraker.klippy !== "ready") result.takeBack();
  showProgress();
  showNext();
  $("away").hidden = !why;
  if ($("away").textContent !== why) $("away").textContent = why;
  const isReady = moonraker.klippy === "ready";
  for (const button of $("shortcuts").querySelectorAll("[data-runs]")) button.disabled = !isReady;
}

live.addEventListener("pulse", showStates);
moonraker.addEventListener("state", ({ detail }) => {
  showStates();
  config.klippy(detail, moonraker.message);
});
