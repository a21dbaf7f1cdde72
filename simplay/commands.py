"""What can be typed while a printer is played with: faults, and repairs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from simplay.options import speed_of
from simplay.watcher import Watcher
from simprinter import Fault, Scene
from simprinter.simulation import Pace

# What ends the printer, where it was started
ENDS = ("quit", "exit")
# The printer's seconds for which a hand presses a switch
_PRESSED = 2.0


class CommandError(Exception):
    """What was typed cannot be done; the text says why."""


class Command(NamedTuple):
    """words: how it is typed, after its name."""

    words: str
    help: str
    run: Callable[[Watcher, Scene, list[str]], str]


def run(line: str, watcher: Watcher, scene: Scene) -> str:
    """Do what was typed; what to show. Raises CommandError."""
    name, *words = line.split()
    if name in ENDS:
        raise CommandError(
            f"{name}: only in the terminal, whose printer ends then"
        )
    if name not in COMMANDS:
        raise CommandError(f"{name}: unknown, 'help' lists the commands")
    command = COMMANDS[name]
    needed = command.words.split()
    least = sum(not word.startswith("[") for word in needed)
    if not least <= len(words) <= len(needed):
        raise CommandError(f"usage: {name} {command.words}".rstrip())
    try:
        return command.run(watcher, scene, words)
    except ValueError as error:
        raise CommandError(f"{name}: {error}") from error


def possible(scene: Scene) -> list[str]:
    """The commands for what this printer has."""
    world = scene.world
    has = {name: bool(world.probes()) for name in ("attach", "drop", "off")}
    has.update(lay=bool(world.membranes()), take=bool(world.membranes()))
    return [name for name in COMMANDS if has.get(name, True)]


def wires(scene: Scene) -> Mapping[str, str]:
    """The wires that can break: the signal and its pin."""
    return scene.wiring.inputs


def _pin_of(scene: Scene, name: str) -> str:
    known = wires(scene)
    if name not in known:
        raise CommandError(f"no wire {name}, only {', '.join(known)}")
    return known[name]


def _stick(watcher: Watcher, name: str, is_asserted: bool) -> str:
    kind = "stuck_closed" if is_asserted else "stuck_open"
    fault = Fault(kind, signal=name, t=watcher.seconds(), strikes="may")
    watcher.machine.break_down(fault)
    return "always triggered" if is_asserted else "never triggered"


def _break(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    pin = _pin_of(scene, words[0])
    # A pull-up makes an open wire read high; without one it may be anything
    reads_high = "^" in pin
    state = _stick(watcher, words[0], reads_high and "!" not in pin)
    return f"the wire of {words[0]} is broken: {state}"


def _short(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    state = _stick(watcher, words[0], "!" in _pin_of(scene, words[0]))
    return f"the wire of {words[0]} is shorted to ground: {state}"


def _late(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    name, mm = words[0], float(words[1])
    _pin_of(scene, name)
    fault = Fault(
        "trigger_late", signal=name, mm=mm, persistent=True, strikes="may"
    )
    watcher.machine.break_down(fault)
    return f"{name} triggers {mm:g} mm too deep from now on"


def _press(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    name = words[0]
    _pin_of(scene, name)
    hold = watcher.machine.hold
    hold(name, True)
    watcher.later(_PRESSED, lambda: hold(name, None))
    return f"a hand presses {name} for {_PRESSED:g} s"


def _which(signals: list[str], words: list[str], missing: str) -> str:
    """The one of them that was typed, else the first."""
    if not signals:
        raise CommandError(f"this printer has no {missing}")
    if words and words[0] not in signals:
        raise CommandError(f"no {words[0]}, only {', '.join(signals)}")
    return words[0] if words else signals[0]


def _probe(scene: Scene, words: list[str], what: str) -> str:
    signals = [probe.signal for probe in scene.world.probes()]
    return _which(signals, words, f"probe to {what}")


def _attach(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    probe = _probe(scene, words, "put on the toolhead")
    watcher.machine.world.put_probe_on(watcher.seconds(), probe)
    return f"{_the(probe)} is on the toolhead"


def _off(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    probe = _on_head(watcher, scene, words, "take off")
    watcher.machine.world.take_probe_off(watcher.seconds(), probe)
    return f"{_the(probe)} is off the toolhead; 'attach' puts it on again"


def _drop(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    probe = _on_head(watcher, scene, words, "drop")
    watcher.machine.world.lose_probe(watcher.seconds(), probe)
    return f"{_the(probe)} has fallen off; 'repair' puts it back"


def _the(probe: str) -> str:
    return "the probe" if probe == "probe" else f"the probe {probe}"


def _on_head(
    watcher: Watcher, scene: Scene, words: list[str], what: str
) -> str:
    probe = _probe(scene, words, what)
    if (
        watcher.machine.world.probe_state(watcher.seconds(), probe)
        != "attached"
    ):
        raise CommandError(f"the toolhead does not carry {_the(probe)} now")
    return probe


def _mm(text: str, low: float, high: float) -> float:
    mm = float(text)
    if not low <= mm <= high:
        raise ValueError(f"{text} is not from {low:g} to {high:g} mm")
    return mm


def _dirt(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    height = _mm(words[0], 0.0, 0.3)
    watcher.machine.world.smear_nozzle(watcher.seconds(), height)
    if not height:
        return "the nozzle is clean"
    return f"{height:g} mm of plastic hang below the nozzle"


def _nozzle(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    lower = _mm(words[0], -0.5, 0.5)
    watcher.machine.world.exchange_nozzle(lower)
    return _compared("nozzle: its tip hangs", lower, "lower", "higher")


def _plate(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    higher = _mm(words[0], -0.5, 0.5)
    watcher.machine.world.exchange_plate(higher)
    return _compared("plate: its surface is", higher, "higher", "lower")


def _compared(what: str, mm: float, more: str, less: str) -> str:
    name, _, rest = what.partition(":")
    if not mm:
        return f"the first {name} again"
    word = more if mm > 0 else less
    return f"another {name}:{rest} {abs(mm):g} mm {word} than that of the first"


def _membrane(
    watcher: Watcher, scene: Scene, words: list[str], is_laid: bool
) -> str:
    signals = [part.signal for part in scene.world.membranes()]
    signal = _which(signals, words, "membrane switch")
    watcher.machine.lay_membrane(is_laid, signal)
    if any(watcher.machine.world.laid.values()) and not is_laid:
        return f"{signal} is taken away"
    name = "" if signal == "membrane" else f" {signal}"
    return (
        f"the membrane{name} lies on the bed" if is_laid else "the bed is free"
    )


def _repair(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    watcher.machine.repair()
    for probe in scene.world.probes():
        watcher.machine.world.bring_probe_back(watcher.seconds(), probe.signal)
    watcher.machine.world.smear_nozzle(watcher.seconds(), 0.0)
    return "all is as good as new"


def _gap(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    watcher.ask_gap()
    return "the true gap, as soon as the toolhead stands:"


def _speed(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    speed = speed_of(words[0])
    simulation = watcher.machine.simulation
    simulation.pace = Pace(simulation.clock, speed)
    return f"{speed:g} times as fast as a real printer"


def _help(watcher: Watcher, scene: Scene, words: list[str]) -> str:
    lines = [
        f"  {name + ' ' + command.words:16} {command.help}"
        for name, command in COMMANDS.items()
    ]
    return "\n".join([*lines, f"Wires: {', '.join(wires(scene))}"])


COMMANDS = {
    "break": Command("WIRE", "a wire breaks", _break),
    "short": Command("WIRE", "a wire touches ground", _short),
    "late": Command("WIRE MM", "a sensor gets slack", _late),
    "press": Command("WIRE", "press a switch by hand, let go", _press),
    "attach": Command(
        "[PROBE]", "put the probe on the toolhead by hand", _attach
    ),
    "off": Command("[PROBE]", "take the probe off the toolhead by hand", _off),
    "drop": Command("[PROBE]", "the probe falls off", _drop),
    "repair": Command("", "take all faults back", _repair),
    "lay": Command(
        "[MEMBRANE]",
        "lay the membrane on the bed",
        lambda watcher, scene, words: _membrane(watcher, scene, words, True),
    ),
    "take": Command(
        "[MEMBRANE]",
        "take the membrane away",
        lambda watcher, scene, words: _membrane(watcher, scene, words, False),
    ),
    "dirt": Command("MM", "plastic below the nozzle; 0: clean", _dirt),
    "nozzle": Command("MM", "another nozzle, so much longer", _nozzle),
    "plate": Command("MM", "another plate, so much thicker", _plate),
    "gap": Command("", "the true gap at Z=0", _gap),
    "speed": Command("N", "1 to 20 times real time", _speed),
    "help": Command("", "this list", _help),
}
