# The last calibration that was applied, and whether it still holds.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from ..core import restoring

# Something odd: the site, "switch - nozzle" or the feature of Klipper's that it is
# about, and a text
Warned = collections.namedtuple("Warned", "about text")

# The last run that was applied:
#
#   result       its heights.Result
#   mark         of the frame that it was measured in
#   warnings     what was odd, each a Warned
#   uncertainty  what it is worth (mm at 95 %, None: nobody knows)
#   z_adjust     what Z_ADJUST added (mm)
#   z_offset     the G-code offset that came of it (mm): what was measured, less what
#                Klipper's own features shift there, with what was added
#   applied      the G-code offset that was set (mm): the same, unless offset_gcode
#                has made another one of it
#   nozzle_at    X, Y where the nozzle has met the pin with the probe on the head (mm),
#                None: that was elsewhere
#   point        X, Y of the bed that was measured (mm)
#   height       of bed mesh or bed tilt there, when it was applied (mm)
#   guessed      whether nobody knew it, see features
#   twist        what the host adds to the height of the bed there (mm)
#   extruder     whose nozzle it was
#   heat         what was set of z_thermal_adjust, see features.heat_settings()
#   states       the states of G-code that were saved, see restoring.saved(): when it was
#                applied, or corrected since
Last = collections.namedtuple(
    "Last",
    "result mark warnings uncertainty z_adjust z_offset applied nozzle_at point"
    " height guessed twist extruder heat states",
)
NOTHING = Last(
    None, None, (), None, 0.0, 0.0, 0.0, None, None, 0.0, False, 0.0, "", {}, {}
)

# By less (mm) the bed mesh is as high as it was.
SAME_HEIGHT = 0.01

# Offsets that differ by less (mm) are the same, but for their digits in G-code.
SAME_OFFSET = 0.000002


# Where the host's probe sees the bed at the point of the results.Last (toolhead Z, mm)
def bed_seen(host, last):
    return last.result.probe + last.twist - host.probing.z_offset()


# The height (mm) of bed mesh or bed tilt there
def height_of(host, last):
    bed_z = bed_seen(host, last)
    return host.features.height(*last.point, bed_z=bed_z)


# What macros read of results, and what the next run knows of the last one.
class Results:
    # 'frame': frame.Frame of the heights
    def __init__(self, host, frame):
        self.host = host
        self.frame = frame
        self.last = NOTHING
        # The last one with each extruder, by its name: another nozzle is longer
        self.of_tools = {}
        # The Last of the run that is under way, as soon as it has measured:
        # end_gcode may read it.
        self.measured = None
        # The last run has ended well, or the one under way has measured well
        self.is_good = False

    # A run begins
    def begin(self):
        self.note(None)

    # The Last of the run that is under way, None: there is none
    def note(self, measured):
        self.measured = measured
        self.is_good = measured is not None

    # A run has ended well
    def keep(self, last):
        self.last = self.of_tools[last.extruder] = last
        self.is_good = True

    # What the next run with an extruder knows: the last good heights.Result or None,
    # and whether its heights hold
    def earlier(self, extruder):
        last = self.of_tools.get(extruder, NOTHING)
        if last.result is None:
            return None, False
        return last.result, not self.frame.moved_since(last.mark)

    # What is in force (mm) is the offset of the last run now, with another switch_offset
    def correct(self, switch_offset, z_offset):
        result = self.last.result
        change = result.switch_offset - switch_offset
        corrected = result._replace(
            switch_offset=switch_offset, offset=result.offset + change
        )
        # What offset_gcode adds is no part of it
        added = self.last.applied - self.last.z_offset
        last = self.last._replace(
            result=corrected,
            z_offset=z_offset - added,
            applied=z_offset,
            states=restoring.saved(self.host),
        )
        self.last = self.of_tools[last.extruder] = last

    ##################################################################
    # Whether it holds: why it does not (any more), in words; empty: it does
    ##################################################################

    # The heights, by the frame.  'besides' is of its words, and counts as nothing.
    def why_outdated(self, besides=None):
        if self.last.result is None:
            return "not calibrated yet"
        return self.frame.moved_since(self.last.mark, besides)

    # The offset that came of them, if it is set (again)
    def why_not_right(self, besides=None):
        return (
            self.why_outdated(besides)
            or self._why_not_as_high()
            or self._why_other_heat()
        )

    # The offset, and that it is set
    def why_not(self):
        return self.why_not_measured() or self._why_not_in_force()

    # The measurement, for the nozzle that is active and where Z=0 is
    def why_not_measured(self):
        return (
            self.why_not_right()
            or self._why_other_tool()
            or self.why_moved_by_g92()
        )

    def _why_other_tool(self):
        active, calibrated = self.host.extruder(), self.last.extruder
        if active == calibrated:
            return ""
        return "%s is active, and CALIBRATE_Z was run with %s" % (
            active,
            calibrated,
        )

    def why_moved_by_g92(self):
        moved = self.host.features.moved_by_g92()
        if abs(moved) < SAME_OFFSET:
            return ""
        return (
            "G92 has moved Z=0 by %.3f mm; G28 or CALIBRATE_Z undoes that"
            % (moved,)
        )

    def _why_not_as_high(self):
        last, features = self.last, self.host.features
        height = height_of(self.host, last)
        if features.is_mesh_guessed(*last.point) and not last.guessed:
            return (
                "bed_mesh ends before %.1f, %.1f, where CALIBRATE_Z has measured,"
                " and its zero is elsewhere; set %s of section 'bed_mesh' there"
                % (last.point + (features.mesh_zero_option(),))
            )
        if abs(height - last.height) <= SAME_HEIGHT:
            return ""
        return (
            "%s is %.3f mm at %.1f, %.1f and was %.3f mm there after"
            " CALIBRATE_Z; run that when the mesh is loaded"
            % ((features.mesh_name(), height) + last.point + (last.height,))
        )

    def _why_other_heat(self):
        if self.host.features.heat_settings() == self.last.heat:
            return ""
        return (
            "SET_Z_THERMAL_ADJUST has moved Z=0 since CALIBRATE_Z; run it before"
            " that"
        )

    # Where offset_gcode makes another one of it, or sets it later, either will do.
    def _why_not_in_force(self):
        offset, last = self.host.gcode_offset.z(), self.last
        if (
            min(abs(offset - z) for z in (last.applied, last.z_offset))
            < SAME_OFFSET
        ):
            return ""
        return (
            "the G-code Z offset is %.3f, that of CALIBRATE_Z is %.3f: changed by"
            " baby steps, SET_GCODE_OFFSET, RESUME or RESTORE_GCODE_STATE"
            % (offset, last.applied)
        )

    ##################################################################
    # Status
    ##################################################################

    # 'last_query' and 'last_z_offset' as upstream has them; for end_gcode the
    # heights are of the run that is under way.
    def status(self):
        shown = self.measured or self.last
        result = shown.result
        reason = "not applied yet" if self.measured else self.why_not()
        return {
            "last_query": self.is_good,
            "last_z_offset": shown.z_offset,
            "last_result": {} if result is None else dict(result._asdict()),
            "measured": not self.measured and not self.why_not_measured(),
            "valid": not reason,
            "reason": reason,
            "warnings": [warned.text for warned in self.last.warnings],
            "uncertainty": self.last.uncertainty,
            "z_adjust": self.last.z_adjust,
            "applied": self.last.applied,
        }
