"""Goes one walk: does each step, and has it judged."""

from __future__ import annotations

import os
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
from simprinter.simulation import SimulationError
from tools.campaign import doing
from tools.campaign.breaking import (
    MISSED,
    PUT_ON,
    TEMPLATE_FAULTS,
    Break,
    Breaking,
    fail_templates,
)
from tools.campaign.drawn import card
from tools.campaign.drawn import steps as stepping
from tools.campaign.drawn.printers import Owned
from tools.campaign.drawn.steps import Step
from tools.campaign.judging import Expected, Gone, HarmError, Judge
from tools.kit.printer import Printer

# Whose nozzle comes so near to the bed (mm) puts paper below it and goes on by hand
NEAR = 1.0
# Of a hand, and what it holds (mm): a probe, or a switch that is flat
HAND, FINGERS = 15.0, 5.0
# Of one command, printer seconds: a mesh of nine points takes 100, a nozzle that is
# measured at three temperatures stands still for minutes at each
LIMIT, GROWS_LIMIT = 900.0, 3600.0
_GROWS = "Z_CALIBRATION_NOZZLE_GROWTH"
# By which a dockable probe is told that a person has put it into its dock
BY_HAND = "SET_PROBE_STATUS STATE=DOCKED"
# How a command may end in which something breaks
RIGHT, REFUSED, SHUT_DOWN = "right", "refused", "shut down"
_NUMBER = re.compile(r"-?\d+(\.\d+)?")
_ACROSS = re.compile(r"G1 X(\S+) Y(\S+) F9000")


def shape(reason: str) -> str:
    """A reason without its numbers, short."""
    return _NUMBER.sub("#", reason.splitlines()[0])[:100]


@dataclass
class Broken:
    """How the command went in which something broke.

    struck: whether all of it has. message: why it was refused. depths: mm by
    which each site was pressed deeper than in a good run. error: of the gap that
    it ended with, mm.
    """

    ended: str = ""
    struck: bool = False
    message: str = ""
    depths: Mapping[str, float] = field(default_factory=dict)
    error: float = 0.0


@dataclass
class Outcome:
    """What came of a walk.

    harm: what was wrong with which step; empty if nothing. refusals: by their
    shape; healthy: those for which the world knows no reason. done: of each
    kind of step, how many without an error. ends: why each step was refused, in
    their order; empty if it was not. broken: the last command that has met a
    fault.
    """

    harm: str = ""
    kind: str = ""
    refusals: Counter[str] = field(default_factory=Counter)
    healthy: Counter[str] = field(default_factory=Counter)
    done: Counter[str] = field(default_factory=Counter)
    ends: list[str] = field(default_factory=list)
    refused_at_start: str = ""
    broken: Optional[Broken] = None


class Walker:
    """One printer on which a walk goes on."""

    def __init__(
        self,
        printer: Printer,
        owned: Owned,
        outcome: Outcome,
        say: Callable[[str], None],
        temperature: Path = Path(os.devnull),
        expected: Optional[Expected] = None,
    ) -> None:
        self.say = say
        self.printer = printer
        self.owned = owned
        self.outcome = outcome
        # What z_thermal_adjust reads, see heat()
        self.temperature = temperature
        self.judge = Judge(printer, owned, partial(around, owned), expected)
        # What the next command is to meet, and whether it has
        self.breaks: list[Break] = []
        self.struck: tuple[Break, ...] = ()
        # The step that is being done: for people, what ran, why it was refused
        self.step = self.script = self.refusal = ""
        self.does: Mapping[str, Callable[[Any], None]] = {
            "gcode": self._gcode,
            "heed": self._heed,
            "wait": lambda seconds: printer.session.wait(float(seconds)),
            "away": lambda to: self._gcode(stepping.AWAY % tuple(to)),
            "lower": self._lower,
            "answer": partial(doing.answer, printer.session, self._gcode),
            "late": partial(doing.late, printer.session, self._gcode),
            "twice": partial(doing.twice, printer.session, self._gcode),
            "card": self._card,
            "save": partial(doing.save, printer.session),
            "restart": self._restart,
            "both": self._both,
            "macro": lambda commands: self._gcode("\n".join(commands)),
            "hand": self._hand,
            "print": self._print,
            "heat": self._heat,
            "mend": self._mend,
        }

    def go(self, walk: Sequence[Step]) -> None:
        """All steps. Raises HarmError at the first that does harm."""
        console = self.printer.session.console
        for number, (kind, what) in enumerate(walk, 1):
            if kind == "break":
                # In the next command, not yet
                self.breaks.append(Break(*what))
                self.outcome.ends.append("")
                continue
            self.judge.begin(kind)
            shown = len(console)
            self.step, self.script, self.refusal = f"{kind} {what!r}", "", ""
            self.say(f"--- step {number}, {self.step}")
            try:
                if not self._do(kind, what):
                    return
                gone = self._gone(kind, console[shown:])
                self.judge.end(gone)
                if self.judge.is_shut_down:
                    self._start_again(gone)
                    return
            except HarmError as error:
                text = f"step {number}, {self.step}: {error}"
                raise HarmError(error.sort, text) from error
            finally:
                for line in console[shown:]:
                    self.say(line)
            self._count(kind, what)

    def _gone(self, kind: str, lines: Sequence[str]) -> Gone:
        """What the judge is to know of the step."""
        struck = self.struck if kind == "gcode" else ()
        gone = Gone(kind, self.script, self.refusal, lines, struck)
        if kind != "gcode" or not self.breaks:
            return gone
        # Until all that it leads to has happened
        is_silent = "mcu_silent" in gone.faults
        self.printer.session.wait(MISSED if is_silent else 1.0)
        ended = REFUSED if gone.refusal else RIGHT
        broken = Broken(ended, len(struck) == len(self.breaks))
        if self.printer.session.state()[0] != "ready":
            broken.ended = SHUT_DOWN
        broken.message = gone.refusal
        broken.depths, broken.error = self.judge.measured()
        self.outcome.broken = broken
        return gone

    def _start_again(self, gone: Gone) -> None:
        """Whoever has stopped it starts it again."""
        expected = self.judge.expected
        if "mcu_silent" in gone.faults:
            return
        self.printer.machine.repair()
        try:
            self._restart("FIRMWARE_RESTART")
        except SessionError as error:
            # Klipper of 2026 waits for a trigger for ever, in its own G28, too
            if not expected or not expected.job.is_homing:
                raise HarmError("hang", str(error).splitlines()[0]) from error
        else:
            self.judge.end(Gone("restart", "", "", ()))

    def _do(self, kind: str, what: Any) -> bool:
        """Whether klippy goes on."""
        try:
            self.does[kind](what)
        except (SessionError, SimulationError) as error:
            text = str(error).splitlines()[0]
            # Whoever accepts what he has not measured may save what Klipper refuses
            if kind == "save" and text.startswith("error: "):
                self.outcome.refused_at_start = text
                return False
            raise HarmError("hang", text) from error
        return True

    def _count(self, kind: str, what: Any) -> None:
        self.outcome.ends.append(self.refusal)
        if self.refusal:
            self.outcome.refusals[shape(self.refusal)] += 1
            if self.judge.is_healthy:
                self.outcome.healthy[shape(self.refusal)] += 1
        else:
            name = str(what).splitlines()[-1].split()[0]
            self.outcome.done[name if kind == "gcode" else kind] += 1

    # Steps

    def _gcode(self, script: str) -> None:
        self.script += script + "\n"
        try:
            limit = GROWS_LIMIT if _GROWS in script else LIMIT
            if self.breaks:
                self._meet(self._around(script), limit)
            else:
                self.printer.session.run(self._around(script), limit)
        except GcodeError as error:
            self.refusal = str(error)

    def _meet(self, script: str, limit: float) -> None:
        """It meets what is to break. Raises GcodeError."""
        breaking = Breaking(self.printer, self.breaks)
        try:
            breaking.run(script, limit)
        finally:
            self.struck = breaking.struck

    def _heed(self, script: str) -> None:
        """As one who reads: where a message asks for a hand, that and once more."""
        self._gcode(script)
        if BY_HAND in self.refusal:
            world, now = self.printer.machine.world, self.printer.now()
            world.lose_probe(now)
            world.bring_probe_back(now)
            self.printer.session.wait(0.5)
            self.refusal = ""
            self._gcode(BY_HAND)
            self._gcode(script)

    def _around(self, script: str) -> str:
        return around(self.owned, script)

    def _print(self, what: Sequence) -> None:
        """As PRINT_START: G28, a calibration, a pause of so many seconds, a layer."""
        calibration, pause = what
        self._gcode(f"G28\n{self._of_owner()}{calibration}")
        if pause:
            self.printer.session.wait(float(pause))
        if not self.refusal:
            self._gcode(stepping.first_layer())

    def _of_owner(self) -> str:
        """Who wants no trips, or holds the probe, puts it away before he prints."""
        status = self.printer.status("dockable_probe")
        is_own = status.get("auto_attach_detach") is False
        if not self.owned.has("z_calibration"):
            # Which docks what ATTACH_PROBE has fetched
            is_own = is_own or status.get("last_status_name") == "ATTACHED"
        return "DETACH_PROBE\n" if is_own else ""

    def _card(self, what: Sequence) -> None:
        """Nobody prints who reads that nothing was calibrated yet."""
        status = self.printer.status("auto_z_offset")
        before = self._of_owner()
        if before:
            self._gcode(f"G28\n{before}")
        is_right = self.owned.has("z_calibration")
        if not self.refusal and (is_right or status.get("probe_z_correction")):
            doing.print_card(self.printer.session, self._gcode, what)

    def _lower(self, distance: float) -> None:
        """As a person with paper does, who looks at the nozzle, and at the pin."""
        machine = self.printer.machine
        if self.printer.status("manual_probe").get("is_active"):
            gap = machine.truth.true_gap(*machine.tip())
            below = [n.distance for n in machine.near() if "nozzle" in n.site]
            room = min([gap, *below]) - hanging(self.printer) - NEAR
            distance = min(distance, room)
            if distance > 0.0:
                self._gcode(f"TESTZ Z=-{distance:.3f}\nM400")
                self.printer.session.wait(0.5)

    def _restart(self, command: str) -> None:
        self.printer.session.restart(command)

    def _both(self, commands: Sequence[str]) -> None:
        """The second comes from another client while the first runs."""
        session = self.printer.session
        self.script = "\n".join(commands)
        first = session.begin(self._around(commands[0]))
        begun = self.printer.now() + 2.0
        session.run_until(first, lambda: self.printer.now() >= begun)
        second = session.begin(self._around(commands[1]))
        for command in first, second:
            try:
                session.finish(command, LIMIT)
            except GcodeError as error:
                self.refusal = self.refusal or str(error)

    def _heat(self, celsius: float) -> None:
        """The frame is so warm now, as far as Klipper can see."""
        heat(self.temperature, celsius)
        self.printer.session.wait(5.0)

    def _mend(self, fault: str) -> None:
        """All is as good as new, and a probe that has fallen is where it was."""
        machine = self.printer.machine
        machine.repair()
        if any(what.fault in TEMPLATE_FAULTS for what in self.breaks):
            fail_templates(self.printer, ())
        machine.rig.settle(machine.simulation.clock.now())
        if any(what.fault == PUT_ON for what in self.breaks):
            machine.world.take_probe_off(self.printer.now())
        self.breaks, self.struck = [], ()
        now = self.printer.now()
        if machine.world.probe_state(now) == "lost":
            machine.world.bring_probe_back(now)

    def _press(self, signal: str) -> None:
        """A finger; where a dialog is open that wants one, after its first button."""
        session, machine = self.printer.session, self.printer.machine
        self.script = doing.finger_asked_for(session)
        if not self.script:
            doing.finger(session, machine, signal)
            return
        command = session.begin(self._around(self.script))
        session.wait(0.5)
        doing.finger(session, machine, signal)
        try:
            session.finish(command, LIMIT)
        except GcodeError as error:
            self.refusal = str(error)

    def _hand(self, name: str) -> None:
        machine = self.printer.machine
        world = machine.world
        machine.rig.settle(machine.simulation.clock.now())
        now = self.printer.now()
        # No hand fits below a nozzle that is down
        room = FINGERS if name.endswith("_membrane") else HAND
        if machine.truth.true_gap(*machine.tip(), now) < room:
            return
        if name in ("lay_membrane", "take_membrane"):
            # Where the switch is fixed there is none
            if self.printer.scene.world.membrane is not None:
                machine.lay_membrane(name == "lay_membrane")
        elif name.startswith("press_"):
            signal = name.replace("press_", "", 1)
            self._press(signal)
        else:
            getattr(world, name)(now)


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
    expected: Optional[Expected] = None,
) -> Outcome:
    """Walk on a host.

    modules: by their name (default: the repository's). say: takes each step
    and what the console has shown. expected: of a command that is known, so
    that the judge is strict.
    """
    outcome = Outcome()
    with tempfile.TemporaryDirectory() as folder:
        temperature = Path(folder) / "temperature"
        heat(temperature, 25.0)
        variables = Path(folder) / "variables.cfg"
        keep_clear = partial(around, owned)
        card.write(Path(folder), keep_clear(stepping.first_layer()))
        changes = owned.changes(
            temperature=str(temperature), variables=str(variables), card=folder
        )
        printer = Printer(host, owned.scene, changes, (), owned.seed, modules)
        try:
            # A printer that does not start may know nothing of its own yet
            if _starts(printer, owned, outcome):
                _go(
                    Walker(printer, owned, outcome, say, temperature, expected),
                    walk,
                )
            elif expected:
                outcome.harm, outcome.kind = outcome.refused_at_start, "start"
        finally:
            printer.session.close()
            printer.machine.close()
    return outcome


def heat(file: Path, celsius: float) -> None:
    """Let a thermometer of the computer show that."""
    file.write_text(f"{1000.0 * celsius:.0f}\n")


def _starts(printer: Printer, owned: Owned, outcome: Outcome) -> bool:
    state, message = printer.session.start()
    if state == "ready":
        return True
    if "nternal error" in message:
        outcome.harm, outcome.kind = message, "internal error"
    elif owned.mistake and "ection '" not in message:
        outcome.harm, outcome.kind = f"names no section: {message}", "hidden"
    outcome.refused_at_start = message
    return False


def _go(walker: Walker, walk: Sequence[Step]) -> None:
    outcome = walker.outcome
    try:
        walker.go(walk)
    except HarmError as error:
        outcome.harm, outcome.kind = f"{error.sort}: {error}", error.sort
