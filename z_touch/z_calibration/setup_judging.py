"""What Z_CALIBRATION_SETUP judges: hands, touches, a sheet of paper.  Pure.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple

from .. import touch
from ..errors import CalibrationError
from ..sampling import AUTO, accuracy
from ..touch import Site
from .settings import Settings
from .statistics import impossible
from .switches import COME_DOWN, SWITCHES

# The first touches of a site: at most so fast (mm/s), and so many
SLOW_SPEED = 2.0
FIRST_TOUCHES = 5

# The switch_offset (mm) by which floors are calculated until it is known
USUAL_SWITCH_OFFSET = 0.5

# By jogging nothing comes nearer (mm) to the pin, nor to where it may be as long as
# its height is not known.
CLEAR_OF_PIN = 1.0
CLEAR_OF_UNKNOWN_PIN = 3.0

# A site nearer (mm) than this to dock_position is in the dock
DOCK_NEAR = 15.0

# A sheet of paper is so thick (mm)
PAPER = 0.1
# Larger steps (mm) end above the highest bed that there may be.
SMALL_STEP = 0.1

# From the body to the trigger point (mm): more than any switch has, and less than any
# healthy one
LARGEST_SWITCH_OFFSET = 1.5
SMALLEST_SWITCH_OFFSET = 0.1

# What the offset should vary by at most (mm, 95 %), and the touches that a site
# has at least and at most
WANTED_UNCERTAINTY = 0.01
FEWEST_SAMPLES = 3
MOST_SAMPLES = 10


def inverted(pin: str) -> str:
    """Return the text of an option with the other polarity of its MCU pin."""
    pin = pin.strip()
    if "!" in pin:
        return pin.replace("!", "", 1)
    marks = len(pin) - len(pin.lstrip("^~ "))
    return f"{pin[:marks]}!{pin[marks:]}"


def slow_settings(settings: Settings) -> Settings:
    """Return the settings, but slow, for the first touches."""
    if settings.switch_offset is None:
        settings = settings.replace(switch_offset=USUAL_SWITCH_OFFSET)
    speed = min(SLOW_SPEED, settings.on_pin.speed)
    on_pin, on_bed = (
        sampling._replace(
            samples=FIRST_TOUCHES,
            tolerance=float("inf"),
            result="median",
            speed=speed,
        )
        for sampling in (settings.on_pin, settings.on_bed)
    )
    return settings.replace(
        probing_speed=min(settings.probing_speed, 2.0 * SLOW_SPEED),
        probing_first_fast=False,
        # Texture would look like a switch that varies
        bed_spread=0.0,
        # An attached probe may be another one than before: it is looked for each time
        may_attach_late=True,
        samples=None,
        on_pin=on_pin,
        on_bed=on_bed,
    )


def jog_floor(pin_z: Optional[float], below: float) -> float:
    """Return how low (toolhead Z, mm) the toolhead may be moved by hand.

    pin_z: the pin is not above it; None: its height is not known. below: how far
    (mm) the probe reaches below the nozzle.
    """
    if pin_z is None:
        return below + CLEAR_OF_UNKNOWN_PIN
    return max(pin_z, 0.0) + below + CLEAR_OF_PIN


def repeatability(samples: Sequence[Sequence[float]]) -> Tuple[str, int]:
    """Say how well touches (mm) repeat, and how many a site should have."""
    worst = max(accuracy(z)[5] for z in samples if z)
    # Three sites, and each is averaged
    needed = 3.0 * (2.0 * worst / WANTED_UNCERTAINTY) ** 2
    count = max(FEWEST_SAMPLES, min(MOST_SAMPLES, math.ceil(needed)))
    if needed > MOST_SAMPLES:
        return "poor, so clean the nozzle and look for play", count
    word = "good" if needed <= FEWEST_SAMPLES else "fair"
    return f"{word}; {count} touches of each place are enough", count


def is_near(a: Site, b: Site) -> bool:
    """Say whether two sites are the same."""
    return math.hypot(a.x - b.x, a.y - b.y) <= touch.SAME_SITE


def check_dock(site: Site, dock_position: str) -> None:
    """Raise CalibrationError where a site is in the dock.

    dock_position: text of the option, X and Y first (mm); empty: there is no dock.
    """
    parts = dock_position.split(",")[:2]
    dock = [float(part) for part in parts if part.strip()]
    if len(dock) < 2:
        return
    apart = math.hypot(site.x - dock[0], site.y - dock[1])
    if apart < DOCK_NEAR:
        raise CalibrationError(
            f"{site.origin} is {apart:.1f} mm from the dock; choose one at least"
            f" {DOCK_NEAR:g} mm away"
        )


######################################################################
# The sheet of paper.  contact, z: toolhead Z (mm), see setup.Found.contact()
######################################################################


def paper_room(contact: float, z: float) -> float:
    """Return by how much (mm) the nozzle is above where it may hold the sheet."""
    return z - (contact + PAPER)


def is_too_high(contact: float, z: float) -> bool:
    """Say that nothing can be held there: every switch moves before it triggers."""
    return round(paper_room(contact, z), 3) >= 0.0


def from_paper(contact: float, z: float) -> float:
    """Return the switch_offset (mm) with the nozzle at z where it holds the sheet.

    Raises CalibrationError where it cannot, or where no switch moves so far.
    """
    switch_offset = round(-paper_room(contact, z), 3)
    if is_too_high(contact, z):
        raise CalibrationError(
            f"still too high, by {abs(switch_offset):.3f} mm at least: the nozzle"
            " cannot hold the sheet yet; lower it"
        )
    if switch_offset > LARGEST_SWITCH_OFFSET:
        raise CalibrationError(
            f"the switch would move by {switch_offset:.3f} mm, and none by more than"
            f" {LARGEST_SWITCH_OFFSET:g} mm; check that the nozzle holds the sheet"
            " and that the pin presses the body"
        )
    return switch_offset


def paper_floor(contact: float, z: float, distance: float) -> float:
    """Return the lowest z (mm) of a jog by a distance (mm) with the sheet.

    Above all beds there may be only small steps lead down to it.
    """
    if distance < -SMALL_STEP - 1e-6 and z + distance < contact + PAPER:
        return min(z, contact + PAPER)
    return contact - LARGEST_SWITCH_OFFSET


def too_small(switch_offset: float) -> str:
    """Say that no healthy switch has that switch_offset (mm); empty: one may."""
    if switch_offset >= SMALLEST_SWITCH_OFFSET:
        return ""
    return (
        f"{switch_offset:.3f} mm is less than any healthy switch moves: did the"
        " nozzle hold the sheet? If not, Z=0 is too high; 'Back', then 'Paper'."
    )


def of_a_list(kind: str) -> str:
    """Say what a switch of the list means for Z=0; empty: it was measured."""
    if not kind:
        return ""
    return (
        f"With the {SWITCHES[kind]:.1f} mm of any {kind} Z=0 is too high on purpose:"
        f" {COME_DOWN}."
    )


def proposed_samples(settings: Settings, step: float, count: int) -> str:
    """Return what samples should be where so many touches of each place are enough.

    Empty: as it is.  A user who has set enough of them keeps his.  'step' is that of the
    motors of Z (mm).
    """
    fewest = min(settings.on_pin.samples, settings.on_bed.samples)
    is_exceeded = not settings.is_auto and fewest < count
    if "samples" in settings.given and not is_exceeded:
        return ""
    if not impossible(settings.target_uncertainty, step):
        return AUTO
    return str(count) if is_exceeded else ""
