"""Lives in a simulation that is played with: tells what happens, does as told."""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Optional

from simplay.sites import sites_of, told
from simprinter import Machine
from simprinter.hosts.api import ApiClient, ApiError
from simprinter.world import Crash, Pose, Touch, WorldSpec
from simprinter.world.spec import SECOND

# Printer nanoseconds between two looks at what presses something
_LOOK_EVERY = 5_000_000
# Printer nanoseconds after which the machine is looked at, if nobody did
_SETTLE_EVERY = 100_000_000
# Printer nanoseconds for which the toolhead has to stand before its Z counts, and
# real seconds between two questions for it
_STANDS = 500_000_000
_ASK_EVERY = 2.0
# Smaller changes of the true gap are not told, mm: a printer that warms up would
# tell nothing else
WORTH_TELLING = 0.005
# From so much on (mm) it is said aloud that Z=0 is in the bed: the page has it red
_TOO_LOW = 0.1
# That are kept for a page; none looks, and nobody takes them
MOST_TOUCHES = 100


class Spot(NamedTuple):
    """Where on the bed the true gap at Z=0 is told, X and Y in mm.

    wanted: how far above the bed Z=0 is meant to be there, mm: some leave a first layer's
    last tenths to their owner on purpose.
    """

    x: float
    y: float
    wanted: float = 0.0


# By the settings of klippy; {} before it has said anything
Place = Callable[[dict[str, Any]], Spot]


class Watcher:
    """Takes part in the simulation like an API client.

    say: shows a line. place: X and Y of the bed (mm) at which the gap is told, by
    what klippy says of its configuration ({} before it has said anything).
    """

    def __init__(
        self,
        machine: Machine,
        socket: Path,
        place: Place,
        say: Callable[[str], None],
    ):
        self.machine = machine
        self._say = say
        self._orders: queue.SimpleQueue[Callable[[], None]] = (
            queue.SimpleQueue()
        )
        # What is to be done at a time of the printer (s)
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._api = ApiClient(socket)
        # Looked at last of all, such as by a film of it
        self.on_look: Optional[Callable[[], None]] = None
        self._contacts = _Contacts(machine, self.tell)
        self._gap = GapTeller(machine, self._api, place, self.tell)

    def order(self, action: Callable[[], None]) -> None:
        """Have something done to the machine, soon; for other threads."""
        self._orders.put(action)

    def later(self, seconds: float, action: Callable[[], None]) -> None:
        """Have something done when so many of the printer's seconds are over."""
        self._later.append((self.seconds() + seconds, action))

    def ask_gap(self) -> None:
        """Tell the true gap as soon as the toolhead stands."""
        self._gap.is_wanted = True

    def tell(self, text: str) -> None:
        """Show a line, with the printer's time."""
        self._say(f"{self.seconds():9.1f} s  {text}")

    def seconds(self) -> float:
        """The printer's time."""
        machine = self.machine
        return machine.rig.seconds(machine.simulation.clock.now())

    def fileno(self) -> int:
        """Readable when klippy has said something."""
        return self._api.fileno()

    def settled(self) -> bool:
        """Never holds up the time.

        Klippy that restarts sleeps before it hears what was said meanwhile.
        """
        return True

    def close(self) -> None:
        """Hang up."""
        self._api.close()

    def pump(self) -> bool:
        """Do what was ordered, look, and tell."""
        moved = self._api.pump()
        while not self._orders.empty():
            self._orders.get()()
        for due in [due for due in self._later if due[0] <= self.seconds()]:
            self._later.remove(due)
            due[1]()
        self._contacts.look()
        moved = self._gap.look() or moved
        if self.on_look is not None:
            self.on_look()
        return moved

    @property
    def gap(self) -> Optional[float]:
        """The true gap at Z=0 (mm) as it was known last; None: not homed."""
        return self._gap.height

    @property
    def spot(self) -> Spot:
        """Where on the bed that is."""
        return self._gap.spot

    def touches(self) -> list[TouchDone]:
        """Those that have ended since the last call."""
        done = self._contacts.done
        taken = list(done)
        done.clear()
        return taken


class TouchDone(NamedTuple):
    """A touch that has ended: X and Y of the tip, mm beyond the trigger."""

    site: str
    x: float
    y: float
    deep: float


class _Contacts:
    """Tells of touches, of what became of the probe, of crashes."""

    def __init__(self, machine: Machine, tell: Callable[[str], None]):
        self._machine = machine
        self._tell = tell
        self._touches = self._events = 0
        # Of switches that an axis runs into, by their signals
        switches = machine.scene.world.switches
        self._axes = {switch.signal: switch.axis for switch in switches}
        # Of each site, which carriage has what comes to it
        self._carriages = dict(_carriages(machine.scene.world))
        # Touches that have ended since somebody took them
        self.done: deque[TouchDone] = deque(maxlen=MOST_TOUCHES)
        self._crashes: dict[tuple[str, str], float] = {}
        self._settled = machine.simulation.clock.now()
        # What is pressed now: its touch, the lowest place of the toolhead since
        self._open: dict[str, tuple[Touch, float]] = {}
        self._looked = self._settled

    def look(self) -> None:
        machine = self._machine
        now = machine.simulation.clock.now()
        if now - self._settled >= _SETTLE_EVERY:
            self._settled = now
            machine.rig.settle(now)
        truth = machine.world.truth
        for touch in truth.touches[self._touches :]:
            self._begin(touch)
        self._touches = len(truth.touches)
        for event in truth.events[self._events :]:
            self._tell(f"{event.signal}: {event.kind.replace('_', ' ')}")
        self._events = len(truth.events)
        self._follow(now)
        for crash in truth.crashes():
            key = (crash.site, crash.kind)
            # Told again when it gets much worse only
            if crash.depth > 1.5 * self._crashes.get(key, 0.0):
                self._crashes[key] = crash.depth
                self._tell(crash_line(crash, machine.scene.world))

    def _begin(self, touch: Touch) -> None:
        axis = self._axes.get(touch.site)
        if axis is not None:
            # Where Z is, is another thing for everybody
            shown = "X" if axis == SECOND else axis.upper()
            at = f", at {shown}{touch.trigger_z:.2f}"
            name = told(touch.site, self._machine.scene.world)
            self._tell(name if axis == "z" else f"{name}{at}")
            return
        self._open[touch.site] = (touch, touch.z)
        # The world may have been told of it a little after it happened
        since = self._machine.simulation.clock.now() - round(
            (self._seconds() - touch.t) * 1e9
        )
        self._looked = min(self._looked, since)

    def _seconds(self) -> float:
        machine = self._machine
        return machine.rig.seconds(machine.simulation.clock.now())

    def _follow(self, now: int) -> None:
        """Until what is pressed is left again: how deep it got."""
        machine = self._machine
        while self._open and self._looked < now:
            self._looked = min(now, self._looked + _LOOK_EVERY)
            poses = machine.rig.poses(self._looked)
            for site, (touch, lowest) in tuple(self._open.items()):
                if machine.rig.seconds(self._looked) < touch.t:
                    continue
                pose = poses[self._carriages[site]]
                self._open[site] = (touch, min(lowest, pose.z))
                if pose.z > touch.trigger_z:
                    del self._open[site]
                    self._tell_touch(touch, min(lowest, pose.z))
        self._looked = now

    def _tell_touch(self, touch: Touch, lowest: float) -> None:
        truth = self._machine.world.truth
        x, y, z = touch.x, touch.y, touch.trigger_z
        carriage = self._carriages[touch.site]
        above = truth.true_gap(x, y, z, touch.t, carriage)
        deep = max(0.0, z - lowest)
        self.done.append(TouchDone(touch.site, x, y, deep))
        self._tell(
            f"{told(touch.site, self._machine.scene.world):24} X{x:.1f} Y{y:.1f}, tip {above:+.3f} mm"
            f" above the bed, {deep:.3f} mm deep"
        )


def _carriages(world: WorldSpec) -> Iterator[tuple[str, int]]:
    """Each site, and the carriage whose nozzle or probe meets something there."""
    probes = [int(probe.on_second) for probe in world.probes()]
    for site, met in sites_of(world).items():
        is_hung = met.presser in ("body", "plunger")
        yield site, probes[met.whose] if is_hung else met.whose


def crash_line(crash: Crash, world: WorldSpec) -> str:
    """Of what would have hurt a real machine, as touches are told."""
    x, y, _ = crash.pose
    what = "deep" if crash.kind == "depth" else "dragged"
    place = f"CRASH: {told(crash.site, world)}"
    line = (
        f"{place:24} X{x:.1f} Y{y:.1f}, {crash.depth:.3f} mm {what},"
        f" {crash.allowed:.3f} mm allowed"
    )
    if crash.past_stop > 0.0:
        line += f", {crash.past_stop:.3f} mm past its hard stop"
    return line


def is_news(told: Optional[float], gap: float) -> bool:
    """Whether a gap is told; told: the last one that was, mm; None: none was."""
    return told is None or abs(gap - told) >= WORTH_TELLING


class GapTeller:
    """Tells the true gap between nozzle and bed that G-code Z=0 stands for."""

    def __init__(
        self,
        machine: Machine,
        api: ApiClient,
        place: Place,
        tell: Callable[[str], None],
    ):
        self.is_wanted = False
        self._machine = machine
        self._api = api
        self._place = place
        self._tell = tell
        self.spot = place({})
        # Of the klippy whose configuration the spot is of; None: of none yet
        self._known: Optional[int] = None
        self._tip: Optional[Pose] = None
        self._stands_since = machine.simulation.clock.now()
        self._asked = time.monotonic()
        self._question: Optional[tuple[int, int]] = None
        self._told: Optional[float] = None
        # mm above the bed; None: not known before Z is homed
        self.height: Optional[float] = None

    def look(self) -> bool:
        """Ask klippy, or use its answer; whether it was spoken to."""
        now, tip = time.monotonic(), self._machine.tip()
        clock = self._machine.simulation.clock.now()
        if tip != self._tip:
            self._tip, self._stands_since = tip, clock
            self._question = None
        if self._question is not None:
            self._take_answer()
            return False
        asked_for = self.is_wanted or now - self._asked >= _ASK_EVERY
        stands = clock - self._stands_since >= _STANDS
        if not (asked_for and stands and self._api.connected()):
            return False
        self._asked = now
        objects = {
            "webhooks": ["state"],
            "gcode_move": ["gcode_position"],
            "toolhead": ["homed_axes", "print_time", "estimated_print_time"],
        }
        if self._known != self._api.connections:
            # Another one for each start of klippy
            objects["configfile"] = ["settings"]
        number = self._api.request("objects/query", {"objects": objects})
        self._question = (number, self._api.connections)
        return True

    def _take_answer(self) -> None:
        assert self._question is not None
        number, connections = self._question
        if self._api.answered(number):
            self._question = None
            try:
                status = self._api.answer(number)["status"]
            except ApiError:
                return
            self._take_place(status, connections)
            self._tell_gap(status)
        elif self._api.connections != connections:
            self._question = None  # klippy has restarted

    def _take_place(self, status: dict, connections: int) -> None:
        settings = status.get("configfile", {}).get("settings")
        if settings is not None:
            self._known = connections
            self.spot = self._place(settings)
            # At another place it is another one
            self._told = None

    def _tell_gap(self, status: dict) -> None:
        # Where printer.cfg has a mistake there is none
        toolhead, wanted = status["toolhead"], self.is_wanted
        has_stopped = status["webhooks"]["state"] != "ready"
        if has_stopped or "z" not in (toolhead.get("homed_axes") or ""):
            self._told, self.is_wanted, self.height = None, False, None
            if wanted and has_stopped:
                self._tell("true gap: not known, klippy has stopped")
            elif wanted:
                self._tell("true gap: not known before Z is homed")
            return
        # Moves that are still to come have changed the G-code Z already
        if toolhead["print_time"] > toolhead["estimated_print_time"]:
            return
        self.is_wanted = False
        z = status["gcode_move"]["gcode_position"][2]
        gap = self.height = self._machine.gap_at_zero(z, self.spot[:2])
        if wanted or is_news(self._told, gap):
            self._told = gap
            where = "above the bed" if gap >= 0 else "in the bed"
            where = "IN THE BED" if gap < -_TOO_LOW else where
            x, y = self.spot[:2]
            self._tell(
                f"true gap: Z=0 is {abs(gap):.3f} mm {where} at X{x:g} Y{y:g}"
            )
