# What Klipper's own features shift at the point of the bed that was measured: taken
# off the offset, so that the gap is right there, and told.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .results import Warned, bed_seen

# Less (mm) is rounding.
SMALLEST_PART = 0.0005

# From here on (mm) it is more than the interpolation of a mesh at its zero.
WORTH_A_WARNING = 0.02

MESH = "bed_mesh"


# As it is now; 'last': the results.Last that it is asked for.
class Shifts:
    def __init__(self, host, last):
        features, self.last = host.features, last
        point = last.point + (last.result.offset,)
        bed_z = bed_seen(host, last)
        self.rest = features.rest(*point)
        self.parts = [
            part
            for part in features.parts(*point, bed_z=bed_z)
            if abs(part.height) >= SMALLEST_PART
        ]
        self.mesh_zero_option = features.mesh_zero_option()
        self.is_beyond_mesh = features.is_beyond_mesh(*last.point)
        self.is_guessed = features.is_mesh_guessed(*last.point)

    # The G-code offset (mm) with which the gap is right there, Z_ADJUST included
    def offset(self):
        taken = sum(part.height for part in self.parts)
        return self.last.result.offset + self.last.z_adjust - taken

    # (whether that is a warning, Warned) of each
    def lines(self):
        for part in self.parts:
            text = self.of_mesh if part.name == MESH else self.of_other
            is_large = abs(part.height) >= WORTH_A_WARNING
            yield is_large, Warned(part.name, text(part))
        if self.is_guessed:
            yield True, Warned(MESH, self.of_rim())
        if abs(self.rest) >= WORTH_A_WARNING:
            text = (
                "another feature shifts Z by %.3f mm there, such as"
                " exclude_object, a retraction with a lift, or a module of its"
                " own: not taken off; check the first layer"
            )
            yield True, Warned("another", text % (self.rest,))

    def of_mesh(self, part):
        text = (
            "bed_mesh is %.3f mm at %.1f, %.1f, where the bed was measured:"
            " taken off"
        ) % ((part.height,) + self.last.point)
        if self.is_guessed:
            return text
        text += ", the gap is right %s" % (
            "within the mesh" if self.is_beyond_mesh else "there",
        )
        if abs(part.height) < WORTH_A_WARNING:
            return text
        return "%s; for all of the bed set %s of section 'bed_mesh' there" % (
            text,
            self.mesh_zero_option,
        )

    def of_rim(self):
        return (
            "bed_mesh ends before %.1f, %.1f, and its zero is elsewhere: what was"
            " taken off is the height of its rim, and the first layer may be"
            " wrong; set %s of section 'bed_mesh' there"
            % (self.last.point + (self.mesh_zero_option,))
        )

    # Heat goes on from here, a tilt is the same.
    def of_other(self, part):
        text = "%s shifts Z by %.3f mm there now: taken off"
        return text % (part.name, part.height)

    def warnings(self):
        return [told for is_warning, told in self.lines() if is_warning]
