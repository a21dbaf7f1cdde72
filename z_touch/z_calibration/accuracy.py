"""What CALIBRATE_Z_ACCURACY and PROBE_Z_ACCURACY are asked for, and their figures.

Where the spread is the question, no touch is taken again.  What the figures are of is
found by z_touch/report.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Dict, Iterator, List, Sequence

from .. import options
from .runs import SITES, Cycle, offsets, uncertainty
from .statistics import MOST

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand
    from ..sampling import Sampling
    from .settings import Settings

# Cycles of CALIBRATE_Z_ACCURACY, at most
MOST_CYCLES = 200

# Touches of each place in a cycle, where their number is not given
CYCLE_SAMPLES = 3


@dataclass(frozen=True)
class CycleParams:
    """Parameters of CALIBRATE_Z_ACCURACY.

    How many cycles, and whether the probe is attached and Z homed in each.
    """

    cycles: int
    attach: bool
    home: bool


def cycle_params(gcmd: GCodeCommand) -> CycleParams:
    """Read the parameters; raises the command's error."""
    cycles = options.param_int(gcmd, "CYCLES", 10, minval=2, maxval=MOST_CYCLES)
    attach = bool(options.param_int(gcmd, "ATTACH", 1))
    home = bool(options.param_int(gcmd, "HOME", 0))
    if home and not attach:
        raise gcmd.error(
            "HOME=1 with ATTACH=0: the probe has to be put away to home;"
            " leave one of the two out"
        )
    return CycleParams(cycles, attach, home)


def of_cycles(settings: Settings) -> Settings:
    """Return the settings of cycles, each with the same number of touches.

    All at one point: texture would look like a switch that varies.
    """
    return settings.replace(
        samples=None,
        on_pin=_in_cycle(settings, settings.on_pin),
        on_bed=_in_cycle(settings, settings.on_bed),
        bed_spread=0.0,
    )


def _in_cycle(settings: Settings, sampling: Sampling) -> Sampling:
    """Return how a place is touched in each cycle; a single touch has no spread."""
    is_open = settings.is_auto or sampling.samples < 2
    return sampling._replace(
        samples=CYCLE_SAMPLES if is_open else sampling.samples,
        tolerance=float("inf"),
        result="average",
    )


def of_nozzle(settings: Settings, gcmd: GCodeCommand) -> Settings:
    """Return the settings of PROBE_Z_ACCURACY, with its parameters."""
    on_pin = settings.on_pin
    count = MOST if settings.is_auto else on_pin.samples
    param = options.param_number
    on_pin = on_pin._replace(
        samples=options.param_int(
            gcmd, "SAMPLES", count, minval=1, maxval=options.MOST_TOUCHES
        ),
        speed=param(gcmd, "PROBE_SPEED", on_pin.speed, above=0.0),
        lift_speed=param(gcmd, "LIFT_SPEED", on_pin.lift_speed, above=0.0),
        retract_dist=param(
            gcmd, "SAMPLE_RETRACT_DIST", on_pin.retract_dist, above=0.0
        ),
        tolerance=float("inf"),
    )
    return settings.replace(samples=None, on_pin=on_pin)


######################################################################
# Figures
######################################################################


def drift(times: Sequence[float], values: Sequence[float]) -> float:
    """Return the slope of the straight line through values, per minute.

    times: s.
    """
    return 60.0 * slope(times, values)


def slope(xs: Sequence[float], ys: Sequence[float]) -> float:
    """Return by how much y grows with x, on the straight line of least squares.

    0 where all x are the same.
    """
    middle, mean = fmean(xs), fmean(ys)
    square = math.fsum((x - middle) ** 2 for x in xs)
    if not square:
        return 0.0
    product = math.fsum((x - middle) * (y - mean) for x, y in zip(xs, ys))
    return product / square


def figures(
    cycles: Sequence[Cycle], switch_offset: float, step: float, seconds: float
) -> Iterator[str]:
    """Yield the lines for the console; seconds: how long one cycle took."""
    times = [cycle.time for cycle in cycles]
    series: Dict[str, List[float]] = {
        site: [fmean(cycle.touches(site)) for cycle in cycles] for site in SITES
    }
    series["offset"] = offsets(cycles, switch_offset)
    for name, values in series.items():
        yield (
            f"{name}: mean {fmean(values):.6f}, standard deviation"
            f" {stdev(values):.6f}, range {max(values) - min(values):.6f}, drift"
            f" {drift(times, values):.6f} per minute"
        )
    may_be_off = uncertainty(series["offset"], step)
    yield f"one CALIBRATE_Z: +-{may_be_off:.4f} mm, {seconds:.1f} s"
