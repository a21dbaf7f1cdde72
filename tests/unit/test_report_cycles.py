"""z_touch/report/cycles.py: its verdict on printers at random."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from z_touch.report import cycles
from z_touch.z_calibration.runs import Cycle, offsets, uncertainty

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "accuracy.md"
STEP = 0.0025
HEIGHTS = {"nozzle": 1.6, "switch": 8.0, "bed": 7.0}
# Between two touches and before those of a site; at the end of a cycle, s
TOUCH, WAY, END = 1.7, 3.0, 4.0


class RandomPrinter:
    """One with a cause that makes its heights vary, and little else."""

    def __init__(self, draw: random.Random, cause: str) -> None:
        self.draw, self.cause, self.t = draw, cause, 0.0
        self.noise = {name: draw.uniform(0.0005, 0.004) for name in HEIGHTS}
        self.noise["switch"] = self.noise["nozzle"]
        worn = {"pin": ("nozzle", "switch"), "probe": ("bed",)}.get(cause, ())
        self.noise.update(dict.fromkeys(worn, draw.uniform(0.012, 0.02)))
        self.play = draw.uniform(0.03, 0.08) * (cause == "play")
        self.ooze = self.most = draw.uniform(0.02, 0.1) * (cause == "nozzle")
        self.kept, self.flow = draw.uniform(0.3, 0.8), draw.uniform(0.01, 0.05)
        self.heat = draw.uniform(-2e-6, 2e-6)
        if cause == "heat":
            self.heat = draw.choice((-1, 1)) * draw.uniform(0.0005, 0.002)
        self.warm = draw.choice((("nozzle",), ("bed",), ("nozzle", "switch")))

    def cycle(self, touches: int = 3) -> Cycle:
        draw = self.draw
        seat = draw.gauss(0.0, 0.04) * (self.cause == "seat")
        home = draw.gauss(0.0, 0.03) * (self.cause == "homing")
        shift, found = {}, {}
        if self.cause.startswith("hidden"):
            home, by = draw.gauss(0.0, 0.03), draw.gauss(0.0, 0.02)
            seat = by * (self.cause == "hidden seat")
            shift["bed"] = by * (self.cause == "hidden bed")
        for site, height in HEIGHTS.items():
            z = height + home + (seat if site != "nozzle" else 0.0)
            z += shift.get(site, 0.0)
            self.pass_by(WAY)
            found[site] = [self.touch(site, z) for _ in range(touches)]
        self.pass_by(END)
        return Cycle(self.t, *map(tuple, found.values()))

    def pass_by(self, seconds: float) -> None:
        self.t += seconds
        grown = self.ooze + self.most * self.flow * seconds
        self.ooze = min(self.most, grown)

    def touch(self, site: str, z: float) -> float:
        self.pass_by(TOUCH)
        z += self.draw.gauss(0.0, self.noise[site])
        z += self.draw.uniform(0.0, self.play)
        if site in self.warm:
            z += self.heat * self.t
        if site == "nozzle":
            z += self.ooze
            self.ooze *= self.kept
        return z // STEP * STEP


def verdicts(cause: str, count: int, printers: int = 200) -> Counter:
    draw = random.Random(cause)
    return Counter(
        cycles.judge([p.cycle() for _ in range(count)], STEP).cause
        for p in (RandomPrinter(draw, cause) for _ in range(printers))
    )


# Of 200 printers each so many causes are told, those without one for their noise
FOUND = {
    "none": 194,
    "nozzle": 195,
    "heat": 200,
    "seat": 200,
    "pin": 198,
    "probe": 198,
    "play": 199,
    "homing": 200,
}


@pytest.mark.parametrize("cause", FOUND)
def test_cause_is_found_and_none_other_is_told(cause):
    told = verdicts(cause, 10)
    assert told[cause] == FOUND[cause]
    assert set(told) <= {cause, "none", "noise"}


def test_document_says_how_many_are_found():
    text = " ".join(DOCUMENT.read_text(encoding="utf-8").split())
    missed = sum(200 - FOUND[cause] for cause in FOUND if cause != "none")
    assert f"On {200 * len(FOUND)} simulated printers" in text
    assert f"On {200 - FOUND['none']} of those without a cause" in text
    assert f"; {missed} times the true one was too small" in text


def test_few_cycles_tell_no_cause():
    assert set(verdicts("heat", 5, 20)) == {"few"}
    assert verdicts("heat", 6, 20) == {"heat": 20}


def test_drift_is_told_by_the_minute():
    """Of 0.02 mm in two minutes, by which bed and offset drift alike."""
    found = [
        Cycle(12.0 * i, (1.6,), (8.0,), (7.0 - 0.002 * i,)) for i in range(11)
    ]
    verdict = cycles.judge(found, STEP)
    assert verdict.text.startswith("the offset drifts by -0.0100 mm per minute")


@pytest.mark.parametrize("touches", [2, 5])
@pytest.mark.parametrize("cause", ["none", "seat", "heat", "probe"])
def test_other_numbers_of_touches(cause, touches):
    draw = random.Random(5)
    for _ in range(20):
        printer = RandomPrinter(draw, cause)
        found = [printer.cycle(touches) for _ in range(10)]
        verdict = cycles.judge(found, STEP)
        whole = uncertainty(offsets(found), STEP)
        assert verdict.cause in (cause, "none", "noise")
        assert verdict.cause == cause or whole <= 0.01 or "none" not in verdict


@pytest.mark.parametrize(
    ("cause", "named", "count"),
    [
        # Some are too small by chance.  Which of two hangs elsewhere homing may
        # hide, but it is never the other one that is told
        ("hidden bed", {"alone"}, 190),
        ("hidden seat", {"seat", "either"}, 190),
    ],
)
def test_homing_hides_no_shift(cause, named, count):
    told = verdicts(cause, 10)
    assert sum(told[name] for name in named) >= count
    assert set(told) <= named | {"several", "most", "homing"}


@pytest.mark.parametrize("noise", [0.002, 0.004, 0.006])
@pytest.mark.parametrize("shift", [0.0, 0.004, 0.008])
def test_nothing_to_do_is_said_up_to_ten_um_only(noise, shift):
    draw, told = random.Random(f"{noise}/{shift}"), Counter()
    for _ in range(60):
        found = []
        for i in range(10):
            by = {s: draw.gauss(0.0, shift) for s in HEIGHTS}
            samples = [
                [z + by[s] + draw.gauss(0.0, noise) for _ in range(3)]
                for s, z in HEIGHTS.items()
            ]
            found.append(Cycle(20.0 * i, *map(tuple, samples)))
        verdict = cycles.judge(found, STEP)
        is_good = uncertainty(offsets(found), STEP) <= 0.01
        assert ("nothing to do" in verdict.text) == (verdict.cause == "none")
        assert is_good or verdict.cause != "none"
        told[verdict.cause] += 1
    assert not (shift == 0.008 and told["none"])


def shifted(**by: float) -> list[Cycle]:
    """Cycles with 2 um of noise, whose sites shift by so much (mm)."""
    draw, found = random.Random(4), []
    for cycle in only(**dict.fromkeys(HEIGHTS, 0.002)):
        shift = {site: draw.gauss(0.0, mm) for site, mm in by.items()}
        moved = {s: [z + shift[s] for z in cycle.touches(s)] for s in shift}
        found.append(replace(cycle, **moved))
    return found


def test_largest_cause_is_told_where_none_dominates():
    verdict = cycles.judge(shifted(bed=0.012, switch=0.005), STEP)
    assert verdict.cause in ("most", "several")
    assert "the bed" in verdict.text and "nozzle" not in verdict.text
    size = float(verdict.text.split("by ")[1].split()[0])
    assert size == pytest.approx(0.012, rel=0.5)
    verdict = cycles.judge(shifted(bed=0.02, switch=0.02), STEP)
    assert verdict.cause == "several"
    assert "the bed by 0.0" in verdict.text
    assert "the switch by 0.0" in verdict.text


def only(**worn: float) -> list[Cycle]:
    """Cycles whose sites vary by so much (mm), touch by touch."""
    draw = random.Random(1)
    return [
        Cycle(
            20.0 * i,
            *[
                [z + draw.gauss(0.0, worn.get(site, 0.001)) for _ in range(3)]
                for site, z in HEIGHTS.items()
            ],
        )
        for i in range(10)
    ]


@pytest.mark.parametrize(
    ("worn", "cause", "words"),
    [
        ({}, "none", "nothing stands out"),
        ({"nozzle": 0.02}, "tip", "clean the nozzle"),
        ({"switch": 0.02}, "body", "seat the probe"),
        ({"nozzle": 0.02, "switch": 0.02}, "pin", "switch of the pin"),
        ({"bed": 0.02}, "probe", "the probe's switch"),
        (dict.fromkeys(HEIGHTS, 0.02), "play", "the Z axis for play"),
        (dict.fromkeys(HEIGHTS, 0.003), "none", "nothing to do"),
    ],
)
def test_sites_that_vary(worn, cause, words):
    verdict = cycles.judge(only(**worn))
    assert (verdict.cause, words in verdict.text) == (cause, True)


@pytest.mark.parametrize(
    ("sites", "cause"),
    [
        (("nozzle",), "alone"),
        (("switch",), "alone"),
        (("bed",), "alone"),
        (("switch", "bed"), "seat"),
        (("nozzle", "switch", "bed"), "homing"),
    ],
)
def test_sites_that_shift_from_cycle_to_cycle(sites, cause):
    draw = random.Random(2)
    found = []
    for cycle in only():
        shift = draw.gauss(0.0, 0.03)
        moved = {s: [z + shift for z in cycle.touches(s)] for s in sites}
        found.append(replace(cycle, **moved))
    verdict = cycles.judge(found)
    assert verdict.cause == cause
    assert cause != "alone" or f"only the {sites[0]} shifts" in verdict.text


def test_first_touches_that_are_all_higher_are_no_dirt():
    found = [
        replace(c, **{s: [z + 0.01, z, z] for s, z in HEIGHTS.items()})
        for c in only() * 6
    ]
    assert cycles.judge(found).cause == "none"
    found = [replace(c, nozzle=[1.61, 1.6, 1.6]) for c in only()]
    assert cycles.judge(found).cause == "nozzle"
