"""One place to touch: travel, come down, touch down to a floor, come up again.

Every height is a toolhead Z: the position, in mm and in the frame that the last homing
defined, at which a touch triggered.  G-code offset, bed mesh and skew play no part in it.
Up is positive.  Speeds are in mm/s.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import math
from typing import (
    TYPE_CHECKING,
    Any,
    Iterator,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Type,
)

from .command import always
from .errors import CalibrationError, NoTrigger, TouchedWrong
from .host.toolhead import has_no_trigger, was_not_heard

if TYPE_CHECKING:
    from .host.klippy import Config, Endstop
    from .host.printer import Host
    from .host.probe import Probed, ProbeSession
    from .sampling import Sampling

# What to do about a board that was not heard
LATE = (
    "a board was not heard in time, as the computer or the line to it is too"
    " slow or broken; run it again, and look into klippy.log if it comes back"
)

# What to do about a touch by the host's own probing
CHECK_PROBE = "check the probe with QUERY_PROBE and PROBE"

# Nothing down to where a touch ends
NO_ANSWER = "the switch did not answer"

# A trigger this close (mm) to the start is none: the sensor was pressed.
# Less than any microstep is long, more than rounding.
NO_TRAVEL = 0.0001

# What to do where the toolhead does not get to a point that is the user's choice
CHOOSE_ANOTHER = "choose a point that it can reach"

# A move that follows on others in time is told to the host so long (s) before they
# end: BUFFER_TIME_START of its toolhead.py, 0.25 s, and some for the answer of a switch
MOVE_START = 0.3

# A toolhead so near (mm) to a site is over it
SAME_SITE = 0.01


######################################################################
# Where to touch
######################################################################


class Site(NamedTuple):
    """Something to touch.

    name is the word used in messages, x and y (mm) where the toolhead stands for it, origin
    where the user has said so, in words, and option the option or parameter for that.
    """

    name: str
    x: float
    y: float
    origin: str
    option: str = ""

    def place(self) -> str:
        """Return what to check where the toolhead does not stand as it should."""
        return self.option or f"the place of the {self.name}"


def option_site(
    config: Config, name: str, option: str, pair: Sequence[float]
) -> Site:
    """Return the site of an option that is a point (mm)."""
    x, y = pair
    section = config.get_name()
    origin = f"Option '{option}: {x:g},{y:g}' in section '{section}'"
    return Site(name, x, y, origin, option)


def rounded(x: float, y: float) -> Tuple[float, float]:
    """Return coordinates (mm) that add up to the end of an axis, not beyond it."""
    return round(x, 6), round(y, 6)


def probe_site(host: Host, bed: Optional[Site]) -> Optional[Site]:
    """Return where the toolhead stands for the probe to touch a point of the bed.

    'bed' has that point (mm); None: the zero of the bed mesh is taken.  None is returned
    where the mesh has none.
    """
    if bed is None:
        zero = host.transforms.mesh_zero()
        if zero is None:
            return None
        option = "zero_reference_position of section 'bed_mesh'"
        origin = "The zero reference position of section 'bed_mesh'"
        bed = Site("bed", zero[0], zero[1], origin, option)
    x_offset, y_offset = host.probing.offsets()[:2]
    x, y = rounded(bed.x - x_offset, bed.y - y_offset)
    return bed._replace(x=x, y=y)


def check_reach(host: Host, site: Site, remedy: str, shift: str = "") -> None:
    """Raise CalibrationError where the toolhead does not reach a site.

    'shift' says why the toolhead is elsewhere than the user's point.
    """
    for axis, xy, (low, high) in zip("XY", site[1:3], host.axes.limits()):
        if not low <= xy <= high:
            raise CalibrationError(
                f"{site.origin} needs the toolhead at {axis}={xy:.3f}{shift}, outside its"
                f" {low:.3f} to {high:.3f}; {remedy}"
            )


def check_spread(
    host: Host,
    site: Site,
    radius: float,
    section: str,
    remedy: str = "choose a smaller one, or another bed_xy_position",
) -> None:
    """Raise CalibrationError where not all points of a bed_spread (mm) can be reached.

    'section' is the one whose option it is.
    """
    if not radius:
        return
    origin = f"Option 'bed_spread: {radius:g}' in section '{section}'"
    for x, y in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        edge = site._replace(
            x=site.x + x * radius, y=site.y + y * radius, origin=origin
        )
        check_reach(host, edge, remedy)


######################################################################
# Travel
######################################################################


def is_near(host: Host, z: float, there: float) -> bool:
    """Return whether Z is there, as near as motors stop that make whole steps."""
    return abs(z - there) <= 2.0 * host.axes.z_step()


def is_at(host: Host, z: float) -> bool:
    """Return whether the toolhead stands at a height (mm)."""
    return is_near(host, host.motion.z(), z)


def is_over(host: Host, site: Site) -> bool:
    """Return whether the toolhead stands over a site."""
    here = host.toolhead.get_position()
    return max(abs(here[0] - site.x), abs(here[1] - site.y)) <= SAME_SITE


def raise_to(host: Host, z: float, speed: float) -> None:
    """Lift to z (mm): never down, and not where Z is not homed (any more)."""
    if host.motion.z() < z and host.is_homed("z"):
        host.toolhead.manual_move([None, None, z], speed)


def move_xy(host: Host, x: float, y: float, speed: float) -> None:
    """Move straight to X and Y (mm), as high as the toolhead is."""
    if tuple(host.toolhead.get_position()[:2]) != (x, y):
        host.toolhead.manual_move([x, y], speed)


def move_xyz(
    host: Host,
    place: Tuple[float, float, Optional[float]],
    speed: float,
    lift_speed: float,
) -> None:
    """Move straight to X, Y and Z (mm); Z None: as high as it is.

    At 'speed' in the plane and 'lift_speed' up or down, whichever takes longer.
    """
    x, y, z = place
    here = host.toolhead.get_position()
    up = 0.0 if z is None else abs(z - here[2])
    if not up:
        move_xy(host, x, y, speed)
        return
    flat = math.hypot(x - here[0], y - here[1])
    seconds = max(flat / speed, up / lift_speed)
    host.toolhead.manual_move([x, y, z], math.hypot(flat, up) / seconds)


def before_arrival(host: Host, begun: float) -> float:
    """Return the print time to look at a switch while the toolhead is still on its way.

    Late, but the next move begins in time.  Not before 'begun', a print time.  May pause.
    """
    return max(begun, host.after_moves() - MOVE_START)


######################################################################
# Touching
######################################################################


class Head:
    """The toolhead at one place, and whether it still presses what it has touched.

    'remedy' says what to do where it is too low for a touch.  All methods that move may
    pause.
    """

    def __init__(self, host: Host, sampling: Sampling, remedy: str):
        self.host = host
        self.sampling = sampling
        self.remedy = remedy
        # Where the last touch triggered; None: it was lifted since
        self.pressed_z: Optional[float] = None

    def come_down(
        self, endstop: Endstop, z: float, speed: float
    ) -> Optional[float]:
        """Come down to z where nothing should be yet.

        Returns None, or the toolhead Z where the endstop triggered nevertheless.
        """
        if self.host.motion.z() <= z:
            return None
        try:
            return self._move_down(endstop, z, speed)
        except NoTrigger:
            return None

    def touch(self, endstop: Endstop, floor: float, speed: float) -> float:
        """Move down until the endstop triggers; return the toolhead Z of the trigger.

        Raises NoTrigger at the floor.
        """
        self.check_above(floor)
        return self._move_down(endstop, floor, speed)

    def _move_down(self, endstop: Endstop, z: float, speed: float) -> float:
        host, start_z = self.host, self.host.motion.z()
        try:
            trigger_z = host.motion.probing_move(endstop, z, speed)
        except host.printer.command_error as e:
            if host.printer.is_shutdown():
                raise
            is_missing = has_no_trigger(e)
            kind = (
                NoTrigger if is_missing and is_at(host, z) else CalibrationError
            )
            # The host calls whatever is touched a probe
            probing = host.probing
            is_probe = endstop in (probing.endstop(), probing.bare_endstop())
            text = NO_ANSWER if is_missing and not is_probe else str(e)
            raise self._stopped(e, kind, text)
        return self._pressed(start_z, trigger_z, trigger_z)

    def probe(self, session: ProbeSession) -> Probed:
        """Move down until the host's own probing has triggered, see probing()."""
        host, start_z = self.host, self.host.motion.z()
        try:
            probed = session.touch()
        except host.printer.command_error as e:
            if host.printer.is_shutdown():
                raise
            is_missing = has_no_trigger(e)
            kind = TouchedWrong if is_missing else CalibrationError
            raise self._stopped(e, kind, str(e))
        # QIDI's hosts answer a probe that is pressed already with a result
        self._pressed(start_z, host.motion.z(), probed.z)
        return probed

    def probe_bed(self, session: Optional[ProbeSession], floor: float) -> float:
        """Move down until the probe has triggered; return the toolhead Z as G28 sees it.

        By the host's own probing, which ends at 'floor'.  session None: on a host that cannot
        be told the floor by the switch alone, as its probing would go on to position_min.
        """
        probing = self.host.probing
        if session is not None:
            return probing.homed_z(self.probe(session))
        return self.touch(probing.endstop(), floor, self.sampling.speed)

    def _stopped(
        self, error: Exception, kind: Type[CalibrationError], text: str
    ) -> CalibrationError:
        # Without the sign of a rounded zero
        z = round(self.host.motion.z(), 3) + 0.0
        text = f"{text} (stopped at z={z:.3f})"
        if was_not_heard(error):
            # Nothing about the sensor or its place
            return CalibrationError(text).advised(LATE)
        return kind(text)

    def check_above(self, floor: float) -> None:
        """Raise CalibrationError where a touch would not go down."""
        z = self.host.motion.z()
        if z <= floor:
            raise CalibrationError(
                f"the toolhead is at z={z:.3f}, this touch ends at z={floor:.3f} already;"
                f" {self.remedy}"
            )

    def _pressed(self, start_z: float, end_z: float, trigger_z: float) -> float:
        if start_z - end_z <= NO_TRAVEL:
            raise CalibrationError(
                f"triggered at z={start_z:.3f} before the toolhead moved: the sensor was"
                " pressed or is not attached"
            )
        self.pressed_z = trigger_z
        return trigger_z

    def move_down(self, z: float, speed: float) -> None:
        """Come down to z in the air above what was touched before."""
        if self.host.motion.z() > z:
            self.host.toolhead.manual_move([None, None, z], speed)

    def use_lift(self, distance: float) -> None:
        """Have retract() lift by that (mm) from now on."""
        self.sampling = self.sampling._replace(retract_dist=distance)

    def retract(self) -> None:
        """Lift to where the next touch begins."""
        if self.pressed_z is not None:
            self.lift(self.pressed_z + self.sampling.retract_dist)

    def lift(self, z: float) -> None:
        """Lift to z (mm), never down."""
        self.pressed_z = None
        raise_to(self.host, z, self.sampling.lift_speed)


@contextlib.contextmanager
def probing(
    head: Head, floor: float, top: float, **params: str
) -> Iterator[Optional[ProbeSession]]:
    """Begin a session of the host's own probing that ends each touch at 'floor'.

    The toolhead is lifted to 'top' before it ends: the host may stow or dock the probe then.
    Yields the session for Head.probe(), or None where the host cannot be told the floor.
    """
    host = head.host
    # One by one: what is wanted of several is looked at between them
    session: Any = host.probing.start({**params, "SAMPLES": "1"})
    # An error inside activate_gcode makes the host end the session by itself;
    # ending it again is then an error that must not be shown.
    ending = always(host, session.end, "ending the probe session")
    lifting = always(host, lambda: head.lift(top), "lifting")
    with ending, host.probing.floor(floor) as is_limited, lifting:
        yield session if is_limited else None
