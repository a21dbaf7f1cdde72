# A picture of a history: one SVG without scripts, for light and dark pages.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#   python3 -m z_touch.history.report history.jsonl [report.svg]
#
# from the folder in which z_touch stands.
from __future__ import absolute_import, division

import logging
import os
import re
import sys
import time

from ..core.sampling import summarize
from . import trend
from .file import SITES, parse, pause, replace
from .svg import GAP, LEFT, Curve, Page, Plot, day

# The newest reports are kept
KEPT = 10
NAME = "report-%s.svg"

USAGE = "python3 -m z_touch.history.report history.jsonl [report.svg]\n"

# Points that a noisy curve is smoothed to
SMOOTH = 60

SITE_COLOURS = tuple(zip(SITES, "abc"))


def draw(page, title, curves, runs, marks=()):
    curves = [c for c in curves if any(v is not None for v in c.values)]
    values = [v for c in curves for v in c.values if v is not None]
    values += [v for c in curves for pair in c.band or () if pair for v in pair]
    if not values:
        return
    page.pause()
    plot = Plot(page, len(runs), min(values), max(values))
    plot.frame(title, dates_of(runs))
    if len(curves) > 1:
        plot.legend(curves)
    for curve in curves:
        page.pause()
        plot.curve(curve)
    for number in marks:
        plot.cross(number)


# At both ends and in the middle, each once
def dates_of(runs):
    first, middle, last = [
        day(runs[i]["time"]) for i in (0, len(runs) // 2, -1)
    ]
    if first == last:
        return [first, "", ""]
    return [first, "" if middle in (first, last) else middle, last]


# Of good runs only
def values_of(runs, value):
    return [value(run) if run["ok"] else None for run in runs]


# In um, each the mean of the values up to it where there are many
def smooth(values, pause):
    count, means = max(1, len(values) // SMOOTH), []
    for i in range(len(values)):
        if i % 100 == 0:
            pause()
        part = values[max(0, i + 1 - count) : i + 1]
        part = [1000.0 * v for v in part if v is not None]
        means.append(sum(part) / len(part) if part else None)
    return means


# Around the fingerprint, since nozzle and probe are the ones they are
def band_of(runs, pause):
    (middle, sigma, _), since, _ = trend.summarize_runs(runs, pause)
    if middle is None:
        return None
    far = max(trend.FAR_SIGMA * sigma, trend.FAR)
    band, good = [], 0
    for run in runs:
        there = good >= since
        band.append((middle - far, middle + far) if there else None)
        good += run["ok"]
    return band


def around(values, widths):
    return [
        None if v is None or w is None else (v - w, v + w)
        for v, w in zip(values, widths)
    ]


def draw_runs(page, runs):
    refused = [i for i, run in enumerate(runs) if not run["ok"]]
    offsets = values_of(runs, lambda run: run["offset"])
    widths = [run.get("uncertainty") for run in runs]
    curve = Curve("offset", "a", offsets, around(offsets, widths))
    title = "Offset (mm), where it is with 95 %; crosses: refused"
    draw(page, title, [curve], runs, refused)
    for site, colour in SITE_COLOURS:
        heights = values_of(runs, trend.height(site))
        title = "Height of the %s (mm)" % (site,)
        draw(page, title, [Curve(site, colour, heights, None)], runs)
    bodies = values_of(runs, trend.body)
    curve = Curve("switch - nozzle", "a", bodies, band_of(runs, page.pause))
    title = "Switch - nozzle (mm), and how far it may depart"
    draw(page, title, [curve], runs)
    curves = [
        Curve(s, c, smooth(values_of(runs, trend.spread(s)), page.pause), None)
        for s, c in SITE_COLOURS
    ]
    title = "Spread of each site (um)"
    if len(runs) >= 2 * SMOOTH:
        title += ", over %d runs" % (len(runs) // SMOOTH,)
    draw(page, title, curves, runs)
    curves = [
        Curve(
            name,
            colour,
            [run.get("temperatures", {}).get(key) for run in runs],
            None,
        )
        for name, key, colour in (
            ("nozzle", "extruder", "b"),
            ("bed", "heater_bed", "c"),
        )
    ]
    draw(page, "Temperatures (C)", curves, runs)


def draw_reasons(page, runs):
    refused = [run for run in runs if not run["ok"]]
    if refused:
        page.line("h", "Refused: %d, the last ones" % (len(refused),))
    for run in reversed(refused[-6:]):
        text = "%s: %s" % (day(run["time"]), run.get("reason"))
        page.line("s", text, 4)


def draw_summary(page, runs):
    page.y = GAP
    page.text(LEFT - 48, page.y + 6, "t", "Z calibration")
    page.y += 8
    good = [run for run in runs if run["ok"]]
    text = "%d runs, %s to %s" % (
        len(runs),
        day(runs[0]["time"]),
        day(runs[-1]["time"]),
    )
    page.line("s", text)
    if good:
        last, width = good[-1], good[-1].get("uncertainty")
        text = "last offset %.3f mm" % (last["offset"],)
        if width is not None:
            text += " +-%.3f (95 %%)" % (width,)
        page.line("", text)
    page.y += GAP


# The samples of each cycle of an accuracy run
def draw_cycles(page, record):
    cycles = record["cycles"]
    text = "Accuracy run of %s: %d cycles" % (day(record["time"]), len(cycles))
    page.line("h", text)
    page.line("s", record.get("verdict") or "", 4)
    page.y += GAP
    for site, colour in SITE_COLOURS:
        page.pause()
        all_samples = [cycle.get(site) or [] for cycle in cycles]
        flat = [z for samples in all_samples for z in samples]
        if not flat:
            continue
        middle = summarize(flat, "median")
        plot = Plot(
            page,
            len(cycles),
            1000.0 * (min(flat) - middle),
            1000.0 * (max(flat) - middle),
        )
        ends = ("cycle 1", "", "cycle %d" % (len(cycles),))
        text = "%s: samples about their median (um)" % (site.capitalize(),)
        plot.frame(text, ends)
        for number, samples in enumerate(all_samples):
            apart = min(3.0, plot.apart() / len(samples))
            for i, z in enumerate(samples):
                shift = (i - (len(samples) - 1) / 2.0) * apart
                plot.dot(
                    plot.x(number) + shift,
                    plot.y(1000.0 * (z - middle)),
                    colour,
                )


# The picture as text.  pause() is called often.
def svg(records, pause=trend.no_pause):
    page = Page(pause)
    runs = [r for r in records if "cycles" not in r]
    cycles = [r for r in records if "cycles" in r]
    if runs:
        draw_summary(page, runs)
        if cycles:
            draw_cycles(page, cycles[-1])
        draw_runs(page, runs)
        draw_reasons(page, runs)
    elif cycles:
        page.y = GAP
        draw_cycles(page, cycles[-1])
    else:
        page.line("", "There are no runs yet")
    return page.done()


# Beside the history; returns its path.  The oldest reports go.
def write(file, printer, pause=pause):
    records, _ = file.read()
    records = [r for r in records if r.get("printer") == printer]
    text = svg(records, pause)
    name = NAME % (time.strftime("%Y%m%d-%H%M%S", time.localtime()),)
    if not os.path.isdir(file.folder):
        os.makedirs(file.folder)
    path = os.path.join(file.folder, name)
    replace(path, text.encode("ascii"))
    old = re.compile(r"report-\d{8}-\d{6}\.svg$")
    names = [n for n in os.listdir(file.folder) if old.match(n) and n != name]
    for other in sorted(names)[: max(0, len(names) + 1 - KEPT)]:
        try:
            os.remove(os.path.join(file.folder, other))
        except OSError:
            logging.exception("report: %s stays", other)
    return path


def main(words):
    if len(words) not in (1, 2):
        sys.stderr.write(USAGE)
        return 2
    records = []
    with open(words[0], "rb") as f:
        for line in f.read().splitlines():
            records.append(parse(line))
    records = [record for record in records if record is not None]
    # Of several printers the one that ran last
    printer = records[-1].get("printer") if records else None
    records = [r for r in records if r.get("printer") == printer]
    folder = os.path.dirname(words[0])
    path = words[1] if words[1:] else os.path.join(folder, "report.svg")
    with open(path, "wb") as f:
        f.write(svg(records).encode("ascii"))
    sys.stdout.write(path + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
