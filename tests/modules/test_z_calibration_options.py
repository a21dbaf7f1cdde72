"""Every option of [z_calibration]: that it does something, and what.

What options refuse besides is in test_wrong_values.py.
"""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from simprinter import Fault
from tools.kit.cases import slow
from tools.kit.load_errors import load
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    BED,
    BODY,
    MICROSTEP,
    PIN,
    SWITCH_OFFSET,
    TRIGGER,
    calibration,
    refusal,
    section,
    touched_sites,
    with_extra,
)

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

PARAMETERS = (
    "NOZZLE_POSITION=205.5,306.5 BED_POSITION=110,90"
    ' SWITCH_POSITION="211.5, 281"'
)
# The probe's point is asked for, not the nozzle's
EACH = {
    "nozzle_pin": (205.5, 306.5),
    "body_pin": (211.5, 281.0),
    "probe_bed": (112.0, 65.25),
}
OFFSETS = section(
    nozzle_xy_position="205.5, 306",
    switch_xy_position=None,
    switch_xy_offsets="5.5, -24.75",
)
# Sections, parameters, and where the toolhead is at each site that they are about (mm)
SITES = {
    "options": (
        section(
            nozzle_xy_position="205.5, 306.5",
            switch_xy_position="211.5, 281",
            bed_xy_position="110, 90",
        ),
        *("", EACH),
    ),
    "parameters": ({}, PARAMETERS, EACH),
    "safe_z_home": (
        {
            "safe_z_home": {"home_xy_position": "205.5, 306.5"},
            **section(nozzle_xy_position=None),
        },
        *("", {"nozzle_pin": (205.5, 306.5)}),
    ),
    "offsets": (OFFSETS, "", {"body_pin": (211.0, 281.25)}),
    # A nozzle that comes with the command takes the switch along
    "offsets from a parameter": (
        *(OFFSETS, "NOZZLE_POSITION=206.25,306.25"),
        {"body_pin": (211.75, 281.5)},
    ),
    "a position before offsets": (
        section(switch_xy_offsets="3, -20"),
        *("", {"body_pin": (211.5, 281.25)}),
    ),
    "zero of the mesh": (
        {
            **section(bed_xy_position=None),
            **mesh(zero_reference_position="120, 130"),
        },
        *("", {"probe_bed": (122.0, 105.25)}),
    ),
}


@pytest.mark.parametrize(
    ("changes", "parameters", "places"), SITES.values(), ids=SITES
)
def test_each_site_is_touched_where_it_is_wanted(
    start, changes, parameters, places
):
    printer = start(changes=changes).homed()
    before = len(printer.machine.truth.touches)
    calibration(printer, f"CALIBRATE_Z {parameters}")
    for site, place in places.items():
        assert place_of(site, printer, before) == place


@pytest.mark.every_host("only hosts until 2023-06 have it")
def test_bed_position_falls_back_to_the_index_of_a_mesh(host):
    changes = {
        **section(bed_xy_position=None),
        **mesh(relative_reference_index="5"),
    }
    with Printer(host, changes=changes) as printer:
        state, message = printer.session.start()
        if state != "ready":
            words = "'relative_reference_index' is not valid in section"
            assert words in message
            pytest.skip(f"{host.name}: {message.splitlines()[0]}")
        calibration(printer.homed())
        # Rows of the mesh go there and back: the sixth is the middle's end
        assert place_of("probe_bed", printer) == (42.0, 115.25)
        assert printer.gap((40, 140)) == pytest.approx(0.06, abs=0.005)


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
    "bed near the endstop": (
        section(bed_xy_position="214.5, 301.5"),
        [
            f"Option 'bed_xy_position: 214.5,301.5'{IN} puts the toolhead 6.7 mm"
            " from where it touches the switch",
            "at least 7 mm away",
        ],
    ),
    "texture out of reach": (
        section(bed_spread="3", bed_xy_position="150, 26"),
        [f"Option 'bed_spread: 3'{REACH} Y=-1.750, outside"],
    ),
    "texture near the endstop": (
        section(bed_spread="6", bed_xy_position="199.5, 306"),
        ["choose a point of the bed at least 7 mm away"],
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


@pytest.mark.parametrize(
    "options",
    [
        *(
            dict.fromkeys(("nozzle_xy_position", "switch_xy_position"), edge)
            for edge in ("300, 100", "100, 310", "0, 0")
        ),
        {"bed_xy_position": "214.5, 301"},
    ],
)
def test_point_just_within_its_limits(host, options):
    state, message = load(host, section(**options))
    assert state == "ready", message


# Heights


CLEAR = BODY + SWITCH_OFFSET + 1.0 + 1.0
# Options, a travel of the first run, and the height (mm) of its way
TRAVELS = [
    # To the pin: enough for a probe that nobody has measured yet, 10 mm over it
    ({}, 0, 13.8),
    slow({"safe_z_height": "25"}, 0, 25.0),
    ({"safe_z_height": "6"}, 0, PIN + 10.0 + 1.0),
    ({"safe_z_height": "6", "travel_margin": "2"}, 0, PIN + 10.0 + 2.0),
    # To the bed, as high as the margin lets that be
    ({"safe_z_height": "6", "offset_margins": "5"}, -1, 5.0 + CLEAR),
    # From each touch on
    ({"clearance": "16"}, -2, PIN + 16.0),
    ({"clearance": "16"}, -1, PIN + BODY + 16.0),
]


@pytest.mark.parametrize(("options", "travel", "height"), TRAVELS)
def test_travel_height(watched, options, travel, height):
    printer = watched(**options)
    printer.run("G1 Z4 F600")
    calibration(printer)
    found = travel_heights(printer)[travel]
    assert found == pytest.approx(height, abs=0.01)
    assert printer.machine.truth.drag("body_pin") == 0.0


def test_travel_height_follows_what_was_measured(watched):
    printer = watched(safe_z_height="6")
    calibration(printer)
    # To the bed: over the pin with the free plunger, and over the bed
    assert travel_heights(printer)[-1] == pytest.approx(PIN + CLEAR, abs=0.01)
    printer.run("G1 X206 Y306 F6000\nG1 Z4 F600")
    calibration(printer)
    known = travel_heights(printer)[-2]
    assert known == pytest.approx(PIN + CLEAR, abs=0.01)
    # After homing the probe may have been exchanged
    calibration(printer, "G28 Z\nCALIBRATE_Z")
    assert travel_heights(printer)[-2] == pytest.approx(PIN + 11.0, abs=0.01)


# Sampling


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


@pytest.mark.parametrize(
    ("changes", "speed"),
    [
        # That of homing, though Z is moved at 10 mm/s by then
        ({}, 8.0),
        ({"stepper_z": {"homing_speed": "2"}}, 2.0),
        # What the section gives counts, were it faster
        (section(probing_speed="12"), 12.0),
    ],
)
def test_first_fast_touch_is_as_fast_as_homing(start, changes, speed):
    own = {"probing_first_fast": "true", **changes.get("z_calibration", {})}
    printer = start(changes={**changes, **section(**own)}).homed()
    printer.run("G90\nG1 Z60 F900\nM400")
    began, touches = printer.now(), printer.machine.truth.touches
    count = len(touches)
    calibration(printer)
    seconds = touches[count].t - began
    assert seconds == pytest.approx((60.0 - PIN) / speed, abs=1.2)


# What runs besides


def test_empty_template_is_no_template(start):
    # This probe is attached all the time
    parts = ("start", "before_switch", "end", "offset", "error")
    changes = section(**{f"{part}_gcode": "" for part in parts})
    printer = start(changes=changes).homed()
    result, _ = calibration(printer)
    assert printer.offset() == pytest.approx(result[-1], abs=1e-6)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("CALIBRATE_Z", "not homed: X, Y, Z"),
        ("G28\nCALIBRATE_Z BED_POSITION=1", "BED_POSITION has to be X and Y"),
    ],
)
def test_error_gcode_is_told_of_the_error(start, script, words):
    code = 'RESPOND MSG="panic {params.ERROR}"'
    changes = {"respond": {}, **section(error_gcode=code)}
    printer = start(changes=changes)
    printer.session.require_ready()
    assert words in printer.fail(script)
    (line,) = [n for n in printer.session.console if "echo: panic " in n]
    assert words in line


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


@pytest.mark.slow
@pytest.mark.parametrize("between", ["", "G28\n", "M84\nG28\n"])
def test_pin_of_its_own_is_known_after_a_good_run(start, between):
    printer = start("separate_pin")
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


def test_old_and_new_name_of_the_pin_are_one(start):
    options = {"endstop_pin": "^PC7", "calibration_endstop_pin": "^PC7"}
    start(changes=section(**options)).session.require_ready()
