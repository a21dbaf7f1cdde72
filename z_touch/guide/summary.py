# What Z_CALIBRATION_SETUP has found out, and what of it is saved.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import math

from ..core.sampling import AUTO
from . import steps
from .head import PLACES

# More (mm) than this is another place
SAME_PLACE = 0.01


def near(a, b):
    return math.hypot(a.x - b.x, a.y - b.y) <= SAME_PLACE


# What the last touches say
def found(state):
    samples = state.samples
    if not samples:
        return ""
    name = [site for site in PLACES if site in samples][-1]
    text = "The %s repeats within %.4f mm."
    text %= (name, max(samples[name]) - min(samples[name]))
    if len(samples) == len(PLACES):
        text += " All in all: %s; samples: %d is enough."
        text %= steps.repeatability(list(samples.values()))
    return text


# What differs from the section, as pairs of option and text
def values(ways, state):
    settings, places = ways.module.settings, ways.places()
    sites, found = state.sites, []
    old_switch = places.switch_site(
        sites["nozzle"], settings.switch_xy_position
    )
    x, y = ways.host.probing.offsets()[:2]
    for name, old in (
        ("nozzle", settings.nozzle_xy_position),
        ("switch", old_switch),
        ("bed", places.bed_site(settings.bed_xy_position)),
    ):
        site = sites[name]
        if old is not None and near(old, site):
            continue
        if name == "bed":
            site = site._replace(x=site.x + x, y=site.y + y)
        found.append((name + "_xy_position", steps.as_pair(site)))
    found.append(("switch_offset", "%.3f" % (state.switch_offset,)))
    travel_z = ways.travel_z(state)
    is_higher = travel_z > settings.safe_z_height or settings.unmeasured_pin
    if settings.position_endstop is None and is_higher:
        # CALIBRATE_Z does not know how high that pin is
        found.append(("safe_z_height", "%.1f" % (travel_z + 0.05,)))
    count = steps.repeatability(list(state.samples.values()))[1]
    own = (settings.pin.samples, settings.probe.samples)
    if AUTO not in own and min(own) < count:
        found.append(("samples", "%d" % (count,)))
    return found


# The same in words: what SAVE_CONFIG writes, and what it cannot
def summary(ways, state, saver):
    saved, not_saved = [], ""
    for option, text in values(ways, state):
        line = "%s: %s" % (option, text)
        place = saver.obstacle(ways.host.section, option)
        if place:
            not_saved += " SAVE_CONFIG cannot: write '%s' into %s." % (
                (line, place)
            )
        else:
            saved.append(line)
    return {"values": "; ".join(saved), "not_saved": not_saved}
