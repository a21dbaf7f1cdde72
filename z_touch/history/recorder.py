# What [z_calibration] writes into its history, and what users ask of it.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import functools
import logging
import os
import time

from ..core.sampling import summarize
from ..uncertainty import adaptive, cycles
from . import asking, report, trend
from .file import SITES, File, History, as_text, site_record

HEATERS = ("extruder", "heater_bed")


# The whole path of printer.cfg
def find_config(printer):
    path = printer.get_start_args().get("config_file", "")
    return os.path.abspath(os.path.expanduser(path))


# The file in a folder beside printer.cfg, of so many lines at most; None: nothing
# is kept.
def find_file(config_file, folder, runs):
    if folder is None:
        return None
    beside = os.path.dirname(config_file)
    path = os.path.join(beside, os.path.expanduser(folder))
    return File(path, runs, as_text(config_file))


# Of a run that is under way: when it began (eventtime), its adaptive.Plan, and why
# the nozzle was cleaned.
class Recorder:
    # 'settings' name the folder; 'version' of the modules; begun() is called when the
    # runs of before are known, after klippy is ready
    def __init__(self, host, settings, version, begun):
        self.host = host
        self.printer = host.printer
        self.version = version
        self.keeps_times = settings.history_times
        config_file = find_config(self.printer)
        self.history = History(
            self.printer.get_reactor(),
            find_file(config_file, settings.history, settings.history_runs),
            as_text(config_file),
            self.say,
            begun,
        )
        self.plan = None
        # Of the section (mm), and PLATE of the command
        self.bed_spread, self.plate = 0.0, ""
        self.began = 0.0
        self.cleaned = ""
        register = self.printer.register_event_handler
        register("klippy:ready", self.history.begin)

    # By how much (mm) switch - nozzle departs from the runs with this extruder that
    # were as hot as it is now; 0: not by more than chance.
    def departure(self, body):
        as_hot = {"temperatures": self.temperatures(self.host.eventtime())}
        history, tool = self.history, self.host.extruder()
        runs = trend.of_tool(history.runs, tool)
        bodies = trend.bodies_as_hot(runs, history.summary(tool), as_hot)
        return trend.departure(body, bodies)

    # Of the history, for the status of the section
    def status(self):
        return self.history.status

    # The records that are kept, the oldest first
    def runs(self):
        return self.history.runs

    # When nothing is under way
    def say(self, text):
        self.host.gcode.respond_info("%s: %s" % (self.host.section, text))

    # What a run knows of its sites.  'counting': adaptive.FixedCount or Automatic;
    # 'bed_spread' as in the section (mm)
    def make_plan(self, counting, bed_spread=0.0):
        spreads = self.history.spreads(bed_spread)
        rough = ("bed",) if bed_spread else ()
        return adaptive.Plan(self.host.axes.z_step(), spreads, counting, rough)

    def begin(self, counting, bed_spread=0.0, plate=""):
        self.bed_spread = bed_spread
        self.plan = self.make_plan(counting, bed_spread)
        self.plate = as_text(plate)
        self.began = self.host.eventtime()
        self.cleaned = ""
        return self.plan

    # All is measured once more, after the nozzle was found dirty
    def begin_again(self):
        self.plan = self.make_plan(self.plan.counting, self.bed_spread)
        return self.plan

    def note_cleaning(self, why):
        self.cleaned = why

    # The cycles.Cycle that has just ended
    def cycle(self, switch_offset):
        samples = [self.plan.samples[site] for site in SITES]
        return cycles.Cycle(self.host.eventtime(), *samples + [switch_offset])

    # CALIBRATE_Z_ACCURACY has ended; 'measured': its cycles.Cycle
    def tell_cycles(self, gcmd, measured):
        step = self.plan.step
        seconds = (self.host.eventtime() - self.began) / len(measured)
        for line in cycles.tell(measured, step, seconds):
            gcmd.respond_info("CALIBRATE_Z_ACCURACY: %s" % (line,))
        offsets, judged = cycles.offsets(measured), cycles.judge(measured, step)
        self.add(
            ok=True,
            reason="",
            offset=round(sum(offsets) / len(offsets), 6),
            uncertainty=round(cycles.uncertainty(measured, step), 6),
            switch_offset=measured[-1].switch_offset,
            warnings=[],
            cause=judged.cause,
            verdict=judged.text,
            cycles=[
                dict(
                    (site, [round(z, 6) for z in getattr(cycle, site)])
                    for site in SITES
                )
                for cycle in measured
            ],
        )
        if self.history.file is not None:
            self.draw()

    # The last good run with the extruder that is active: toolhead Z (mm) of each site,
    # and its switch_offset; None: there is none
    def last_good(self):
        own = trend.of_tool(self.history.runs, self.host.extruder())
        for run in reversed(own):
            if run["ok"]:
                heights = {site: run["sites"][site]["z"] for site in SITES}
                return dict(heights, switch_offset=run["switch_offset"])
        return None

    # X, Y (mm) of the last good run that has met the pin with the probe on the head;
    # None: none has
    def nozzle_at(self):
        for run in reversed(self.history.runs):
            if run["ok"] and run.get("nozzle_at"):
                return run["nozzle_at"]
        return None

    # CALIBRATE_Z has ended well.  'last' has the result, its uncertainty, z_adjust,
    # nozzle_at and warnings, each with 'about' and 'text'.
    def good(self, last):
        worth = last.uncertainty
        self.add(
            ok=True,
            reason="",
            nozzle_at=last.nozzle_at
            and [round(xy, 3) for xy in last.nozzle_at],
            offset=round(last.result.offset, 6),
            uncertainty=None if worth is None else round(worth, 6),
            switch_offset=last.result.switch_offset,
            z_adjust=last.z_adjust,
            warnings=[dict(warning._asdict()) for warning in last.warnings],
        )

    def refused(self, error):
        self.add(ok=False, reason=error)

    # Nothing that goes wrong here may fail a run
    def add(self, **fields):
        try:
            reason = " ".join(as_text(fields["reason"]).split())
            fields.update(self.common(), reason=reason)
            self.history.add(fields)
        except Exception:
            logging.exception("%s: no record of this run", self.host.section)

    # What a record has of good and of refused runs
    def common(self):
        plan, eventtime = self.plan, self.host.eventtime()
        sites, retries = {}, 0
        for site in SITES:
            if plan.touches.get(site):
                sites[site] = self.site_of(site)
                retries += len(plan.touches[site]) - len(sites[site]["samples"])
        return {
            "time": round(time.time(), 1) if self.keeps_times else 0.0,
            "plate": self.plate,
            "extruder": self.host.extruder(),
            "bed_spread": self.bed_spread,
            "revision": self.version,
            "duration": round(eventtime - self.began, 2),
            "temperatures": self.temperatures(eventtime),
            "sites": sites,
            "retries": retries,
            "cleaned": self.cleaned,
            "dirty": bool(plan.flattened("nozzle")),
        }

    # Where the touches of a site did not agree, all that is known of it
    def site_of(self, site):
        plan, touches = self.plan, self.plan.touches[site]
        samples, z = touches, summarize(touches, "average")
        if site in plan.estimates:
            samples, z = plan.samples[site], plan.estimates[site].z
        earlier = plan.earlier_at(site)
        points = plan.points if site == "bed" else []
        return site_record(samples, z, plan.step, touches, earlier, points)

    # Of bed and nozzle, by the names of HEATERS (C): that of the extruder that is active
    def temperatures(self, eventtime):
        active = {"extruder": self.host.extruder() or "extruder"}
        heaters = [
            (name, self.printer.lookup_object(active.get(name, name), None))
            for name in HEATERS
        ]
        return {
            name: round(heater.get_status(eventtime)["temperature"], 1)
            for name, heater in heaters
            if heater is not None
        }

    cmd_Z_CALIBRATION_REPORT_help = (
        "Draw the history of the Z calibration, and write what to attach"
    )

    def cmd_Z_CALIBRATION_REPORT(self, gcmd):
        if self.history.file is None:
            raise gcmd.error(
                "%s: there is no history to report of: 'history' is none; name"
                " a folder there" % (self.host.section,)
            )
        self.draw(self.asked())

    # compose() of what somebody who is asked wants to know: in the thread, where
    # nothing that is wrong with it ends a command
    def asked(self):
        name, eventtime = self.host.section, self.host.eventtime()
        configfile, section = map(
            self.printer.lookup_object, ("configfile", name)
        )
        version = self.printer.get_start_args().get("software_version", "?")
        return functools.partial(
            asking.compose,
            name,
            [("z_calibration", self.version), ("Klipper", version)],
            configfile.get_status(eventtime)["settings"],
            section.get_status(eventtime),
            list(self.history.runs),
        )

    # In the thread of the history, after what it has to write
    def draw(self, compose=None):
        self.history.in_thread(self.write_report, compose)

    # With the text to attach, if any
    def write_report(self, compose=None):
        path = report.write(self.history.file, self.history.printer)
        self.history.later(self.say, "the report is %s" % (path,))
        if compose is not None:
            path = asking.write(path, compose())
            self.history.later(
                self.say,
                "attach %s when you ask somebody: it has your options and the"
                " last runs, and names no person, computer or folder" % (path,),
            )
