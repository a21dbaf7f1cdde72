"""What is told of an offset holds: samples that were rejected count for its spread.

The table in docs/performance.md has more; here are the corners that fail first.
"""

from __future__ import annotations

import pytest

from tools.bench.coverage import Noise, Setting, coverage, grown, student
from z_touch.uncertainty import recent
from z_touch.uncertainty.estimate import UNKNOWN, Spread

STEP = 0.0025


@pytest.mark.parametrize(
    ("sigma", "setting", "first"),
    [
        (0.008, Setting(0.008, 3), False),
        (0.010, Setting(0.005, 10), False),
        (0.005, Setting(0.005, 3, method="average"), False),
        (0.001, Setting(0.005, 0), False),
        (0.008, Setting(0.008, 3), True),
    ],
)
def test_95_of_100_are_inside_whatever_was_rejected(sigma, setting, first):
    noise = Noise("normal", sigma)
    assert 0.91 <= coverage(noise, setting, 240, first=first) <= 0.99


@pytest.mark.parametrize(
    "noise",
    [Noise("t", 0.005, student), Noise("outliers", 0.003, outliers=0.02)],
)
def test_tails_and_outliers(noise):
    assert 0.92 <= coverage(noise, Setting(0.01, 3), 300) <= 0.99


def test_noise_that_has_grown_counts_at_once():
    """By the history it would be 70 % for ten runs."""
    parts = grown(0.003, 0.010, Setting(0.02, 3), 70, runs=3)
    assert sum(parts) / 3 >= 0.85


# Which runs count

QUIET, LOUD = Spread(0.003**2, 2), Spread(0.009**2, 2)
SITES = ("nozzle", "switch", "bed")


def begin(past, now=LOUD):
    pasts = dict.fromkeys(SITES, past)
    return recent.first_like_now(pasts, dict.fromkeys(SITES, now), STEP)


@pytest.mark.parametrize(
    ("past", "now", "first"),
    [
        ([QUIET] * 10, QUIET, 0),
        ([QUIET] * 10, LOUD, 10),
        ([QUIET] * 10 + [LOUD] * 2, LOUD, 10),
        ([LOUD] * 10, LOUD, 0),
        # Quieter is no reason to forget
        ([LOUD] * 10, QUIET, 0),
        ([UNKNOWN] * 3, LOUD, 0),
        ([], LOUD, 0),
    ],
)
def test_history_counts_from_the_run_on_that_is_like_this_one(past, now, first):
    assert begin(past, now) == first


def test_one_site_alone_is_told_by_several_runs():
    past = [QUIET] * 10 + [LOUD] * 3
    pasts = {"nozzle": [QUIET] * 13, "switch": [QUIET] * 13, "bed": past}
    now = {"nozzle": QUIET, "switch": QUIET, "bed": LOUD}
    assert recent.first_like_now(pasts, now, STEP) == 10


def test_single_accident_is_no_noise():
    accident = Spread(0.03**2, 2)
    assert recent.pool_usual([QUIET] * 8 + [accident], STEP).dof == 16
    assert recent.pool_usual([QUIET] * 3 + [accident], STEP).dof == 8


def test_alike_is_what_cannot_be_told_apart():
    spreads, shared = recent.spreads_of_now(
        dict.fromkeys(SITES, [QUIET] * 4), dict.fromkeys(SITES, QUIET), STEP
    )
    assert shared and spreads["bed"] == Spread(pytest.approx(9e-6), 30)
    worn = {"nozzle": [QUIET] * 10, "switch": [QUIET] * 10, "bed": [LOUD] * 10}
    now = {"nozzle": QUIET, "switch": QUIET, "bed": LOUD}
    spreads, shared = recent.spreads_of_now(worn, now, STEP)
    assert not shared and spreads["bed"].variance == pytest.approx(81e-6)


def test_a_run_alone_pays_for_what_it_chose():
    spreads, _ = recent.spreads_of_now(
        dict.fromkeys(SITES, []), dict.fromkeys(SITES, QUIET), STEP
    )
    assert spreads["bed"].dof == pytest.approx(6 * recent.CHOSEN)


@pytest.mark.parametrize(
    ("dof", "below", "sigmas", "table"),
    [(2, 20, 2.326, 5.85), (10, 20, 1.645, 2.35), (20, 20, 2.326, 2.94)],
)
def test_limit_is_that_of_the_tables_of_f(dof, below, sigmas, table):
    assert recent.f_limit(dof, below, sigmas) == pytest.approx(table, rel=0.02)
