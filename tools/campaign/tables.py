"""The campaign's figures as tables of a document."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tools.campaign.fault_cases import REFUSED, RIGHT, SHUT_DOWN
from tools.kit.tables import markdown

# Sites (as the truth calls them) whose depth is how far the nozzle, or what
# hangs below it, was driven too far
_SITES = {
    "nozzle_pin": "nozzle, pin",
    "nozzle_bed": "nozzle, bed",
    "nozzle_membrane": "nozzle, membrane",
    "body_pin": "switch body, pin",
    "body_bed": "switch body, bed",
}

Figures = Mapping[str, Any]


def depths_text(worst: Mapping[str, float]) -> str:
    """How much deeper than in a good run, mm, by site."""
    named = [(_SITES[s], depth) for s, depth in worst.items() if s in _SITES]
    return ", ".join(f"{name} {depth:.2f}" for name, depth in named)


def faults_table(figures: Figures, what: str = "faults") -> str:
    """A line for each command."""
    heads = ["command", "worst penetration, mm", what, "survived"]
    heads += [RIGHT, REFUSED, SHUT_DOWN]
    rows = []
    for found in figures["faults"]:
        ended = [found["ended"].get(e, 0) for e in (RIGHT, REFUSED, SHUT_DOWN)]
        numbers = map(str, (found["runs"], found["survived"], *ended))
        rows.append([found["job"], depths_text(found["worst"]), *numbers])
    return markdown(heads, rows)


def pairs_table(figures: Figures) -> str:
    """Two sensors dead at once: how it ends, and where."""
    groups: dict[tuple[str, str], list[Figures]] = {}
    for found in figures["faults"]:
        for one in found["blind"]:
            # What it was; not where, nor what to do next
            words = re.split(r" \(|[,;] ", one["reason"] or one["ended"])[0]
            groups.setdefault((found["job"], words), []).append(one)
    rows = []
    for (job, words), ones in groups.items():
        worst = {
            s: max(o["depths"][s] for o in ones) for s in ones[0]["depths"]
        }
        rows.append([job, words, depths_text(worst), str(len(ones))])
    heads = ["both sensors dead in", "the reason", "stopped at, mm", "pairs"]
    return markdown(heads, rows)


def printers_table(figures: Figures) -> str:
    """A line for each module."""
    heads = ["module", "deepest in the bed, mm", "printers", "right gap"]
    heads += ["refused", "wrong gap", "healthy", "refused of them"]
    heads += ["worst gap, um off", "of its bound"]
    rows = []
    for name, found in figures["printers"].items():
        numbers = (
            found["runs"],
            found["right"],
            sum(found["refused"].values()),
            len(found["failures"]),
            found["healthy"],
            found["healthy_refused"],
            f"{found['worst_um']:.1f}",
            f"{found['worst']:.0%}",
        )
        depth = f"{found['penetration']:.3f}"
        rows.append([name, depth, *map(str, numbers)])
    return markdown(heads, rows)


def kinds_table(figures: Figures) -> str:
    """How many faults of each kind there were, over all commands."""
    counts: dict[str, int] = {}
    for found in figures["faults"]:
        for kind, count in found["faults"].items():
            counts[kind] = counts.get(kind, 0) + count
    rows = [[kind, KINDS[kind], str(n)] for kind, n in sorted(counts.items())]
    return markdown(["fault", "what happens", "runs"], rows)


KINDS = {
    "stuck_open": "a sensor reads open from then on",
    "stuck_closed": "a sensor reads triggered from then on",
    "trigger_early": "a touch triggers 0.3 mm too high",
    "trigger_late": "a touch triggers 0.3 mm too low",
    "trigger_never": "a touch does not trigger",
    "probe_falls": "the probe falls off the head",
    "attach_fails": "the probe stays in its dock",
    "dock_fails": "the probe stays on the head",
    "template raises": "a template of the owner's raises an error",
    "template leaves": "a template of the owner's leaves the axes",
    "tmc_change_lost": "a driver does not take over a changed current",
    "tmc_write_error": "a driver does not get one write",
    "tmc_read_error": "a driver does not answer one read",
    "mcu_silent": "the board neither listens nor answers any more",
    "cancel": "emergency stop",
}


def hosts_text(parts: Iterable[Figures]) -> str:
    """The hosts of these parts."""
    hosts = sorted({host for part in parts for host in part["hosts"]})
    return f"Each on one of these hosts: {', '.join(hosts)}."


def docks_parts(found: Figures) -> list[str]:
    """What came of the faults on each kind of dock."""
    return [
        "### On each kind of dock",
        f"Seed {found['about']['seed']}. {hosts_text(found['faults'])}",
        faults_table(found),
    ]


def pairs_parts(found: Figures) -> list[str]:
    """What came of the pairs."""
    agreed = sum(len(one["agreed"]) for one in found["faults"])
    alike = (
        f"In {agreed} of them the only two touches that are compared were"
        " wrong by the same amount, and so was the gap: no touch can tell."
    )
    return [
        "### Pairs of faults",
        f"Seed {found['about']['seed']}. {hosts_text(found['faults'])}",
        faults_table(found, "pairs"),
        *([alike] if agreed else []),
        pairs_table(found),
        "*right*: a dead sensor was not yet, or no more, asked for.",
    ]


def render(file: str) -> str:
    """The tables of a document, from the figures in a file."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    parts = [
        f"\nSeed {figures['about']['seed']}.",
        "### Faults",
        hosts_text(figures["faults"]),
        faults_table(figures),
        kinds_table(figures),
        *(docks_parts(figures["docks"]) if "docks" in figures else []),
        *(pairs_parts(figures["pairs"]) if "pairs" in figures else []),
        "### Random printers",
        hosts_text(figures["printers"].values()),
        printers_table(figures),
    ]
    return "\n\n".join(parts) + "\n"
