"""z_touch/z_calibration/accuracy.py, runs.py: figures of a series of cycles."""

from __future__ import annotations

import math
import random
import statistics

import pytest

from z_touch.z_calibration import accuracy
from z_touch.z_calibration.runs import Cycle, uncertainty

STEP = 0.0025


def figures(found):
    """By name, the numbers of each line."""
    lines = list(accuracy.figures(found, 0.44, STEP, 21.25))
    *series, last = [line.split(": ") for line in lines]
    numbers = {
        name: [float(part.split()[-1]) for part in rest.split(", ")[:3]]
        + [float(rest.split("drift ")[1].split()[0])]
        for name, rest in series
    }
    return numbers, ": ".join(last)


def test_figures_of_a_series():
    z = [1.6, 1.604, 1.602, 1.61]
    found = [
        Cycle(30.0 * i, (v, v + 0.002), (8.0, 8.0), (7.0, 7.0))
        for i, v in enumerate(z)
    ]
    numbers, last = figures(found)
    assert list(numbers) == ["nozzle", "switch", "bed", "offset"]
    mean, sd, span, drift = numbers["nozzle"]
    assert mean == pytest.approx(statistics.mean(z) + 0.001)
    assert sd == pytest.approx(statistics.stdev(z), abs=1e-6)
    assert span == pytest.approx(0.01)
    # Of the straight line through 0, 0.5, 1 and 1.5 minutes: 0.007 / 1.25
    assert drift == pytest.approx(0.0056)
    assert numbers["switch"][1:] == [0.0, 0.0, 0.0]
    assert numbers["offset"][0] == pytest.approx(7.0 - (8.0 - mean + 0.44))
    assert last.startswith("one CALIBRATE_Z: +-0.0")
    assert last.endswith(" mm, 21.2 s")


def test_drift_of_what_happens_at_once_is_none():
    found = [Cycle(5.0, (v,), (8.0,), (7.0,)) for v in (1.6, 1.7)]
    assert figures(found)[0]["nozzle"][-1] == 0.0


def test_uncertainty_of_one_calibration():
    """By Student's t of ten values: 2.262; and half of a step, which is known."""
    draw = random.Random(1)
    values = [draw.gauss(0.16, 0.002) for _ in range(10)]
    sd = statistics.stdev(values)
    assert uncertainty(values, 0.0) == pytest.approx(2.262 * sd, rel=0.01)
    wide = uncertainty(values, 0.02)
    assert wide == pytest.approx(2.262 * math.hypot(sd, 0.01), rel=0.01)
