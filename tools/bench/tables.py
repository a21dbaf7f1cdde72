"""The figures of the benchmark as tables: of a document, and for people."""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Optional

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


def time_rows(figures: Figures) -> Iterator[list[str]]:
    """Of ours: the first run and the one after it; CPU, the median of all."""
    for timing in figures["timings"]:
        if timing["module"] != OURS or timing["failure"]:
            continue
        first, again = timing["runs"][:2]
        yield [
            timing["command"],
            timing["host"],
            f"{first['seconds']:.1f}",
            f"{first['bound']:.1f}",
            f"{first['ratio']:.2f}",
            f"{again['seconds']:.1f}",
            f"{again['ratio']:.2f}",
            touches_text(first["touches"]),
            *(
                f"{statistics.median(r[name] for r in timing['runs']):.2f}"
                for name in ("cpu", "idle_cpu")
            ),
        ]


def errors(
    errors: Sequence[Figures], table=markdown, module: Optional[str] = None
) -> str:
    """Mean, sigma and worst in um under each condition; module: only of it."""
    errors = [e for e in errors if module in (None, e["module"])]
    noises = list(dict.fromkeys(error["noise"] for error in errors))
    cells: dict[tuple[str, ...], dict[str, str]] = {}
    for error in errors:
        other = () if module else (error["module"],)
        key = (error["command"], error["host"], *other)
        cells.setdefault(key, {})[error["noise"]] = summary_text(error)
    rows = [
        [*key, *(group.get(noise, "") for noise in noises)]
        for key, group in sorted(cells.items())
    ]
    other = () if module else ("module",)
    return table(["command", "host", *other, *noises], rows)


def costs(costs: Sequence[Figures], table=markdown) -> str:
    """Time of loading and memory."""
    rows = [
        [cost["module"], cost["host"]]
        + [f"{cost['import_ms']:.1f}", f"{cost['memory_kib']:.0f}"]
        for cost in sorted(costs, key=lambda cost: cost["module"])
    ]
    return table(["module", "host", "import ms", "memory KiB"], rows)


def render(file: str) -> str:
    """The tables of a document, from the figures in a file."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    about = figures["about"]
    heads = ["command", "host", "printer s", "lower bound s", "ratio"]
    heads += ["again s", "ratio", "touches", "CPU s", "at rest"]
    own = [cost for cost in figures["costs"] if not cost["other"]]
    return f"""
The modules of revision {about["revision"]}, with Python \
{about["python"]} on {about["processor"]}.

### Time

{markdown(heads, list(time_rows(figures)))}

### Error, in um

{errors(figures["errors"], module=OURS)}

### Loading

{costs(own)}
"""
