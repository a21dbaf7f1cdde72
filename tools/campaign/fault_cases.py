"""Every fault at every operation of every command.

A good run tells which operations a command has; then, for each of them and
each fault, a new printer is homed, the fault strikes once, at that operation,
and what the command has done is judged.

Here operations are counted, not touches as tests do: each is to be broken,
also those that meet nothing, and what counts them is a good run of the same
modules on the same host: those that move otherwise are broken where they move.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Optional, Union

from simprinter import Fault, Machine
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError, SessionError
from simprinter.simulation import SimulationError
from simprinter.world.truth import CrashError
from tools.campaign.jobs import (
    ALL_JOBS,
    LEAVES,
    OFFSET,
    RAISES,
    TEMPLATE,
    Job,
)
from tools.campaign.operations import Operation, Watch
from tools.kit.printer import Printer

# A fault of a move strikes when it is under way, s
INTO_A_MOVE = 0.05
# A host has missed a silent board after this long, s
_MISSED = 15.0
# Triggers are so much (mm) too early or late
_OFF = 0.3
# With both sensors dead the probe's body is pressed so deep (mm) at most, and
# the nozzle no deeper than ever
BLIND_BODY = 5.2
# A right gap: two microsteps
GAP_ERROR = 0.0051
_STEP = 0.0026

_TOUCH_FAULTS = ("trigger_never", "trigger_early", "trigger_late")
_WRITE_FAULTS = ("tmc_change_lost", "tmc_write_error", "tmc_read_error")
_SENSOR_FAULTS = ("stuck_open", "stuck_closed")
# Of the nth time that a probe is fetched or docked: the event, and the fault
_TRIP_FAULTS = {"attach": "attach_fails", "dock": "dock_fails"}
# What the message of a command has to say, by fault (and subject); a switch
# that is dead or triggers in the wrong place looks like one that is not met
_DEAD = r"No trigger|did not answer|did not trigger"
_TRIGGERED = r"reads triggered|prior to movement|still triggered"
_HEIGHTS = (
    r"above the expected|differ|No trigger|did not answer|is above z=|sees the bed"
    r" at"
)
# What a dockable probe says where its pins are not as they have to be
_PROBE = r"the probe (was not fetched|was not docked|is not ready|was lost)"
CAUSES = {
    # Before before_switch_gcode a probe has to read triggered
    "stuck_open": _DEAD + r"|is attached already|" + _PROBE,
    # On the way down it is a trigger in mid air
    "stuck_closed": _TRIGGERED
    + r"|before the toolhead moved|check the probe with QUERY_PROBE|"
    + _PROBE,
    "trigger_never": _DEAD,
    "trigger_early": _HEIGHTS,
    "trigger_late": _HEIGHTS,
    "probe_falls": r"has come off|not attached|No trigger|did not answer|before the"
    r" toolhead moved|" + _PROBE,
    "attach_fails": r"the probe was not fetched|it is not attached",
    "dock_fails": r"the probe was not docked",
    "template raises": r"template \d+ fails",
    "template leaves": r"Move out of range|out of range",
    "tmc_change_lost": r"Unable to write tmc uart '\w+' register",
    "tmc_write_error": r"Unable to write tmc uart '\w+' register",
    "tmc_read_error": r"Unable to read tmc uart '\w+' register",
    "mcu_silent": r"shutdown|Unable to obtain|Timeout on wait|Lost communic",
    # A host may be about to plan one more move, and says that it cannot
    "cancel": r"shutdown|webhooks request|Unable to obtain|Timeout on wait"
    r"|Internal error in (MCU '\w+' )?stepcompress",
}
_SHUT_DOWN_CAUSES = {
    # A host may stumble over its own moves before it misses the board
    "mcu_silent": r"Lost communication with MCU|Internal error on command"
    r"|Exception in flush_handler",
    "cancel": r"webhooks request",
}
# After these a sensor tells of nothing any more
_BLINDING = ("stuck_open", "trigger_never", "probe_falls")
# By which a dockable probe is told that a person has put it into its dock
_BY_HAND = "SET_PROBE_STATUS STATE=DOCKED"
# How far a toolhead gets off its line as its board falls silent (mm)
_OFF_LINE = 1.0
# Between the two of a pair
PLUS = " + "
# How a command may end
RIGHT, REFUSED, SHUT_DOWN = "right", "refused", "shut down"


class Case(NamedTuple):
    """One fault at one operation.

    at: number of the operation, 0 before the first; of the template or the
    trip to the dock for their faults. subject: signal, board or driver where
    there are several.
    """

    job: str
    at: int
    fault: str
    subject: str = ""

    def __str__(self) -> str:
        subject = f" {self.subject}" if self.subject else ""
        return f"{self.job} @{self.at}: {self.fault}{subject}"

    @property
    def parts(self) -> tuple[Case, ...]:
        """All single ones."""
        return (self,)


class Pair(NamedTuple):
    """Two faults in one run of a command."""

    first: Case
    second: Case

    def __str__(self) -> str:
        return PLUS.join(map(str, self))

    @property
    def job(self) -> str:
        """The command's name."""
        return self.first.job

    @property
    def parts(self) -> tuple[Case, ...]:
        """All single ones."""
        return tuple(self)


class Setting(NamedTuple):
    """What all cases have in common: seed of all noise, modules installed.

    modules: None: ours; {}: what the host has. of_others: nobody here has made
    them, so only harm is judged.
    """

    seed: int = 0
    modules: Optional[Mapping[str, Path]] = None
    of_others: bool = False

    def job(self, name: str) -> Job:
        """The job of this name, with what these modules need."""
        job = ALL_JOBS[name]
        if not self.of_others:
            return job
        return job.of_others(is_builtin=not self.modules)


# What is required of the modules of others, too; their words are their own
_HARM = ("CrashError", "the printer is shut down", "the gap is")
PLAIN = Setting()


class GoodRun(NamedTuple):
    """What a command does when nothing is wrong.

    trips: how often a probe is fetched and docked, by the event's name.
    depths: mm beyond the trigger by site, of homing and command. gap: true one
    at G-code Z=0 afterwards, mm.
    """

    operations: tuple[Operation, ...]
    templates: int
    trips: Mapping[str, int]
    depths: Mapping[str, float]
    gap: float


@dataclass
class Outcome:
    """How a case went.

    struck: whether there were such operations; hosts may need one more or
    less than in the good run, and the first of two may end it. depths: mm by
    which each site was pressed deeper than in a good run. problems: what must
    not be; empty if it was survived. error: of the gap that it ended with, mm.
    """

    case: Union[Case, Pair]
    ended: str = ""
    struck: bool = False
    message: str = ""
    depths: Mapping[str, float] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    error: float = 0.0

    def is_blind(self) -> bool:
        """Whether two sensors were dead at once."""
        return self.struck and is_blind(self.case)


def is_blind(case: Union[Case, Pair]) -> bool:
    """Whether this takes two sensors."""
    dead = [part for part in case.parts if part.fault in _BLINDING]
    return len({part.subject or "probe" for part in dead}) > 1


def agree(case: Union[Case, Pair]) -> bool:
    """Whether two touches are wrong by the same amount."""
    lies = {part[2:] for part in case.parts}
    (fault, _), *others = lies
    alike = len(case.parts) > 1 and not others
    return alike and fault in ("trigger_early", "trigger_late")


class Saboteur:
    """Breaks something at one operation."""

    def __init__(self, machine: Machine, case: Case, good: GoodRun):
        self._machine = machine
        self._case = case
        # Counted by its kind: one write more or less does not matter then
        before = good.operations[: case.at]
        self._what = before[-1][:2] if before else None
        self._left = sum(one[:2] == self._what for one in before)
        self._struck = False
        self._stop_ns: Optional[int] = None

    def begin(self) -> None:
        """The command is about to be sent."""
        if self._case.at == 0:
            now = self._machine.simulation.clock.now()
            self._strike(Operation("begin", "", now))
        elif self._case.fault in _TRIP_FAULTS.values():
            fault = self._case.fault
            self._machine.break_down(
                Fault(fault, n=self._case.at, persistent=True, strikes="may")
            )

    def tell(self, operation: Operation) -> None:
        """Told of each operation, before it happens."""
        if operation[:2] != self._what or self._is_counted():
            return
        self._left -= 1
        if self._left == 0:
            self._strike(operation)

    def end(self) -> bool:
        """The command has ended; whether anything was broken."""
        self._what = None
        return self._struck or self._is_counted()

    def stop_is_due(self) -> bool:
        """Whether the printer is to be stopped now."""
        now = self._machine.simulation.clock.now()
        return self._stop_ns is not None and now >= self._stop_ns

    def _is_counted(self) -> bool:
        """Whether something else counts than the operations."""
        fault = self._case.fault
        return fault.startswith("template") or fault in _TRIP_FAULTS.values()

    def _strike(self, operation: Operation) -> None:
        machine, fault = self._machine, self._case.fault
        self._struck = True
        moment = max(operation.ns, machine.simulation.clock.now())
        if operation.kind == "move":
            moment += round(INTO_A_MOVE * 1e9)
        t = machine.rig.seconds(moment)
        if fault == "mcu_silent":
            # Who waits for something else to go wrong sees it by then
            self._stop_ns = moment + round(_MISSED * 1e9)
        if fault == "cancel":
            self._stop_ns = moment
        elif fault == "probe_falls":
            machine.world.lose_probe(t)
        elif not self._is_counted():
            machine.break_down(self._fault(t))

    def _fault(self, t: float) -> Fault:
        _, _, fault, subject = self._case
        about: dict[str, Any] = {"signal": subject}
        if fault in _SENSOR_FAULTS:
            about["t"] = t
        elif fault == "mcu_silent":
            about = {"board": subject, "t": t}
        elif fault in _WRITE_FAULTS:
            about = {"driver": subject}
        elif fault != "trigger_never":
            about["mm"] = _OFF
        # Outcome.struck tells; a touch that is broken may be the last one
        return Fault(fault, strikes="may", **about)


def cases(job: Job, good: GoodRun) -> Iterator[Case]:
    """All faults of a job, at all its operations."""
    for case in _all_cases(job, good):
        if not job.only or case.fault in job.only:
            yield case


def _all_cases(job: Job, good: GoodRun) -> Iterator[Case]:
    for number in range(1, good.templates + 1):
        yield Case(job.name, number, "template raises")
        yield Case(job.name, number, "template leaves")
    for kind, fault in _TRIP_FAULTS.items():
        if kind == "dock" and "dockable_probe" not in job.scene.sections:
            # What an owner's template left on the toolhead only the owner takes off
            continue
        for number in range(1, good.trips[kind] + 1):
            yield Case(job.name, number, fault)
    anywhere = [(f, s) for f in _SENSOR_FAULTS for s in job.signals]
    anywhere += [("mcu_silent", b) for b in job.scene.wiring.all_boards()]
    anywhere.append(("cancel", ""))
    if job.scene.world.mag_probe is not None:
        anywhere.append(("probe_falls", ""))
    begin = Operation("begin", "", 0)
    operations = (begin, *good.operations)
    chosen = _chosen(operations) if job.is_long else range(len(operations))
    for at in chosen:
        operation = operations[at]
        for fault, subject in anywhere:
            yield Case(job.name, at, fault, subject)
        own = {"touch": _TOUCH_FAULTS, "write": _WRITE_FAULTS}
        for fault in own.get(operation.kind, ()):
            yield Case(job.name, at, fault, operation.subject)


def _chosen(operations: Sequence[Operation]) -> list[int]:
    """The first, the middle and the last one of each kind."""
    kinds: dict[tuple[str, str], list[int]] = {}
    for at, operation in enumerate(operations):
        kinds.setdefault(operation[:2], []).append(at)
    few = {(a[0], a[len(a) // 2], a[-1]) for a in kinds.values()}
    return sorted({at for three in few for at in three})


def _printer(host: Host, job: Job, setting: Setting) -> Printer:
    options = {"seed": setting.seed, "modules": setting.modules}
    return Printer(host, job.scene, job.changes, **options)


def _prepare(printer: Printer, job: Job) -> None:
    printer.homed()
    printer.run(f"{job.before}\nSET_GCODE_OFFSET Z={OFFSET}\nM400")


def good_run(host: Host, job: Job, setting: Setting = PLAIN) -> GoodRun:
    """The command with nothing wrong.

    Raises AssertionError if its gap is not the ideal one.
    """
    operations: list[Operation] = []
    with _printer(host, job, setting) as printer:
        _prepare(printer, job)
        before = job.gap(printer)
        first = _templates(printer)
        events = printer.machine.truth.events
        homing = len(events)
        Watch(printer.machine, operations.append)
        printer.run(f"{job.script}\nM400")
        gap, ideal = job.gap(printer), job.ideal
        wanted = before if ideal is None else ideal
        assert math.isnan(wanted) or abs(gap - wanted) < GAP_ERROR, gap
        truth = printer.machine.truth
        depths = {site: truth.depth(site) for site in job.margins}
        templates = _templates(printer) - first
        kinds = [event.kind for event in events[homing:]]
    trips = {kind: kinds.count(kind) for kind in _TRIP_FAULTS}
    return GoodRun(tuple(operations), templates, trips, depths, gap)


def _templates(printer: Printer) -> int:
    """How many templates have run."""
    return int(printer.status(f"gcode_macro {TEMPLATE}").get("n", 0))


def _fail(printer: Printer, fail_at: Mapping[int, int]) -> None:
    """Which templates fail, and how."""
    value = str(dict(fail_at)).replace(" ", "")
    printer.run(
        f"SET_GCODE_VARIABLE MACRO={TEMPLATE} VARIABLE=fail_at VALUE={value}"
    )


def attempt(
    host: Host,
    case: Union[Case, Pair],
    good: GoodRun,
    setting: Setting = PLAIN,
) -> Outcome:
    """Let one fault or two strike and judge what happens."""
    job = setting.job(case.job)
    trial = Trial(job, case, good)
    try:
        with _printer(host, job, setting) as printer:
            for site, margin in job.margins.items():
                if is_blind(case) and not site.startswith("nozzle"):
                    margin = max(margin, BLIND_BODY)
                printer.machine.tolerate(
                    site, good.depths[site] + margin + _STEP
                )
            if any(part.fault == "mcu_silent" for part in case.parts):
                # Each axis goes on for the steps that its queue has, and the toolhead
                # leaves its line beside the dock
                printer.machine.tolerate("dock", _OFF_LINE)
            _prepare(printer, job)
            trial.run(printer)
    except (CrashError, SessionError, SimulationError) as error:
        trial.outcome.problems.append(f"{type(error).__name__}: {error}")
    if setting.of_others:
        found = trial.outcome.problems
        trial.outcome.problems = [p for p in found if p.startswith(_HARM)]
    return trial.outcome


class Trial:
    """One command with its faults, and its judgement."""

    def __init__(self, job: Job, case: Union[Case, Pair], good: GoodRun):
        self._job = job
        self._parts = case.parts
        self._faults = [part.fault for part in case.parts]
        self._good = good
        self._state_message = ""
        self.outcome = Outcome(case)

    def run(self, printer: Printer) -> None:
        """Run it on a printer that is homed."""
        job = self._job
        before, gap = job.state(printer), job.gap(printer)
        self._run_command(printer)
        truth = printer.machine.truth
        self.outcome.depths = {
            site: max(0.0, truth.depth(site) - self._good.depths[site])
            for site in job.margins
        }
        if self.outcome.ended == SHUT_DOWN:
            self._judge_shut_down(printer, before)
            return
        if self.outcome.ended == REFUSED:
            self._judge_refused(printer, before, gap)
        else:
            self._judge_right(printer)
        if not self._is_lost(printer):
            self._judge_next_run(printer)

    def _run_command(self, printer: Printer) -> None:
        session = printer.session
        saboteurs = [
            Saboteur(printer.machine, part, self._good) for part in self._parts
        ]
        self._set_template(printer)
        for saboteur in saboteurs:
            Watch(printer.machine, saboteur.tell)
            saboteur.begin()
        command = session.begin(f"{self._job.script}\nM400")
        try:
            if "cancel" in self._faults:
                session.run_until(
                    command, lambda: any(s.stop_is_due() for s in saboteurs)
                )
                if any(saboteur.stop_is_due() for saboteur in saboteurs):
                    session.stop()
            session.finish(command)
            self.outcome.ended = RIGHT
        except GcodeError as error:
            self.outcome.message = str(error)
            self.outcome.ended = REFUSED
        self.outcome.struck = all([saboteur.end() for saboteur in saboteurs])
        session.wait(_MISSED if "mcu_silent" in self._faults else 1.0)
        state, self._state_message = session.state()
        if state != "ready":
            self.outcome.ended = SHUT_DOWN

    def _set_template(self, printer: Printer) -> None:
        ways = {"template raises": RAISES, "template leaves": LEAVES}
        fails = [part for part in self._parts if part.fault in ways]
        if fails:
            done = _templates(printer)
            _fail(printer, {done + p.at: ways[p.fault] for p in fails})

    # Judgement

    def _require(self, holds: bool, otherwise: str) -> None:
        if not holds:
            self.outcome.problems.append(otherwise)

    def _judge_shut_down(
        self, printer: Printer, before: Mapping[str, Any]
    ) -> None:
        session = printer.session
        causes = [_SHUT_DOWN_CAUSES.get(fault) for fault in self._faults]
        words = [cause for cause in causes if cause]
        self._require(bool(words), "the printer is shut down")
        self._require_words(self._state_message, words)
        if self.outcome.message:
            self._require(
                "Internal error on" not in self.outcome.message, "is hidden"
            )
            self._judge_words()
        self._require(
            session.config_text() == before["printer.cfg"],
            "printer.cfg has changed",
        )
        if "cancel" in self._faults and "mcu_silent" not in self._faults:
            printer.machine.repair()
            try:
                session.restart("FIRMWARE_RESTART")
            except SessionError:
                # Klipper of 2026 waits for a trigger for ever, in its own G28, too
                if not self._job.is_homing:
                    raise
                return
            self._require(printer.offset() == 0.0, "an offset is in force")

    def _judge_refused(
        self, printer: Printer, before: Mapping[str, Any], gap: float
    ) -> None:
        job = self._job
        self._require(
            "Internal error" not in self.outcome.message, "internal error"
        )
        self._judge_words()
        if job.is_homing:
            # The host has turned the motors off
            return
        after = job.state(printer)
        for name, value in before.items():
            self._require(
                after[name] == value,
                f"{name} was {value} and is {after[name]}",
            )
        now = job.gap(printer)
        self._require(
            "gap" in job.told or abs(now - gap) < _STEP,
            f"gap was {gap:.4f} and is {now:.4f}",
        )
        z, lift = printer.session.position()[2], job.lift
        if len(self._parts) > 1 and "trigger_late" in self._faults:
            # The bed it is lifted from was met too low, and not again
            lift -= _OFF
        self._require(z >= lift, f"the toolhead is at z={z:.3f}")

    def _judge_right(self, printer: Printer) -> None:
        gap, good = self._job.gap(printer), self._good.gap
        self.outcome.error = error = abs(gap - good)
        if self._job.samples == 2 and agree(self.outcome.case):
            # The only two that are compared: nothing can tell
            error = min(error, abs(error - _OFF))
        self._require(
            error < GAP_ERROR,
            f"the gap is {gap:.4f}, which should be {good:.4f}",
        )

    def _judge_words(self) -> None:
        words = [CAUSES[fault] for fault in self._faults]
        self._require_words(self.outcome.message, words)

    def _require_words(self, message: str, words: Sequence[str]) -> None:
        self._require(
            re.search("|".join(words), message) is not None,
            f"{message!r} does not name the cause ({'|'.join(words)})",
        )

    def _is_lost(self, printer: Printer) -> bool:
        machine = printer.machine
        if machine.scene.world.mag_probe is None:
            return False
        t = machine.rig.seconds(machine.simulation.clock.now())
        return machine.world.probe_state(t) == "lost"

    def _run_again(self, printer: Printer) -> None:
        again = f"{self._job.again}\nSET_GCODE_OFFSET Z={OFFSET}\nM400"
        printer.run(again)
        printer.run(f"{self._job.script}\nM400")

    def _judge_next_run(self, printer: Printer) -> None:
        """Everything works again when the fault is gone."""
        printer.machine.repair()
        if any(fault.startswith("template") for fault in self._faults):
            _fail(printer, {})
        try:
            try:
                self._run_again(printer)
            except GcodeError as error:
                if _BY_HAND not in str(error):
                    raise
                # What the message asks of a person
                _dock_by_hand(printer)
                self._run_again(printer)
        except GcodeError as error:
            self.outcome.problems.append(f"the next run: {error}")
            return
        gap, good = self._job.gap(printer), self._good.gap
        self._require(
            abs(gap - good) < GAP_ERROR,
            f"the next run: gap {gap:.4f}, which should be {good:.4f}",
        )


def _dock_by_hand(printer: Printer) -> None:
    machine = printer.machine
    t = machine.rig.seconds(machine.simulation.clock.now())
    machine.world.lose_probe(t)
    machine.world.bring_probe_back(t)
    printer.session.wait(0.5)
    printer.run(_BY_HAND)
