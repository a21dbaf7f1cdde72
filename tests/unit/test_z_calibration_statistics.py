"""z_touch/z_calibration/statistics.py: formulas, decisions, and printers at random.

Formulas are held against their own definition. Whether 95 of 100 runs are inside of
what they say of themselves is drawn for the corners that fail first; the tables of
docs/performance.md have more printers, and those with tails and outliers.
"""

from __future__ import annotations

import math
import random
import statistics
from collections.abc import Iterable, Sequence

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tools.bench.coverage import (
    STEP,
    DrawnPrinter,
    Noise,
    Setting,
    coverage,
    grown,
)
from z_touch.errors import SamplesDiffer
from z_touch.sampling import AUTO, Sampling
from z_touch.texture import ROUGH
from z_touch.z_calibration import statistics as module
from z_touch.z_calibration.statistics import (
    DOUBT,
    LEAST,
    LEAST_AT_FIRST,
    MOST,
    UNKNOWN,
    Estimate,
    RunStatistics,
    Spread,
    spread_of,
    uncertainty_of,
    without_outliers,
)

SITES = ("nozzle", "switch", "bed")
QUIET = Spread(0.002**2, 20)
LOUD = Spread(0.009**2, 20)
# Touches of 1 um and less, on whole steps
SAME = Spread(0.0, 20)


def sampling(
    samples: int = 3,
    tolerance: float = 0.01,
    retries: int = 0,
    result: str = "median",
) -> Sampling:
    return Sampling(samples, tolerance, retries, result, 2.0, 4.0, 6.0)


def run_of(
    earlier: Spread = UNKNOWN,
    target: float | None = None,
    rough: Sequence[str] = (),
    sites: Sequence[str] = SITES,
) -> RunStatistics:
    """One whose earlier runs say the same of each site."""
    runs = {site: [earlier] for site in sites}
    return RunStatistics(STEP, runs, target, rough)


def touched(
    run: RunStatistics, site: str, values: Iterable[float], **options
) -> list[str]:
    """Touch it until that is enough; returns what was told."""
    series, told, touches = (
        run.begin(site, sampling(**options)),
        [],
        iter(values),
    )
    while not series.is_complete():
        again = series.add(next(touches))
        told += [again] if again else []
    return told


# Formulas


@pytest.mark.parametrize(
    ("dof", "t"),
    [(1, 12.71), (2, 4.303), (4, 2.776), (7, 2.365), (12, 2.179), (50, 2.009)],
)
def test_students_t_is_right_within_two_percent(dof, t):
    assert module.t_factor(dof) == pytest.approx(t, rel=0.02)


@pytest.mark.parametrize("sigma", [0.01, 0.3, 1.0, 1.6, 1.7, 5.0, 40.0])
def test_reach_has_95_of_100(sigma):
    reach, normal = module.reach(1.0, sigma), statistics.NormalDist(1.0, sigma)
    inside = normal.cdf(reach) - normal.cdf(-reach)
    assert inside == pytest.approx(0.95, abs=0.004)


def test_rounding_remains_only_where_there_is_little_noise():
    """As in the sum of Widrow and Kollar, of which the first terms are enough."""
    whole = STEP**2 / 12
    assert module.left_of_rounding(0.0, STEP) == whole
    assert module.left_of_rounding(whole + STEP**2, STEP) < 1e-6 * whole
    for part in (0.1, 0.2, 0.4):
        waves = [
            math.exp(-((2 * math.pi * k * part) ** 2)) / k**2
            for k in range(1, 9)
        ]
        exact = sum(waves) * STEP**2 / (2 * math.pi**2)
        left = module.left_of_rounding(whole + (part * STEP) ** 2, STEP)
        assert exact <= left <= 1.65 * exact


@pytest.mark.parametrize(("n", "least"), [(3, 1.346), (4, 1.193), (40, 1.571)])
def test_a_median_is_less_exact_than_an_average(n, least):
    samples = [1.0 + 0.001 * (-1) ** i for i in range(n)]
    spread = Spread(spread_of(samples).variance, 20)
    average, median = (
        module.variances_of(Estimate(1.0, samples, method, spread), 1e-9)[0]
        for method in ("average", "median")
    )
    assert median == pytest.approx(least * average, rel=0.001)


def test_half_a_step_is_no_variance():
    """Rounding is known: three touches on one step tell as much as a hundred."""
    same = Estimate(1.0, [1.0] * 3, "median", Spread(0.0, 2))
    assert uncertainty_of([same] * 3, STEP) == pytest.approx(
        2.645 * STEP / 2, rel=0.01
    )


def test_nothing_is_said_of_a_single_sample_without_a_history():
    one = Estimate(1.0, [1.0], "median", UNKNOWN)
    two = Estimate(1.0, [1.0, 1.001], "median", Spread(5e-7, 1))
    assert uncertainty_of([one, two, two], STEP) is None
    assert uncertainty_of([two] * 3, STEP) > 0.0


heights = st.lists(
    st.integers(-8, 8).map(lambda n: n * STEP), min_size=3, max_size=9
)


@given(heights, st.floats(1.0, 5.0), st.sampled_from(["average", "median"]))
def test_touches_that_vary_more_are_worth_less(samples, factor, method):
    def worth(scale: float) -> float:
        scaled = [scale * z for z in samples]
        found = Estimate(0.0, scaled, method, spread_of(scaled))
        return uncertainty_of([found] * 3, STEP)

    assert worth(factor) >= worth(1.0) * 0.999


@given(st.floats(0.0, 0.02), st.integers(2, 9), st.integers(1, 99))
def test_more_touches_and_a_longer_history_are_worth_more(sigma, count, dof):
    def worth(count: int, dof: float) -> float:
        spread = Spread(sigma**2, dof)
        found = Estimate(0.0, [0.0] * count, "average", spread)
        return uncertainty_of([found] * 3, STEP)

    assert worth(count + 1, dof) <= worth(count, dof)
    assert worth(count, dof + 1) <= worth(count, dof)


def test_target_below_what_steps_allow_is_told():
    least = module.least_uncertainty(STEP)
    assert least == pytest.approx(0.9 * STEP, rel=0.02)
    text = module.impossible(0.8 * least, STEP)
    assert f"each run ends at about {least:.4f}" in text
    assert not module.impossible(least, STEP)
    assert not module.impossible(None, STEP)


# Outliers and accidents


@pytest.mark.parametrize(
    ("samples", "count"),
    [
        ([], 0),
        ([1.0, 1.5], 2),
        ([1.0, 1.0, 1.0], 3),
        ([1.0, 1.001, 1.05, 1.002], 3),
        ([1.0, 1.012, 1.006, 1.001, 1.011], 5),
        ([1.05, 1.0, 0.9, *[1.001] * 5], 6),
    ],
)
def test_samples_that_are_far_from_all_others_do_not_count(samples, count):
    kept = without_outliers(samples, 0.004)
    assert len(kept) == count and kept == [z for z in samples if z in kept]


@given(heights, st.floats(0.001, 0.02))
def test_most_samples_count(samples, usual):
    """However they lie, and wherever."""
    kept = without_outliers(samples, usual)
    assert 2 * len(kept) > len(samples)
    # One that is just as far as it may be is in or out by rounding
    assume(kept == without_outliers(samples, usual * (1.0 + 1e-9)))
    assume(kept == without_outliers(samples, usual * (1.0 - 1e-9)))
    moved = without_outliers([z + 1.0 for z in samples], usual)
    assert len(moved) == len(kept)


def test_a_single_accident_is_no_noise():
    run, accident = Spread(0.003**2, 2), Spread(0.03**2, 2)
    found = module.pool_usual([run] * 4 + [accident, UNKNOWN], STEP)
    assert found == Spread(pytest.approx(9e-6), 8)
    assert module.pool_usual([UNKNOWN] * 3, STEP) == UNKNOWN
    # Runs in which all touches end on one step, and one on the next
    next_step = Spread(STEP**2 / 2, 1)
    assert module.pool_usual([SAME] * 5 + [next_step], STEP).dof == 101
    # and far more than half a step
    far = Spread((0.75 * module.ACCIDENT * STEP) ** 2, 1)
    assert module.pool_usual([SAME] * 5 + [far], STEP).dof == 100


# A fixed number of touches


def test_series_begins_again_where_it_does_not_agree():
    run = run_of()
    (told,) = touched(run, "bed", [1.0, 1.02, 1.001, 1.002, 1.003], retries=1)
    assert told == (
        "samples differ by 0.0200 mm, samples_tolerance is 0.0100 mm; trying"
        " again"
    )
    assert run.samples["bed"] == [1.001, 1.002, 1.003]
    assert run.touches["bed"] == [1.0, 1.02, 1.001, 1.002, 1.003]
    assert run.estimates["bed"].z == 1.002
    # A touch at 1.02 is an outlier, that at 1.0 is none
    assert run.estimates["bed"].spread.dof == 3


# As many as are needed


@pytest.mark.parametrize(
    ("values", "earlier", "count", "z"),
    [
        ((1.0, 1.001), QUIET, LEAST, 1.0005),
        ((1.0, 1.001, 1.0, 1.001, 1.0), UNKNOWN, LEAST_AT_FIRST, 1.0004),
        # Too few of before are no history
        ((1.0, 1.001, 1.0, 1.001, 1.0), Spread(4e-6, 7), 5, 1.0004),
        ((1.0, 1.001), Spread(4e-6, 8), 2, 1.0005),
        # Three speak against one, six against two
        ((1.0, 1.05, 1.001, 1.002), QUIET, 4, 1.001),
        ((1.05, 1.0, 0.9, *[1.001] * 5), QUIET, 8, 1.000833),
    ],
)
def test_touches_until_it_is_known(values, earlier, count, z):
    run = run_of(earlier, target=0.008)
    touched(run, "nozzle", values)
    assert len(run.touches["nozzle"]) == count
    assert run.estimates["nozzle"].z == pytest.approx(z, abs=1e-6)


def test_a_run_that_is_noisier_is_not_made_better_by_its_history():
    noisy = [1.0, 1.02, 1.005, 1.01, 1.018, 1.001, 1.013, 1.004, 1.02, 1.0]
    counts = []
    for earlier in (LOUD, QUIET, UNKNOWN):
        run = run_of(earlier, target=0.015)
        touched(run, "nozzle", noisy)
        counts.append(len(run.touches["nozzle"]))
    loud, quiet, unknown = counts
    assert loud < quiet == unknown


def test_the_last_place_has_what_the_others_have_left():
    noisy = [1.0, 1.01, 1.0, 1.02] * 9
    for values, count in ((noisy, MOST), ([1.0] * 9, LEAST_AT_FIRST)):
        run = run_of(target=0.0035)
        touched(run, "nozzle", values)
        touched(run, "switch", values)
        touched(run, "bed", noisy)
        counts = [len(run.touches[site]) for site in SITES]
        assert counts == [count, count, 3 * MOST - 2 * count]


@given(st.lists(st.integers(-9, 9), min_size=30, max_size=30))
def test_no_run_has_more_than_thirty_touches(steps):
    run, touches = run_of(target=0.001), [n * STEP for n in steps]
    for site in SITES:
        touched(run, site, touches)
        assert min(touches) <= run.estimates[site].z <= max(touches)
    assert sum(map(len, run.touches.values())) <= 3 * MOST
    assert run.uncertainty() > 0.0


@pytest.mark.parametrize(
    "values",
    [
        # It gives way, it slips once and stays there, it is all over
        [1.0 + 0.03 * i for i in range(10)],
        [1.0, 1.03, 1.01, 1.04, 1.0, 1.02, 1.03, 1.11, 1.11, 1.112],
        [1.0, 1.2, 0.9, 1.1, 1.3, 0.8, 1.0, 1.2, 0.9, 1.1],
    ],
)
def test_what_moves_is_told(values):
    run = run_of(target=0.008)
    words = (
        r"something moves: 10 touches lie up to .* mm apart, which is no noise$"
    )
    with pytest.raises(SamplesDiffer, match=words):
        touched(run, "nozzle", values)
    assert run.differed


def test_texture_moves_nothing():
    """Neighbours on a textured plate are up to 0.1 mm apart."""
    values = [1.0 + 0.001 * v for v in (0, 50, 8, -52, 45, -50, -38, 52, 1, 3)]
    with pytest.raises(SamplesDiffer):
        touched(run_of(target=0.008), "bed", values)
    touched(run_of(target=0.008, rough=("bed",)), "bed", values)
    wild = [1.0 + 6.0 * (v - 1.0) for v in values]
    with pytest.raises(SamplesDiffer):
        touched(run_of(target=0.008, rough=("bed",)), "bed", wild)


@pytest.mark.parametrize(
    ("earlier", "target", "count"),
    [(QUIET, 0.008, 2), (UNKNOWN, 0.008, 5), (QUIET, None, 3)],
)
def test_touches_that_are_expected(earlier, target, count):
    assert run_of(earlier, target).expected_touches(sampling(3)) == count


# What sticks to the nozzle

FALLING = (1.5825, 1.5725, 1.565, 1.56, 1.5575)
HIGHER = "the first touch was 0.0196 mm higher than the next ones"


@pytest.mark.parametrize(
    ("values", "earlier", "options", "text"),
    [
        ((1.0, 1.001, 1.0, 1.001, 1.0), UNKNOWN, {}, ""),
        ((1.0, 1.001), QUIET, {}, ""),
        ((1.02, *[1.0, 1.001] * 4), UNKNOWN, {}, HIGHER),
        ((1.02, *[1.0, 1.001] * 4), QUIET, {}, "higher"),
        # Lower is not pressed flat, but it is no agreement, either
        ((1.0, *[1.02, 1.021] * 4), UNKNOWN, {}, DOUBT),
        # Nor is the first one alone far from the others where all of them fall
        (
            FALLING,
            UNKNOWN,
            {"samples": 5, "tolerance": 0.1},
            "each touch was lower than the one before, by 0.0250 mm in all",
        ),
        # Few of them fall by chance, but those of a quiet nozzle do not
        (FALLING[:3], UNKNOWN, {"samples": 3, "tolerance": 0.1}, ""),
        (FALLING[:3], QUIET, {"samples": 3, "tolerance": 0.1}, "each touch"),
        # Less than noise
        ((1.009, 1.0, 1.001, 1.0, 1.0), UNKNOWN, {}, ""),
        ((1.009, 1.0, 1.0, 1.0), QUIET, {"samples": 4}, "0.0090"),
        # Of touches that always end on the same step, on the next one
        ((1.0, 1.0025), SAME, {}, ""),
        ((1.0025, 1.0, 1.0), SAME, {"samples": 3}, ""),
        ((1.0075, 1.0, 1.0), SAME, {"samples": 3}, "0.0075"),
        # A number of samples
        ((1.0, 1.001, 1.002), UNKNOWN, {"samples": 3}, ""),
        ((1.0, 1.02, *[1.0] * 3), UNKNOWN, {"samples": 3, "retries": 1}, DOUBT),
        ((1.0, 1.02), UNKNOWN, {"samples": 3}, DOUBT),
    ],
)
def test_nozzle_that_may_be_dirty(values, earlier, options, text):
    run = run_of(earlier, None if "samples" in options else 0.008)
    series = run.begin("nozzle", sampling(**options))
    try:
        for z in values:
            if not series.is_complete():
                series.add(z)
    except SamplesDiffer:
        pass
    found = run.doubt("nozzle")
    assert text in found and bool(found) == bool(text)


# Printers at random


@pytest.mark.parametrize(
    ("sigma", "setting", "first"),
    [
        (0.003, Setting(samples=AUTO), False),
        (0.010, Setting(0.005, 10), False),
        (0.008, Setting(samples=AUTO), True),
    ],
)
def test_95_of_100_are_inside_whatever_was_rejected(sigma, setting, first):
    noise = Noise("normal", sigma)
    assert 0.90 <= coverage(noise, setting, 600, first=first) <= 0.98


def test_noise_that_has_grown_counts_at_once():
    """By the history alone it would be 70 % for ten runs."""
    parts = grown(0.003, 0.010, Setting(0.02, 3), 150, runs=4)
    assert min(parts) >= 0.8


def test_touches_and_errors_of_samples_auto():
    """A history spares touches; without one a second run has it."""
    draw, counts, errors = random.Random(4), [], []
    for _ in range(40):
        printer = DrawnPrinter(draw, Noise("", 0.003))
        for number in range(20):
            run = printer.run(Setting(samples=AUTO))
            counts.append((number, printer.touched()))
            errors.append(run.error)
    of_first = statistics.mean(count for n, count in counts if n == 0)
    of_known = statistics.mean(count for n, count in counts if n >= 10)
    assert of_first <= 15.6 and of_known <= 7.6
    assert statistics.stdev(errors) <= 0.004


def test_uncertainty_covers_texture():
    """Each touch of the bed is at another point, 15 um off the mean surface."""
    draw = random.Random(4)
    noises = {"nozzle": 0.003, "switch": 0.003, "bed": math.hypot(0.003, 0.015)}

    def touches(site: str) -> list[float]:
        return [
            math.floor(draw.gauss(5.0, noises[site]) / STEP) * STEP
            for _ in range(30)
        ]

    for known in (SITES, SITES[:2], ()):
        inside, errors = 0, []
        for _ in range(400):
            earlier = {
                site: [
                    spread_of(touches(site)[:6])
                    for _ in range(10 if site in known else 0)
                ]
                for site in SITES
            }
            run = RunStatistics(STEP, earlier, 0.013, ("bed",))
            for site in SITES:
                touched(run, site, touches(site))
            nozzle, switch, bed = (run.estimates[site].z for site in SITES)
            errors.append(bed - switch + nozzle - 5.0)
            inside += abs(errors[-1]) <= run.uncertainty()
        assert 0.92 <= inside / 400 <= 0.98
        assert statistics.stdev(errors) <= 0.0072


def test_texture_that_nobody_knows_has_no_outliers():
    """Points up to 50 um off, where a touch may be 14."""
    draw = random.Random(4)
    for _ in range(100):
        run = run_of(rough=("bed",))
        values = [draw.gauss(5.0, ROUGH) for _ in range(5)]
        touched(run, "bed", values, samples=5, tolerance=0.2)
        assert run.estimates["bed"].spread.dof == 4
