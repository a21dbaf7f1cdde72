"""z_touch/errors.py: what is known of an error, and its words."""

from __future__ import annotations

import pytest

from z_touch import errors


def test_what_is_known_is_put_into_words_once():
    error = errors.CalibrationError("no trigger")
    assert str(error) == "no trigger"
    assert error.advised("look", 1.25, "as deep as it may") is error
    error.happened_in("bed")
    assert str(error) == (
        "bed: no trigger, expected a trigger at z=1.250, the lowest point of"
        " this touch: as deep as it may; look"
    )
    assert (error.subject, error.expected_z) == ("bed", 1.25)
    assert (error.what, error.remedy) == ("no trigger", "look")


def test_a_trigger_at_zero_is_one_that_was_expected():
    error = errors.CalibrationError("no trigger").advised("look", 0.0)
    assert "expected a trigger at z=0.000; look" in str(error)


def test_the_nearest_advice_stays():
    error = errors.NoTrigger("lost").advised("look into the log")
    assert str(error.advised("check the pin", 2.0)) == "lost; look into the log"


@pytest.mark.parametrize("kind", [errors.NoTrigger, errors.SamplesDiffer])
def test_an_error_is_about_the_innermost_part_and_stays_of_its_kind(kind):
    error = kind("so it is")
    outer, inner = errors.about("cycles"), errors.about("bed sensor")
    with pytest.raises(kind) as caught, outer, inner:
        raise error
    assert caught.value is error
    assert str(error) == "bed sensor: so it is"


def test_other_kinds_are_not_about_it():
    for kind, text in (
        (errors.SamplesDiffer, "cycles: so it is"),
        (errors.NoTrigger, "so it is"),
    ):
        cycles = errors.about("cycles", only=errors.SamplesDiffer)
        with pytest.raises(kind, match=f"^{text}$"), cycles:
            raise kind("so it is")
