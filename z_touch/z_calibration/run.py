"""One run of a calibration: nozzle, switch and bed are touched in turn.

Each place is approached at the travel height, which follows what the run learns: first from
what earlier runs say, then from the nozzle, then from the switch.  No touch goes below its
floor, see heights.py.

  nozzle   ->   before_switch_gcode   ->   switch   ->   bed
    |                                        |
    |  samples differ, or the first one      |  nothing is known of the probe, or
    |  is higher: cleaned once               |  nothing down to where it should be:
    +-> nozzle                               |  one touch of the bed tells how long
                                             +-> the probe is, then the switch again

Every height is a toolhead Z in mm.  All methods that touch may pause.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, List, Optional, Tuple

from .. import touch
from ..errors import CalibrationError, NoTrigger
from . import heights
from .heights import Kept, Result
from .place import BedPlace, NozzlePlace, SwitchPlace
from .runs import BODY, Warned
from .shifts import check_unknown
from .sites import SiteFinder

if TYPE_CHECKING:
    from ..datum import HomedDatum
    from ..host.printer import Host
    from ..progress import Progress
    from .pin import PressedPin
    from .settings import Settings
    from .sites import Sites
    from .statistics import RunStatistics
    from .user_gcode import UserGcode

# From here on (mm) the nozzle is too far from the height that Z was homed at.
STALE_Z = 0.5

# From here on (target, degrees C) plastic oozes out of the nozzle while it is measured.  PETG
# and ABS are soft from some 150 on.
OOZES_FROM = 180.0

# Of switch - nozzle: from here on (mm) a difference to the last run is not noise or heat,
# but another nozzle or probe.
ANOTHER = 0.5


@dataclass(frozen=True)
class Earlier:
    """What earlier runs say to one that begins.

    The last good result with this extruder in this session, None without one; whether Z=0 is
    still where it was in that run; what of the last good run holds for all later ones, None:
    there was none.  Of the try before: the height of the nozzle and switch - nozzle (mm), None:
    this is the first, or that was not measured.
    """

    last: Optional[Result] = None
    holds: bool = False
    kept: Optional[Kept] = None
    nozzle: Optional[float] = None
    body: Optional[float] = None


class CalibrationRun:
    """The touches of one run, and what was seen in it so far."""

    def __init__(
        self,
        host: Host,
        settings: Settings,
        sites: Sites,
        pin: PressedPin,
        statistics: RunStatistics,
        progress: Progress,
        homed: HomedDatum,
        proved: List[Tuple[float, float]],
        reports_places: bool = True,
    ):
        self.host = host
        self.settings = settings
        self.sites = sites
        self.pin = pin
        self.statistics = statistics
        self.progress = progress
        self.homed = homed
        # Where (X and Y, mm) the pin was touched with the probe attached; this run adds its own
        self.proved = proved
        # Whether each place is shown on the console when it is done
        self.reports_places = reports_places
        self.warnings: List[Warned] = []
        # What the host adds to what the probe says on the bed, for a twisted axis
        self.twist = 0.0
        # What something that is not known adds to Z over the pin; None: it was not there
        self.unknown_over_pin: Optional[float] = None
        # Where (X and Y, mm) the nozzle has touched the pin with the probe attached
        self.proved_at: Optional[Tuple[float, float]] = None
        # Whether the probe was seen attached
        self.was_attached = False
        # How hot (degrees C) the nozzle was when it was touched, None: it was not yet
        self.nozzle_celsius: Optional[float] = None
        # Why the nozzle was cleaned in this run; empty: it was not
        self.cleaned = ""
        # The height of the nozzle and switch - nozzle (mm), None: not measured; by how much the
        # latter departs from earlier runs that were as hot
        self.nozzle: Optional[float] = None
        self.body: Optional[float] = None
        self.departure = 0.0
        self.know(Earlier())

    def know(self, earlier: Earlier) -> None:
        """Begin with what earlier runs say; Z=0 may be moved until then."""
        self.earlier = earlier
        self.rise_over(self.expected_nozzle())

    def rise_over(self, pin_z: Optional[float]) -> None:
        """Have the travel height follow what is known of the pin, None: nothing.

        The toolhead is lifted to it later.
        """
        last = self.earlier.last
        body = None
        if last is not None and self.earlier.holds:
            body = last.switch - last.nozzle
        self.travel_z = heights.travel_height(self.settings, pin_z, body)

    def lift(self) -> None:
        """Lift to the travel height, never down."""
        speed: float = self.settings.on_pin.lift_speed
        touch.raise_to(self.host, self.travel_z, speed)

    def warn(self, about: str, text: str) -> None:
        """Show something odd, once for all samples.

        'about' is a place, or BODY.
        """
        warned = Warned(about, text)
        if warned not in self.warnings:
            self.warnings.append(warned)
            self.progress.say(text)

    def uncertainty(self) -> Optional[float]:
        """Return what the offset may be off by (mm, 95 %), None: not known.

        What switch - nozzle departs by may be nothing, or all wrong.
        """
        uncertainty = self.statistics.uncertainty()
        if uncertainty is None:
            return None
        return uncertainty + abs(self.departure)

    def check_probe_attached(self) -> None:
        """Raise CalibrationError unless the probe is attached; lift one that is pressed."""
        if self.host.probing.reads_triggered(self.host.after_moves()):
            # A PROBE leaves it pressed on the bed
            self.lift()
            self._switch().check_probe_attached(self.host.after_moves())

    ##################################################################
    # Nozzle
    ##################################################################

    def expected_nozzle(self) -> Optional[float]:
        """Return where the nozzle should meet the pin, None: not known."""
        earlier = self.earlier
        if (
            self.settings.position_endstop is None
            and earlier.nozzle is not None
        ):
            return earlier.nozzle
        return heights.expect_nozzle(self.settings, earlier.last, earlier.holds)

    def nozzle_floor(self) -> float:
        """Return where the nozzle's touch ends at the latest."""
        floor = heights.nozzle_floor(self.settings, self.expected_nozzle())
        nozzle = self.sites.nozzle
        point = (nozzle.x, nozzle.y) if nozzle else None
        return heights.floor_over(self.settings, floor, point)

    def touch_nozzle(self, cleaner: Optional[UserGcode] = None) -> float:
        """Touch the pin with the nozzle; return its height.

        Where its touches do not agree, 'cleaner' cleans it once, and it is touched again;
        None: it is not cleaned.
        """
        why, nozzle_z = "", None
        may_clean = cleaner and cleaner.can_clean and not self.cleaned
        try:
            nozzle_z = self.sample_nozzle()
        except CalibrationError:
            if not (may_clean and self.statistics.differed):
                raise
        why = self.statistics.doubt("nozzle")
        if nozzle_z is None or (may_clean and why):
            assert cleaner is not None
            self.progress.say(f"nozzle: {why}; cleaning it, then once more")
            self.clean(cleaner, why)
            nozzle_z = self.sample_nozzle()
        self.nozzle_celsius = self.host.nozzle_celsius()
        self._warn_of_nozzle(nozzle_z)
        self.rise_over(nozzle_z)
        return nozzle_z

    def clean(self, cleaner: UserGcode, why: str) -> None:
        """Have clean_gcode clean the nozzle, and note why."""
        self.cleaned = why
        self.lift()
        cleaner.clean()

    def sample_nozzle(self) -> float:
        """Touch the pin with the nozzle, whatever its touches say; return its height."""
        self.progress.enter("nozzle")
        assert self.sites.nozzle is not None
        place = NozzlePlace(self, self.sites.nozzle, self.settings.on_pin)
        expected_z, floor = self.expected_nozzle(), self.nozzle_floor()
        return place.measure(self.travel_z, expected_z, floor)

    def oozing(self) -> str:
        """Return what to do about a nozzle that is too hot to be measured, empty: it is not."""
        target = self.host.nozzle_target()
        if target <= OOZES_FROM:
            return ""
        return (
            f"at {target:.0f} C plastic oozes out of the nozzle: heat it to about 150 C"
            " for CALIBRATE_Z, and to printing temperature afterwards"
        )

    def _warn_of_nozzle(self, nozzle_z: float) -> None:
        """Warn of a nozzle that is dirty, or far from where Z was homed on the pin."""
        flattened = self.statistics.flattened("nozzle")
        if flattened:
            remedy = self.oozing() or (
                "clean it before CALIBRATE_Z, or set clean_gcode"
            )
            self.warn(
                "nozzle",
                f"nozzle: {flattened}: something that sticks to it is pressed flat;"
                f" {remedy}",
            )
        homed_z = self.settings.position_endstop
        if homed_z is not None and abs(nozzle_z - homed_z) > STALE_Z:
            self.warn(
                "nozzle",
                f"nozzle: z={nozzle_z:.3f} is far from position_endstop {homed_z:.3f}, at"
                f" which Z was homed; {heights.HOME_AGAIN}",
            )

    ##################################################################
    # Switch
    ##################################################################

    def _switch(self) -> SwitchPlace:
        assert self.sites.switch is not None
        return SwitchPlace(self, self.sites.switch, self.settings.on_pin)

    def switch_floor(
        self,
        nozzle_z: float,
        expected_z: Optional[float],
        kept: Optional[Kept],
    ) -> float:
        """Return where the body's touch ends at the latest.

        'kept' is what of an earlier run holds for this one, None: nothing.
        """
        settings = self.settings
        floor = heights.switch_floor(settings, nozzle_z, expected_z, kept)
        point = None
        if self.sites.switch is not None:
            finder = SiteFinder(self.host, settings)
            point = finder.bed_point(self.sites.switch)
        below = heights.least_body(settings)
        return heights.floor_over(settings, floor, point, below)

    def touch_switch(self, nozzle_z: float) -> float:
        """Touch the pin with the body of the probe's switch; return its height."""
        self.progress.enter("switch")
        place = self._switch()
        last = self.earlier.last
        expected_z = heights.expect_switch(self.settings, nozzle_z, last)
        if self.earlier.body is not None:
            expected_z = nozzle_z + self.earlier.body
        floor = self.switch_floor(nozzle_z, expected_z, self.earlier.kept)
        if expected_z is None:
            floor = self._floor_from_bed(nozzle_z, floor)
        try:
            return place.measure(self.travel_z, expected_z, floor)
        except NoTrigger as e:
            if expected_z is None or place.taken:
                raise
            floor = self._lower_floor(nozzle_z, floor, e)
        return place.measure(self.travel_z, None, floor)

    def _lower_floor(
        self, nozzle_z: float, floor: float, error: NoTrigger
    ) -> float:
        """Return a lower floor where nothing has triggered down to one.

        That came from z_offset, or from a probe that may have been exchanged: the bed tells
        whether it was wrong, or the switch is dead.  Raises 'error' again where the floor
        cannot be lower.
        """
        self.progress.say(str(error))
        self.progress.say("looking at the bed how long the probe is")
        hard = heights.switch_floor(self.settings, nozzle_z, None)
        try:
            lowest = max(self._lowest_switch(nozzle_z), hard)
        except CalibrationError as e:
            self.progress.say(str(e))
            raise error
        if lowest >= floor:
            raise error
        return lowest

    def _floor_from_bed(self, nozzle_z: float, hard: float) -> float:
        """Return the floor where nothing is known of the probe.

        The bed tells how long it is before its body goes down where it may meet something
        else than the pin.
        """
        try:
            lowest = self._lowest_switch(nozzle_z)
        except NoTrigger as e:
            self.progress.say(str(e))
            self.progress.say(f"searching for the switch down to z={hard:.3f}")
            return hard
        return max(self.switch_floor(nozzle_z, None, None), lowest)

    def _lowest_switch(self, nozzle_z: float) -> float:
        """Return the lowest height of the body, by one touch of the bed.

        Raises NoTrigger where that cannot be found.
        """
        settings = self.settings
        floor = heights.unmeasured_bed_floor(settings, nozzle_z)
        if floor >= self.travel_z:
            raise NoTrigger(
                "bed: with offset_margins this wide the nozzle may meet it"
                f" first, below z={floor:.3f}"
            )
        assert self.sites.bed is not None
        place = BedPlace(self, self.sites.bed, settings.on_bed)
        bed_z = place.look(self.travel_z, floor)
        kept = self.earlier.kept
        return heights.lowest_switch(settings, nozzle_z, bed_z, kept)

    ##################################################################
    # switch - nozzle against earlier runs
    ##################################################################

    # An exchanged nozzle is what the module is for; dirt, or a probe that is seated badly,
    # looks the same.

    def is_another_probe(self, body: float) -> bool:
        """Return whether switch - nozzle is that of another nozzle or probe."""
        last = self.earlier.last
        if last is None:
            return False
        return abs(body - (last.switch - last.nozzle)) > ANOTHER

    def why_departed(self) -> str:
        """Return why the nozzle is to be cleaned before all is measured again."""
        return f"switch - nozzle is {self.departure:.3f} mm off earlier runs that were as hot"

    def warn_of_body(self, body: float) -> None:
        """Warn where switch - nozzle is another one than in earlier runs."""
        last = self.earlier.last
        if last is not None and self.is_another_probe(body):
            self.warn(
                BODY,
                f"switch - nozzle is {body:.3f} mm and was"
                f" {last.switch - last.nozzle:.3f} mm in the last good run; if neither"
                " nozzle nor probe was exchanged, check how the probe is seated and that"
                " the nozzle is tight",
            )
        elif self.departure:
            remedy = (
                self.oozing() or "clean the nozzle and run CALIBRATE_Z again"
            )
            self.warn(
                BODY,
                f"switch - nozzle is {body:.3f} mm and was"
                f" {body - self.departure:.3f} mm in earlier runs that were as hot: the"
                " nozzle is dirty, or was exchanged, or the probe is not seated;"
                f" {remedy}",
            )

    ##################################################################
    # Bed
    ##################################################################

    def bed_floor(self, nozzle_z: float, switch_z: float) -> float:
        """Return where the probe's touch ends at the latest."""
        kept = self.earlier.kept
        return heights.bed_floor(self.settings, nozzle_z, switch_z, kept)

    def touch_bed(self, nozzle_z: float, switch_z: float) -> float:
        """Touch the bed with the probe; return its height."""
        self.progress.enter("bed")
        settings, earlier = self.settings, self.earlier
        expected_z = heights.expect_bed(
            settings, nozzle_z, switch_z, earlier.last
        )
        self.travel_z = heights.travel_height_to_bed(
            settings, nozzle_z, switch_z
        )
        lowest, _ = heights.possible_offsets(settings, nozzle_z, earlier.kept)
        assert self.sites.bed is not None
        place = BedPlace(self, self.sites.bed, settings.on_bed, lowest)
        floor = self.bed_floor(nozzle_z, switch_z)
        return place.measure(self.travel_z, expected_z, floor)

    def check_unknown_over_bed(self) -> None:
        """Raise CalibrationError where something adds another height here than over the pin."""
        if self.unknown_over_pin is not None:
            over_bed = self.host.transforms.unknown_here()
            check_unknown(self.unknown_over_pin, over_bed)
