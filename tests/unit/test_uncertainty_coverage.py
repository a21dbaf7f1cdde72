"""What is told of an offset holds: samples that were rejected count for its spread.

The table in docs/performance.md has more; here are the corners that fail first.
"""

from __future__ import annotations

import itertools
import math
import random
import statistics

import pytest

from tools.bench.coverage import (
    STEP,
    DrawnPrinter,
    Noise,
    Setting,
    coverage,
    grown,
    normal,
    student,
)
from z_touch.core.sampling import AUTO, Sampling
from z_touch.uncertainty import adaptive, recent, tails
from z_touch.uncertainty.estimate import (
    UNKNOWN,
    Spread,
    after_choice,
    estimate,
    expanded,
    spread_of,
    weighed,
)

pytestmark = pytest.mark.slow


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


@pytest.mark.parametrize("after", [0.006, 0.010])
def test_noise_that_has_grown_counts_at_once(after):
    """By the history it would be 70 % for ten runs."""
    parts = grown(0.003, after, Setting(0.02, 3), 90, runs=4)
    assert parts[0] >= 0.8
    # 95 % at most 1.5 standard deviations of chance off
    assert sum(parts[1:]) / 3 >= 0.93


AUTOMATIC = Setting(samples=AUTO, target=0.005)


@pytest.mark.parametrize("sigma", [0.005, 0.008])
def test_a_first_run_that_ends_early_is_worth_what_it_says(sigma):
    """By chance it looks quiet, and stops for that: 95 % is not 91."""
    setting = Setting(samples=AUTO)
    part = coverage(Noise("normal", sigma), setting, 1500, first=True)
    assert 0.93 <= part <= 0.97


def touches_of(printer):
    return sum(len(touches) for touches in printer.plan.touches.values())


@pytest.mark.parametrize("sigma", [0.002, 0.003, 0.004])
def test_target_is_kept_as_long_as_there_are_touches_left(sigma):
    """Also of a run that is noisier than those before it."""
    draw, touches, inside = random.Random(f"{sigma}"), [], []
    for _ in range(4):
        printer = DrawnPrinter(draw, Noise("", sigma))
        for number in range(30):
            if number == 25:
                printer.noise = Noise("", 1.5 * sigma)
            run = printer.run(AUTOMATIC)
            touches.append(touches_of(printer))
            assert run.worth <= AUTOMATIC.target or touches[-1] >= 30
            inside.append(abs(run.error) <= run.worth)
    assert max(touches) <= 30
    assert sum(inside) / len(inside) >= 0.9
    assert sigma > 0.003 or sum(touches) / len(touches) < 24


def test_target_below_what_steps_allow_ends_at_what_can_be_had():
    """With ten touches of each site, and no error."""
    least = adaptive.least_uncertainty(STEP)
    assert least == pytest.approx(0.887 * STEP, rel=0.01)
    counting = adaptive.Automatic(0.8 * least)
    assert f"each run ends at about {least:.4f}" in counting.impossible(STEP)
    assert not adaptive.Automatic(least).impossible(STEP)
    assert not adaptive.FixedCount(3).impossible(STEP)
    printer = DrawnPrinter(random.Random(1), Noise("", 0.001))
    setting = AUTOMATIC._replace(target=0.8 * least)
    runs = [printer.run(setting) for _ in range(25)]
    assert None not in [run.error for run in runs]
    assert least <= runs[-1].worth < 1.2 * least


def test_run_that_is_noisier_is_seen_before_its_last_place():
    """Later it is too late: nobody goes back to the nozzle."""
    draw, missed = random.Random(6), 0
    for _ in range(6):
        printer = DrawnPrinter(draw, Noise("", 0.003))
        for number in range(35):
            run = printer.run(AUTOMATIC)
            missed += number >= 10 and run.worth > AUTOMATIC.target
    assert missed <= 3


# Which runs count

QUIET, LOUD = Spread(0.003**2, 2), Spread(0.009**2, 2)
SITES = ("nozzle", "switch", "bed")


def begin(past, now=LOUD):
    earlier_runs = dict.fromkeys(SITES, past)
    return recent.first_like_current(
        earlier_runs, dict.fromkeys(SITES, now), STEP
    )


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
    earlier_runs = {"nozzle": [QUIET] * 13, "switch": [QUIET] * 13, "bed": past}
    now = {"nozzle": QUIET, "switch": QUIET, "bed": LOUD}
    assert recent.first_like_current(earlier_runs, now, STEP) == 10


def test_quiet_runs_before_it_are_no_part_of_what_has_grown():
    """They would hide how much it is; here one in six runs is by chance."""
    draw, early = random.Random(3), 0
    for _ in range(200):
        runs = {site: [] for site in SITES}
        for sigma in [0.003] * 12 + [0.008] * 4:
            for past in runs.values():
                values = [draw.gauss(0.0, sigma) for _ in range(3)]
                past.append(spread_of(values))
        earlier_runs = {site: past[:-1] for site, past in runs.items()}
        now = {site: past[-1] for site, past in runs.items()}
        early += recent.first_like_current(earlier_runs, now, STEP) < 11
    assert early <= 20


def test_single_accident_is_no_noise():
    accident = Spread(0.03**2, 2)
    assert recent.pool_usual([QUIET] * 8 + [accident], STEP).dof == 16
    assert recent.pool_usual([QUIET] * 3 + [accident], STEP).dof == 8


def test_alike_is_what_cannot_be_told_apart():
    spreads, shared, _ = recent.current_spreads(
        dict.fromkeys(SITES, [QUIET] * 4), dict.fromkeys(SITES, QUIET), STEP
    )
    assert shared and spreads["bed"] == Spread(pytest.approx(9e-6), 30)
    worn = {"nozzle": [QUIET] * 10, "switch": [QUIET] * 10, "bed": [LOUD] * 10}
    now = {"nozzle": QUIET, "switch": QUIET, "bed": LOUD}
    spreads, shared, _ = recent.current_spreads(worn, now, STEP)
    assert not shared and spreads["bed"].variance == pytest.approx(81e-6)


def test_a_run_alone_pays_for_what_it_chose():
    spreads, _, _ = recent.current_spreads(
        dict.fromkeys(SITES, []), dict.fromkeys(SITES, QUIET), STEP, 0.5
    )
    assert spreads["bed"].dof == pytest.approx(6 * 0.5)


def test_a_site_without_a_history_pays_for_what_it_chose():
    """The bed, in the first run with a bed_spread."""
    earlier_runs = {**dict.fromkeys(SITES, [QUIET] * 4), "bed": [UNKNOWN] * 4}
    now = {**dict.fromkeys(SITES, QUIET), "bed": LOUD}
    spreads, shared, _ = recent.current_spreads(earlier_runs, now, STEP, 0.5)
    assert not shared
    assert [spreads[site].dof for site in SITES] == [10, 10, 1]
    now["bed"] = QUIET
    spreads, shared, _ = recent.current_spreads(earlier_runs, now, STEP, 0.5)
    assert shared and spreads["bed"].dof == pytest.approx(10 + 10 + 1)


def test_who_chooses_pays_and_who_chooses_the_number_of_touches_more():
    earlier_runs, worth = dict.fromkeys(SITES, []), []
    for samples, chosen in ((4, 1.0), (4, None), (AUTO, None)):
        counting = adaptive.choose(samples, 0.03)
        counting.chosen = chosen or counting.chosen
        plan = adaptive.Plan(STEP, earlier_runs, counting)
        touches = itertools.cycle([1.0, 1.005, 1.002, 1.01])
        sampling = Sampling(4, 1.0, 0, "average", 2.0, 4.0, 6.0)
        for site in SITES:
            plan.collect(site, touches.__next__, sampling, None, "")
        assert sum(map(len, plan.samples.values())) == 12
        worth.append(plan.uncertainty())
    free, fixed, automatic = worth
    assert fixed > 1.02 * free and automatic > 1.02 * fixed


@pytest.mark.parametrize(
    ("dof", "below", "sigmas", "table"),
    [(2, 20, 2.326, 5.85), (10, 20, 1.645, 2.35), (20, 20, 2.326, 2.94)],
)
def test_limit_is_that_of_the_tables_of_f(dof, below, sigmas, table):
    assert recent.f_limit(dof, below, sigmas) == pytest.approx(table, rel=0.02)


# Heavy tails


def pasts_of(shape, runs=20, touches=9, sigma=0.006):
    draw = random.Random(f"{shape.__name__}/{sigma}")
    return [
        [
            spread_of([sigma * shape(draw) for _ in range(touches)])
            for _ in range(runs)
        ]
        for _ in SITES
    ]


@pytest.mark.parametrize("touches", [3, 9])
def test_middle_of_heavy_tails_is_narrower(touches):
    """0.6 of all it is, and what may be chance is left out."""
    earlier_runs = pasts_of(student, 400, touches)
    assert 0.5 <= tails.middle_part(earlier_runs, STEP) <= 0.8
    assert tails.middle_part(pasts_of(normal, 400, touches), STEP) >= 0.95


def test_few_touches_say_nothing_of_tails():
    for earlier_runs in (
        pasts_of(student, 1, 3),
        # Nor do steps: one of ten touches that end on the next one looks far off
        pasts_of(student, 80, 9, sigma=0.3 * STEP),
        [[Spread(9e-6, 20)]] * 3,
        [[UNKNOWN]] * 3,
    ):
        assert tails.middle_part(earlier_runs, STEP) == 1.0


def test_what_may_be_chance_is_no_tail():
    """The more touches have it the less of it may be."""
    past = Spread(0.006**2, 2, 0.95 * 0.006)
    few, many = (
        tails.middle_part([[past] * count] * 3, STEP) for count in (4, 400)
    )
    assert few > many + 0.15


def test_what_no_switch_does_is_left_out():
    draw = random.Random(1)
    wild = [[draw.gauss(0.0, 1.0) ** 9 for _ in range(9)] for _ in range(60)]
    part = tails.middle_part([[spread_of(values) for values in wild]], STEP)
    assert part == pytest.approx(tails.NARROWEST**3)


def test_median_is_of_the_middle_and_an_average_of_all():
    past = [Spread(0.006**2, 8, 0.9 * 0.006)] * 20
    found = recent.current_spreads(
        dict.fromkeys(SITES, past), dict.fromkeys(SITES, past[0]), STEP
    )
    assert 0.4 <= found.middle <= 0.7
    for method, whole in (("median", 1.0), ("average", 0.0)):
        one = estimate([1.0, 1.001, 1.003], UNKNOWN, STEP, method)
        parts = [
            weighed(one, found.spreads["bed"], STEP, middle).variance
            for middle in (1.0, found.middle)
        ]
        lack = (1.0 - found.middle) * (0.006**2 - STEP**2 / 12) / 3
        assert parts[0] - parts[1] == pytest.approx(whole * lack)


def test_rounding_is_known_without_a_history():
    """It costs t nothing: three touches on one step tell as much as a hundred."""
    one = estimate([1.0] * 3, UNKNOWN, STEP, "median")
    assert one.variance == one.rounded
    alone = expanded([one] * 3, STEP)
    assert alone == pytest.approx(2.646 * STEP / 2.0, rel=0.001)


def test_touches_that_were_chosen_for_being_close_cost_a_degree():
    touches = [1.0, 1.01, 1.0, 1.003, 1.006]
    chosen = estimate(touches[2:], UNKNOWN, STEP, "median", touches).spread
    whole = spread_of(touches)
    assert chosen.dof == whole.dof - 1
    assert chosen.variance == pytest.approx(whole.variance * 4 / 3)
    assert estimate(touches, UNKNOWN, STEP, "median").spread == whole
    assert after_choice(Spread(1.0, 1)) == Spread(1.0, 1)


# Textured plates: each touch of the bed is at another point, which is ROUGHNESS (mm)
# off the mean surface; with a history, without one of the bed, and without any
ROUGHNESS = 0.015


def rough_run(draw, known, counting):
    """Error and uncertainty (mm) of a run with bed_spread, and its plan."""
    noises = {
        **dict.fromkeys(SITES, 0.003),
        "bed": math.hypot(0.003, ROUGHNESS),
    }

    def touch(site):
        return math.floor(draw.gauss(5.0, noises[site]) / STEP) * STEP

    earlier_runs = {
        site: [
            spread_of([touch(site) for _ in range(6)])
            for _ in range(10 if site in known else 0)
        ]
        for site in SITES
    }
    plan = adaptive.Plan(STEP, earlier_runs, counting, rough=("bed",))
    sampling = Sampling(5, 0.11, 3, "average", 2.0, 4.0, 6.0)
    for site in SITES:
        plan.collect(site, lambda site=site: touch(site), sampling, None, "")
    nozzle, switch, bed = (plan.estimates[site].z for site in SITES)
    return bed - switch + nozzle - 5.0, plan.uncertainty(), plan


@pytest.mark.parametrize(
    "known", [SITES, SITES[:2], ()], ids=["all", "no bed", "nothing"]
)
def test_uncertainty_covers_texture(known):
    draw, counting = random.Random(4), adaptive.choose(AUTO, 0.014)
    runs = [rough_run(draw, known, counting)[:2] for _ in range(1000)]
    inside = sum(abs(error) <= worth for error, worth in runs)
    assert 930 <= inside <= 970
    assert statistics.stdev(error for error, _ in runs) <= 0.007


@pytest.mark.parametrize("samples", [AUTO, 5])
def test_texture_that_nobody_knows_has_no_outliers(samples):
    """Points up to 50 um off, where a touch may be 14."""
    draw, counting = random.Random(4), adaptive.choose(samples, 0.014)
    for _ in range(100):
        *_, plan = rough_run(draw, SITES[:2], counting)
        touches = plan.touches["bed"]
        assert plan.estimates["bed"].spread.dof == len(touches) - 1
