"""DOCKABLE_PROBE_SETUP on the simulated printer: from no position to Save."""

from __future__ import annotations

import pytest

from simprinter import Fault
from tools.kit.dock_owner import SETUP, UNKNOWN, Owner
from tools.kit.dock_owner import dock_owner as owner
from tools.kit.dockable_probe import (
    ABOVE,
    FRAME,
    QUICK,
    SENSED,
    SWITCH,
    WAY,
    section,
    trips,
    where,
)
from tools.kit.setup_user import SAVE_THAT_FAILS

OPTIONS = ("dock_position", "approach_position", "detach_position")


def test_from_no_position_to_the_first_probe(start):
    user = owner(start)
    printer = user.printer
    user.come_to("FETCH")
    assert user.step() == "FETCH"
    user.press("Fetch")
    assert where(printer) == "attached"
    user.press("Dock")
    assert where(printer) == "docked"
    assert trips(printer) == ["attach", "dock", "attach", "dock"]
    assert printer.status("configfile")["save_config_pending_items"] == {}
    text = user.dialog().text
    assert "dock_position: 50.000, 308.000" in text
    printer.session.restart(user.dialog().gcode("Save"))
    settings = printer.status("configfile")["settings"]["dockable_probe"]
    wanted = [(50.0, 308.0), (50.0, 270.0), (90.0, 308.0)]
    assert [tuple(settings[name]) for name in OPTIONS] == wanted
    printer.run("G28\nG90\nG1 X150 Y150 Z20 F6000\nPROBE")
    assert trips(printer)[-2:] == ["attach", "dock"]


def test_dock_with_a_height_of_its_own_entered_from_above(start):
    user = owner(start, ABOVE, dock_fixed_z="False", safe_dock_distance=None)
    printer = user.printer
    user.begin()
    user.press("Next")
    user.go("Z30", "X50 Y308", "Z14")
    user.jog("Z", -2.0)
    user.press("Here")
    user.go("X90")
    user.press("Here")
    user.go("Z30", "X50")
    for label in ("Here", "Same", "Fetch", "Dock"):
        user.press(label)
    assert where(printer) == "docked"
    assert "approach_position: 50.000, 308.000, 30.000" in (user.dialog().text)
    # No lower than the probe hangs
    printer.run(f"{SETUP} STEP=ABORT\n{SETUP}\nG1 Z20")
    user.put_on()
    user.press("Next")
    printer.run(f"{SETUP} STEP=DOCK Z=-10")
    assert "would lead to" in printer.fail(f"{SETUP} STEP=DOCK Z=-10")


def test_what_does_not_fit_is_asked_again(start):
    user = owner(start)
    printer = user.printer
    printer.machine.world.lose_probe(printer.now())
    user.begin()
    assert "the probe is DOCKED" in user.refused("Next")
    assert user.dialog().text.startswith("Not done: dockable_probe: the pr")
    user.put_on()
    user.press("Next")
    user.go("X50 Y270", "Y308")
    user.press("Here")
    # Out with it
    user.go("Y270")
    assert "the probe is ATTACHED" in user.refused("Here")
    user.go("Y308", "X60")
    assert "this is 10.0 mm from the dock" in user.refused("Here")
    user.go("X90")
    user.press("Here")
    # The same way
    user.go("X95")
    assert "this is the way out without the probe" in user.refused("Here")
    assert "Z stays as it is here" in printer.fail(f"{SETUP} STEP=APPROACH Z=1")


def test_trial_that_fails(start):
    user = owner(start, faults=[Fault("attach_fails")])
    user.come_to("FETCH")
    assert "the probe was not fetched" in user.refused("Fetch")
    assert user.step() == "FETCH"
    user.press("Fetch")
    user.press("Dock")
    assert where(user.printer) == "docked"


def test_slow_and_around_what_was_found(start):
    user = owner(start)
    user.come_to("FETCH")
    before = user.printer.now()
    user.press("Fetch")
    user.printer.run("M400")
    # Twice 38 mm at 10 mm/s
    assert user.printer.now() - before > 7.5
    user.go("X150 Y270")
    # Not before it is saved
    assert "nothing says where the dock is" in user.printer.fail(
        "MOVE_TO_APPROACH_PROBE"
    )


def test_section_that_is_not_set_up(start):
    changes = section(**UNKNOWN)
    printer = start(SWITCH, changes).homed()
    lines = "\n".join(printer.session.console)
    assert "set it up with DOCKABLE_PROBE_SETUP" in lines
    for command in ("ATTACH_PROBE", "PROBE", "MOVE_AVOIDING_DOCK X=1"):
        assert "nothing says where the dock is" in printer.fail(command)
    # Nothing to do is nothing to refuse
    printer.run("DETACH_PROBE\nG28\nGET_PROBE_STATUS")


def test_not_homed(start):
    printer = start(SWITCH, section(**UNKNOWN))
    printer.session.require_ready()
    user = Owner(printer)
    user.put_on()
    user.begin()
    assert "not homed: X, Y; home first (G28 X Y)" in user.refused("Next")


# A hand may have moved it, and what the host says of X and Y is as before
@pytest.mark.parametrize("step", ["DOCK", "OUT", "APPROACH", "INSERT"])
def test_place_is_not_taken_where_the_motors_are_off(start, step):
    user = owner(start)
    user.come_to(step)
    user.look_and_jog(step)
    user.printer.run("M84")
    text = user.refused("Here")
    assert "not homed: X, Y, and it is not known where the toolhead is" in text
    assert "by hand, and home (G28 X Y)" in text
    assert user.step() == step


# The second time the dock is entered the same way.  What 'Save' has written the first
# time does not stay in force, nor what SAVE_CONFIG has refused then.
@pytest.mark.parametrize("is_refused", [False, True])
def test_two_set_ups_in_a_row(start, is_refused):
    user = owner(start, more=SAVE_THAT_FAILS if is_refused else None)
    printer = user.printer
    user.come_to("INSERT")
    user.go("Y262")
    for label in ("Here", "Fetch", "Dock"):
        user.press(label)
    assert "insert_position: 50.000, 262.000" in user.dialog().text
    if is_refused:
        user.refused("Save")
        user.press("Abort")
    else:
        printer.session.restart(user.dialog().gcode("Save"))
        printer.run("G28")
    user.go("X150 Y150 Z20")
    user.put_on()
    user.come_to("FETCH")
    for label in ("Fetch", "Dock"):
        user.press(label)
    assert "insert_position: 50.000, 270.000" in user.dialog().text
    if is_refused:
        user.refused("Save")
    script = "SAVE_CONFIG_BASE" if is_refused else user.dialog().gcode("Save")
    printer.session.restart(script)
    settings = printer.status("configfile")["settings"]["dockable_probe"]
    assert tuple(settings["insert_position"]) == (50.0, 270.0)


# 28 mm before the dock, where klippy refuses 38; 28.0179 is not rounded up
@pytest.mark.parametrize(
    ("given", "place", "wanted"),
    [
        ("38", "X50", "28.000"),
        ("38", "X51", "28.017"),
        ("27", "X50", None),
        (None, "X50", None),
    ],
)
def test_way_around_the_dock_fits_what_was_found(start, given, place, wanted):
    user = owner(start, safe_dock_distance=given)
    user.come_to("APPROACH")
    user.look_and_jog("APPROACH")
    user.go(f"Y280 {place}")
    for label in ("Here", "Same", "Fetch", "Dock"):
        user.press(label)
    line = f"safe_dock_distance: {wanted}\n"
    assert (line in user.dialog().text) is (wanted is not None)
    user.printer.session.restart(user.dialog().gcode("Save"))
    user.printer.session.require_ready()
    settings = user.printer.status("configfile")["settings"]["dockable_probe"]
    distance = float(wanted or given or 28.0)
    assert settings["safe_dock_distance"] == pytest.approx(distance)
    user.printer.run("G28\nG90\nG1 X150 Y150 Z20 F6000\nPROBE")
    assert where(user.printer) == "docked"


# It goes up and down with the toolhead, which is so much higher there
def test_z_of_a_dock_at_the_height_of_the_head_is_kept(start):
    placed = {
        name: FRAME.sections["dockable_probe"][name]
        for name in ("dock_position", "approach_position", "detach_position")
    }
    user = owner(start, FRAME, **placed)
    user.go("Z40", "X44 Y200")
    user.begin()
    user.press("Next")
    user.go("X2")
    user.press("Here")
    user.go("Y240")
    user.press("Here")
    user.go("X44", "Y200")
    for label in ("Here", "Same"):
        user.press(label)
    assert "dock 2.000, 200.000, 8.000, out to" in user.dialog().text
    user.press("Fetch")
    # As high as it will be
    user.go("Z9")
    user.press("Dock")
    assert user.position()[2] == pytest.approx(WAY + 8.0)
    assert "dock_position: 2.000, 200.000, 8.000\n" in user.dialog().text
    assert user.dialog().text.count("200.000, 8.000") == 1


# In the dock one tells that it is on the toolhead, the other that it is docked
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"check_open_attach": None},
        {"probe_sense_pin": None},
        {"dock_sense_pin": None},
        {"check_open_attach": None, "probe_sense_pin": None},
        {"check_open_attach": None, "dock_sense_pin": None},
    ],
    ids=lambda options: ", ".join(options) or "all",
)
def test_with_sensors(start, options):
    user = sensed(start, **options)
    user.come_to("FETCH")
    for label in ("Fetch", "Dock"):
        user.press(label)
    assert where(user.printer) == "docked"
    user.printer.session.restart(user.dialog().gcode("Save"))
    user.printer.run("G28")
    assert where(user.printer) == "docked"


@pytest.mark.parametrize(
    ("signal", "words"),
    [
        ("probe_sense", "probe_sense_pin reads open, dock_sense_pin reads TRI"),
        (
            "dock_sense",
            "probe_sense_pin reads TRIGGERED, dock_sense_pin reads o",
        ),
    ],
)
def test_sensor_that_says_nothing_in_the_dock(start, signal, words):
    user = sensed(start)
    user.come_to("DOCK")
    user.look_and_jog("DOCK")
    user.printer.machine.break_down(Fault("stuck_open", signal=signal, t=0.0))
    text = user.refused("Here")
    assert (
        "the probe is not on the toolhead and in the dock at once (pin " in text
    )
    assert words in text
    wanted = (
        "probe_sense_pin TRIGGERED, dock_sense_pin TRIGGERED, pin open; the"
    )
    assert f"expected {wanted}" in text
    assert user.step() == "DOCK"


def sensed(start, **options):
    """An owner of sensors, whose Z is homed with the probe."""
    printer = start(SENSED, section(**{**UNKNOWN, **QUICK, **options}))
    printer.session.require_ready()
    printer.run("G28 X Y")
    user = Owner(printer)
    user.put_on()
    return user
