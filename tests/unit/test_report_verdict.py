"""z_touch/report/verdict.py: what to do, by a history."""

from __future__ import annotations

import random

import pytest

from tools.kit.runs import make_run, make_runs, read
from z_touch.report import verdict

DIRTY = {
    "about": "switch - nozzle",
    "text": "switch - nozzle is 6.415 mm and was 6.377 mm in earlier runs",
}
MESH = {
    "about": "bed_mesh",
    "text": "bed_mesh is 0.030 mm at 150, 150, where the bed was measured",
}


def refused(count=1, reason="bed: no trigger"):
    run = make_run(random.Random(1), ok=False, reason=reason)
    return [{**run, "sites": {}}] * count


def told(at=-1, count=30, **changes):
    """Runs of which one is another one."""
    runs = make_runs(count, seed=3)
    runs[at] = {**runs[at], **changes}
    return runs


def drifting(count):
    """Runs without noise, whose heights all rise by 1 um a run."""
    runs = make_runs(count, noise=0.0, homing=0.0)
    for number, run in enumerate(runs):
        for site in run["sites"].values():
            site["z"] += 0.001 * number
    return runs


def exchanged(later):
    """Another plate since so many runs."""
    runs = make_runs(20 + later, noise=0.0, homing=0.0)
    for run in runs[20:]:
        run["sites"]["bed"]["z"] += 0.12
    return runs


def noisy(uncertainty):
    return told(
        uncertainty=uncertainty,
        sites=make_run(random.Random(4), worn={"bed": 0.02})["sites"],
    )


CASES = {
    "none": ([], "watch", "There are no runs yet"),
    "good": (make_runs(30), "good", "Nothing to do."),
    "few": (make_runs(2), "good", "after 3 more good ones."),
    "one too few": (make_runs(4), "good", "after 1 more good one."),
    "refused": (
        make_runs(9) + refused(),
        "act",
        "The last run was refused: bed: no trigger.",
    ),
    "refused once": (make_runs(9) + refused() + make_runs(1), "good", ""),
    "often refused": (
        make_runs(9) + refused(3) + make_runs(2),
        "watch",
        "3 of the last 10 runs were refused, the last one on 2023-11-14: bed",
    ),
    "refused long ago": (refused(5) + make_runs(10), "good", ""),
    "dirty": (
        told(warnings=[DIRTY]),
        "act",
        "The probe hangs 6.415 mm below the nozzle and hung 6.377 mm in earlier",
    ),
    "dirty before": (told(-2, warnings=[DIRTY]), "good", ""),
    "mesh": (told(warnings=[MESH]), "watch", MESH["text"][1:]),
    "vague": (
        noisy(0.012),
        "watch",
        "+-0.012 mm only, mostly as touches of the probe on the bed vary by",
    ),
    "poor": (noisy(0.03), "act", "Check how the probe is seated, then its"),
    "doubted": (
        told(uncertainty=0.03, warnings=[MESH]),
        "watch",
        MESH["text"][1:],
    ),
    "worn": (
        drifting(30),
        "watch",
        "Check the switch that the nozzle presses, and what homes Z: the nozzle"
        " meets the pin 0.030 mm higher than in November 2023.",
    ),
    "worn, but hardly known": (drifting(19), "good", ""),
    "worn, without a clock": (
        [{**run, "time": 0.0} for run in drifting(30)],
        "watch",
        "0.030 mm higher than 30 runs ago.",
    ),
    "grown": (
        make_runs(20, touches=4)
        + make_runs(20, 3, touches=4, worn={"bed": 0.009}),
        "watch",
        "Replace the probe's switch soon: its touches spread 2.8 times as far as"
        " in November 2023 (0.00",
    ),
    "changed": (
        exchanged(9),
        "watch",
        "Look for what is loose, unless you laid another plate or exchanged the"
        " probe before the run of 2023-12-05: since then the probe finds the bed"
        " 0.120 mm higher.",
    ),
    "changed some time ago": (exchanged(11), "good", ""),
    "cleaned": (
        make_runs(20) + make_runs(3, cleaned="it had to be"),
        "watch",
        "does not drip: it had to be cleaned in 3 of the last 10 runs.",
    ),
    "cleaned twice": (
        make_runs(20) + make_runs(2, cleaned="it had to be"),
        "good",
        "",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_verdict(name):
    runs, level, words = CASES[name]
    found = verdict.judge(read(runs))
    assert found.level == level
    assert words in " ".join(found.texts)
    assert len(found.texts) == 1 or "few" in name


def test_the_worst_comes_first():
    runs = drifting(30)
    runs[-1]["warnings"] = [MESH, DIRTY]
    level, texts, plots = verdict.judge(read(runs))
    assert level == "act"
    assert [text[:9] for text in texts] == [
        "The probe",
        "Bed_mesh ",
        "Check the",
    ]
    # Where each is seen; the mesh is nowhere
    assert list(plots.items()) == [
        ("switch - nozzle", "act"),
        ("nozzle height", "watch"),
    ]


def accuracy(sd=0.0, count=10):
    """A CALIBRATE_Z_ACCURACY whose bed varies by so much (mm)."""
    draw = random.Random(1)
    cycles = [
        {
            "time": 20.0 * n,
            "nozzle": [1.6] * 3,
            "switch": [8.0] * 3,
            "bed": [draw.gauss(7.0, sd) for _ in range(3)],
        }
        for n in range(count)
    ]
    (run,) = read(make_runs(1, cycles=cycles, step=0.0025))
    return run


@pytest.mark.parametrize(
    ("run", "level", "words"),
    [
        (accuracy(), "good", "nothing to do."),
        (accuracy(0.02), "watch", "exchange the probe's switch."),
        (accuracy(count=3), "watch", "3 cycles are too few"),
    ],
)
def test_an_accuracy_run_that_was_last_decides(run, level, words):
    found = verdict.judge(read(make_runs(3)), run)
    (text,) = found.texts
    assert found.level == level
    assert text.startswith("Accuracy run: ") and words in text


def test_an_accuracy_run_hides_nothing():
    """Dirt that is hard repeats as well as a clean nozzle."""
    level, texts, _ = verdict.judge(read(told(warnings=[DIRTY])), accuracy())
    assert (level, len(texts)) == ("act", 2)
    assert "the nozzle and hung 6.377 mm" in texts[0]
    assert texts[1].startswith("Accuracy run: nothing stands out")
    assert verdict.judge([], accuracy()).texts == texts[1:]


@pytest.mark.parametrize("about", ["nozzle", "switch", "bed", "bed_tilt", ""])
def test_a_warning_counts_by_what_it_is_about(about):
    runs = told(warnings=[{"about": about, "text": "switch: it is odd"}])
    level = "act" if about in ("nozzle", "switch", "bed") else "watch"
    found = verdict.judge(read(runs))
    assert found[:2] == (level, ["Switch: it is odd."])
    seen = about in ("nozzle", "switch", "bed")
    assert found.plots == ({"last run": "act"} if seen else {})


@pytest.mark.parametrize(
    ("spread", "worth", "level"),
    [
        (3.0, 0.014, verdict.GOOD),
        (0.0, 0.014, verdict.WATCH),
        (3.0, 0.016, verdict.WATCH),
        (3.0, 0.021, verdict.ACT),
    ],
)
def test_texture_is_part_of_what_an_offset_is_worth(spread, worth, level):
    """The target of such runs is 0.014 mm: keeping it is good."""
    runs = make_runs(8, uncertainty=worth, bed_spread=spread)
    assert verdict.judge(read(runs)).level == level


def test_what_happened_is_marked_where_it_was():
    runs = make_runs(10) + make_runs(10, moved={"nozzle": -0.2})
    for run in runs[15:]:
        run["switch_offset"] = 0.5
    runs[3]["warnings"] = [MESH]
    marks = verdict.marks_of(read(refused() + runs))
    assert [(mark.number, mark.text) for mark in marks] == [
        (4, MESH["text"]),
        (11, "the nozzle meets the pin 0.200 mm lower from then on"),
        (11, "the probe hangs 0.200 mm further below the nozzle from then on"),
        (16, "switch_offset was 0.440 and is 0.500"),
    ]


@pytest.mark.parametrize(
    ("worn", "words"),
    [
        (
            {"nozzle": 0.009, "switch": 0.009},
            "Replace the switch of the pin soon: touches of the nozzle and of the"
            " probe's body on it spread ",
        ),
        (
            {"nozzle": 0.009},
            "Clean the nozzle, then check the switch of the pin: touches of the"
            " nozzle spread ",
        ),
        (
            {"switch": 0.009},
            "Seat the probe firmly, then check the switch of the pin: touches of"
            " the probe's body spread ",
        ),
    ],
)
def test_what_touches_have_in_common_is_worn(worn, words):
    runs = make_runs(20, touches=4) + make_runs(20, 3, touches=4, worn=worn)
    found = verdict.judge(read(runs))
    (text,) = found.texts
    assert text.startswith(words)
    assert found.plots == {"spread": "watch"}


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (1.74, "1.7 times"),
        (1.75, "twice"),
        (2.24, "twice"),
        (2.25, "2.2 times"),
        (6.04, "6 times"),
    ],
)
def test_ratios_are_said_as_one_does(ratio, words):
    assert verdict.times(ratio) == words


@pytest.mark.parametrize(("worth", "count"), [(0.012, 1), (0.021, 2)])
def test_what_wear_explains_is_not_told_twice(worth, count):
    """But for an offset that a first layer shows."""
    worn = {"bed": 0.009}
    runs = make_runs(20, touches=4) + make_runs(20, 3, touches=4, worn=worn)
    runs[-1]["uncertainty"] = worth
    found = verdict.judge(read(runs))
    assert len(found.texts) == count
    assert "Replace the probe's switch soon: " in found.texts[-1]
