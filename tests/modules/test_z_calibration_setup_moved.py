"""Z_CALIBRATION_SETUP where Z, or the probe, is not where the set-up has left it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.hosts.session import GcodeError
from tools.kit.cases import slow
from tools.kit.dockable_probe import SWITCH, trips, where
from tools.kit.docks import calibrating
from tools.kit.scenes import SCENES
from tools.kit.setup_user import EMPTY, User
from tools.kit.z_calibration import section

VORON = SCENES["voron"]
DOCK = calibrating(SWITCH)
LEVEL = {
    "quad_gantry_level": {
        **SWITCH.sections["quad_gantry_level"],
        "retries": "5",
        "retry_tolerance": "0.02",
    }
}
# Levelling lifts the pin by 3.1 mm
SLOPE = -0.02
TILT = {
    "z_positions": "-60, -10\n  -60, 370\n  360, 370\n  360, -10",
    "points": "50, 25\n  50, 225\n  250, 225\n  250, 25",
    "speed": "200",
    "horizontal_move_z": "10",
}
OVER_PIN = "G90\nG1 X206 Y270 Z15 F12000\nG1 Y306"
# Z is homed with the probe, and the pin is one of its own
OWN_PIN = {
    "stepper_z": {
        "endstop_pin": "probe:z_virtual_endstop",
        "position_endstop": None,
    },
    "safe_z_home": {
        "home_xy_position": "152, 125.25",
        "speed": "100",
        "z_hop": "10",
    },
}


def tilted(scene):
    z0 = 0.4 - SLOPE * 150
    bed = replace(scene.world.bed, slope_y=SLOPE, z0=z0)
    return scene.with_world(bed=bed)


def begun(start, scene, changes, script="", is_fixed=False):
    """Somebody who has come to the pin."""
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    if script:
        printer.run(script)
    user = User(printer)
    user.begin()
    user.test_switches(is_fixed)
    user.press("Home")
    return user


def places(user):
    """From the pin on, up to the touches."""
    user.printer.run(OVER_PIN)
    user.press("Here")
    user.jog("X", 4.0)
    for label in ("Here", "Here", "Yes"):
        user.press(label)


def lower(user):
    """As far as the buttons lead."""
    for _ in range(3):
        try:
            user.press("Z-10 mm")
        except GcodeError as error:
            return str(error)
    return ""


# With the probe on the toolhead only that would end the way down
@pytest.mark.slow
def test_levelled_before_home(start):
    changes = {**section(**EMPTY), **LEVEL}
    script = "G28\nQUAD_GANTRY_LEVEL"
    user = begun(start, tilted(VORON), changes, script, is_fixed=True)
    places(user)
    # So far above the bed a pin is none of this position_endstop
    assert "bed: No trigger" in user.refused("Touch")
    user.printer.machine.truth.require_no_crash()


@pytest.mark.parametrize("command", ["CALIBRATE_Z", slow("PROBE_Z_ACCURACY")])
def test_pin_that_was_levelled_with_the_probe_on_the_head(start, command):
    hook = {"before_switch_gcode": "M400"}
    changes = {"z_calibration": hook, **LEVEL}
    printer = start(tilted(VORON), changes=changes).homed()
    printer.run("QUAD_GANTRY_LEVEL")
    # Whether it is met or not
    try:
        printer.run(command)
    except GcodeError as error:
        assert "home Z again" in str(error)
    printer.machine.truth.require_no_crash()


@pytest.mark.parametrize("is_late", [False, True])
def test_levelled_before_the_head_is_lowered(start, is_late):
    changes = {**section(**EMPTY), **LEVEL}
    level = "QUAD_GANTRY_LEVEL"
    early = "" if is_late else f"G28\n{level}"
    user = begun(start, tilted(DOCK), changes, early)
    if is_late:
        user.printer.run(level)
    user.printer.run(OVER_PIN)
    text = lower(user)
    user.printer.machine.truth.require_no_crash()
    assert ("home Z again (G28 Z)" in text) is is_late
    user.printer.run(f"G28 Z\n{OVER_PIN}")
    lower(user)
    user.printer.machine.truth.require_no_crash()
    user.press("Here")
    assert user.step() == "SWITCH"


# It would be asked for again and again
@pytest.mark.slow
def test_homing_that_ends_with_levelling(start):
    homing = {
        "rename_existing": "G28.1",
        "gcode": "\n  G28.1 {rawparams}\n  Z_TILT_ADJUST",
    }
    changes = {
        **section(**EMPTY),
        "quad_gantry_level": None,
        "z_tilt": TILT,
        "stepper_z": {"position_endstop": "1.0"},
        "gcode_macro G28": homing,
    }
    user = begun(start, DOCK, changes)
    user.printer.run(OVER_PIN)
    assert "home Z again (G28 Z)" in user.refused("Here")
    user.printer.run("G28")
    places(user)
    user.press("Touch")
    assert user.step() == "GAP"
    user.printer.machine.truth.require_no_crash()


@pytest.mark.slow
def test_heights_that_hold_no_more_are_no_floor(start):
    changes = {**section(**EMPTY, endstop_pin="^PC2"), **OWN_PIN, **LEVEL}
    user = begun(start, tilted(DOCK), changes)
    places(user)
    user.press("Touch")
    user.printer.run("G28\nQUAD_GANTRY_LEVEL\nG28 Z")
    assert "first touches begin again" in user.refused("Paper")
    user.press("Back")
    assert "The height of the pin is not known yet" in user.dialog().text


@pytest.mark.slow
def test_start_gcode_that_homes_with_the_probe(start):
    options = {"endstop_pin": "^PC2", "safe_z_height": "30"}
    options["start_gcode"] = "\n  G28"
    changes = {**section(**EMPTY, **options), **OWN_PIN}
    user = begun(start, DOCK, changes)
    places(user)
    user.press("Touch")
    assert user.step() == "GAP"
    user.printer.machine.truth.require_no_crash()


# Whoever has fetched it is not asked to take it off again
@pytest.mark.slow
@pytest.mark.parametrize("is_good", [True, False])
def test_probe_that_its_owner_has_fetched(start, is_good):
    probe = replace(DOCK.world.mag_probe, plunger_on_pin=not is_good)
    scene = DOCK.with_world(mag_probe=probe)
    user = begun(start, scene, section(**EMPTY))
    user.printer.run("ATTACH_PROBE")
    places(user)
    if is_good:
        user.press("Touch")
        user.press("Paper")
    else:
        assert "the pin presses the plunger" in user.refused("Touch")
        user.press("Abort")
    assert where(user.printer) == "docked"
    assert trips(user.printer)[-1] == "dock"


# 188.3 + 31.8 is more than 220.1 for a computer
@pytest.mark.slow
def test_place_at_the_end_of_an_axis_can_be_saved(start):
    scene = SCENES["cartesian"]
    probe = replace(scene.world.mag_probe, y_offset=-31.8)
    changes = section(**EMPTY)
    changes["stepper_y"] = {"position_max": "220.1"}
    changes["probe"] = {"y_offset": "-31.8"}
    scene = scene.with_world(mag_probe=probe)
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    user = User(printer)
    user.begin()
    user.go_to("NOZZLE")
    for place in ((226, 20), (254, 55.3)):
        user.jog_to(*place)
        user.press("Here")
    printer.run("G90\nG1 Y220.1 F6000")
    for label in ("Here", "Yes", "Touch", "D2F 0.2 mm"):
        user.press(label)
    printer.session.restart(user.dialog().gcode("Save"))
    printer.run("G28\nCALIBRATE_Z")


@pytest.mark.slow
def test_saved_with_the_motors_off(start):
    user = begun(start, VORON, section(**EMPTY), is_fixed=True)
    places(user)
    user.press("Touch")
    user.press("D2F 0.2 mm")
    user.printer.run("M84")
    user.printer.session.restart(user.dialog().gcode("Save"))
    user.printer.run("G28\nCALIBRATE_Z")
