"""Every option of [z_calibration]: that it does something, and what.

What options refuse besides is in test_wrong_values.py.
"""

from __future__ import annotations

import functools
import json
import math
import re
from dataclasses import replace

import pytest

from simprinter import Fault
from tools.kit.cases import slow
from tools.kit.load_errors import load
from tools.kit.printer import Printer
from tools.kit.runs import make_runs
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
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
    result_of,
    section,
    touched_sites,
    with_dead_pin,
    with_extra,
    with_moves,
)


@pytest.fixture
def watched(start):
    """A homed printer with these options, whose moves are recorded."""

    def begin(**options):
        changes = {"moves": {}, **section(**options)}
        return start(changes=changes, modules=with_moves()).homed()

    return begin


# Of the voron scene, but the nozzle's, on which Z is homed
PLACES = ([211.5, 281.25], [212.0, 281.25], [152.0, 125.25])


def travel_heights(printer):
    """The heights (mm) at which the module moved the toolhead in XY, homed."""
    ends = printer.status("moves")["ends"]
    travels = [
        there for here, there in zip(ends, ends[1:]) if here[:2] != there[:2]
    ]
    # Homing moves the toolhead to the pin, too
    return [end[2] for end in travels if end[:2] in PLACES]


def place_of(site, printer, start=0):
    """Where the only touches of a site were made (mm)."""
    touches = printer.machine.truth.touches[start:]
    (place,) = {(t.x, t.y) for t in touches if t.site == site}
    return pytest.approx(place, abs=0.05)


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


# Places


def test_nozzle_position_falls_back_to_safe_z_home(start):
    changes = {
        "safe_z_home": {"home_xy_position": "205.5, 306.5"},
        **section(nozzle_xy_position=None),
    }
    printer = start(changes=changes).homed()
    before = len(printer.machine.truth.touches)
    calibration(printer)
    assert place_of("nozzle_pin", printer, before) == (205.5, 306.5)


def test_switch_offsets_are_relative_to_the_nozzle(start):
    changes = section(
        nozzle_xy_position="205.5, 306",
        switch_xy_position=None,
        switch_xy_offsets="5.5, -24.75",
    )
    printer = start(changes=changes).homed()
    calibration(printer)
    assert place_of("body_pin", printer) == (211, 281.25)
    # A nozzle that comes with the command takes the switch along
    before = len(printer.machine.truth.touches)
    calibration(printer, "CALIBRATE_Z NOZZLE_POSITION=206.25,306.25")
    assert place_of("body_pin", printer, before) == (211.75, 281.5)


def test_a_switch_position_comes_before_offsets(start):
    changes = section(switch_xy_offsets="3, -20")
    printer = start(changes=changes).homed()
    calibration(printer)
    assert place_of("body_pin", printer) == (211.5, 281.25)


def test_bed_beside_the_endstop(start):
    printer = start(changes=section(bed_xy_position="214.5, 301")).homed()
    at = printer.session.position()
    # Both places may come with the command
    for params in ("BED_POSITION=209.5,306", "SWITCH_POSITION=216.5,276.25"):
        message = printer.fail(f"CALIBRATE_Z {params}")
        assert "from where it touches the switch" in message
        assert printer.session.position() == at


@pytest.mark.parametrize(
    ("option", "value", "point"),
    [
        ("zero_reference_position", "120, 130", (120, 130)),
        # Rows of the mesh go there and back: the sixth is the middle's end
        pytest.param(
            *("relative_reference_index", "5", (40, 140)),
            marks=pytest.mark.every_host("only hosts until 2023-06 have it"),
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
        # The probe's place, not the toolhead's
        head = (point[0] + 2.0, point[1] - 24.75)
        assert place_of("probe_bed", printer) == head
        assert printer.gap(point) == pytest.approx(0.06, abs=0.005)


@pytest.mark.slow
def test_the_meshs_point_is_read_at_every_run(host, tmp_path):
    code = """
def adapt(gcmd):
    bmc = printer.lookup_object("bed_mesh").bmc
    getattr(bmc, "probe_mgr", bmc).zero_ref_pos = (100.0, 110.0)
gcode.register_command("ADAPT", adapt)
"""
    changes = {
        **section(bed_xy_position=None),
        **mesh(zero_reference_position="120, 130"),
        "extra": {},
    }
    modules = with_extra(tmp_path, code)
    with Printer(host, changes=changes, modules=modules) as printer:
        calibration(printer.homed())
        assert place_of("probe_bed", printer) == (122, 105.25)
        before = len(printer.machine.truth.touches)
        calibration(printer, "ADAPT\nCALIBRATE_Z")
        assert place_of("probe_bed", printer, before) == (102, 85.25)


# A mesh as it is before June 2023, when it knew the index of a point only
OLD_MESH = """
class OldMesh(object):
    points = [(40.0, 50.0), (145.0, 50.0), (120.0, 140.0)]
    relative_reference_index = %s
def age():
    printer.lookup_object("bed_mesh").bmc = OldMesh()
printer.register_event_handler("klippy:ready", age)
"""


@pytest.mark.parametrize("index", [2, slow(3), None])
def test_the_meshs_point_on_an_old_host(start, tmp_path, index):
    modules = with_extra(tmp_path, OLD_MESH % (index,))
    changes = {**section(bed_xy_position=None), **mesh(), "extra": {}}
    printer = start(changes=changes, modules=modules).homed()
    if index == 2:
        calibration(printer)
        assert place_of("probe_bed", printer) == (122, 115.25)
        return
    message = printer.fail("CALIBRATE_Z")
    assert "or relative_reference_index in section 'bed_mesh'" in message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bed", "zero", "is_told"),
    [
        ("150, 150", "120, 130", True),
        ("150, 150", "150, 151.1", True),
        ("150, 150", "150.6, 150.7", False),
        ("150, 150", None, None),
        (None, "120, 130", False),
    ],
)
def test_bed_position_away_from_the_meshs_zero_is_told(
    start, bed, zero, is_told
):
    options = {} if zero is None else {"zero_reference_position": zero}
    changes = {**section(bed_xy_position=bed), **mesh(**options)}
    printer = start(changes=changes).homed()
    console = printer.session.console
    # Or there is no zero
    missing = "z_calibration: section 'bed_mesh' has no zero_reference_position"
    assert any(missing in line for line in console) is (is_told is None)
    text = "z_calibration: bed_xy_position (150.000, 150.000) is not where"
    told = [line for line in console if text in line]
    assert len(told) == bool(is_told)
    x, y = (float(part) for part in (zero or "0, 0").split(","))
    assert all(f"zero ({x:.3f}, {y:.3f})" in line for line in told)


def test_nozzle_is_wiggled_after_every_touch(watched):
    printer = watched(wiggle_xy_offsets="1.5, -2")
    calibration(printer)
    ends = printer.status("moves")["ends"]
    aside = [i for i, end in enumerate(ends) if end[:2] == [207.5, 304.0]]
    assert len(aside) == 3
    for i in aside:
        # After lifting by the retract, and back again
        assert ends[i][2] == pytest.approx(PIN + 3.0, abs=0.01)
        assert ends[i + 1] == pytest.approx([206.0, 306.0, ends[i][2]])


def test_no_wiggle_is_no_move(watched):
    printer = watched(wiggle_xy_offsets="0,0")
    calibration(printer)
    plain = {tuple(end[:2]) for end in printer.status("moves")["ends"]}
    assert plain - {(0.0, 0.0)} == {
        (206.0, 306.0),
        (211.5, 281.25),
        (152.0, 125.25),
    }


IN = " in section 'z_calibration'"
REACH = f"{IN} needs the toolhead at"
BEYOND = "must lie within position_max (280.000) of section 'stepper_z';"
# What klippy refuses, and with which words
REFUSED = {
    "nozzle out of reach": (
        section(nozzle_xy_position="301, 100"),
        [f"Option 'nozzle_xy_position: 301,100'{REACH} X=301.000, outside"],
    ),
    "switch out of reach": (
        section(switch_xy_position="100, -1"),
        [f"Option 'switch_xy_position: 100,-1'{REACH} Y=-1.000, outside"],
    ),
    # The probe hangs 24.75 mm behind the nozzle
    "bed out of reach": (
        section(bed_xy_position="150, 20"),
        [
            f"Option 'bed_xy_position: 150,20'{REACH} Y=-4.750, the probe's"
            " offset included, outside"
        ],
    ),
    "bed on the other side": (
        section(bed_xy_position="299, 150"),
        [f"'bed_xy_position: 299,150'{REACH} X=301.000"],
    ),
    "safe_z_home out of reach": (
        {
            "safe_z_home": {"home_xy_position": "206, 311"},
            **section(nozzle_xy_position=None),
        },
        ["Option 'home_xy_position: 206,311' in section 'safe_z_home'"],
    ),
    "mesh out of reach": (
        {
            **section(bed_xy_position=None),
            **mesh(zero_reference_position="120, 20"),
        },
        ["zero reference position of section 'bed_mesh'", "Y=-4.750"],
    ),
    "wiggle out of reach": (
        section(wiggle_xy_offsets="0, 4.5"),
        [f"Option 'wiggle_xy_offsets'{REACH} Y=310.500"],
    ),
    # The toolhead is at 211.5, 281.25 for the switch
    "bed on the endstop": (
        section(bed_xy_position="209.5, 306"),
        [
            f"Option 'bed_xy_position: 209.5,306'{IN} puts the toolhead 0.0 mm from"
        ],
    ),
    "bed near the endstop": (
        section(bed_xy_position="214.5, 301.5"),
        ["6.7 mm from where it touches the switch", "at least 7 mm away"],
    ),
    "position as offsets": (
        section(switch_xy_position=None, switch_xy_offsets="5.5, -101"),
        [f"'switch_xy_offsets'{IN}: -101 mm in Y is no distance from the"],
    ),
    "offset out of reach": (
        section(switch_xy_position=None, switch_xy_offsets="95, -24.75"),
        [f"Option 'switch_xy_offsets: 95,-24.75'{REACH} X=301.000"],
    ),
    "offset behind the axis": (
        section(switch_xy_position=None, switch_xy_offsets="2, 4.5"),
        [f"Option 'switch_xy_offsets: 2,4.5'{REACH} Y=310.500"],
    ),
    "position_min above the endstop": (
        section(position_min="1.7"),
        [
            f"Option 'position_min'{IN}: 1.700 leaves no touch the room",
            "position_endstop (1.600) of section 'stepper_z'",
        ],
    ),
    "travel too high": (
        section(safe_z_height="281"),
        [f"z_calibration, z=281.000, {BEYOND} correct safe_z_height in"],
    ),
    "clearance too large": (
        section(clearance="281"),
        [f"{BEYOND} correct clearance in"],
    ),
    # Twice the z_offset is no height to travel at
    "probe too long": (
        {"probe": {"z_offset": "141"}},
        [BEYOND, "z_offset in section 'probe', the real distance"],
    ),
    "pin too high": (
        {"stepper_z": {"position_endstop": "271"}},
        [f"{BEYOND} correct position_endstop there, travel_margin in"],
    ),
    "half of an old position": (
        section(nozzle_xy_position=None, probe_nozzle_x="206"),
        [
            f"Option 'nozzle_xy_position'{IN}",
            "only one of 'probe_nozzle_x' and 'probe_nozzle_y'",
        ],
    ),
}


@pytest.mark.parametrize(("changes", "words"), REFUSED.values(), ids=REFUSED)
def test_setting_that_is_refused(host, changes, words):
    message = refusal(host, changes)
    for text in words:
        assert text in message


@pytest.mark.parametrize("edge", ["300, 100", "100, 310", "0, 0"])
def test_point_on_the_edge_of_the_axes(host, edge):
    changes = section(nozzle_xy_position=edge, switch_xy_position=edge)
    state, message = load(host, changes)
    assert state == "ready", message


# Margins, heights, floors


def test_offset_margins(start):
    # The offset is 0.16
    printer = start(changes=section(offset_margins="-0.5,0.1")).homed()
    printer.run("SET_GCODE_OFFSET Z=0.1")
    text = printer.fail("CALIBRATE_Z")
    assert "offset 0.160 is outside offset_margins -0.500 to 0.100" in text
    assert "(probe=7.015 switch=8.015 nozzle=1.600); home Z again" in text
    assert_unharmed(printer, 0.1)


def test_margins_far_from_zero(start):
    # The pin is taken to stand 2.5 mm lower than it does
    changes = {
        "stepper_z": {"position_endstop": "-0.9"},
        **section(offset_margins="-2.75, -2.15"),
    }
    printer = start(changes=changes).homed()
    result, _ = calibration(printer)
    assert result[-1] == pytest.approx(0.16 - 2.5, abs=2 * MICROSTEP)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


@pytest.mark.parametrize(
    ("options", "height"),
    [
        ({}, 13.8),
        slow({"safe_z_height": "25"}, 25.0),
        # Enough for a probe that nobody has measured yet: 10 mm over the pin
        ({"safe_z_height": "6"}, PIN + 10.0 + 1.0),
        ({"safe_z_height": "6", "travel_margin": "2"}, PIN + 10.0 + 2.0),
    ],
)
def test_travel_height_over_the_pin(watched, options, height):
    printer = watched(**options)
    printer.run("G1 Z4 F600")
    calibration(printer)
    assert travel_heights(printer)[0] == pytest.approx(height, abs=0.01)
    assert printer.machine.truth.drag("body_pin") == 0.0


def test_travel_height_follows_what_was_measured(watched):
    printer = watched(safe_z_height="6")
    calibration(printer)
    # To the bed: over the pin with the free plunger, and over the bed
    clear = BODY + SWITCH_OFFSET + 1.0 + 1.0
    expected = max(PIN, 1.0) + clear
    assert travel_heights(printer)[-1] == pytest.approx(expected, abs=0.01)
    printer.run("G1 X206 Y306 F6000\nG1 Z4 F600")
    calibration(printer)
    known = travel_heights(printer)[-2]
    assert known == pytest.approx(PIN + clear, abs=0.01)
    # After homing the probe may have been exchanged
    calibration(printer, "G28 Z\nCALIBRATE_Z")
    assert travel_heights(printer)[-2] == pytest.approx(PIN + 11.0, abs=0.01)


def test_travel_height_clears_a_bed_as_high_as_the_margin(watched):
    printer = watched(safe_z_height="6", offset_margins="5")
    calibration(printer)
    expected = 5.0 + BODY + SWITCH_OFFSET + 1.0 + 1.0
    assert travel_heights(printer)[-1] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(
    "z_offset", ["0", slow("-1.1"), "1.49", "2.0", slow("4.0")]
)
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
        ({"travel_margin": "0.5", "offset_margins": "-0.3,0.3"}, PIN - 0.5),
        ({"travel_margin": "1.5"}, PIN - 1.5),
        # What the result may be is another question
        ({"offset_margins": "-2,2"}, PIN - 1.0),
        ({"position_min": "1.2"}, 1.2),
        # What the axis allows stays the last word
        ({"position_min": "-8", "travel_margin": "9"}, -5.0),
    ],
)
def test_floor_of_the_nozzle(start, options, floor):
    fault = Fault("trigger_never", site="nozzle_pin", command="CALIBRATE_Z")
    printer = start(changes=section(**options), faults=[fault])
    printer.machine.tolerate("nozzle_pin", PIN - floor + MICROSTEP)
    text = printer.homed().fail("CALIBRATE_Z")
    assert text.startswith("z_calibration: nozzle: the switch did not answer")
    assert f"(stopped at z={floor:.3f}), expected a trigger at z=1.600" in text
    is_early = "position_min" in options
    again = "home Z again (G28 Z) after any levelling, then check nozzle_xy"
    assert again in text
    assert (f"position_min ({floor:.3f}) of section" in text) == is_early
    assert_unharmed(printer)


def test_floor_without_position_min_is_zero(start):
    changes = {"stepper_z": {"position_min": None}}
    fault = Fault("trigger_never", site="nozzle_pin", command="CALIBRATE_Z")
    printer = start("cartesian", changes=changes, faults=[fault])
    printer.machine.tolerate("nozzle_pin", 0.5 + MICROSTEP)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "(stopped at z=0.000), expected a trigger at z=0.500" in text


@pytest.mark.parametrize(
    ("options", "floor"),
    [
        # From a z_offset of 6.9
        ({"travel_margin": "0.6"}, PIN + 6.9 - SWITCH_OFFSET - 0.6),
        ({"switch_offset": "0.9"}, PIN + 6.9 - 0.9 - 1.0),
    ],
)
def test_floor_of_the_switch(start, options, floor):
    faults = [Fault("trigger_never", site="body_pin", command="CALIBRATE_Z")]
    printer = start(changes=section(**options), faults=faults)
    printer.machine.tolerate("body_pin", 1.42)
    printer.homed()
    # Where the bed says that there is room below, the touch is repeated
    again = floor > BED + TRIGGER + PIN - SWITCH_OFFSET - 1.0
    if again:
        calibration(printer)
    else:
        assert "check switch_xy_position" in printer.fail("CALIBRATE_Z")
        assert_unharmed(printer)
    console = "\n".join(printer.session.console)
    assert "switch: the switch did not answer" in console
    assert f"(stopped at z={floor:.3f}), expected" in console
    assert "looking at the bed how long the probe is" in console


@pytest.mark.slow
@pytest.mark.parametrize("touch", [1, slow(2)])
def test_floor_of_the_bed(start, touch):
    about = {"site": "probe_bed", "touch": touch, "command": "CALIBRATE_Z"}
    faults = [Fault("trigger_never", **about)]
    changes = section(offset_margins="-0.4,1")
    printer = start(changes=changes, faults=faults)
    printer.machine.tolerate("body_bed", 1.0)
    text = printer.homed().fail("CALIBRATE_Z").replace("\n", " ")
    floor = BODY + SWITCH_OFFSET - 0.4
    stopped = f"after full movement (stopped at z={floor:.3f})"
    assert f"bed: No trigger on probe {stopped}" in text
    assert "expected a trigger at z=6.855" in text
    assert "bed_xy_position" in text
    assert printer.machine.truth.min_gap > 5.0
    assert_unharmed(printer)


# Sampling


def spans(host, changes, command="CALIBRATE_Z"):
    """Seconds between the touches of a calibration, from its start on."""
    with Printer(host, changes=changes) as printer:
        printer.homed()
        printer.run("G1 Z20 F900\nM400")
        before = len(printer.machine.truth.touches)
        printer.run(command)
        times = {}
        for touch in printer.machine.truth.touches[before:]:
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


def longer(pin, bed=0.0):
    """So much more (s) between two samples."""
    return {"nozzle": pin, "switch": pin, "bed": bed}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "more"),
    [
        # What the axis has is for the pin only
        (
            {"stepper_z": {"second_homing_speed": "0.5"}},
            longer(0.5 / 0.5 - 0.5 / 3),
        ),
        # Half the homing speed of 8 where there is no second one
        (
            {"stepper_z": {"second_homing_speed": None, "homing_speed": "1"}},
            longer(0.5 / 0.5 - 0.5 / 3),
        ),
        # Of homing, where the user says nothing of these touches
        ({"stepper_z": {"homing_retract_dist": "6"}}, longer(0.0)),
        # The larger of two
        ({"probe": {"lift_speed": "0.5"}}, longer(0.0)),
        (
            {
                "probe": {"lift_speed": "0.5"},
                "stepper_z": {"homing_speed": "0.5"},
            },
            longer(*[0.5 / 0.5 - 0.5 / 10] * 2),
        ),
        # Down from 13.8 to the retract over what is expected
        (
            section(probing_speed="2"),
            {
                "nozzle to switch": (13.8 - (PIN + 6.9 - SWITCH_OFFSET + 0.5))
                * (1 / 2 - 1 / 10),
                "switch to bed": (13.8 - (BODY + SWITCH_OFFSET + 0.5))
                * (1 / 2 - 1 / 10),
            },
        ),
        (
            section(speed="20"),
            {
                "switch to bed": math.hypot(211.5 - 152, 281.25 - 125.25)
                * (1 / 20 - 1 / 100)
            },
        ),
    ],
)
def test_speeds(host, changes, more):
    usual = usual_spans(host)
    changed = spans(host, changes)
    found = {part: changed[part] - usual[part] for part in more}
    assert found == pytest.approx(more, abs=0.25)


IDLE = "// z_calibration: SAMPLES_TOLERANCE is ignored with 'samples: auto'"


# Touches with samples: auto, where there is no history
AT_FIRST = 5


@pytest.mark.parametrize(
    ("samples", "params", "count"),
    [
        ("6", "SAMPLES=", 6),
        ("6", "SAMPLES=auto", AT_FIRST),
        slow("auto", "SAMPLES=2", 2),
        ("auto", "PROBE_SPEED=4", AT_FIRST),
    ],
)
def test_samples_of_one_command(start, samples, params, count):
    printer = start(changes=section(samples=samples)).homed()
    before = len(printer.machine.truth.touches)
    lines = printer.run(f"CALIBRATE_Z {params} SAMPLES_TOLERANCE=0.02")
    sites = touched_sites(printer, before)
    assert {site: sites.count(site) for site in sites} == {
        "nozzle_pin": count,
        "body_pin": count,
        "probe_bed": count,
    }
    assert (IDLE in lines) is (count == AT_FIRST)


def test_first_fast_touch_is_no_sample(start):
    # The first touch of each site is 0.2 mm off, and nobody minds
    faults = [
        Fault("trigger_early", site=site, command="CALIBRATE_Z", mm=0.2)
        for site in ("nozzle_pin", "body_pin", "probe_bed")
    ]
    changes = section(probing_first_fast="true")
    printer = start(changes=changes, faults=faults).homed()
    (probe, switch, nozzle, _, _), sites = calibration(printer)
    # They did not reach anything
    assert sites == ["nozzle_pin"] * 3 + ["body_pin"] * 3 + ["probe_bed"] * 3
    assert nozzle == pytest.approx(PIN, abs=MICROSTEP)
    assert switch == pytest.approx(PIN + BODY, abs=MICROSTEP)
    assert probe == pytest.approx(BED + TRIGGER, abs=MICROSTEP)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


def test_first_fast_touch_is_fast(host):
    # From the travel height down to the pin at 8 mm/s
    slow = spans(host, section(probing_first_fast="true", probing_speed="2"))
    fast = spans(host, section(probing_first_fast="true"))
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
        **section(
            offset_gcode="\n  RESPOND MSG='it is {params.Z}, {rawparams}'"
            "\n  Z_CALIBRATION_KEEP_OFFSET"
        ),
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


def test_empty_template_is_no_template(start):
    # This probe is attached all the time
    parts = ("start", "before_switch", "end", "offset", "error")
    changes = section(**{f"{part}_gcode": "" for part in parts})
    printer = start(changes=changes).homed()
    result, _ = calibration(printer)
    assert printer.offset() == pytest.approx(result[-1], abs=1e-6)


@pytest.mark.parametrize(
    ("code", "told"),
    [
        (
            'RESPOND MSG="panic {params.ERROR}"',
            "echo: panic nozzle: the switch did not answer",
        ),
        (
            "{ action_raise_error('worse') }",
            "after the error: error_gcode: ",
        ),
    ],
)
def test_error_gcode_is_told_of_the_error(start, code, told):
    changes = marked("LAST")
    changes.update(section(end_gcode="LAST", error_gcode=code))
    printer = with_dead_pin(start, changes=changes)
    before = len(printer.session.console)
    text = printer.fail("CALIBRATE_Z")
    assert "nozzle: the switch did not answer" in text
    assert "worse" not in text
    lines = printer.session.console[before:]
    (line,) = [line for line in lines if told in line]
    # After the probe was put away
    assert lines.index("echo: LAST") < lines.index(line)
    assert lines.count("echo: LAST") == 1
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


# before_switch_gcode that attaches nothing


def test_moves_before_the_switch_do_not_ask_for_an_absent_probe(start):
    gcode = "\n  G90\n  G0 Z20 F900\n  M400\n  AT"
    at = "RESPOND MSG='at {printer.toolhead.position.z}'"
    changes = {**marked("AT", AT=at), **section(before_switch_gcode=gcode)}
    lines = start(changes=changes).homed().run("CALIBRATE_Z")
    assert any("at 20.0" in line for line in lines)
    result_of(lines)


def test_the_same_gcode_at_the_start_has_attached_it_already(start):
    changes = section(
        start_gcode="ATTACH_PROBE", before_switch_gcode="Attach_Probe"
    )
    changes["gcode_macro Attach_Probe"] = {"gcode": "\n  G4 P10"}
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
    changes["duplicate_pin_override"] = {"pins": "PC2"}
    printer = start(changes=changes).homed()
    result, _ = calibration(printer)
    assert result[2] == pytest.approx(PIN, abs=MICROSTEP)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)
    # Where Z is homed says nothing about another pin
    assert "HINT" not in "\n".join(printer.session.console)


@pytest.mark.parametrize(
    ("pin", "words"),
    [
        ("^!probe:z_virtual_endstop", "is no pin"),
        ("^PC3", "is the pin of section 'probe'"),
        ("!mcu:PC3", "is the pin of section 'probe'"),
    ],
)
def test_pin_that_no_nozzle_can_press(host, pin, words):
    message = refusal(host, section(endstop_pin=pin), "separate_pin")
    option = f"Option 'endstop_pin: {pin.strip()}'{IN} {words}"
    assert message.startswith(option)
    assert "give the pin of the switch that the nozzle presses" in message


def test_position_min_is_not_the_matter_where_the_probe_homes(host):
    changes = section(position_min="0.5", endstop_pin=None)
    message = refusal(host, changes, "separate_pin")
    assert message.startswith(
        "Option 'endstop_pin: probe:z_virtual_endstop' in section 'stepper_z'"
        " is the probe: z_calibration needs a Z endstop that the nozzle can press;"
        " set it to the pin of that switch, or give the pin as endstop_pin"
    )


def proven(folder):
    """The nozzle has met the pin there in a run of before."""
    (run,) = make_runs(1, nozzle_at=[206.0, 306.0])
    (folder / "printer.jsonl").write_text(json.dumps(run) + "\n")
    return section(history=str(folder))


def test_pin_of_its_own_is_looked_for_down_to_position_min_once(
    start, tmp_path
):
    # Nobody knows its height; after a good run it is known
    scene = SCENES["separate_pin"]
    about = {"site": "nozzle_pin", "touch": 2, "command": "CALIBRATE_Z"}
    fault = Fault("trigger_never", **about)
    deep = replace(scene.world.pin, pin_travel=8.0)
    changes = {"stepper_z": {"position_min": "-2"}, **proven(tmp_path)}
    printer = start(scene.with_world(pin=deep), changes, [fault])
    printer.machine.tolerate("nozzle_pin", 4.0)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "nozzle: " in text
    assert "(stopped at z=-2.000)" in text
    assert_unharmed(printer)


@pytest.mark.slow
@pytest.mark.parametrize("between", ["", "G28\n", "M84\nG28\n"])
def test_pin_of_its_own_is_known_after_a_good_run(start, tmp_path, between):
    printer = start("separate_pin", proven(tmp_path))
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.homed()
    result, _ = calibration(printer)
    printer.run(between)
    printer.machine.break_down(
        Fault("trigger_never", site="nozzle_pin", command="CALIBRATE_Z")
    )
    text = printer.fail("CALIBRATE_Z")
    assert f"(stopped at z={result[2] - 1.0:.3f})" in text


def test_pin_of_its_own_that_stands_high_is_passed(start):
    # 9 mm; the probe, which hangs 6.4 mm, is on the toolhead all the time
    scene = SCENES["separate_pin"]
    high = replace(scene.world.pin, z=9.3012)
    printer = start(scene.with_world(pin=high)).homed()
    told = "until endstop_pin is touched the toolhead travels at z=21.0, enough for"
    assert told in "\n".join(printer.session.console)
    calibration(printer)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)
    assert printer.machine.truth.drag("body_pin") == 0.0


def test_pin_of_its_own_that_stands_high_is_met_ready_to_stop(start):
    # Nobody knows its height, and the toolhead comes from above
    scene = SCENES["separate_pin"]
    high = replace(scene.world.pin, z=15.4)
    printer = start(scene.with_world(pin=high)).homed()
    printer.run("G1 Z60 F900")
    before = len(printer.machine.truth.touches)
    printer.run("PROBE_Z_ACCURACY")
    assert {t.site for t in printer.machine.truth.touches[before:]} == {
        "nozzle_pin"
    }


# Old names


def test_old_names_work_and_are_told_once(watched):
    printer = watched(
        nozzle_xy_position=None,
        switch_xy_position=None,
        bed_xy_position=None,
        probe_nozzle_x="205.5",
        probe_nozzle_y="306",
        probe_switch_x="211.5",
        probe_switch_y="281.25",
        probe_bed_x="110",
        probe_bed_y="90",
        max_deviation="0.2",
        # Of others
        homing_speed="7",
        second_homing_speed="2",
        homing_retract_dist="2.5",
    )
    start = "// z_calibration: option"
    told = [e for e in printer.session.console if e.startswith(start)]
    assert sorted(re.split("options? ", e, maxsplit=1)[1] for e in told) == [
        "'homing_retract_dist' is now called 'probing_retract_dist'",
        "'homing_speed' is now called 'probing_speed'",
        "'max_deviation' is now called 'offset_margins'",
        "'probe_bed_x' and 'probe_bed_y' are now 'bed_xy_position: 110,90'",
        "'probe_nozzle_x' and 'probe_nozzle_y' are now"
        " 'nozzle_xy_position: 205.5,306'",
        "'probe_switch_x' and 'probe_switch_y' are now"
        " 'switch_xy_position: 211.5,281.25'",
        "'second_homing_speed' is now called 'probing_second_speed'",
    ]
    calibration(printer)
    again = [e for e in printer.session.console if e.startswith(start)]
    assert told == again
    assert place_of("body_pin", printer) == (211.5, 281.25)
    assert place_of("probe_bed", printer) == (112.0, 65.25)
    accuracy = "\n".join(printer.run("PROBE_Z_ACCURACY"))
    assert "retract=2.500 speed=2.0" in accuracy


def test_new_names_come_before_old_ones(watched):
    printer = watched(
        probe_nozzle_x="1",
        probe_nozzle_y="2",
        max_deviation="0.1",
        offset_margins="-1,1",
        safe_z_height="14",
    )
    console = "\n".join(printer.session.console)
    for text in (
        "'probe_nozzle_x' and 'probe_nozzle_y' are ignored,"
        " 'nozzle_xy_position' is given",
        "'max_deviation' is ignored, 'offset_margins' is given",
    ):
        assert text in console
    result, _ = calibration(printer)
    assert result[2] == pytest.approx(PIN, abs=MICROSTEP)
    assert max(travel_heights(printer)) == pytest.approx(14.0, abs=0.01)


def test_clearance_counts_from_each_touch(watched):
    printer = watched(clearance="16")
    calibration(printer)
    wanted = [PIN + 16.0, PIN + BODY + 16.0]
    assert travel_heights(printer)[-2:] == pytest.approx(wanted, abs=0.01)


def test_clearance_of_zero_is_none(watched):
    printer = watched(clearance="0")
    calibration(printer)
    assert 13.8 in [round(z, 2) for z in travel_heights(printer)]


def test_sites_do_not_depend_on_where_the_head_was(start):
    printer = start().homed()
    first, _ = calibration(printer)
    printer.run("G1 X10 Y10 Z60 F6000")
    before = len(printer.machine.truth.touches)
    second, _ = calibration(printer)
    assert second == pytest.approx(first, abs=MICROSTEP)
    assert touched_sites(printer, before) == touched_sites(printer)[-9:]


def test_old_and_new_name_of_the_pin_are_one(start):
    options = {"endstop_pin": "^PC7", "calibration_endstop_pin": "^PC7"}
    start(changes=section(**options)).session.require_ready()
