"""Each option of [dockable_probe]: what it does, and what it must not be."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.hosts.hosts import Host
from tools.kit.dockable_probe import (
    BED,
    CLEAR,
    HANG,
    QUICK,
    SENSED,
    SWITCH,
    WAY,
    moves,
    refusal,
    section,
    trips,
    where,
)
from tools.kit.z_calibration import with_moves

DOCK = (50.0, 308.0)
APPROACH = (50.0, 270.0)
DETACH = (90.0, 308.0)


def recording(start, scene=SWITCH, **options):
    """A printer, homed, that records its moves; only one sample."""
    changes = {"moves": {}, **section(**{**QUICK, **options})}
    printer = start(scene, changes, modules=with_moves()).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nM400")
    return printer


def seconds(printer, script):
    """Printer seconds of a script."""
    simulation = printer.machine.simulation
    before = simulation.virtual_ns
    printer.run(script + "\nM400")
    return (simulation.virtual_ns - before) * 1e-9


# Wrong ones


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pin": "no:PA1"}, "give the pin that the switch is wired to"),
        ({"check_open_attach": None}, "nothing tells whether the probe is"),
        ({"check_open_attach": "False"}, "set check_open_attach: True"),
        ({"approach_position": "50, 308"}, "is at dock_position"),
        ({"extract_position": "50.1, 308"}, "'extract_position' in section"),
        ({"detach_position": "50, 308"}, "'detach_position' in section"),
        (
            {"detach_position": "50, 250"},
            "0 degrees apart: the probe would stay on the toolhead; choose one that"
            " strips it off, mostly at 90 degrees, or give detach_gcode with the"
            " moves that do",
        ),
        ({"dock_fixed_z": "False"}, "dock_position needs the Z of the dock"),
        ({"dock_position": "50, 311"}, "'dock_position' in section"),
        ({"approach_position": "-1, 308"}, "X=-1.000 is outside of 0.000 to"),
        ({"detach_position": "50, 320"}, "Y=320.000 is outside"),
        ({"extract_position": "40, -3"}, "'extract_position' in section"),
        ({"insert_position": "50, -3"}, "'insert_position' in section"),
        (
            {"dock_position": "50, 308, 275", "dock_fixed_z": "True"},
            "the way there is at z=286.900, above position_max (280.000)",
        ),
        ({"z_hop": "281"}, "above position_max"),
        (
            {"dock_position": "50, 308, 20"},
            "to get there Z has to be homed, and Z is homed with the probe",
        ),
        (
            # The third number counts for nothing there
            {
                "dock_position": "50, 308, 5",
                "approach_position": "50, 308, 30",
                "dock_fixed_z": "True",
            },
            "'approach_position' in section 'dockable_probe' (50, 308) is at",
        ),
        (
            {"safe_z_position": "60, 290"},
            "60, 290 is 20.6 mm from the dock",
        ),
        (
            {"safe_z_position": "150, 350"},
            "'safe_z_position' in section 'dockable_probe': 150, 350 is outside of"
            " 0.000 to 300.000 and 0.000 to 310.000",
        ),
        (
            {"safe_z_position": "-1, 100"},
            "-1, 100 is outside of 0.000 to 300.000 and 0.000 to 310.000",
        ),
        ({"safe_dock_distance": "41"}, "safe_dock_distance"),
        ({"dock_angle": "0"}, "needs dock_safe_distance"),
    ],
)
def test_wrong_option(host: Host, changes, words):
    assert words in refusal(host, section(**changes))


# As it was before, and what SAVE_CONFIG has left of it; and one behind other sections
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("probe", {"pin": "^PC3", "z_offset": "1"}),
        ("probe", {"z_offset": "1.5"}),
        ("bltouch", {"sensor_pin": "^PC4"}),
    ],
)
def test_old_probe_is_told_as_that(host: Host, name, options):
    message = refusal(host, {name: options})
    assert f"there is a [{name}], too, and a printer has one probe" in message
    assert f"'#*# [{name}]'" in message


# What they do


def test_old_names(start):
    printer = recording(
        start,
        approach_position=None,
        detach_position=None,
        dock_angle="270",
        detach_angle="0",
        dock_safe_distance="38",
        return_to_last_probe_position_after_detach="False",
    )
    lines = "\n".join(printer.session.console)
    assert "are now 'approach_position: 50.0, 270.0'" in lines
    assert "are now 'detach_position: 88.0, 308.0'" in lines
    assert "is now called 'restore_toolhead'" in lines
    ends = moves(printer, "ATTACH_PROBE\nDETACH_PROBE")
    assert ends[0][:2] == pytest.approx(APPROACH)
    assert ends[-1][:2] == pytest.approx((88.0, 308.0))


def test_other_places_for_out_and_in(start):
    # As an Euclid probe has it
    printer = recording(
        start,
        approach_position="90, 308",
        extract_position="50, 270",
        insert_position="50, 272",
        detach_position="88, 308",
    )
    ends = moves(printer, "ATTACH_PROBE")
    assert [e[:2] for e in ends[:-1]][-3:] == [(90, 308), DOCK, APPROACH]
    ends = moves(printer, "DETACH_PROBE")
    places = [e[:2] for e in ends[:-1]]
    assert places[-3:] == [(50, 272), DOCK, (88, 308)]
    assert trips(printer) == ["attach", "dock"]


@pytest.mark.parametrize(
    ("option", "script"),
    [
        ("attach_speed", "ATTACH_PROBE"),
        ("detach_speed", "DETACH_PROBE"),
        ("travel_speed", "ATTACH_PROBE"),
    ],
)
def test_speed(start, option, script):
    slow = {"travel_speed": "100", "attach_speed": "20", "detach_speed": "20"}
    printer = recording(start, **slow)
    printer.run("ATTACH_PROBE" if script == "DETACH_PROBE" else "G4 P1")
    before = seconds(printer, script)
    printer = recording(start, **{**slow, option: "10"})
    printer.run("ATTACH_PROBE" if script == "DETACH_PROBE" else "G4 P1")
    assert seconds(printer, script) > before + 1.0


def test_default_speeds(start):
    none = {"travel_speed": None, "attach_speed": None, "detach_speed": None}
    printer = recording(start, speed="10", lift_speed="40", **none)
    # 170 and 156 mm, and twice 38 or 38 and 40, all at 50 mm/s
    for script in ("ATTACH_PROBE", "DETACH_PROBE"):
        taken = seconds(printer, script)
        assert (76 + 2 * 155) / 50 < taken < (78 + 2 * 160) / 50 + 2.0


# Up from near the bed, and also while it travels
@pytest.mark.parametrize(
    ("z", "speed", "least"),
    [(0.5, "2", 7.0), (CLEAR, "1", 5.5), (CLEAR, "200", 0.0)],
)
def test_lift_speed(start, z, speed, least):
    printer = recording(start, lift_speed=speed)
    printer.run(f"G1 Z{z}\nM400")
    assert least < seconds(printer, "ATTACH_PROBE") < least + 6.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "first", "height"),
    [
        # Up, and the rest comes with the way
        ({}, CLEAR, WAY),
        ({"sample_retract_dist": "0.5"}, CLEAR, WAY),
        ({"sample_retract_dist": "4"}, HANG + 4.0, WAY),
        ({"sample_retract_dist": "6"}, HANG + 6.0, HANG + 6.0),
        # Whoever wants it higher has a reason: at once
        ({"z_hop": "15"}, 15.0, 15.0),
        ({"z_hop": "11"}, 11.0, WAY),
        ({"z_hop": "3"}, CLEAR, WAY),
        # There may be something beside it
        (
            {"dock_position": "50, 308, 5", "dock_fixed_z": "True"},
            WAY + 5.0,
            WAY + 5.0,
        ),
    ],
)
def test_height_of_the_way(start, options, first, height):
    printer = recording(start, **options)
    printer.run("G1 Z2\nM400")
    ends = moves(printer, "ATTACH_PROBE")
    assert ends[0] == pytest.approx((150.0, 150.0, first))
    away = [z for x, y, z in ends if (x, y) != (150.0, 150.0)]
    assert away == pytest.approx([height] * len(away))
    assert min(z for _, _, z in ends[:-1]) == pytest.approx(first)
    # And goes with it
    last = max(at for at, end in enumerate(ends) if end[:2] != (150.0, 150.0))
    assert ends[last + 1] == pytest.approx((150.0, 150.0, first))
    # Back as low as the probe allows
    low = HANG + float(options.get("sample_retract_dist", "2"))
    assert ends[-1][2] == pytest.approx(low)
    printer.run("DETACH_PROBE\nG1 Z2\nPROBE")
    assert where(printer) == "docked"


def test_probe_that_was_never_measured(start):
    # It may hang 10 mm lower than the nozzle
    printer = recording(start, z_offset="0")
    printer.run("G1 Z2\nM400")
    assert moves(printer, "ATTACH_PROBE")[-1][2] == pytest.approx(12.0)


def test_way_back_clears_what_was_touched(start):
    """A z_offset that is too small is no height to sink to with the probe on."""
    printer = recording(start, z_offset=f"{HANG - 3.0:g}")
    printer.run("PROBE\nDETACH_PROBE\nG1 Z2\nM400")
    ends = moves(printer, "ATTACH_PROBE")
    last = max(at for at, end in enumerate(ends) if end[:2] != (150.0, 150.0))
    assert min(z for *_, z in ends[last:]) > HANG + 1.5


def test_z_of_the_places_of_a_dock_on_the_bed(start):
    printer = recording(
        start,
        BED,
        dock_position="50, 308, 12",
        approach_position="50, 270, 13",
        detach_position="90, 308, 14",
    )
    ends = moves(printer, "ATTACH_PROBE")
    assert [z for *xy, z in ends if tuple(xy) == DOCK] == [12.0, 13.0]
    assert (50.0, 270.0, 20.0) in ends
    assert (50.0, 270.0, 13.0) in ends
    assert ends[-1] == (150.0, 150.0, 20.0)
    ends = moves(printer, "DETACH_PROBE")
    assert (50.0, 308.0, 14.0) in ends
    assert (90.0, 308.0, 14.0) in ends
    assert where(printer) == "docked"


def test_head_is_not_lifted_again(start):
    # The host has lifted it from the last point of the mesh
    changes = {"moves": {}, "force_move": {"enable_force_move": "True"}}
    changes.update(bed_mesh={"horizontal_move_z": "12"}, **section(**QUICK))
    printer = start(SWITCH, changes, modules=with_moves()).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nM400")
    ends = moves(printer, "BED_MESH_CALIBRATE PROBE_COUNT=3,3\nBED_MESH_CLEAR")
    first = [z for _, _, z in ends].index(12.0)
    assert {z for _, _, z in ends[first:] if z > HANG + 0.1} == {12.0}
    # It is lifted from a bed that is higher than Z=0
    ends = moves(printer, "SET_KINEMATIC_POSITION Z=18\nG1 Z20\nPROBE")
    low = [z for x, y, z in ends if (x, y) == DOCK]
    assert min(low) == pytest.approx(HANG + 6.0 + 2.0, abs=0.2)


def test_distance_to_the_dock(start):
    for safe, y in (("0", 300.0), ("10", 298.0), (None, 270.0)):
        printer = recording(start, safe_dock_distance=safe)
        printer.run("G1 X5 Y300\nM400")
        ends = moves(printer, "MOVE_AVOIDING_DOCK X=120 Y=300")
        assert min(e[1] for e in ends) == pytest.approx(y, abs=1.0)


def test_point_to_pass_by(start):
    dock = {
        "dock_position": "150, 150",
        "approach_position": "150, 110",
        "detach_position": "190, 150",
    }
    for safe, above in ((None, True), ("150, 100", False)):
        printer = recording(start, **dock, safe_position=safe)
        printer.run("G1 X50\nG1 Y160\nM400")
        ends = moves(printer, "MOVE_AVOIDING_DOCK X=250 Y=160")
        assert ends[-1][:2] == (250.0, 160.0) and ends[1:]
        assert all((y > 150.0) is above for _, y, _ in ends[:-1])


def test_templates_in_their_order(start):
    names = [
        "pre_attach",
        "attach",
        "post_attach",
        "activate",
        "deactivate",
        "pre_detach",
        "detach",
        "post_detach",
    ]
    at = "{printer.toolhead.position[:2]|map('round')|map('int')|join('/')}"
    options = {
        f"{name}_gcode": f'\n  RESPOND MSG="{at} {name}"\n  M400'
        for name in names
    }
    changes = {
        "respond": {},
        **section(dock_retries="1", samples="2", **options),
    }
    faults = [Fault("attach_fails"), Fault("dock_fails")]
    printer = start(SWITCH, changes, faults=faults).homed()
    lines = printer.run("G1 X150 Y150 Z20 F6000\nPROBE")
    words = [line.split()[-2:] for line in lines if line.split()[-1] in names]
    told = [name for _, name in words]
    # Beside the dock, as they may have moves that lead out from there
    places = {name: place for place, name in words}
    assert places["post_attach"] == "50/270"
    assert places["post_detach"] == "90/308"
    assert places["activate"] == places["deactivate"] == "150/150"
    assert told == [
        # Those at the dock again with each attempt, the others once
        "activate",
        "pre_attach",
        "attach",
        "attach",
        "post_attach",
        "pre_detach",
        "detach",
        "detach",
        "post_detach",
        "deactivate",
    ]


def test_activated_for_each_sample(start):
    options = {
        f"{name}_gcode": f"\n  RESPOND MSG={name}"
        for name in ("activate", "deactivate")
    }
    changes = {
        "respond": {},
        **section(deactivate_on_each_sample="True", samples="2", **options),
    }
    printer = start(SWITCH, changes).homed()
    lines = printer.run("G1 X150 Y150 Z20 F6000\nPROBE")
    told = [line.split()[-1] for line in lines if "activate" in line]
    assert told == ["activate", "deactivate"] * 2


def test_way_that_may_not_strip_it_off(start):
    printer = recording(start, detach_position="70, 270")
    lines = "\n".join(printer.session.console)
    assert "28 degrees apart: the probe may stay on the toolhead" in lines


def test_dock_where_the_mesh_is(start):
    printer = start(
        SWITCH,
        section(
            dock_position="150, 150",
            approach_position="150, 110",
            detach_position="190, 150",
        ),
    )
    printer.homed()
    lines = "\n".join(printer.session.console)
    assert "dock_position (150, 150) lies where the toolhead goes" in lines


CROSSES = {"restore_toolhead": "False", "detach_position": "10, 308"}


@pytest.mark.parametrize("right", ["", *CROSSES])
def test_left_where_homing_goes_across_the_dock(start, right):
    # X is homed to the right, and nobody knows after a restart where the toolhead is
    own = {name: value for name, value in CROSSES.items() if name != right}
    lines = "\n".join(start(SWITCH, section(**own)).homed().session.console)
    note = (
        "leaves the toolhead at detach_position (10, 308), from where homing X and Y"
        " after a restart goes across the dock"
    )
    assert (note in lines) is not bool(right)


@pytest.mark.every_host("only some hosts can drop a first result")
def test_first_result_is_dropped_where_the_host_can(start):
    printer = start(
        SWITCH, section(drop_first_result="True", samples="2")
    ).homed()
    told = "drop_first_result needs" in "\n".join(printer.session.console)
    printer.run("G1 X150 Y150 Z20 F6000\nPROBE")
    touches = printer.machine.truth.touch_count("probe_bed")
    assert touches == (2 if told else 3)


def test_parameters_of_a_probing_command_that_are_none(start):
    printer = start(SWITCH, section(**QUICK)).homed()
    printer.run("G1 X150 Y150 Z20 F6000")
    for wrong in ("SAMPLES=0", "PROBE_SPEED=0"):
        assert wrong.split("=")[0] in printer.fail(f"PROBE {wrong}")
    # Kalico's PROBE does not look at it for one sample
    assert "LIFT_SPEED" in printer.fail("PROBE_ACCURACY LIFT_SPEED=0")


# What tells where it is


PROBE_PIN = "pin reads TRIGGERED, probe_sense_pin reads open"
DOCK_PIN = "pin reads TRIGGERED, dock_sense_pin reads TRIGGERED"


@pytest.mark.parametrize(
    "options, words",
    [
        ({"check_open_attach": "False", "dock_sense_pin": None}, PROBE_PIN),
        ({"check_open_attach": "False", "probe_sense_pin": None}, DOCK_PIN),
        ({"check_open_attach": None, "probe_sense_pin": None}, DOCK_PIN),
        ({"probe_sense_pin": None}, DOCK_PIN),
        ({"dock_sense_pin": None}, PROBE_PIN),
    ],
)
def test_sense_pins(start, options, words):
    printer = start(SENSED, section(**{**QUICK, **options})).homed()
    printer.run("PROBE")
    assert trips(printer) == ["attach", "dock"] * 2
    assert printer.run("GET_PROBE_STATUS")[1].split(": ")[-1] == words


# Each with the probe in the dock and on the toolhead.  Open as if it were on the toolhead,
# TRIGGERED as if it were not: 'pin' has a veto, beside others, if it is asked.
@pytest.mark.parametrize(
    ("asked", "stuck", "docked", "attached"),
    [
        ("True", "stuck_open", "DOCKED", "ATTACHED"),
        ("True", "stuck_closed", "DOCKED", "UNKNOWN"),
        (None, "stuck_closed", "DOCKED", "ATTACHED"),
        (None, "stuck_open", "DOCKED", "ATTACHED"),
    ],
)
@pytest.mark.parametrize("missing", ["probe_sense_pin", "dock_sense_pin"])
def test_say_of_the_pin_beside_others(
    start, missing, asked, stuck, docked, attached
):
    options = {"check_open_attach": asked, missing: None}
    for initial, state in (("docked", docked), ("attached", attached)):
        probe = replace(SENSED.world.mag_probe, initial=initial)
        fault = Fault(stuck, signal="probe", t=0.0)
        printer = start(
            SENSED.with_world(mag_probe=probe),
            section(**options),
            faults=[fault],
        )
        printer.session.require_ready()
        assert printer.run("GET_PROBE_STATUS")[0].endswith(": " + state)
