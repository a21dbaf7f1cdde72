# What Z_CALIBRATION_SETUP tells of its touches, and what it saves.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import math

from ..core import touching
from . import steps
from .state import SITES


def near(a, b):
    return math.hypot(a.x - b.x, a.y - b.y) <= touching.SAME_SITE


# How well the last touches repeat, in a sentence; empty before the first ones
def repeats(state):
    samples = state.samples()
    if not samples:
        return ""
    name = [site for site in SITES if site in samples][-1]
    spread = max(samples[name]) - min(samples[name])
    last = "The %s repeats within %.4f mm." % (name, spread)
    if len(samples) < len(SITES):
        return last
    text, _ = steps.repeatability(list(samples.values()))
    return "%s\nAll in all: %s." % (last, text)


# Collects what of the State has to be saved.
class Summary:
    # 'section': interface.Interface; 'head': head.GuidedHead; 'saver':
    # saving.Saver
    def __init__(self, section, head, saver):
        self.section = section
        self.host = section.host
        self.head = head
        self.saver = saver

    # What differs from the section, as pairs of option and text
    def values(self, state):
        settings = self.section.settings()
        values = self.sites(state)
        values.append(("switch_offset", "%.3f" % (state.switch_offset.value,)))
        travel_z = self.head.travel_z(state)
        is_higher = travel_z > settings.safe_z_height or settings.unmeasured_pin
        if settings.position_endstop is None and is_higher:
            # CALIBRATE_Z does not know how high that pin is
            values.append(("safe_z_height", "%.1f" % (travel_z + 0.05,)))
        count = steps.repeatability(list(state.samples().values()))[1]
        samples = self.section.proposed_samples(count)
        if samples:
            values.append(("samples", samples))
        return values

    # The sites that are others than those of the section
    def sites(self, state):
        settings, finder = self.section.settings(), self.section.site_finder()
        configured = (
            settings.nozzle_xy_position,
            finder.switch_site(
                state.sites["nozzle"], settings.switch_xy_position
            ),
            finder.bed_site(settings.bed_xy_position),
        )
        values, (x, y) = [], self.host.probing.offsets()[:2]
        for name, old in zip(SITES, configured):
            site = state.sites[name]
            if old is not None and near(old, site):
                continue
            if name == "bed":
                # The option is a point of the bed, the site one of the head
                site = site._replace(x=site.x + x, y=site.y + y)
            values.append((name + "_xy_position", steps.as_pair(site)))
        return values

    # What of that SAVE_CONFIG writes, and what has to be written by hand
    def facts(self, state):
        return self.saver.facts(self.host.section, self.values(state))

    # Returns when it is written, and klippy about to restart
    def save(self, state):
        self.saver.finish(self.host.section, self.values(state))
