"""z_touch/z_calibration/heights.py: the formula, what is expected, floors, travel heights.

Heights are toolhead Z (mm), drawn in multiples of 1/64: their sums are exact, and
equality really is equality. A drawn Machine knows where everything is; what heights.py
says of it has to fit.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from z_touch.errors import TouchedWrong
from z_touch.host.toolhead import ZZero
from z_touch.z_calibration import heights as zc

STEP = 1 / 64


def exact(low, high):
    """Multiples of 1/64 from low to high."""
    return st.integers(int(low / STEP), int(high / STEP)).map(
        lambda steps: steps * STEP
    )


heights = exact(-50, 400)
shifts = exact(-10, 10)
travels = exact(0, 3)
margin_pairs = st.tuples(exact(-3, 3), exact(-3, 3)).filter(
    lambda pair: pair[0] < pair[1]
)


class Machine(NamedTuple):
    """What only the test knows."""

    pin: float  # where the nozzle presses the pin
    body: float  # how far the switch body hangs below the nozzle
    travel: float  # from the body down to the plunger when it triggers
    bed: float  # where the nozzle would meet the bed

    @property
    def switch_trigger(self):
        return self.pin + self.body

    @property
    def bed_trigger(self):
        return self.bed + self.body + self.travel

    def result(self):
        """What a run finds."""
        return zc.result_of(
            self.bed_trigger, self.switch_trigger, self.pin, self.travel
        )


# Bodies that the module admits, beds inside the default margins
machines = st.builds(
    Machine,
    pin=exact(-2, 5),
    body=exact(1 + STEP, 12),
    travel=travels,
    bed=exact(-1 + STEP, 1 - STEP),
)


def settings(**changes):
    """Those of z_touch/z_calibration/settings.py that heights depend on."""
    values = {
        "switch_offset": 0.5,
        "offset_margins": (-1.0, 1.0),
        "travel_margin": 1.0,
        "safe_z_height": 13.0,
        "clearance": 0.0,
        "position_endstop": 0.0,
        "position_min": -100.0,
        "position_max": 500.0,
        "z_offset": 6.5,
        "unmeasured_pin": 0.0,
        "mesh_area": None,
    }
    return SimpleNamespace(**{**values, **changes})


def settings_of(machine, **changes):
    """Those of an owner who has measured the machine."""
    own = {"position_endstop": machine.pin, "switch_offset": machine.travel}
    return settings(**{**own, **changes})


# The offset


def test_example_of_the_specification():
    """Of README of release 0.8.1."""
    found = zc.offset(
        probe=5.602, switch=7.366, nozzle=2.202, switch_offset=0.44
    )
    assert found == pytest.approx(-0.002, abs=1e-9)


@given(machines)
def test_offset_is_where_the_bed_is(machine):
    assert machine.result().offset == machine.bed


@pytest.mark.parametrize("value", [-1.0000001, 1.0000001, math.nan])
def test_offset_outside_its_margins_is_refused_with_its_heights(value):
    result = zc.Result(5.6, 7.3, 2.2, 0.4, value)
    zero = ZZero("stepper_z", "position_endstop", 3.0)
    # None that brings the nozzle closer to the bed
    try_it = f" (3.000 - {value:.3f}: try {3.0 - value:.3f})"
    for place, end in (
        (None, "and position_endstop"),
        (zero, f"of section 'stepper_z'{'' if value < 0.0 else try_it}"),
    ):
        with pytest.raises(TouchedWrong) as caught:
            zc.check_offset(result, (-1.0, 1.0), place)
        assert str(caught.value).endswith(end)
        assert "(probe=5.600 switch=7.300 nozzle=2.200)" in str(caught.value)


@given(exact(-4, 4), margin_pairs)
def test_just_what_is_outside_is_refused(offset, margins):
    result, (low, high) = zc.Result(0, 0, 0, 0, offset), margins
    if low <= offset <= high:
        zc.check_offset(result, margins, None)
    else:
        with pytest.raises(TouchedWrong):
            zc.check_offset(result, margins, None)


# Expected heights

LAST = zc.Result(
    probe=8.75, switch=10.0, nozzle=2.0, switch_offset=0.5, offset=0.25
)


@pytest.mark.parametrize(
    ("endstop", "last", "holds", "expected"),
    [
        (1.5, None, False, 1.5),
        # Homed there since
        (1.5, LAST, False, 1.5),
        (1.5, LAST, True, 2.0),
        # A pin of its own
        (None, None, False, None),
        (None, LAST, False, 2.0),
    ],
)
def test_expected_nozzle(endstop, last, holds, expected):
    found = zc.expect_nozzle(settings(position_endstop=endstop), last, holds)
    assert found == expected


@pytest.mark.parametrize(
    ("z_offset", "last", "expected"),
    [
        (2.0, None, 2.5),
        # No smaller one was measured
        (1.9999, None, None),
        (-6.5, None, None),
        (0.0, LAST, 9.0),
    ],
)
def test_expected_switch(z_offset, last, expected):
    found = zc.expect_switch(settings(z_offset=z_offset), 1.0, last)
    assert found == expected


@given(machines, shifts)
def test_a_machine_that_was_homed_elsewhere_triggers_just_there(machine, shift):
    last = machine.result()
    now = machine._replace(pin=machine.pin + shift, bed=machine.bed + shift)
    own, pin, switch = settings_of(now), now.pin, now.switch_trigger
    assert zc.expect_nozzle(own, last, False) == pin
    assert zc.expect_switch(own, pin, last) == switch
    # As far from Z=0 as before, which the shift has changed
    assert zc.expect_bed(own, pin, switch, last) == machine.bed_trigger
    assert (
        zc.expect_bed(own, pin, switch, None) == machine.body + machine.travel
    )


# Floors


@given(machines, st.booleans(), exact(-1 + STEP, 1 - STEP))
def test_a_healthy_machine_triggers_above_every_floor(machine, is_known, error):
    """Also with a z_offset that is 1 mm wrong, and once a run was good."""
    own = settings_of(machine, z_offset=machine.body + machine.travel + error)
    last = machine.result() if is_known else None
    pin, switch = machine.pin, machine.switch_trigger
    nozzle = zc.expect_nozzle(own, last, is_known)
    assert zc.nozzle_floor(own, nozzle) < pin
    body = zc.expect_switch(own, pin, last)
    assert zc.switch_floor(own, pin, body) < switch
    assert zc.bed_floor(own, pin, switch) < machine.bed_trigger


@given(machines, exact(STEP, 2))
def test_what_is_dead_is_pressed_no_more_than_the_margin(machine, margin):
    own, last = settings_of(machine, travel_margin=margin), machine.result()
    pin, switch = machine.pin, machine.switch_trigger
    # Homed there; or on a pin of its own, known from the last run
    for endstop in (pin, None):
        own.position_endstop = endstop
        expected = zc.expect_nozzle(own, last, True)
        assert zc.nozzle_floor(own, expected) == pin - margin
    expected = zc.expect_switch(own, pin, last)
    floor = zc.switch_floor(own, pin, expected)
    assert floor == max(switch - margin, pin + 1.0)


@given(heights, st.none() | heights)
def test_a_dead_switch_stops_with_the_nozzle_above_the_pin(nozzle, expected):
    assert zc.switch_floor(settings(), nozzle, expected) >= nozzle + 1.0


@given(machines, margin_pairs)
def test_a_dead_probe_stops_where_the_offset_is_at_its_low_margin(
    machine, margins
):
    own = settings_of(machine, offset_margins=margins)
    pin, switch = machine.pin, machine.switch_trigger
    floor = zc.bed_floor(own, pin, switch)
    assert zc.offset(floor, switch, pin, machine.travel) == margins[0]


@given(margin_pairs, heights, st.none() | heights)
def test_a_probe_of_unknown_length_stops_above_the_highest_bed(
    margins, nozzle, endstop
):
    """Where levelling has lifted the pin of the Z endstop, the bed, too."""
    own = settings(offset_margins=margins, position_endstop=endstop)
    risen = 0.0 if endstop is None else max(0.0, nozzle - endstop)
    floor = zc.unmeasured_bed_floor(own, nozzle)
    assert floor == max(own.position_min, margins[1] + 1.0 + risen)


@given(machines, shifts)
def test_after_a_good_run_all_is_looked_for_within_2_mm(machine, shift):
    """So much plates differ in thickness; Z may have been homed elsewhere since."""
    pin, switch, bed = (
        machine.pin,
        machine.switch_trigger,
        machine.bed_trigger,
    )
    kept = zc.kept_of(pin, switch, bed, machine.travel)
    own, now = settings(offset_margins=(-20.0, 20.0)), pin + shift
    at = machine.bed + shift
    assert zc.possible_offsets(own, now, kept) == (at - 2.0, at + 2.0)
    body = zc.switch_floor(own, now, None, kept)
    assert body == now + max(1.0, machine.body - 2.0)
    # The margins stay the last word
    own = settings(offset_margins=(-1.0, 1.0))
    low, high = zc.possible_offsets(own, pin, kept)
    assert -1.0 <= low <= high <= 1.0


@given(heights, heights, heights, st.none() | heights, st.none() | heights)
def test_no_floor_is_below_position_min(
    position_min, nozzle, switch, expected, endstop
):
    own = settings(position_min=position_min, position_endstop=endstop)
    for floor in (
        zc.nozzle_floor(own, expected),
        zc.switch_floor(own, nozzle, expected),
        zc.bed_floor(own, nozzle, switch),
        zc.unmeasured_bed_floor(own, nozzle),
    ):
        assert floor >= position_min


def test_a_pin_that_nobody_knows_is_looked_for_down_to_position_min():
    own = settings(position_endstop=None, position_min=-5.0)
    assert zc.nozzle_floor(own, None) == -5.0


@pytest.mark.parametrize(
    ("area", "is_over"),
    [
        (None, False),
        (((10.0, 10.0), (50.0, 50.0)), True),
        (((10.0, 31.0), (50.0, 50.0)), False),
        (((10.0, 10.0), (19.0, 50.0)), False),
    ],
)
def test_over_the_mesh_no_pin_is_lower_than_the_bed(area, is_over):
    own, point = settings(mesh_area=area), (20.0, 30.0)
    assert zc.floor_over(own, -5.0, point) == (-1.0 if is_over else -5.0)
    assert zc.floor_over(own, 0.6, point) == 0.6
    body = zc.floor_over(own, -5.0, point, below=6.0)
    assert body == (5.0 if is_over else -5.0)
    assert zc.floor_over(own, -5.0, None) == -5.0


@given(heights, heights, travels, margin_pairs)
def test_lowest_switch_gives_the_upper_margin(
    nozzle, bed_z, switch_offset, margins
):
    own = settings(switch_offset=switch_offset, offset_margins=margins)
    lowest = zc.lowest_switch(own, nozzle, bed_z)
    assert zc.offset(bed_z, lowest, nozzle, switch_offset) == margins[1]


# Travel heights


@pytest.mark.parametrize(
    ("z_offset", "safe_z"),
    [(6.5, 13.0), (1.5, 3.0), (1.49, 20.0), (-20.0, 20.0)],
)
def test_safe_z_height_where_it_is_left_out(z_offset, safe_z):
    assert zc.default_safe_z(z_offset) == safe_z


@pytest.mark.parametrize(
    ("pin", "body", "z_offset", "height"),
    [
        # safe_z_height is enough
        (0.0, 2.0, 6.5, 8.0),
        # 0.5 mm switch_offset, 1 mm free plunger, 0.5 mm travel_margin
        (0.0, 8.0, 6.5, 10.0),
        (1.0, 8.0, 6.5, 11.0),
        # The bed is at 0 nevertheless
        (-1.0, 8.0, 6.5, 10.0),
        # Of a body that nobody has measured 10 mm, or what the probe says
        (2.0, None, -6.5, 12.5),
        (0.0, None, 10.25, 10.75),
        # A pin that nobody has measured
        (None, 8.0, 6.5, 13.0),
        # 0 is a length, too
        (0.0, 0.0, 6.5, 8.0),
        # No further than the axis goes
        (25.0, None, 6.5, 30.0),
    ],
)
def test_travel_height(pin, body, z_offset, height):
    own = settings(
        safe_z_height=8.0,
        travel_margin=0.5,
        z_offset=z_offset,
        position_max=30.0,
        unmeasured_pin=3.0,
    )
    assert zc.travel_height(own, pin, body) == height


def test_after_a_touch_the_toolhead_rises_by_the_clearance_at_least():
    own = settings(safe_z_height=8.0, clearance=4.0)
    assert zc.travel_height(own, 30.0, 0.0) == 34.0
    assert zc.travel_height_to_bed(own, 0.0, 30.0) == 34.0


@given(machines, margin_pairs, exact(STEP, 3), exact(3, 20))
def test_the_probe_clears_pin_and_bed_and_goes_no_higher(
    machine, margins, margin, safe_z
):
    """With the free plunger, 1 mm below where it triggers."""
    own = settings_of(
        machine,
        offset_margins=margins,
        travel_margin=margin,
        safe_z_height=safe_z,
    )
    height = zc.travel_height_to_bed(own, machine.pin, machine.switch_trigger)
    highest = machine._replace(bed=max(margins[1], machine.pin)).bed_trigger
    assume(highest + 1.0 + margin < own.position_max)
    assert height == max(safe_z, highest + 1.0 + margin, machine.switch_trigger)
