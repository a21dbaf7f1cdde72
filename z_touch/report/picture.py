"""A picture of a history: one SVG without scripts, for light and dark pages.

From the top: what to do, the plots in which that is seen, tinted; the touches of the
last run, then the runs over days, with marks where something happened.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

# Its texts are no messages: they are drawn.

from __future__ import annotations

import math
from statistics import fmean, median
from typing import (
    Callable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ..z_calibration.runs import (
    BODY,
    SITES,
    Run,
    SiteRun,
    bodies_as_hot,
    first_of_now,
    spreads,
    usual,
)
from ..z_calibration.statistics import pool
from . import cycles, trend, verdict
from .days import Axis, axis_of, day, minute
from .svg import (
    BELOW,
    EDGE,
    GAP,
    LEFT,
    LETTERS,
    PLOT,
    RIGHT,
    TITLE,
    WIDTH,
    XY,
    Curve,
    Page,
    Plan,
    Plot,
    fill,
    from_zero,
    spanned,
    stroke,
)
from .verdict import Mark, Verdict

# A noisy curve is the mean of so many runs, or more where it would have more points
SMOOTH_RUNS, SMOOTH_POINTS = 5, 60

# Marks that are drawn, the latest
MARKS = 9

# Lines of one text of the verdict, and such texts
LINES, TEXTS = 4, 4

# Refused runs whose reasons are written, the latest
REASONS = 6

# What a plot spans at least: less is noise of a good printer.  mm, um, um, C
LEAST_HEIGHT, LEAST_SPREAD, LEAST_OFF, LEAST_HEAT = 0.04, 10.0, 10.0, 20.0

# The largest circle around a touch of the bed, in units of the picture
LARGEST_CIRCLE = 8.0

# 95 % of a normal distribution are so many standard deviations from its middle
OF_95 = 1.96

# Micrometres
UM = "\xb5m"

SITE_COLOURS = tuple(zip(SITES, "abc"))


class Height(NamedTuple):
    """A plot of a height of trend.HEIGHTS: what it depends on, and its colour."""

    title: str
    words: str
    colour: str


HEIGHTS = {
    "nozzle height": Height(
        "Where the nozzle meets the pin",
        "depends on homing, pin and nozzle",
        "a",
    ),
    BODY: Height(
        "How far the probe hangs below the nozzle",
        "changes with nozzle and probe",
        "b",
    ),
    "probe - switch": Height(
        "How high the probe finds the bed",
        "depends on plate, bed and the probe's switch",
        "c",
    ),
}
HEAT = "heat"
# All plots of runs, in their usual order
PLOTS = (verdict.LAST_RUN, verdict.OFFSET, *HEIGHTS, verdict.SPREAD, HEAT)

# What touches at each site
TOUCHING = {
    "nozzle": "Nozzle on the pin",
    "switch": "Probe's body on the pin",
    "bed": "Probe on the bed",
}
LEGEND = {
    "nozzle": "nozzle on pin",
    "switch": "body on pin",
    "bed": "probe on bed",
}
HEATS = (("nozzle", "extruder", "b"), ("bed", "heater_bed", "c"))


def svg(records: Sequence[Run], *, name: str = "") -> str:
    """Return the picture of all that a file keeps, the oldest first.

    name: whose history it is.
    """
    page = Page()
    runs = [record for record in records if record.is_calibration]
    # Nozzles of two lengths are no change from run to run
    if runs:
        runs = [run for run in runs if run.is_of(runs[-1].extruder)]
    accuracy = [record for record in records if record.cycles]
    latest = accuracy[-1] if accuracy and records[-1].cycles else None
    draw_head(page, records, runs, name)
    judged = verdict.judge(runs, latest)
    draw_verdict(page, judged)
    usual = [verdict.ACCURACY] if latest is not None else []
    usual += PLOTS if runs else []
    # What has caused the verdict is first
    caused = [name for name in judged.plots if name in usual]
    drawn = Runs(page, runs)
    for name in [*caused, *(name for name in usual if name not in caused)]:
        begin, top = len(page.parts), page.y
        page.y += 6 if name in caused else 0
        if name == verdict.ACCURACY:
            draw_cycles(page, accuracy[-1])
        else:
            draw_plot(drawn, name)
        if name in caused:
            box = EDGE - 10, top, WIDTH - EDGE + 10, page.y - GAP + 8
            tint(page, begin, box, judged.plots[name])
    draw_reasons(page, runs)
    if accuracy and latest is None:
        draw_cycles(page, accuracy[-1])
    waits = [record for record in records if record.waited]
    if waits:
        draw_wait(page, waits[-1])
    return page.done()


def draw_plot(drawn: Runs, name: str) -> None:
    """Draw one of PLOTS."""
    if name == verdict.LAST_RUN:
        draw_last(drawn.page, drawn.runs)
    elif name == verdict.OFFSET:
        draw_offsets(drawn)
    elif name == verdict.SPREAD:
        draw_spreads(drawn)
    elif name == HEAT:
        draw_heats(drawn)
    else:
        draw_height(drawn, name)


def tint(
    page: Page, begin: int, box: Tuple[float, float, float, float], colour: str
) -> None:
    """Tint what was drawn since a part, with a bar at its left.

    box: left, top, right and bottom.
    """
    left, top, right, bottom = box
    page.parts[begin:begin] = [
        f'<rect x="{left:.0f}" y="{top:.1f}" width="{width:.0f}"'
        f' height="{bottom - top:.1f}" {fill(colour)} fill-opacity="{opacity}"/>'
        for width, opacity in ((right - left, "0.1"), (6, "1"))
    ]


######################################################################
# What to do
######################################################################


def draw_head(
    page: Page, records: Sequence[Run], runs: Sequence[Run], name: str
) -> None:
    """Draw whose history it is, and of what."""
    page.y = GAP - 4
    page.line("Z calibration", more='font-size="19" font-weight="600"')
    if name:
        # Where two are alike, their folders are not
        lack = len(name) - LETTERS + 4
        page.line("..." + name[lack:] if lack > 0 else name, "soft")
    page.line("; ".join(facts(records, runs)), "soft", most=2)
    page.y += 8


def facts(records: Sequence[Run], runs: Sequence[Run]) -> Iterator[str]:
    """Yield how many runs from when to when, with which extruder and version."""
    if runs:
        days = sorted({day(run) for run in (runs[0], runs[-1])})
        yield f"{len(runs)} runs, {' to '.join(days)}"
        if len({run.extruder for run in records} - {""}) > 1:
            yield f"with {runs[-1].extruder}"
    if records and records[-1].revision:
        yield f"z_calibration {records[-1].revision}"


def draw_verdict(page: Page, judged: Verdict) -> None:
    """Draw a box with a bar in the colour of the word."""
    begin, top, colour = len(page.parts), page.y, judged.level
    page.y += 6
    head = 'font-size="16" font-weight="700"'
    page.line(judged.level.capitalize(), colour, head, x=EDGE + 18)
    for text in judged.texts[:TEXTS]:
        page.line(text, most=LINES, x=EDGE + 18)
    more = len(judged.texts) - TEXTS
    if more > 0:
        page.line(f"And {more} more.", "soft", x=EDGE + 18)
    page.y += 12
    tint(page, begin, (EDGE, top, WIDTH - EDGE, page.y), colour)
    page.y += GAP


######################################################################
# The last run
######################################################################


def draw_last(page: Page, runs: Sequence[Run]) -> None:
    """Draw the touches of the last of the runs, on one scale for the three sites."""
    last = runs[-1]
    text = f"Last run, {minute(last)}: refused"
    if last.ok:
        text = f"Last run, {minute(last)}: offset {last.offset:.3f} mm"
        if last.uncertainty is not None:
            text += f" +-{last.uncertainty:.3f} (95 %)"
    page.title(text)
    page.line(
        f"Touches in {UM} about the height that counts; hollow: rejected; band:"
        " usual spread (95 %)",
        "soft",
    )
    page.y += 12
    wide = (WIDTH - RIGHT - LEFT + 48) / 3.0
    usuals = [usual_spread(runs[:-1], site, last.bed_spread) for site in SITES]
    offs = [offsets_of(last.sites.get(site)) for site in SITES]
    end = 1.08 * max([LEAST_OFF, *usuals, *(abs(v) for o in offs for v in o)])
    for number, (site, colour) in enumerate(SITE_COLOURS):
        left = LEFT + number * wide
        box = (left, left + wide - 48)
        count = len(offs[number])
        xs = [(i + 0.5) / count for i in range(count)]
        plot = Plot(page, xs, (-end, end), box)
        plot.frame(TOUCHING[site])
        kept = last.sites.get(site)
        if kept is not None and count:
            draw_touches(plot, offs[number], kept, usuals[number], colour)
        else:
            plot.below("not measured")
    page.y += TITLE + PLOT + BELOW + GAP
    bed = last.sites.get("bed")
    if bed is not None and bed.points and len(bed.points) == len(offs[-1]):
        draw_points(page, bed.points, offs[-1], box)


def draw_points(
    page: Page, points: Sequence[XY], offs: Sequence[float], box: XY
) -> None:
    """Draw where each touch of the bed was, and how high.

    offs: um about the height that counts; box: left and right end.
    """
    plan, most = Plan(page, points, box), max(map(abs, offs)) or 1.0
    plan.frame()
    radii = [LARGEST_CIRCLE * math.sqrt(abs(v) / most) for v in offs]
    for is_high, attributes in ((True, fill("c")), (False, stroke("c", 1.5))):
        chosen = [i for i, v in enumerate(offs) if (v > 0) == is_high]
        plan.circles(
            [points[i] for i in chosen], [radii[i] for i in chosen], attributes
        )
    page.line("Where the bed was touched (mm), which is as rough as that:")
    page.line(
        "full: higher than the height that counts; hollow: lower;", "soft"
    )
    page.line(f"the largest circle: by {most:.1f} {UM}", "soft")
    page.y = plan.top + plan.side + BELOW + GAP


def usual_spread(earlier: Sequence[Run], site: str, bed_spread: float) -> float:
    """Return within how much (um) 95 % of the touches of earlier runs are.

    0: nothing is known. bed_spread: of the run that is compared, mm.
    """
    pooled = pool(spreads(earlier, site, bed_spread))
    return 1000.0 * OF_95 * math.sqrt(pooled.variance) if pooled.dof else 0.0


def offsets_of(kept: Optional[SiteRun]) -> List[float]:
    """Return all touches of a site about its height (um)."""
    if kept is None or not kept.samples:
        return []
    return [1000.0 * (z - kept.z) for z in kept.touches or kept.samples]


def draw_touches(
    plot: Plot, offs: Sequence[float], kept: SiteRun, usual: float, colour: str
) -> None:
    """Draw the touches of a site; usual: half of the band of earlier ones (um)."""
    plot.strip(-usual, usual, colour)
    points = [(plot.x(i), plot.y(v)) for i, v in enumerate(offs)]
    flags = counted(kept.touches or kept.samples, kept.samples)
    plot.dots([p for p, f in zip(points, flags) if f], colour, 4.0)
    plot.rings([p for p, f in zip(points, flags) if not f], colour)
    plot.below(f"at {kept.z:.3f} mm, spread {1000.0 * kept.sd:.1f} {UM}")


def counted(touches: Sequence[float], samples: Sequence[float]) -> List[bool]:
    """Tell of each touch whether it is one of the samples, which are the latest."""
    left, flags = list(samples), []
    for touch in reversed(touches):
        flags.append(touch in left)
        if touch in left:
            left.remove(touch)
    return flags[::-1]


######################################################################
# Over days
######################################################################

Flags = Sequence[Tuple[int, str]]


class Runs:
    """Plots of the runs, one below the other, all with the same marks."""

    def __init__(self, page: Page, runs: Sequence[Run]) -> None:
        """Begin with none.

        flags: numbers of runs at which something happened, and what stands there.
        """
        self.page = page
        self.runs = runs
        self.marks = verdict.marks_of(runs)
        self.flags = flags_of(self.marks)
        self.axis = axis_of(runs) if runs else Axis([], [])

    def draw(
        self,
        titles: Tuple[str, ...],
        curves: Sequence[Curve],
        least: float,
        *,
        zero: bool = False,
    ) -> Optional[Plot]:
        """Draw curves; returns the plot, None where there is nothing to see.

        least: what it spans in its own unit; zero: whether it begins there.
        """
        page = self.page
        curves = [c for c in curves if any(v is not None for v in c.values)]
        values = [v for c in curves for v in c.values if v is not None]
        values += [
            v for c in curves for ends in c.band or () for v in ends or ()
        ]
        if not values:
            return None
        ends = spanned(min(values), max(values), least)
        if zero:
            ends = from_zero(max(values), least)
        plot = Plot(page, self.axis.xs, ends)
        plot.frame(*titles)
        plot.scale(self.axis.marks)
        if len(curves) > 1:
            plot.legend(curves)
        for number, _ in self.flags:
            plot.mark(number, "soft")
        for curve in curves:
            plot.curve(curve)
        page.y = plot.bottom + BELOW + GAP
        return plot

    def values(self, value: Callable[[Run], float]) -> List[Optional[float]]:
        """Return a value of each good run."""
        return [value(run) if run.ok else None for run in self.runs]


def smooth(values: Sequence[Optional[float]]) -> List[Optional[float]]:
    """Return mm as um, each the mean of the latest values up to it."""
    count = max(SMOOTH_RUNS, len(values) // SMOOTH_POINTS)
    means: List[Optional[float]] = []
    for i in range(len(values)):
        latest = values[max(0, i + 1 - count) : i + 1]
        part = [1000.0 * v for v in latest if v is not None]
        means.append(fmean(part) if part else None)
    return means


def usual_body(runs: Sequence[Run]) -> Optional[List[Optional[XY]]]:
    """Return within what switch - nozzle is as usual, for each run.

    None before nozzle and probe were those of now, and where there are too few runs.
    """
    known = usual(bodies_as_hot(runs, runs[-1].temperatures))
    if known is None:
        return None
    good = [number for number, run in enumerate(runs) if run.ok]
    begin = good[first_of_now([runs[number].body() for number in good])]
    ends = known.middle - known.limit, known.middle + known.limit
    return [ends if number >= begin else None for number in range(len(runs))]


def draw_offsets(drawn: Runs) -> None:
    """Draw the offset with its marks, and what these say."""
    page, runs = drawn.page, drawn.runs
    band = [
        (run.offset - run.uncertainty, run.offset + run.uncertainty)
        if run.ok and run.uncertainty is not None
        else None
        for run in runs
    ]
    refused = [i for i, run in enumerate(runs) if not run.ok]
    cleaned = [i for i, run in enumerate(runs) if run.cleaned]
    words = "band: 95 %"
    words += "; x: refused" if refused else ""
    words += "; triangle: cleaned" if cleaned else ""
    offsets = drawn.values(lambda run: run.offset)
    curve = Curve("offset", "a", offsets, band)
    plot = drawn.draw(("Offset (mm)", words), [curve], LEAST_HEIGHT)
    if plot is None:
        return
    plot.crosses(refused, "act")
    plot.triangles(cleaned, "watch")
    for number, text in drawn.flags:
        plot.flag(number, text, "soft")
    page.y -= GAP - 4
    for number, text in drawn.flags:
        told = "; ".join(m.text for m in drawn.marks if m.number == number)
        page.line(f"{text}: {day(runs[number])}, {told}", most=2, x=LEFT)
    page.y += GAP - 4


def flags_of(marks: Sequence[Mark]) -> Flags:
    """Return the latest runs at which something happened, with a number."""
    numbers = sorted({mark.number for mark in marks})[-MARKS:]
    return [(number, f"{i + 1}") for i, number in enumerate(numbers)]


def draw_height(drawn: Runs, name: str) -> None:
    """Draw one of HEIGHTS over days."""
    height, values = HEIGHTS[name], drawn.values(trend.HEIGHTS[name])
    band = usual_body(drawn.runs) if name == BODY else None
    curve = Curve(height.title, height.colour, values, band)
    titles = (f"{height.title} (mm)", height.words)
    drawn.draw(titles, [curve], LEAST_HEIGHT)


def draw_spreads(drawn: Runs) -> None:
    """Draw how much touches of one place differ, over days."""
    runs = drawn.runs
    curves = [
        Curve(LEGEND[site], colour, smooth(spread_curve(runs, site)))
        for site, colour in SITE_COLOURS
    ]
    count = max(SMOOTH_RUNS, len(runs) // SMOOTH_POINTS)
    titles = (f"Spread of touches ({UM})", f"mean of {count} runs")
    drawn.draw(titles, curves, LEAST_SPREAD, zero=True)


def draw_heats(drawn: Runs) -> None:
    """Draw the temperatures over days."""
    heats = [
        Curve(name, colour, [run.temperatures.get(key) for run in drawn.runs])
        for name, key, colour in HEATS
    ]
    drawn.draw(("Temperatures (C)",), heats, LEAST_HEAT)


def spread_curve(runs: Sequence[Run], site: str) -> List[Optional[float]]:
    """Return how the touches of a site varied in each good run (mm)."""
    return [run.sites[site].sd if run.ok else None for run in runs]


def draw_reasons(page: Page, runs: Sequence[Run]) -> None:
    """Write why runs were refused."""
    refused = [run for run in runs if not run.ok]
    if not refused:
        return
    page.title(f"Refused: {len(refused)}, the last ones")
    for run in reversed(refused[-REASONS:]):
        page.line(f"{minute(run)}: {run.reason}", "soft", most=4)
    page.y += GAP


######################################################################
# An accuracy run
######################################################################


def draw_cycles(page: Page, accuracy: Run) -> None:
    """Draw the touches of each cycle of a CALIBRATE_Z_ACCURACY, and its verdict."""
    count = len(accuracy.cycles)
    page.title(f"Accuracy run of {minute(accuracy)}: {count} cycles")
    page.line(cycles.judge_run(accuracy).text, "soft", most=4)
    page.y += GAP
    for site, colour in SITE_COLOURS:
        touches = [cycle.touches(site) for cycle in accuracy.cycles]
        draw_samples(page, site, colour, touches)


def draw_samples(
    page: Page, site: str, colour: str, touches: Sequence[Sequence[float]]
) -> None:
    """Draw the touches of a site, cycle by cycle."""
    flat = [z for samples in touches for z in samples]
    middle, count = median(flat), len(touches)
    offs = [1000.0 * (z - middle) for z in flat]
    xs = [(i + 0.5) / count for i in range(count)]
    plot = Plot(page, xs, spanned(min(offs), max(offs), 20.0))
    plot.frame(f"{TOUCHING[site]} ({UM})", "samples about their median")
    plot.scale([(xs[0], "cycle 1"), (xs[-1], f"cycle {count}")][:count])
    apart = (WIDTH - RIGHT - LEFT - 14) / count
    for number, samples in enumerate(touches):
        between = min(4.0, apart / len(samples))
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
# A printer that warms up
######################################################################


def draw_wait(page: Page, wait: Run) -> None:
    """Draw how far the pin has moved while a Z_CALIBRATION_WAIT watched it."""
    last_minute, last_z = wait.waited[-1]
    offs = [1000.0 * (z - last_z) for _, z in wait.waited]
    ended = "it stood still" if wait.ok else "it still moved"
    page.title(
        f"Waiting of {minute(wait)}: {last_minute:.0f} minutes, then {ended}"
    )
    page.line(
        "above 0: the nozzle has touched the pin higher than in the end", "soft"
    )
    xs = [m / (last_minute or 1.0) for m, _ in wait.waited]
    plot = Plot(page, xs, spanned(min(offs), max(offs), LEAST_OFF))
    plot.frame(f"Where the nozzle meets the pin ({UM})", "about the last one")
    plot.scale([(0.0, "0 min"), (1.0, f"{last_minute:.0f} min")])
    plot.curve(Curve("pin", "a", offs))
    page.y = plot.bottom + BELOW + GAP
