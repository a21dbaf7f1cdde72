"""One command at the bed: prepare the sensor, touch with the nozzle and with the probe.

  prepare()      over the bed, prepare_gcode
  begin_at()     at another point of the bed
  touch_bed()    the nozzle, until the sensor below the bed triggers
  touch_probe()  the inductive probe over the same point, by the host's own probing
  cycle()        both

Each touch has a floor, see heights.py.  Every height is a toolhead Z in mm.  All methods
that move or touch may pause.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional, Tuple

from .. import attached, command, errors, templates, touch
from .. import pin as z_pin
from ..errors import CalibrationError, NoTrigger
from ..sampling import Series
from ..texture import spread_site, spread_tolerance
from . import heights, motors
from .heights import Expected, Floor, Result

if TYPE_CHECKING:
    from ..host.probe import ProbeSession
    from ..progress import Progress
    from ..touch import Head, Site
    from .expected import Expectations
    from .sensor import BedSensor
    from .settings import Settings

# Above this distance (mm) a way down is quick, but ready to stop.
FAR = 5.0

# Lift (mm) before the nozzle moves on over a textured plate
CLEAR_OF_PLATE = 1.0

# Piezo sensors were reported to miss touches that are slower (mm/s).
SOMETIMES_MISSED = 10.0

# What to do about samples that differ
DIFFER = (
    "clean the nozzle and check that nothing shakes the bed and that the sensor"
    " triggers in time (prepare_gcode, probe_accel)"
)

# What to do about a toolhead that is below the floor of a touch
TOO_LOW = "check probe_z_min, and that prepare_gcode leaves the toolhead above the bed"


class Run:
    """The touches of one command, and what is known of the bed so far.

    'expectations' tell where the bed is; None: whatever was changed since, nothing is
    expected.  'turn' counts the runs: the points of bed_spread are turned by it.
    """

    def __init__(
        self,
        sensor: BedSensor,
        settings: Settings,
        progress: Progress,
        expectations: Optional[Expectations],
        turn: int = 0,
    ):
        self.turn = turn
        self.host = sensor.host
        self.sensor = sensor
        self.settings = settings
        self.progress = progress
        self.expectations = expectations
        # Where the nozzle touches: there or, with a radius (mm), each time at another
        # point around it; see prepare()
        self.site: Site
        self.radius = 0.0
        self.touches = 0
        # The lowest trigger of the nozzle so far (mm), None: there was none
        self.lowest_z: Optional[float] = None
        # Where the sensor should trigger, and where it has; None: it was not touched
        self.expected: Expected = heights.NOTHING_EXPECTED
        self.sensor_z: Optional[float] = None
        # The same where the probe has seen the bed there, too
        self.agreed_z: Optional[float] = None
        # Where the probe should trigger, None: that is not known
        self.probe_z: Optional[float] = None
        # Toolhead Z that it is lifted to; it follows what the run learns
        self.travel_z = heights.travel_height(
            self.host.probing.homed_probe_z(), settings.probe_hop
        )
        # The print time (s) at which the nozzle had left the bed
        self.left_at = 0.0

    ##################################################################
    # Travel
    ##################################################################

    def lift(self) -> None:
        """Lift to the travel height, never down."""
        speed = self.settings.sampling.lift_speed
        touch.raise_to(self.host, self.travel_z, speed)

    def go_to(self, site: Site) -> None:
        """Lift, then move over a site."""
        self.lift()
        self.move(site)

    def move(self, site: Site) -> None:
        """Move over a site, as high as the toolhead is; around a dock."""
        everything = attached.of(self.host.printer)
        speed = self.settings.travel_speed
        everything.go_to(self.host, site.x, site.y, speed)

    def _rise_over(self, bed_z: float) -> None:
        """Travel over a bed that the nozzle meets at that height from now on."""
        z_offset = self.host.probing.z_offset()
        self.travel_z = bed_z + heights.hop(self.settings.probe_hop, z_offset)

    def next_point(self) -> Site:
        """Return the point of the nozzle's next touch."""
        return spread_site(self.site, self.radius, self.touches, self.turn)

    def free_nozzle(self) -> None:
        """Have no probe of a dock below the nozzle."""
        attached.of(self.host.printer).free_nozzle(self.host)

    ##################################################################
    # Preparing
    ##################################################################

    def prepare(self, site: Site, radius: float = 0.0) -> None:
        """Go to the bed and run prepare_gcode, which may move the toolhead.

        The nozzle touches within 'radius' (mm) around the site.
        """
        self.site, self.radius = site, radius
        self.go_to(site)
        self.progress.enter("prepare_gcode")
        # It goes down to where the nozzle is free, and an attached probe is not
        self.free_nozzle()
        # Relative moves do not outlive the template, also when it fails
        with self.host.gcode_state.keeping_modes():
            template = self.settings.prepare_gcode
            templates.run_template(self.host, "prepare_gcode", template)
        command.check_homed(self.host, "prepare_gcode")
        # It may have homed, too
        if self.expectations is not None:
            self.expected = self.expectations.expected()
            self.probe_z = self.expectations.probe_z()
        self.go_to(self.next_point())

    def begin_at(self, site: Site) -> None:
        """Have the next touches be at another point, where the bed is about as high."""
        self.site, self.touches, self.lowest_z = site, 0, None
        if self.sensor_z is not None:
            margin = heights.EXPECTED_MARGIN
            self.expected = heights.expect_near(self.sensor_z, margin)

    ##################################################################
    # The nozzle on the bed
    ##################################################################

    def touch_bed(self) -> float:
        """Return the height at which the bed sensor triggers, the toolhead lifted again.

        It is still on its way up: check_left() looks at the sensor.
        """
        self.progress.enter("bed sensor")
        settings = self.settings
        # Each time: prepare_gcode may have attached it, and a probe that is docked with a
        # delay is attached again
        self.free_nozzle()
        tolerance = spread_tolerance(settings.sampling.tolerance, self.radius)
        sampling = settings.sampling._replace(tolerance=tolerance)
        head = touch.Head(self.host, settings.sampling, TOO_LOW)
        with errors.about("bed sensor"):
            self._come_down(head)
            series = Series(sampling, DIFFER)
            while not series.is_complete():
                why_again = series.add(self._sample(head, sampling.retries))
                if why_again:
                    self._report_bed(why_again)
        self.sensor_z = series.result()
        self._rise_over(self.sensor_z)
        self.lift()
        self.left_at = self.host.after_moves()
        return self.sensor_z

    def check_left(self) -> None:
        """Raise CalibrationError where the sensor is triggered after the nozzle has left.

        One that stays so has not seen the bed.  The toolhead may be on its way already:
        looking only when it stands still takes longer.
        """
        with errors.about("bed sensor"):
            self.sensor.check_open(self.left_at)

    def _come_down(self, head: Head) -> None:
        """Come down to where a touch begins.

        At full current, and ready to stop where nothing was touched yet.
        """
        sampling = self.settings.sampling
        if self.lowest_z is not None:
            speed, accel = self._speed_and_accel()
            above = heights.approach(speed, accel)
            top = self.lowest_z + min(self._least_lift(), above)
            head.move_down(top, sampling.lift_speed)
        elif self.host.motion.z() > self.travel_z + FAR:
            self.sensor.check_open(self.host.after_moves())
            accel = motors.braking_accel(self.host, 0.0)
            speed = heights.fastest_touch(sampling.lift_speed, accel)
            head.come_down(self.sensor.endstop, self.travel_z, speed)

    def _least_lift(self) -> float:
        """Return how far (mm) above a trigger the nozzle is at least, where it does not touch.

        One point of a textured plate is higher than another.
        """
        lift: float = self.settings.sampling.retract_dist
        return max(lift, CLEAR_OF_PLATE) if self.radius else lift

    def _retract(self, head: Head) -> None:
        """Lift to where the next touch begins, over its point."""
        pressed_z = head.pressed_z
        if not self.radius or pressed_z is None:
            head.retract()
            return
        head.lift(pressed_z + self._least_lift())
        self.move(self.next_point())

    def _sample(self, head: Head, retries: int) -> float:
        """Return the height of one touch that is believed.

        A trigger far above the bed is none: shaking makes them.
        """
        while True:
            self._retract(head)
            z = self._touch_once(head)
            try:
                heights.check_expected(z, self.expected)
                break
            except CalibrationError as e:
                if not retries:
                    # Stuck, it says more than where it was that
                    head.retract()
                    self.sensor.check_open(self.host.after_moves())
                    raise
                self._report_bed(str(e))
                self._report_bed("trying again")
                retries -= 1
        sampling = self.settings.sampling
        tolerance = spread_tolerance(sampling.tolerance, self.radius)
        self.expected = heights.expect_again(
            z, self.lowest_z, sampling._replace(tolerance=tolerance)
        )
        self.lowest_z = self.expected.z
        self.progress.touched()
        self._report_bed(f"triggered at z={z:.6f}{self._note_point()}")
        return z

    def _note_point(self) -> str:
        """Return where a touch was, in words; empty: where all are."""
        point = self.next_point()
        self.touches += 1
        return f" at {point.x:.2f}, {point.y:.2f}" if self.radius else ""

    def _speed_and_accel(self) -> Tuple[float, float]:
        """Return those of a touch (mm/s, mm/s^2)."""
        accel = motors.braking_accel(self.host, self.settings.probe_accel)
        speed: float = self.settings.sampling.speed
        return heights.fastest_touch(speed, accel), accel

    def _touch_once(self, head: Head) -> float:
        """Touch the bed once, down to the floor; return the height of the trigger.

        The current is low only while the nozzle goes down: a motor that loses a step on the
        way up would take Z along.
        """
        sensor, settings = self.sensor, self.settings
        speed, accel = self._speed_and_accel()
        lowest = heights.above_pin(
            settings.floor, z_pin.floor(self.host, sensor.z_pin)
        )
        floor = heights.sensor_floor(lowest, self.expected, speed, accel)
        less_accel = motors.limited_accel(self.host, settings.probe_accel)
        less_current = sensor.motors.reduced(settings.z_current_factor)
        start_z = self.host.motion.z()
        try:
            with less_accel, less_current:
                # When the moves have ended: the motors settle meanwhile
                sensor.check_open(self.host.after_moves())
                return head.touch(sensor.endstop, floor.z, speed)
        except NoTrigger as e:
            remedy = self._no_trigger_remedy(speed, floor)
            raise e.advised(remedy, floor_reason=floor.why)
        except CalibrationError:
            if touch.is_at(self.host, start_z):
                sensor.check_open(self.host.after_moves())
            raise

    def _no_trigger_remedy(self, speed: float, floor: Floor) -> str:
        """Return what to do about a bed that has not triggered down to a floor."""
        slow = ""
        if speed < SOMETIMES_MISSED:
            slow = f"raise speed (piezo sensors may miss a touch at {speed:g} mm/s), "
        lower = f", or {floor.remedy}" if floor.remedy else ""
        return (
            f"{slow}check that prepare_gcode turns the sensor on, that 'pin:"
            f" {self.sensor.pin}' is the sensor's (QUERY_ENDSTOPS while you press the"
            f" bed), and that the bed is no lower{lower}"
        )

    def _report_bed(self, text: str) -> None:
        self.progress.say(f"bed sensor: {text}")

    ##################################################################
    # The probe over the same point
    ##################################################################

    def touch_probe(self, sensor_z: float) -> float:
        """Return the height at which the probe triggers above the bed.

        'sensor_z' is where the nozzle meets that: a probe triggers above it.
        """
        settings = self.settings
        z_offset = self.host.probing.offsets()[2]
        floor = heights.probe_floor(sensor_z, z_offset)
        head = touch.Head(self.host, settings.sampling, TOO_LOW)
        speed = f"{settings.sampling.speed:.6f}"
        top = self.host.motion.z()
        with errors.about("probe"), touch.probing(
            head, floor.z, top, PROBE_SPEED=speed
        ) as session:
            self._come_down_with_probe(head, floor.z)
            series = Series(settings.sampling, DIFFER)
            while not series.is_complete():
                z = self._probe_once(head, session, floor)
                self.progress.touched()
                self._report_probe(f"triggered at z={z:.6f}")
                why_again = series.add(z)
                if why_again:
                    self._report_probe(why_again)
        self.probe_z = series.result()
        return self.probe_z

    def _come_down_with_probe(self, head: Head, floor_z: float) -> None:
        """Come down quickly to where a touch begins.

        Through air: the nozzle has just touched the bed lower down.
        """
        if self.probe_z is not None:
            sampling = self.settings.sampling
            accel = motors.braking_accel(self.host, 0.0)
            above = heights.approach(sampling.speed, accel)
            top = max(floor_z, self.probe_z) + above
            head.move_down(top, sampling.lift_speed)

    def _probe_once(
        self, head: Head, session: Optional[ProbeSession], floor: Floor
    ) -> float:
        """Touch once with the probe; return the height of the trigger.

        A probe that goes down to the bed is dead, or that was not the bed.
        """
        head.retract()
        head.check_above(floor.z)
        try:
            return head.probe_bed(session, floor.z)
        except CalibrationError as e:
            if e.remedy or not touch.is_at(self.host, floor.z):
                raise e.advised(touch.CHECK_PROBE)
            error = NoTrigger(
                f"{e} {floor.why}: that was not the bed, or the probe does not see it"
            )
            raise error.advised(touch.CHECK_PROBE)

    def _report_probe(self, text: str) -> None:
        self.progress.say(f"probe: {text}")

    ##################################################################
    # Both, and Z set by the sensor
    ##################################################################

    def cycle(self, probe_site: Site) -> Result:
        """Touch with the nozzle, then with the probe over the same point; return the result."""
        self.go_to(self.next_point())
        sensor_z = self.touch_bed()
        self.progress.enter("probe")
        self.move(probe_site)
        self.check_left()
        probe_z = self.touch_probe(sensor_z)
        self.lift()
        # It is the nozzle that goes down next, whatever command does it
        attached.of(self.host.printer).settle(self.host)
        self.agreed_z = sensor_z
        probe_z_offset = self.host.probing.offsets()[2]
        return heights.result_of(
            sensor_z, probe_z, probe_z_offset, self.settings.z_offset
        )

    def set_z(self, z: float) -> None:
        """Have Z be z_offset where the sensor has triggered, at z, from here on.

        Last, so that nothing can fail when Z=0 is another one.
        """
        z_offset = self.settings.z_offset
        position = self.host.toolhead.get_position()
        position[2] += z_offset - z
        self.host.toolhead.set_position(position)
        self.sensor_z = z_offset
        self._rise_over(z_offset)
