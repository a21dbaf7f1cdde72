# What is known of common switches of probes.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

# From the body to the trigger point (mm): the least of any healthy switch of that
# kind, by the limits of its operating position and the height of its body (a D2F
# has 5.5 +-0.3 over 5.0).  With a larger one the nozzle would be inside the bed for
# some of them; with this one Z=0 is at the bed or above it.
SWITCHES = collections.OrderedDict((("D2F", 0.2), ("SSG", 0.2)))

# How to come down from there
COME_DOWN = (
    "come down with paper after CALIBRATE_Z (CALCULATE_SWITCH_OFFSET), or with"
    " baby steps and Z_CALIBRATION_SAVE_GCODE_OFFSET"
)


# What the user is told with a switch_offset (mm) of that list; empty: with one that
# he has measured, or where an earlier run had it, too.  'runs': records of the
# history; 'before': the heights.Result before this one, or None.
def reminder(switch_offset, runs, before):
    told = [run.get("switch_offset") for run in runs if run.get("ok")]
    if before is not None:
        told.append(before.switch_offset)
    if switch_offset not in SWITCHES.values() or switch_offset in told:
        return ""
    return (
        "switch_offset=%.3f is the least that a healthy switch has, so Z=0 is too"
        " high on purpose, by up to some tenths of a millimetre; %s"
        % (switch_offset, COME_DOWN)
    )
