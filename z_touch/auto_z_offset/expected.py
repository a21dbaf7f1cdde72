# What is known before a touch: the probe's correction, and where the bed sensor
# should trigger.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import options
from ..datum import DATUM_NOISE, Datum, HomedDatum
from ..errors import CalibrationError
from ..host.probe import TWIST
from .heights import (
    EXPECTED_MARGIN,
    NOTHING_EXPECTED,
    expect_below_probe,
    expect_near,
)

# From here on (mm) the probe does not see the bed where Z was homed with it:
# the nozzle would be wrong by as much until the next homing.
STALE_Z = 0.1

# What is saved is rounded to that (mm).
SAVED_DIGIT = 0.000001


# By how much the probe is wrong (mm): as it was saved, or measured since.
class Correction:
    def __init__(self, host, settings):
        self.host = host
        # z_offset of the probe that it was measured with; None: not known
        self.probe_z_offset = settings.corrected_probe_z_offset
        # None: never measured.  The documented default of 0 means that, too.
        self.z = settings.probe_z_correction
        if self.probe_z_offset is None:
            self.z = self.z or None
        # What the probe's z_offset has changed by since it was measured or saved (mm)
        self.followed = 0.0

    # Z_OFFSET_APPLY_PROBE and PROBE_CALIBRATE move the probe's Z=0, and the
    # correction is counted from there.  Returns what the user is told.
    def follow_probe(self):
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
            "the probe's z_offset is %.3f and was %.3f when the correction was"
            " saved: probe_z_correction %.6f is taken as %.6f; if the probe was moved"
            " meanwhile, run AUTO_Z_CALIBRATE"
            % (z_offset, self.probe_z_offset, saved_z, self.z)
        )

    # What the user is told whenever it is loaded; empty: nothing
    def unsure(self):
        if not self.followed:
            return ""
        # Mounted anew it has another z_offset, and the same correction as before.
        return (
            "%.3f mm of it follow the probe's new z_offset, which is wrong by as"
            " much if the probe was moved; then run AUTO_Z_CALIBRATE and"
            " SAVE_CONFIG" % (self.followed,)
        )

    # Ready for SAVE_CONFIG, and in force from here on
    def save(self, z):
        self.z, self.followed = z, 0.0
        for option, value in (
            ("probe_z_correction", z),
            ("corrected_probe_z_offset", self.host.probing.z_offset()),
        ):
            printer, section = self.host.printer, self.host.section
            options.save(printer, section, option, "%.6f" % (value,))


# Where the bed is expected: from touches, from the correction, and from how Z
# was homed.
class Expectations:
    def __init__(self, host, settings, correction):
        self.host = host
        self.settings = settings
        self.correction = correction
        self.frame = Datum(host)
        self.homed = HomedDatum(self.frame)
        # Toolhead Z (mm) of the last trigger, and the frame it was seen in
        self.sensor_z = self.mark = None
        # The frame that AUTO_Z_HOME_Z has made
        self.home_mark = None
        # Heights of the mesh that was probed last, and the frame it was probed in
        self.mesh = self.mesh_mark = None
        # All sections have registered their commands then, and no macro has
        # taken the place of one.
        register = host.printer.register_event_handler
        register("klippy:mcu_identify", self._watch_commands)

    def _watch_commands(self):
        wrap = self.host.wrap_command
        wrap("BED_MESH_CALIBRATE", self._around_mesh)
        wrap(TWIST, self._before_twist)

    def _around_mesh(self, command, gcmd):
        command(gcmd)
        self.mesh = self.host.transforms.mesh_heights()
        self.mesh_mark = self.frame.mark()

    # The host forgets the old one before it asks for the first paper.
    def _before_twist(self, command, gcmd):
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

    # The bed sensor has triggered there.
    def touched(self, sensor_z):
        self.sensor_z = sensor_z
        self.mark = self.frame.mark()

    # Z was set by the touch that was the last one.
    def homed_by_sensor(self):
        self.home_mark = self.mark

    # From a touch since Z was set, or from what the probe said when Z was homed
    # with it
    def expected(self):
        if self.holds(self.mark):
            return expect_near(self.sensor_z, EXPECTED_MARGIN)
        probing = self.host.probing
        if self.is_sensor_frame() or not self.host.axes.homes_with_probe():
            return NOTHING_EXPECTED
        if self.correction.z is not None:
            # The trigger that the correction stands for
            z = self.correction.z - self.settings.z_offset
            return expect_near(probing.homed_bed_z() + z, EXPECTED_MARGIN)
        return expect_below_probe(probing.homed_probe_z())

    # Where (toolhead Z, mm) the probe should trigger, as Z was homed with it;
    # None: it was not.
    def probe_z(self):
        if self.is_sensor_frame() or not self.host.axes.homes_with_probe():
            return None
        return self.host.probing.homed_probe_z()

    # Whether Z=0 is another one since it was homed, which the correction is of.  Not
    # where nobody knows, or where the mesh in force goes with it.
    def is_levelled(self):
        moved = self.homed.moved_by() if self.frame.is_homed() else 0.0
        return DATUM_NOISE < moved < float("inf") and not self.is_in_mesh()

    # What the user is told then of an offset that is set; empty: nothing
    def levelled(self):
        if not self.is_levelled():
            return ""
        return (
            "the Z motors have moved since G28, as levelling does: where Z=0 is"
            " another one now, the offset is wrong by that; run G28 Z, then the mesh"
            " if you use one, then AUTO_Z_LOAD_OFFSET again"
        )

    # What the user is told then of steps that are saved; empty: nothing
    def levelled_steps(self):
        if not self.is_levelled():
            return ""
        return (
            "the Z motors have moved since G28, as levelling does: steps that make"
            " good for it are wrong after the next G28; before SAVE_CONFIG run G28,"
            " level, G28 Z, AUTO_Z_CALIBRATE, which measures without them"
        )

    # Whether the mesh in force holds what Z=0 has moved by: it was probed since then,
    # and has no zero of its own.
    def is_in_mesh(self):
        features = self.host.transforms
        # Whoever has saved it as a profile may have loaded it again.
        is_last = self.mesh is not None and self.mesh == features.mesh_heights()
        if not is_last or features.mesh_zero() is not None:
            return False
        return self.frame.moved_by(self.mesh_mark) <= DATUM_NOISE

    # Whether Z is still what it was when the frame was marked.  Where the
    # motors do not tell (empty datum), nobody knows.
    def holds(self, mark):
        is_told = mark is not None and bool(mark[1])
        return is_told and not self.frame.moved_since(mark)

    # Whether Z is the bed sensor's.  Levelling does not change that: only what
    # sets Z does.
    def is_sensor_frame(self):
        return self.was_sensor_frame() and self.frame.is_homed()

    # Whether it was, and perhaps Z is not homed any more
    def was_sensor_frame(self):
        mark = self.home_mark
        return mark is not None and not self.frame.was_set_since(mark)

    # The correction of the probe means nothing in a frame of the bed sensor, and where
    # that is gone the G-code offset may still be the one that was right in it.
    def check_offset(self):
        if self.was_sensor_frame():
            self.refuse_frame()

    def check_frame(self):
        if self.is_sensor_frame():
            self.refuse_frame()

    def refuse_frame(self):
        raise CalibrationError(
            "Z was set by AUTO_Z_HOME_Z, a correction of the probe does not"
            " hold there; home Z with the probe (G28) first"
        )

    # The correction is the G-code offset only where the probe sees the bed at
    # about 0.  Returns what is wrong with that; empty: nothing.
    def why_stale(self, result):
        bed_z = result.probe - result.probe_z_offset
        homed_bed_z = self.host.probing.homed_bed_z()
        if abs(bed_z - homed_bed_z) <= STALE_Z:
            return ""
        remedy = "the correction holds with a bed mesh of this probe only"
        if self.host.axes.homes_with_probe():
            remedy = (
                "check the probe with QUERY_PROBE, and home Z again (G28) after"
                " any levelling, over this point"
            )
        text = "the probe sees the bed at z=%.3f instead of %.3f; %s"
        return text % (bed_z, homed_bed_z, remedy)
