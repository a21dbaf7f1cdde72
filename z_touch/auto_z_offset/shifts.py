# What Klipper's own features shift where AUTO_Z_CALIBRATE has measured.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# The correction makes the gap right as long as Z is shifted there by where the probe
# says that the bed is, and by nothing else: by 0 after homing with it, by the
# height of its own mesh where that has no zero.
from __future__ import absolute_import, division

# From here on (mm) it is told: with the noise of both sensors on top, what is not told
# is less than 0.02.
WORTH_TELLING = 0.015

# Less (mm) is rounding.
NO_SHIFT = 0.0005


# What the user is told of the gap at a point; empty: it is right.  'site': the
# nozzle's touching.Site; 'results': heights.Result of all cycles.
def wrong_gap(host, site, results):
    if host.features.is_mesh_guessed(site.x, site.y):
        return (
            "bed_mesh ends before %.1f, %.1f, and its zero is elsewhere: nobody"
            " knows by how much the gap is wrong; a bed mesh has to be zero where"
            " Z is homed, or nowhere" % (site.x, site.y)
        )
    seen = sum(r.probe - r.probe_z_offset for r in results) / len(results)
    parts = [
        part
        for part in host.features.parts(
            site.x, site.y, results[0].sensor, bed_z=seen
        )
        if abs(part.height) >= NO_SHIFT
    ]
    shift = sum(part.height for part in parts)
    wrong = shift - (seen - host.probing.homed_bed_z())
    # Without any part it is homing that is old, and that is told by itself
    if not parts or abs(wrong) < WORTH_TELLING:
        return ""
    return (
        "%s: Z is shifted by %.3f mm here, and the probe sees the bed at %.3f:"
        " the gap is wrong by %.3f mm; a bed mesh has to be zero where Z is"
        " homed, or nowhere; correct that, or the first layer where something"
        " else shifts Z"
        % (", ".join(part.name for part in parts), shift, seen, wrong)
    )
