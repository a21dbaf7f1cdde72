"""Runs of a printer, as lines of its history have them."""

from __future__ import annotations

import json
import random
import statistics
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from types import MappingProxyType

from tools.kit.product import runs

HEIGHTS = {"nozzle": 1.6, "switch": 8.015, "bed": 7.015}
STEP = 0.0025


def make_run(
    draw: random.Random,
    noise: float = 0.003,
    touches: int = 2,
    homing: float = 0.003,
    moved: Mapping[str, float] = MappingProxyType({}),
    worn: Mapping[str, float] = MappingProxyType({}),
    **record,
) -> dict:
    """A good one.

    touches: of each site; homing: its noise (mm), the same at each site; moved:
    mm by site; worn: other noise by site; record: replaces what is recorded.
    """
    shift, sites = draw.gauss(0.0, homing), {}
    for name, height in HEIGHTS.items():
        z = height + shift + moved.get(name, 0.0)
        sigma = worn.get(name, noise)
        samples = [
            (z + draw.gauss(0.0, sigma)) // STEP * STEP for _ in range(touches)
        ]
        sites[name] = as_kept(runs.site_run(samples, statistics.mean(samples)))
    run = {
        "format": runs.FORMAT,
        "ok": True,
        "time": 1.7e9,
        "sites": sites,
        "offset": 0.16,
        "uncertainty": 0.006,
        "switch_offset": 0.44,
        "temperatures": {"extruder": 150.0, "heater_bed": 60.0},
        "reason": "",
    }
    return {**run, **record}


def make_runs(count: int, seed: int = 1, **options) -> list[dict]:
    draw = random.Random(seed)
    return [
        make_run(draw, **{"time": 1.7e9 + 9e4 * i, **options})
        for i in range(count)
    ]


def as_kept(site: runs.SiteRun) -> dict:
    """A site as a line has it."""
    return {k: v for k, v in asdict(site).items() if v not in (None, ())}


def read(records: Iterable[dict]) -> list[runs.Run]:
    """Runs as the modules have them, of such lines."""
    return [runs.parse(json.dumps(record).encode()) for record in records]
