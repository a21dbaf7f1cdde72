# A picture of a history: one SVG without scripts, for light and dark pages.
# Its texts are no messages: they are drawn.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#   python3 -m z_touch.history.report history.jsonl [report.svg]
#
# from the folder in which z_touch stands.  From the top: what to do, the touches of
# the last run, then the runs over days, with marks where something was told.

import logging
import math
import os
import re
import sys
import time

from ..core.sampling import summarize
from ..uncertainty.estimate import pool
from . import svg as drawing
from . import trend, verdict
from .days import axis_of, day, minute
from .file import SITES, parse, pause, replace, spreads_in
from .svg import BELOW, EDGE, GAP, LEFT, RIGHT, WIDTH, Curve, Page, Plot

# The newest reports are kept
KEPT = 10
NAME = "report-%s.svg"

USAGE = "python3 -m z_touch.history.report history.jsonl [report.svg]\n"

# A noisy curve is the mean of so many runs, or more where it would have more points
SMOOTH_RUNS, SMOOTH_POINTS = 5, 60

# Marks that are drawn, the latest
MARKS = 9

# Plates that have curves of their own, and letters of their names
PLATE_COLOURS = "abc"
PLATE_LETTERS = 8

# Lines of one text of the verdict, and such texts
LINES, TEXTS = 4, 4

# What a plot spans at least: less is noise of a good printer.  mm, um, um, C
LEAST_HEIGHT, LEAST_SPREAD, LEAST_OFF, LEAST_HEAT = 0.04, 10.0, 10.0, 20.0

# The largest circle around a touch of the bed, in units of the picture
LARGEST_CIRCLE = 8.0

# Micrometres
UM = "\xb5m"

SITE_COLOURS = tuple(zip(SITES, "abc"))


######################################################################
# What to do
######################################################################


# 'cycles': the accuracy run that was the last thing, or None
def draw_head(page, records, runs, cycles, printer):
    page.y = GAP - 4
    page.line("Z calibration", more='font-size="19" font-weight="600"')
    if printer:
        # Where two are alike, their folders are not
        lack = len(printer) - drawing.LETTERS + 4
        text = "..." + printer[lack:] if lack > 0 else printer
        page.line(text, "soft")
    page.line("; ".join(facts(records, runs)), "soft", most=2)
    page.y += 8
    draw_verdict(page, verdict.judge(runs, cycles, page.pause))


# How many runs from when to when, and whose
def facts(records, runs):
    if runs:
        days = sorted(set(day(run) for run in (runs[0], runs[-1])))
        yield "%d runs, %s" % (len(runs), " to ".join(days))
        tools = set(trend.tool(run) for run in records)
        if len(tools - {""}) > 1:
            yield "with %s" % (trend.tool(runs[-1]),)
    revision = records[-1].get("revision") if records else None
    if revision:
        yield "z_calibration %s" % (revision,)


# A box with a bar in the colour of the word
def draw_verdict(page, judged):
    begin, top, colour = len(page.parts), page.y, judged.level
    page.y += 6
    head = 'font-size="16" font-weight="700"'
    page.line(judged.level.capitalize(), colour, head, x=EDGE + 18)
    for text in judged.texts[:TEXTS]:
        page.line(text, most=LINES, x=EDGE + 18)
    more = len(judged.texts) - TEXTS
    if more > 0:
        page.line("And %d more." % (more,), "soft", x=EDGE + 18)
    page.y += 12
    box = []
    for width, opacity in ((WIDTH - 2 * EDGE, 0.1), (6, 1.0)):
        box.append(
            '<rect x="%d" y="%.1f" width="%d" height="%.1f" %s'
            ' fill-opacity="%g"/>'
            % (EDGE, top, width, page.y - top, drawing.fill(colour), opacity)
        )
    page.parts[begin:begin] = box


######################################################################
# The last run
######################################################################


# 'runs': it is the last of them
def draw_last(page, runs):
    last = runs[-1]
    text = "Last run, %s" % (minute(last),)
    if last["ok"]:
        text += ": offset %.3f mm" % (last["offset"],)
        if last.get("uncertainty") is not None:
            text += " +-%.3f (95 %%)" % (last["uncertainty"],)
    else:
        text += ": refused"
    page.title(text)
    page.line(
        "Touches in %s about the height that counts; hollow: rejected; band:"
        " usual spread (95 %%)" % (UM,),
        "soft",
    )
    page.y += 12
    wide = (WIDTH - RIGHT - LEFT + 48) / 3.0
    radius = trend.bed_spread(last)
    usual = [usual_spread(runs[:-1], site, radius) for site in SITES]
    offs = [offsets_of(last["sites"].get(site)) for site in SITES]
    # One scale for the three, so that they can be compared
    end = 1.08 * max([LEAST_OFF] + usual + [abs(v) for o in offs for v in o])
    for number, (site, colour) in enumerate(SITE_COLOURS):
        left = LEFT + number * wide
        box = (left, left + wide - 48)
        xs = [(i + 0.5) / len(offs[number]) for i in range(len(offs[number]))]
        plot = Plot(page, xs, -end, end, box)
        plot.frame(site.capitalize())
        record = last["sites"].get(site)
        if offs[number]:
            draw_touches(plot, offs[number], record, usual[number], colour)
        else:
            plot.below("not measured")
    page.y += drawing.TITLE + drawing.PLOT + BELOW
    draw_points(page, last["sites"].get("bed"), offs[-1], box)


# With bed_spread: where each touch of the bed was, and how high (um about the height
# that counts).  'box': left and right end
def draw_points(page, record, offs, box):
    points = (record or {}).get("points", [])
    if not points or len(points) != len(offs):
        return
    page.y += GAP
    plan, most = drawing.Plan(page, points, box), max(map(abs, offs)) or 1.0
    plan.frame()
    radii = [LARGEST_CIRCLE * math.sqrt(abs(v) / most) for v in offs]
    for is_high, attributes in (
        (True, drawing.fill("c")),
        (False, drawing.stroke("c", 1.5)),
    ):
        chosen = [i for i, v in enumerate(offs) if (v > 0) == is_high]
        plan.circles(
            [points[i] for i in chosen], [radii[i] for i in chosen], attributes
        )
    text = "Where the bed was touched (mm), which is as rough as that:"
    page.line(text)
    page.line(
        "full: higher than the height that counts; hollow: lower;", "soft"
    )
    page.line("the largest circle: by %.1f %s" % (most, UM), "soft")
    page.y = plan.top + plan.side + BELOW


# 1.96 standard deviations of a touch in earlier runs with that bed_spread (mm), in
# um; 0: nobody knows
def usual_spread(earlier, site, bed_spread):
    pooled = pool(spreads_in(earlier, site, bed_spread))
    return 1960.0 * math.sqrt(pooled.variance) if pooled.dof else 0.0


# All touches of a site about its height (um)
def offsets_of(record):
    if not record or not record["samples"]:
        return []
    touches = record.get("touches") or record["samples"]
    return [1000.0 * (touch - record["z"]) for touch in touches]


def draw_touches(plot, offs, record, usual, colour):
    plot.strip(-usual, usual, colour)
    points = [(plot.x(i), plot.y(v)) for i, v in enumerate(offs)]
    samples = record["samples"]
    flags = counted(record.get("touches") or samples, samples)
    plot.dots([p for p, f in zip(points, flags) if f], colour, 4.0)
    plot.rings([p for p, f in zip(points, flags) if not f], colour)
    text = "z %.3f mm, sd %.1f %s"
    plot.below(text % (record["z"], 1000.0 * record["sd"], UM))


# Of each touch whether it is one of the samples, which are the latest
def counted(touches, samples):
    left, flags = list(samples), []
    for touch in reversed(touches):
        flags.append(touch in left)
        if touch in left:
            left.remove(touch)
    return flags[::-1]


######################################################################
# Over days
######################################################################


# Plots of the runs, one below the other.  'axis': days.Axis, 'flags': pairs of the
# number of a run and what stands in its flag.
class Runs:
    def __init__(self, page, runs, flags):
        self.page = page
        self.runs = runs
        self.flags = flags
        page.pause()
        self.axis = axis_of(runs)
        page.pause()

    # Returns the Plot, None where there is nothing to see.  'least': what it spans
    # in its own unit; 'zero': whether it begins there
    def draw(self, titles, curves, least, zero=False):
        page = self.page
        curves = [c for c in curves if any(v is not None for v in c.values)]
        values = [v for c in curves for v in c.values if v is not None]
        values += [v for c in curves for p in c.band or () if p for v in p]
        if not values:
            return None
        page.pause()
        ends = drawing.spanned(min(values), max(values), least)
        if zero:
            ends = drawing.from_zero(max(values), least)
        plot = Plot(page, self.axis.xs, *ends)
        plot.frame(*titles)
        plot.scale(self.axis.marks)
        if len(curves) > 1:
            plot.legend(curves)
        for number, _ in self.flags:
            plot.mark(number, "soft")
        for curve in curves:
            page.pause()
            plot.curve(curve)
        page.y = plot.bottom + BELOW + GAP
        return plot

    def values(self, value):
        return values_of(self.runs, value)

    # Of what depends on the plate: one for each, where the command has named them
    def by_plate(self, curve):
        plates = ["%s" % (run.get("plate") or "",) for run in self.runs]
        names = sorted(set(plates))[: len(PLATE_COLOURS)]
        if len(names) < 2:
            return [curve]
        return [
            curve._replace(
                name=name[:PLATE_LETTERS] or "no plate",
                colour=colour,
                values=only(curve.values, plates, name),
                band=curve.band and only(curve.band, plates, name),
            )
            for name, colour in zip(names, PLATE_COLOURS)
        ]


# Where the plate is the one of that name
def only(values, plates, name):
    return [v if plate == name else None for v, plate in zip(values, plates)]


# Of good runs only
def values_of(runs, value):
    return [value(run) if run["ok"] else None for run in runs]


# In um, each the mean of the latest values up to it
def smooth(values, pause):
    count, means = max(SMOOTH_RUNS, len(values) // SMOOTH_POINTS), []
    for i in range(len(values)):
        if i % 100 == 0:
            pause()
        part = values[max(0, i + 1 - count) : i + 1]
        part = [1000.0 * v for v in part if v is not None]
        means.append(sum(part) / len(part) if part else None)
    return means


# Where switch - nozzle is not told, since nozzle and probe are the ones they are
def band_of(runs, pause):
    summary = trend.summarize_runs(runs, pause)
    fingerprint = trend.fingerprint_of(
        trend.bodies_as_hot(runs, summary, runs[-1])
    )
    if fingerprint.middle is None:
        return None
    far = trend.limit_as_hot(fingerprint)
    band, good = [], 0
    for run in runs:
        there = good >= summary.since
        ends = (fingerprint.middle - far, fingerprint.middle + far)
        band.append(ends if there else None)
        good += run["ok"]
    return band


def around(values, widths):
    return [
        None if v is None or w is None else (v - w, v + w)
        for v, w in zip(values, widths)
    ]


# The offset with its marks, and what these say
def draw_offsets(drawn, marks):
    page, runs = drawn.page, drawn.runs
    offsets = drawn.values(lambda run: run["offset"])
    widths = [run.get("uncertainty") for run in runs]
    curve = Curve("offset", "a", offsets, around(offsets, widths), True)
    page.pause()
    refused = [i for i, run in enumerate(runs) if not run["ok"]]
    cleaned = [i for i, run in enumerate(runs) if run.get("cleaned")]
    words = "band: 95 %"
    words += "; x: refused" if refused else ""
    words += "; triangle: cleaned" if cleaned else ""
    curves = drawn.by_plate(curve)
    plot = drawn.draw(("Offset (mm)", words), curves, LEAST_HEIGHT)
    if plot is None:
        return
    plot.signs(refused, "x", "act")
    plot.signs(cleaned, "v", "watch")
    for number, text in drawn.flags:
        plot.flag(number, text, "soft")
    page.y -= GAP - 4
    for number, text in drawn.flags:
        told = "; ".join(m.text for m in marks if m.number == number)
        text = "%s: %s, %s" % (text, day(runs[number]), told)
        page.line(text, most=2, x=LEFT)
    page.y += GAP - 4


# The latest runs at which something was told, with a number
def flags_of(marks):
    numbers = sorted(set(mark.number for mark in marks))[-MARKS:]
    return [(number, "%d" % (i + 1,)) for i, number in enumerate(numbers)]


def draw_runs(page, runs):
    marks = verdict.marks_of(runs, page.pause)
    drawn = Runs(page, runs, flags_of(marks))
    page.y += GAP
    draw_offsets(drawn, marks)
    bands = {"switch - nozzle": band_of(runs, page.pause)}
    for name, words, value, colour in HEIGHTS:
        title = "%s (mm)" % (name,)
        curve = Curve(
            name, colour, drawn.values(value), bands.get(name.lower()), True
        )
        curves = drawn.by_plate(curve) if value is probe else [curve]
        # The names of several are where these words would be
        titles = (title, words) if len(curves) == 1 else (title,)
        drawn.draw(titles, curves, LEAST_HEIGHT)
    curves = [
        Curve(
            s, c, smooth(drawn.values(trend.spread(s)), page.pause), None, True
        )
        for s, c in SITE_COLOURS
    ]
    count = max(SMOOTH_RUNS, len(runs) // SMOOTH_POINTS)
    titles = ("Spread of touches (%s)" % (UM,), "mean of %d runs" % (count,))
    drawn.draw(titles, curves, LEAST_SPREAD, True)
    heats = [
        Curve(name, colour, [heat(run, key) for run in runs], None, True)
        for name, key, colour in HEATS
    ]
    drawn.draw(("Temperatures (C)",), heats, LEAST_HEAT)


def heat(run, key):
    return run.get("temperatures", {}).get(key)


# How high the probe triggers above its body on the pin (mm)
def probe(run):
    return trend.height("bed")(run) - trend.height("switch")(run)


# Of a plot: its name, what it depends on, a value of a run (mm), colour
HEIGHTS = (
    (
        "Nozzle on the pin",
        "depends on homing, on the pin, on the nozzle",
        trend.height("nozzle"),
        "a",
    ),
    (
        "Switch - nozzle",
        "the same until one of them is exchanged, dirty or loose",
        trend.body,
        "b",
    ),
    (
        "Probe - switch",
        "depends on the bed and its plate, and on the probe's switch",
        probe,
        "c",
    ),
)
HEATS = (("nozzle", "extruder", "b"), ("bed", "heater_bed", "c"))


def draw_reasons(page, runs):
    refused = [run for run in runs if not run["ok"]]
    if not refused:
        return
    page.y -= GAP
    page.title("Refused: %d, the last ones" % (len(refused),))
    for run in reversed(refused[-6:]):
        text = "%s: %s" % (minute(run), run.get("reason"))
        page.line(text, "soft", most=4)


######################################################################
# An accuracy run
######################################################################


# The samples of each of its cycles
def draw_cycles(page, record):
    cycles = record["cycles"]
    text = "Accuracy run of %s: %d cycles" % (minute(record), len(cycles))
    page.title(text)
    page.line(record.get("verdict") or "", "soft", most=4)
    page.y += GAP
    for site, colour in SITE_COLOURS:
        page.pause()
        all_samples = [cycle.get(site) or [] for cycle in cycles]
        flat = [z for samples in all_samples for z in samples]
        if flat:
            draw_samples(page, site, colour, all_samples)


def draw_samples(page, site, colour, all_samples):
    flat = [z for samples in all_samples for z in samples]
    middle, count = summarize(flat, "median"), len(all_samples)
    offs = [1000.0 * (z - middle) for z in flat]
    ends = drawing.spanned(min(offs), max(offs), 20.0)
    xs = [(i + 0.5) / count for i in range(count)]
    plot = Plot(page, xs, *ends)
    plot.frame(
        "%s (%s)" % (site.capitalize(), UM), "samples about their median"
    )
    plot.scale([(xs[0], "cycle 1"), (xs[-1], "cycle %d" % (count,))][:count])
    apart = (WIDTH - RIGHT - LEFT - 14) / count
    for number, samples in enumerate(all_samples):
        between = min(4.0, apart / max(1, len(samples)))
        points = [
            (
                plot.x(number) + (i - (len(samples) - 1) / 2.0) * between,
                plot.y(1000.0 * (z - middle)),
            )
            for i, z in enumerate(samples)
        ]
        plot.dots(points, colour)
    page.y = plot.bottom + BELOW + GAP


######################################################################
# The picture
######################################################################


# The picture as text.  'printer' is told; pause() is called often.
def svg(records, pause=trend.no_pause, printer=""):
    page = Page(pause)
    runs = [r for r in records if "cycles" not in r]
    # Nozzles of two lengths are no change from run to run
    if runs:
        runs = trend.of_tool(runs, trend.tool(runs[-1]), pause)
    cycles = [r for r in records if r.get("cycles")]
    latest = cycles[-1] if cycles and cycles[-1] is records[-1] else None
    draw_head(page, records, runs, latest, printer)
    if latest is not None:
        draw_cycles(page, latest)
    if runs:
        draw_last(page, runs)
        draw_runs(page, runs)
        draw_reasons(page, runs)
    if cycles and latest is None:
        draw_cycles(page, cycles[-1])
    return page.done()


# Beside the history; returns its path.  The oldest reports go.
def write(file, printer, pause=pause):
    records, _ = file.read()
    records = [r for r in records if r.get("printer") == printer]
    text = svg(records, pause, printer)
    name = NAME % (time.strftime("%Y%m%d-%H%M%S", time.localtime()),)
    if not os.path.isdir(file.folder):
        os.makedirs(file.folder)
    path = os.path.join(file.folder, name)
    replace(path, text.encode("ascii"))
    drop_old(file.folder, name)
    return path


# All but the latest of each kind, picture and text; 'name' was just written
def drop_old(folder, name):
    for ending in (".svg", ".txt"):
        old = re.compile(r"report-\d{8}-\d{6}\%s$" % (ending,))
        names = [n for n in os.listdir(folder) if old.match(n) and n != name]
        for other in sorted(names)[: max(0, len(names) + 1 - KEPT)]:
            try:
                os.remove(os.path.join(folder, other))
            except OSError:
                logging.exception("report: %s stays", other)


# Whether a run is one of a printer's.  The first format has its name without folder.
def is_of(printer, run):
    if "format" not in run and printer:
        return run.get("printer") in (printer, os.path.basename(printer))
    return run.get("printer") == printer


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
    records = [r for r in records if is_of(printer, r)]
    folder = os.path.dirname(words[0])
    path = words[1] if words[1:] else os.path.join(folder, "report.svg")
    with open(path, "wb") as f:
        f.write(svg(records, printer=printer).encode("ascii"))
    sys.stdout.write(path + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
