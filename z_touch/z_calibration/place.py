"""One place of a calibration: get there, come down, touch, look, come up.

                         nozzle           switch           bed

  touches with           the tip          the body         the probe
  stopped by             the pin          the pin          the probe
  looked at, too         the probe        the probe        the pin and the probe
                         on arrival       on arrival and   on arrival (the probe)
                                          at each touch    and when it leaves

The sensor that stops a touch is looked at by the host before each move.  The other one is not
armed, so it is looked at here.

Every height is a toolhead Z in mm.  All methods that move or look at a sensor may pause.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING, Iterator, Optional

from .. import attached, errors, touch
from ..command import always
from ..errors import CalibrationError, NoTrigger, SamplesDiffer
from ..texture import spread_site, spread_tolerance
from . import checks, heights, pace
from .heights import HIGHER_THAN_HOMED, HOME_AGAIN
from .settings import may_lengthen

if TYPE_CHECKING:
    from ..host.klippy import Endstop
    from ..host.probe import ProbeSession
    from ..sampling import Sampling
    from ..touch import Site
    from .run import CalibrationRun

# What to do where the toolhead is below the floor of a touch already
TOO_LOW = (
    "correct switch_offset (larger than any switch has it) or"
    " position_max of the Z axis"
)

# So far (mm) above where the nozzle should meet the pin a move ends that is armed on the
# probe
ABOVE_PIN = 0.5

# At least so far (mm) a plunger goes in beyond where it triggers
LOOK_STEP = 0.2

# The pin is wider than this (mm)
SAME_PLACE = 1.0

# Lift (mm) before the free plunger is moved over the plate
CLEAR_OF_PLATE = heights.FREE_PLUNGER + 0.5

# Where an earlier run has limited a touch
IF_CHANGED = (
    ", or, if pin, bed or probe was changed, run CALIBRATE_Z ACCEPT_CHANGE=1"
)


class Place:
    """One site of a run: approach it, touch it, come back up."""

    # What to look at after a touch that failed; %s is where the site comes from.
    remedy = ""
    # Whether the way there goes along X, then along Y
    x_first = False

    def __init__(self, run: CalibrationRun, site: Site, sampling: Sampling):
        self.run = run
        self.host = run.host
        self.settings = run.settings
        self.site = site
        self.sampling = sampling
        self.head = touch.Head(run.host, sampling, TOO_LOW)
        # Where the trigger should be, None: not known; and no touch goes lower
        self.expected_z: Optional[float] = None
        self.floor = float("inf")
        # Samples so far
        self.taken = 0

    def measure(
        self, travel_z: float, expected_z: Optional[float], floor: float
    ) -> float:
        """Return the height of the place.

        'travel_z' is where the toolhead moves in X and Y; 'expected_z' where the trigger
        should be, None: not known; no touch goes lower than 'floor'.
        """
        self.expected_z, self.floor = expected_z, floor
        with errors.about(self.site.name):
            self.touch_all(travel_z)
        if self.run.reports_places:
            self.report()
        return self.run.statistics.estimates[self.site.name].z

    def touch_all(self, travel_z: float) -> None:
        """Take all samples, in the order in which it is done."""
        self.arrive(travel_z)
        self.come_down(travel_z)
        self.collect()

    def report(self) -> None:
        """Show where the place is, by so many touches."""
        name = self.site.name
        z = self.run.statistics.estimates[name].z
        samples = self.run.statistics.samples[name]
        how = "1 touch"
        if len(samples) > 1:
            apart = max(samples) - min(samples)
            how = f"{len(samples)} touches, {apart:.3f} mm apart"
        self.run.progress.say(f"{name} at z={z:.3f} ({how})")

    ##################################################################
    # There and down
    ##################################################################

    def endstop(self) -> Endstop:
        """Return what is to be pressed at this place."""
        return self.run.pin.endstop

    def arrive(self, travel_z: float) -> None:
        """Go there, unless the toolhead is there, and high enough for a touch."""
        is_high = self.host.motion.z() >= self.top(travel_z)
        is_there = self.expected_z is not None and is_high
        if not (is_there and touch.is_over(self.host, self.site)):
            self.go_there(travel_z)

    def go_there(self, travel_z: float) -> None:
        """Go up first, so that nothing is hit on the way; never down to get there."""
        self.head.lift(travel_z)
        site, speed = self.site, self.settings.speed
        everything = attached.of(self.host.printer)
        everything.go_to(self.host, site.x, site.y, speed, self.x_first)

    def top(self, travel_z: float) -> float:
        """Return where the samples begin: above the expected trigger."""
        if self.expected_z is None:
            return travel_z
        lift: float = self.sampling.retract_dist
        return max(self.expected_z, self.floor) + lift

    def come_down(self, travel_z: float) -> None:
        """Come down quickly to where every sample begins.

        Where it is not known where that is, the samples begin at the travel height.
        """
        if self.settings.probing_first_fast:
            self.first_touch()
            return
        with self.explaining():
            self.head.come_down(
                self.endstop(), self.top(travel_z), self.settings.probing_speed
            )

    def first_touch(self) -> None:
        """Touch once to get down; it is no sample."""
        speed, settings = self.settings.probing_speed, self.settings
        if "probing_speed" not in settings.given:
            # It is a touch, and those are as fast as the user has them
            assert self.host.axes.z_axis is not None
            speed = min(speed, self.host.axes.z_axis.homing_speed)
        with self.explaining():
            self.head.touch(self.endstop(), self.floor, speed)

    ##################################################################
    # Samples
    ##################################################################

    def collect(self) -> None:
        """Touch until the series is complete; the heights go into the statistics."""
        series = self.run.statistics.begin(self.site.name, self.sampling)
        while not series.is_complete():
            z = self.take_sample()
            try:
                why_again = series.add(z)
            except SamplesDiffer as e:
                raise e.advised(self.steady())
            if why_again:
                self.run.progress.say(f"{self.site.name}: {why_again}")

    def take_sample(self) -> float:
        """Return the height of one touch."""
        before_z = self.head.pressed_z
        self.retract()
        with self.explaining():
            self.touch_again(before_z)
        z = self.head.pressed_z
        assert z is not None
        self.check_pressed()
        self.taken += 1
        self.run.progress.touched()
        point = self.note_point()
        self.run.progress.detail(
            f"{self.site.name}: touched at z={z:.6f}{point}"
        )
        return z

    def touch_again(self, before_z: Optional[float]) -> None:
        """Touch once, begun higher up where the switch is still pressed after the lift.

        'before_z' is where it had triggered, None: it was not touched before.
        """
        try:
            self.touch_once()
        except CalibrationError:
            if before_z is None or not self.lift_until_open(before_z):
                raise
            self.touch_once()

    def touch_once(self) -> None:
        """Touch once, down to the floor."""
        self.head.touch(self.endstop(), self.floor, self.sampling.speed)

    def retract(self) -> None:
        """Lift to where the next touch begins."""
        self.head.retract()

    def lift_until_open(self, pressed_z: float) -> bool:
        """Lift until the switch opens, which is the lift from now on; return whether it does.

        Only where the lift is the module's.
        """
        lift: float = self.sampling.retract_dist
        if not may_lengthen(self.settings) or not self.reads_pressed():
            return False
        while lift < pace.LONGEST_LIFT:
            lift = min(2.0 * lift, pace.LONGEST_LIFT)
            self.head.lift(pressed_z + lift)
            if not self.endstop().query_endstop(self.host.after_moves()):
                self.sampling = self.sampling._replace(retract_dist=lift)
                self.head.use_lift(lift)
                return True
        self.explain()
        return False

    def reads_pressed(self) -> bool:
        """Return whether what is pressed here reads triggered, right after a touch."""
        return bool(self.endstop().query_endstop(self.host.print_time()))

    def lift_clear(self) -> None:
        """Lift until nothing is pressed any more, whatever is lifted between touches."""
        lift: float = self.sampling.retract_dist
        if may_lengthen(self.settings):
            lift = max(lift, pace.LONGEST_LIFT)
        z = self.host.motion.z() + lift
        self.head.lift(min(z, self.settings.position_max))

    ##################################################################
    # What a place says of its touches
    ##################################################################

    def steady(self) -> str:
        """Return what to do about touches that do not agree."""
        return "check how the probe is seated, and probe and Z axis for play"

    def check_pressed(self) -> None:
        """Look at the sensor that is not armed while the toolhead presses the other one."""

    def note_point(self) -> str:
        """Return where a touch was, in words; empty: where all touches are."""
        return ""

    def check_height(self) -> None:
        """Raise CalibrationError where what was just touched cannot be the right thing."""

    def explain(self) -> None:
        """Raise what is known of a touch that failed."""
        self.check_pin_open(self.host.after_moves())

    def advice(self) -> str:
        """Return what to look at after a touch that has just failed."""
        return self.remedy % (self.site.place(),)

    @contextlib.contextmanager
    def explaining(self) -> Iterator[None]:
        """Have the error of a touch say what was expected and what to look at.

        Where nothing triggered, or at once, the sensors may know better.
        """
        start_z = self.host.motion.z()
        try:
            yield
        except CalibrationError as e:
            if isinstance(e, NoTrigger) or touch.is_at(self.host, start_z):
                self.explain()
            raise e.advised(self.advice(), self.expected_z, self.floor_reason())
        self.check_height()

    def floor_reason(self) -> str:
        """Return why a touch has ended where it did, if that was position_min."""
        if not touch.is_at(self.host, self.floor):
            return ""
        section = checks.position_min_section(self.host, self.settings)
        return heights.ended_by_position_min(
            self.settings, section, self.floor, self.expected_z
        )

    ##################################################################
    # The two sensors, as they are at a print time
    ##################################################################

    def check_pin_open(self, print_time: float) -> None:
        """Raise CalibrationError where the pin reads triggered."""
        if self.run.pin.endstop.query_endstop(print_time):
            raise CalibrationError(
                f"{self.run.pin.name} reads triggered where nothing should press it;"
                " check it with QUERY_ENDSTOPS"
            )

    def check_probe_attached(self, print_time: float) -> None:
        """Raise CalibrationError where the probe reads triggered."""
        if not self.host.probing.reads_triggered(print_time):
            self.run.was_attached = True
            return
        if self.run.was_attached:
            raise CalibrationError(
                "the probe reads triggered, and was attached before: it has come"
                " off, or its wire is broken; look where it is before the toolhead"
                " moves and check it with QUERY_PROBE"
            )
        # In the set-up there may be none of these yet
        where = (
            " in start_gcode or before_switch_gcode" if self.site.option else ""
        )
        raise CalibrationError(
            "the probe reads triggered: it is not attached, or not wired"
            f" as normally closed; attach it{where} and check it with QUERY_PROBE"
        )


class NozzlePlace(Place):
    """The nozzle tip on the pin."""

    remedy = HOME_AGAIN + ", then check %s and the switch there"
    # A dock that is not known is more often beside the pin than in front of it.
    x_first = True

    def touch_all(self, travel_z: float) -> None:
        """Take all samples; a probe that is attached must not meet the bed before the pin."""
        carrier = attached.of(self.host.printer).carrier(self.host)
        is_late = carrier is None and self.settings.may_attach_late
        # Where macros attach it afterwards, one that was left on is looked for in each run
        looks = is_late or not self.is_proved()
        if looks and carrier is not None:
            looks = carrier.state() != attached.DOCKED
        moved = self.host.after_moves()
        self.arrive(travel_z)
        self.run.unknown_over_pin = self.host.transforms.unknown_here()
        looked = touch.before_arrival(self.host, moved)
        is_attached = looks and not self.host.probing.reads_triggered(looked)
        if is_attached and self.is_proved() and self.is_pin_known():
            self.come_down_with_probe(travel_z)
            if self.endstop().query_endstop(self.host.after_moves()):
                # A longer nozzle: the next way down is armed on the pin
                self.go_there(travel_z)
        elif is_attached:
            self.look_for_bed(travel_z)
        self.come_down(travel_z)
        self.collect()
        if is_attached and not self.is_proved():
            self.run.proved.append((self.site.x, self.site.y))
        if self.is_proved():
            self.run.proved_at = self.site.x, self.site.y
        if self.settings.wiggle_xy_offsets is not None:
            self.retract()

    def is_proved(self) -> bool:
        """Return whether the pin was touched here with the probe attached."""
        here = self.site.x, self.site.y
        return any(
            math.dist(here, place) <= SAME_PLACE for place in self.run.proved
        )

    def is_pin_known(self) -> bool:
        """Return whether the pin is as high as expected: Z=0 was not moved since G28."""
        if self.expected_z is None:
            return False
        is_homed_on = self.settings.position_endstop is not None
        return not (is_homed_on and self.run.homed.moved())

    def come_down_with_probe(self, travel_z: float) -> None:
        """Come down in one move that is armed on the probe, to above the pin."""
        assert self.expected_z is not None
        low = max(self.expected_z, self.floor) + ABOVE_PIN
        probe = self.host.probing.bare_endstop()
        speed = self.settings.probing_speed
        if self.head.come_down(probe, low, speed) is not None:
            self.refuse_attached()

    def look_for_bed(self, travel_z: float) -> None:
        """Come down to the pin in small steps, and look at the probe after each.

        Only one switch can end a move, and that is the pin: it may be higher than expected,
        and the probe's body may be over it in place of the nozzle.  Afterwards it is known how
        high the pin is.
        """
        settings, floor = self.settings, self.floor
        z = max(
            heights.reach_below(settings.z_offset, settings.offset_margins[1]),
            floor,
        )
        while True:
            with self.explaining():
                trigger_z = self.head.come_down(
                    self.endstop(), z, settings.probing_speed
                )
            if trigger_z is not None:
                break
            if self.host.probing.reads_triggered(self.host.after_moves()):
                self.refuse_attached()
            if z <= floor:
                # A touch from above says that nothing has triggered
                self.go_there(travel_z)
                return
            z = max(min(z, self.host.motion.z()) - LOOK_STEP, floor)
        # A switch may open late
        self.retract()
        self.lift_clear()
        self.expected_z = trigger_z
        self.floor = max(floor, heights.nozzle_floor(settings, trigger_z))

    def refuse_attached(self) -> None:
        """Raise as the probe has touched the bed."""
        carrier = attached.of(self.host.printer).carrier(self.host)
        remedy = (
            f"check that the pin is at {self.site.place()}, or attach the probe later, in"
            " before_switch_gcode"
        )
        if carrier is None and self.settings.may_attach_late:
            remedy = (
                "put it away, and attach it after the nozzle only, in"
                " before_switch_gcode"
            )
        raise CalibrationError(
            "the probe is on the toolhead, and has touched the bed at"
            f" z={self.host.motion.z():.3f}, where nothing should be touched before the pin;"
            f" {remedy}"
        )

    def steady(self) -> str:
        """Return what to do about touches that do not agree."""
        return (
            self.run.oozing()
            or "clean the nozzle and check the switch for play"
        )

    def check_height(self) -> None:
        """Raise where the pin triggers far above where Z was homed on it."""
        homed_z, z = self.settings.position_endstop, self.head.pressed_z
        if homed_z is None or z is None or z <= homed_z + HIGHER_THAN_HOMED:
            return
        if self.host.is_file_output():
            return
        # A switch that is stuck has touched nothing
        self.lift_clear()
        self.check_pin_open(self.host.after_moves())
        text = (
            f"triggered at z={z:.3f}, {z - homed_z:.1f} mm above position_endstop"
            f" ({homed_z:.3f})"
        )
        moved = self.run.homed.moved()
        if moved:
            raise CalibrationError(f"{text}, and {moved}; {HOME_AGAIN}")
        raise CalibrationError(
            f"{text}, at which Z was homed on this pin: something hangs below the"
            " nozzle, such as the probe; take it off, or attach it in"
            " before_switch_gcode"
        )

    def retract(self) -> None:
        """Lift; a pin that sticks to the nozzle is shaken off then."""
        is_pressed = self.head.pressed_z is not None
        self.head.retract()
        if is_pressed and self.settings.wiggle_xy_offsets is not None:
            (x, y), speed = self.settings.wiggle_xy_offsets, self.settings.speed
            site = self.site
            touch.move_xy(self.host, site.x + x, site.y + y, speed)
            touch.move_xy(self.host, site.x, site.y, speed)


class SwitchPlace(Place):
    """The body of the probe's switch on the same pin."""

    remedy = (
        "check %s, how the probe is seated, and that z_offset"
        " in section 'probe' is about the distance of nozzle and probe"
    )

    def advice(self) -> str:
        """Return what to look at; a good run of before may have limited the touch."""
        remedy = super().advice()
        return remedy if self.run.earlier.kept is None else remedy + IF_CHANGED

    def arrive(self, travel_z: float) -> None:
        """Go there, and look at the probe, which may have been attached right before."""
        moved = self.host.after_moves()
        super().arrive(travel_z)
        self.check_probe_attached(touch.before_arrival(self.host, moved))

    def explain(self) -> None:
        """Raise what is known of a touch that failed.

        A probe that reads triggered is lost, or its plunger is pressed: lifting tells which.
        """
        if self.host.probing.reads_triggered(self.host.after_moves()):
            self.lift_clear()
            self.check_probe_attached(self.host.after_moves())
            raise CalibrationError(
                "the plunger of the probe was pressed where only its body"
                f" should meet the pin; check {self.site.place()}"
            )
        super().explain()

    def check_pressed(self) -> None:
        """Warn where the pin presses the plunger, too; the sample counts.

        Such a probe looks lost until it is lifted.
        """
        if self.host.probing.reads_triggered(self.host.print_time()):
            self.lift_clear()
            self.check_probe_attached(self.host.after_moves())
            self.run.warn(
                self.site.name,
                "switch: the pin presses the plunger of the probe besides its body,"
                f" which makes the height wrong; correct {self.site.place()}",
            )


class BedPlace(Place):
    """The probe on the print surface, through the host's own probing.

    'lowest' is the lowest offset (mm) that the floor allows for, None: it is another floor.
    With bed_spread each sample is at a point of its own.
    """

    remedy = "check %s and the probe (QUERY_PROBE, PROBE)"

    def __init__(
        self,
        run: CalibrationRun,
        site: Site,
        sampling: Sampling,
        lowest: Optional[float] = None,
    ):
        self.lowest = lowest
        self.spread = run.settings.bed_spread
        self.middle = site
        # The host's own probing; None: it cannot be told the floor
        self.session: Optional[ProbeSession] = None
        tolerance = spread_tolerance(sampling.tolerance, self.spread)
        sampling = sampling._replace(tolerance=tolerance)
        first = spread_site(site, self.spread, 0, run.statistics.turn)
        super().__init__(run, first, sampling)

    def endstop(self) -> Endstop:
        """Return the probe's switch: only the host's own probing runs G-code of the user."""
        found: Endstop = self.host.probing.bare_endstop()
        return found

    def touch_all(self, travel_z: float) -> None:
        """Take all samples."""
        self.arrive(travel_z)
        self.run.check_unknown_over_bed()
        with self.in_session(travel_z, is_look=False):
            self.collect()

    def look(self, travel_z: float, floor: float) -> float:
        """Return the height of one fast touch, which tells how long the probe is.

        Outside of the host's own probing, whose end may put the probe away before its body
        is to meet the pin.
        """
        self.floor = floor
        with errors.about(self.site.name):
            self.go_there(travel_z)
            self.check_probe_attached(self.host.after_moves())
            if self.host.probing.lifts_outside_session():
                with self.in_session(travel_z, is_look=True):
                    z = self.head.pressed_z
            else:
                z = self.look_once(travel_z)
        assert z is not None
        return z

    def look_once(self, travel_z: float) -> Optional[float]:
        """Return the height of one fast touch, the toolhead lifted again."""

        def lift() -> None:
            """Lift the toolhead to travel_z (mm)."""
            self.head.lift(travel_z)

        with always(self.host, lift, "lifting"):
            self.first_touch()
            z = self.head.pressed_z
        self.leave(travel_z)
        return z

    @contextlib.contextmanager
    def in_session(self, travel_z: float, is_look: bool) -> Iterator[None]:
        """Come down and begin the host's own probing; lift before it ends.

        Outside of a session some dockable_probe may lift the toolhead after a move.  At its
        end the host may stow or dock the probe.
        """
        is_inside = self.host.probing.lifts_outside_session()
        if not is_inside:
            self.come_down(travel_z)
        with touch.probing(
            self.head,
            self.floor,
            travel_z,
            PROBE_SPEED=f"{self.sampling.speed:.6f}",
        ) as self.session:
            if is_inside:
                self.come_down_to(travel_z, is_look)
            yield
            self.leave(travel_z)

    def come_down_to(self, travel_z: float, is_look: bool) -> None:
        """Come down to where the samples begin, or to the bed."""
        if is_look:
            self.first_touch()
        else:
            self.come_down(travel_z)

    def leave(self, travel_z: float) -> None:
        """Lift; both sensors must be free again above the bed.

        A probe that the host puts away after each touch reads like one that has come off.
        """
        self.head.lift(travel_z)
        print_time = self.host.after_moves()
        self.check_pin_open(print_time)
        is_put_away = self.taken and self.host.probing.puts_away_each_time()
        if not is_put_away:
            self.check_probe_attached(print_time)

    def touch_once(self) -> None:
        """Touch once, down to the floor.

        A host that cannot be told the floor would go on to position_min, so its switch is
        touched without its probing.
        """
        self.head.check_above(self.floor)
        if self.session is not None:
            self.run.twist = self.head.probe(self.session).twist
        else:
            endstop = self.host.probing.endstop()
            self.head.touch(endstop, self.floor, self.sampling.speed)
            self.run.twist = self.host.probing.twist()

    def retract(self) -> None:
        """Lift; with bed_spread high enough to move on to the next point."""
        pressed_z = self.head.pressed_z
        if not self.spread or pressed_z is None:
            super().retract()
            return
        lift = max(self.sampling.retract_dist, CLEAR_OF_PLATE)
        self.head.lift(pressed_z + lift)
        turn = self.run.statistics.turn
        site = spread_site(self.middle, self.spread, self.taken, turn)
        # A dock may be so near
        everything = attached.of(self.host.printer)
        everything.go_to(self.host, site.x, site.y, self.settings.speed)

    def note_point(self) -> str:
        """Keep X and Y of the bed, and return them in words."""
        if not self.spread:
            return ""
        x, y = self.host.toolhead.get_position()[:2]
        x_offset, y_offset = self.host.probing.offsets()[:2]
        point = (x + x_offset, y + y_offset)
        self.run.statistics.points.append(point)
        return f" at {point[0]:.2f}, {point[1]:.2f}"

    def explain(self) -> None:
        """Raise what is known of a touch that failed."""
        self.check_probe_attached(self.host.after_moves())

    def advice(self) -> str:
        """Return what to look at, of a bed that is lower than it may be, too."""
        is_below = self.lowest is not None and not self.taken
        if is_below and touch.is_at(self.host, self.floor):
            zero = self.host.axes.z_zero()
            assert self.lowest is not None
            kept = self.run.earlier.kept
            remedy = heights.below_margins(
                self.settings, self.lowest, kept, zero, self.site
            )
            if remedy:
                return remedy
        place = self.site.place()
        if self.site.option:
            place += ", switch_offset"
        return self.remedy % (place,)
