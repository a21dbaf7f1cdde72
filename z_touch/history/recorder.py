# What a module writes into its history, and what users ask of it.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import logging
import os
import time

from ..core import options
from ..core.sampling import AUTO
from ..uncertainty import adaptive, cycles
from . import report
from .file import SITES, File, History, site_record

# Touches of each site in a cycle, where their number is not given, and cycles at
# most
CYCLE_SAMPLES = 3
MOST_CYCLES = 200

HEATERS = ("extruder", "heater_bed")


# The file in a folder beside printer.cfg, of so many lines at most; None: nothing
# is kept.
def find_file(printer, folder, runs):
    if folder is None:
        return None
    config_file = printer.get_start_args()["config_file"]
    beside = os.path.dirname(os.path.abspath(config_file))
    return File(os.path.join(beside, os.path.expanduser(folder)), runs)


# What CALIBRATE_Z_ACCURACY was asked for: how often, whether the probe is
# attached and Z homed each time, and how to touch
class Wanted(object):
    def __init__(self, gcmd, settings):
        count = options.param_int
        self.cycles = count(gcmd, "CYCLES", 10, minval=2, maxval=MOST_CYCLES)
        self.attach = bool(count(gcmd, "ATTACH", 1))
        self.home = bool(count(gcmd, "HOME", 0))
        if self.home and not self.attach:
            raise gcmd.error(
                "HOME=1 needs ATTACH=1: the probe is put away to home"
            )
        self.settings = settings._replace(
            pin=for_cycles(settings.pin), probe=for_cycles(settings.probe)
        )


# The spread is what is asked for, and a single touch has none
def for_cycles(sampling):
    samples = sampling.samples
    if samples in (AUTO, 1):
        samples = CYCLE_SAMPLES
    return sampling._replace(
        samples=samples, tolerance=float("inf"), result="average"
    )


class Recorder(object):
    def __init__(self, host, settings, version):
        self.host = host
        self.printer = host.printer
        self.version = version
        name = self.printer.get_start_args().get("config_file", "")
        self.history = History(
            self.printer.get_reactor(),
            find_file(self.printer, settings.history, settings.history_runs),
            os.path.basename(name),
            self.say,
        )
        # Of the run that is under way
        self.plan = None
        self.began = 0.0
        self.cleaned = ""
        register = self.printer.register_event_handler
        register("klippy:ready", self.history.begin)

    # When nothing is under way
    def say(self, text):
        self.host.gcode.respond_info("%s: %s" % (self.host.section, text))

    # What a run knows of its sites, for adaptive.Plan
    def make_plan(self, target):
        step = max(s.get_step_dist() for s in self.host.z_steppers())
        spreads = self.history.spreads()
        return adaptive.Plan(step, spreads, target)

    def begin(self, target):
        self.plan = self.make_plan(target)
        self.began = self.host.eventtime()
        self.cleaned = ""
        return self.plan

    # The one that has just ended, of CALIBRATE_Z_ACCURACY
    def cycle(self, switch_offset):
        samples = [self.plan.samples[site] for site in SITES]
        return cycles.Cycle(self.host.eventtime(), *samples + [switch_offset])

    def tell_cycles(self, gcmd, found):
        step = self.plan.step
        seconds = (self.host.eventtime() - self.began) / len(found)
        for line in cycles.tell(found, step, seconds):
            gcmd.respond_info("CALIBRATE_Z_ACCURACY: %s" % (line,))
        offsets = cycles.offsets(found)
        self.add(
            ok=True,
            reason="",
            offset=round(sum(offsets) / len(offsets), 6),
            uncertainty=round(cycles.uncertainty(found, step), 6),
            switch_offset=found[-1].switch_offset,
            warnings=[],
            verdict=cycles.judge(found).text,
            cycles=[
                dict(
                    (site, [round(z, 6) for z in getattr(cycle, site)])
                    for site in SITES
                )
                for cycle in found
            ],
        )
        if self.history.file is not None:
            self.draw()

    # 'last': what the module keeps of it
    def good(self, last):
        worth = last.uncertainty
        self.add(
            ok=True,
            reason="",
            offset=round(last.result.offset, 6),
            uncertainty=None if worth is None else round(worth, 6),
            switch_offset=last.result.switch_offset,
            z_adjust=last.z_adjust,
            warnings=list(last.warnings),
        )

    def refused(self, error):
        self.add(ok=False, reason=error)

    # Nothing that goes wrong here may fail a run
    def add(self, **fields):
        try:
            reason = " ".join(str(fields["reason"]).split())
            fields.update(self.common(), reason=reason)
            self.history.add(fields)
        except Exception:
            logging.exception("%s: no record of this run", self.host.section)

    def common(self):
        plan, now = self.plan, self.host.eventtime()
        sites, retries = {}, 0
        for site in SITES:
            if site in plan.estimates:
                samples, z = plan.samples[site], plan.estimates[site].z
                sites[site] = site_record(samples, z, plan.step)
                retries += len(plan.touches[site]) - len(samples)
        return {
            "time": round(time.time(), 1),
            "revision": self.version,
            "duration": round(now - self.began, 2),
            "temperatures": self.temperatures(now),
            "sites": sites,
            "retries": retries,
            "cleaned": self.cleaned,
        }

    def temperatures(self, now):
        found = {}
        for name in HEATERS:
            heater = self.printer.lookup_object(name, None)
            if heater is not None:
                status = heater.get_status(now)
                found[name] = round(status["temperature"], 1)
        return found

    cmd_Z_CALIBRATION_REPORT_help = "Draw the history of the Z calibration"

    def cmd_Z_CALIBRATION_REPORT(self, gcmd):
        if self.history.file is None:
            raise gcmd.error(
                "%s: there is no history to report of: 'history' is none"
                % (self.host.section,)
            )
        self.draw()

    # In the thread of the history, after what it has to write
    def draw(self):
        self.history.in_thread(self.write_report)

    def write_report(self):
        file = self.history.file
        path = report.write(file, self.history.printer)
        self.history.later(self.say, "the report is %s" % (path,))
