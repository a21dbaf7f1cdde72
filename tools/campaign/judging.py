"""Judges each step of a walk by the simulated world, which knows the truth."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Optional

from simprinter.world import Bed, WorldSpec
from simprinter.world.truth import Crash
from tools.campaign import claims
from tools.campaign.breaking import OFF, Break
from tools.campaign.claims import CAUSES, SHUT_DOWN_CAUSES
from tools.campaign.drawn import steps as stepping
from tools.campaign.drawn.printers import POINT, Owned
from tools.campaign.gaps import CALIBRATED, Gaps
from tools.campaign.jobs import Job
from tools.kit.dialogs import dialogs_of
from tools.kit.printer import Printer

# After which a docking that is pending is made: docs/dockable_probe.md (s)
DETACH_DELAY = 1.0
# From where a trigger is expected to where a touch ends: docs/reliability.md (mm)
MARGIN = 1.0
# Beyond it: a step, and what a bed differs below two places (mm)
SLACK = 0.1
# How much deeper than Z=0 the bed of a new printer may be expected (mm)
WRONG_ZERO = 1.5
# Of a gap that is right: two microsteps, and one (mm)
GAP_ERROR, STEP = 0.0051, 0.0026
# With both sensors dead the probe's body is pressed so deep (mm) at most, and
# the nozzle no deeper than ever
BLIND_BODY = 5.2
# How far a toolhead gets off its line as its board falls silent (mm)
OFF_LINE = 1.0
# Of places that are the same (mm): half a step of both belts, and more
PLACE = 0.1
# Ours, which leave all as it was when they refuse
OF_Z_CALIBRATION, OF_DOCKABLE_PROBE, *_OTHERS = (
    frozenset(
        text.splitlines()[-1].split()[0]
        for text in stepping.OF_SECTION[section]
    )
    for section in (
        "z_calibration",
        "dockable_probe",
        "auto_z_offset",
        "extra_probe membrane",
    )
)
OURS = OF_Z_CALIBRATION.union(OF_DOCKABLE_PROBE, *_OTHERS)
# Touches where the toolhead is, by what touches
WHERE_IT_IS = {
    "PROBE": ("probe_bed", "inductive_bed"),
    "PROBE_ACCURACY": ("probe_bed", "inductive_bed"),
    "AUTO_Z_PROBE": ("nozzle_bed",),
    "EXTRA_PROBE": ("nozzle_bed", "nozzle_membrane"),
    "EXTRA_PROBE_ACCURACY": ("nozzle_bed", "nozzle_membrane"),
}
# What they may change for ever when they end well
LASTING = (
    "the G-code offset",
    "what is saved",
    "homed axes",
    "status",
    "printer.cfg",
)
# All that is looked at before and after each step, at one moment
PENDING = "save_config_pending_items"
Status = Mapping[str, Mapping[str, Any]]
LOOKED_AT: Mapping[str, Optional[Sequence[str]]] = {
    "toolhead": None,
    "gcode_move": None,
    "configfile": (PENDING,),
    "manual_probe": None,
    "print_stats": ("state",),
    "z_calibration": None,
    "dockable_probe": None,
    "extra_probe membrane": None,
}
# Steps during which nobody commands anything, and those after which nobody has
UNCOMMANDED = ("wait", "hand")
# What klippy says as it goes
RESTARTED = "Klipper state: Disconnect"
RESTARTS = ("restart", "save")
MODES = {"G90": ("G90", "G91"), "M82": ("M82", "M83")}
_SENT = re.compile(r"^(?:G1|MOVE_AVOIDING_DOCK) X=?(\S+) Y=?(\S+)")


class HarmError(AssertionError):
    """The world was hurt, or what klippy says is not so; sort: in a word."""

    def __init__(self, sort: str, text: str) -> None:
        super().__init__(text)
        self.sort = sort


class Gone(NamedTuple):
    """A step that was gone: what ran, why it was refused, what was shown.

    breaks: what has broken meanwhile.
    """

    kind: str
    script: str
    refusal: str
    lines: Sequence[str]
    breaks: tuple[Break, ...] = ()

    @property
    def command(self) -> str:
        """The last one, without parameters; of two nobody knows which it was."""
        if self.kind in stepping.MANY:
            return ""
        lines = [line for line in self.script.splitlines() if line != "M400"]
        return ((lines or [""])[-1].split() or [""])[0]

    @property
    def faults(self) -> list[str]:
        """The names of what has broken, see simprinter/faults.py."""
        return [what.fault for what in self.breaks]


class Expected(NamedTuple):
    """What is known of a command, so that the judge is strict.

    depths: mm beyond the trigger by site, in a good run of it, homing included.
    gap: true one at G-code Z=0 afterwards, mm.
    """

    job: Job
    depths: Mapping[str, float]
    gap: float

    def allowed(self, breaks: Sequence[Break]) -> dict[str, float]:
        """How deep (mm) each site may be pressed when that breaks."""
        found = {}
        for site, margin in self.job.margins.items():
            if is_blind(breaks) and not site.startswith("nozzle"):
                margin = max(margin, BLIND_BODY)
            found[site] = self.depths[site] + margin + STEP
        if any(what.fault == "mcu_silent" for what in breaks):
            # Each axis goes on for the steps that its queue has, and the toolhead
            # leaves its line beside the dock
            found["dock"] = OFF_LINE
        return found


def is_blind(breaks: Sequence[Break]) -> bool:
    """Whether two sensors are dead at once."""
    dead = [what for what in breaks if what.fault in claims.BLINDING]
    return len({what.subject or "probe" for what in dead}) > 1


def _agree(breaks: Sequence[Break]) -> bool:
    """Whether two touches are wrong by the same amount."""
    alike = {what[:2] for what in breaks}
    lies = ("trigger_early", "trigger_late")
    return len(breaks) > 1 == len(alike) and breaks[0].fault in lies


@dataclass
class Before:
    """What was so when a step began.

    state: what a refusal leaves as it was. pressed: sites that something
    touched. question: whether a person is asked something. events, touches:
    how many the world had seen. time: seconds of the world. gap: true one at
    G-code Z=0 before a command that is known, mm.
    """

    state: Mapping[str, Any]
    status: Mapping[str, Any]
    pressed: frozenset[str]
    question: bool
    tip: Sequence[float]
    events: int
    touches: int
    probe: str
    time: float
    gap: float


@dataclass
class Judge:
    """Of one walk. Raises HarmError with what is wrong.

    keep_clear: puts the ways of a script around what is in the way. expected: of
    the command that is broken, where it is known: no step may be refused then in
    which nothing was to break.
    is_healthy: the step was refused, and the world knows no reason for it.
    """

    printer: Printer
    owned: Owned
    keep_clear: Callable[[str], str]
    expected: Optional[Expected] = None
    is_healthy: bool = False
    is_shut_down: bool = False

    def __post_init__(self) -> None:
        self.gaps = Gaps(self.printer, self.owned, self.keep_clear)
        self.before = self._before()
        self.lowest = lowest(self.printer.scene.world)
        # A calibration of [z_calibration] has ended well, which its history keeps
        self.is_measured = False
        # How many touches there were when klippy has started
        self.begun = 0
        # What nobody answers any more: whoever prints has cleared the bed
        self.over = ""
        # What had broken when klippy was shut down
        self.pressed_by: tuple[Break, ...] = ()

    def begin(self, kind: str = "") -> None:
        """A step begins."""
        self.is_healthy = False
        self.before = self._before()
        # Its last command's moves are queued still
        if self.before.question or kind in UNCOMMANDED:
            self._stand_still()
            self.before = self._before()

    def end(self, gone: Gone) -> None:
        """It has ended. Raises HarmError."""
        if gone.kind == "print" or (gone.breaks and not self.expected):
            # Its last moves are queued still
            self._stand_still()
        if gone.kind in RESTARTS:
            self.gaps.restarted()
            self.begun = len(self.printer.machine.truth.touches)
            self.over = ""
        if gone.kind == "card":
            after = self._status()["extra_probe membrane"]
            self.over = after.get("waits_for", "")
        elif "EXTRA_PROBE_CALIBRATE" in gone.script:
            self.over = ""
        for sort, rule in (
            ("shutdown", self._is_shut_down),
            ("harm", self._is_hurt),
            ("internal error", self._is_internal),
            ("too low", self._is_too_low),
            ("moved", self._has_moved),
            ("moved", self._is_among_hands),
            ("elsewhere", self._is_elsewhere),
            ("refused", self._is_refused),
            ("left behind", self._has_left),
            ("left behind", self._has_left_of_job),
            ("hidden", self._hides),
            ("lie", self._lies),
            ("wrong offset", self._is_off),
        ):
            if self.is_shut_down and sort not in ("shutdown", "harm"):
                # Klippy knows nothing any more; what is pressed stays so until the restart
                self.pressed_by = gone.breaks
                return
            for text in rule(gone):
                raise HarmError(sort, text)

    def measured(self) -> tuple[dict[str, float], float]:
        """Of a command that is known, when it has ended.

        mm by which each site was pressed deeper than in a good run, and by which
        the gap is another one.
        """
        if self.expected is None:
            return {}, 0.0
        job, good, gap = self.expected
        truth = self.printer.machine.truth
        deeper = {
            site: max(0.0, truth.depth(site) - good[site])
            for site in job.margins
        }
        return deeper, abs(job.gap(self.printer) - gap)

    # What klippy is

    def _is_shut_down(self, gone: Gone) -> Iterator[str]:
        """But where its board is silent, or somebody stops it, and that is said."""
        state, message = self.printer.session.state()
        self.is_shut_down = state != "ready"
        if not self.is_shut_down:
            self.printer.session.wait(0.3)
            return
        causes = [SHUT_DOWN_CAUSES.get(fault) for fault in gone.faults]
        words = "|".join(cause for cause in causes if cause)
        if not words:
            yield message.splitlines()[0]
        elif not re.search(words, message):
            yield f"{message!r} does not name the cause ({words})"
        if "Internal error on" in gone.refusal:
            yield f"is hidden by {gone.refusal!r}"
        if gone.refusal:
            yield from _does_not_name(gone)
        before = self.before.state.get("printer.cfg")
        if before not in (None, self.printer.session.config_text()):
            yield "printer.cfg has changed"

    def _is_internal(self, gone: Gone) -> Iterator[str]:
        for line in (gone.refusal, *gone.lines):
            if "nternal error" in line:
                yield line

    # What the world has seen

    def _is_hurt(self, gone: Gone) -> Iterator[str]:
        truth = self.printer.machine.truth
        if self._is_of_host(gone):
            return
        crashes = [c for c in truth.crashes() if not self._may(gone, c)]
        if crashes:
            reason = f" (refused: {gone.refusal})" if gone.refusal else ""
            yield "; ".join(map(str, crashes)) + reason

    def _may(self, gone: Gone, crash: Crash) -> bool:
        """docs/reliability.md: where no membrane was laid, 1 mm below Z=0."""
        if self.expected:
            is_restart = gone.kind in RESTARTS
            breaks = self.pressed_by if is_restart else gone.breaks
            found = self.expected.allowed(breaks) if breaks else {}
            is_depth = crash.kind == "depth"
            return is_depth and crash.depth <= found.get(crash.site, 0.0)
        is_wrong = bool(gone.breaks or self.owned.mistake)
        if is_wrong and crash.depth <= self._deepest_dead(gone, crash.site):
            return True
        is_looking = "EXTRA_PROBE" in gone.script
        is_laid = self.printer.machine.world.membrane_is_laid
        if crash.site != "nozzle_bed" or is_laid or not is_looking:
            return False
        if self.printer.scene.world.membrane is None:
            # What is fixed is always there
            return False
        return crash.depth <= self._deepest()

    def _deepest(self) -> float:
        """How far (mm) a touch of nothing may go into the bed: below Z=0."""
        machine = self.printer.machine
        tip = machine.tip()
        zero = tip.z - self.printer.session.position()[2]
        x, y = self.membrane
        below = -machine.truth.true_gap(x, y, zero)
        # A frame that is farther away is no mistake of its owner, unless one was drawn
        wrong = math.inf if self.owned.mistake else WRONG_ZERO
        return MARGIN + PLACE + min(max(0.0, below), wrong)

    def _is_of_host(self, gone: Gone) -> bool:
        """Its owner's mistake is in the way of a command that is none of ours."""
        is_ours = gone.command in OURS or gone.kind in ("print", "card")
        return bool(self.owned.mistake) and not is_ours

    def _deepest_dead(self, gone: Gone, site: str) -> float:
        """How far (mm) a dead switch may be pressed: docs/reliability.md.

        As long as no run was good, offset_margins say how low the bed may be.
        """
        low = MARGIN
        if gone.command in OF_Z_CALIBRATION and not self.is_measured:
            low = max(MARGIN, self._lowest_margin())
        if not site.startswith("nozzle"):
            # The nozzle stays above that
            probe = self.printer.scene.world.mag_probe
            hangs = probe.body_drop + probe.switch_offset if probe else 0.0
            return hangs + low
        if site == "nozzle_pin" and self._is_first_on_pin():
            pin = self.printer.scene.world.pin
            assert pin is not None
            return self._to_position_min() + pin.z
        is_known = self.gaps.is_corrected and "ACCEPT_CHANGE" not in gone.script
        if "AUTO_Z" in gone.script and not is_known:
            return self._to_position_min()
        return (MARGIN if site == "nozzle_pin" else low) + SLACK

    def _lowest_margin(self) -> float:
        """How far (mm) below Z=0 the owner lets an offset be."""
        config = self.printer.status("configfile")["config"]
        text = config.get("z_calibration", {}).get("offset_margins", "-1, 1")
        return -min(float(part) for part in text.split(","))

    def _deepest_of_job(self) -> float:
        """How far (mm) the nozzle may press anything."""
        assert self.expected is not None
        job, depths, _ = self.expected
        return max(
            [
                depths[site] + margin
                for site, margin in job.margins.items()
                if site.startswith("nozzle")
            ],
            default=0.0,
        )

    def _is_first_on_pin(self) -> bool:
        """Whether klippy does not know yet how high a pin of its own is."""
        own = self.printer.scene.sections.get("z_calibration") or {}
        touches = self.printer.machine.truth.touches
        touches = touches[self.begun : self.before.touches]
        is_known = any(touch.site == "nozzle_pin" for touch in touches)
        return "endstop_pin" in own and not is_known

    def _to_position_min(self) -> float:
        """From the bed to the end of the Z axis, which is the first floor of all (mm)."""
        machine = self.printer.machine
        zero = machine.tip().z - self.printer.session.position()[2]
        low = self.printer.status("toolhead")["axis_minimum"][2]
        return max(MARGIN, -machine.truth.true_gap(*POINT, zero + low)) + SLACK

    @property
    def membrane(self) -> tuple[float, float]:
        """The middle of what a membrane is laid on, or the fixed switch (mm)."""
        world = self.printer.scene.world
        spec = world.membrane or world.pin
        assert spec is not None
        return spec.x, spec.y

    def _is_too_low(self, gone: Gone) -> Iterator[str]:
        """Also where nothing is in the way."""
        truth = self.printer.machine.truth
        floor = self.lowest - MARGIN
        if "EXTRA_PROBE" in gone.script:
            floor -= self._deepest()
        if self.expected:
            floor -= max(self._deepest_of_job(), MARGIN)
        elif gone.breaks or self.owned.mistake:
            sites = ("nozzle_bed", "nozzle_pin")
            deepest = max(self._deepest_dead(gone, site) for site in sites)
            floor -= deepest - MARGIN
        if truth.lowest < floor and not self._is_of_host(gone):
            yield f"the nozzle was at {truth.lowest:.3f}, {floor:.3f} is low"
        truth.forget()

    def _has_moved(self, gone: Gone) -> Iterator[str]:
        """While nobody commands anything."""
        if gone.kind in UNCOMMANDED:
            here, there = self.printer.machine.tip(), self.before.tip
            status, is_asked = self.before.status, self.before.question
        elif gone.kind in RESTARTS or not self.owned.has("dockable_probe"):
            return
        else:
            # Where its moves end, klippy knows before they have been made
            there = self.printer.session.position()[:3]
            trips = self._trips()
            self.printer.session.wait(DETACH_DELAY)
            self._stand_still()
            here, status = self.printer.session.position()[:3], self._status()
            is_asked = self._is_asked(status)
            if self._is_refused_beside(gone) and is_asked:
                # Before the toolhead moves, and whatever templates run
                there = self.before.tip
                here = self.printer.machine.tip()
            if self._trips() > trips and not _may_dock(status):
                yield "to the dock and back while nobody asks for it"
        moved = max(abs(a - b) for a, b in zip(here, there))
        if moved > PLACE and is_asked:
            yield f"by {moved:.1f} mm while somebody is asked"
        elif moved > PLACE and not _may_dock(status):
            yield f"by {moved:.1f} mm while nobody asks for it"

    def _trips(self) -> int:
        """How often the probe was fetched and docked, when all moves are made."""
        self.printer.session.run("M400")
        events = self.printer.machine.truth.events
        return sum(event.kind in ("attach", "dock") for event in events)

    def _is_among_hands(self, gone: Gone) -> Iterator[str]:
        """Nothing of ours touches while another asks a person, who reaches in."""
        status = self.before.status
        waits_for = status["extra_probe membrane"].get("waits_for", "")
        is_asked = status["manual_probe"].get("is_active")
        is_asked = is_asked or waits_for not in ("", self.over)
        is_answer = re.search("EXTRA_PROBE_(CONTINUE|ABORT)", gone.script)
        is_ours = gone.kind == "gcode" and gone.command in OURS
        touches = self.printer.machine.truth.touches[self.before.touches :]
        if is_asked and is_ours and not is_answer and touches:
            yield f"touched {touches[0].site} while somebody is asked"

    def _is_refused_beside(self, gone: Gone) -> bool:
        """Something of ours was refused that is no answer to what is asked."""
        is_answer = re.search("_CONTINUE|_ABORT|_SETUP", gone.script)
        is_own = gone.command in OF_DOCKABLE_PROBE and any(
            shown.is_open and "DOCKABLE_PROBE_SETUP" in str(shown)
            for shown in dialogs_of(self._console_of_now())
        )
        if gone.command in OF_Z_CALIBRATION or is_own:
            # Its own set-up asks its owner, who has sent the command
            status = self.before.status
            waits_for = status["extra_probe membrane"].get("waits_for")
            is_answer = not (
                waits_for or status["manual_probe"].get("is_active")
            )
        is_one = gone.command in OURS and gone.script.count("\n") <= 1
        is_beside = self.before.question and is_one and not is_answer
        return bool(gone.refusal and is_beside)

    def _is_elsewhere(self, gone: Gone) -> Iterator[str]:
        """Where the toolhead was sent, it is; and it touches what is there."""
        sent = [m for m in map(_SENT.match, gone.script.splitlines()) if m]
        # A skew that is corrected is another place
        is_skew = "skew" in self.owned.names
        if gone.refusal or gone.kind != "gcode" or not sent or is_skew:
            return
        x, y = (float(number) for number in sent[-1].groups())
        if gone.command == "MOVE_AVOIDING_DOCK":
            self._stand_still()
            places = [self.printer.machine.tip()]
            # A docking that was pending may leave it beside the dock
            new = self.printer.machine.truth.events[self.before.events :]
            if any(event.kind == "dock" for event in new):
                return
        else:
            sites = WHERE_IT_IS.get(gone.command, ())
            touches = self.printer.machine.truth.touches[self.before.touches :]
            places = [touch for touch in touches if touch.site in sites]
        for place in places:
            if max(abs(place.x - x), abs(place.y - y)) > PLACE:
                yield (
                    f"at X={place.x:.3f} Y={place.y:.3f} instead of"
                    f" X={x:.3f} Y={y:.3f}"
                )

    # What is left, and said

    def _before(self) -> Before:
        machine = self.printer.machine
        job = self.expected.job if self.expected else None
        truth = machine.truth
        status = self._status()
        return Before(
            state=self._state(status),
            status=status,
            pressed=self._pressed(),
            question=self._is_asked(status),
            tip=machine.tip(),
            events=len(truth.events),
            touches=len(truth.touches),
            probe=self._probe(),
            time=self.printer.now(),
            gap=job.gap(self.printer) if job else 0.0,
        )

    def _status(self) -> Status:
        return self.printer.session.statuses(LOOKED_AT)

    def _state(self, status: Status) -> dict[str, Any]:
        """What a refusal leaves as it was."""
        toolhead, gcode_move = status["toolhead"], status["gcode_move"]
        limits = [name for name in toolhead if name.startswith("max_")]
        limits += ["axis_minimum", "axis_maximum", "square_corner_velocity"]
        return {
            "the G-code offset": round(gcode_move["homing_origin"][2], 9),
            "G90": gcode_move["absolute_coordinates"],
            "M82": gcode_move["absolute_extrude"],
            **{name: toolhead.get(name) for name in limits},
            "what is saved": status["configfile"].get(PENDING),
            "currents": {
                name: driver.current()[1:]
                for name, driver in self.printer.machine.drivers.items()
            },
            **(self.expected.job.state(self.printer) if self.expected else {}),
        }

    def _pressed(self) -> frozenset[str]:
        here = self.printer.machine.near()
        return frozenset(near.site for near in here if near.pressed)

    def _has_left(self, gone: Gone) -> Iterator[str]:
        """All that is temporary is as before; after a refusal the rest, too."""
        is_known = self.expected is not None and bool(gone.breaks)
        if gone.kind != "gcode" or not (is_known or gone.command in OURS):
            return
        lasting = {*self._of_owner(), *(() if gone.refusal else LASTING)}
        if self.expected:
            if self.expected.job.is_homing:
                # The host has turned the motors off
                return
            lasting.update(self.expected.job.told)
        before, after = self.before.state, self._state(self._status())
        if gone.refusal and gone.script.startswith(stepping.AWAY[:20]):
            # Before the command the way there may have failed, between its modes
            lasting.add("G90")
        changed = {
            k: (before[k], after[k])
            for k in after
            if after[k] != before[k] and k not in lasting
        }
        if changed:
            yield f"{changed} after {gone.refusal or 'a good run'}"
        if not gone.refusal:
            return
        self._stand_still()
        pressed = self._pressed() - self.before.pressed
        sites = sorted(s for s in pressed if s.startswith(("nozzle", "body")))
        if sites:
            yield f"{sites} are pressed after {gone.refusal}"

    def _is_refused(self, gone: Gone) -> Iterator[str]:
        """A command that is known, and nothing has broken."""
        if self.expected and gone.refusal and not gone.breaks:
            yield gone.refusal

    def _has_left_of_job(self, gone: Gone) -> Iterator[str]:
        """Beyond what any command of ours leaves, where it is known."""
        if gone.kind == "restart" and self.printer.offset():
            yield "an offset is in force"
        if not self.expected or not gone.refusal:
            return
        job = self.expected.job
        if job.is_homing:
            return
        now = job.gap(self.printer)
        if "gap" not in job.told and abs(now - self.before.gap) >= STEP:
            yield f"gap was {self.before.gap:.4f} and is {now:.4f}"
        z, lift = self.printer.session.position()[2], job.lift
        if len(gone.breaks) > 1 and "trigger_late" in gone.faults:
            # The bed it is lifted from was met too low, and not again
            lift -= OFF
        if z < lift:
            yield f"the toolhead is at z={z:.3f}"

    def _of_owner(self) -> Iterator[str]:
        """What G-code in options sets: modes, which only z_calibration undoes,
        and the offset, where homing does."""
        for section, option, value in self.owned.options:
            is_homing = option == "error_gcode" and "G28" in (value or "")
            if is_homing and "wrapped_homing" in self.owned.names:
                yield LASTING[0]
            if section != "z_calibration" and option.endswith("_gcode"):
                for name, codes in MODES.items():
                    if any(code in (value or "") for code in codes):
                        yield name

    def _hides(self, gone: Gone) -> Iterator[str]:
        """What was broken is not named, nor anything else that is so."""
        if not gone.breaks or not gone.refusal or self.owned.mistake:
            return
        found = next(_does_not_name(gone), "")
        if found and not self.expected:
            has_struck = not self.printer.machine.faults.unfired()
            is_so = claims.verdict(gone.refusal, self._facts()) is not None
            # A touch that is to be broken may not come any more
            found = "" if is_so or not has_struck else found
        if found:
            yield found

    def _lies(self, gone: Gone) -> Iterator[str]:
        """What is said of the printer is not so, and nothing is broken or wrong."""
        if self.owned.mistake:
            return
        facts = self._facts()
        if gone.breaks:
            yield from claims.untrue_query(gone.command, gone.refusal, facts)
            return
        yield from claims.untrue(gone.command, gone.refusal, gone.lines, facts)
        if gone.refusal and gone.kind in ("gcode", "print", "answer"):
            found = claims.verdict(gone.refusal, facts)
            if found is False:
                yield f"it is not so: {gone.refusal}"
            self.is_healthy = found is None

    def _facts(self) -> claims.Facts:
        """What was so before the step and is so now."""
        status = self._status()
        return claims.Facts(
            before=self.before.status,
            after=status,
            probes=self._probes(),
            membrane=self.printer.machine.world.membrane_is_laid,
            is_asked=self.before.question or self._was_asked(status),
            touched=frozenset(
                touch.site
                for touch in self.printer.machine.truth.touches[
                    self.before.touches :
                ]
            ),
        )

    def _probes(self) -> frozenset[str]:
        """Where the probe has been while the step went on."""
        new = self.printer.machine.truth.events[self.before.events :]
        names = {"attach": "attached", "dock": "docked", "lost": "lost"}
        seen = {names[e.kind] for e in new if e.kind in names}
        return frozenset({self.before.probe, self._probe(), *seen})

    def _is_off(self, gone: Gone) -> Iterator[str]:
        if self.expected:
            yield from self._is_off_of_job(gone, self.expected)
            return
        shows = any(CALIBRATED.search(line) for line in gone.lines)
        self.is_measured = self.is_measured or shows
        # In a print, too, others come after it
        is_alone = gone.kind not in (*stepping.MANY, "card")
        yield from self.gaps.wrong(
            gone.script,
            gone.lines,
            is_alone,
            bool(gone.refusal),
            self.before.time,
        )

    def _is_off_of_job(self, gone: Gone, expected: Expected) -> Iterator[str]:
        """The gap is not that of a good run."""
        job, _, good = expected
        if gone.refusal or not gone.script.endswith(f"{job.script}\nM400\n"):
            return
        gap = job.gap(self.printer)
        error = abs(gap - good)
        if job.samples == 2 and _agree(gone.breaks):
            # The only two that are compared: nothing can tell
            error = min(error, abs(error - OFF))
        if error >= GAP_ERROR:
            yield f"the gap is {gap:.4f}, which should be {good:.4f}"

    # Looking

    def _probe(self) -> str:
        return self.printer.machine.world.probe_state(self.printer.now())

    def _is_asked(self, status: Status) -> bool:
        """Whether a dialog, or a manual probe, has a person look or reach in."""
        if status["manual_probe"].get("is_active"):
            return True
        extra = status["extra_probe membrane"]
        shown = dialogs_of(self._console_of_now())
        return bool(extra.get("waits_for")) or any(d.is_open for d in shown)

    def _console_of_now(self) -> Sequence[str]:
        """Since klippy has started: nobody has asked what was open before."""
        console = self.printer.session.console
        starts = [i for i, line in enumerate(console) if RESTARTED in line]
        return console[starts[-1] :] if starts else console

    def _was_asked(self, status: Status) -> bool:
        """Whether one is, or was: the end of a set-up closes the dialogs of all
        sections on a page, while the others still wait."""
        shown = dialogs_of(self.printer.session.console)
        return bool(shown) or self._is_asked(status)

    def _stand_still(self) -> None:
        """A host may keep the last move to itself for most of a second."""
        machine, last = self.printer.machine, None
        while last != machine.tip():
            last = machine.tip()
            self.printer.session.wait(1.0)


def _does_not_name(gone: Gone) -> Iterator[str]:
    """A refusal does not name the cause."""
    words = "|".join(CAUSES[fault] for fault in gone.faults)
    if not re.search(words, gone.refusal):
        names = ", ".join(gone.faults)
        yield f"{names}: {gone.refusal!r} does not name the cause ({words})"


def _may_dock(status: Status) -> bool:
    """Whether a probe may go to its dock by itself, after a while."""
    dock = status.get("dockable_probe") or {}
    is_homed = "xy" in status["toolhead"]["homed_axes"]
    return is_homed and bool(dock.get("auto_attach_detach", True))


def lowest(world: WorldSpec) -> float:
    """The lowest Pose.z (mm) at which something stops a nozzle: bed or switch."""
    bed = Bed(world.bed)
    ends = (
        (world.bed.x_min, world.bed.x_max),
        (world.bed.y_min, world.bed.y_max),
    )
    corners = [bed.height(x, y) for x in ends[0] for y in ends[1]]
    mesh = world.bed.mesh
    dips = min([0.0, *(min(row) for row in mesh.heights)] if mesh else [0.0])
    switches = [s.position for s in world.switches if s.axis == "z"]
    pins = [world.pin.z - world.pin.pin_travel] if world.pin else []
    return min([*(corner + dips for corner in corners), *switches, *pins])
