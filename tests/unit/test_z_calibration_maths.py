"""The pure part of z_calibration.py: tables of edges and general properties."""

import importlib.util
import math
import statistics
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[2]


def load_module():
    path = ROOT / "z_calibration.py"
    spec = importlib.util.spec_from_file_location("z_calibration", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


zc = load_module()

heights = st.floats(-50.0, 400.0)
series = st.lists(heights, min_size=1, max_size=9)
methods = st.sampled_from(["median", "average"])


def make_settings(**changes):
    """Settings of a plausible machine, all fields set."""
    values = dict.fromkeys(zc.Settings._fields)
    values.update(
        nozzle=zc.Site("nozzle", 100.0, 290.0),
        switch=zc.Site("switch", 110.0, 290.0),
        bed=zc.Site("bed", 150.0, 150.0),
        switch_offset=0.5,
        attach_after_nozzle=False,
        offset_margins=(-1.0, 1.0),
        travel_margin=1.0,
        position_endstop=0.0,
        position_min=-5.0,
        samples=3,
        samples_tolerance=0.01,
        samples_tolerance_retries=0,
        samples_result="median",
    )
    values.update(changes)
    return zc.Settings(**values)


def filled_settings():
    """Settings that leave nothing to the probe; each value is unlike its."""
    return make_settings(
        safe_z_height=8.0,
        speed=50.0,
        lift_speed=1.0,
        bed_speed=2.0,
        probing_second_speed=3.0,
        probing_retract_dist=4.0,
        samples=7,
        samples_tolerance=0.0,
        samples_tolerance_retries=0,
        samples_result="average",
    )


class TestParsePair:
    @pytest.mark.parametrize(
        ("text", "pair"),
        [
            ("100,200", (100.0, 200.0)),
            (" 1.5 , -2 ", (1.5, -2.0)),
            ("0,0", (0.0, 0.0)),
            ("1e2,.5", (100.0, 0.5)),
        ],
    )
    def test_accepts_two_numbers(self, text, pair):
        assert zc.parse_pair(text) == pair

    @pytest.mark.parametrize(
        "text",
        ["", "1", "1,", ",1", "1,2,3", "a,b", "1;2", "1 2", "nan,1", "1,inf"]
        + ["-inf,0", "<X,Y position>", "1,0x10"],
    )
    def test_refuses_anything_else_and_shows_it(self, text):
        with pytest.raises(zc.CalibrationError) as caught:
            zc.parse_pair(text)
        parts = [part.strip() for part in text.split(",")]
        assert any(
            "'%s'" % shown in str(caught.value) for shown in [text, *parts]
        )

    @given(heights, heights)
    def test_reads_back_what_was_written(self, x, y):
        assert zc.parse_pair(f"{x!r}, {y!r}") == (x, y)


class TestParseNotNegative:
    @pytest.mark.parametrize(
        ("text", "value"), [("0", 0.0), ("0.44", 0.44), (" 1 ", 1.0)]
    )
    def test_accepts_zero_and_more(self, text, value):
        assert zc.parse_not_negative(text) == value

    @pytest.mark.parametrize("text", ["-0.001", "", "nan", "inf", "a", "1,2"])
    def test_refuses_anything_else_and_shows_it(self, text):
        with pytest.raises(zc.CalibrationError, match="'%s'" % text):
            zc.parse_not_negative(text)


class TestSummarize:
    @pytest.mark.parametrize(
        ("samples", "method", "expected"),
        [
            ([1.0], "median", 1.0),
            ([1.0], "average", 1.0),
            ([3.0, 1.0, 2.0], "median", 2.0),
            ([4.0, 1.0, 2.0, 3.0], "median", 2.5),
            ([0.0, 0.0, 3.0], "median", 0.0),
            ([0.0, 0.0, 3.0], "average", 1.0),
        ],
    )
    def test_table(self, samples, method, expected):
        assert zc.summarize(samples, method) == expected

    @given(series)
    def test_agrees_with_the_standard_library(self, samples):
        assert zc.summarize(samples, "median") == statistics.median(samples)
        assert zc.summarize(samples, "average") == pytest.approx(
            statistics.fmean(samples), abs=1e-9
        )

    @given(series, methods)
    def test_lies_within_the_samples(self, samples, method):
        result = zc.summarize(samples, method)
        assert min(samples) - 1e-9 <= result <= max(samples) + 1e-9

    @given(st.data(), series, methods)
    def test_order_does_not_matter(self, data, samples, method):
        shuffled = data.draw(st.permutations(samples))
        assert zc.summarize(shuffled, method) == zc.summarize(samples, method)

    @given(series, methods, st.floats(-10.0, 10.0))
    def test_shifts_with_the_samples(self, samples, method, shift):
        moved = zc.summarize([z + shift for z in samples], method)
        assert moved == pytest.approx(
            zc.summarize(samples, method) + shift, abs=1e-9
        )


class TestCollect:
    def collect(self, values, **changes):
        touches, notes = iter(values), []
        result = zc.collect(
            lambda: next(touches), make_settings(**changes), notes.append
        )
        return result, notes, list(touches)

    def test_takes_exactly_the_samples_wanted(self):
        result, notes, unused = self.collect([1.0, 1.003, 1.001, 9.0])
        assert result == zc.Touch(1.001, (1.0, 1.003, 1.001))
        assert (notes, unused) == ([], [9.0])

    # 0.25 and 0.5 are exact in binary: equality really is equality
    @pytest.mark.parametrize(
        ("second", "agrees"), [(1.25, True), (0.75, True), (1.2500001, False)]
    )
    def test_a_spread_equal_to_the_tolerance_agrees(self, second, agrees):
        changes = {"samples": 2, "samples_tolerance": 0.25}
        if agrees:
            assert self.collect([1.0, second], **changes)[0].samples == (
                1.0,
                second,
            )
        else:
            with pytest.raises(
                zc.CalibrationError, match="samples_tolerance is 0.25"
            ):
                self.collect([1.0, second], **changes)

    def test_a_retry_starts_the_series_again(self):
        result, notes, unused = self.collect(
            [1.0, 2.0, 3.0, 3.0, 3.0], samples_tolerance_retries=1
        )
        assert result.samples == (3.0, 3.0, 3.0)
        assert len(notes) == 1
        assert not unused

    @pytest.mark.parametrize("retries", [0, 1, 2, 5])
    def test_gives_up_after_the_retries(self, retries):
        touched = []

        def touch():
            touched.append(float(len(touched)))
            return touched[-1]

        settings = make_settings(samples_tolerance_retries=retries)
        with pytest.raises(zc.CalibrationError, match="1.0000 mm"):
            zc.collect(touch, settings, lambda msg: None)
        assert len(touched) == 2 * (retries + 1)

    def test_an_error_of_the_touch_ends_it_at_once(self):
        def touch():
            raise zc.CalibrationError("probe lost")

        settings = make_settings(samples_tolerance_retries=5)
        with pytest.raises(zc.CalibrationError, match="probe lost"):
            zc.collect(touch, settings, lambda msg: None)

    @given(st.lists(st.floats(0.0, 0.02), min_size=40, max_size=40))
    def test_whatever_is_returned_keeps_the_tolerance(self, values):
        try:
            result, _, _ = self.collect(values, samples_tolerance_retries=4)
        except zc.CalibrationError:
            return
        assert len(result.samples) == 3
        assert max(result.samples) - min(result.samples) <= 0.01


class TestOffset:
    def test_example_of_the_specification(self):
        result = zc.offset(
            probe=5.602, switch=7.366, nozzle=2.202, switch_offset=0.44
        )
        assert result == pytest.approx(-0.002, abs=1e-9)

    @given(
        heights, heights, heights, st.floats(0.0, 3.0), st.floats(-10.0, 10.0)
    )
    def test_shift_of_the_frame_shifts_the_offset(self, p, s, n, so, shift):
        # switch - nozzle is a difference, only the bed's height remains
        moved = zc.offset(p + shift, s + shift, n + shift, so)
        assert moved == pytest.approx(zc.offset(p, s, n, so) + shift, abs=1e-9)

    @given(
        heights, heights, heights, st.floats(0.0, 3.0), st.floats(0.001, 1.0)
    )
    def test_signs(self, p, s, n, so, more):
        plain = zc.offset(p, s, n, so)
        assert zc.offset(p, s, n, so + more) < plain  # nozzle closer to the bed
        assert zc.offset(p + more, s, n, so) > plain  # bed higher
        assert zc.offset(p, s + more, n, so) < plain  # probe hangs less low
        assert zc.offset(p, s, n + more, so) > plain

    @given(
        st.floats(-2.0, 2.0),
        st.floats(-1.0, 1.0),
        st.floats(1.0, 12.0),
        st.floats(0.0, 2.0),
    )
    def test_finds_the_bed_of_a_modelled_machine(self, pin, bed, body, travel):
        # toolhead Z where the nozzle meets pin and bed; the body hangs below
        # the nozzle and the probe triggers 'travel' above the body
        found = zc.offset(
            probe=bed + body + travel,
            switch=pin + body,
            nozzle=pin,
            switch_offset=travel,
        )
        assert found == pytest.approx(bed, abs=1e-9)


class TestFloors:
    @pytest.mark.parametrize(
        ("endstop", "margins", "position_min", "floor"),
        [
            (0.0, (-1.0, 1.0), -5.0, -1.0),
            (2.2, (-1.0, 1.0), -5.0, 1.2),
            (0.0, (-3.0, 1.0), -5.0, -3.0),  # what the margins allow is larger
            (0.0, (-0.2, 1.0), -5.0, -1.0),  # the travel margin is larger
            (0.0, (0.1, 1.0), -5.0, -1.0),
            (0.0, (-1.0, 1.0), -0.5, -0.5),  # never below position_min
        ],
    )
    def test_nozzle(self, endstop, margins, position_min, floor):
        settings = make_settings(
            position_endstop=endstop,
            offset_margins=margins,
            position_min=position_min,
        )
        assert zc.nozzle_floor(settings) == pytest.approx(floor)

    @pytest.mark.parametrize(
        ("nozzle", "position_min", "floor"),
        [(0.1, -5.0, 1.1), (-8.0, -5.0, -5.0)],
    )
    def test_switch(self, nozzle, position_min, floor):
        settings = make_settings(position_min=position_min)
        assert zc.switch_floor(settings, nozzle) == pytest.approx(floor)

    @pytest.mark.parametrize(
        ("nozzle", "switch", "position_min", "floor"),
        [(0.0, 6.0, -5.0, 5.5), (2.0, 6.0, -5.0, 3.5), (0.0, 1.0, 1.0, 1.0)],
    )
    def test_bed(self, nozzle, switch, position_min, floor):
        settings = make_settings(position_min=position_min)
        assert zc.bed_floor(settings, nozzle, switch) == pytest.approx(floor)

    @given(heights, heights, heights)
    def test_never_below_position_min(self, position_min, nozzle, switch):
        settings = make_settings(position_min=position_min)
        assert zc.nozzle_floor(settings) >= position_min
        assert zc.switch_floor(settings, nozzle) >= position_min
        assert zc.bed_floor(settings, nozzle, switch) >= position_min

    @given(
        st.floats(-2.0, 2.0),
        st.floats(2.0, 12.0),
        st.floats(0.0, 2.0),
        st.floats(-0.99, 0.99),
    )
    def test_a_healthy_machine_triggers_above_every_floor(
        self, pin, body, travel, bed
    ):
        settings = make_settings(
            position_endstop=pin, switch_offset=travel, position_min=-100.0
        )
        assert zc.nozzle_floor(settings) < pin
        assert zc.switch_floor(settings, pin) < pin + body
        assert zc.bed_floor(settings, pin, pin + body) < bed + body + travel

    @given(
        st.floats(-2.0, 2.0),
        st.floats(2.1, 12.0),
        st.floats(0.0, 2.0),
        st.floats(-0.99, 0.99),
    )
    def test_a_dead_probe_stops_with_the_nozzle_above_the_bed(
        self, pin, body, travel, bed
    ):
        settings = make_settings(
            position_endstop=pin, switch_offset=travel, position_min=-100.0
        )
        assert zc.bed_floor(settings, pin, pin + body) > bed

    @given(heights, heights)
    def test_a_result_at_the_bed_floor_is_at_the_lower_margin(
        self, nozzle, switch
    ):
        settings = make_settings(position_min=-1000.0)
        floor = zc.bed_floor(settings, nozzle, switch)
        at_floor = zc.offset(floor, switch, nozzle, settings.switch_offset)
        assert at_floor == pytest.approx(settings.offset_margins[0], abs=1e-9)


class TestCheckOffset:
    @pytest.mark.parametrize("value", [-1.0, -0.5, 0.0, 1.0])
    def test_accepts_the_margins_themselves(self, value):
        zc.check_offset(zc.Result(0, 0, 0, 0, value), (-1.0, 1.0))

    @pytest.mark.parametrize("value", [-1.0000001, 1.0000001, 40.0, math.nan])
    def test_refuses_anything_outside_and_names_the_values(self, value):
        with pytest.raises(zc.CalibrationError) as caught:
            zc.check_offset(zc.Result(5.6, 7.3, 2.2, 0.4, value), (-1.0, 1.0))
        for shown in (
            "%.3f" % value,
            "-1.000",
            "1.000",
            "5.600",
            "7.300",
            "2.200",
        ):
            assert shown in str(caught.value)


class TestDefaults:
    @pytest.mark.parametrize(
        ("z_offset", "safe_z"),
        [(6.5, 13.0), (1.5, 3.0), (1.49, 20.0), (0.0, 20.0), (-2.0, 20.0)],
    )
    def test_safe_z(self, z_offset, safe_z):
        assert zc.default_safe_z(z_offset) == safe_z

    PROBE = {
        "probe_speed": 5.0,
        "lift_speed": 10.0,
        "samples": 3,
        "samples_tolerance": 0.1,
        "samples_tolerance_retries": 2,
        "samples_result": "median",
    }

    LEFT_OPEN = {*PROBE, "safe_z_height", "bed_speed"} - {"probe_speed"}

    def test_the_probe_fills_what_is_open(self):
        open_fields = dict.fromkeys(self.LEFT_OPEN)
        settings = zc.complete(
            filled_settings()._replace(**open_fields), self.PROBE, 6.5
        )
        assert settings.safe_z_height == 13.0
        assert settings.bed_speed == 5.0
        for name in set(self.PROBE) - {"probe_speed"}:
            assert getattr(settings, name) == self.PROBE[name]

    def test_what_is_set_stays(self):
        chosen = filled_settings()
        assert zc.complete(chosen, self.PROBE, 6.5) == chosen

    @given(st.floats(allow_nan=False, allow_infinity=False, width=32))
    def test_safe_z_is_always_a_real_height(self, z_offset):
        assert zc.default_safe_z(z_offset) >= zc.SMALLEST_SAFE_Z


def test_no_state_at_module_level():
    mutable = [
        name
        for name, value in vars(zc).items()
        if not name.startswith("__") and isinstance(value, (list, dict, set))
    ]
    assert mutable == []
