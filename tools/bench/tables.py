"""The figures of the benchmark as the tables of a document."""

from __future__ import annotations

import csv
import json
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.kit.tables import markdown

Figures = Mapping[str, Any]


def summary_text(error: Figures) -> str:
    """Mean, sigma and worst in um, and how many gave no offset."""

    def shown(name: str, form: str) -> str:
        return "-" if error[name] is None else format(error[name], form)

    mean, sigma = shown("mean", "+.1f"), shown("sigma", ".1f")
    text = f"{mean} ({sigma}) {shown('worst', '+.1f')}"
    if error["refused"]:
        text += f" {error['refused']} refused"
    return text


def span(numbers: Sequence[float], form: str = ".1f") -> str:
    """From the least to the largest of them; one number where all are alike."""
    low, high = (format(pick(numbers), form) for pick in (min, max))
    return low if low == high else f"{low} to {high}"


def time_rows(figures: Figures) -> Iterator[list[str]]:
    """Over all hosts: the first run, the one after it, CPU."""
    by_command: dict[str, list[Figures]] = {}
    for timing in figures["timings"]:
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
    """Mean, sigma and worst in um, of one host."""
    noises = list(dict.fromkeys(error["noise"] for error in errors))
    cells: dict[str, dict[str, str]] = {}
    for error in errors:
        of_command = cells.setdefault(error["command"], {})
        of_command[error["noise"]] = summary_text(error)
    rows = [
        [command, *(found.get(noise, "") for noise in noises)]
        for command, found in sorted(cells.items())
    ]
    return markdown(["command", *noises], rows)


def render(file: str) -> str:
    """The tables of a document, from the figures in a file."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    about = figures["about"]
    heads = ["command", "printer s", "lower bound s", "once more s", "CPU s"]
    return f"""
Revision {about["revision"]}, Python {about["python"]}, {about["processor"]}.

{markdown(heads, list(time_rows(figures)))}

{worst_errors(figures["errors"])}

{loading(figures["costs"])}
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
