"""What a command has the machine do, and what breaks at one of these operations.

Operations are counted, not touches as tests do: each can be broken, also those
that meet nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Optional

from simprinter import Fault, Machine
from tools.kit.printer import Printer

# Steps that begin later than this (ns) after the last are another move: the
# slowest ramps leave 10 ms between two steps
_PAUSE_NS = 20_000_000
# A touch starts to move this long (ns) after its endstop looks, at most
_TOUCH_NS = 300_000_000
# A fault of a move strikes when it is under way, s
INTO_A_MOVE = 0.05
# A host has missed a silent board after this long, s
MISSED = 15.0
# Triggers are so much (mm) too early or late
OFF = 0.3

TOUCH_FAULTS = ("trigger_never", "trigger_early", "trigger_late")
WRITE_FAULTS = ("tmc_change_lost", "tmc_write_error", "tmc_read_error")
SENSOR_FAULTS = ("stuck_open", "stuck_closed")
# Of the nth time that a probe is fetched or docked: the event, and the fault
TRIP_FAULTS = {"attach": "attach_fails", "dock": "dock_fails"}
# Of a touch, see Watch, and a switch that is stuck closed from its middle on
WAY, STICKS = "way", "sticks"
# Before the first operation
BEGIN = "begin"
# Its owner has left it on the toolhead, where macros attach it later
PUT_ON = "probe_put_on"
# Runs wherever the modules run G-code of their owner's; how it fails, by number
TEMPLATE = "_OPERATION"
TEMPLATE_FAULTS = {"template raises": 1, "template leaves": 2}
TEMPLATE_MACRO = """
  SET_GCODE_VARIABLE MACRO=_OPERATION VARIABLE=n VALUE={n + 1}
  {% if fail_at.get(n + 1) == 1 %}
    {action_raise_error("template %d fails" % (n + 1))}
  {% elif fail_at.get(n + 1) == 2 %}
    G90
    G1 X9999
  {% endif %}"""


class Operation(NamedTuple):
    """A touch, its way or a query (of a signal), a write (to a driver) or a move.

    subject of a move: "xy" or "z". ns: when it begins, on the machine's clock.
    """

    kind: str
    subject: str
    ns: int


class Watch:
    """Tells of every operation of a machine, before it happens.

    The host queues moves ahead, so one is told of some time before it begins.
    The move of a touch is its way.
    """

    def __init__(self, machine: Machine, listener: Callable[[Operation], None]):
        self._machine = machine
        self._listener = listener
        self._touched, self._touched_ns = "", -_TOUCH_NS
        self._ends_ns = {"xy": 0, "z": 0}
        self._known = {
            name: axis.track.last_clock
            for name, axis in machine.rig.axes.items()
        }
        machine.rig.on_operation.append(self._operation)
        machine.rig.on_steps.append(self._steps_queued)

    def _operation(self, kind: str, subject: str, ns: int) -> None:
        if kind == "touch":
            self._touched, self._touched_ns = subject, ns
        self._listener(Operation(kind, subject, ns))

    def _steps_queued(self, _start_ns: int) -> None:
        for name, axis in self._machine.rig.axes.items():
            track, board = axis.track, axis.board
            if board is None or track.last_clock <= self._known[name]:
                continue
            self._known[name] = track.last_clock
            group = "xy" if name in "xy" else "z"
            begin, end = board.ns(track.newest()), board.ns(track.last_clock)
            paused = begin > self._ends_ns[group] + _PAUSE_NS
            self._ends_ns[group] = max(self._ends_ns[group], end)
            if paused and begin > self._touched_ns + _TOUCH_NS:
                self._listener(Operation("move", group, begin))
            elif self._touched and begin >= self._touched_ns:
                self._listener(Operation(WAY, self._touched, begin))
                self._touched = ""


class Break(NamedTuple):
    """A fault, and when it strikes: at the nth operation of kind and of.

    subject: signal, board or driver where there are several. kind: that of an
    operation, or BEGIN; empty where templates or trips to the dock are counted.
    """

    fault: str
    subject: str = ""
    kind: str = ""
    of: str = ""
    nth: int = 1

    def __str__(self) -> str:
        place = f" of {self.kind} {self.of}".rstrip() if self.kind else ""
        number = "" if self.kind == BEGIN else f" {self.nth}"
        return f"{self.fault} {self.subject}".rstrip() + place + number


class _Saboteur:
    """Has one fault strike while a command runs."""

    def __init__(self, printer: Printer, what: Break):
        self._machine = printer.machine
        self.what = what
        self._left = what.nth
        self.has_struck = not what.kind
        self.stop_ns: Optional[int] = None

    def begin(self) -> None:
        """The command is about to be sent."""
        fault, nth = self.what.fault, self.what.nth
        if self.what.kind == BEGIN:
            now = self._machine.simulation.clock.now()
            self._strike(Operation(BEGIN, "", now))
        elif fault in TRIP_FAULTS.values():
            # Whether it has failed, nobody has to say
            self._machine.break_down(
                Fault(fault, n=nth, persistent=True, strikes="may")
            )

    def tell(self, operation: Operation) -> None:
        """Told of each operation, before it happens."""
        if operation[:2] == self.what[2:4]:
            self._left -= 1
            if self._left == 0:
                self._strike(operation)

    def end(self) -> None:
        """The command has ended: later operations are others'."""
        self._left = 0

    def _strike(self, operation: Operation) -> None:
        machine, fault = self._machine, self.what.fault
        self.has_struck = True
        moment = max(operation.ns, machine.simulation.clock.now())
        if operation.kind in ("move", WAY):
            moment += round(INTO_A_MOVE * 1e9)
        t = machine.rig.seconds(moment)
        if fault == "mcu_silent":
            # Who waits for something else to go wrong sees it by then
            self.stop_ns = moment + round(MISSED * 1e9)
        if fault == "cancel":
            self.stop_ns = moment
        elif fault == "probe_falls":
            machine.world.lose_probe(t)
        elif fault == PUT_ON:
            machine.world.put_probe_on(t)
        else:
            machine.break_down(self._fault(t))

    def _fault(self, t: float) -> Fault:
        fault, subject = self.what[:2]
        about: dict[str, Any] = {"signal": subject}
        if fault == STICKS:
            fault = "stuck_closed"
        if fault in SENSOR_FAULTS:
            about["t"] = t
        elif fault == "mcu_silent":
            about = {"board": subject, "t": t}
        elif fault in WRITE_FAULTS:
            about = {"driver": subject}
        elif fault != "trigger_never":
            about["mm"] = OFF
        # Who judges is told; a touch that is broken may be the last one
        return Fault(fault, strikes="may", **about)


class Breaking:
    """Runs one command in which something breaks."""

    def __init__(self, printer: Printer, breaks: Sequence[Break]) -> None:
        self._printer = printer
        self._breaks = breaks
        self._saboteurs: list[_Saboteur] = []

    def run(self, script: str, limit: float) -> None:
        """Run it. Raises GcodeError."""
        session = self._printer.session
        if any(what.fault in TEMPLATE_FAULTS for what in self._breaks):
            fail_templates(self._printer, self._breaks)
        self._saboteurs = [
            _Saboteur(self._printer, what) for what in self._breaks
        ]
        for saboteur in self._saboteurs:
            Watch(self._printer.machine, saboteur.tell)
            saboteur.begin()
        command = session.begin(script)
        try:
            if any(what.fault == "cancel" for what in self._breaks):
                session.run_until(command, self._is_stop_due)
                if self._is_stop_due():
                    session.stop()
            session.finish(command, limit)
        finally:
            for saboteur in self._saboteurs:
                saboteur.end()

    @property
    def struck(self) -> tuple[Break, ...]:
        """Those that have.

        Hosts may need an operation more or less than another time, and the first
        of two may end the command.
        """
        return tuple(s.what for s in self._saboteurs if s.has_struck)

    def _is_stop_due(self) -> bool:
        now = self._printer.machine.simulation.clock.now()
        stops = [saboteur.stop_ns for saboteur in self._saboteurs]
        return any(stop is not None and now >= stop for stop in stops)


def templates_run(printer: Printer) -> int:
    """How many templates have run."""
    return int(printer.status(f"gcode_macro {TEMPLATE}").get("n", 0))


def fail_templates(printer: Printer, breaks: Sequence[Break]) -> None:
    """Let templates fail from now on, or none."""
    done = templates_run(printer)
    fails = {
        done + what.nth: TEMPLATE_FAULTS[what.fault]
        for what in breaks
        if what.fault in TEMPLATE_FAULTS
    }
    value = str(fails).replace(" ", "")
    printer.run(
        f"SET_GCODE_VARIABLE MACRO={TEMPLATE} VARIABLE=fail_at VALUE={value}"
    )
