"""z_touch/history/trend.py: what is told of many runs, and what is not."""

from __future__ import annotations

import random
import statistics
import time

import pytest

from tools.kit.cases import slow
from tools.kit.runs import make_run, make_runs
from z_touch.history import steps, trend


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


@pytest.mark.parametrize(("sd", "part"), [(0.003, 1.0), (0.006, 0.89)])
def test_so_much_residue_is_found_after_twenty_clean_runs(sd, part):
    """And two false warnings in 5,400 runs at most."""
    draw, found, told, many = random.Random(1), 0, 0, 1000
    for _ in range(many):
        bodies = [draw.gauss(6.4, sd) for _ in range(20)]
        found += bool(trend.departure(draw.gauss(6.362, sd), bodies))
    assert found >= part * many
    for _ in range(18):
        bodies = [draw.gauss(6.4, sd) for _ in range(300)]
        told += sum(
            bool(trend.departure(bodies[n], bodies[max(0, n - 50) : n]))
            for n in range(1, 300)
        )
    assert told <= 2


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
    draw, texts = random.Random(4), []
    for _ in range(printers):
        number, worn = first_told(draw, drifting)
        assert number is not None
        # A switch is part of both, and either may be seen first
        assert set(worn) <= {"switch - nozzle", "probe - switch"}
        texts.append(worn.get("switch - nozzle"))
    found = [text for text in texts if text]
    assert len(found) > printers / 2
    for text in found:
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
    """And told with its first run, so it is no change, either."""
    other = {"switch": 0.2, "bed": 0.2}
    runs = make_runs(50) + make_runs(50, 2, moved=other)
    assert trend.find(runs) == ([], [], [])


def test_what_was_long_ago_is_no_trend():
    runs = make_runs(30) + [
        make_run(random.Random(n), moved={"switch": 0.0004 * n})
        for n in range(50)
    ]
    runs += make_runs(100, 2, moved={"switch": 0.02})
    assert trend.wear(runs) == []
    assert "switch - nozzle" in names(trend.wear(runs[:80]))


def test_drift_less_than_it_matters_is_not_told():
    draw = random.Random(7)
    runs = [
        make_run(draw, 0.0004, moved={"switch": 0.004 * n / 100}, homing=0.0)
        for n in range(100)
    ]
    values = [body(run) for run in runs]
    assert abs(trend.kendall(values)) > trend.TREND_SIGMA
    assert "switch - nozzle" not in names(trend.wear(runs))


def changes(runs):
    return {change["what"]: change for change in trend.find(runs).changed}


def test_hot_runs_are_not_compared_with_cold_ones():
    cold = make_runs(50)
    hot = make_runs(
        50,
        2,
        moved={"switch": 0.03},
        temperatures={"extruder": 150.0, "heater_bed": 110.0},
    )
    assert changes(cold + hot) == {}
    for run in hot:
        run["temperatures"]["heater_bed"] = 69.0
    assert "switch - nozzle" in changes(cold + hot)


# The good runs before it have told what there is
def test_run_that_was_refused_tells_of_no_change():
    moved = {"bed": 0.1}
    runs = make_runs(20) + make_runs(8, 2, moved=moved)
    refused = make_run(random.Random(3), ok=False, moved=moved)
    assert "probe - switch" in changes(runs)
    assert changes([*runs, refused]) == {}


# Steps


def living(number, options, seed=1, **given):
    """So many runs as a printer has them, and all that was told."""
    draw, runs, texts = random.Random(seed), [], []
    for n in range(number):
        run = make_run(draw, touches=3, time=1.7e9 + 9e4 * n, **options(n))
        runs.append({**run, **given})
        told = trend.find(runs)
        runs[-1].update(wear=told.wear, changed=told.changed)
        texts += [(n, text) for text in told.texts]
    return runs, texts


def moved_from(first, **sites):
    return lambda n: {"moved": sites if n >= first else {}}


@pytest.mark.parametrize(
    ("sites", "name", "by", "cause", "plate", "later"),
    [
        (
            {"nozzle": -0.25, "switch": -0.25, "bed": -0.25},
            "nozzle height",
            -0.25,
            "position_endstop",
            "",
            4,
        ),
        ({"bed": 0.07}, "probe - switch", 0.07, "another plate", "", 4),
        ({"bed": 0.05}, "probe - switch", 0.05, "another plate", "a", 4),
        # May be two plates in turn, as long as it has not held
        ({"bed": 0.05}, "probe - switch", 0.05, "another plate", "", 39),
        ({"bed": 0.015}, "probe - switch", 0.015, "PLATE=name", "", 39),
    ],
)
def test_step_is_told_once_with_its_size_and_day(
    sites, name, by, cause, plate, later
):
    runs, texts = living(120, moved_from(40, **sites), plate=plate)
    ((number, text),) = texts
    assert number - 40 in range(later, later + 6)
    assert "drift" not in text and "wear" not in text
    words = f"{name} has changed by "
    assert text.startswith(words) and cause in text
    size = float(text[len(words) :].split()[0])
    assert size == pytest.approx(by, abs=0.004)
    day = time.strftime("%Y-%m-%d", time.localtime(runs[40]["time"]))
    assert f" mm on {day}, between two runs: " in text
    (change,) = runs[number]["changed"]
    assert (change["what"], change["runs"]) == (name, number - 39)
    assert change["told"] is True


def test_step_without_a_time_has_no_day():
    _, texts = living(60, moved_from(40, bed=0.1), time=0.0)
    ((_, text),) = texts
    assert " mm, between two runs: another plate" in text


def test_step_begins_a_new_stretch():
    """What was before it is no part of a drift, nor of another step."""
    runs, _ = living(60, moved_from(40, bed=0.1))
    assert trend.begins_of("probe - switch", runs) == [40]
    draw = random.Random(3)
    more = [
        make_run(draw, touches=3, moved={"bed": 0.1 + 0.0003 * n})
        for n in range(60)
    ]
    worn = names(trend.wear(runs + more))
    assert worn == ["probe - switch"]
    # A nozzle that is exchanged in between is no change of the plate
    assert trend.begins_of("switch - nozzle", runs) == []


@pytest.mark.parametrize("block", [slow(1), slow(2), slow(5), 10, slow(25)])
@pytest.mark.parametrize("apart", [0.04, slow(0.025), slow(0.01)])
def test_plates_in_turn_are_no_alarm(block, apart):
    def options(n):
        return {"moved": {"bed": apart * (n // block % 2)}}

    runs, texts = living(200, options)
    assert texts == []
    assert not any(run["changed"] or run["wear"] for run in runs)


@pytest.mark.parametrize(
    ("before", "after", "is_held"),
    [
        ("A" * 30, "B" * 40, True),
        ("A" * 30, "B" * 39, False),
        # Single runs are no plate
        ("A" * 30, "B" * 20 + "A" + "B" * 19, True),
        ("A" * 30, "B" * 20 + "A" * 5 + "B" * 15, False),
        ("A" * 15 + "B" * 5 + "A" * 10, "B" * 40, False),
        # It is a plate that was there before
        ("B" * 5 + "A" * 70, "B" * 40, False),
    ],
)
def test_step_has_held_where_nothing_was_back(before, after, is_held):
    values = [0.04 * (letter == "B") for letter in before + after]
    assert steps.has_held(values, len(before)) is is_held


def test_what_is_back_where_it_was_is_told_to_nobody():
    def options(n):
        return {"moved": {"bed": 0.1 * (n // 12 % 2)}}

    runs, texts = living(36, options)
    told = [c["told"] for run in runs for c in run["changed"]]
    assert told == [True, False]
    assert len(texts) == 1


def test_what_a_step_explains_better_is_no_drift():
    """Although later values are higher than earlier ones."""
    draw = random.Random(1)
    step = [draw.gauss(0.05 * (n >= 30), 0.003) for n in range(60)]
    line = [draw.gauss(0.001 * n, 0.003) for n in range(60)]
    for values, is_drift in ((step, False), (line, True)):
        assert trend.kendall(values) > trend.TREND_SIGMA
        text = trend.shifted("bed", values, trend.no_pause)
        assert ("bed has drifted" in text) == is_drift


def test_small_steps_are_no_drift():
    """Of which a line leaves little more than a step."""
    told = 0
    for seed in range(150):
        draw = random.Random(seed)
        n = draw.choice((40, 60, 100))
        at = draw.randrange(5, n - 4)
        values = [draw.gauss(0.012 * (k >= at), 0.003) for k in range(n)]
        told += bool(trend.shifted("bed", values, trend.no_pause))
    # 13 by the trend alone
    assert told == 0


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


def test_names_keep_plates_apart():
    """A drift is found though plates are changed each time."""

    def options(n):
        moved = {"bed": 0.04 * (n % 2), "switch": 2e-4 * max(0, n - 60)}
        return {"moved": moved, "plate": ("smooth", "textured")[n % 2]}

    _, texts = living(160, options)
    assert texts and all("has drifted" in text for _, text in texts)
    assert any("probe - switch has drifted" in text for _, text in texts)
    _, texts = living(60, lambda n: {**options(n), "plate": ""})
    assert not any("probe - switch has drifted" in text for _, text in texts)


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


def test_noise_that_grows_slowly_is_told_against_the_first_runs():
    """From 2 to 8 um within 500 runs, which no hundred of them show."""

    def options(n):
        return {"noise": 0.002, "worn": {"bed": 0.002 + 0.006 * n / 500}}

    draw = random.Random(5)
    runs = [make_run(draw, touches=3, **options(n)) for n in range(500)]
    for end in range(40, 500, 10):
        worn = dict(trend.wear(runs[:end]))
        if worn:
            break
    assert set(worn) == {"spread of the bed's touches"}
    assert 100 < end < 400
    text = worn["spread of the bed's touches"]
    assert f"mm in the last {end} runs" in text
    assert "has grown from 0.002" in text


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


# Of a textured plate: one point of it, or many


def rough(draw, number, first, spread=3.0):
    """From a run on its touches are spread over it."""
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


@pytest.mark.parametrize(("spread", "is_told"), [(3.0, False), (0.0, True)])
def test_bed_spread_is_neither_wear_nor_a_step(spread, is_told):
    """Told is what looks the same without it, or the test would prove nothing."""
    runs, told, draw = [], [], random.Random(5)
    for number in range(80):
        run = rough(draw, number, 30, spread)
        found = trend.find([*runs, run])
        run.update(wear=found.wear, changed=found.changed)
        runs.append(run)
        told += found.texts
    assert bool(told) is is_told, told
    assert any("probe - switch" in text for text in told) is is_told


def test_runs_before_there_was_such_an_option_are_those_without():
    old = make_run(random.Random(1))
    assert trend.is_like({**old, "bed_spread": 0.0}, old)
    assert not trend.is_like({**old, "bed_spread": 3.0}, old)
    assert not trend.is_like({**old, "bed_spread": 3.0}, {"bed_spread": 4.0})
