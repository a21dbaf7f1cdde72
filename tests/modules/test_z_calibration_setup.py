"""Z_CALIBRATION_SETUP on the simulated printer: forwards, aborted, disturbed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import SCENES
from simprinter.docks import calibrating
from simprinter.hosts.session import GcodeError
from tools.kit.cases import slow
from tools.kit.dockable_probe import SWITCH, trips, where
from tools.kit.setup_user import EMPTY, SETUP, User
from tools.kit.z_calibration import (
    MICROSTEP,
    calibration,
    section,
    touched_sites,
)

# Where the nozzle and the body of the switch are over the pin
CARTESIAN = {"nozzle": (226.0, 20.0), "switch": (254.0, 14.5)}


def empty(**changes):
    """The section before anything is known."""
    return {**section(**{**EMPTY, **changes.pop("options", {})}), **changes}


def pending(printer):
    return printer.status("configfile")["save_config_pending_items"]


@pytest.mark.every_host
def test_from_an_empty_section_to_the_true_gap(start):
    # Z is homed beside the middle of the pin, and the nozzle stays on it
    home = {"home_xy_position": "227.3, 20.4", "z_hop": None}
    printer = start("cartesian", changes=empty(safe_z_home=home)).homed()
    user = User(printer)
    user.begin()
    user.test_switches()
    user.set_places(**CARTESIAN)
    user.touch()
    # Nobody leaves the nozzle as low as that
    height = user.position()[2]
    user.press("Paper")
    assert user.position()[2] < height - 1.0
    user.press("Back")
    assert user.position()[2] > height
    user.press("Paper")
    user.lower_to_the_sheet()
    user.press("Here")
    assert user.step() == "SAVE"
    assert pending(printer) == {}
    printer.session.restart(user.dialog().gcode("Save"))
    assert user.dialog() is None
    printer.run("G28")
    result, _ = calibration(printer)
    settings = printer.status("configfile")["settings"]["z_calibration"]
    # The probe over the middle, as nothing says where else
    assert settings["bed_xy_position"] == pytest.approx((125.0, 110.5))
    assert settings["nozzle_xy_position"] == pytest.approx(
        (226.0, 20.0), abs=0.06
    )
    # Paper is as exact as its steps, and its gap is in switch_offset
    assert result[3] == pytest.approx(0.7, abs=0.015)
    x, y = settings["bed_xy_position"]
    gap = printer.gap((x, y))
    assert gap == pytest.approx(0.7 - result[3], abs=2 * MICROSTEP)


def test_separate_pin_in_no_section_and_a_switch_from_the_list(start, tmp_path):
    path = tmp_path / "tools.cfg"
    path.write_text("[z_calibration]\nswitch_offset: 0.1\n")
    changes = empty(options={"switch_offset": None})
    # The pin higher than the probe hangs
    scene = SCENES["separate_pin"]
    scene = scene.with_world(pin=replace(scene.world.pin, z=10.9012))
    printer = start(scene, changes={f"include {path}": {}, **changes})
    printer.session.require_ready()
    user = User(printer, "nozzle_endstop")
    user.begin()
    user.test_switches(is_fixed=True)
    user.press("Home")
    # By hand, as far as it is
    printer.run("G90\nG1 X205.9 Y305.9 F12000")
    user.jog_to(206.0, 306.0)
    for label in ("Here", "Attach", "Here", "Here", "Yes", "Yes", "Yes"):
        user.press(label)
    user.touch()
    # The probe cannot be taken off
    assert "the nozzle cannot reach the sheet" in user.refused("Paper")
    assert (
        user.dialog().texts[0].startswith("Not done: z_calibration: the probe")
    )
    assert "TYPE=X: none of D2F, SSG" in printer.fail(
        f"{SETUP} STEP=GAP TYPE=X"
    )
    assert "outside offset_margins" in printer.fail(
        f"{SETUP} STEP=GAP VALUE=1.5"
    )
    user.press("D2F")
    text = user.dialog().texts[0]
    assert (
        "nozzle_xy_position: 206.000, 306.000; switch_xy_position: 208" in text
    )
    assert (
        "SAVE_CONFIG cannot: write 'switch_offset: 0.200' into line 2 of"
        in text
    )
    assert text.endswith("tools.cfg.")
    # As high as that CALIBRATE_Z has to pass
    assert "safe_z_height: 21.5" in text
    assert "All in all: good; samples: 3 is enough." in text
    printer.session.restart(user.dialog().gcode("Save"))
    path.write_text("[z_calibration]\nswitch_offset: 0.5\n")
    printer.session.restart("RESTART")
    printer.run("G28")
    calibration(printer)
    place = printer.status("configfile")["settings"]["z_calibration"]
    gap = printer.gap(tuple(place["bed_xy_position"]))
    assert gap == pytest.approx(0.0, abs=2 * MICROSTEP)


# All that a D2F may have: 5.5 +-0.3 mm over a body of 5.0
@pytest.mark.slow
@pytest.mark.parametrize("switch_offset", [0.2, slow(0.5), 0.8])
def test_button_of_a_switch_leaves_no_nozzle_in_the_bed(start, switch_offset):
    scene = SCENES["cartesian"]
    probe = replace(scene.world.mag_probe, switch_offset=switch_offset)
    printer = start(scene.with_world(mag_probe=probe), changes=empty()).homed()
    user = User(printer)
    user.begin()
    user.test_switches()
    user.set_places(**CARTESIAN)
    user.touch()
    text = user.dialog().texts[0]
    assert user.dialog().footer_buttons[0][0] == "Paper"
    assert text.index("'Paper' measures that, and is best") < text.index("D2F")
    assert "D2F 0.2 mm, SSG 0.2 mm, the least of any healthy one" in text
    user.press("D2F")
    text = user.dialog().texts[0]
    assert "With the 0.2 mm of any D2F Z=0 is too high on purpose: come" in text
    assert "(CALCULATE_SWITCH_OFFSET), or with baby steps and Z_CAL" in text
    # Paper is right, and says nothing of that
    user.press("Back")
    user.press("Paper")
    user.lower_to_the_sheet()
    user.press("Here")
    assert "on purpose" not in user.dialog().texts[0]
    user.press("Back")
    user.press("D2F")
    printer.session.restart(user.dialog().gcode("Save"))
    assert said_on_purpose(printer.run("G28\nCALIBRATE_Z")) == 1
    own = printer.status("configfile")["settings"]["z_calibration"]
    gap = printer.gap(tuple(own["bed_xy_position"]))
    assert gap == pytest.approx(switch_offset - 0.2, abs=2 * MICROSTEP)
    # Once, whether somebody keeps it or not
    assert said_on_purpose(printer.run("CALIBRATE_Z")) == 0
    printer.session.restart("RESTART")
    assert said_on_purpose(printer.run("G28\nCALIBRATE_Z")) == 0


def said_on_purpose(lines):
    return sum("so Z=0 is too high on purpose" in line for line in lines)


def advance(user, step):
    """From the beginning to a step."""
    places = (CARTESIAN["nozzle"], CARTESIAN["switch"])
    user.begin()
    user.by_hand(user.pin)
    if step == "OFF":
        return
    user.test_probe()
    if step != "HOME":
        user.press("Home")
    for place in places:
        if user.step() == step or step == "HOME":
            return
        user.jog_to(*place)
        user.press("Here")
        if user.step() == "ATTACH":
            user.press("Attach")
    for label in (
        "Here",
        "Yes",
        "Yes",
        "Yes",
        "Touch",
        "Touch",
        "Touch",
        "Paper",
    ):
        if user.step() == step:
            return
        user.press(label)


def assert_slow(printer):
    """At most 2 mm/s over the 5 mm that the head is lifted in between."""
    for site in ("nozzle_pin", "body_pin"):
        times = [t.t for t in printer.machine.truth.touches if t.site == site]
        assert times[-1] - times[-2] > 2.5, site


def test_abort_leaves_the_printer_as_it_was(start):
    changes = empty(options={"probing_second_speed": "9"})
    # What the owner's G-code adds is taken back, too
    changes["gcode_macro DOCK_PROBE"] = {
        "gcode": "\n  SET_GCODE_OFFSET Z_ADJUST=0.3\n  SET_PIN PIN=probe_magnet"
        " VALUE=0\n  G4 P500"
    }
    printer = start("cartesian", changes=changes)
    printer.session.require_ready()
    user = User(printer)
    printer.run("SET_GCODE_OFFSET Z=0.1")
    before = printer.status("toolhead")["homed_axes"]
    for step in ("OFF", "NOZZLE", "SWITCH", "TOUCH_SWITCH", "PAPER"):
        advance(user, step)
        assert user.step() == step
        if step == "OFF":
            assert printer.status("toolhead")["homed_axes"] == before
        else:
            printer.run("G91\nG1 Z-0.5 F600\nG90")
        if step == "PAPER":
            # Up to here, and no further
            user.press("Z-0.1")
            assert_slow(printer)
        lines = user.press("Abort")
        assert any(
            "the set-up has ended, nothing was saved" in li for li in lines
        )
        assert user.dialog() is None
        assert pending(printer) == {}
        assert printer.offset() == pytest.approx(0.1)
        printer.session.wait(1.0)
        if step != "OFF":
            assert printer.session.position()[2] > 11.4
        assert where(printer) == "docked"
        assert "no set-up is under way" in printer.fail(f"{SETUP} STEP=ABORT")
        if step == "OFF":
            # Nothing has moved: there was no G28 yet
            printer.run("G28")


def test_hands_on_the_wrong_switch(start):
    printer = start("cartesian", changes=empty())
    printer.session.require_ready()
    user = User(printer)
    assert "no set-up is under way" in printer.fail(f"{SETUP} STEP=PIN")
    user.begin()
    hold = printer.machine.hold
    # Attached, as the other one has to be seen changing
    hold("probe", False)
    hold(user.pin, True)
    pin = "'endstop_pin: ^!PC2' in section 'stepper_z' (line "
    text = user.refused("Watch")
    assert (
        f"the Z endstop reads pressed before anything presses it; check {pin}"
        in text
    )
    assert "the other polarity is 'endstop_pin: ^PC2'" in text
    # The dialog says so, as it hides the console
    assert text in user.dialog().texts[0]
    hold(user.pin, False)
    clock = printer.machine.simulation.clock
    began = clock.now()
    command = printer.session.begin(user.dialog().gcode("Watch"))
    printer.session.wait(1.0)
    assert printer.status("z_calibration")["phase"] == "setup"
    with pytest.raises(GcodeError, match="the Z endstop did not change; check"):
        printer.session.finish(command)
    assert 19.5e9 < clock.now() - began < 21.5e9
    for signal, others, words in (
        ("probe", [], "did not change, but the other switch did: the pins are"),
        (user.pin, ["probe"], "changed together with the other switch"),
    ):
        with pytest.raises(GcodeError, match=words):
            user.by_hand(signal, after=False, others=others)
    hold(user.pin, True)
    hold(user.pin, False)
    user.by_hand(user.pin, after=False)
    # One that is pressed twice
    text = printer.fail(f"{SETUP} STEP=PIN")
    assert text == (
        "z_calibration: STEP=pin is not what is asked now, which is STEP=off;"
        " Z_CALIBRATION_SETUP shows it again"
    )
    assert "the probe reads as if it were attached" in user.refused("Next")
    assert printer.status("toolhead")["homed_axes"] == ""
    assert touched_sites(printer) == []
    user.press("Skip")
    hold("probe", True)
    text = user.refused("Watch")
    assert "the probe reads pressed before anything presses it" in text
    assert "'pin: ^PC3' in section 'probe' (line " in text
    assert "ANSWER=SKIP is none of STEP=probe" in printer.fail(
        f"{SETUP} STEP=PROBE ANSWER=SKIP"
    )


def assert_heights_and_probe_are_watched(user):
    """After the first touches of the nozzle; ends with a restart."""
    printer = user.printer
    # Z was homed again in between
    printer.run("G28 Z")
    text = user.refused("Touch")
    assert "the heights hold no more, the first touches begin again" in text
    assert user.step() == "TOUCH_NOZZLE"
    user.press("Touch")
    # It falls off on its way
    command = printer.session.begin(user.dialog().gcode("Touch"))
    seen = len(touched_sites(printer))
    printer.session.run_until(
        command, lambda: len(touched_sites(printer)) > seen + 1
    )
    # It would be in the way of the emergency stop
    assert user.dialog() is None
    machine = printer.machine
    machine.world.lose_probe(
        machine.rig.seconds(machine.simulation.clock.now())
    )
    with pytest.raises(GcodeError, match="switch: "):
        printer.session.finish(command)
    assert user.step() == "TOUCH_SWITCH"
    assert printer.session.position()[2] > 11.4
    # Left, and taken up again
    printer.run('RESPOND type="command" msg="action:prompt_end"')
    printer.run(SETUP)
    assert user.step() == "TOUCH_SWITCH"
    printer.session.restart("RESTART")
    text = printer.fail(f"{SETUP} STEP=TOUCH_SWITCH")
    assert "no set-up is under way, a restart ends it, too" in text
    assert user.dialog() is None


def assert_jogs_are_limited(printer):
    """At the nozzle's place, 11.5 mm high; leaves the head low."""
    for params, words in (
        ("X=+10.1", "the head is moved by at most 10 mm at once"),
        ("Y=-25", "at most 10 mm"),
        ("Z=-10", "Z=-10 would lead to 1.500, outside 1.500 to 250.000"),
        ("Z=nan", "Z"),
    ):
        if params == "Z=-10":
            # As low as that, and no lower
            printer.run(f"{SETUP} STEP=NOZZLE Z=-10")
            params, words = "Z=-0.1", "would lead to 1.400, outside 1.500 to"
        assert words in printer.fail(f"{SETUP} STEP=NOZZLE {params}")


def test_places_that_cannot_be_and_a_probe_that_is_lost(start):
    changes = empty()
    changes["stepper_x"] = {"position_max": "254.5"}
    printer = start("cartesian", changes=changes)
    printer.session.require_ready()
    user = User(printer)
    advance(user, "HOME")
    printer.machine.hold("probe", False)
    assert "the probe is on the head, and would hit" in user.refused("Home")
    assert printer.status("toolhead")["homed_axes"] == ""
    printer.machine.hold("probe", None)
    user.press("Home")
    assert user.step() == "NOZZLE"
    at = printer.session.position()
    # Not homed any more
    printer.run("M84")
    for label in ("X+1", "Here"):
        assert "not homed: X, Y, Z; home all axes (G28) first" in user.refused(
            label
        )
    printer.run("G28\nG90\nG1 Z11.5 F600\nG1 X226 Y20 F6000")
    assert_jogs_are_limited(printer)
    assert printer.session.position()[:2] == pytest.approx(at[:2])
    user.press("Here")
    assert printer.session.position()[2] == pytest.approx(11.5)
    # It does not come, for once
    printer.machine.hold("probe", True)
    assert "neither start_gcode nor before_switch_gcode has" in user.refused(
        "Attach"
    )
    printer.machine.hold("probe", None)
    user.press("Attach")
    assert printer.session.position()[:2] == pytest.approx((254.0, 14.5))
    assert "X=1 would lead to 255.000" in user.refused("X+1")
    user.press("Back")
    assert user.step() == "NOZZLE"
    assert printer.session.position()[:2] == pytest.approx((226.0, 20.0))
    for label in ("Here", "Attach", "Here"):
        user.press(label)
    printer.run("M84")
    text = user.refused("Back")
    assert "not homed, and the probe is on the head: unless Z is homed" in text
    printer.run("DOCK_PROBE")
    assert "not homed: X" in user.refused("Back")
    printer.run("G28")
    # Back from where the head has not got to
    user.press("Back")
    assert user.step() == "NOZZLE"
    for label in ("Here", "Attach", "Here"):
        user.press(label)
    # The point of the bed beside the pin
    bed = printer.session.position()
    printer.run("G1 X250 Y15 F6000")
    assert "choose a point of the bed at least 7 mm away" in user.refused(
        "Here"
    )
    printer.run(f"G1 X{bed[0]} Y{bed[1]} F6000")
    for label in ("Here", "Yes", "Yes", "Yes", "Touch"):
        user.press(label)
    assert_heights_and_probe_are_watched(user)


def test_not_during_a_print(start, tmp_path):
    (tmp_path / "long.gcode").write_text("G4 P500\n" * 40)
    changes = {**empty(), "virtual_sdcard": {"path": str(tmp_path)}}
    printer = start("cartesian", changes=changes)
    printer.session.require_ready()
    user = User(printer)
    advance(user, "SWITCH")
    printer.run("G91\nG1 Z-5 F600\nG90")
    at = printer.session.position()
    printer.run("SDCARD_PRINT_FILE FILENAME=long.gcode")
    for script in (SETUP, f"{SETUP} STEP=SWITCH"):
        assert printer.fail(script) == "z_calibration: not during a print"
    # The print would go on at another height
    lines = "\n".join(user.press("Abort"))
    assert "printing or not homed, so nothing was moved; the probe" in lines
    assert printer.session.position() == at
    assert where(printer) == "attached"
    assert user.dialog() is None


def test_pin_that_presses_the_plunger(start):
    scene = SCENES["cartesian"]
    probe = replace(scene.world.mag_probe, plunger_on_pin=True)
    fetch = {"before_switch_gcode": "\n  ATTACH_PROBE\n  RESPOND MSG=fetched"}
    changes = {"respond": {}, **empty(options=fetch)}
    printer = start(scene.with_world(mag_probe=probe), changes=changes)
    printer.session.require_ready()
    user = User(printer)
    advance(user, "TOUCH_SWITCH")
    seen = len(printer.session.console)
    for _ in range(2):
        text = user.refused("Touch")
        assert "the pin presses the plunger of the probe" in text
    # What is on the head is not fetched again
    console = printer.session.console[seen:]
    assert sum("fetched" in line for line in console) == 1
    # To another place then
    user.press("Back")
    assert user.step() == "SWITCH"


def test_probe_that_fetches_itself(start):
    printer = start(calibrating(SWITCH), changes=empty())
    printer.session.require_ready()
    user = User(printer)
    user.begin()
    user.test_switches()
    user.press("Home")
    # In front of the dock
    printer.run("G90\nG1 X50 Y270 F12000\nG1 Y294")
    assert "14.0 mm from dock_position" in user.refused("Here")
    printer.run("G1 Y270\nG1 X206\nG1 Y306")
    for label in ("Here", "Attach", "Here"):
        user.press(label)
    assert where(printer) == "attached"
    for label in ("Here", "Yes", "Yes", "Yes", "Touch"):
        user.press(label)
    user.press("Touch")
    user.press("Touch")
    assert where(printer) == "docked"
    user.press("SSG")
    assert trips(printer) == ["attach", "dock"] * 2
    printer.session.restart(user.dialog().gcode("Save"))
    printer.run("G28\nCALIBRATE_Z")
    own = printer.status("configfile")["settings"]["z_calibration"]
    gap = printer.gap(tuple(own["bed_xy_position"]))
    # Whatever the switch of this probe is
    real = printer.scene.world.mag_probe.switch_offset
    assert gap == pytest.approx(real - 0.2, abs=2 * MICROSTEP)
