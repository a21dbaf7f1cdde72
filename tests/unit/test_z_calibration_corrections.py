"""Baby steps into switch_offset, and where printer.cfg has an option: pure."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.calibrated import (
    distances,
    exact,
    machines,
    results,
    shifts,
    travels,
)
from z_touch.core.errors import CalibrationError
from z_touch.core.saving import is_same, places
from z_touch.z_calibration.corrections import (
    Base,
    check_steps,
    corrected_switch_offset,
)
from z_touch.z_calibration.heights import offset

BASE = Base(0.16, 0.44)


@given(st.floats(-1, 1), st.floats(0.3, 2), st.floats(-0.25, 0.25))
def test_next_calibration_gives_the_offset_of_the_baby_steps(
    z_offset, switch_offset, change
):
    base = Base(z_offset, switch_offset)
    new, _ = check_steps(base, z_offset + change, True)
    # offset = something measured - switch_offset
    measured = z_offset + switch_offset
    assert measured - new == pytest.approx(z_offset + change)


def test_answer_has_old_change_and_new():
    new, text = check_steps(BASE, 0.18, False)
    assert new == pytest.approx(0.42)
    assert text == (
        "switch_offset=0.440 - (G-code offset=0.180 - 0.160 of CALIBRATE_Z)"
        " --> new switch_offset=0.420"
    )


@pytest.mark.parametrize(
    ("z_offset", "force", "words"),
    [
        (0.61, True, "new switch_offset=-0.010, which cannot be negative"),
        (0.61, False, "cannot be negative"),
        (-0.35, False, "a change of more than 0.5 mm"),
        (0.0, False, "the G-code offset is 0"),
    ],
)
def test_what_cannot_be_is_refused(z_offset, force, words):
    with pytest.raises(CalibrationError, match=words):
        check_steps(BASE, z_offset, force)


@pytest.mark.parametrize("z_offset", [-0.35, 0.0])
def test_force_helps_against_what_is_only_unlikely(z_offset):
    assert check_steps(BASE, z_offset, True)[0] > 0.0


@pytest.mark.parametrize("z_offset", [-0.33, 0.59])
def test_half_a_millimetre_is_allowed(z_offset):
    assert check_steps(BASE, z_offset, False)[0] >= 0.0


MAIN = """
[stepper_z]
switch_offset: 7
[include tools/*.cfg]
[include missing.cfg]
[z_calibration]  # mine
#switch_offset: 0.1
  switch_offset: 0.2
Switch_Offset = 0.3
[probe]
switch_offset: 8
#*# <-- SAVE_CONFIG -->
#*# [z_calibration]
#*# switch_offset = 0.4
"""


def test_places_of_an_option(tmp_path):
    (tmp_path / "tools").mkdir()
    path = tmp_path / "printer.cfg"
    path.write_text(MAIN)
    for name in "ba":
        text = f"[include ../printer.cfg]\n[z_calibration]\nspeed: {name}"
        (tmp_path / "tools" / f"{name}.cfg").write_text(text)
    (tmp_path / "tools" / "c.cfg").write_text(
        "[z_calibration]\n\nswitch_offset:\n [probe]\n"
    )

    def found(option):
        return [
            (p.path[len(str(tmp_path)) + 1 :], p.line)
            for p in places(str(path), "z_calibration", option)
        ]

    # As klippy reads them, each file once
    assert found("speed") == [("tools/a.cfg", 3), ("tools/b.cfg", 3)]
    assert found("switch_offset") == [("tools/c.cfg", 3), ("printer.cfg", 9)]
    assert found("samples") == []
    assert places("/nowhere/printer.cfg", "z_calibration", "speed") == []


class TestCorrectedSwitchOffset:
    @pytest.mark.parametrize(
        ("switch_offset", "z", "z_offset", "expected"),
        [
            (0.5, 0.25, 0.25, 0.5),  # it was right
            (0.5, -0.25, 0.0, 0.75),  # the nozzle had to go lower
            (0.5, 0.25, 0.0, 0.25),
            (0.5, -1.25, -1.0, 0.75),
            (0.0, 0.5, 0.0, -0.5),  # refused later on
        ],
    )
    def test_table(self, switch_offset, z, z_offset, expected):
        new = corrected_switch_offset(switch_offset, z, z_offset)
        assert new == expected

    @given(results, shifts)
    def test_gives_the_offset_that_was_moved_to(self, result, z):
        p, s, n, so = result[:4]
        new = corrected_switch_offset(so, z, offset(p, s, n, so))
        assert offset(p, s, n, new) == z

    @given(machines, exact(0, 3))
    def test_finds_the_travel_of_a_modelled_machine(self, machine, wrong):
        p, s, n = machine.result()[:3]
        found = offset(p, s, n, wrong)
        new = corrected_switch_offset(wrong, machine.bed, found)
        assert new == machine.travel

    @given(travels, shifts, shifts, distances)
    def test_signs(self, so, z, z_offset, more):
        plain = corrected_switch_offset(so, z, z_offset)
        assert corrected_switch_offset(so, z - more, z_offset) > plain
        assert corrected_switch_offset(so, z, z_offset - more) < plain
        assert corrected_switch_offset(so + more, z, z_offset) > plain


def test_places_below_a_pattern_of_any_depth(tmp_path):
    folder = tmp_path / "tools" / "one" / "two"
    folder.mkdir(parents=True)
    path = tmp_path / "printer.cfg"
    path.write_text("[include tools/**/own.cfg]\n")
    (folder / "own.cfg").write_text("[z_calibration]\nspeed: 3 # fast\n")
    assert places(str(path), "z_calibration", "speed") == []
    (found,) = places(str(path), "z_calibration", "speed", deep=True)
    assert (found.line, found.text) == (2, "3")


def test_what_was_saved_counts_most(tmp_path):
    path = tmp_path / "printer.cfg"
    text = "[z_calibration]\nspeed: 3\n#*# [z_calibration]\n#*# speed = 4\n"
    path.write_text(text)
    found = places(str(path), "z_calibration", "speed", saved=True)
    assert [place.text for place in found] == ["3", "4"]


@pytest.mark.parametrize(
    ("text", "other", "same"),
    [
        ("206, 306", "206.000, 306.000", True),
        ("0.2", "0.200", True),
        ("0.2", "0.201", False),
        ("0.2, 1", "0.2", False),
        ("a: b", "a: b ", True),
        ("0.2", "none", False),
    ],
)
def test_texts_that_mean_the_same(text, other, same):
    assert is_same(text, other) is same
