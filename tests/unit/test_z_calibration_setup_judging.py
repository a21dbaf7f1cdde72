"""z_touch/z_calibration/setup_judging.py: what the set-up judges, and the sheet of paper."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch.errors import CalibrationError
from z_touch.touch import Site
from z_touch.z_calibration import setup_judging as judging


@pytest.mark.parametrize(
    ("pin", "other"),
    [
        ("^PC2", "^!PC2"),
        ("^!PC2", "^PC2"),
        ("!^ tool:PB1", "^ tool:PB1"),
        ("PC2", "!PC2"),
    ],
)
def test_other_polarity(pin, other):
    assert judging.inverted(pin) == other


@pytest.mark.parametrize(
    ("deviation", "word", "count"),
    [
        (0.0, "good", 3),
        (0.004, "good", 3),
        (0.006, "fair", 5),
        (0.02, "poor", 10),
    ],
)
def test_repeatability_and_samples(deviation, word, count):
    good, bad = [1.0, 1.0], [2.0 - deviation, 2.0 + deviation]
    found, samples = judging.repeatability([good, bad, []])
    assert found.startswith(word)
    assert samples == count
    # None of so poor ones
    enough = f"; {count} touches of each place are enough"
    assert found.endswith(enough) is (word != "poor")


@given(st.floats(-1, 1), st.floats(0.001, 1.5))
def test_paper_gives_back_the_switch_offset(contact, switch_offset):
    # The bed is switch_offset lower, the sheet is held 0.1 above it
    z = contact - switch_offset + judging.PAPER
    assert judging.from_paper(contact, z) == pytest.approx(
        switch_offset, abs=6e-4
    )
    assert not judging.is_too_high(contact, z)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (-0.01, "still too high, by 0.010 mm"),
        (0.0, "still too high, by 0.000 mm"),
        (0.0004, "still too high, by 0.000 mm"),
        (1.51, "none by more than 1.5 mm"),
    ],
)
def test_paper_where_no_switch_would_be(wrong, words):
    with pytest.raises(CalibrationError, match=words):
        judging.from_paper(0.3, 0.3 - wrong + judging.PAPER)


@pytest.mark.parametrize(
    ("wrong", "is_told"),
    [(0.001, True), (0.099, True), (0.1, False), (0.2, False), (1.5, False)],
)
def test_switch_that_hardly_moves_is_told(wrong, is_told):
    switch_offset = judging.from_paper(0.3, 0.3 - wrong + judging.PAPER)
    assert switch_offset == pytest.approx(wrong)
    text = judging.too_small(switch_offset)
    assert text.startswith(f"{wrong:.3f} mm is less than any") is is_told
    assert bool(text) is is_told


def test_lower_towards_the_sheet_in_small_steps_only():
    # The bed may lie at 0.3 or lower
    assert judging.paper_floor(0.3, 2.3, -1.0) == -1.2
    assert judging.paper_floor(0.3, 1.0, -1.0) == pytest.approx(0.4)
    assert judging.paper_floor(0.3, 0.2, -1.0) == 0.2
    assert judging.paper_floor(0.3, 0.2, -0.1) == -1.2


@pytest.mark.parametrize(
    ("pin_z", "hangs", "floor"),
    [
        (1.5, 0.0, 2.5),
        (-1.0, 0.0, 1.0),
        # A separate one
        (None, 0.0, 3.0),
        # With the length of the probe, and of its free plunger
        (1.5, 7.5, 10.0),
        (None, 7.5, 10.5),
    ],
)
def test_how_low_the_head_is_moved(pin_z, hangs, floor):
    assert judging.jog_floor(pin_z, hangs) == floor


@pytest.mark.parametrize("text", ["50, 308", "50,308,12"])
def test_place_in_the_dock(text):
    site = Site("bed", 60.0, 300.0, "The place of the bed")
    words = "The place of the bed is 12.8 mm from the dock; choose one"
    with pytest.raises(CalibrationError, match=words):
        judging.check_dock(site, text)
    judging.check_dock(site._replace(x=65.1, y=308.0), text)
    judging.check_dock(site, "")


# What is saved as samples: fifteen touches are enough, or three


@pytest.mark.parametrize(
    ("count", "given", "samples", "step", "expected"),
    [
        # As many as [probe] has, which are enough, or too few
        (3, (), None, 0.0025, "auto"),
        (15, (), None, 0.0025, "auto"),
        # Those of the section, which are enough, or too few
        (3, ("samples",), 3, 0.0025, ""),
        (15, ("samples",), 3, 0.0025, "auto"),
        # That is what it is already
        (15, ("samples",), "auto", 0.0025, ""),
        # Such steps cannot keep the target
        (3, (), None, 0.01, ""),
        (15, (), None, 0.01, "15"),
    ],
)
def test_samples_that_are_proposed(count, given, samples, step, expected):
    settings = SimpleNamespace(
        given=frozenset(given),
        target_uncertainty=0.008,
        is_auto=samples == "auto",
        on_pin=SimpleNamespace(samples=3),
        on_bed=SimpleNamespace(samples=3),
    )
    assert judging.proposed_samples(settings, step, count) == expected
