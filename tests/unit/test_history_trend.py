"""z_touch/history/trend.py: what is told of many runs, and what is not."""

from __future__ import annotations

import random

import pytest

from tests.unit.runs import make_run, make_runs
from tools.kit.cases import slow
from z_touch.history import trend


def names(worn):
    return [name for name, text in worn]


def body(run):
    return trend.body(run)


# The fingerprint


def test_fingerprint_wants_five_runs():
    assert trend.summarize_runs(make_runs(4)).fingerprint.middle is None
    known = trend.summarize_runs(make_runs(5)).fingerprint
    assert known.middle == pytest.approx(6.415, abs=0.01)
    assert known.sigma < 0.01
    # It follows what changes slowly
    slow = trend.fingerprint_of([0.001 * n for n in range(100)])
    assert (slow.runs, slow.middle) == (50, pytest.approx(0.0745))


@pytest.mark.parametrize(
    ("sigma", "shift", "is_off"),
    [
        (0.002, 0.049, False),
        (0.002, 0.051, True),
        (0.002, -0.051, True),
        # Five times its noise where that is more
        (0.02, 0.09, False),
        (0.02, 0.11, True),
    ],
)
def test_run_departs_from_both_limits_on(sigma, shift, is_off):
    known = trend.Fingerprint(6.4, sigma, 20)
    assert trend.departs(6.4 + shift, known) is is_off
    assert not trend.departs(99.0, trend.NO_FINGERPRINT)


def test_one_run_that_departs_is_forgotten_two_are_another_nozzle():
    before = make_runs(20)
    other = {"switch": 0.2, "bed": 0.2}
    draw = random.Random(2)
    odd = [make_run(draw, moved=other) for _ in range(4)]
    known = trend.summarize_runs(before)
    assert known.since == 0
    assert (
        trend.summarize_runs([*before, odd[0]]).fingerprint == known.fingerprint
    )
    more = trend.summarize_runs([*before, odd[0], *make_runs(3, 3)])
    assert (more.since, more.fingerprint.runs) == (0, 23)
    fresh = trend.summarize_runs([*before, *odd])
    assert (fresh.since, fresh.fingerprint.runs) == (20, 4)
    # Runs that were refused have no say
    refused = make_run(draw, ok=False, moved={"switch": 9.0})
    assert trend.summarize_runs([*before, refused, refused]) == known


def test_noise_does_not_make_two_odd_runs_another_nozzle():
    before = make_runs(20)
    draw = random.Random(2)
    odd = [make_run(draw, moved={"switch": z}) for z in (0.2, 0.4)]
    assert trend.summarize_runs([*before, *odd]).since == 0


def test_residue_is_told_among_runs_that_were_as_hot():
    """38 um at a noise of 3 um: all found, no false warning in 500 runs."""
    draw = random.Random(9)
    runs, told = [], 0
    for _ in range(500):
        run = make_run(draw)
        known = trend.summarize_runs(runs[-60:])
        bodies = trend.bodies_as_hot(runs[-60:], known, run)
        told += bool(trend.departure(body(run), bodies))
        if len(bodies) > 19:
            found = trend.departure(body(run) - 0.038, bodies)
            assert found == pytest.approx(-0.038, abs=0.015)
        runs.append(run)
    assert told == 0


def test_residue_is_no_matter_of_runs_that_were_colder():
    cold = make_runs(20, temperatures={"extruder": 150.0, "heater_bed": 20.0})
    hot = make_runs(6, 2, moved={"nozzle": 0.038})
    known = trend.summarize_runs(cold)
    dirty = body(hot[-1])
    assert trend.departure(dirty, trend.bodies_as_hot(cold, known, cold[0]))
    assert not trend.departure(dirty, trend.bodies_as_hot(cold, known, hot[-1]))
    # Told once: the next run is as the last one was
    bodies = trend.bodies_as_hot(cold, known, cold[0])
    assert not trend.departure(dirty, [*bodies, dirty])
    # Too few say nothing
    assert not trend.departure(dirty, bodies[:4])


# Wear


@pytest.mark.parametrize(
    ("noise", "touches"), [(0.001, 2), (0.003, 2), (0.01, 5)]
)
@pytest.mark.parametrize("printers", [1, slow(8)])
def test_no_wear_is_told_of_a_printer_without_it(noise, touches, printers):
    """A look at every tenth run; those between see nearly the same."""
    found, draw = [], random.Random(f"{noise}")
    for _ in range(printers):
        runs = []
        for number in range(500):
            run = make_run(draw, noise, touches=touches)
            runs = [*runs, run][-120:]
            if number % 10 == 9:
                run["wear"] = names(trend.wear(runs))
                found += run["wear"]
    assert found == []


def drifting(draw, number, **changes):
    """The n-th run after 60 good ones: 10 um in a hundred."""
    return make_run(draw, moved={"switch": 0.01 * number / 100}, **changes)


def first_told(draw, make):
    """After how many runs, and what."""
    runs = [make_run(draw) for _ in range(60)]
    for number in range(1, 101):
        runs.append(make(draw, number))
        worn = trend.wear(runs) if number % 10 == 0 else []
        if worn:
            return number, dict(worn)
    return None, {}


@pytest.mark.parametrize("printers", [4, slow(24)])
def test_drift_of_ten_um_is_found_within_a_hundred_runs(printers):
    draw = random.Random(4)
    for _ in range(printers):
        number, worn = first_told(draw, drifting)
        assert number is not None
        assert set(worn) <= {"switch - nozzle", "probe - switch"}
    text = worn["switch - nozzle"]
    assert text.startswith("switch - nozzle has drifted by 0.0")
    assert "check nozzle, probe" in text


def test_switch_that_wears_out_is_found():
    def worn(draw, number):
        return make_run(draw, worn={"bed": 0.003 + 0.03 * number / 100})

    number, found = first_told(random.Random(5), worn)
    assert number is not None
    assert set(found) == {"spread of the bed's touches"}
    assert "has grown from" in found["spread of the bed's touches"]


def test_what_was_told_is_not_told_again():
    draw = random.Random(6)
    runs = [drifting(draw, number) for number in range(100)]
    worn = names(trend.wear(runs))
    assert "switch - nozzle" in worn
    runs[-1]["wear"] = worn
    assert trend.wear(runs) == []
    runs += [make_run(draw, moved={"switch": 0.01}) for _ in range(19)]
    assert trend.wear(runs) == []


def test_exchanged_nozzle_is_no_wear():
    other = {"switch": 0.2, "bed": 0.2}
    runs = make_runs(50) + make_runs(50, 2, moved=other)
    assert trend.wear(runs) == []


def test_what_was_long_ago_is_no_trend():
    higher = {"moved": {"switch": 0.03}}
    runs = make_runs(50) + make_runs(100, 2, **higher)
    assert trend.wear(runs) == []
    assert "switch - nozzle" in names(trend.wear(runs[:-20]))


def test_drift_less_than_it_matters_is_not_told():
    draw = random.Random(7)
    runs = [
        make_run(draw, 0.0004, moved={"switch": 0.004 * n / 100}, homing=0.0)
        for n in range(100)
    ]
    values = [body(run) for run in runs]
    assert abs(trend.kendall(values)) > trend.TREND_SIGMA
    assert "switch - nozzle" not in names(trend.wear(runs))


def test_hot_runs_are_not_compared_with_cold_ones():
    cold = make_runs(50)
    hot = make_runs(
        50,
        2,
        moved={"switch": 0.03},
        temperatures={"extruder": 150.0, "heater_bed": 110.0},
    )
    assert trend.wear(cold + hot) == []
    for run in hot:
        run["temperatures"]["heater_bed"] = 69.0
    assert "switch - nozzle" in names(trend.wear(cold + hot))


def test_trend_wants_twenty_runs():
    runs = [
        make_run(random.Random(n), moved={"switch": 0.002 * n})
        for n in range(20)
    ]
    assert trend.wear(runs[:19]) == []
    assert "switch - nozzle" in names(trend.wear(runs))


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
