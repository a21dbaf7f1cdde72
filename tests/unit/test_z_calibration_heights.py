"""The formula, expected heights, floors and travel heights: pure."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.unit.calibrated import (
    STEP,
    complaint,
    distances,
    exact,
    expected_heights,
    heights,
    machines,
    make_settings,
    margin_pairs,
    offsets_within_margins,
    results,
    settings_of,
    shifts,
    travels,
)
from z_touch.host.toolhead import ZZero
from z_touch.z_calibration import heights as zc


class TestOffset:
    def test_example_of_the_specification(self):
        result = zc.offset(
            probe=5.602, switch=7.366, nozzle=2.202, switch_offset=0.44
        )
        assert result == pytest.approx(-0.002, abs=1e-9)

    @given(heights, heights, heights, travels, shifts)
    def test_shift_of_the_frame_shifts_the_offset(self, p, s, n, so, shift):
        # switch - nozzle is a difference, only the bed's height remains
        moved = zc.offset(p + shift, s + shift, n + shift, so)
        assert moved == zc.offset(p, s, n, so) + shift

    @given(heights, heights, heights, travels, distances)
    def test_signs(self, p, s, n, so, more):
        plain = zc.offset(p, s, n, so)
        assert zc.offset(p, s, n, so + more) < plain  # nozzle closer to the bed
        assert zc.offset(p + more, s, n, so) > plain  # bed higher
        assert zc.offset(p, s + more, n, so) < plain  # probe hangs less low
        assert zc.offset(p, s, n + more, so) > plain

    @given(machines)
    def test_finds_the_bed_of_a_modelled_machine(self, machine):
        assert machine.result().offset == machine.bed


class TestCheckOffset:
    @pytest.mark.parametrize(
        ("value", "margins"),
        [
            (-1.0, (-1.0, 1.0)),
            (-0.5, (-1.0, 1.0)),
            (0.0, (-1.0, 1.0)),
            (1.0, (-1.0, 1.0)),
            (0.0, (0.0, 1.0)),
            (0.0, (-1.0, 0.0)),
        ],
    )
    def test_accepts_the_margins_themselves(self, value, margins):
        zc.check_offset(zc.Result(0, 0, 0, 0, value), margins, None)

    @pytest.mark.parametrize("value", [-1.0000001, 1.0000001, 40.0, math.nan])
    def test_refuses_anything_outside_and_names_the_values(self, value):
        result = zc.Result(5.6, 7.3, 2.2, 0.4, value)
        text = (
            f"offset {value:.3f} is outside offset_margins -1.000 to 1.000"
            " (probe=5.600 switch=7.300 nozzle=2.200); home Z again (G28 Z)"
            " after any levelling, then check the three positions and"
            " position_endstop"
        )
        check, margins = zc.check_offset, (-1.0, 1.0)
        assert complaint(check, result, margins, None) == text
        zero = ZZero("stepper_z", "position_endstop", 3.0)
        right = f" (3.000 - {value:.3f}: try {3.0 - value:.3f})"
        # None that brings the nozzle closer to the bed
        right = "" if value < 0.0 else right
        text += f" of section 'stepper_z'{right}"
        assert complaint(check, result, margins, zero) == text

    @given(results, margin_pairs)
    def test_refuses_just_what_is_outside(self, result, margins):
        low, high = margins
        if result.offset < low or result.offset > high:
            complaint(zc.check_offset, result, margins, None)
        else:
            zc.check_offset(result, margins, None)


LAST = zc.Result(
    probe=8.75, switch=10.0, nozzle=2.0, switch_offset=0.5, offset=0.25
)


class TestExpect:
    @pytest.mark.parametrize(
        ("endstop", "last", "holds", "expected"),
        [
            (1.5, None, False, 1.5),
            (0.0, None, True, 0.0),
            (1.5, LAST, False, 1.5),  # homed there since
            (0.0, LAST, False, 0.0),
            (1.5, LAST, True, 2.0),
            (None, None, False, None),
            (None, LAST, False, 2.0),  # better than nothing
            (None, LAST, True, 2.0),
        ],
    )
    def test_nozzle(self, endstop, last, holds, expected):
        settings = make_settings(position_endstop=endstop)
        assert zc.expect_nozzle(settings, last, holds) == expected

    @pytest.mark.parametrize(
        ("z_offset", "last", "expected"),
        [
            (6.5, None, 7.0),
            (2.0, None, 2.5),  # no smaller one is real
            (1.9999, None, None),
            (0.0, None, None),
            (-6.5, None, None),
            (6.5, LAST, 9.0),
            (0.0, LAST, 9.0),
        ],
    )
    def test_switch(self, z_offset, last, expected):
        settings = make_settings(z_offset=z_offset, switch_offset=0.5)
        assert zc.expect_switch(settings, 1.0, last) == expected

    @given(machines, st.booleans())
    def test_a_machine_that_stays_triggers_just_there(self, machine, holds):
        settings, last = settings_of(machine), machine.result()
        pin, switch = machine.pin, machine.switch_trigger
        assert zc.expect_nozzle(settings, last, holds) == pin
        assert zc.expect_switch(settings, pin, last) == switch
        bed = zc.expect_bed(settings, pin, switch, last)
        assert bed == machine.bed_trigger

    @given(machines, shifts)
    def test_the_switch_follows_the_nozzle(self, machine, shift):
        now = machine.shifted(shift)
        expected = zc.expect_switch(settings_of(now), now.pin, machine.result())
        assert expected == now.switch_trigger

    @given(machines)
    def test_a_right_z_offset_tells_the_switch(self, machine):
        assume(machine.body + machine.travel >= 2.0)
        settings = settings_of(machine, z_offset=machine.body + machine.travel)
        expected = zc.expect_switch(settings, machine.pin, None)
        assert expected == machine.switch_trigger

    @given(heights, heights, travels, st.none() | results)
    def test_the_bed_is_where_the_offset_would_be_as_before(
        self, nozzle, switch, switch_offset, last
    ):
        settings = make_settings(switch_offset=switch_offset)
        z = zc.expect_bed(settings, nozzle, switch, last)
        found = zc.offset(z, switch, nozzle, switch_offset)
        assert found == (last.offset if last else 0.0)


class TestFloors:
    @pytest.mark.parametrize(
        ("area", "floor"),
        [
            (None, -5.0),
            (((10.0, 10.0), (50.0, 50.0)), -1.0),
            (((10.0, 31.0), (50.0, 50.0)), -5.0),
            (((10.0, 10.0), (19.0, 50.0)), -5.0),
        ],
    )
    def test_no_pin_is_lower_than_the_bed(self, area, floor):
        settings = make_settings(mesh_area=area, offset_margins=(-1.0, 1.0))
        point = 20.0, 30.0
        assert zc.floor_over(settings, -5.0, point) == floor
        assert zc.floor_over(settings, 0.6, point) == 0.6
        is_raised = floor > -5.0
        body = zc.floor_over(settings, -5.0, point, below=6.0)
        assert body == (5.0 if is_raised else -5.0)
        assert zc.floor_over(settings, -5.0, None) == -5.0

    @pytest.mark.parametrize(
        ("endstop", "margins", "travel_margin", "position_min", "floor"),
        [
            (0.0, (-1.0, 1.0), 1.0, -5.0, -1.0),
            (2.25, (-1.0, 1.0), 1.0, -5.0, 1.25),
            (0.0, (-3.0, 1.0), 1.0, -5.0, -1.0),  # margins are for the result
            (0.0, (-0.25, 3.0), 1.0, -5.0, -1.0),
            (0.0, (-0.25, 3.0), 0.5, -5.0, -0.5),
            (0.0, (0.0, 1.0), 1.0, -5.0, -1.0),
            (0.0, (-1.0, 1.0), 1.0, -0.5, -0.5),  # never below position_min
            (0.0, (-1.0, 1.0), 1.0, -1.0, -1.0),
        ],
    )
    def test_nozzle_where_z_was_homed(
        self, endstop, margins, travel_margin, position_min, floor
    ):
        settings = make_settings(
            position_endstop=endstop,
            offset_margins=margins,
            travel_margin=travel_margin,
            position_min=position_min,
        )
        # Whatever an earlier run has found
        for expected_z in (endstop, 4.0):
            assert zc.nozzle_floor(settings, expected_z) == floor

    @pytest.mark.parametrize(
        ("expected", "position_min", "floor"),
        [
            (None, -5.0, -5.0),
            (2.0, -5.0, 1.5),
            (0.0, -5.0, -0.5),
            (2.0, 1.75, 1.75),
        ],
    )
    def test_nozzle_on_a_separate_pin(self, expected, position_min, floor):
        settings = make_settings(
            position_endstop=None,
            offset_margins=(-3.0, 3.0),
            travel_margin=0.5,
            position_min=position_min,
        )
        assert zc.nozzle_floor(settings, expected) == floor

    @pytest.mark.parametrize(
        ("nozzle", "expected", "position_min", "floor"),
        [
            (0.25, None, -5.0, 1.25),
            (0.25, 9.0, -5.0, 8.5),
            (0.25, 1.5, -5.0, 1.25),  # never closer to the nozzle's
            (0.25, 1.75, -5.0, 1.25),
            (0.25, 2.0, -5.0, 1.5),
            (-8.0, None, -5.0, -5.0),
            (-8.0, -5.25, -5.0, -5.0),
            (-8.0, 0.0, -5.0, -0.5),
        ],
    )
    def test_switch(self, nozzle, expected, position_min, floor):
        settings = make_settings(travel_margin=0.5, position_min=position_min)
        assert zc.switch_floor(settings, nozzle, expected) == floor

    @pytest.mark.parametrize(
        ("nozzle", "switch", "low", "position_min", "floor"),
        [
            (0.0, 6.0, -1.0, -5.0, 5.5),
            (2.0, 6.0, -1.0, -5.0, 3.5),
            (2.0, 6.0, -0.25, -5.0, 4.25),
            (2.0, 6.0, 0.0, -5.0, 4.5),
            (0.0, 1.0, -1.0, 1.0, 1.0),
        ],
    )
    def test_bed(self, nozzle, switch, low, position_min, floor):
        settings = make_settings(
            switch_offset=0.5,
            offset_margins=(low, 3.0),
            position_min=position_min,
        )
        assert zc.bed_floor(settings, nozzle, switch) == floor

    @pytest.mark.parametrize(
        ("high", "position_min", "endstop", "nozzle", "floor"),
        [
            (1.0, -5.0, 0.5, 0.5, 2.0),
            (0.0, -5.0, 0.5, 0.5, 1.0),
            (3.0, -5.0, 0.5, 0.5, 4.0),
            (1.0, 2.25, 0.5, 0.5, 2.25),
            (1.0, -5.0, 0.5, 2.0, 3.5),  # the bed has risen with the pin
            (1.0, -5.0, 0.5, -2.0, 2.0),
            (1.0, -5.0, None, 9.0, 2.0),
        ],
    )
    def test_unmeasured_bed(self, high, position_min, endstop, nozzle, floor):
        settings = make_settings(
            offset_margins=(-2.0, high),
            position_min=position_min,
            position_endstop=endstop,
        )
        assert zc.unmeasured_bed_floor(settings, nozzle) == floor

    @given(
        heights,
        heights,
        heights,
        expected_heights,
        st.none() | heights,
        margin_pairs,
    )
    def test_never_below_position_min(
        self, position_min, nozzle, switch, expected, endstop, margins
    ):
        settings = make_settings(
            position_min=position_min,
            position_endstop=endstop,
            offset_margins=margins,
        )
        for floor in (
            zc.nozzle_floor(settings, expected),
            zc.switch_floor(settings, nozzle, expected),
            zc.bed_floor(settings, nozzle, switch),
            zc.unmeasured_bed_floor(settings, nozzle),
        ):
            assert floor >= position_min

    @given(heights, heights, heights, shifts)
    def test_shift_of_the_frame_shifts_the_floors(
        self, nozzle, switch, endstop, shift
    ):
        plain = make_settings(position_endstop=endstop, position_min=-9999.0)
        moved = plain.replace(position_endstop=endstop + shift)
        assert zc.nozzle_floor(moved, None) == (
            zc.nozzle_floor(plain, None) + shift
        )
        assert zc.switch_floor(moved, nozzle + shift, switch + shift) == (
            zc.switch_floor(plain, nozzle, switch) + shift
        )
        # Z=0 is meant to be the bed, wherever the pin stands
        assert zc.bed_floor(moved, nozzle + shift, switch + shift) == (
            zc.bed_floor(plain, nozzle, switch)
        )

    @given(machines, exact(-1 + STEP, 1 - STEP))
    def test_a_healthy_machine_triggers_above_every_floor(
        self, machine, z_offset_error
    ):
        z_offset = machine.body + machine.travel + z_offset_error
        settings = settings_of(machine, z_offset=z_offset)
        pin, switch = machine.pin, machine.switch_trigger
        homed = zc.expect_nozzle(settings, None, False)
        assert zc.nozzle_floor(settings, homed) < pin
        body = zc.expect_switch(settings, pin, None)
        assert zc.switch_floor(settings, pin, body) < switch
        assert zc.bed_floor(settings, pin, switch) < machine.bed_trigger

    @given(machines, st.booleans(), exact(-1 + STEP, 1 - STEP), st.booleans())
    def test_it_does_so_again_after_a_run(self, machine, holds, shift, own_pin):
        last, now = machine.result(), machine
        if not holds:
            # Homed again: to where position_endstop says the pin is
            now = machine.shifted(shift)
            assume(-1.0 < now.bed < 1.0)
        settings = settings_of(now)
        if own_pin:
            settings = settings.replace(position_endstop=None)
        pin, switch = now.pin, now.switch_trigger
        nozzle = zc.expect_nozzle(settings, last, holds)
        assert zc.nozzle_floor(settings, nozzle) < pin
        body = zc.expect_switch(settings, pin, last)
        assert zc.switch_floor(settings, pin, body) < switch
        assert zc.bed_floor(settings, pin, switch) < now.bed_trigger

    @given(machines, margin_pairs)
    def test_a_bed_inside_the_margins_is_not_below_the_bed_floor(
        self, machine, margins
    ):
        settings = settings_of(machine, offset_margins=margins)
        floor = zc.bed_floor(settings, machine.pin, machine.switch_trigger)
        within = machine.bed >= margins[0]
        assert (machine.bed_trigger >= floor) == within

    @given(machines, margin_pairs)
    def test_a_dead_probe_stops_with_the_nozzle_above_the_bed(
        self, machine, margins
    ):
        low, high = margins
        assume(machine.body + machine.travel > high - low)
        machine = machine._replace(bed=high)
        settings = settings_of(machine, offset_margins=margins)
        floor = zc.bed_floor(settings, machine.pin, machine.switch_trigger)
        assert floor > machine.bed

    @given(margin_pairs, heights)
    def test_so_does_one_of_unknown_length(self, margins, nozzle):
        settings = make_settings(offset_margins=margins)
        floor = zc.unmeasured_bed_floor(settings, nozzle)
        assert floor >= margins[1] + 1.0

    @given(machines, margin_pairs)
    def test_a_long_probe_of_unknown_length_finds_the_bed(
        self, machine, margins
    ):
        low, high = margins
        assume(machine.body + machine.travel > high - low + 1.0)
        machine = machine._replace(bed=low)
        settings = settings_of(machine, offset_margins=margins)
        floor = zc.unmeasured_bed_floor(settings, machine.pin)
        assert floor < machine.bed_trigger

    @given(heights, expected_heights)
    def test_a_dead_switch_stops_with_the_nozzle_above_the_pin(
        self, nozzle, expected
    ):
        settings = make_settings()
        assert zc.switch_floor(settings, nozzle, expected) >= nozzle + 1.0

    @given(machines)
    def test_a_dead_switch_is_pressed_no_more_than_the_margin(self, machine):
        settings = settings_of(machine, travel_margin=0.5)
        expected = zc.expect_switch(settings, machine.pin, machine.result())
        floor = zc.switch_floor(settings, machine.pin, expected)
        assert floor >= machine.switch_trigger - 0.5

    @given(heights, heights, travels, margin_pairs)
    def test_a_result_at_the_bed_floor_is_at_the_lower_margin(
        self, nozzle, switch, switch_offset, margins
    ):
        settings = make_settings(
            position_min=-1000.0,
            switch_offset=switch_offset,
            offset_margins=margins,
        )
        floor = zc.bed_floor(settings, nozzle, switch)
        at_floor = zc.offset(floor, switch, nozzle, switch_offset)
        assert at_floor == margins[0]
        zc.check_offset(zc.Result(0, 0, 0, 0, at_floor), margins, None)


class TestLowestSwitch:
    @pytest.mark.parametrize(
        ("nozzle", "bed_z", "high", "lowest"),
        [
            (0.0, 8.0, 1.0, 6.5),
            (2.0, 8.0, 1.0, 8.5),
            (0.0, 8.0, 0.25, 7.25),
            (0.0, 2.0, 1.0, 0.5),
        ],
    )
    def test_table(self, nozzle, bed_z, high, lowest):
        settings = make_settings(switch_offset=0.5, offset_margins=(-2.0, high))
        assert zc.lowest_switch(settings, nozzle, bed_z) == lowest

    @given(machines, margin_pairs)
    def test_never_above_the_body_if_the_offset_is_inside_the_margins(
        self, machine, margins
    ):
        low, high = margins
        assume(low <= machine.bed <= high)
        settings = settings_of(machine, offset_margins=margins)
        lowest = zc.lowest_switch(settings, machine.pin, machine.bed_trigger)
        assert lowest <= machine.switch_trigger
        # and not further below than the margins are wide
        assert lowest >= machine.switch_trigger - (high - low)

    @given(heights, heights, travels, margin_pairs)
    def test_a_switch_there_gives_the_upper_margin(
        self, nozzle, bed_z, switch_offset, margins
    ):
        settings = make_settings(
            switch_offset=switch_offset, offset_margins=margins
        )
        lowest = zc.lowest_switch(settings, nozzle, bed_z)
        assert zc.offset(bed_z, lowest, nozzle, switch_offset) == margins[1]


class TestDefaultSafeZ:
    @pytest.mark.parametrize(
        ("z_offset", "safe_z"),
        [
            (6.5, 13.0),
            (1.5, 3.0),
            (1.49, 20.0),
            (0.0, 20.0),
            (-2.0, 20.0),
            (-20.0, 20.0),
        ],
    )
    def test_table(self, z_offset, safe_z):
        assert zc.default_safe_z(z_offset) == safe_z

    @given(st.floats(allow_nan=False, allow_infinity=False, width=32))
    def test_is_always_a_real_height(self, z_offset):
        assert zc.default_safe_z(z_offset) >= 3.0


class TestTravelHeight:
    @pytest.mark.parametrize(
        ("pin", "body", "z_offset", "height"),
        [
            (0.0, 2.0, 6.5, 8.0),  # safe_z_height is enough
            # with a switch_offset of 0.5 and 1 mm for the free plunger
            (0.0, 6.0, 6.5, 8.0),
            (0.0, 8.0, 6.5, 10.0),
            (1.0, 8.0, 6.5, 11.0),
            (-1.0, 8.0, 6.5, 10.0),  # the bed is at 0 nevertheless
            (-1.0, None, 6.5, 10.5),
            (None, 8.0, 6.5, 10.0),
            (0.0, 0.0, 6.5, 8.0),  # 0 is a length, too
            (0.0, None, 6.5, 10.5),
            (0.0, None, 10.25, 10.75),
            (0.0, None, -6.5, 10.5),
            (2.0, None, 6.5, 12.5),
            (None, None, 6.5, 10.5),
            (0.0, 27.5, 6.5, 29.5),
            (0.0, 29.75, 6.5, 30.0),  # no further than the axis goes
            (25.0, None, 6.5, 30.0),
        ],
    )
    def test_table(self, pin, body, z_offset, height):
        settings = make_settings(
            safe_z_height=8.0,
            travel_margin=0.5,
            switch_offset=0.5,
            z_offset=z_offset,
            position_max=30.0,
        )
        assert zc.travel_height(settings, pin, body) == height

    @pytest.mark.parametrize(
        ("nozzle", "switch", "high", "height"),
        [
            (0.0, 4.0, 1.0, 8.0),  # safe_z_height is enough
            (0.0, 5.0, 1.0, 8.0),
            (0.0, 5.25, 1.0, 8.25),  # the bed at its highest
            (0.0, 5.25, 1.5, 8.75),
            (0.0, 5.25, 0.0, 8.0),
            (-2.0, 5.0, 1.0, 10.0),
            (3.0, 9.0, 1.0, 11.0),  # the pin is higher
            (1.0, 9.0, 1.0, 11.0),  # both the same
            (0.75, 9.0, 1.0, 11.25),
            (0.75, 9.0, 0.0, 11.0),
            (0.0, -9.0, 1.0, 8.0),
            (0.0, 27.5, 0.25, 29.75),
            (0.0, 29.0, 1.0, 30.0),  # no further than the axis goes
            (9.0, 29.75, 1.0, 30.0),
        ],
    )
    @pytest.mark.parametrize("low", [-2.0, -0.25])
    def test_table_to_bed(self, nozzle, switch, low, high, height):
        settings = make_settings(
            safe_z_height=8.0,
            travel_margin=0.5,
            position_max=30.0,
            switch_offset=0.5,
            offset_margins=(low, high),
        )
        found = zc.travel_height_to_bed(settings, nozzle, switch)
        assert found == height

    @given(
        st.none() | heights,
        st.none() | exact(0, 50),
        heights,
        margin_pairs,
        exact(3, 50),
        exact(5, 500),
    )
    def test_limits(self, pin, body, switch, margins, safe_z, position_max):
        settings = make_settings(
            safe_z_height=safe_z,
            position_max=position_max,
            offset_margins=margins,
        )
        for height in (
            zc.travel_height(settings, pin, body),
            zc.travel_height_to_bed(settings, pin or 0.0, switch),
        ):
            assert min(safe_z, position_max) <= height <= position_max

    @given(machines, exact(STEP, 3), exact(3, 20))
    def test_a_known_body_clears_pin_and_bed(self, machine, margin, safe_z):
        settings = settings_of(
            machine, travel_margin=margin, safe_z_height=safe_z
        )
        height = zc.travel_height(settings, machine.pin, machine.body)
        assert height - machine.body >= machine.pin + margin
        # The bed lies at about 0
        assert height - machine.body >= margin

    @given(machines, exact(-10, 20), exact(STEP, 3), exact(3, 20))
    def test_an_unmeasured_body_clears_pin_and_bed(
        self, machine, z_offset, margin, safe_z
    ):
        assume(machine.body <= max(z_offset, 10.0))
        settings = settings_of(
            machine,
            z_offset=z_offset,
            travel_margin=margin,
            safe_z_height=safe_z,
        )
        height = zc.travel_height(settings, machine.pin, None)
        assert height - machine.body >= machine.pin + margin
        assert height - machine.body >= margin

    @given(machines, offsets_within_margins, exact(STEP, 3), exact(3, 20))
    def test_the_probe_clears_pin_and_bed(
        self, machine, margins_and_bed, margin, safe_z
    ):
        margins, bed = margins_and_bed
        machine = machine._replace(bed=bed)
        settings = settings_of(
            machine,
            offset_margins=margins,
            travel_margin=margin,
            safe_z_height=safe_z,
        )
        pin, switch = machine.pin, machine.switch_trigger
        height = zc.travel_height_to_bed(settings, pin, switch)
        assert height >= switch + margin
        assert height >= machine.bed_trigger + margin
        # also with the free plunger, and no higher than that
        highest = machine._replace(bed=max(margins[1], pin)).bed_trigger
        assert height == max(safe_z, highest + 1.0 + margin)

    @given(heights, heights, travels, margin_pairs, distances)
    def test_a_larger_margin_is_never_a_lower_travel(
        self, nozzle, switch, switch_offset, margins, more
    ):
        low, high = margins
        plain = make_settings(
            offset_margins=margins, switch_offset=switch_offset
        )
        wider = plain.replace(offset_margins=(low, high + more))
        above = zc.travel_height_to_bed(plain, nozzle, switch)
        assert zc.travel_height_to_bed(wider, nozzle, switch) >= above
        # How deep the bed may lie is nothing to a travel
        deeper = plain.replace(offset_margins=(low - more, high))
        assert zc.travel_height_to_bed(deeper, nozzle, switch) == above

    @given(heights, exact(0, 50), distances)
    def test_more_below_the_nozzle_is_never_a_lower_travel(
        self, pin, body, more
    ):
        settings = make_settings()
        plain = zc.travel_height(settings, pin, body)
        assert zc.travel_height(settings, pin + more, body) >= plain
        assert zc.travel_height(settings, pin, body + more) >= plain
