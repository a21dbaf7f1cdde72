"""What owners of a dock have reported: each is a member of a kind."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.hosts.hosts import Host
from tools.kit.cases import slow
from tools.kit.dock_owner import UNKNOWN, Owner
from tools.kit.dockable_probe import (
    GANTRY,
    QUICK,
    SWITCH,
    assert_safe,
    moves,
    refusal,
    section,
    trips,
    where,
)
from tools.kit.docks import SLINGER
from tools.kit.z_calibration import with_moves

CENTRE = "G1 X150 Y150 Z20 F6000\n"
SAME = {"detach_position": "50, 250"}
TOLD = "0 degrees apart: the probe would stay on the toolhead"


# Both ways the same in X and Y


@pytest.mark.parametrize(
    ("options", "macro", "by"),
    [
        ({"detach_gcode": "\n  G4 P1"}, None, "detach_gcode"),
        ({"pre_detach_gcode": "\n  G4 P1"}, None, "pre_detach_gcode"),
        ({"detach_position": "50, 250, 3"}, None, "the Z of detach_position"),
        *(
            ({}, f"MOVE_TO_{part}_PROBE", f"the macro MOVE_TO_{part}_PROBE")
            for part in ("APPROACH", "DOCK", "EXTRACT", "INSERT", "DETACH")
        ),
    ],
)
def test_same_way_is_told_where_something_else_may_strip_it_off(
    start, options, macro, by
):
    changes = section(**{"dock_fixed_z": "True", **SAME, **options})
    if macro:
        changes[f"gcode_macro {macro}"] = {
            "rename_existing": "_THEIRS",
            "gcode": "\n  _THEIRS",
        }
    printer = start(GANTRY, changes)
    printer.session.require_ready()
    told = f"{TOLD}, unless {by} strips it off"
    assert any(
        told in note for note in printer.status("dockable_probe")["notes"]
    )


def test_nothing_is_told_where_the_ways_differ(start):
    changes = section(detach_gcode="\n  G4 P1", pre_detach_gcode="\n  G4 P1")
    printer = start(GANTRY, changes)
    printer.session.require_ready()
    assert printer.status("dockable_probe")["notes"] == []


# A bed slinger


@pytest.mark.every_host(
    "whatever homes with the probe puts it back by a Z stroke"
)
def test_probe_that_a_stroke_in_z_strips_off(start):
    printer = start(SLINGER, section(**QUICK)).homed()
    printer.run(CENTRE + "BED_MESH_CALIBRATE PROBE_COUNT=3,3")
    printer.run(CENTRE + "ATTACH_PROBE\nDETACH_PROBE")
    assert trips(printer) == ["attach", "dock"] * 3
    assert where(printer) == "docked"
    # Back where it was, not so low
    assert printer.session.position() == pytest.approx((150, 150, 20), abs=0.01)
    assert_safe(printer)


@pytest.mark.parametrize("retries", [0, 1])
def test_probe_that_stays_on_is_not_dragged_out_low(start, retries):
    changes = section(dock_retries=str(retries), **QUICK)
    printer = start(SLINGER, changes).homed()
    printer.run(CENTRE + "ATTACH_PROBE")
    printer.machine.break_down(Fault("dock_fails", persistent=not retries))
    touches = len(printer.machine.truth.touches)
    if retries:
        printer.run("DETACH_PROBE")
    else:
        assert "the probe was not docked" in printer.fail("DETACH_PROBE")
    assert where(printer) == ("docked" if retries else "attached")
    assert printer.machine.truth.touches[touches:] == []
    assert_safe(printer)


# Macros over the parts of a trip, as Kalico's documents had them for an Euclid


def euclid(scene):
    """The probe is taken along, and brought back, along Y; stripped off along X."""
    return scene.with_world(
        dock=replace(
            scene.world.dock, approach=(0.0, -1.0, 0.0), release=(1.0, 0.0, 0.0)
        )
    )


@pytest.mark.parametrize("mode", ["G90", slow("G91")])
@pytest.mark.parametrize("scene", [GANTRY, slow(SWITCH)])
def test_macros_instead_of_positions(start, scene, mode):
    changes = section(
        approach_position="90, 308", detach_position="90, 308", **QUICK
    )
    for part in ("EXTRACT", "INSERT"):
        changes[f"gcode_macro MOVE_TO_{part}_PROBE"] = {
            "rename_existing": f"_{part}",
            "gcode": "\n  G1 X50 Y270",
        }
    changes["moves"] = {}
    printer = start(euclid(scene), changes, modules=with_moves()).homed()
    before = len(trips(printer))
    printer.run(f"{CENTRE}{mode}\nATTACH_PROBE\nPROBE")
    ends = [end[:2] for end in moves(printer, "DETACH_PROBE")]
    assert trips(printer, before) == ["attach", "dock"]
    # Straight in from where the macro ends, whose own moves are not told
    assert [end for end in ends if end != (150, 150)][0] == (50, 308)
    assert where(printer) == "docked"
    assert_safe(printer)


@pytest.mark.parametrize("command", ["PROBE", slow("DETACH_PROBE")])
def test_macro_that_needs_what_it_is_a_part_of(start, command):
    macro = {"rename_existing": "_THEIRS", "gcode": f"\n  {command}\n  _THEIRS"}
    changes = {"gcode_macro MOVE_TO_APPROACH_PROBE": macro, **section(**QUICK)}
    printer = start(SWITCH, changes).homed()
    text = printer.fail(f"{CENTRE}ATTACH_PROBE")
    assert "a command in a macro over a part of the way needs the probe" in text
    assert where(printer) == "docked"
    assert_safe(printer)


def test_macros_are_no_part_of_a_trial(start):
    changes = {"respond": {}, **section(**UNKNOWN, **QUICK)}
    for part in ("APPROACH", "EXTRACT", "DETACH"):
        changes[f"gcode_macro MOVE_TO_{part}_PROBE"] = {
            "rename_existing": f"_{part}",
            "gcode": "\n  {action_raise_error('a place of before')}",
        }
    user = Owner(start(SWITCH, changes).homed())
    user.go("X150 Y150 Z20")
    user.put_on()
    user.come_to("FETCH")
    begun = len(trips(user.printer))
    user.press("Fetch")
    user.press("Dock")
    assert user.step() == "SAVE"
    assert trips(user.printer, begun) == ["attach", "dock"]


# No Z of a position is found there: another way out is, which is tried as it is
def test_set_up_where_a_stroke_was_before(start):
    places = {
        "dock_position": "50, 308",
        "approach_position": "90, 308",
        "detach_position": "90, 308, 2",
        "dock_fixed_z": "True",
    }
    changes = {"respond": {}, "moves": {}, **section(**places, **QUICK)}
    user = Owner(start(SWITCH, changes, modules=with_moves()).homed())
    user.go("X150 Y150 Z20")
    user.put_on()
    user.come_to("APPROACH")
    user.go("X90 Y308")
    assert "this is the way out without the probe" in user.refused("Here")
    user.go("Y270", "X50")
    user.press("Here")
    user.press("Same")
    user.press("Fetch")
    begun = len(user.printer.status("moves")["ends"])
    user.press("Dock")
    assert user.step() == "SAVE"
    ends = user.printer.status("moves")["ends"][begun:]
    assert min(z for _, _, z in ends) > 8


# Homing of the user's may go down with the probe on


def test_homing_override_goes_where_it_likes(start):
    # Z is made up: 0 where the toolhead is, so the bed is lower than that
    gcode = (
        "\n  G90\n  G1 Z15 F900\n  G28 X Y\n  ATTACH_PROBE\n  G1 X150 Y130 F6000"
        "\n  G1 Z6 F600\n  G28 Z\n  DETACH_PROBE"
    )
    changes = {
        "safe_z_home": None,
        "homing_override": {"axes": "z", "set_position_z": "0", "gcode": gcode},
        **section(**QUICK),
    }
    printer = start(GANTRY, changes).homed()
    printer.run("G1 Z20 F900\nG28")
    assert where(printer) == "docked"
    # It is over with that
    printer.run(f"{CENTRE}ATTACH_PROBE")
    assert "run DETACH_PROBE first" in printer.fail("G1 Z6")
    assert_safe(printer)


# Machines without a Z of their own


@pytest.mark.parametrize(
    ("kinematics", "why"),
    [
        ("delta", "has no Z axis of its own"),
        ("rotary_delta", "has no Z axis of its own"),
        ("deltesian", "has no Z axis of its own"),
        ("winch", "has no Z axis of its own"),
        ("none", "nothing moves there"),
    ],
)
def test_machine_that_it_cannot_be_used_on(host: Host, kinematics, why):
    none = dict.fromkeys(
        ("stepper_x", "stepper_y", "stepper_z", "safe_z_home", "bed_mesh")
    )
    changes = {
        **none,
        **{f"stepper_z{i}": None for i in (1, 2, 3)},
        "quad_gantry_level": None,
        "printer": {"kinematics": kinematics},
    }
    text = refusal(host, changes)
    assert f"Option 'kinematics: {kinematics}' in section 'printer'" in text
    assert why in text
    assert "remove section 'dockable_probe'" in text


# Nothing says yet where the dock is


@pytest.mark.parametrize("scene", [GANTRY, SWITCH])
def test_home_x_and_y_with_the_probe_on_and_no_positions(start, scene):
    scene = scene.with_world(
        mag_probe=replace(scene.world.mag_probe, initial="attached")
    )
    printer = start(scene, section(**UNKNOWN))
    printer.session.require_ready()
    text = printer.fail("G28")
    assert "nothing says where the dock is" in text
    assert "G28 X Y is possible" in text
    printer.run("G28 X Y")
    assert "x" in printer.status("toolhead")["homed_axes"]
    assert "y" in printer.status("toolhead")["homed_axes"]
    printer.run("DOCKABLE_PROBE_SETUP\nDOCKABLE_PROBE_SETUP STEP=ON")
    assert where(printer) == "attached"
    assert_safe(printer)
