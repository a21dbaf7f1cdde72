"""Runs of a printer, as the history has them."""

from __future__ import annotations

import random
import statistics
from collections.abc import Mapping
from types import MappingProxyType

from tools.kit.product import history

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
        sites[name] = history.site_record(
            samples, statistics.mean(samples), STEP
        )
    run = {
        "ok": True,
        "time": 1.7e9,
        "printer": "printer.cfg",
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
