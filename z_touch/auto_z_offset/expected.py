"""What is known before a touch: the probe's correction, and where the bed should be.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Iterator, Optional

from .. import options
from ..datum import DATUM_NOISE, Datum, HomedDatum, Mark
from ..errors import CalibrationError
from ..host.probe import TWIST
from .heights import (
    EXPECTED_MARGIN,
    NOTHING_EXPECTED,
    Expected,
    Result,
    expect_below_probe,
    expect_near,
)

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand, Handler
    from ..host.printer import Host
    from .settings import Settings

# From here on (mm) the probe does not see the bed where Z was homed with it:
# the nozzle would be wrong by as much until the next homing.
STALE_Z = 0.1

# Bed and chamber that differ by no more (degrees C) are as hot as they were
AS_HOT = 15.0

# What is saved is rounded to that (mm).
SAVED_DIGIT = 0.000001


class Correction:
    """By how much the probe is wrong: as it was saved, or measured since."""

    def __init__(self, host: Host, settings: Settings):
        self.host = host
        # z_offset of the probe that it was measured with (mm); None: not known
        self.probe_z_offset = settings.corrected_probe_z_offset
        # mm; None: never measured.  The documented default of 0 means that, too.
        self.z = settings.probe_z_correction
        if self.probe_z_offset is None:
            self.z = self.z or None
        # How hot (degrees C) bed and chamber were then, as far as that is known
        self.temperatures = {
            part: degrees
            for part, degrees in (
                ("bed", settings.corrected_bed_temp),
                ("chamber", settings.corrected_chamber_temp),
            )
            if degrees is not None
        }
        # What the probe's z_offset has changed by since it was measured or saved (mm)
        self.followed = 0.0

    def follow_probe(self) -> str:
        """Follow what has moved the probe's Z=0, which the correction is counted from.

        Z_OFFSET_APPLY_PROBE and PROBE_CALIBRATE do so.  Returns what the user is told.
        """
        if self.z is None or self.probe_z_offset is None:
            return ""
        z_offset = self.host.probing.z_offset()
        moved = z_offset - self.probe_z_offset
        if abs(moved) < SAVED_DIGIT:
            return ""
        saved_z = self.z
        self.z = saved_z + moved
        self.followed = moved
        return (
            f"the probe's z_offset is {z_offset:.3f} and was {self.probe_z_offset:.3f}"
            f" when the correction was saved: probe_z_correction {saved_z:.6f} is taken"
            f" as {self.z:.6f}; if the probe was moved meanwhile, run AUTO_Z_CALIBRATE"
        )

    def unsure(self) -> str:
        """Return what the user is told whenever it is loaded; empty: nothing."""
        if not self.followed:
            return ""
        # Mounted anew it has another z_offset, and the same correction as before.
        return (
            f"{self.followed:.3f} mm of it follow the probe's new z_offset, which is"
            " wrong by as much if the probe was moved; then run AUTO_Z_CALIBRATE and"
            " SAVE_CONFIG"
        )

    def other_heat(self) -> str:
        """Return what the user is told of bed and chamber that are hotter or colder now.

        An inductive probe senses another height then.  Empty: they are about as hot.
        """
        now = self.host.wanted_temperatures()
        texts = [
            f"the {part} is {now[part]:.0f} C and was {degrees:.0f} C"
            for part, degrees in self.temperatures.items()
            if part in now and abs(now[part] - degrees) > AS_HOT
        ]
        if not texts:
            return ""
        return (
            f"{', '.join(texts)} when the correction was measured: the probe may sense"
            " another height, and the first layer be wrong by it; run AUTO_Z_CALIBRATE"
            " as hot as you print, and SAVE_CONFIG"
        )

    def save(self, z: float) -> None:
        """Have another one (mm) in force from here on, and ready for SAVE_CONFIG."""
        self.z, self.followed = z, 0.0
        self.temperatures = self.host.wanted_temperatures()
        printer, section = self.host.printer, self.host.section
        for option, value in (
            ("probe_z_correction", z),
            ("corrected_probe_z_offset", self.host.probing.z_offset()),
        ):
            options.save(printer, section, option, f"{value:.6f}")
        for part, degrees in self.temperatures.items():
            option = f"corrected_{part}_temp"
            options.save(printer, section, option, f"{degrees:.1f}")


class Expectations:
    """Where the bed is expected: from touches, the correction, and how Z was homed."""

    def __init__(self, host: Host, settings: Settings, correction: Correction):
        self.host = host
        self.settings = settings
        self.correction = correction
        self.datum = Datum(host)
        self.homed = HomedDatum(self.datum)
        # Toolhead Z (mm) of the last trigger, and where Z=0 was then
        self.sensor_z: Optional[float] = None
        self.mark: Optional[Mark] = None
        # Where AUTO_Z_HOME_Z has set Z=0
        self.home_mark: Optional[Mark] = None
        # Heights of the mesh that was probed last, and where Z=0 was then
        self.mesh: Any = None
        self.mesh_mark: Optional[Mark] = None
        # All sections have registered their commands then, and no macro has taken the
        # place of one.
        register = host.printer.register_event_handler
        register("klippy:mcu_identify", self._watch_commands)

    def _watch_commands(self) -> None:
        wrap = self.host.wrap_command
        wrap("BED_MESH_CALIBRATE", self._around_mesh)
        wrap(TWIST, self._before_twist)

    def _around_mesh(self, command: Handler, gcmd: GCodeCommand) -> None:
        command(gcmd)
        self.mesh = self.host.transforms.mesh_heights()
        self.mesh_mark = self.datum.mark()

    def _before_twist(self, command: Handler, gcmd: GCodeCommand) -> None:
        """Tell what another twist does; the host forgets the old one before the first paper."""
        is_in_zero = (
            self.host.axes.homes_with_probe()
            and self.host.probing.homes_with_twist()
        )
        if is_in_zero and self.correction.z is not None:
            self.host.say(
                "another twist moves the Z=0 of G28, which probe_z_correction is"
                " counted from; after the last ACCEPT run G28, AUTO_Z_CALIBRATE and"
                " SAVE_CONFIG, after ABORT RESTART, which brings the old twist back"
            )
        command(gcmd)

    def touched(self, sensor_z: Optional[float]) -> None:
        """Note that the bed sensor has triggered there (mm), None: it was not touched."""
        self.sensor_z = sensor_z
        self.mark = self.datum.mark()

    @contextlib.contextmanager
    def learning(self) -> Iterator[None]:
        """Forget what is learned meanwhile if that fails: a failed command teaches nothing."""
        known = self.sensor_z, self.mark
        try:
            yield
        except Exception:
            self.sensor_z, self.mark = known
            raise

    def homed_by_sensor(self) -> None:
        """Note that Z was set by the touch that was the last one."""
        self.home_mark = self.mark

    ##################################################################
    # Expected heights
    ##################################################################

    def expected(self) -> Expected:
        """Return where the bed sensor should trigger.

        From a touch since Z was set, or from what the probe said when Z was homed with it.
        """
        if self.sensor_z is not None and self._holds(self.mark):
            return expect_near(self.sensor_z, EXPECTED_MARGIN)
        probing = self.host.probing
        if self.is_sensor_frame() or not self.host.axes.homes_with_probe():
            return NOTHING_EXPECTED
        if self.correction.z is not None:
            # The trigger that the correction stands for
            z = self.correction.z - self.settings.z_offset
            return expect_near(probing.homed_bed_z() + z, EXPECTED_MARGIN)
        return expect_below_probe(probing.homed_probe_z())

    def probe_z(self) -> Optional[float]:
        """Return where (toolhead Z, mm) the probe should trigger, as Z was homed with it.

        None: it was not.
        """
        if self.is_sensor_frame() or not self.host.axes.homes_with_probe():
            return None
        return self.host.probing.homed_probe_z()

    def why_stale(self, result: Result) -> str:
        """Return why a correction is not the G-code offset; empty: it is.

        It is only where the probe sees the bed at about 0.
        """
        bed_z = result.probe - result.probe_z_offset
        homed_bed_z = self.host.probing.homed_bed_z()
        if abs(bed_z - homed_bed_z) <= STALE_Z:
            return ""
        remedy = "the correction holds with a bed mesh of this probe only"
        if self.is_sensor_frame():
            remedy = (
                "Z was set by AUTO_Z_HOME_Z, so that is no fault; AUTO_Z_LOAD_OFFSET"
                " needs Z homed with the probe (G28)"
            )
        elif self.host.axes.homes_with_probe():
            remedy = (
                "check the probe with QUERY_PROBE, and home Z again (G28) after"
                " any levelling, over this point"
            )
        return (
            f"the probe sees the bed at z={bed_z:.3f} instead of {homed_bed_z:.3f};"
            f" {remedy}"
        )

    ##################################################################
    # Levelled since it was homed
    ##################################################################

    def _is_levelled(self) -> bool:
        """Return whether Z=0 is another one since G28, which the correction is of.

        Not where that is not known, or where the mesh in force goes with it.
        """
        moved = self.homed.moved_by() if self.datum.is_homed() else 0.0
        return DATUM_NOISE < moved < float("inf") and not self._is_in_mesh()

    def levelled(self) -> str:
        """Return what the user is told then of an offset that is set; empty: nothing."""
        if not self._is_levelled():
            return ""
        return (
            "the Z motors have moved since G28, as levelling does: where Z=0 is"
            " another one now, the offset is wrong by that; run G28 Z, then the mesh"
            " if you use one, then AUTO_Z_LOAD_OFFSET again"
        )

    def moved_since(self, mark: Mark) -> str:
        """Return what has moved Z=0 since a correction was applied, in words; empty: nothing.

        It holds after any G28, and with a mesh that goes with Z=0; what AUTO_Z_HOME_Z does to
        it that command tells.
        """
        if self.was_sensor_frame() or self._is_in_mesh():
            return ""
        return self.homed.moved_since(mark)

    def levelled_steps(self) -> str:
        """Return what the user is told then of steps that are saved; empty: nothing."""
        if not self._is_levelled():
            return ""
        return (
            "the Z motors have moved since G28, as levelling does: steps that make"
            " good for it are wrong after the next G28; before SAVE_CONFIG run G28,"
            " level, G28 Z, AUTO_Z_CALIBRATE, which measures without them"
        )

    def _is_in_mesh(self) -> bool:
        """Return whether the mesh in force holds what Z=0 has moved by.

        It was probed since then, and has no zero of its own.
        """
        transforms = self.host.transforms
        # As a profile it may have been loaded again.
        is_last = (
            self.mesh is not None and self.mesh == transforms.mesh_heights()
        )
        if not is_last or transforms.mesh_zero() is not None:
            return False
        assert self.mesh_mark is not None
        return self.datum.moved_by(self.mesh_mark) <= DATUM_NOISE

    ##################################################################
    # Whose Z=0 it is
    ##################################################################

    def _holds(self, mark: Optional[Mark]) -> bool:
        """Return whether Z=0 is still where it was.

        Where the motors do not tell (no heights of them) that is not known.
        """
        if mark is None or not mark.motors:
            return False
        return not self.datum.moved_since(mark)

    def is_sensor_frame(self) -> bool:
        """Return whether Z=0 is the bed sensor's.

        Levelling does not change that: only what sets Z does.
        """
        return self.was_sensor_frame() and self.datum.is_homed()

    def was_sensor_frame(self) -> bool:
        """Return whether it was, and perhaps Z is not homed any more."""
        mark = self.home_mark
        return mark is not None and not self.datum.was_set_since(mark)

    def check_offset(self) -> None:
        """Raise CalibrationError where the G-code offset may be one for the bed sensor's Z=0.

        It may still be in force where that is gone.
        """
        if self.was_sensor_frame():
            self._refuse_frame()

    def check_frame(self) -> None:
        """Raise CalibrationError where a correction of the probe means nothing."""
        if self.is_sensor_frame():
            self._refuse_frame()

    def _refuse_frame(self) -> None:
        raise CalibrationError(
            "Z was set by AUTO_Z_HOME_Z, a correction of the probe does not"
            " hold there; home Z with the probe (G28) first"
        )
