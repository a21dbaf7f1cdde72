"""How much longer a hot nozzle is: measured once, and then part of each offset.

The nozzle touches at some 150 C, where nothing oozes, and prints at 250.  By then it is
longer, and with the offset of the touch it would be too low:

  offset + nozzle_growth * (EXTRUDER_TEMP - temperature at the touch) / 100

A longer nozzle meets pin and bed at a larger toolhead Z, so the offset is larger.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from statistics import fmean
from typing import TYPE_CHECKING, Iterator, List, Optional, Sequence, Tuple

from .. import command, options
from ..errors import CalibrationError
from ..warming import Wanted
from .accuracy import slope
from .run import OOZES_FROM
from .settings import LARGEST_GROWTH
from .warming import settings_of

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand
    from ..host.printer import Host
    from .module import ZCalibration
    from .run import CalibrationRun
    from .settings import Settings

# What is printed is hotter (degrees C) than that: a macro that knows no temperature says 0
COLDEST_PRINT = 100.0
HOTTEST_PRINT = 500.0

# Temperatures (degrees C) of the touches by default, and which ones can be: at the least a
# nozzle gets without a fan in a hot chamber
USUAL_TEMPS = (60.0, 110.0, 160.0)
COLDEST_TOUCH = 50.0
FEWEST_TEMPS = 3
APART = 20.0

# So near (degrees C) to its target the nozzle is as hot as wanted; no hotend takes so long (s)
NEAR = 3.0
LONGEST_HEATING = 1200.0

# At each temperature: how long (minutes) it may take to stand still
AT_EACH = Wanted(minutes=15.0)

# Touches that are so far (mm) off a straight line do not lie on one
LARGEST_SCATTER = 0.01


@dataclass(frozen=True)
class Growth:
    """A nozzle that prints hotter than it was touched: mm per 100 C, and degrees C."""

    per_100: float
    touched: float
    printing: float

    def longer(self, celsius: float) -> float:
        """Return by how much (mm) it is longer at a temperature than it was touched."""
        return self.per_100 * (celsius - self.touched) / 100.0

    @property
    def added(self) -> float:
        """What the offset is larger by (mm)."""
        return self.longer(self.printing)


def with_extruder_temp(
    host: Host, settings: Settings, gcmd: GCodeCommand
) -> Settings:
    """Return the settings with EXTRUDER_TEMP, at which will be printed.

    Raises CalibrationError where nothing can be calculated with it.
    """
    celsius: Optional[float] = options.param_number(
        gcmd,
        "EXTRUDER_TEMP",
        None,
        minval=COLDEST_PRINT,
        maxval=HOTTEST_PRINT,
    )
    if celsius is None:
        return settings
    if settings.nozzle_growth is None:
        raise CalibrationError(
            "EXTRUDER_TEMP needs nozzle_growth, which says how much longer the nozzle"
            " is then; run Z_CALIBRATION_NOZZLE_GROWTH once, or leave EXTRUDER_TEMP out"
        )
    check_extruder(host)
    return settings.replace(extruder_temp=celsius)


def check_extruder(host: Host) -> None:
    """Raise CalibrationError for a printer without an extruder."""
    if not host.extruder():
        raise CalibrationError(
            "this printer has no extruder, so it is not known how hot its nozzle is"
        )


def growth_of(run: CalibrationRun) -> Optional[Growth]:
    """Return the growth of a run that has touched the nozzle, None: not asked for."""
    settings, touched = run.settings, run.nozzle_celsius
    if settings.extruder_temp is None:
        return None
    assert settings.nozzle_growth is not None and touched is not None
    return Growth(settings.nozzle_growth, touched, settings.extruder_temp)


def fit(touches: Sequence[Tuple[float, float]]) -> Tuple[float, float]:
    """Return mm per 100 C, and how far (mm) the worst touch is off the straight line.

    'touches' are pairs of degrees C and heights (mm).
    """
    temps, heights = [t for t, _ in touches], [z for _, z in touches]
    per_degree = slope(temps, heights)
    middle, mean = fmean(temps), fmean(heights)
    off = [abs(z - mean - per_degree * (t - middle)) for t, z in touches]
    return 100.0 * per_degree, max(off)


class NozzleGrowth:
    """The command that measures it."""

    def __init__(self, calibration: ZCalibration):
        self.calibration = calibration
        self.host = calibration.host
        self.progress = calibration.progress
        command.register_commands(self.host, self)

    cmd_Z_CALIBRATION_NOZZLE_GROWTH_help = "Measure how much longer a hot nozzle is, for CALIBRATE_Z EXTRUDER_TEMP="

    def cmd_Z_CALIBRATION_NOZZLE_GROWTH(self, gcmd: GCodeCommand) -> None:
        """Touch the pin with the nozzle at several temperatures; save its growth."""
        calibration = self.calibration
        calibration.refuse_during_a_print(gcmd, own=True)
        temps = self._temps(gcmd)
        settings = settings_of(calibration.settings)
        wanted = len(temps) * AT_EACH.touches(settings.on_pin)
        with calibration.running(gcmd, "nozzle", wanted, has_error_gcode=False):
            check_extruder(self.host)
            with self._target_kept(), calibration.nozzle_run(
                gcmd, settings
            ) as run:
                touches = [self._touch_at(run, celsius) for celsius in temps]
            growth, scatter = fit(touches)
            growth = round(growth, 4)
            self._check(growth, scatter)
        gcmd.respond_info(
            f"Z_CALIBRATION_NOZZLE_GROWTH: the nozzle is {growth:.4f} mm longer for each"
            f" 100 C; the touches lie up to {scatter:.4f} mm off a straight line"
        )
        calibration.use_nozzle_growth(growth)
        self.host.save("nozzle_growth", f"{growth:.4f}")

    def _temps(self, gcmd: GCodeCommand) -> List[float]:
        """Read TEMPS; raises the command's error."""
        text = gcmd.get("TEMPS", "").strip()
        if not text:
            return list(USUAL_TEMPS)
        try:
            temps = [float(part) for part in text.split(",")]
        except ValueError:
            raise options.param_error(
                gcmd, "TEMPS", "temperatures in C, such as 60,110,160"
            )
        if not all(COLDEST_TOUCH <= t <= OOZES_FROM for t in temps):
            raise options.param_error(
                gcmd,
                "TEMPS",
                f"{COLDEST_TOUCH:g} to {OOZES_FROM:g} C: colder is not reached in each"
                " printer, and from hotter nozzles plastic oozes",
            )
        if len(set(temps)) < FEWEST_TEMPS:
            raise options.param_error(
                gcmd, "TEMPS", "three temperatures or more: two make no line"
            )
        if any(abs(a - b) < APART for a, b in zip(temps, temps[1:])):
            raise options.param_error(
                gcmd,
                "TEMPS",
                f"{APART:g} C apart, each from the one before, to see any growth",
            )
        return temps

    @contextlib.contextmanager
    def _target_kept(self) -> Iterator[None]:
        """Have the heater's target be as before in the end, whatever happens."""
        extruder, target = self.host.extruder(), self.host.nozzle_target()

        def heat_back() -> None:
            """Have the target of before."""
            self.host.heat(extruder, target)

        with command.always(self.host, heat_back, "the heater's target"):
            yield

    def _touch_at(
        self, run: CalibrationRun, celsius: float
    ) -> Tuple[float, float]:
        """Return how hot the nozzle is, and where it meets the pin, once both stand still."""
        self.progress.enter("heating")
        self.progress.say(f"nozzle to {celsius:g} C")
        self.host.heat(self.host.extruder(), celsius)
        self._wait_until_hot(celsius)
        seen = self.calibration.warming.until_still(run, AT_EACH)
        assert seen.last is not None and seen.movement is not None
        if not seen.is_still:
            raise CalibrationError(
                f"at {celsius:g} C the pin still moves, by {abs(seen.movement):.4f} mm a"
                f" minute after {seen.minutes:.0f} minutes, and it cannot be told what of"
                " that is the nozzle; let the printer warm up with Z_CALIBRATION_WAIT, then"
                " measure again"
            )
        return self.host.nozzle_celsius(), seen.last

    def _wait_until_hot(self, celsius: float) -> None:
        """Wait until the nozzle is as hot as wanted, or as cool.  May pause."""
        begun = self.host.eventtime()
        while abs(self.host.nozzle_celsius() - celsius) > NEAR:
            if self.host.eventtime() > begun + LONGEST_HEATING:
                raise CalibrationError(
                    f"the nozzle has {self.host.nozzle_celsius():.0f} C after"
                    f" {LONGEST_HEATING / 60.0:g} minutes, and should have"
                    f" {celsius:g} C; choose other TEMPS"
                )
            self.host.wait_until(self.host.eventtime() + 1.0)

    def _check(self, growth: float, scatter: float) -> None:
        """Raise CalibrationError for a growth (mm per 100 C) that is none."""
        if 0.0 <= growth <= LARGEST_GROWTH and scatter <= LARGEST_SCATTER:
            return
        raise CalibrationError(
            f"the nozzle would be {growth:.4f} mm longer for each 100 C (0.03 to 0.1 is"
            f" usual), with touches up to {scatter:.4f} mm off a straight line (no more"
            f" than {LARGEST_SCATTER:g}); clean the nozzle and let the printer warm up with"
            " Z_CALIBRATION_WAIT, then measure again"
        )
