"""The figures as lines for people."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Optional

from tools.bench.commands import Command
from tools.bench.lower_bounds import PURPOSES, Part
from tools.bench.timing import OURS, RUNS, Outcome, Run

Figures = Mapping[str, Any]


def row(name: str, cells: Sequence[str], width: int, rest: str = "") -> str:
    """A line of the table."""
    columns = "".join(f"  {cell:>16}" for cell in cells)
    return f"  {name:{width}}{columns}{rest}".rstrip()


# Times


def timing_head(command: Command, width: int) -> list[str]:
    """Above the times of a command."""
    sites = ", ".join(command.sites)
    return [
        f"{command.script}: printer seconds / lower bound = ratio; touches of"
        f" {sites}; CPU s, and of as long a rest",
        row("", [name for name, _ in RUNS], width, "  samples  touches"),
    ]


def run_row(command: Command, name: str, outcome: Outcome, width: int) -> str:
    """The runs of one module on one host."""
    if isinstance(outcome, str):
        return f"  {name:{width}}  {outcome}"
    cells = [f"{r.seconds:.2f}/{r.bound:.2f}={r.ratio:.2f}" for r in outcome]
    samples = _same(["?" if r.samples is None else r.samples for r in outcome])
    touches = _same([touches_text(command, r.touches) for r in outcome])
    cpu, idle = median_of(outcome, "cpu"), median_of(outcome, "idle")
    rest = f"  {samples:>7}  {touches}  CPU {cpu:.2f}, {idle:.2f}"
    return row(name, cells, width, rest)


def touches_text(command: Command, touches: Mapping[str, int]) -> str:
    """Touches of its sites, and any others by their name."""
    text = "+".join(str(touches.get(site, 0)) for site in command.sites)
    others = [s for s in touches if s not in command.sites]
    return text + "".join(f" {site}:{touches[site]}" for site in others)


def _same(values: Sequence[object]) -> str:
    """One value where all are the same."""
    texts = list(map(str, values))
    return texts[0] if len(set(texts)) == 1 else "/".join(texts)


def ratio_row(name: str, first: list[Run], other: list[Run], width: int) -> str:
    """How our printer seconds and our CPU time compare with others."""
    ratios = [a.seconds / b.seconds for a, b in zip(first, other)]
    cells = [f"{ratio:.2f}" for ratio in ratios]
    cpu = ratio_text(median_of(first, "cpu"), median_of(other, "cpu"))
    return row(f"ours / {name}", cells, width, f"  CPU {cpu}")


def median_of(runs: Sequence[Run], name: str) -> float:
    """The median of a field."""
    return statistics.median(getattr(run, name) for run in runs)


def timing_rows(
    command: Command, outcomes: Mapping[str, Outcome], width: int
) -> list[str]:
    """The times of one host, without its name."""
    own = outcomes[OURS]
    lines = []
    for name, outcome in outcomes.items():
        lines.append(run_row(command, name, outcome, width))
        both = isinstance(own, list) and isinstance(outcome, list)
        if name != OURS and both:
            lines.append(ratio_row(name, own, outcome, width))
    return lines


def bound_table(
    command: Command, parts: Sequence[Part], start: Sequence[float]
) -> list[str]:
    """A lower bound and what it consists of."""
    sites = list(dict.fromkeys(part.site for part in parts))
    purposes = [
        purpose
        for purpose in PURPOSES
        if seconds_of(parts, what=purpose) or purpose != "prepare"
    ]
    place = " ".join(f"{axis}{p:.1f}" for axis, p in zip("XYZ", start))
    heads = "".join(f"{head:>10}" for head in (*purposes, "all"))
    lines = [
        f"lower bound of {command.name} from {place}, s",
        f"  {'':8}{heads}",
    ]
    for site in (*sites, None):
        seconds = [seconds_of(parts, site, what) for what in purposes]
        seconds.append(seconds_of(parts, site))
        cells = "".join(f"{value:10.2f}" for value in seconds)
        lines.append(f"  {site or 'all':8}{cells}")
    return lines


def seconds_of(
    parts: Iterable[Part], site: Optional[str] = None, what: str = ""
) -> float:
    """Seconds of a lower bound, of a place and a purpose where given."""
    return math.fsum(
        part.seconds
        for part in parts
        if site in (None, part.site) and what in ("", part.what)
    )


def bound_tables(command: Command, runs: Sequence[Run]) -> list[str]:
    """The lower bounds of all places from which a run began."""
    starts: dict[tuple[float, ...], Run] = {}
    for run in runs:
        starts.setdefault(tuple(round(p, 1) for p in run.start), run)
    lines = []
    for run in starts.values():
        lines += ["", *bound_table(command, run.parts, run.start)]
    return lines


# Costs and errors


def ratio_text(first: float, other: float) -> str:
    """One by the other, where there is another."""
    return f"{first / other:.2f}" if other else "-"


def cost_lines(costs: Sequence[Figures]) -> list[str]:
    """Time of loading and memory, host by host."""
    width = max((len(cost["module"]) for cost in costs), default=0) + 7
    lines = ["loading a module: ms, KiB (median; alone on this machine)"]
    for host in dict.fromkeys(cost["host"] for cost in costs):
        lines.append(host)
        of_host = [cost for cost in costs if cost["host"] == host]
        own = next(c for c in of_host if c["module"] == "z_calibration")
        for cost in of_host:
            cells = (f"{cost['import_ms']:.2f}", f"{cost['memory_kib']:.0f}")
            lines.append(row(cost["module"], cells, width))
            if cost.get("other"):
                ratios = [
                    ratio_text(own[name], cost[name])
                    for name in ("import_ms", "memory_kib")
                ]
                lines.append(row(f"ours / {cost['module']}", ratios, width))
    return lines


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


def error_lines(errors: Sequence[Figures]) -> list[str]:
    """The errors, host by host."""
    if not errors:
        return []
    seeds = errors[0]["seeds"]
    lines = [f"error over {seeds} seeds, um: mean (sigma) worst"]
    groups: dict[str, dict[tuple[str, str], list[Figures]]] = {}
    for error in errors:
        of_host = groups.setdefault(error["host"], {})
        key = error["command"], error["module"]
        of_host.setdefault(key, []).append(error)
    for host, of_host in groups.items():
        lines.append(host)
        for (command, module), group in of_host.items():
            lines.append(f"  {command}, {module}")
            lines += [f"    {e['noise']:26}{summary_text(e)}" for e in group]
            if module != OURS:
                # Our spread by theirs, under each condition
                sigmas = {
                    e["noise"]: e["sigma"]
                    for e in of_host.get((command, OURS), [])
                }
                cells = [
                    ratio_text(sigmas[e["noise"]] or 0.0, e["sigma"])
                    for e in group
                    if e["noise"] in sigmas
                ]
                lines.append(f"    sigma, ours / {module}: {', '.join(cells)}")
    return lines


def reason_lines(errors: Sequence[Figures]) -> list[str]:
    """Why there was no offset, most frequent first; # is any number."""
    counts: dict[tuple[str, str], int] = {}
    for error in errors:
        for text, count in error["reasons"].items():
            key = (error["module"], text)
            counts[key] = counts.get(key, 0) + count
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return [f"  {n} x {module}: {text}" for (module, text), n in ordered]
