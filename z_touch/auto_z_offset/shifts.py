# What Klipper's own features shift where AUTO_Z_CALIBRATE has measured.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# The correction makes the gap right as long as Z is shifted there by where the probe
# says that the bed is, and by nothing else: by 0 after homing with it, by the
# height of its own mesh where that has no zero.

# From here on (mm) it is told: with the noise of both sensors on top, what is not told
# is less than 0.02.
WORTH_TELLING = 0.015

# Less (mm) is rounding.
NO_SHIFT = 0.0005


# What shifts Z at a site, by what is worth a word; see features.parts()
def parts_at(host, site, z, **known):
    parts = host.transforms.parts(site.x, site.y, z, **known)
    return [part for part in parts if abs(part.height) >= NO_SHIFT]


# What the user is told where the bed sensor has set Z, the bed at 'z' (mm) now; empty:
# the gap is right, and stays so.  Here it counts from the bed, not from the probe.
def wrong_zero(host, site, z):
    parts, features = parts_at(host, site, z), host.transforms
    shift = sum(part.height for part in parts)
    if abs(shift) >= WORTH_TELLING:
        return (
            "%s: Z is shifted by %.3f mm here, and the gap is wrong by that; clear"
            " it before AUTO_Z_HOME_Z, or use AUTO_Z_CALIBRATE"
            % (", ".join(part.name for part in parts), shift)
        )
    if features.has_mesh_section() and not features.is_mesh_zero(
        site.x, site.y
    ):
        return (
            "bed_mesh has no zero at %.1f, %.1f: one that is probed or loaded now"
            " makes the gap wrong by its height there; set its %s to that point"
            % (site.x, site.y, features.mesh_zero_option())
        )
    return ""


# What the user is told of a bed mesh with a zero of its own where Z is not homed with
# the probe: there it takes off nothing of what the probe says of the bed; empty: it is
# none.
def wrong_mesh(host):
    features = host.transforms
    if host.axes.homes_with_probe() or features.mesh_zero() is None:
        return ""
    return (
        "Z is homed without the probe, and the bed mesh has a zero of its own: the"
        " gap is wrong by the height at which the probe sees the bed there; remove"
        " %s from section 'bed_mesh', and probe the mesh again"
        % (features.mesh_zero_option(),)
    )


# What the user is told of the gap at a point; empty: it is right.  'site': the
# nozzle's touching.Site; 'results': heights.Result of all cycles.
def wrong_gap(host, site, results):
    if host.transforms.is_mesh_guessed(site.x, site.y):
        return (
            "bed_mesh ends before %.1f, %.1f, and its zero is elsewhere: nobody"
            " knows by how much the gap is wrong; a bed mesh has to be zero where"
            " Z is homed, or nowhere" % (site.x, site.y)
        )
    seen = sum(r.probe - r.probe_z_offset for r in results) / len(results)
    parts = parts_at(host, site, results[0].sensor, bed_z=seen)
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
