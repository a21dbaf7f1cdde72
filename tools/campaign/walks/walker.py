"""Goes one walk: does each step, and has the world judge it."""

from __future__ import annotations

import re
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Callable, Optional

from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError, SessionError
from simprinter.world.truth import Crash
from tools.campaign.judge import shape
from tools.campaign.walks import card, doing
from tools.campaign.walks import steps as stepping
from tools.campaign.walks.printers import Owned
from tools.campaign.walks.steps import Step
from tools.kit.printer import Printer

# Beyond what a step of the motors and the noise explain (mm)
GAP_ERROR = 0.02
# Whose nozzle comes so near to the bed (mm) puts paper below it and goes on by hand
NEAR = 1.0
# Of a hand, and what it holds (mm)
HAND = 15.0
# From where the bed is to the lowest that a membrane is looked for (mm)
MEMBRANE_FLOOR = 1.5
# Of one command, printer seconds: a mesh of nine points takes 100
LIMIT = 900.0
LOOK = """\
SAVE_GCODE_STATE NAME=look_at_gap
G90
G1 Z30 F1200
G1 X%g Y%g F9000
G1 Z10 F1200
M400"""
# Commands that leave all as it was when they refuse
ALONE = tuple(
    command
    for section in ("z_calibration", "auto_z_offset", "extra_probe membrane")
    for command in stepping.OF_SECTION[section]
    if "\n" not in command
)
_ACROSS = re.compile(r"G1 X(\S+) Y(\S+) F9000")
AFTER_LOOK = "RESTORE_GCODE_STATE NAME=look_at_gap"


class HarmError(AssertionError):
    """The world was hurt, or what klippy says is not so."""


@dataclass
class Outcome:
    """What came of a walk.

    harm: what was wrong with which step; empty if nothing. refusals: of
    printers with which nothing is wrong, by their shape. done: of each kind of
    step, how many without an error.
    """

    harm: str = ""
    kind: str = ""
    refusals: Counter[str] = field(default_factory=Counter)
    done: Counter[str] = field(default_factory=Counter)
    refused_at_start: str = ""


class Walker:
    """One printer on which a walk goes on."""

    def __init__(
        self,
        printer: Printer,
        owned: Owned,
        outcome: Outcome,
        say: Callable[[str], None],
    ) -> None:
        self.say = say
        self.printer = printer
        self.owned = owned
        self.outcome = outcome
        # The step that is being done, for people, and why it was refused
        self.step = ""
        self.refusal = ""
        self.does: Mapping[str, Callable[[Any], None]] = {
            "gcode": self._gcode,
            "wait": lambda seconds: printer.session.wait(float(seconds)),
            "away": lambda to: self._gcode(stepping.AWAY % tuple(to)),
            "lower": self._lower,
            "answer": partial(doing.answer, printer.session, self._gcode),
            "late": partial(doing.late, printer.session, self._gcode),
            "twice": partial(doing.twice, printer.session, self._gcode),
            "card": partial(doing.print_card, printer.session, self._gcode),
            "save": partial(doing.save, printer.session),
            "restart": self._restart,
            "both": self._both,
            "hand": self._hand,
            "print": self._print,
        }

    def go(self, walk: Sequence[Step]) -> None:
        """All steps. Raises HarmError at the first that does harm."""
        console = self.printer.session.console
        for number, (kind, what) in enumerate(walk, 1):
            before = self._state()
            shown = len(console)
            self.step, self.refusal = f"step {number}, {kind} {what!r}", ""
            self.say(f"--- {self.step}")
            try:
                self.does[kind](what)
            except SessionError as error:
                self._fail("hang", str(error).splitlines()[0])
            for line in console[shown:]:
                self.say(line)
            self._count(kind, what)
            self._judge(kind, what, before)

    def _count(self, kind: str, what: Any) -> None:
        if self.refusal:
            self.outcome.refusals[shape(self.refusal)] += 1
        else:
            name = str(what).splitlines()[-1].split()[0]
            self.outcome.done[name if kind == "gcode" else kind] += 1

    def _fail(self, sort: str, text: str) -> None:
        self.outcome.kind = sort
        raise HarmError(f"{sort}: {self.step}: {text}")

    # Steps

    def _gcode(self, script: str) -> None:
        try:
            self.printer.session.run(self._around(script), LIMIT)
        except GcodeError as error:
            self.refusal = str(error)

    def _around(self, script: str) -> str:
        return around(self.owned, script)

    def _print(self, calibration: str) -> None:
        """As PRINT_START: what the owner has put on the head, he takes off."""
        script = "G28\n"
        if self.owned.has("dockable_probe"):
            script += "DETACH_PROBE\n"
        self._gcode(script + calibration)
        # Of a docking that is delayed, and of heating
        self.printer.session.wait(10.0)
        if not self.refusal:
            self._gcode(stepping.first_layer())

    def _lower(self, distance: float) -> None:
        """As a person with paper does, who looks at the nozzle."""
        if self.printer.status("manual_probe").get("is_active"):
            tip = self.printer.machine.tip()
            truth = self.printer.machine.truth
            room = truth.true_gap(*tip) - hanging(self.printer) - NEAR
            distance = min(distance, room)
            if distance > 0.0:
                self._gcode(f"TESTZ Z=-{distance:.3f}\nM400")
                self.printer.session.wait(0.5)

    def _restart(self, command: str) -> None:
        self.printer.session.restart(command)

    def _both(self, commands: Sequence[str]) -> None:
        """The second comes from another client while the first runs."""
        session = self.printer.session
        first = session.begin(self._around(commands[0]))
        begun = self._now() + 2.0
        session.run_until(first, lambda: self._now() >= begun)
        second = session.begin(self._around(commands[1]))
        for command in first, second:
            try:
                session.finish(command, LIMIT)
            except GcodeError as error:
                self.refusal = self.refusal or str(error)

    def _now(self) -> float:
        machine = self.printer.machine
        return machine.rig.seconds(machine.simulation.clock.now())

    def _hand(self, name: str) -> None:
        machine = self.printer.machine
        world = machine.world
        machine.rig.settle(machine.simulation.clock.now())
        now = self._now()
        # No hand fits below a nozzle that is down
        if machine.truth.true_gap(*machine.tip(), now) < HAND:
            return
        if name == "lay_membrane":
            machine.lay_membrane()
        elif name == "take_membrane":
            machine.lay_membrane(False)
        elif name.startswith("press_"):
            signal = name.replace("press_", "", 1)
            doing.finger(self.printer.session, machine, signal)
        else:
            getattr(world, name)(now)

    # The judge

    def _state(self) -> dict[str, Any]:
        """What a refusal leaves as it was."""
        toolhead = self.printer.status("toolhead")
        gcode_move = self.printer.status("gcode_move")
        return {
            "the G-code offset": gcode_move["homing_origin"][2],
            "G90": gcode_move["absolute_coordinates"],
            "max_accel": toolhead["max_accel"],
            "max_velocity": toolhead["max_velocity"],
            "position_min": toolhead["axis_minimum"][2],
        }

    def _judge(self, kind: str, what: Any, before: dict[str, Any]) -> None:
        state, message = self.printer.session.state()
        if state != "ready":
            self._fail("shutdown", message.splitlines()[0])
        if "nternal error" in self.refusal:
            self._fail("internal error", self.refusal)
        self.printer.session.wait(0.3)
        truth = self.printer.machine.truth
        crashes = [crash for crash in truth.crashes() if not self._may(crash)]
        if crashes:
            reason = f" (refused: {self.refusal})" if self.refusal else ""
            self._fail("harm", "; ".join(map(str, crashes)) + reason)
        if kind == "gcode" and self.refusal:
            self._check_left(what, before)
        elif kind == "gcode":
            self._check_probe(what)
            if what == "CALIBRATE_Z":
                self._check_gap()

    def _check_left(self, what: str, before: dict[str, Any]) -> None:
        """A refusal has left nothing behind."""
        after = self._state()
        changed = {
            k: (before[k], after[k]) for k in after if after[k] != before[k]
        }
        if changed and what in ALONE:
            self._fail("left behind", f"{changed} after {self.refusal}")

    def _may(self, crash: Crash) -> bool:
        """What docs/reliability allows: a membrane that was not laid down.

        The floor counts from where its owner has Z=0.
        """
        allowed = MEMBRANE_FLOOR + abs(self.owned.too_high) + self.owned.uneven
        membrane = self.owned.has("extra_probe membrane")
        return (
            membrane and crash.site == "nozzle_bed" and crash.depth <= allowed
        )

    def _check_probe(self, what: str) -> None:
        """The dock's commands have done what they say."""
        wanted = {"ATTACH_PROBE": "attached", "DETACH_PROBE": "docked"}.get(
            what
        )
        if wanted is not None:
            now = self.printer.machine.world.probe_state(self._now())
            if now != wanted:
                self._fail("lie", f"the probe is {now}")

    def _check_gap(self) -> None:
        """The true gap at Z=0, where the bed was measured."""
        printer = self.printer
        status = printer.status("z_calibration")
        console = printer.session.console
        x, y = printer.bed_point()
        look = self._around(LOOK % (x, y))
        try:
            printer.session.run(look, LIMIT)
        except GcodeError:
            # The probe may hang there by its owner's wish, and the dock be far
            return
        printer.session.wait(0.5)
        gap = printer.machine.gap_at_zero(10.0, (x, y))
        printer.session.run(AFTER_LOOK)
        last = status.get("last_result") or {}
        told = float(last.get("uncertainty") or 0.0)
        right = printer.scene.formula_gap() + self._asked()
        error = gap - right
        if abs(error) > GAP_ERROR + told and not _is_told(console):
            text = (
                f"the gap is {gap:.4f}, right is {right:.4f}, nothing is told"
            )
            self._fail("wrong offset", text)

    def _asked(self) -> float:
        """What the owner's own macros add to the offset (mm)."""
        options = {row[:2]: row[2] for row in self.owned.options}
        hook = options.get(("z_calibration", "end_gcode")) or ""
        found = re.fullmatch(r"SET_GCODE_OFFSET Z=(\S+)", hook)
        return float(found.group(1)) if found else 0.0


def _is_told(console: Sequence[str]) -> bool:
    """Whether the last run has warned of its own result."""
    recent = console[-40:]
    return any("WARNING" in line or "not taken off" in line for line in recent)


def hanging(printer: Printer) -> float:
    """How far (mm) a probe that is there for good hangs below the nozzle."""
    probe = printer.scene.world.mag_probe
    if probe is None or probe.mode != "fixed":
        return 0.0
    return probe.body_drop + probe.switch_offset + probe.pretravel


def around(owned: Owned, script: str) -> str:
    """The same where an owner has to keep clear of a dock."""
    if not owned.has("dockable_probe"):
        return script
    return _ACROSS.sub(r"MOVE_AVOIDING_DOCK X=\1 Y=\2 SPEED=150", script)


def go(
    owned: Owned,
    walk: Sequence[Step],
    host: Host,
    modules: Optional[Mapping[str, Path]] = None,
    say: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Walk on a host.

    modules: by their name (default: the repository's). say: takes each step
    and what the console has shown.
    """
    outcome = Outcome()
    with tempfile.TemporaryDirectory() as folder:
        temperature = Path(folder) / "temperature"
        temperature.write_text("25000\n")
        variables = Path(folder) / "variables.cfg"
        keep_clear = partial(around, owned)
        card.write(Path(folder), keep_clear(stepping.first_layer()))
        changes = owned.changes(
            temperature=str(temperature), variables=str(variables), card=folder
        )
        printer = Printer(host, owned.scene, changes, (), owned.seed, modules)
        try:
            _go(printer, owned, walk, outcome, say)
        finally:
            printer.session.close()
            printer.machine.close()
    return outcome


def _go(
    printer: Printer,
    owned: Owned,
    walk: Sequence[Step],
    outcome: Outcome,
    say: Callable[[str], None],
) -> None:
    state, message = printer.session.start()
    if state != "ready":
        if "nternal error" in message:
            outcome.harm, outcome.kind = message, "internal error"
        outcome.refused_at_start = message
        return
    try:
        Walker(printer, owned, outcome, say).go(walk)
    except HarmError as error:
        outcome.harm = str(error)
