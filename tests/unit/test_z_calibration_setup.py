"""The steps of Z_CALIBRATION_SETUP, and what is judged in them: pure."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.calibrated import make_settings
from z_touch import wizard
from z_touch.errors import CalibrationError
from z_touch.touch import Site
from z_touch.wizard import jogged
from z_touch.z_calibration import setup_judging as judging
from z_touch.z_calibration.settings import OPTIONS
from z_touch.z_calibration.setup import LEADS_TO, SITES, Setup
from z_touch.z_calibration.setup_steps import BY_GCODE, BY_HAND, STEPS

BY_NAME = {step.name: step for step in STEPS}
every_step = pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)


@every_step
def test_buttons_of_a_step(step):
    answers = step.answers()
    # All that KlipperScreen shows; the last step fills it in
    assert step.text[-1].startswith(f"'{step.go_on}'") or step.name == "save"
    # One is known by what it sends
    assert len({answer.word for answer in answers}) == len(answers)
    # On the dark page that one cannot be told from a button out of use
    assert "secondary" not in {answer.colour for answer in answers}
    assert (answers[-1].word == "BACK") == (step.name != "pin")
    assert hasattr(Setup, f"do_{step.name}")


@every_step
def test_move_that_follows_is_announced(step):
    """By the sentence that all interfaces show."""
    if step.name in LEADS_TO and step.name != "look":
        assert "{goal}" in step.text[-1]
    if step.name in SITES:
        assert step.axes


def test_twelve_steps_are_asked():
    assert [step.number for step in STEPS] == sorted(s.number for s in STEPS)
    assert {step.number for step in STEPS} == set(range(1, 13))


@every_step
def test_steps_lead_back_to_earlier_ones(step):
    if step.back:
        assert STEPS.index(BY_NAME[step.back]) < STEPS.index(step)


@every_step
def test_sentences_name_no_options(step):
    texts = [*step.text, *BY_GCODE.values(), *BY_HAND.values()]
    for row in OPTIONS:
        assert "_" not in row.name or not any(row.name in t for t in texts)


@every_step
def test_a_sentence_a_line(step):
    for text in step.text:
        assert ". " not in text.rstrip("."), text


def test_own_gcode_is_spoken_of_where_there_is_some():
    assert not any("own G-code" in text for text in BY_HAND.values())
    assert any("own G-code" in text for text in BY_GCODE.values())


NO, YES = False, True


@pytest.mark.parametrize(
    ("readings", "verdict"),
    [
        ([(NO, YES)], "nothing"),
        ([(NO, YES), (NO, YES)], "nothing"),
        ([(NO, YES), (YES, YES)], "held"),
        ([(NO, YES), (YES, YES), (NO, YES)], "good"),
        ([(YES, NO), (NO, NO)], "early"),
        ([(NO, NO), (NO, YES), (NO, NO)], "other"),
        ([(NO, NO), (YES, YES), (NO, NO)], "both"),
        # Not at the same moment
        ([(NO, NO), (YES, NO), (NO, YES)], "both"),
    ],
)
def test_what_a_hand_has_done(readings, verdict):
    assert wizard.judge(readings) == verdict


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
    ("start", "distance", "end"),
    [(5.0, 5.0, 10.0), (5.0, -5.0, 0.0), (-1.0, 1.0, 0.0), (12.0, -1.0, 11.0)],
)
def test_jog_within_the_limits_or_towards_them(start, distance, end):
    assert jogged("X", start, distance, (0.0, 10.0)) == end


@pytest.mark.parametrize(
    ("start", "distance", "end"),
    [(5.0, -10.0, 2.0), (5.0, -3.0, 2.0), (5.0, -1.0, 4.0), (2.0, 1.0, 3.0)],
)
def test_jog_that_stops_by_itself(start, distance, end):
    assert jogged("Z", start, distance, (2.0, 9.0), stops=True) == end


@pytest.mark.parametrize(
    ("start", "distance", "words"),
    [
        # Nowhere to go
        (2.0, -0.1, "would lead to 1.900, outside 2.000"),
        (1.0, -0.1, "would lead to 0.900, outside 1.000"),
        (9.0, -10.1, "by 10 mm at most"),
        (8.5, 1.0, "outside 2.000 to 9.000"),
    ],
)
def test_jog_that_does_not_even_stop(start, distance, words):
    with pytest.raises(CalibrationError, match=words):
        jogged("Z", start, distance, (2.0, 9.0), stops=True)


@pytest.mark.parametrize(
    ("start", "distance", "words"),
    [
        (5.0, 5.1, "X=5.1 would lead to 10.100, outside 0.000 to 10.000"),
        (5.0, -5.1, "outside"),
        (-1.0, -0.1, "would lead to -1.100"),
        (5.0, 10.1, "by 10 mm at most"),
        (5.0, -10.1, "by 10 mm at most"),
    ],
)
def test_jog_too_far(start, distance, words):
    with pytest.raises(CalibrationError, match=words):
        jogged("X", start, distance, (0.0, 10.0))


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
    settings = make_settings(
        given=frozenset(given), target_uncertainty=0.008, samples=samples
    )
    assert judging.proposed_samples(settings, step, count) == expected
