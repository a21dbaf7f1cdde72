"""z_touch/report/trend.py and steps.py: what is found in many runs, and what is not."""

from __future__ import annotations

import random
import statistics

import pytest

from tools.kit.runs import make_run, make_runs, read
from z_touch.report import steps, trend
from z_touch.report.noise import f_limit, pool_usual
from z_touch.z_calibration.statistics import Spread


def worn(records):
    """Names of heights that drift, and sites whose spreads grow."""
    runs = read(records)
    drifts = [drift.height for drift in trend.drifts(runs)]
    return drifts + [growth.site for growth in trend.growths(runs)]


def changed(records):
    """By name, the first run after it and its size (mm)."""
    return [
        (change.height, change.number, change.by)
        for change in trend.changes(read(records))
    ]


# Wear


@pytest.mark.parametrize(
    ("noise", "touches"), [(0.001, 2), (0.003, 2), (0.01, 5)]
)
def test_nothing_is_found_on_a_printer_without_it(noise, touches):
    """A look at every tenth run; those between see nearly the same."""
    found, runs, draw = [], [], random.Random(f"{noise}")
    for number in range(300):
        runs.append(make_run(draw, noise, touches=touches))
        if number % 10 == 9:
            found += worn(runs)
    assert found + changed(runs) == []


def drifting(draw, number, **changes):
    """The n-th run after 60 good ones: 10 um in a hundred."""
    return make_run(draw, moved={"switch": 0.01 * number / 100}, **changes)


def test_drift_of_ten_um_is_found_within_a_hundred_runs():
    draw = random.Random(4)
    for _ in range(4):
        runs, found = [make_run(draw) for _ in range(60)], []
        for number in range(1, 101):
            runs.append(drifting(draw, number))
            if number % 10 == 0 and not found:
                found = worn(runs)
        # A switch is part of both, and either may be seen first
        assert found and set(found) <= {"switch - nozzle", "probe - switch"}
        assert changed(runs) == []


def test_it_says_by_how_much_and_in_how_many_runs():
    runs = make_runs(40, homing=0.0, noise=0.0)
    for number, run in enumerate(runs):
        run["sites"]["bed"]["z"] += 0.001 * number
    (drift,) = trend.drifts(read(runs))
    assert drift.height == "probe - switch"
    assert (drift.by, drift.runs) == (pytest.approx(0.0405, abs=0.002), 40)
    # Of a long one what is of late
    runs = make_runs(150, homing=0.0, noise=0.0)
    for number, run in enumerate(runs):
        run["sites"]["bed"]["z"] += 0.001 * number
    (drift,) = trend.drifts(read(runs))
    assert (drift.by, drift.runs) == (pytest.approx(0.1, abs=0.002), 100)


def test_switch_that_wears_out_is_found():
    draw = random.Random(5)
    runs = [make_run(draw) for _ in range(60)]
    for number in range(100):
        bed = 0.003 + 0.03 * number / 100
        runs.append(make_run(draw, worn={"bed": bed}))
    (growth,) = trend.growths(read(runs))
    assert (growth.site, growth.runs) == ("bed", 160)
    assert 0.002 < growth.before < 0.006 < 0.02 < growth.after < 0.04
    assert trend.growths(read(runs[:39])) == []


def test_noise_that_grows_slowly_is_found_against_the_first_runs():
    """From 2 to 8 um within 500 runs, which no hundred of them show."""
    draw = random.Random(5)
    runs = [
        make_run(
            draw,
            noise=0.002,
            touches=3,
            worn={"bed": 0.002 + 0.006 * n / 500},
        )
        for n in range(500)
    ]
    ends = [end for end in range(40, 500, 10) if worn(runs[:end])]
    assert 100 < ends[0] < 400
    assert worn(runs[: ends[0]]) == ["bed"]


def test_drift_wants_twenty_runs():
    runs = [
        make_run(random.Random(n), moved={"switch": 0.002 * n})
        for n in range(20)
    ]
    assert worn(runs[:19]) == []
    assert "switch - nozzle" in worn(runs)


def test_statistic_of_mann_and_kendall():
    """Of the tables in Kendall's Rank Correlation Methods: n = 10, S = 45."""
    assert trend.kendall(list(range(10))) == pytest.approx(45 / 125**0.5)
    assert trend.kendall(list(range(10, 0, -1))) == pytest.approx(
        -45 / 125**0.5
    )
    assert trend.kendall([1.0] * 10) == 0.0
    # Two ties of two: variance less by 2 * 2 * 1 * 9 / 18
    assert trend.kendall([1, 1, 2, 2]) == pytest.approx(
        4 / ((4 * 3 * 13 - 2 * 2 * 9) / 18) ** 0.5
    )


def test_accident_of_one_run_is_no_growth():
    usual = [Spread(1e-6, 4)] * 9
    assert pool_usual([*usual, Spread(1e-3, 4)], 0.001).variance == 1e-6
    # Of few it is not known which are the accidents
    assert pool_usual([*usual[:4], Spread(1e-3, 4)], 0.001).variance > 1e-4


def test_limits_of_f():
    """Of its tables: 1 % with 10 and 20 degrees of freedom is 3.37."""
    assert f_limit(10, 20, 2.326) == pytest.approx(3.37, rel=0.02)
    assert f_limit(1, 1, 4.5) == float("inf")


# Changes


def moved_from(first, count=120, **sites):
    draw = random.Random(1)
    return [
        make_run(
            draw,
            touches=3,
            time=1.7e9 + 9e4 * n,
            moved=sites if n >= first else {},
        )
        for n in range(count)
    ]


@pytest.mark.parametrize(
    ("sites", "name", "by"),
    [
        (
            {"nozzle": -0.25, "switch": -0.25, "bed": -0.25},
            "nozzle height",
            -0.25,
        ),
        ({"bed": 0.07}, "probe - switch", 0.07),
        ({"bed": 0.015}, "probe - switch", 0.015),
        ({"switch": 0.2, "bed": 0.2}, "switch - nozzle", 0.2),
    ],
)
def test_step_is_found_with_its_size_and_the_first_run_after_it(
    sites, name, by
):
    records = moved_from(40, **sites)
    ((found, number, size),) = changed(records)
    assert found == name
    assert abs(number - 40) <= 1
    assert size == pytest.approx(by, abs=0.004)
    assert worn(records) == []
    # With the fifth run after it, or a bit later where it is small
    early = [end for end in range(40, 60) if changed(records[:end])]
    assert 45 <= early[0] <= 48


def test_nothing_is_found_twice_in_many_runs():
    """Three steps, one after the other, and hundreds of runs after them."""
    draw, runs = random.Random(2), []
    for n in range(400):
        moved = {
            "nozzle": -0.25 * (n >= 50) - 0.21 * (n >= 200),
            "switch": -0.25 * (n >= 50),
            "bed": -0.25 * (n >= 50) + 0.05 * (n >= 120),
        }
        runs.append(make_run(draw, touches=3, moved=moved))
    names = [(name, number) for name, number, _ in changed(runs)]
    assert names == [
        ("nozzle height", 50),
        ("probe - switch", 120),
        ("nozzle height", 200),
        ("switch - nozzle", 200),
    ]


@pytest.mark.parametrize("block", [1, 12])
@pytest.mark.parametrize("apart", [0.1, 0.04])
def test_plates_in_turn_are_no_change(block, apart):
    """Each is back where it has been, in its last turn or the one before."""
    draw = random.Random(1)
    runs = [
        make_run(draw, touches=3, moved={"bed": apart * (n // block % 2)})
        for n in range(200)
    ]
    assert changed(runs) == []


def test_what_a_step_explains_better_is_no_drift():
    """Although later values are higher than earlier ones."""
    draw = random.Random(1)
    step = [draw.gauss(0.05 * (n >= 30), 0.003) for n in range(60)]
    line = [draw.gauss(0.001 * n, 0.003) for n in range(60)]
    for values, is_drift in ((step, False), (line, True)):
        assert trend.kendall(values) > trend.TREND_SIGMA
        assert bool(trend.drifted(values)) == is_drift


def test_what_hangs_together_counts_as_fewer_runs():
    """Two plates, six runs each on average: 33 of 60 where each counts."""
    found = 0
    for seed in range(60):
        draw, on, values = random.Random(seed), False, []
        for _ in range(100):
            on ^= draw.random() < 1 / 6
            values.append(draw.gauss(0.04 * on, 0.003))
        found += any(steps.find_step(values[:e]) for e in range(10, 101, 5))
    assert found <= 25


def test_single_runs_that_are_off_are_no_step_and_hide_none():
    values = [0.001 * (n % 3) for n in range(30)]
    values[10] = values[27] = 0.3
    assert steps.find_step(values) == 0
    stepped = values[:15] + [v + 0.02 for v in values[15:]]
    assert steps.find_step(stepped) == 15


def test_drift_that_has_just_begun_is_no_step():
    draw = random.Random(8)
    for by in (0.0005, 0.001, 0.002):
        values = [draw.gauss(max(0, n - 60) * by, 0.0025) for n in range(85)]
        for end in range(60, 86):
            assert steps.find_step(values[:end]) == 0


def test_bent_line_is_the_best_one():
    draw = random.Random(9)
    values = [draw.gauss(max(0, n - 7) * 0.5, 1.0) for n in range(20)]

    def left(bend):
        x = [max(0, n - bend) for n in range(20)]
        mean_x, mean = statistics.mean(x), statistics.mean(values)
        pairs = [(a - mean_x, v - mean) for a, v in zip(x, values)]
        slope = sum(a * v for a, v in pairs) / sum(a**2 for a, _ in pairs)
        return sum((v - slope * a) ** 2 for a, v in pairs)

    least = min(left(bend) for bend in range(19))
    assert steps.square_off_bend(values) == pytest.approx(least)


def test_step_wants_five_runs_on_both_sides():
    values = [0.001 * (n % 3) for n in range(24)] + [0.1] * 5
    assert steps.find_step(values) == 24
    assert steps.find_step(values[:-1]) == 0
    assert steps.find_step(values[-8:]) == 0
    assert steps.find_steps(values) == [24]


# Which runs are compared


def test_hot_runs_are_not_compared_with_cold_ones():
    cold = make_runs(50)
    hot = make_runs(
        50,
        2,
        moved={"switch": 0.03},
        temperatures={"extruder": 150.0, "heater_bed": 110.0},
    )
    assert changed(cold + hot) == []
    for run in hot:
        run["temperatures"]["heater_bed"] = 69.0
    assert "switch - nozzle" in [name for name, _, _ in changed(cold + hot)]


def test_refused_run_says_nothing_and_hides_nothing():
    moved = {"bed": 0.1}
    runs = make_runs(20) + make_runs(8, 2, moved=moved)
    refused = make_run(random.Random(3), ok=False, moved={"bed": 9.0})
    assert changed(runs) == changed([*runs, refused])
    assert changed([refused]) == worn([refused]) == []


def rough(draw, number, first, spread=3.0):
    """From a run on its touches are spread over a textured plate."""
    if number < first:
        return make_run(draw, time=1.7e9 + 9e4 * number)
    options = {"bed_spread": spread} if spread else {}
    return make_run(
        draw,
        time=1.7e9 + 9e4 * number,
        worn={"bed": 0.015},
        moved={"bed": 0.03},
        touches=6,
        **options,
    )


@pytest.mark.parametrize(("spread", "is_found"), [(3.0, False), (0.0, True)])
def test_bed_spread_is_neither_wear_nor_a_step(spread, is_found):
    """Found is what looks the same without it, or the test would prove nothing."""
    draw = random.Random(5)
    runs = [rough(draw, number, 30, spread) for number in range(80)]
    names = [name for name, _, _ in changed(runs)]
    assert (names == ["probe - switch"]) is is_found
    assert (worn(runs) == ["bed"]) is is_found
