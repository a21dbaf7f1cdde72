"""The pure part of z_calibration.py: tables of edges and general properties."""

import importlib.util
import math
import shlex
import statistics
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[3]


def load_module():
    path = ROOT / "z_calibration.py"
    spec = importlib.util.spec_from_file_location("z_calibration", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


zc = load_module()

STEP = 1 / 64


def exact(low, high):
    """Multiples of 1/64: their sums are exact, equality really is equality."""
    return st.integers(int(low / STEP), int(high / STEP)).map(
        lambda steps: steps * STEP
    )


heights = exact(-50, 400)
shifts = exact(-10, 10)
distances = exact(STEP, 10)
travels = exact(0, 3)
series = st.lists(st.floats(-50.0, 400.0), min_size=1, max_size=9)
methods = st.sampled_from(["median", "average"])
margin_pairs = st.tuples(exact(-3, 0), exact(0, 3)).filter(any)
# Margins and an offset that they admit
offsets_within_margins = margin_pairs.flatmap(
    lambda margins: st.tuples(st.just(margins), exact(*margins))
)
results = st.builds(zc.Result, heights, heights, heights, travels, shifts)
expected_heights = st.builds(
    zc.Expected, st.none() | heights, st.just(False)
) | st.builds(zc.Expected, heights, st.just(True))


class Machine(NamedTuple):
    """What only the test knows; heights are toolhead Z."""

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

    def shifted(self, shift):
        """After homing at a pin that is taken to stand elsewhere."""
        return self._replace(pin=self.pin + shift, bed=self.bed + shift)

    def result(self):
        """What a run finds."""
        parts = (self.bed_trigger, self.switch_trigger, self.pin, self.travel)
        return zc.Result(*parts, zc.offset(*parts))


# Bodies that the module admits, beds inside the default margins
machines = st.builds(
    Machine,
    pin=exact(-2, 5),
    body=exact(1 + STEP, 12),
    travel=travels,
    bed=exact(-1 + STEP, 1 - STEP),
)


def make_sampling(**changes):
    """How the pin is sampled; nothing is left to the probe."""
    values = {
        "samples": 3,
        "tolerance": 0.01,
        "retries": 0,
        "result": "median",
        "speed": 2.0,
        "retract_dist": 4.0,
        "lift_speed": 6.0,
    }
    return zc.Sampling(**dict(values, **changes))


def make_settings(**changes):
    """Settings of a plausible machine, as complete() leaves them."""
    values = {
        "nozzle": zc.Site("nozzle", 100.0, 290.0, "nozzle_xy_position"),
        "switch": zc.Site("switch", 110.0, 290.0, "switch_xy_position"),
        "switch_xy_offsets": None,
        "bed": zc.Site("bed", 150.0, 150.0, "bed_xy_position"),
        "wiggle": None,
        "switch_offset": 0.5,
        "attach_after_nozzle": False,
        "first_fast": False,
        "offset_margins": (-1.0, 1.0),
        "travel_margin": 1.0,
        "position_endstop": 0.0,
        "position_min": -100.0,
        "position_max": 500.0,
        "safe_z_height": 13.0,
        "speed": 50.0,
        "probing_speed": 5.0,
        "z_offset": 6.5,
        "pin": make_sampling(),
        "probe": make_sampling(),
    }
    return zc.Settings(**dict(values, **changes))


def settings_of(machine, **changes):
    """Settings of someone who has measured the machine."""
    return make_settings(
        position_endstop=machine.pin, switch_offset=machine.travel
    )._replace(**changes)


def complaint(function, *args):
    """The message that a call ends with."""
    with pytest.raises(zc.CalibrationError) as caught:
        function(*args)
    assert issubclass(caught.type, zc.CalibrationError)
    return str(caught.value)


NOT_NUMBERS = ["", "a", "1,2", "1 2", "0x10", "1;2", "<number>", "1.0.0"]
NOT_FINITE = ["nan", "inf", "-inf", "Infinity", "1e999"]


class TestParseNumber:
    @pytest.mark.parametrize(
        ("text", "value"),
        [("0", 0.0), ("-2", -2.0), (" 1.5 ", 1.5), ("1e2", 100.0), (".5", 0.5)],
    )
    def test_accepts_numbers(self, text, value):
        assert zc.parse_number(text) == value
        assert isinstance(zc.parse_number(text), float)

    @pytest.mark.parametrize("text", NOT_NUMBERS)
    def test_refuses_other_text(self, text):
        assert complaint(zc.parse_number, text) == f"'{text}' is not a number"

    @pytest.mark.parametrize("text", NOT_FINITE)
    def test_refuses_what_is_not_finite(self, text):
        shown = f"'{text}' is not a finite number"
        assert complaint(zc.parse_number, text) == shown

    @given(st.floats(-zc.LARGEST_NUMBER, zc.LARGEST_NUMBER))
    def test_reads_back_what_was_written(self, value):
        assert zc.parse_number(repr(value)) == value

    @pytest.mark.parametrize("text", ["100001", "-1e12", "1e300"])
    def test_refuses_what_no_printer_has(self, text):
        shown = f"'{text}' is larger than 100000"
        assert complaint(zc.parse_number, text) == shown

    @pytest.mark.parametrize("text", ["1_0", "\uff11", "1\u0660"])
    def test_takes_no_other_ways_to_write_digits(self, text):
        shown = f"'{text}' is not a number"
        assert complaint(zc.parse_number, text) == shown
        shown = f"'{text}' is not a whole number"
        assert complaint(zc.parse_count, text, 0) == shown


class TestParseNotNegative:
    @pytest.mark.parametrize(
        ("text", "value"), [("0", 0.0), ("0.44", 0.44), (" 1 ", 1.0)]
    )
    def test_accepts_zero_and_more(self, text, value):
        assert zc.parse_not_negative(text) == value

    @pytest.mark.parametrize("text", ["-0.001", "-1e-9", "-5"])
    def test_refuses_less(self, text):
        assert complaint(zc.parse_not_negative, text) == f"'{text}' is negative"

    @pytest.mark.parametrize("text", NOT_NUMBERS + NOT_FINITE)
    def test_refuses_what_is_no_number(self, text):
        assert complaint(zc.parse_not_negative, text).startswith(
            f"'{text}' is not a "
        )


class TestParsePositive:
    @pytest.mark.parametrize(
        ("text", "value"), [("0.001", 0.001), ("1e-9", 1e-9), (" 5 ", 5.0)]
    )
    def test_accepts_more_than_zero(self, text, value):
        assert zc.parse_positive(text) == value

    @pytest.mark.parametrize("text", ["0", "0.0", "-0", "-1e-9", "-5"])
    def test_refuses_zero_and_less(self, text):
        shown = f"'{text}' is not above zero"
        assert complaint(zc.parse_positive, text) == shown

    @pytest.mark.parametrize("text", NOT_NUMBERS + NOT_FINITE)
    def test_refuses_what_is_no_number(self, text):
        assert complaint(zc.parse_positive, text).startswith(
            f"'{text}' is not a "
        )


class TestParseCount:
    @pytest.mark.parametrize(
        ("text", "smallest", "value"),
        [("1", 1, 1), ("0", 0, 0), (" 3 ", 1, 3), ("10", 10, 10), ("5", 0, 5)],
    )
    def test_accepts_the_smallest_and_more(self, text, smallest, value):
        assert zc.parse_count(text, smallest) == value
        assert isinstance(zc.parse_count(text, smallest), int)

    @pytest.mark.parametrize(
        ("text", "smallest"), [("0", 1), ("-1", 0), ("-3", 1), ("9", 10)]
    )
    def test_refuses_less(self, text, smallest):
        shown = f"'{text}' is less than {smallest}"
        assert complaint(zc.parse_count, text, smallest) == shown

    def test_refuses_more_than_anybody_waits_for(self):
        assert zc.parse_count("1000", 1) == 1000
        for text in ("1001", "9" * 30):
            shown = f"'{text}' is more than 1000"
            assert complaint(zc.parse_count, text, 1) == shown

    @pytest.mark.parametrize(
        "text", [*NOT_NUMBERS, *NOT_FINITE, "1.0", "2.5", "1e3"]
    )
    def test_refuses_what_is_not_whole(self, text):
        shown = f"'{text}' is not a whole number"
        assert complaint(zc.parse_count, text, 1) == shown


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

    @pytest.mark.parametrize("text", ["", "1", "1;2", "1 2", "1,2,3", "1,2,"])
    def test_refuses_another_count(self, text):
        shown = f"'{text}' is not a pair of numbers"
        assert complaint(zc.parse_pair, text) == shown

    @pytest.mark.parametrize(
        ("text", "shown"),
        [
            ("1,", "'' is not a number"),
            (",1", "'' is not a number"),
            ("a, 1", "'a' is not a number"),
            ("1, b ", "'b' is not a number"),
            ("<X,Y position>", "'<X' is not a number"),
            ("1,0x10", "'0x10' is not a number"),
            ("nan,1", "'nan' is not a finite number"),
            ("1,-inf", "'-inf' is not a finite number"),
        ],
    )
    def test_names_the_part_that_is_no_number(self, text, shown):
        assert complaint(zc.parse_pair, text) == shown

    @given(heights, heights)
    def test_reads_back_what_was_written(self, x, y):
        assert zc.parse_pair(f"{x!r}, {y!r}") == (x, y)


class TestParseMargins:
    @pytest.mark.parametrize(
        ("text", "margins"),
        [
            ("1", (-1.0, 1.0)),
            (" 0.001 ", (-0.001, 0.001)),
            ("-1,2", (-1.0, 2.0)),
            (" -0.5 , 0.25 ", (-0.5, 0.25)),
            ("-1,0", (-1.0, 0.0)),
            ("0,1", (0.0, 1.0)),
            ("-0.001,0", (-0.001, 0.0)),
        ],
    )
    def test_accepts_what_holds_zero(self, text, margins):
        assert zc.parse_margins(text) == margins

    @pytest.mark.parametrize(
        "text",
        ["0,0", "-0,0", "0.001,1", "-1,-0.001", "1,1", "1,-1", "-2,-1"],
    )
    def test_refuses_what_does_not(self, text):
        shown = f"'{text}' leaves no room around 0"
        assert complaint(zc.parse_margins, text) == shown

    @pytest.mark.parametrize(
        ("text", "shown"),
        [
            ("0", "'0' is not above zero"),
            ("-1", "'-1' is not above zero"),
            ("", "'' is not a number"),
            ("1 2", "'1 2' is not a number"),
            ("nan", "'nan' is not a finite number"),
            ("-1,0,1", "'-1,0,1' is not a pair of numbers"),
            ("-1,b", "'b' is not a number"),
            ("-inf,1", "'-inf' is not a finite number"),
        ],
    )
    def test_refuses_anything_else(self, text, shown):
        assert complaint(zc.parse_margins, text) == shown

    @given(shifts, shifts)
    def test_a_pair_is_accepted_unless_it_has_no_use(self, low, high):
        text = f"{low!r},{high!r}"
        if low <= 0.0 <= high and high - low > 0.0:
            assert zc.parse_margins(text) == (low, high)
        else:
            complaint(zc.parse_margins, text)

    @given(distances)
    def test_one_value_counts_in_both_directions(self, size):
        assert zc.parse_margins(repr(size)) == (-size, size)


class TestParseWords:
    @pytest.mark.parametrize("text", ["median", "average"])
    def test_accepts_results(self, text):
        assert zc.parse_result(text) == text

    @pytest.mark.parametrize("text", ["", "mean", "Median", "median,average"])
    def test_refuses_other_results(self, text):
        assert complaint(zc.parse_result, text) == f"'{text}' is not known"

    @pytest.mark.parametrize(
        ("text", "value"),
        [("true", True), ("yes", True), ("on", True), ("1", True)]
        + [("false", False), ("no", False), ("off", False), ("0", False)],
    )
    def test_accepts_what_hosts_take_for_a_boolean(self, text, value):
        for spelling in (text, text.upper(), text.capitalize()):
            assert zc.parse_switch(spelling) is value

    @pytest.mark.parametrize("text", ["", "2", "-1", "00", "y", "tru", "None"])
    def test_refuses_other_switches_as_they_were_written(self, text):
        shown = f"'{text}' is neither true nor false"
        assert complaint(zc.parse_switch, text) == shown


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

    @given(series, methods)
    def test_leaves_the_samples_as_they_were(self, samples, method):
        before = list(samples)
        zc.summarize(samples, method)
        assert samples == before


class TestDeviation:
    @pytest.mark.parametrize(
        ("samples", "expected"),
        [
            ([7.0], 0.0),
            ([1.0, 3.0], 1.0),
            ([0.0, 0.0, 3.0], math.sqrt(2.0)),
            ([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0], 2.0),
        ],
    )
    def test_table(self, samples, expected):
        assert zc.deviation(samples) == pytest.approx(expected, abs=1e-12)

    @given(series)
    def test_agrees_with_the_standard_library(self, samples):
        assert zc.deviation(samples) == pytest.approx(
            statistics.pstdev(samples), abs=1e-9
        )

    @given(series, st.floats(-10.0, 10.0))
    def test_neither_shift_nor_sign_matters(self, samples, shift):
        plain = pytest.approx(zc.deviation(samples), abs=1e-9)
        assert zc.deviation([z + shift for z in samples]) == plain
        assert zc.deviation([-z for z in samples]) == plain

    @given(series)
    def test_is_at_most_half_the_range(self, samples):
        half = (max(samples) - min(samples)) / 2.0
        assert 0.0 <= zc.deviation(samples) <= half + 1e-9


class TestCollect:
    def collect(self, values, **changes):
        touches, notes = iter(values), []
        result = zc.collect(
            lambda: next(touches), make_sampling(**changes), notes.append
        )
        return result, notes, list(touches)

    @pytest.mark.parametrize("samples", [1, 2, 3, 5])
    def test_takes_exactly_the_samples_wanted(self, samples):
        values = [1.0, 1.003, 1.001, 1.004, 1.002, 9.0]
        result, notes, unused = self.collect(values, samples=samples)
        assert (result, notes) == (values[:samples], [])
        assert unused == values[samples:]

    # 0.25 and 0.5 are exact in binary: equality really is equality
    @pytest.mark.parametrize("second", [0.75, 1.0, 1.25])
    def test_a_spread_up_to_the_tolerance_agrees(self, second):
        result, notes, _ = self.collect(
            [1.0, second], samples=2, tolerance=0.25
        )
        assert (result, notes) == ([1.0, second], [])

    @pytest.mark.parametrize("second", [0.7499999, 1.2500001])
    def test_a_larger_spread_does_not(self, second):
        sampling = make_sampling(samples=2, tolerance=0.25)
        touches = iter([1.0, second])
        assert complaint(
            zc.collect, lambda: next(touches), sampling, pytest.fail
        ) == (
            "samples differ by 0.2500 mm, samples_tolerance is 0.2500 mm;"
            " clean the nozzle and check the switch for play"
        )

    def test_the_spread_is_of_all_samples(self):
        values = [1.0, 1.25, 1.5]
        with pytest.raises(zc.CalibrationError, match=r"differ by 0\.5000 mm"):
            self.collect(values, tolerance=0.25)

    def test_equal_samples_need_no_tolerance(self):
        assert self.collect([1.0] * 3, tolerance=0.0)[0] == [1.0] * 3

    def test_an_endless_tolerance_takes_everything(self):
        values = [1.0, -50.0, 400.0]
        assert self.collect(values, tolerance=math.inf)[:2] == (values, [])

    def test_a_retry_starts_the_series_again(self):
        result, notes, unused = self.collect(
            [1.0, 2.0, 3.0, 3.0, 3.0], retries=1
        )
        assert result == [3.0, 3.0, 3.0]
        assert notes == [
            "samples differ by 1.0000 mm, samples_tolerance is 0.0100 mm;"
            " trying again"
        ]
        assert not unused

    @pytest.mark.parametrize("retries", [0, 1, 2, 5])
    def test_gives_up_after_the_retries(self, retries):
        touched, notes = [], []

        def touch():
            touched.append(float(len(touched)))
            return touched[-1]

        sampling = make_sampling(retries=retries)
        shown = complaint(zc.collect, touch, sampling, notes.append)
        assert shown.startswith("samples differ by 1.0000 mm,")
        assert len(touched) == 2 * (retries + 1)
        assert len(notes) == retries

    def test_an_error_of_the_touch_ends_it_at_once(self):
        def touch():
            raise zc.NoTrigger("probe lost")

        with pytest.raises(zc.NoTrigger, match="^probe lost$"):
            zc.collect(touch, make_sampling(retries=5), pytest.fail)

    @given(st.lists(exact(0, 1), min_size=40, max_size=40), st.integers(0, 4))
    def test_what_is_returned_are_the_last_touches_and_they_agree(
        self, values, retries
    ):
        try:
            result, notes, unused = self.collect(
                values, tolerance=0.5, retries=retries
            )
        except zc.CalibrationError:
            return
        used = values[: len(values) - len(unused)]
        assert result == used[-3:]
        assert max(result) - min(result) <= 0.5
        assert len(notes) <= retries
        assert bool(notes) == (len(used) > 3)

    @given(st.lists(exact(0, 0.5), min_size=1, max_size=9))
    def test_samples_that_agree_need_no_retry(self, values):
        collected = self.collect(values, samples=len(values), tolerance=0.5)
        assert collected == (values, [], [])


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
        zc.check_offset(zc.Result(0, 0, 0, 0, value), margins)

    @pytest.mark.parametrize("value", [-1.0000001, 1.0000001, 40.0, math.nan])
    def test_refuses_anything_outside_and_names_the_values(self, value):
        result = zc.Result(5.6, 7.3, 2.2, 0.4, value)
        assert complaint(zc.check_offset, result, (-1.0, 1.0)) == (
            f"offset {value:.3f} is outside offset_margins -1.000 to 1.000"
            " (probe=5.600 switch=7.300 nozzle=2.200); home Z again (G28 Z)"
            " after any levelling, then check the three positions and"
            " position_endstop"
        )

    @given(results, margin_pairs)
    def test_refuses_just_what_is_outside(self, result, margins):
        low, high = margins
        if result.offset < low or result.offset > high:
            complaint(zc.check_offset, result, margins)
        else:
            zc.check_offset(result, margins)

    @given(margin_pairs)
    def test_a_perfect_machine_passes_whatever_the_margins(self, margins):
        zc.check_offset(zc.Result(6.5, 6.0, 0.0, 0.5, 0.0), margins)


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
        new = zc.corrected_switch_offset(switch_offset, z, z_offset)
        assert new == expected

    @given(results, shifts)
    def test_gives_the_offset_that_was_moved_to(self, result, z):
        p, s, n, so = result[:4]
        new = zc.corrected_switch_offset(so, z, zc.offset(p, s, n, so))
        assert zc.offset(p, s, n, new) == z

    @given(machines, exact(0, 3))
    def test_finds_the_travel_of_a_modelled_machine(self, machine, wrong):
        p, s, n = machine.result()[:3]
        found = zc.offset(p, s, n, wrong)
        new = zc.corrected_switch_offset(wrong, machine.bed, found)
        assert new == machine.travel

    @given(travels, shifts, shifts, distances)
    def test_signs(self, so, z, z_offset, more):
        plain = zc.corrected_switch_offset(so, z, z_offset)
        assert zc.corrected_switch_offset(so, z - more, z_offset) > plain
        assert zc.corrected_switch_offset(so, z, z_offset - more) < plain
        assert zc.corrected_switch_offset(so + more, z, z_offset) > plain


LAST = zc.Result(
    probe=8.75, switch=10.0, nozzle=2.0, switch_offset=0.5, offset=0.25
)


class TestExpect:
    @pytest.mark.parametrize(
        ("endstop", "last", "sure", "expected"),
        [
            (1.5, None, False, (1.5, False)),
            (1.5, None, True, (1.5, False)),
            (0.0, None, False, (0.0, False)),
            (1.5, LAST, False, (1.5, False)),  # homed there since
            (0.0, LAST, False, (0.0, False)),
            (1.5, LAST, True, (2.0, True)),
            (None, None, False, (None, False)),
            (None, LAST, False, (2.0, False)),  # better than nothing
            (None, LAST, True, (2.0, True)),
        ],
    )
    def test_nozzle(self, endstop, last, sure, expected):
        settings = make_settings(position_endstop=endstop)
        assert zc.expect_nozzle(settings, last, sure) == expected

    @pytest.mark.parametrize(
        ("z_offset", "last", "sure", "expected"),
        [
            (6.5, None, False, (7.0, False)),
            (6.5, None, True, (7.0, False)),
            (2.0, None, False, (2.5, False)),  # no smaller one is real
            (1.9999, None, False, (None, False)),
            (0.0, None, False, (None, False)),
            (-6.5, None, False, (None, False)),
            (6.5, LAST, False, (9.0, False)),
            (6.5, LAST, True, (9.0, True)),
            (0.0, LAST, True, (9.0, True)),
        ],
    )
    def test_switch(self, z_offset, last, sure, expected):
        settings = make_settings(z_offset=z_offset, switch_offset=0.5)
        assert zc.expect_switch(settings, 1.0, last, sure) == expected

    @pytest.mark.parametrize(
        ("last", "expected"), [(None, (7.5, False)), (LAST, (7.75, False))]
    )
    def test_bed(self, last, expected):
        settings = make_settings(switch_offset=0.5)
        assert zc.expect_bed(settings, 2.0, 9.0, last) == expected

    @given(machines, st.booleans())
    def test_a_machine_that_stays_triggers_just_there(self, machine, sure):
        settings, last = settings_of(machine), machine.result()
        assert zc.expect_nozzle(settings, last, sure).z == machine.pin
        switch = zc.expect_switch(settings, machine.pin, last, sure)
        assert switch == (machine.switch_trigger, sure)
        bed = zc.expect_bed(settings, machine.pin, machine.switch_trigger, last)
        assert bed.z == machine.bed_trigger

    @given(machines, shifts)
    def test_the_switch_follows_the_nozzle(self, machine, shift):
        now = machine.shifted(shift)
        expected = zc.expect_switch(
            settings_of(now), now.pin, machine.result(), False
        )
        assert expected.z == now.switch_trigger

    @given(machines)
    def test_a_right_z_offset_tells_the_switch(self, machine):
        assume(machine.body + machine.travel >= 2.0)
        settings = settings_of(machine, z_offset=machine.body + machine.travel)
        expected = zc.expect_switch(settings, machine.pin, None, False)
        assert expected == (machine.switch_trigger, False)

    @given(heights, heights, travels, st.none() | results)
    def test_the_bed_is_where_the_offset_would_be_as_before(
        self, nozzle, switch, switch_offset, last
    ):
        settings = make_settings(switch_offset=switch_offset)
        z = zc.expect_bed(settings, nozzle, switch, last).z
        found = zc.offset(z, switch, nozzle, switch_offset)
        assert found == (last.offset if last else 0.0)


class TestFloors:
    @pytest.mark.parametrize(
        ("endstop", "margins", "travel_margin", "position_min", "floor"),
        [
            (0.0, (-1.0, 1.0), 1.0, -5.0, -1.0),
            (2.25, (-1.0, 1.0), 1.0, -5.0, 1.25),
            (0.0, (-3.0, 1.0), 1.0, -5.0, -3.0),  # what the margins allow
            (0.0, (-0.25, 3.0), 1.0, -5.0, -1.0),  # the travel margin is larger
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
        for expected in (endstop, False), (4.0, False), (4.0, True):
            found = zc.nozzle_floor(settings, zc.Expected(*expected))
            assert found == floor

    @pytest.mark.parametrize(
        ("expected", "position_min", "floor"),
        [
            ((None, False), -5.0, -5.0),
            ((2.0, False), -5.0, -1.0),  # homed again: within the margins
            ((2.0, True), -5.0, -1.0),
            ((0.0, True), -5.0, -3.0),
            ((2.0, True), 1.75, 1.75),
        ],
    )
    def test_nozzle_on_a_separate_pin(self, expected, position_min, floor):
        settings = make_settings(
            position_endstop=None,
            offset_margins=(-3.0, 3.0),
            travel_margin=0.5,
            position_min=position_min,
        )
        found = zc.nozzle_floor(settings, zc.Expected(*expected))
        assert found == floor

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
    @pytest.mark.parametrize("sure", [False, True])
    def test_switch(self, nozzle, expected, position_min, floor, sure):
        settings = make_settings(travel_margin=0.5, position_min=position_min)
        found = zc.switch_floor(settings, nozzle, zc.Expected(expected, sure))
        assert found == floor

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
        moved = plain._replace(position_endstop=endstop + shift)
        for sure in (False, True):
            here = zc.Expected(switch, sure)
            there = zc.Expected(switch + shift, sure)
            assert zc.nozzle_floor(moved, there) == (
                zc.nozzle_floor(plain, here) + shift
            )
            assert zc.switch_floor(moved, nozzle + shift, there) == (
                zc.switch_floor(plain, nozzle, here) + shift
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
        body = zc.expect_switch(settings, pin, None, False)
        assert zc.switch_floor(settings, pin, body) < switch
        assert zc.bed_floor(settings, pin, switch) < machine.bed_trigger

    @given(machines, st.booleans(), exact(-1 + STEP, 1 - STEP), st.booleans())
    def test_it_does_so_again_after_a_run(self, machine, sure, shift, own_pin):
        last, now = machine.result(), machine
        if not sure:
            # Homed again: to where position_endstop says the pin is
            now = machine.shifted(shift)
            assume(-1.0 < now.bed < 1.0)
        settings = settings_of(now)
        if own_pin:
            settings = settings._replace(position_endstop=None)
        pin, switch = now.pin, now.switch_trigger
        nozzle = zc.expect_nozzle(settings, last, sure)
        assert zc.nozzle_floor(settings, nozzle) < pin
        body = zc.expect_switch(settings, pin, last, sure)
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

    @given(machines, st.booleans())
    def test_a_dead_switch_is_pressed_no_more_than_the_margin(
        self, machine, sure
    ):
        settings = settings_of(machine, travel_margin=0.5)
        expected = zc.expect_switch(
            settings, machine.pin, machine.result(), sure
        )
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
        zc.check_offset(zc.Result(0, 0, 0, 0, at_floor), margins)


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
        wider = plain._replace(offset_margins=(low, high + more))
        above = zc.travel_height_to_bed(plain, nozzle, switch)
        assert zc.travel_height_to_bed(wider, nozzle, switch) >= above
        # How deep the bed may lie is nothing to a travel
        deeper = plain._replace(offset_margins=(low - more, high))
        assert zc.travel_height_to_bed(deeper, nozzle, switch) == above

    @given(heights, exact(0, 50), distances)
    def test_more_below_the_nozzle_is_never_a_lower_travel(
        self, pin, body, more
    ):
        settings = make_settings()
        plain = zc.travel_height(settings, pin, body)
        assert zc.travel_height(settings, pin + more, body) >= plain
        assert zc.travel_height(settings, pin, body + more) >= plain


# No two values alike, none as the pin has it
PROBE = zc.Sampling(
    samples=5,
    tolerance=0.1,
    retries=2,
    result="average",
    speed=7.0,
    retract_dist=8.0,
    lift_speed=9.0,
)


class TestComplete:
    def complete(self, settings, z_offset=6.5):
        open_ends = settings._replace(
            probe=None, z_offset=None, position_max=None
        )
        return zc.complete(open_ends, PROBE, z_offset, 250.0)

    def test_what_is_set_stays(self):
        chosen = make_settings(safe_z_height=4.0)
        assert self.complete(chosen) == chosen._replace(
            probe=PROBE, z_offset=6.5, position_max=250.0
        )

    @pytest.mark.parametrize("name", zc.Sampling._fields)
    def test_the_probe_fills_what_is_open_and_only_that(self, name):
        settings = make_settings(pin=make_sampling(**{name: None}))
        filled = make_sampling(**{name: getattr(PROBE, name)})
        assert self.complete(settings).pin == filled

    def test_the_probe_may_fill_everything(self):
        nothing = zc.Sampling(*[None] * len(zc.Sampling._fields))
        assert self.complete(make_settings(pin=nothing)).pin == PROBE

    @pytest.mark.parametrize("name", ["tolerance", "retries"])
    def test_zero_is_a_setting(self, name):
        pin = make_sampling(**{name: 0})
        assert self.complete(make_settings(pin=pin)).pin == pin

    @pytest.mark.parametrize(
        ("safe_z", "z_offset", "completed"),
        [
            (None, 6.5, 13.0),
            (None, 1.0, 20.0),
            (0.5, 6.5, 0.5),
            (4.0, 9.0, 4.0),
        ],
    )
    def test_the_travel_height(self, safe_z, z_offset, completed):
        settings = make_settings(safe_z_height=safe_z)
        found = self.complete(settings, z_offset)
        assert (found.safe_z_height, found.z_offset) == (completed, z_offset)


PLAIN_COMMANDS = (
    *("G0", "G1", "G4", "G90", "G91", "G92"),
    *("M117", "M118", "M204", "M400"),
)
OTHER_COMMANDS = [
    *("ATTACH_PROBE", "G28", "G10", "G1.1", "G920", "M40", "M4000", "M280 P0"),
    *(
        "SERVO S=1",
        "SET_GCODE_OFFSET Z=0",
        "{% if x %} M401",
        "_G1",
        "N1 G1",
        "GO",
    ),
]
plain_lines = st.lists(
    st.sampled_from(
        ["G1 X10 Y20 F6000", "g0 x1", "G1X10", "G90", "M400", "", "  "]
        + ["; ATTACH_PROBE", "  ;", "M204 S500", "G1 X1 ; ATTACH_PROBE"]
    )
)


class TestAttachesProbe:
    @pytest.mark.parametrize("command", PLAIN_COMMANDS)
    @pytest.mark.parametrize(
        "text",
        [
            "%s",
            "%s X1 Y2",
            "\n  %s  \n",
            "%s\n%s",
            "%sX10Y20",
            "%s\tX1",
            "%s;X",
        ],
    )
    def test_moves_do_not(self, command, text):
        before = text.replace("%s", command)
        assert zc.attaches_probe(before, "") is False
        assert zc.attaches_probe(before.lower(), "ATTACH_PROBE") is False

    @pytest.mark.parametrize(
        "before", ["", " ", "\n \n", "M400", "M117 Switch", "m117 ATTACH_PROBE"]
    )
    def test_neither_does_what_only_waits_or_shows(self, before):
        assert zc.attaches_probe(before, "") is False

    @pytest.mark.parametrize(
        "before",
        [
            ";",
            "; ATTACH_PROBE",
            "  ;; ATTACH_PROBE\n\n",
            "G1 X1 ; ATTACH_PROBE",
        ],
    )
    def test_neither_does_a_comment(self, before):
        assert zc.attaches_probe(before, "") is False

    @pytest.mark.parametrize("other", OTHER_COMMANDS)
    @pytest.mark.parametrize(
        "text", ["%s", "\n%s\n", "G1 X1\n%s", "%s\nG1 X1", "%s ; G1 X1"]
    )
    def test_anything_else_does(self, other, text):
        before = text.replace("%s", other)
        for start in ("", "G28", "G28\n" + before):
            assert zc.attaches_probe(before, start) is (
                before.strip() != start.strip()
            )

    @pytest.mark.parametrize(
        "start", ["ATTACH_PROBE", "\nATTACH_PROBE", " ATTACH_PROBE \n"]
    )
    def test_start_gcode_has_done_it_already(self, start):
        assert zc.attaches_probe("ATTACH_PROBE", start) is False
        assert zc.attaches_probe("\n  ATTACH_PROBE\n", start) is False

    @given(plain_lines, plain_lines, st.sampled_from(OTHER_COMMANDS))
    def test_one_command_among_moves_is_enough(self, lines, more, other):
        moves = "\n".join(lines + more)
        assert zc.attaches_probe(moves, other) is False
        assert zc.attaches_probe("\n".join([*lines, other, *more]), "") is True


class TestAsParam:
    @pytest.mark.parametrize(
        ("value", "text"),
        [
            ("", ""),
            ("probe lost", "probe lost"),
            ("  two\n lines\t ", "two lines"),
            ('Unknown command:"X"', "Unknown command:'X'"),
            ("first; second", "first, second"),
            ("extruder #1", "extruder 1"),
            ("it's 5.5 mm (100%)", "it's 5.5 mm (100%)"),
            (zc.CalibrationError("no probe; look"), "no probe, look"),
            (0.25, "0.25"),
        ],
    )
    def test_table(self, value, text):
        assert zc.as_param(value) == text

    # A backslash is nothing that messages have
    @given(
        st.lists(
            st.characters(
                codec="ascii",
                exclude_characters="\\",
                exclude_categories=["Cc"],
            )
            | st.sampled_from(";#\"'\n\r\t ")
        ).map("".join)
    )
    def test_can_stand_in_a_quoted_string(self, value):
        text = zc.as_param(value)
        # As hosts take a line apart: a comment, then the parameters
        line = f'MSG="{text}"'.split(";")[0]
        lexer = shlex.shlex(line, posix=True)
        lexer.whitespace_split = True
        lexer.commenters = "#;"
        assert list(lexer) == [f"MSG={text}"]
        assert "\n" not in text
        assert "\r" not in text


def test_a_touch_without_a_trigger_is_an_error_of_the_calibration():
    assert issubclass(zc.NoTrigger, zc.CalibrationError)


def test_no_state_at_module_level():
    mutable = [
        name
        for name, value in vars(zc).items()
        if not name.startswith("__") and isinstance(value, (list, dict, set))
    ]
    assert mutable == []
