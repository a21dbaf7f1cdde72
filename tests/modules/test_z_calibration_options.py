"""Every option of [z_calibration]: that it does something, and what."""

from __future__ import annotations

import functools
import math
import re
from contextlib import ExitStack
from dataclasses import replace

import pytest

from tests.hostkit.printer import Printer
from tests.hostkit.z_calibration import (
    BED,
    BODY,
    MICROSTEP,
    PIN,
    SWITCH_OFFSET,
    TRIGGER,
    assert_unharmed,
    calibration,
    marked,
    refusal,
    section,
    touched_sites,
    with_moves,
)
from tests.simprinter import SCENES, Fault

pytestmark = pytest.mark.spread


@pytest.fixture
def start(some_host):
    """start() of all tests, on one host a test: there are many tables here."""
    with ExitStack() as stack:
        yield lambda *args, **options: stack.enter_context(
            Printer(some_host, *args, **options)
        )


# Of the voron scene, but the nozzle's, on which Z is homed
PLACES = ([208.0, 281.25], [208.5, 281.25], [152.0, 125.25])


def travel_heights(printer):
    """The heights (mm) at which the module moved the head in XY, homed."""
    ends = printer.status("moves")["ends"]
    travels = [
        there for here, there in zip(ends, ends[1:]) if here[:2] != there[:2]
    ]
    # Homing moves the head to the pin, too
    return [end[2] for end in travels if end[:2] in PLACES]


# Places


def test_nozzle_position_falls_back_to_safe_z_home(start):
    changes = {
        "safe_z_home": {"home_xy_position": "205.5, 306.5"},
        **section(nozzle_xy_position=None),
    }
    printer = start(changes=changes).homed()
    before = len(printer.machine.truth.touches)
    calibration(printer)
    touch = printer.machine.truth.touches[before]
    assert touch.site == "nozzle_pin"
    assert (touch.x, touch.y) == pytest.approx((205.5, 306.5), abs=0.02)


def test_safe_z_home_out_of_reach_is_named(host):
    changes = {
        "safe_z_home": {"home_xy_position": "206, 311"},
        **section(nozzle_xy_position=None),
    }
    message = refusal(host, changes)
    assert "Option 'home_xy_position: 206,311' in section 'safe_z_home'" in (
        message
    )


def test_switch_offsets_are_relative_to_the_nozzle(start):
    changes = section(
        nozzle_xy_position="205.5, 306",
        switch_xy_position=None,
        switch_xy_offsets="2, -24.75",
    )
    printer = start(changes=changes).homed()
    calibration(printer)
    touches = printer.machine.truth.touches
    (place,) = {(t.x, t.y) for t in touches if t.site == "body_pin"}
    assert place == pytest.approx((207.5, 281.25), abs=0.02)
    # A nozzle that comes with the command takes the switch along
    before = len(touches)
    calibration(printer, "CALIBRATE_Z NOZZLE_POSITION=206.25,306.25")
    touches = printer.machine.truth.touches[before:]
    (place,) = {(t.x, t.y) for t in touches if t.site == "body_pin"}
    assert place == pytest.approx((208.25, 281.5), abs=0.02)


def test_a_switch_position_comes_before_offsets(start):
    changes = section(switch_xy_offsets="3, -20")
    printer = start(changes=changes).homed()
    calibration(printer)
    touches = printer.machine.truth.touches
    (place,) = {(t.x, t.y) for t in touches if t.site == "body_pin"}
    assert place == pytest.approx((208, 281.25), abs=0.02)


@pytest.mark.parametrize(
    ("bed", "distance"), [("206, 306", "0.0 mm"), ("211, 301.5", "6.7 mm")]
)
def test_bed_that_is_on_the_endstop(host, bed, distance):
    # The head is at 208, 281.25 for the switch
    message = refusal(host, section(bed_xy_position=bed))
    place = f"Option 'bed_xy_position: {bed.replace(' ', '')}' in section"
    assert message.startswith(f"{place} 'z_calibration' puts the head")
    assert f"{distance} from where it touches the switch" in message
    assert "at least 7 mm away" in message


def test_bed_beside_the_endstop(start):
    printer = start(changes=section(bed_xy_position="211, 301")).homed()
    at = printer.session.position()
    # Both places may come with the command
    for params in ("BED_POSITION=206,306", "SWITCH_POSITION=213,276.25"):
        message = printer.fail(f"CALIBRATE_Z {params}")
        assert "from where it touches the switch" in message
        assert printer.session.position() == at


@pytest.mark.parametrize(
    ("offsets", "words"),
    [
        ("208, 281.25", "208 mm in X is no distance from the nozzle"),
        ("2, -101", "-101 mm in Y is no distance"),
        ("95, -24.75", "needs the head at X=301.000"),
        ("2, 4.5", "needs the head at Y=310.500"),
    ],
)
def test_switch_offsets_that_are_a_position(host, offsets, words):
    changes = section(switch_xy_position=None, switch_xy_offsets=offsets)
    message = refusal(host, changes)
    assert words in message
    assert "Option 'switch_xy_offsets" in message
    assert "section 'z_calibration'" in message


def mesh(**options):
    """A bed mesh over the middle of the voron's bed."""
    return {
        "bed_mesh": {
            "mesh_min": "40, 40",
            "mesh_max": "240, 240",
            "probe_count": "3, 3",
            **options,
        }
    }


def bed_place(printer, start=0):
    """Where the bed was touched."""
    touches = printer.machine.truth.touches[start:]
    (place,) = {(t.x, t.y) for t in touches if t.site == "probe_bed"}
    # The probe's place, not the head's
    return place[0] - 2.0, place[1] + 24.75


@pytest.mark.parametrize(
    ("option", "value", "point"),
    [
        ("zero_reference_position", "120, 130", (120, 130)),
        # Rows of the mesh go there and back: the sixth is the middle's end
        pytest.param(
            *("relative_reference_index", "5", (40, 140)),
            marks=pytest.mark.each_host,
        ),
    ],
)
def test_bed_position_falls_back_to_the_mesh(host, option, value, point):
    changes = {**section(bed_xy_position=None), **mesh(**{option: value})}
    with Printer(host, changes=changes) as printer:
        state, message = printer.session.start()
        if state != "ready":
            assert f"'{option}' is not valid in section 'bed_mesh'" in message
            pytest.skip(f"{host.name}: {message.splitlines()[0]}")
        calibration(printer.homed())
        assert bed_place(printer) == pytest.approx(point, abs=0.05)
        assert printer.gap(point) == pytest.approx(0.06, abs=0.005)


def test_the_meshs_point_is_read_at_every_run(host, tmp_path):
    source = tmp_path / "adapt.py"
    source.write_text(
        "def load_config(config):\n"
        "    printer = config.get_printer()\n"
        "    def cmd(gcmd):\n"
        "        bmc = printer.lookup_object('bed_mesh').bmc\n"
        "        owner = getattr(bmc, 'probe_mgr', bmc)\n"
        "        owner.zero_ref_pos = (100.0, 110.0)\n"
        "    gcode = printer.lookup_object('gcode')\n"
        "    gcode.register_command('ADAPT', cmd)\n"
    )
    changes = {
        **section(bed_xy_position=None),
        **mesh(zero_reference_position="120, 130"),
        "adapt": {},
    }
    modules = {**with_moves(), "adapt": source}
    with Printer(host, changes=changes, modules=modules) as printer:
        printer.homed()
        calibration(printer)
        assert bed_place(printer) == pytest.approx((120, 130), abs=0.05)
        before = len(printer.machine.truth.touches)
        printer.run("ADAPT")
        calibration(printer)
        assert bed_place(printer, before) == pytest.approx((100, 110), abs=0.05)


@pytest.mark.parametrize(
    ("bed", "zero", "is_told"),
    [
        ("150, 150", "120, 130", True),
        ("150, 150", "150, 151.1", True),
        ("150, 150", "150.6, 150.7", False),
        ("150, 150", None, False),
        (None, "120, 130", False),
    ],
)
def test_bed_position_away_from_the_meshs_zero_is_told(
    start, bed, zero, is_told
):
    options = {} if zero is None else {"zero_reference_position": zero}
    changes = {**section(bed_xy_position=bed), **mesh(**options)}
    printer = start(changes=changes).homed()
    text = "z_calibration: bed_xy_position (150.000, 150.000) is not where"
    told = [line for line in printer.session.console if text in line]
    assert len(told) == is_told
    x, y = (float(part) for part in (zero or "0, 0").split(","))
    assert all(f"zero ({x:.3f}, {y:.3f})" in line for line in told)


def test_mesh_point_out_of_reach_is_named(host):
    changes = {
        **section(bed_xy_position=None),
        **mesh(zero_reference_position="120, 20"),
    }
    message = refusal(host, changes)
    assert "zero reference position of section 'bed_mesh'" in message
    assert "Y=-4.750" in message


def test_nozzle_is_wiggled_after_every_touch(start):
    changes = {"moves": {}, **section(wiggle_xy_offsets="1.5, -2")}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    ends = printer.status("moves")["ends"]
    aside = [i for i, end in enumerate(ends) if end[:2] == [207.5, 304.0]]
    assert len(aside) == 3
    for i in aside:
        # After lifting by the retract, and back again
        assert ends[i][2] == pytest.approx(PIN + 3.0, abs=0.01)
        assert ends[i + 1] == pytest.approx([206.0, 306.0, ends[i][2]])


def test_no_wiggle_is_no_move(start):
    changes = {"moves": {}, **section(wiggle_xy_offsets="0,0")}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    plain = {tuple(end[:2]) for end in printer.status("moves")["ends"]}
    assert plain - {(0.0, 0.0)} == {
        (206.0, 306.0),
        (208.0, 281.25),
        (152.0, 125.25),
    }


def test_wiggle_out_of_reach(host):
    message = refusal(host, section(wiggle_xy_offsets="0, 4.5"))
    assert "Option 'wiggle_xy_offsets' in section 'z_calibration'" in message
    assert "Y=310.500" in message


# Margins, heights, floors


@pytest.mark.parametrize(
    ("margins", "accepted"),
    [
        ("-0.5,0.2", True),
        ("0.2", True),
        ("-0.5,0.1", False),
        ("0.1", False),
    ],
)
def test_offset_margins(start, margins, accepted):
    # The offset is 0.16
    printer = start(changes=section(offset_margins=margins)).homed()
    if accepted:
        calibration(printer)
        return
    low = "-0.500" if "," in margins else "-0.100"
    text = printer.fail("CALIBRATE_Z")
    assert f"offset 0.160 is outside offset_margins {low} to 0.100" in text
    assert "(probe=7.015 switch=8.015 nozzle=1.600)" in text
    assert_unharmed(printer)


@pytest.mark.parametrize(
    ("options", "height"),
    [
        ({}, 13.8),
        ({"safe_z_height": "25"}, 25.0),
        # Enough for a probe that nobody has measured yet: 10 mm over the pin
        ({"safe_z_height": "6"}, PIN + 10.0 + 1.0),
        ({"safe_z_height": "6", "travel_margin": "2"}, PIN + 10.0 + 2.0),
    ],
)
def test_travel_height_over_the_pin(start, options, height):
    changes = {"moves": {}, **section(**options)}
    printer = start(changes=changes, modules=with_moves()).homed()
    printer.run("G1 Z4 F600")
    calibration(printer)
    assert travel_heights(printer)[0] == pytest.approx(height, abs=0.01)
    assert printer.machine.truth.drag("body_pin") == 0.0


def test_travel_height_follows_what_was_measured(start):
    changes = {"moves": {}, **section(safe_z_height="6")}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    # To the bed: over the pin with the free plunger, and over the bed
    clear = BODY + SWITCH_OFFSET + 1.0 + 1.0
    expected = max(PIN, 1.0) + clear
    assert travel_heights(printer)[-1] == pytest.approx(expected, abs=0.01)
    printer.run("G1 X206 Y306 F6000\nG1 Z4 F600")
    calibration(printer)
    known = travel_heights(printer)[-2]
    assert known == pytest.approx(PIN + clear, abs=0.01)


def test_travel_height_is_cautious_again_after_homing(start):
    # The probe may have been exchanged
    changes = {"moves": {}, **section(safe_z_height="6")}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    calibration(printer, "G28 Z\nCALIBRATE_Z")
    assert travel_heights(printer)[-2] == pytest.approx(PIN + 11.0, abs=0.01)


def test_travel_height_clears_a_bed_as_high_as_the_margin(start):
    changes = {"moves": {}, **section(safe_z_height="6", offset_margins="5")}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    expected = 5.0 + BODY + SWITCH_OFFSET + 1.0 + 1.0
    assert travel_heights(printer)[-1] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("z_offset", ["0", "-1.1", "1.49", "2.0", "4.0"])
def test_wrong_z_offset_drags_nothing(start, z_offset):
    changes = {"moves": {}, "probe": {"z_offset": z_offset}}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)
    truth = printer.machine.truth
    assert truth.drag("body_pin") == truth.drag("probe_bed") == 0.0
    low = PIN + 11.0
    high = 20.0 if 2 * float(z_offset) < 3.0 else low
    assert max(travel_heights(printer)[:2]) == pytest.approx(high, abs=0.01)


@pytest.mark.parametrize(
    ("options", "floor"),
    [
        ({}, PIN - 1.0),
        ({"travel_margin": "0.5"}, PIN - 1.0),
        ({"travel_margin": "0.5", "offset_margins": "-0.3,0.3"}, PIN - 0.5),
        ({"offset_margins": "-0.3,0.3"}, PIN - 1.0),
        ({"travel_margin": "1.5"}, PIN - 1.5),
        ({"offset_margins": "-2,2"}, PIN - 2.0),
        ({"position_min": "1.2", "offset_margins": "-2,2"}, 1.2),
        # What the axis allows stays the last word
        ({"position_min": "-8", "offset_margins": "-9,9"}, -5.0),
    ],
)
def test_floor_of_the_nozzle(start, options, floor):
    fault = Fault("trigger_never", signal="z_endstop", n=4)
    printer = start(changes=section(**options), faults=[fault])
    printer.machine.tolerate("nozzle_pin", PIN - floor + MICROSTEP)
    text = printer.homed().fail("CALIBRATE_Z")
    assert f"(stopped at z={floor:.3f})" in text


@pytest.mark.parametrize(
    ("options", "floor"),
    [
        # From a z_offset of 6.9
        ({}, PIN + 6.9 - SWITCH_OFFSET - 1.0),
        ({"travel_margin": "0.6"}, PIN + 6.9 - SWITCH_OFFSET - 0.6),
        ({"switch_offset": "0.9"}, PIN + 6.9 - 0.9 - 1.0),
    ],
)
def test_floor_of_the_switch(start, options, floor):
    faults = [Fault("trigger_never", signal="z_endstop", n=8)]
    printer = start(changes=section(**options), faults=faults)
    printer.machine.tolerate("body_pin", 1.42)
    printer.homed()
    # Where the bed says that there is room below, the touch is repeated
    again = floor > BED + TRIGGER + PIN - SWITCH_OFFSET - 1.0
    if again:
        calibration(printer)
    else:
        printer.fail("CALIBRATE_Z")
    console = "\n".join(printer.session.console)
    assert "switch: No trigger on probe after full movement" in console
    assert f"(stopped at z={floor:.3f}), expected" in console
    assert "looking at the bed how long the probe is" in console


@pytest.mark.parametrize(
    ("options", "below"),
    [({}, 1.0), ({"offset_margins": "-0.4,1"}, 0.4)],
)
@pytest.mark.parametrize("n", [2, 3, 4])
def test_floor_of_the_bed(start, options, below, n):
    faults = [Fault("trigger_never", signal="probe", n=n)]
    printer = start(changes=section(**options), faults=faults)
    printer.machine.tolerate("body_bed", 1.0)
    text = printer.homed().fail("CALIBRATE_Z")
    floor = BODY + SWITCH_OFFSET - below
    assert (
        f"bed: No trigger on probe after full movement (stopped at z={floor:.3f})"
        in text.replace("\n", " ")
    )
    assert "expected a trigger at z=6.855" in text
    assert printer.machine.truth.min_gap > 5.0
    assert_unharmed(printer)


def test_position_min_above_the_endstop(host):
    message = refusal(host, section(position_min="1.7"))
    assert "Option 'position_min' in section 'z_calibration'" in message
    assert "above position_endstop (1.600) of section 'stepper_z'" in message


def test_position_min_is_not_the_matter_where_the_probe_homes(host):
    changes = section(position_min="0.5", endstop_pin=None)
    message = refusal(host, changes, "separate_pin")
    assert "is the probe: z_calibration needs a Z endstop" in message


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (section(safe_z_height="281"), "lower safe_z_height"),
        ({"probe": {"z_offset": "141"}}, "set z_offset in section 'probe'"),
        (
            {"stepper_z": {"position_endstop": "271"}},
            "correct position_endstop there, z_offset in section 'probe'",
        ),
    ],
)
def test_travel_height_beyond_the_axis(host, changes, words):
    message = refusal(host, changes)
    assert words in message
    assert "position_max (280.000) of section 'stepper_z'" in message


# Sampling


def test_samples_are_for_the_pin_only(start):
    printer = start(changes=section(samples="2")).homed()
    _, sites = calibration(printer)
    assert sites == ["nozzle_pin"] * 2 + ["body_pin"] * 2 + ["probe_bed"] * 3


@pytest.mark.parametrize(
    ("options", "n", "fails"),
    [
        ({"samples_tolerance": "0.06"}, 5, False),
        ({"samples_tolerance_retries": "0"}, 5, True),
        ({"samples_tolerance": "0.06"}, 9, False),
        ({"samples_tolerance_retries": "0"}, 9, True),
    ],
)
def test_tolerance_and_retries(start, options, n, fails):
    # The probe has 0.01 mm and 3 retries
    faults = [Fault("trigger_early", signal="z_endstop", mm=0.05, n=n)]
    printer = start(changes=section(**options), faults=faults).homed()
    if fails:
        assert "samples differ by 0.05" in printer.fail("CALIBRATE_Z")
        assert_unharmed(printer)
        return
    lines = printer.run("CALIBRATE_Z")
    assert not any("trying again" in line for line in lines)
    assert printer.machine.faults.unfired() == []


@pytest.mark.parametrize(("result", "share"), [("median", 0), ("average", 1)])
def test_samples_result_is_for_the_pin(start, result, share):
    other = {"median": "average", "average": "median"}[result]
    changes = {
        "probe": {"samples_result": other},
        **section(samples_result=result, samples_tolerance="0.2"),
    }
    faults = [Fault("trigger_early", signal="z_endstop", mm=0.09, n=5)]
    printer = start(changes=changes, faults=faults).homed()
    (_, _, nozzle, _, _), _ = calibration(printer)
    assert nozzle == pytest.approx(PIN + share * 0.03, abs=2 * MICROSTEP)


@pytest.mark.parametrize(("result", "share"), [("median", 0), ("average", 1)])
def test_bed_is_summarized_as_the_probe_says(start, result, share):
    other = {"median": "average", "average": "median"}[result]
    changes = {
        "probe": {"samples_result": result, "samples_tolerance": "0.2"},
        **section(samples_result=other),
    }
    faults = [Fault("trigger_early", signal="probe", mm=0.09, n=3)]
    printer = start(changes=changes, faults=faults).homed()
    (probe, *_), _ = calibration(printer)
    expected = BED + TRIGGER + share * 0.03
    assert probe == pytest.approx(expected, abs=2 * MICROSTEP)


def spans(host, changes):
    """Seconds between the touches of a calibration, from its start on."""
    with Printer(host, changes=changes) as printer:
        printer.homed()
        printer.run("G1 Z20 F900\nM400")
        before = len(printer.machine.truth.touches)
        printer.run("CALIBRATE_Z")
        touches = printer.machine.truth.touches[before:]
        times = {}
        for touch in touches:
            times.setdefault(touch.site, []).append(touch.t)
    nozzle, switch, bed = (
        times[s] for s in ("nozzle_pin", "body_pin", "probe_bed")
    )
    return {
        "nozzle": nozzle[1] - nozzle[0],
        "switch": switch[1] - switch[0],
        "bed": bed[1] - bed[0],
        "nozzle to switch": switch[0] - nozzle[-1],
        "switch to bed": bed[0] - switch[-1],
    }


@functools.cache
def usual_spans(host):
    """The same without any change."""
    return spans(host, None)


@pytest.mark.parametrize(
    ("option", "value", "more"),
    [
        # 3 mm up at 10 and down at 3 mm/s, as it is without the option; the
        # bed is the probe's
        (
            "probing_second_speed",
            "1",
            {"nozzle": 3 / 1 - 3 / 3, "switch": 3 / 1 - 3 / 3, "bed": 0.0},
        ),
        (
            "probing_retract_dist",
            "5",
            {"nozzle": 2 / 10 + 2 / 3, "switch": 2 / 10 + 2 / 3, "bed": 0.0},
        ),
        (
            "lift_speed",
            "2",
            {"nozzle": 3 / 2 - 3 / 10, "switch": 3 / 2 - 3 / 10, "bed": 0.0},
        ),
        # Down from 13.8 to the retract over what is expected
        (
            "probing_speed",
            "2",
            {
                "nozzle to switch": (13.8 - (PIN + 6.9 - SWITCH_OFFSET + 3.0))
                * (1 / 2 - 1 / 8),
                "switch to bed": (13.8 - (BODY + SWITCH_OFFSET + 2.0))
                * (1 / 2 - 1 / 8),
            },
        ),
        (
            "speed",
            "20",
            {
                "switch to bed": math.hypot(208 - 152, 281.25 - 125.25)
                * (1 / 20 - 1 / 50)
            },
        ),
    ],
)
def test_speeds(some_host, option, value, more):
    usual = usual_spans(some_host)
    changed = spans(some_host, section(**{option: value}))
    found = {part: changed[part] - usual[part] for part in more}
    assert found == pytest.approx(more, abs=0.25)


def test_first_fast_touch_is_no_sample(start):
    # The first touch of each site is 0.2 mm off, and nobody minds
    faults = [
        Fault("trigger_early", signal=signal, mm=0.2, n=n)
        for signal, n in (("z_endstop", 3), ("z_endstop", 7), ("probe", 1))
    ]
    changes = section(probing_first_fast="true")
    printer = start(changes=changes, faults=faults).homed()
    (probe, switch, nozzle, _, _), sites = calibration(printer)
    assert printer.machine.faults.unfired() == []
    # They did not reach anything
    assert sites == ["nozzle_pin"] * 3 + ["body_pin"] * 3 + ["probe_bed"] * 3
    assert nozzle == pytest.approx(PIN, abs=MICROSTEP)
    assert switch == pytest.approx(PIN + BODY, abs=MICROSTEP)
    assert probe == pytest.approx(BED + TRIGGER, abs=MICROSTEP)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


def test_first_fast_touch_is_one_more(start):
    printer = start(changes=section(probing_first_fast="true")).homed()
    _, sites = calibration(printer)
    assert sites == ["nozzle_pin"] * 4 + ["body_pin"] * 4 + ["probe_bed"] * 4


def test_first_fast_touch_is_fast(some_host):
    # From the travel height down to the pin at 8 mm/s
    slow = spans(
        some_host, section(probing_first_fast="true", probing_speed="2")
    )
    fast = spans(some_host, section(probing_first_fast="true"))
    for part, way in (
        ("nozzle to switch", 13.8 - PIN - BODY),
        ("switch to bed", 13.8 - BED - TRIGGER),
    ):
        more = way * (1 / 2 - 1 / 8)
        assert slow[part] - fast[part] == pytest.approx(more, abs=0.25)


# What runs besides


def test_offset_gcode_gets_the_offset_instead(start):
    changes = {
        "respond": {},
        **section(offset_gcode="RESPOND MSG='it is {params.Z}, {rawparams}'"),
    }
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    lines = printer.run("CALIBRATE_Z")
    assert "echo: it is 0.160000, Z=0.160000" in lines
    assert printer.offset() == pytest.approx(0.3)
    status = printer.status("z_calibration")
    assert status["last_z_offset"] == pytest.approx(0.16, abs=0.001)


def test_offset_gcode_that_fails_voids_the_result(start):
    code = "SET_GCODE_OFFSET Z={params.Z}\n  FAILS"
    changes = marked("FAILS", FAILS="{ action_raise_error('no tool') }")
    changes.update(section(offset_gcode=code))
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    assert "no tool" in printer.fail("CALIBRATE_Z")
    assert printer.status("z_calibration")["last_query"] is False
    assert "was not applied" in "\n".join(printer.session.console)
    assert_unharmed(printer, 0.3)


def test_empty_offset_gcode_is_none(start):
    printer = start(changes=section(offset_gcode="", error_gcode="")).homed()
    result, _ = calibration(printer)
    assert printer.offset() == pytest.approx(result[-1], abs=1e-6)


def error_run(start, scene="voron", **options):
    """A run that fails at the nozzle; its error and the console."""
    fault = Fault("trigger_never", signal="z_endstop", n=4)
    changes = marked("LAST", "PANIC")
    changes["gcode_macro PANIC"]["gcode"] = (
        "\n  RESPOND MSG='panic {params.ERROR}'"
    )
    changes.update(section(end_gcode="LAST", **options))
    printer = start(scene, changes=changes, faults=[fault])
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.homed()
    before = len(printer.session.console)
    return printer, printer.fail("CALIBRATE_Z"), before


def test_error_gcode_is_told_of_the_error(start):
    code = 'RESPOND MSG="panic {params.ERROR}"'
    printer, text, before = error_run(start, error_gcode=code)
    lines = printer.session.console[before:]
    told = [line for line in lines if line.startswith("echo: panic ")]
    assert len(told) == 1
    assert "nozzle: No trigger on probe" in told[0]
    assert "nozzle: No trigger on probe" in text
    # After the probe was put away
    assert lines.index("echo: LAST") < lines.index(told[0])
    assert lines.count("echo: LAST") == 1
    assert_unharmed(printer)


def test_error_gcode_that_fails_hides_nothing(start):
    code = "{ action_raise_error('worse') }"
    printer, text, before = error_run(start, error_gcode=code)
    assert "nozzle: No trigger on probe" in text
    assert "worse" not in text
    lines = "\n".join(printer.session.console[before:])
    assert "error_gcode failed, too: " in lines
    assert "worse" in lines
    assert_unharmed(printer)


def test_error_gcode_runs_after_every_kind_of_failure(start):
    changes = {"respond": {}, **section(error_gcode="RESPOND MSG=panic")}
    printer = start(changes=changes)
    printer.session.require_ready()
    for script in (
        "CALIBRATE_Z",
        "G28\nCALIBRATE_Z BED_POSITION=1",
        "CALIBRATE_Z SWITCH_OFFSET=-1",
    ):
        before = len(printer.session.console)
        printer.fail(script)
        lines = printer.session.console[before:]
        assert lines.count("echo: panic") == 1, script
    before = len(printer.session.console)
    calibration(printer)
    assert "echo: panic" not in printer.session.console[before:]


def test_offset_is_put_back_when_user_gcode_has_changed_it(start):
    changes = section(
        start_gcode="SET_GCODE_OFFSET Z=0",
        end_gcode="SET_GCODE_OFFSET Z=0.9",
    )
    fault = Fault("trigger_never", signal="z_endstop", n=4)
    printer = start(changes=changes, faults=[fault])
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.homed()
    printer.run("SET_GCODE_OFFSET Z=0.25")
    printer.fail("CALIBRATE_Z")
    assert_unharmed(printer, 0.25)


# before_switch_gcode that attaches nothing


@pytest.mark.parametrize("code", ["G1 Z20", "G90\n  G0 Z20 F900\n  M400"])
def test_moves_before_the_switch_do_not_ask_for_an_absent_probe(start, code):
    changes = {"moves": {}, **section(before_switch_gcode=code)}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    # It ran: the switch is approached from that height
    assert 20.0 in [round(z, 2) for z in travel_heights(printer)]


def test_the_same_gcode_at_the_start_has_attached_it_already(start):
    changes = section(
        start_gcode="ATTACH_PROBE", before_switch_gcode="ATTACH_PROBE"
    )
    changes["gcode_macro ATTACH_PROBE"] = {"gcode": "\n  G4 P10"}
    calibration(start(changes=changes).homed())


# A pin of its own


def test_pin_of_its_own(start):
    printer = start("separate_pin").homed()
    calibration(printer)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)
    assert any("z_calibration:open" in e for e in printer.run("QUERY_ENDSTOPS"))


def test_pin_of_its_own_beside_a_z_endstop(start):
    # The same switch under two names, or one beside the other
    changes = section(endstop_pin="^PC2")
    printer = start(changes=changes).homed()
    result, _ = calibration(printer)
    assert result[2] == pytest.approx(PIN, abs=MICROSTEP)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)
    # Where Z is homed says nothing about another pin
    assert "HINT" not in "\n".join(printer.session.console)


@pytest.mark.parametrize(
    "pin", ["probe:z_virtual_endstop", "^!probe:z_virtual_endstop", " "]
)
def test_pin_that_no_nozzle_can_press(host, pin):
    message = refusal(host, section(endstop_pin=pin), "separate_pin")
    assert "Option 'endstop_pin: " in message
    assert "in section 'z_calibration'" in message
    assert "give the pin of that switch" in message


def test_pin_of_its_own_is_looked_for_down_to_position_min_once(start):
    # Nobody knows its height; after a good run it is known
    scene = SCENES["separate_pin"]
    fault = Fault("trigger_never", signal="nozzle_endstop", n=2)
    deep = replace(scene.world.pin, pin_travel=8.0)
    changes = {"stepper_z": {"position_min": "-2"}}
    printer = start(scene.with_world(pin=deep), changes, [fault])
    printer.machine.tolerate("nozzle_pin", 4.0)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "nozzle: " in text
    assert "(stopped at z=-2.000)" in text
    assert_unharmed(printer)


@pytest.mark.parametrize(
    ("between", "n"), [("", 9), ("G28\n", 9), ("M84\nG28\n", 9)]
)
def test_pin_of_its_own_is_known_after_a_good_run(start, between, n):
    # A good run: a way down (none is known), 3 + 3 samples with a way down
    # to the switch; then again
    fault = Fault("trigger_never", signal="nozzle_endstop", n=n + 1)
    printer = start("separate_pin", faults=[fault])
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.homed()
    result, _ = calibration(printer)
    text = printer.fail(between + "CALIBRATE_Z")
    assert f"(stopped at z={result[2] - 1.0:.3f})" in text
    assert "add ACCEPT_CHANGE=1 if the nozzle was exchanged" in text


def test_pin_of_its_own_that_stands_high_is_met_ready_to_stop(start):
    # Nobody knows its height, and the head comes from above
    scene = SCENES["separate_pin"]
    high = replace(scene.world.pin, z=15.4)
    printer = start(scene.with_world(pin=high)).homed()
    printer.run("G1 Z60 F900")
    before = len(printer.machine.truth.touches)
    printer.run("PROBE_Z_ACCURACY")
    assert {t.site for t in printer.machine.truth.touches[before:]} == {
        "nozzle_pin"
    }


@pytest.mark.parametrize("pin", ["^PC3", "!mcu:PC3"])
def test_pin_of_its_own_is_not_the_probes(host, pin):
    message = refusal(host, section(endstop_pin=pin), "separate_pin")
    assert f"Option 'endstop_pin: {pin}' in section 'z_calibration'" in message
    assert "is the pin of section 'probe'" in message


# Old names


OLD = {
    "nozzle_xy_position": None,
    "switch_xy_position": None,
    "bed_xy_position": None,
    "probe_nozzle_x": "205.5",
    "probe_nozzle_y": "306",
    "probe_switch_x": "208.5",
    "probe_switch_y": "281.25",
    "probe_bed_x": "110",
    "probe_bed_y": "90",
    "max_deviation": "0.2",
    "clearance": "16",
}


def test_old_names_work_and_are_told_once(start):
    changes = {"moves": {}, **section(**OLD)}
    printer = start(changes=changes, modules=with_moves()).homed()
    told = [
        e for e in printer.session.console if "// z_calibration: option" in e
    ]
    expected = [
        "'probe_nozzle_x' and 'probe_nozzle_y' are now"
        " 'nozzle_xy_position: 205.5,306'",
        "'probe_switch_x' and 'probe_switch_y' are now"
        " 'switch_xy_position: 208.5,281.25'",
        "'probe_bed_x' and 'probe_bed_y' are now 'bed_xy_position: 110,90'",
        "'max_deviation' is now called 'offset_margins'",
        "'clearance' is now called 'safe_z_height'",
    ]
    assert sorted(
        re.split("options? ", e, maxsplit=1)[1] for e in told
    ) == sorted(expected)
    calibration(printer)
    assert len(told) == len(
        [e for e in printer.session.console if "// z_calibration: option" in e]
    )
    touches = printer.machine.truth.touches
    for site, place in (
        ("body_pin", (208.5, 281.25)),
        ("probe_bed", (112.0, 65.25)),
    ):
        (at,) = {(t.x, t.y) for t in touches if t.site == site}
        assert at == pytest.approx(place, abs=0.02)
    assert 16.0 in [round(z, 2) for z in travel_heights(printer)]


def test_max_deviation_is_the_margin(start):
    changes = section(max_deviation="0.1")
    text = start(changes=changes).homed().fail("CALIBRATE_Z")
    assert "outside offset_margins -0.100 to 0.100" in text


def test_new_names_come_before_old_ones(start):
    changes = {
        "moves": {},
        **section(
            probe_nozzle_x="1",
            probe_nozzle_y="2",
            max_deviation="0.1",
            offset_margins="-1,1",
            clearance="30",
            safe_z_height="14",
        ),
    }
    printer = start(changes=changes, modules=with_moves()).homed()
    console = "\n".join(printer.session.console)
    for text in (
        "'probe_nozzle_x' and 'probe_nozzle_y' are ignored,"
        " 'nozzle_xy_position' is given",
        "'max_deviation' is ignored, 'offset_margins' is given",
        "'clearance' is ignored, 'safe_z_height' is given",
    ):
        assert text in console
    result, _ = calibration(printer)
    assert result[2] == pytest.approx(PIN, abs=MICROSTEP)
    assert max(travel_heights(printer)) == pytest.approx(14.0, abs=0.01)


def test_clearance_of_zero_was_no_clearance(start):
    changes = {"moves": {}, **section(clearance="0")}
    printer = start(changes=changes, modules=with_moves()).homed()
    calibration(printer)
    assert 13.8 in [round(z, 2) for z in travel_heights(printer)]


def test_half_of_an_old_position(host):
    changes = section(nozzle_xy_position=None, probe_nozzle_x="206")
    message = refusal(host, changes)
    assert "Option 'nozzle_xy_position' in section 'z_calibration'" in message
    assert "only one of 'probe_nozzle_x' and 'probe_nozzle_y'" in message


# Nonsense

NUMBERS = {
    "switch_offset": "mm",
    "travel_margin": "mm",
    "safe_z_height": "mm",
    "clearance": "mm",
    "speed": "mm/s",
    "probing_speed": "mm/s",
    "probing_second_speed": "mm/s",
    "lift_speed": "mm/s",
    "probing_retract_dist": "mm",
    "samples_tolerance": "mm",
    "position_min": "mm",
    "probe_bed_x": "mm",
    "max_deviation": "mm",
    "offset_margins": "mm",
    "samples": "a whole number of 1 or more",
    "samples_tolerance_retries": "a whole number of 0 or more",
    "nozzle_xy_position": "100,100",
    "switch_xy_position": "100,100",
    "switch_xy_offsets": "such as -2,-24.5",
    "bed_xy_position": "100,100",
    "wiggle_xy_offsets": "such as -2,-24.5",
    "samples_result": "median or average",
    "probing_first_fast": "true or false",
}
ZERO_IS_FINE = {
    "switch_offset",
    "clearance",
    "samples_tolerance",
    "samples_tolerance_retries",
    "position_min",
    "probe_bed_x",
    "probing_first_fast",
}
NEGATIVE_IS_FINE = {"position_min", "probe_bed_x"}


def nonsense():
    for option in NUMBERS:
        for value in ("", "much", "nan", "inf", "1,2,3"):
            yield option, value
        if option not in ZERO_IS_FINE:
            yield option, "0"
        if option not in NEGATIVE_IS_FINE:
            yield option, "-0.5"
    yield "offset_margins", "1,2"
    yield "offset_margins", "-2,-1"
    yield "offset_margins", "-0,0"
    yield "samples", "2.5"


@pytest.mark.half
@pytest.mark.parametrize(("option", "value"), list(nonsense()))
def test_nonsense_is_refused(some_host, option, value):
    changes = section(**{option: value})
    if option == "probe_bed_x":
        changes = section(
            bed_xy_position=None, probe_bed_x=value, probe_bed_y="150"
        )
    message = refusal(some_host, changes)
    assert f"Option '{option}' in section 'z_calibration': " in message
    assert NUMBERS[option] in message


def test_numbers_are_numbers_to_macros(start):
    changes = section(
        safe_z_height="15",
        speed="60",
        samples_tolerance="0.02",
        probing_first_fast="yes",
    )
    printer = start(changes=changes)
    printer.session.require_ready()
    settings = printer.status("configfile")["settings"]["z_calibration"]
    assert settings["safe_z_height"] == 15.0
    assert settings["speed"] == 60.0
    assert settings["samples_tolerance"] == 0.02
    assert settings["probing_first_fast"] is True


@pytest.mark.parametrize("code", ["offset_gcode", "error_gcode"])
def test_other_templates_with_a_syntax_error(host, code):
    assert f"'{code}'" in refusal(host, section(**{code: "{% if %}"})) or (
        re.search(
            f"z_calibration:{code}",
            refusal(host, section(**{code: "{% if %}"})),
        )
    )


def test_sites_do_not_depend_on_where_the_head_was(start):
    printer = start().homed()
    first, _ = calibration(printer)
    printer.run("G1 X10 Y10 Z60 F6000")
    before = len(printer.machine.truth.touches)
    second, _ = calibration(printer)
    assert second == pytest.approx(first, abs=MICROSTEP)
    assert touched_sites(printer, before) == touched_sites(printer)[-9:]
