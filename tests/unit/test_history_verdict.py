"""z_touch/history/verdict.py: what an owner has to do, by his history."""

from __future__ import annotations

import random

import pytest

from tools.kit.runs import make_run, make_runs
from z_touch.history import trend, verdict

DIRTY = {
    "about": "switch - nozzle",
    "text": "switch - nozzle is 6.415 mm and was 6.377 mm in earlier runs",
}
MESH = {
    "about": "bed_mesh",
    "text": "bed_mesh is 0.030 mm at 150, 150, where the bed was measured",
}


def refused(count=1, reason="bed: no trigger"):
    run = make_run(random.Random(1), ok=False, offset=None, reason=reason)
    return [{**run, "sites": {}}] * count


def told(at=-1, count=30, **changes):
    """Runs of which one is another one."""
    runs = make_runs(count, seed=3)
    runs[at] = {**runs[at], **changes}
    return runs


def noisy(uncertainty):
    return told(
        uncertainty=uncertainty,
        sites=make_run(random.Random(4), worn={"bed": 0.02})["sites"],
    )


CASES = {
    "none": ([], "watch", "There are no runs yet"),
    "good": (make_runs(30), "good", "Nothing to do."),
    "few": (make_runs(2), "good", "after 3 more good ones"),
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
    "dirty": (told(warnings=[DIRTY]), "act", DIRTY["text"][1:]),
    "dirty before": (told(-2, warnings=[DIRTY]), "good", ""),
    "mesh": (told(warnings=[MESH]), "watch", MESH["text"][1:]),
    "nothing of it": (told(warnings=[], wear=3), "good", ""),
    "vague": (
        noisy(0.012),
        "watch",
        "+-0.012 mm only; most of it are the bed's touches, which vary by",
    ),
    "poor": (noisy(0.03), "act", "its switch for wear, or set samples: auto"),
    "doubted": (
        told(uncertainty=0.03, warnings=[MESH]),
        "watch",
        MESH["text"][1:],
    ),
    "worn": (
        told(-5, wear=["nozzle height"]),
        "watch",
        "Nozzle height drifts by 0.004 mm in 30 runs, told on 2023-12-10; "
        "check the switch that",
    ),
    "grown": (
        told(wear=["spread of the bed's touches"]),
        "watch",
        "Spread of the bed's touches grows from 0.00",
    ),
    "worn, but hardly known": (
        told(count=3, wear=["nozzle height"]),
        "good",
        "",
    ),
    "worn long ago": (told(5, 40, wear=["nozzle height"]), "good", ""),
    "changed": (
        told(-5, changed=[{"what": "probe - switch", "by": 0.12, "runs": 6}]),
        "watch",
        "Probe - switch changed by 0.120 mm on 2023-12-05, between two runs: ",
    ),
    "told some time after it changed": (
        told(-10, changed=[{"what": "probe - switch", "by": 0.05, "runs": 15}]),
        "watch",
        "Probe - switch changed by 0.050 mm on 2023-11-21, between two runs: ",
    ),
    "changed some time ago": (
        told(-11, changed=[{"what": "probe - switch", "by": 0.12, "runs": 6}]),
        "good",
        "",
    ),
    "back again": (
        told(changed=[{"what": "x", "by": 1, "runs": 6, "told": False}]),
        "good",
        "",
    ),
    "cleaned": (
        make_runs(20) + make_runs(3, cleaned="it had to be"),
        "watch",
        "had to be cleaned in 3 of the last 10 runs",
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
    found = verdict.judge(runs)
    assert found.level == level
    assert words in " ".join(found.texts)
    assert len(found.texts) == 1 or name in ("few", "worn, but hardly known")


def test_it_says_how_much_since_the_stretch_has_begun():
    """Not what another nozzle has changed before."""
    runs = make_runs(10) + make_runs(40, moved={"nozzle": -0.2}, homing=0.0)
    for number, run in enumerate(runs[10:]):
        run["sites"]["bed"]["z"] += 0.001 * number
        run["sites"]["bed"]["sd"] = 0.002 + 0.0001 * number
    names = ["probe - switch", "spread of the bed's touches"]
    runs[-3]["wear"] = names
    day = "in 40 runs, told on 2023-12-"
    first, second = verdict.judge(runs).texts
    assert first.startswith("Probe - switch drifts by 0.039")
    assert second.startswith(
        "Spread of the bed's touches grows from 0.0026 to 0.0053 mm"
    )
    assert day in first and day in second
    # What was told before it has changed is over
    change = {"what": "probe - switch", "by": 0.1, "runs": 1}
    runs[-1]["changed"] = [change]
    texts = verdict.judge(runs).texts
    assert [text.split(" ")[0] for text in texts] == ["Spread", "Probe"]


def test_it_says_how_much_of_the_plate_it_was_told_of():
    runs = make_runs(60, homing=0.0, noise=0.0)
    for number, run in enumerate(runs):
        run["plate"] = "ab"[number % 2]
        # The other one is higher, and stays so
        run["sites"]["bed"]["z"] += 0.2 if number % 2 else 0.001 * number
    runs[-2]["wear"] = ["probe - switch"]
    (text,) = verdict.judge(runs).texts
    assert text.startswith("Probe - switch drifts by 0.060 mm in 30 runs")
    # A step that went back is none to tell of, but a stretch has begun
    change = {"what": "probe - switch", "by": 0.1, "runs": 21, "told": False}
    runs[-1]["changed"] = [change]
    (text,) = verdict.judge(runs).texts
    assert " in 10 runs" in text


def test_the_worst_comes_first():
    runs = told(-3, wear=["switch - nozzle"])
    runs[-1]["warnings"] = [MESH, DIRTY]
    level, texts = verdict.judge(runs)
    assert level == "act"
    assert [text[:8] for text in texts] == ["Switch -", "Bed_mesh", "Switch -"]


@pytest.mark.parametrize(
    ("cause", "level"),
    [("none", "good"), ("tip", "watch"), ("", "watch"), (None, "watch")],
)
def test_an_accuracy_run_that_was_last_decides(cause, level):
    """By its cause: the words are for people."""
    text = "The words say nothing to do"
    run = {"cycles": [{}], "verdict": text, "cause": cause}
    found = verdict.judge(make_runs(3), run)
    assert found == (level, [f"Accuracy run: {text}."])


def test_an_accuracy_run_hides_nothing():
    """Dirt that is hard repeats as well as a clean nozzle."""
    run = {"cycles": [{}], "verdict": "nothing stands out", "cause": "none"}
    level, texts = verdict.judge(told(warnings=[DIRTY]), run)
    assert (level, len(texts)) == ("act", 2)
    assert DIRTY["text"][1:] in texts[0]
    assert texts[1] == "Accuracy run: nothing stands out."
    assert verdict.judge([], run).texts == texts[1:]


def test_of_a_long_stretch_it_says_how_much_of_late():
    """What has begun 100 runs ago is little in 850."""
    runs = make_runs(850, homing=0.0, noise=0.0)
    for number, run in enumerate(runs[-100:]):
        run["sites"]["bed"]["z"] += 0.0003 * number
    for run in runs[-20:]:
        run["sites"]["nozzle"]["sd"] = 0.01
    runs[-1]["wear"] = ["probe - switch", "spread of the nozzle's touches"]
    first, second = verdict.judge(runs).texts
    assert first.startswith("Probe - switch drifts by 0.030 mm in 100 runs")
    assert second.startswith("Spread of the nozzle's touches grows from 0.0000")
    assert "to 0.0100 mm in 850 runs" in second


@pytest.mark.parametrize("about", ["nozzle", "switch", "bed", "bed_tilt", ""])
def test_a_warning_counts_by_what_it_is_about(about):
    runs = told(warnings=[{"about": about, "text": "switch: it is odd"}])
    level = "act" if about in ("nozzle", "switch", "bed") else "watch"
    assert verdict.judge(runs) == (level, ["Switch: it is odd."])


def test_each_trend_has_its_remedy():
    names = {entry[0] for entry in trend.HEIGHTS + trend.SPREADS}
    assert set(verdict.REMEDIES) == names


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
    assert verdict.judge(runs).level == level


def test_other_nozzle_is_marked():
    runs = make_runs(10) + make_runs(10, moved={"nozzle": -0.2})
    marks = verdict.marks_of(refused() + runs, trend.no_pause)
    assert [(mark.number, mark.text) for mark in marks] == [
        (11, "from here on switch - nozzle is another one")
    ]
