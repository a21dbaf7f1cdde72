"""The figures of the benchmark as tables: of a document, and for people."""

from __future__ import annotations

import csv
import json
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.bench.commands import Command
from tools.bench.lower_bounds import PURPOSES
from tools.bench.timing import OURS, RUNS, Outcome, Run
from tools.kit.tables import markdown, plain

Figures = Mapping[str, Any]


# For people


def times(command: Command, outcomes: Mapping[tuple, Outcome]) -> str:
    """Of each (host, module), ours first: what a command took."""
    heads = ["host", "module", *(name for name, _ in RUNS)]
    heads += ["samples", "touches", "CPU s", "at rest"]
    rows: list[Sequence[str]] = []
    reasons: list[str] = []
    for (host, module), outcome in outcomes.items():
        if isinstance(outcome, str):
            reasons.append(f"{host}, {module}: {outcome}")
            continue
        rows.append([host, module, *_cells(command, outcome)])
        own = outcomes[host, OURS]
        if module != OURS and not isinstance(own, str):
            ratios = [a.seconds / b.seconds for a, b in zip(own, outcome)]
            rows.append(
                [host, f"ours / {module}", *map("{:.2f}".format, ratios)]
            )
    title = f"{command.name}: printer seconds / lower bound = ratio"
    return "\n".join([title, plain(heads, rows), *reasons, ""])


def _cells(command: Command, runs: Sequence[Run]) -> Iterator[str]:
    for run in runs:
        yield f"{run.seconds:.2f}/{run.bound:.2f}={run.ratio:.2f}"
    yield "/".join(dict.fromkeys(str(run.samples) for run in runs))
    yield touches_text(runs[0].touches)
    for name in ("cpu", "idle"):
        yield f"{statistics.median(getattr(run, name) for run in runs):.2f}"


def touches_text(touches: Mapping[str, int]) -> str:
    """Touches by site."""
    return ", ".join(f"{site} {n}" for site, n in sorted(touches.items()))


def bounds(command: Command, runs: Sequence[Run]) -> str:
    """The lower bounds of all places from which a run began."""
    starts = {tuple(round(p, 1) for p in run.start): run for run in runs}
    tables = []
    for start, run in starts.items():
        seconds = {(p.site, p.what): f"{p.seconds:.2f}" for p in run.parts}
        sites = dict.fromkeys(part.site for part in run.parts)
        rows = [
            [site, *(seconds.get((site, what), "") for what in PURPOSES)]
            for site in sites
        ]
        title = f"lower bound of {command.name} from {start}, s"
        tables += [title, plain(["place", *PURPOSES], rows), ""]
    return "\n".join(tables)


def summary_text(error: Figures) -> str:
    """Mean, sigma and worst in um, and how many gave no offset."""

    def shown(name: str, form: str) -> str:
        return "-" if error[name] is None else format(error[name], form)

    mean, sigma = shown("mean", "+.1f"), shown("sigma", ".1f")
    text = f"{mean} ({sigma}) {shown('worst', '+.1f')}"
    if error["refused"]:
        text += f" {error['refused']} refused"
    if error["failed"]:
        text += f" {error['failed']} FAILED"
    return text


def reasons(errors: Sequence[Figures]) -> str:
    """Why there was no offset, most frequent first; # is any number."""
    counts: dict[tuple[str, str], int] = {}
    for error in errors:
        for text, count in error["reasons"].items():
            key = (error["module"], text)
            counts[key] = counts.get(key, 0) + count
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return "\n".join(f"{n} x {module}: {text}" for (module, text), n in ordered)


# Of the document, and of others where they are measured, too


def span(numbers: Sequence[float], form: str = ".1f") -> str:
    """From the least to the largest of them; one number where all are alike."""
    low, high = (format(pick(numbers), form) for pick in (min, max))
    return low if low == high else f"{low} to {high}"


def time_rows(figures: Figures) -> Iterator[list[str]]:
    """Of ours, over all hosts: the first run, the one after it, CPU."""
    by_command: dict[str, list[Figures]] = {}
    for timing in figures["timings"]:
        if timing["module"] == OURS and not timing["failure"]:
            by_command.setdefault(timing["command"], []).append(timing)
    for command, timings in by_command.items():
        first, again = ([t["runs"][n] for t in timings] for n in (0, 1))
        cpu = [
            statistics.median(run["cpu"] for run in t["runs"]) for t in timings
        ]
        yield [
            command,
            span([run["seconds"] for run in first]),
            span([run["bound"] for run in first]),
            span([run["seconds"] for run in again]),
            span(cpu, ".2f"),
        ]


def errors(errors: Sequence[Figures]) -> str:
    """Mean, sigma and worst in um under each condition."""
    noises = list(dict.fromkeys(error["noise"] for error in errors))
    cells: dict[tuple[str, ...], dict[str, str]] = {}
    for error in errors:
        key = (error["command"], error["host"], error["module"])
        cells.setdefault(key, {})[error["noise"]] = summary_text(error)
    rows = [
        [*key, *(group.get(noise, "") for noise in noises)]
        for key, group in sorted(cells.items())
    ]
    return plain(["command", "host", "module", *noises], rows)


def costs(costs: Sequence[Figures]) -> str:
    """Time of loading and memory, on each host."""
    rows = [
        [cost["module"], cost["host"]]
        + [f"{cost['import_ms']:.1f}", f"{cost['memory_kib']:.0f}"]
        for cost in sorted(costs, key=lambda cost: cost["module"])
    ]
    return plain(["module", "host", "import ms", "memory KiB"], rows)


def loading(costs: Sequence[Figures]) -> str:
    """Time of loading and memory, over all hosts."""
    by_module: dict[str, list[Figures]] = {}
    for cost in sorted(costs, key=lambda cost: cost["module"]):
        by_module.setdefault(cost["module"], []).append(cost)
    rows = [
        [
            module,
            span([cost["import_ms"] for cost in found]),
            span([cost["memory_kib"] for cost in found], ".0f"),
        ]
        for module, found in by_module.items()
    ]
    return markdown(["module", "import ms", "memory KiB"], rows)


def worst_errors(errors: Sequence[Figures]) -> str:
    """Mean, sigma and worst in um; hosts that agree are one line."""
    noises = list(dict.fromkeys(error["noise"] for error in errors))
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for error in errors:
        key = (error["command"], error["host"])
        cells.setdefault(key, {})[error["noise"]] = summary_text(error)
    rows = {
        (command, *(group.get(noise, "") for noise in noises))
        for (command, _), group in cells.items()
    }
    return markdown(["command", *noises], sorted(rows))


def render(file: str) -> str:
    """The tables of a document, from the figures in a file."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    about = figures["about"]
    heads = ["command", "printer s", "lower bound s", "once more s", "CPU s"]
    own = [cost for cost in figures["costs"] if not cost["other"]]
    ours = [error for error in figures["errors"] if error["module"] == OURS]
    return f"""
Revision {about["revision"]}, Python {about["python"]}, {about["processor"]}.

{markdown(heads, list(time_rows(figures)))}

{worst_errors(ours)}

{loading(own)}
"""


def automatic(file: str) -> str:
    """The table of `samples: auto`, from the figures of tools/bench/automatic.py."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    heads = ["noise, and what is set", "error, um: mean (sigma) worst"]
    heads += ["inside the +- told", "printer s", "touches"]
    rows = [
        [
            one["name"],
            f"{one['mean']:+.1f} ({one['sigma']:.1f}) {one['worst']:+.1f}",
            f"{one['inside']:.0%}",
            f"{one['seconds']:.1f}",
            f"{one['touches']:.1f}",
        ]
        for one in figures["cases"]
    ]
    printers = figures["cases"][0]["printers"]
    return f"""
{figures["host"]}, {printers} printers each.

{markdown(heads, rows)}
"""


# How docs/coverage.csv calls them
FIRST_RUN, KNOWN = "first run of a printer", "with a history of ten runs"


def coverage(file: str) -> str:
    """How many gaps were inside what was told: least, mean and most of the cells."""
    with Path(file).open(encoding="utf-8", newline="") as lines:
        cells = list(csv.DictReader(lines))
    shares: dict[tuple[str, str], list[float]] = {}
    for cell in cells:
        # "-": where nearly all of them are refused
        if cell["inside, %"] != "-":
            key = cell["runs"], cell["noise"]
            shares.setdefault(key, []).append(float(cell["inside, %"]))
    noises = dict.fromkeys(noise for _, noise in shares)
    steady = [noise for noise in noises if (FIRST_RUN, noise) in shares]
    rows = [
        [noise, *(_span(shares[runs, noise]) for runs in (KNOWN, FIRST_RUN))]
        for noise in steady
    ]
    heads = ["noise of 1 to 10 um", "with a history, %", "first run, %"]
    return f"\n{markdown(heads, rows)}\n"


def _span(values: Sequence[float]) -> str:
    mean = statistics.mean(values)
    return f"{min(values):.1f}, {mean:.1f}, {max(values):.1f}"
