# What Klipper's own features shift where the switch lies, a bed mesh above all: the
# offset is applied below them.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from ..host.transforms import INNERMOST

# Less (mm) is rounding.
SMALLEST_PART = 0.0005

# From here on (mm) it is worth telling what nobody knows.
LARGEST_REST = 0.02


# With the head at x, y, z (toolhead, mm).
class Shifts:
    # 'is_saved': for a value that counts from the next homing on, when the mesh is
    # as it is, but not the heat.
    def __init__(self, host, point, is_saved):
        self.point = point
        self.features = host.transforms
        self.parts = [
            part
            for part in host.transforms.parts(*point)
            if abs(part.height) >= SMALLEST_PART
            and (part.name in INNERMOST or not is_saved)
        ]
        self.rest = host.transforms.unknown_here()
        # Nobody knows what the mesh would be there
        self.is_guessed = host.transforms.is_beyond_mesh(
            *point[:2]
        ) and not host.transforms.is_mesh_zero(*point[:2])

    # mm, to be taken off the offset
    def height(self):
        return sum(part.height for part in self.parts)

    # Whether Z=0 will be where a later bed mesh sees it, not where the switch lay.  One
    # in force was taken off, and stays right.
    def is_mesh_elsewhere(self):
        features = self.features
        return (
            features.has_mesh_section()
            and features.mesh_heights() is None
            and not features.is_mesh_zero(*self.point[:2])
        )

    # What the user is told; 'z_offset': what has become of the offset (mm)
    def lines(self, z_offset):
        if self.parts:
            parts = ["%s %.3f mm" % tuple(part) for part in self.parts]
            values = (", ".join(parts),) + self.point[:2] + (z_offset,)
            yield (
                "%s at %.1f, %.1f, where the switch lay, taken off: the offset is"
                " %.6f, and right there while that is in force" % values
            )
        if self.is_guessed:
            yield (
                "bed_mesh ends before %.1f, %.1f, where the switch lay: what was"
                " taken off is the height of its rim; check the first layer"
                % self.point[:2]
            )
        if self.is_mesh_elsewhere():
            option = self.features.mesh_zero_option()
            yield (
                "bed_mesh has no zero at %.1f, %.1f, where the switch lay: one that"
                " is probed or loaded now makes Z=0 wrong by its height there; set"
                " its %s to that point, probe it, and calibrate again"
                % (self.point[:2] + (option,))
            )
        if abs(self.rest) >= LARGEST_REST:
            yield (
                "another feature shifts Z by %.3f mm there: not taken off; check"
                " the first layer" % (self.rest,)
            )
