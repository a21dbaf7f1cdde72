"""The campaign's figures as tables of a document."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.campaign.walker import REFUSED, RIGHT, SHUT_DOWN
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

# What the commands of a section have in their names; all others are of z_calibration
_SECTIONS = (
    ("dockable", "dockable_probe"),
    ("AUTO_Z", "auto_z_offset"),
    ("EXTRA_PROBE", "extra_probe"),
)
# What is less is shown as 0, mm
SHOWN = 0.005

Figures = Mapping[str, Any]


def depths_text(worst: Mapping[str, float]) -> str:
    """How much deeper than in a good run, mm, by site."""
    named = [
        (_SITES[site], depth)
        for site, depth in worst.items()
        if site in _SITES and depth >= SHOWN
    ]
    return ", ".join(f"{name} {depth:.2f}" for name, depth in named) or "0"


def together(name: str, jobs: Sequence[Figures]) -> Figures:
    """Several jobs as one: sums, and the deepest of each site."""
    sites = {site for one in jobs for site in one["worst"]}
    ends = (RIGHT, REFUSED, SHUT_DOWN)
    return {
        "job": name,
        "runs": sum(one["runs"] for one in jobs),
        "survived": sum(one["survived"] for one in jobs),
        "ended": {e: sum(j["ended"].get(e, 0) for j in jobs) for e in ends},
        "worst": {
            site: max(one["worst"].get(site, 0.0) for one in jobs)
            for site in _SITES
            if site in sites
        },
    }


def faults_table(jobs: Sequence[Figures]) -> str:
    """A line for each command."""
    heads = ["commands of", "deepest, mm", "tried", "survived"]
    heads += [RIGHT, REFUSED, SHUT_DOWN]
    rows = []
    for found in jobs:
        ended = [found["ended"].get(e, 0) for e in (RIGHT, REFUSED, SHUT_DOWN)]
        numbers = map(str, (found["runs"], found["survived"], *ended))
        rows.append([found["job"], depths_text(found["worst"]), *numbers])
    return markdown(heads, rows)


def commands_of(figures: Figures) -> list[Figures]:
    """The commands of each module together, first touches of all by themselves."""
    groups: dict[str, list[Figures]] = {}
    for one in figures["faults"]:
        job = one["job"]
        if "first of all" not in job:
            job = next(
                (name for word, name in _SECTIONS if word in job),
                "z_calibration",
            )
        groups.setdefault(job, []).append(one)
    return [together(name, jobs) for name, jobs in groups.items()]


# What a walk is harmed by, in columns
_OF_KLIPPY = ("internal error", "shutdown", "hang")
_OF_WORLD = ("harm", "wrong offset")


def walks_table(figures: Figures) -> str:
    """A line for all walks, and one for each healthy refusal."""
    harmed = dict(figures["harmed"])
    ends = [harmed.pop(name, 0) for name in _OF_WORLD]
    ends.append(sum(harmed.pop(name, 0) for name in _OF_KLIPPY))
    heads = ["walks", "steps", *_OF_WORLD, ", ".join(_OF_KLIPPY)]
    heads += ["anything else", "steps refused", "without a reason"]
    refused = [sum(figures[name].values()) for name in ("refused", "healthy")]
    numbers = [figures["walks"], figures["steps"], *ends, sum(harmed.values())]
    rows = [[str(number) for number in (*numbers, *refused)]]
    lines = [
        f"- {count}: `{name}`" for name, count in figures["healthy"].items()
    ]
    return "\n".join([markdown(heads, rows), "", *lines]).rstrip()


def render_walks(file: str) -> str:
    """That of a document, from the figures in a file."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    return "\n" + walks_table(figures) + "\n"


def render(file: str) -> str:
    """The tables of a document, from the figures in a file."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    jobs = [
        *commands_of(figures),
        together("all, each kind of dock", figures["docks"]["faults"]),
        together("all, pairs of faults", figures["pairs"]["faults"]),
    ]
    return f"\n{faults_table(jobs)}\n"
