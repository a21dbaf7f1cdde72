"""Every fault at every operation of every command, as walks.

A good run tells which operations a command has. For each of them and each fault
there is a walk: a new printer is homed, the fault strikes once, at that operation,
it is mended, and the command runs again, which has to be right. What counts the
operations is a good run of the same modules on the same host: those that move
otherwise are broken where they move.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Optional

from simprinter.hosts.hosts import Host
from tools.campaign.breaking import (
    BEGIN,
    PUT_ON,
    SENSOR_FAULTS,
    STICKS,
    TEMPLATE_FAULTS,
    TOUCH_FAULTS,
    TRIP_FAULTS,
    WAY,
    WRITE_FAULTS,
    Break,
    Operation,
    Watch,
    templates_run,
)
from tools.campaign.drawn.steps import Step
from tools.campaign.jobs import ALL_JOBS, OFFSET, Job
from tools.campaign.judging import GAP_ERROR, Expected
from tools.kit.printer import Printer

# After these nothing runs until klippy has started again
_ENDING = ("mcu_silent", "cancel")
Modules = Optional[Mapping[str, Path]]


class Case(NamedTuple):
    """A command, and what breaks in it: one fault, or two.

    later: what breaks when it runs again.
    """

    job: str
    breaks: tuple[Break, ...]
    later: tuple[Break, ...] = ()

    def __str__(self) -> str:
        runs = [" + ".join(map(str, b)) for b in (self.breaks, self.later) if b]
        return f"{self.job}: {', then '.join(runs)}"


class GoodRun(NamedTuple):
    """What a command does when nothing is wrong.

    trips: how often a probe is fetched and docked, by the event's name.
    """

    operations: tuple[Operation, ...]
    templates: int
    trips: Mapping[str, int]
    expected: Expected


_PREPARED = f"%s\nSET_GCODE_OFFSET Z={OFFSET}\nM400"


def walk(case: Case) -> tuple[Step, ...]:
    """Home, break, the command, mend, the command without homing."""
    job = ALL_JOBS[case.job]
    command = f"{job.script}\nM400"
    again = _PREPARED % job.again
    steps: list[Step] = [("gcode", "G28"), ("gcode", _PREPARED % job.before)]
    for breaks in filter(None, (case.breaks, case.later)):
        steps += [("break", what) for what in breaks]
        steps.append(("gcode", command))
        steps.append(("mend", ", ".join(what.fault for what in breaks)))
        steps.append(("heed", again))
    steps[-1] = ("heed", f"{again}\n{command}")
    return tuple(steps)


def good_run(
    host: Host, job: Job, seed: int = 0, modules: Modules = None
) -> GoodRun:
    """The command with nothing wrong.

    Raises AssertionError if its gap is not the ideal one.
    """
    operations: list[Operation] = []
    with Printer(host, job.scene, job.changes, (), seed, modules) as printer:
        printer.homed()
        printer.run(_PREPARED % job.before)
        before = job.gap(printer)
        first = templates_run(printer)
        events = printer.machine.truth.events
        homing = len(events)
        Watch(printer.machine, operations.append)
        printer.run(f"{job.script}\nM400")
        gap, ideal = job.gap(printer), job.ideal
        wanted = before if ideal is None else ideal
        assert math.isnan(wanted) or abs(gap - wanted) < GAP_ERROR, gap
        truth = printer.machine.truth
        depths = {site: truth.depth(site) for site in job.margins}
        templates = templates_run(printer) - first
        kinds = [event.kind for event in events[homing:]]
    trips = {kind: kinds.count(kind) for kind in TRIP_FAULTS}
    expected = Expected(job, depths, gap)
    return GoodRun(tuple(operations), templates, trips, expected)


def cases(good: GoodRun) -> Iterator[Case]:
    """All faults of a command, at all its operations."""
    job = good.expected.job
    for what in _breaks(job, good):
        if not job.only or what.fault in job.only:
            yield Case(job.name, (what,))


def pairs(
    singles: Sequence[Sequence[Case]],
    count: int,
    seed: int,
    is_after: bool = False,
) -> list[list[Case]]:
    """Any two of a command's cases, count pairs in all, each another one.

    is_after: the second breaks when the command runs again, in any order.
    """
    if is_after:
        # What ends the printer has no next run
        singles = [
            [one for one in cases if one.breaks[0].fault not in _ENDING]
            for cases in singles
        ]
    generator = random.Random(seed)
    # Of one case there is no pair
    weights = [len(one) if one[1:] else 0 for one in singles]
    count = min(count, sum(n * (n - 1) // 2 for n in weights))
    found: list[dict[Case, None]] = [{} for _ in singles]
    while sum(map(len, found)) < count:
        (at,) = generator.choices(range(len(singles)), weights)
        chosen = generator.sample(range(weights[at]), 2)
        one, other = (singles[at][number] for number in chosen)
        pair = Case(one.job, one.breaks, other.breaks)
        if not is_after:
            one, other = (singles[at][number] for number in sorted(chosen))
            pair = Case(one.job, (*one.breaks, *other.breaks))
        found[at][pair] = None
    return [list(one) for one in found]


def _breaks(job: Job, good: GoodRun) -> Iterator[Break]:
    yield from _counted(job, good)
    if job.is_left_on:
        yield Break(PUT_ON, kind=BEGIN)
    anywhere = [(f, s) for f in SENSOR_FAULTS for s in job.signals]
    anywhere += [("mcu_silent", b) for b in job.scene.wiring.all_boards()]
    anywhere.append(("cancel", ""))
    if job.scene.world.mag_probe is not None:
        anywhere.append(("probe_falls", ""))
    own = {"touch": TOUCH_FAULTS, "write": WRITE_FAULTS, WAY: (STICKS,)}
    for kind, of, nth in _places(job, good):
        # All else that breaks in a touch is so when it begins
        for fault, subject in anywhere if kind != WAY else ():
            yield Break(fault, subject, kind, of, nth)
        for fault in own.get(kind, ()):
            if fault != STICKS or of in job.signals:
                yield Break(fault, of, kind, of, nth)


def _counted(job: Job, good: GoodRun) -> Iterator[Break]:
    """Of templates, and of trips to the dock."""
    for number in range(1, good.templates + 1):
        for fault in TEMPLATE_FAULTS:
            yield Break(fault, nth=number)
    for kind, fault in TRIP_FAULTS.items():
        if kind == "dock" and "dockable_probe" not in job.scene.sections:
            # What an owner's template left on the toolhead only the owner takes off
            continue
        for number in range(1, good.trips[kind] + 1):
            yield Break(fault, nth=number)


def _places(job: Job, good: GoodRun) -> Iterator[tuple[str, str, int]]:
    """All operations, by their number among those of their kind.

    One more or less of another kind does not matter then. Of a long command the
    first, the middle and the last of each kind.
    """
    yield BEGIN, "", 1
    kinds = Counter(operation[:2] for operation in good.operations)
    numbers: Counter[tuple[str, str]] = Counter()
    for kind, of, _ in good.operations:
        numbers[kind, of] += 1
        nth, count = numbers[kind, of], kinds[kind, of]
        if not job.is_long or nth in (1, count // 2 + 1, count):
            yield kind, of, nth
