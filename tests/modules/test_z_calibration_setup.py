"""Z_CALIBRATION_SETUP on the simulated printer: forwards, aborted, disturbed."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.hosts.session import GcodeError
from tools.kit.cases import slow
from tools.kit.dockable_probe import SWITCH, trips, where
from tools.kit.docks import calibrating
from tools.kit.klipper_sections import TOOL
from tools.kit.scenes import SCENES, heated
from tools.kit.setup_user import EMPTY, SETUP, User, open_dialog
from tools.kit.z_calibration import (
    LIFT,
    MICROSTEP,
    calibration,
    pending,
    section,
    touched_sites,
    with_extra,
)

# Where the nozzle and the body of the switch are over the pin
CARTESIAN = {"nozzle": (226.0, 20.0), "switch": (254.0, 18.0)}


def empty(**changes):
    """The section before anything is known."""
    return {**section(**{**EMPTY, **changes.pop("options", {})}), **changes}


def user_at(start, step, scene="cartesian", changes=None):
    """A printer, and somebody who has come so far from an empty section."""
    printer = start(scene, changes=changes or empty())
    printer.session.require_ready()
    user = User(printer)
    user.come_to(step)
    return printer, user


def test_from_an_empty_section_to_the_true_gap(start):
    # Z is homed beside the middle of the pin, and the nozzle stays on it
    home = {"home_xy_position": "227.3, 20.4", "z_hop": None}
    printer = start("cartesian", changes=empty(safe_z_home=home)).homed()
    user = User(printer)
    user.begin()
    user.test_switches()
    user.set_places(**CARTESIAN)
    user.touch()
    # Each click a step of the twelve
    assert (user.clicks, user.step()) == (9, "GAP")
    assert user.dialog().headline.startswith("Step 10 of 12: ")
    # Nobody leaves the nozzle as low as that
    height = user.position()[2]
    user.press("Paper")
    assert user.position()[2] < height - 1.0
    user.press("Back")
    assert user.position()[2] > height
    user.press("Paper")
    assert user.has("Z-1 mm")
    assert "Still too high: lower it" in user.dialog().text
    text = user.refused("Here")
    assert "still too high, by 1.900 mm at least" in text
    # Just where a switch that does not move would hold it
    for label in ("Z-1 mm", *["Z-0.1 mm"] * 9):
        user.press(label)
    assert "Still too high: lower it" in user.dialog().text
    assert "still too high, by 0.000 mm at least" in user.refused("Here")
    user.lower_to_the_sheet()
    # No room for larger steps
    assert not user.set_width(1.0)
    assert "until it just holds the sheet" in user.dialog().text
    user.press("Here")
    # Without the way back, and with Save, twelve
    assert (user.clicks, user.step()) == (9 + 4, "SAVE")
    assert pending(printer) == {}
    printer.session.restart(user.dialog().gcode("Save"))
    assert user.dialog() is None
    printer.run("G28")
    result, _ = calibration(printer)
    settings = printer.status("configfile")["settings"]["z_calibration"]
    assert settings["samples"] == "auto"
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


def test_separate_pin_in_no_section_and_a_switch_from_the_list(start):
    # The pin higher than the probe hangs
    scene = SCENES["separate_pin"]
    scene = scene.with_world(pin=replace(scene.world.pin, z=10.9012))
    printer = start(scene, changes=empty())
    printer.session.require_ready()
    user = User(printer, "nozzle_endstop")
    user.begin()
    user.test_switches(is_fixed=True)
    user.press("Home")
    # By hand, as far as it is
    printer.run("G90\nG1 X205.9 Y305.9 F12000")
    user.jog_to(206.0, 306.0)
    user.press("Here")
    # Along the body, as it says
    assert user.position()[:2] == pytest.approx((208.0, 281.25))
    said = "then the toolhead lifts to Z=21.0 and moves to X=208.0 Y=281.2"
    assert any(said in line for line in printer.session.console)
    # The probe's body is on the same toolhead
    printer.run("G1 X100 F12000")
    text = user.refused("Here")
    assert "the switch cannot be 108.9 mm from the nozzle" in text
    printer.run("G1 X208 F12000")
    user.jog("X", 4.0)
    for label in ("Here", "Here", "Yes"):
        user.press(label)
    user.touch()
    # The probe cannot be taken off
    assert "the nozzle cannot reach the sheet" in user.refused("Paper")
    assert user.dialog().text.startswith("Not done: z_calibration: the probe")
    assert "TYPE=X: none of D2F, SSG" in printer.fail(
        f"{SETUP} STEP=GAP TYPE=X"
    )
    assert "outside the -1.000 to 1.000 that are allowed" in printer.fail(
        f"{SETUP} STEP=GAP VALUE=1.5"
    )
    for value, is_told in (("0.099", True), ("0.1", False)):
        printer.run(f"{SETUP} STEP=GAP VALUE={value}")
        text = "0.099 mm is less than any healthy switch moves: did the nozzle"
        assert (text in user.dialog().text) is is_told
        user.press("Back")
    user.press("D2F 0.2 mm")
    text = user.dialog().text
    assert "any healthy switch" not in text
    lines = text.splitlines()
    assert "nozzle_xy_position: 206.000, 306.000" in lines
    assert "switch_xy_position: 212.000, 281.250" in lines
    assert "switch_offset: 0.200" in lines
    # As high as that CALIBRATE_Z has to pass
    assert "safe_z_height: 21.5" in text
    assert "All in all: good; 3 touches of each place are enough." in text
    printer.session.restart(user.dialog().gcode("Save"))
    printer.run("G28")
    calibration(printer)
    place = printer.status("configfile")["settings"]["z_calibration"]
    gap = printer.gap(tuple(place["bed_xy_position"]))
    assert gap == pytest.approx(0.3, abs=2 * MICROSTEP)


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
    text = user.dialog().text
    assert user.dialog().footer_buttons[0][0] == "Paper"
    assert "'Paper' measures that, and is best" in text
    assert "the least of any healthy one" in text
    user.press("D2F 0.2 mm")
    text = user.dialog().text
    assert "With the 0.2 mm of any D2F Z=0 is too high on purpose: come" in text
    assert "(CALCULATE_SWITCH_OFFSET), or with baby steps and Z_CAL" in text
    # Paper is right, and says nothing of that
    user.press("Back")
    user.press("Paper")
    user.lower_to_the_sheet()
    user.press("Here")
    assert "on purpose" not in user.dialog().text
    user.press("Back")
    user.press("D2F 0.2 mm")
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


PAD = ["X-{0} mm", "X+{0} mm", "Y-{0} mm", "Y+{0} mm", "Z-{0} mm", "Z+{0} mm"]


def test_jog_buttons_of_one_width(start):
    printer, user = user_at(start, "NOZZLE")
    # On a page of their own, as all would be ten
    for width, other in (("10", "1"), ("1", "0.1"), ("0.1", "10")):
        pad = [label.format(width) for label in PAD]
        assert user.labels() == [*pad, f"Steps of {other} mm", "Done"]
        user.press(f"Steps of {other} mm")
    assert user.dialog().last == "'Done' shows the answers; nothing moves."
    at = user.position()
    user.press("Done")
    assert user.labels() == ["Here", "Move", "Back", "Abort"]
    assert user.dialog().last.startswith("'Here' keeps the place")
    user.press("Move")
    assert user.has("X-10 mm")
    assert user.position() == at
    # Pressed twice it is the same
    for button in ("WIDTH=1", "JOG=0"):
        for _ in range(2):
            printer.run(f"{SETUP} STEP=NOZZLE {button}")
        assert user.has("X-1 mm" if button == "WIDTH=1" else "Here")
    # An error is answered by what can be answered, or by another jog
    printer.run("M84")
    assert "not homed" in user.refused("X+10 mm")
    assert user.has("X+10 mm")
    assert "not homed" in user.refused("Here")
    assert user.has("Move")
    printer.run("G28")
    user.go_to("SWITCH")
    # Along the body
    assert user.has("X+1 mm")
    user.go_to("BED")
    assert user.labels() == [
        *(label.format(10) for label in PAD[:4]),
        "Steps of 1 mm",
        "Here",
        "Back",
        "Abort",
    ]
    assert "Z stays as it is here" in printer.fail(f"{SETUP} STEP=BED Z=1")
    user.go_to("PAPER")
    for width, other in (("1", "0.1"), ("0.1", "0.01"), ("0.01", "1")):
        assert user.labels() == [
            *(label.format(width) for label in PAD[4:]),
            f"Steps of {other} mm",
            "Here",
            "Back",
            "Abort",
        ]
        user.press(f"Steps of {other} mm")
    user.lower_to_the_sheet()
    # Where there is no room for more
    user.set_width(0.1)
    assert user.has("Steps of 0.01 mm")
    user.set_width(0.01)
    assert user.has("Steps of 0.1 mm")


# Its nozzle may be longer
def test_heights_are_those_of_a_nozzle(start, tmp_path):
    heat = tmp_path / "temp"
    heat.write_text("25000")
    changes = {**empty(), "extruder1": {**TOOL, "sensor_path": str(heat)}}
    printer, user = user_at(
        start, "PAPER", heated(SCENES["cartesian"]), changes=changes
    )
    z = printer.session.position()[2]
    printer.run("ACTIVATE_EXTRUDER EXTRUDER=extruder1")
    text = user.refused("Z-0.1 mm")
    assert "extruder1 is active, and the pin was touched with extruder" in text
    assert "the heights hold no more, the first touches begin again" in text
    assert printer.session.position()[2] == z
    user.go_to("PAPER")


def test_hot_nozzle_is_told_before_it_touches(start):
    scene = heated(SCENES["cartesian"])
    printer, user = user_at(start, "TOUCH_NOZZLE", scene)
    printer.run("M104 S240")
    user.come_to("GAP")
    lines = "\n".join(printer.session.console)
    words = "at 240 C plastic oozes out of the nozzle: heat it to about 150"
    assert lines.count(words) == 1


def test_with_the_sheet_only_small_steps_lead_down_to_it(start):
    printer, user = user_at(start, "PAPER")
    at = user.position()
    for typed in ("Z=-10", "Z=-3"):
        text = printer.fail(f"{SETUP} STEP=PAPER {typed}")
        assert "would lead to" in text
    assert user.position() == pytest.approx(at)
    user.lower_to_the_sheet()
    # All that is left by then
    assert "would lead to" in printer.fail(f"{SETUP} STEP=PAPER Z=-1")
    assert printer.machine.truth.min_gap > 0.0


def test_bed_is_touched_below_a_feature_that_shifts_all(start, tmp_path):
    """Each touch is a step of its own: pin and bed are not compared."""
    changes = {**empty(), "extra": {}}
    printer = start(
        "cartesian",
        changes=changes,
        modules=with_extra(tmp_path, LIFT % ("True",)),
    )
    printer.session.require_ready()
    User(printer).come_to("PAPER")


def test_touches_are_slow(start):
    own = empty(options={"probing_second_speed": "9"})
    printer, _ = user_at(start, "GAP", changes=own)
    # At most 2 mm/s over the 5 mm that the toolhead is lifted in between
    for site in ("nozzle_pin", "body_pin"):
        times = [t.t for t in printer.machine.truth.touches if t.site == site]
        assert times[-1] - times[-2] > 2.5, site


def test_hands_on_the_wrong_switch(start):
    printer = start("cartesian", changes=empty())
    printer.session.require_ready()
    user = User(printer)
    user.begin()
    hold = printer.machine.hold
    # Attached, as the other one has to be seen changing
    hold("probe", False)
    hold(user.pin, True)
    pin = "'endstop_pin: ^!PC2' in section 'stepper_z' (the "
    text = user.refused("Watch")
    assert "the Z endstop reads pressed before anything presses it" in text
    assert f"and otherwise check {pin}" in text
    assert "(the other polarity: 'endstop_pin: ^PC2')" in text
    # The dialog says so, as it hides the console
    assert text in user.dialog().text
    hold(user.pin, False)
    clock = printer.machine.simulation.clock
    began = clock.now()
    command = printer.session.begin(user.dialog().gcode("Watch"))
    printer.session.wait(1.0)
    assert printer.status("z_calibration")["phase"] == "setup"
    again = (
        "the Z endstop was not pressed within 20 seconds; press it again, or"
    )
    with pytest.raises(GcodeError, match=again) as caught:
        printer.session.finish(command)
    assert f"again, or, if you did press it, check {pin}" in str(caught.value)
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
    assert "the probe reads as if it were attached" in user.refused("Next")
    assert printer.status("toolhead")["homed_axes"] == ""
    assert touched_sites(printer) == []
    user.press("Skip")
    hold("probe", True)
    text = user.refused("Watch")
    assert "the probe reads pressed before anything presses it" in text
    assert "'pin: ^PC3' in section 'probe' (the other polarity: " in text


def assert_heights_and_probe_are_watched(user):
    """Before the first touches."""
    printer = user.printer
    user.go_to("TOUCH_SWITCH")
    # Z was homed again in between
    printer.run("G28 Z")
    text = user.refused("Touch")
    assert "the heights hold no more, the first touches begin again" in text
    assert user.step() == "TOUCH_NOZZLE"
    user.go_to("TOUCH_SWITCH")
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


def assert_jogs_are_limited(printer):
    """At the nozzle's place, 11.5 mm high; leaves the toolhead low."""
    # As low as that, and no lower
    printer.run(f"{SETUP} STEP=NOZZLE Z=-9.5")
    assert "Z=2.00." in open_dialog(printer.session.console).text
    printer.run(f"{SETUP} STEP=NOZZLE Z=-10")
    assert printer.session.position()[2] == pytest.approx(1.5)
    text = printer.fail(f"{SETUP} STEP=NOZZLE Z=-0.1")
    assert "Z=-0.1 would lead to 1.400, outside 1.500 to 250.000" in text


def test_places_that_cannot_be_and_a_probe_that_is_lost(start):
    changes = empty()
    changes["stepper_x"] = {"position_max": "254.5"}
    printer, user = user_at(start, "HOME", changes=changes)
    printer.machine.hold("probe", False)
    assert "the probe is on the toolhead, and would hit" in user.refused("Home")
    assert printer.status("toolhead")["homed_axes"] == ""
    printer.machine.hold("probe", None)
    user.press("Home")
    assert user.step() == "NOZZLE"
    at = printer.session.position()
    # Not homed any more
    printer.run("M84")
    for label in ("X+1 mm", "Here"):
        assert "not homed: X, Y, Z; home all axes (G28) first" in user.refused(
            label
        )
    printer.run("G28\nG90\nG1 Z11.5 F600\nG1 X226 Y20 F6000")
    assert_jogs_are_limited(printer)
    assert printer.session.position()[:2] == pytest.approx(at[:2])
    # It does not come, for once
    printer.machine.hold("probe", True)
    assert "nothing has attached it; attach it by hand" in user.refused("Here")
    # The place of the nozzle is kept
    assert user.step() == "ATTACH"
    assert printer.session.position()[2] == pytest.approx(11.5)
    printer.machine.hold("probe", None)
    user.press("Attach")
    assert printer.session.position()[:2] == pytest.approx((254.0, 14.5))
    assert "X=1 would lead to 255.000" in user.refused("X+1 mm")
    user.press("Back")
    assert user.step() == "NOZZLE"
    assert printer.session.position()[:2] == pytest.approx((226.0, 20.0))
    for label in ("Here", "Here"):
        user.press(label)
    printer.run("M84")
    text = user.refused("Back")
    assert (
        "not homed, and the probe is attached; put it away unless Z is homed"
        in text
    )
    printer.run("DOCK_PROBE")
    assert "not homed: X" in user.refused("Back")
    printer.run("G28")
    # Back from where the toolhead has not got to
    user.press("Back")
    assert user.step() == "NOZZLE"
    for label in ("Here", "Here"):
        user.press(label)
    # The point of the bed beside the pin
    bed = printer.session.position()
    printer.run("G1 X250 Y15 F6000")
    assert "choose a point of the bed at least 7 mm away" in user.refused(
        "Here"
    )
    printer.run(f"G1 X{bed[0]} Y{bed[1]} F6000")
    for label in ("Here", "Yes"):
        user.press(label)
    assert_heights_and_probe_are_watched(user)


def test_owner_without_gcode_attaches_the_probe_by_hand(start):
    hooks = {"before_switch_gcode": None, "end_gcode": None}
    # It hangs beside the bed while the nozzle is on the pin
    bed = replace(SCENES["cartesian"].world.bed, x_max=180.0)
    scene = SCENES["cartesian"].with_world(bed=bed)
    printer, user = user_at(
        start, "NOZZLE", scene, changes=empty(options=hooks)
    )
    user.turn_to("Here")
    assert ", asks for the probe unless it is there, and" in user.dialog().text
    user.jog_to(*CARTESIAN["nozzle"])
    assert "nothing has attached it; attach it by hand" in user.refused("Here")
    assert user.step() == "ATTACH"
    # Whoever has no dialogs knows it, too
    (line,) = [li for li in printer.session.console if "STEP=ATTACH;" in li]
    assert line.startswith(
        "// z_calibration: Step 5 of 12: fetch the probe; At"
    )
    first = "Attach the probe by hand first, unless it is on the toolhead."
    assert first in user.dialog().text
    printer.run("ATTACH_PROBE")
    user.press("Attach")
    user.jog_to(*CARTESIAN["switch"])
    for label in ("Here", "Here", "Yes"):
        user.press(label)
    assert user.step() == "TOUCH_NOZZLE"
    assert first in user.dialog().text
    user.fail_after("touching the switch", True)
    assert user.step() == "TOUCH_SWITCH"
    assert first in user.dialog().text
    user.fail_after("touching the bed", False)
    assert user.step() == "TOUCH_BED"
    user.touch()
    assert user.step() == "GAP"
    # Whoever has such G-code is told what it does, see below
    assert not any("own G-code" in line for line in printer.session.console)


@pytest.mark.parametrize(
    "hooks",
    [
        {"before_switch_gcode": "ATTACH_PROBE", "start_gcode": None},
        {"before_switch_gcode": None, "start_gcode": "ATTACH_PROBE"},
    ],
    ids=["late", "early"],
)
def test_owner_with_gcode_is_told_what_it_does(start, hooks):
    printer, user = user_at(start, "NOZZLE", changes=empty(options=hooks))
    words = "fetches the probe by your own G-code unless it is there"
    user.turn_to("Here")
    assert words in user.dialog().text
    user.come_to("TOUCH_NOZZLE")
    words = "; your own G-code puts the probe away before, fetches it and"
    assert words in user.dialog().text
    assert "by hand first" not in user.dialog().text


def test_pin_that_presses_the_plunger(start):
    scene = SCENES["cartesian"]
    probe = replace(scene.world.mag_probe, plunger_on_pin=True)
    fetch = {"before_switch_gcode": "\n  ATTACH_PROBE\n  RESPOND MSG=fetched"}
    changes = {"respond": {}, **empty(options=fetch)}
    printer, user = user_at(
        start,
        "TOUCH_NOZZLE",
        scene.with_world(mag_probe=probe),
        changes=changes,
    )
    seen = len(printer.session.console)
    for _ in range(2):
        text = user.refused("Touch")
        assert "the pin presses the plunger of the probe" in text
        assert user.step() == "TOUCH_SWITCH"
    # What is on the toolhead is not fetched again
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
    assert "14.0 mm from the dock;" in user.refused("Here")
    printer.run("G1 Y270\nG1 X206\nG1 Y306")
    user.press("Here")
    user.jog("X", 4.0)
    user.press("Here")
    assert where(printer) == "attached"
    for label in ("Here", "Yes", "Touch"):
        user.press(label)
    assert where(printer) == "docked"
    user.press("SSG 0.2 mm")
    assert trips(printer) == ["attach", "dock"] * 2
    printer.session.restart(user.dialog().gcode("Save"))
    printer.run("G28\nCALIBRATE_Z")
    own = printer.status("configfile")["settings"]["z_calibration"]
    gap = printer.gap(tuple(own["bed_xy_position"]))
    # Whatever the switch of this probe is
    real = printer.scene.world.mag_probe.switch_offset
    assert gap == pytest.approx(real - 0.2, abs=2 * MICROSTEP)


@pytest.mark.parametrize("step", ["NOZZLE", "GAP"])
def test_probe_that_somebody_has_put_on_is_put_away_for_the_nozzle(start, step):
    printer, user = user_at(start, step)
    if step == "GAP":
        # All touches are to be made again
        printer.run("G28 Z")
        assert "first touches begin again" in user.refused("Paper")
    printer.run("ATTACH_PROBE")
    # Its body would be in the bed while the nozzle is on the pin
    if step == "GAP":
        user.press("Touch")
    user.go_to("GAP")
    printer.run("M400")
    assert where(printer) == "docked"
    user.go_to("SAVE")


# Whoever has no hooks yet has put it on himself, as the set-up has told him
def test_probe_that_nobody_puts_away_is_not_on_for_the_nozzle(start):
    hooks = {"before_switch_gcode": None, "end_gcode": None}
    section = {**empty()["z_calibration"], **hooks}
    printer, user = user_at(
        start, "NOZZLE", changes={**empty(), "z_calibration": section}
    )
    assert "nothing has attached it; attach it by hand" in user.refused("Here")
    printer.run("ATTACH_PROBE")
    for label in ("Attach", "Here", "Here", "Yes"):
        user.press(label)
    assert (
        "the probe is on the toolhead, and has touched the bed"
        in user.refused("Touch")
    )
    printer.machine.truth.require_no_crash()


# start_gcode brings it, and nobody takes it off: it stays on at the nozzle, beside
# which there is no bed
@pytest.mark.slow
def test_probe_that_is_there_for_all_sites(start):
    hooks = {
        "start_gcode": "\n  ATTACH_PROBE",
        "before_switch_gcode": None,
        "end_gcode": None,
    }
    bed = replace(SCENES["cartesian"].world.bed, x_max=180.0)
    scene = SCENES["cartesian"].with_world(bed=bed)
    printer = start(scene, changes=empty(options=hooks)).homed()
    user = User(printer)
    user.come_to("GAP")
    # All touches once more, with the probe on
    printer.run("G28 Z")
    assert "first touches begin again" in user.refused("Paper")
    armed = []
    printer.machine.rig.on_operation.append(
        lambda kind, signal, _ns: armed.append((kind, signal))
    )
    user.press("Touch")
    assert user.step() == "GAP"
    # It may be a longer one by now: its switch ends the way down to the pin
    assert [signal for kind, signal in armed if kind == "touch"][0] == "probe"


def test_dockable_probe_that_is_docked_by_itself_alone(start):
    off = {"auto_attach_detach": "False"}
    changes = empty(dockable_probe=off)
    printer = start(calibrating(SWITCH), changes=changes)
    printer.session.require_ready()
    user = User(printer)
    user.begin()
    user.test_switches()
    user.press("Home")
    printer.run("ATTACH_PROBE\nG90\nG1 X206 Y270 F12000\nG1 Y306")
    user.press("Here")
    user.jog("X", 4.0)
    for label in ("Here", "Here", "Yes", "Touch"):
        user.press(label)
    assert trips(printer)[:2] == ["attach", "dock"]


def test_nothing_is_lowered_beside_the_sheet_or_with_the_probe(start):
    printer, user = user_at(start, "PAPER")
    # By another client, over the pin and up again
    printer.run("G90\nG1 Z12 F600\nG1 X226 Y20 F6000")
    for label in ("Z-1 mm", "Z-0.1 mm", "Here"):
        text = user.refused(label)
        assert "the nozzle has left the sheet; 'Back', then 'Paper'" in text
    assert printer.session.position()[:3] == pytest.approx((226, 20, 12))
    for label in ("Back", "Paper"):
        user.press(label)
    printer.run("G91\nG1 X1.5 F6000\nG90")
    user.press("Z-0.1 mm")
    # The probe comes on the toolhead meanwhile
    printer.run("G90\nG1 Z12 F600\nATTACH_PROBE")
    assert "the nozzle cannot reach the sheet" in user.refused("Z-1 mm")
    assert printer.session.position()[2] == pytest.approx(12.0)
    printer.run("DOCK_PROBE")
    for label in ("Back", "Paper"):
        user.press(label)
    user.lower_to_the_sheet()
    user.press("Here")
    assert user.step() == "SAVE"


def test_one_look_at_all_places(start):
    printer, user = user_at(start, "SWITCH")
    # Nobody has looked for it yet
    assert "Now the plunger is about over the pin: move some 4 mm" in (
        user.dialog().text
    )
    user.jog("X", 1.0)
    assert "X=255.0 Y=14.5 Z=" in user.dialog().text
    user.press("Here")
    session = printer.session
    bed = session.position()[:2]
    command = session.begin(user.dialog().gcode("Here"))
    for words, place in (
        ("is the nozzle over the pin?", (226.0, 20.0)),
        ("is the body of the switch over the pin?", (255.0, 14.5)),
        ("is the probe over the point of the bed?", bed),
    ):
        # High up, and long enough to look
        session.run_until(command, lambda w=words: w in session.console[-1])
        for _ in range(3):
            at = session.position()
            assert at[:2] == pytest.approx(place, abs=0.06)
            assert at[2] > 11.4
            session.wait(1.0)
    session.finish(command)
    assert user.step() == "LOOK"
    looks = sum("Look: " in line for line in session.console)
    user.press("Again")
    assert user.step() == "LOOK"
    assert sum("Look: " in line for line in session.console) == 2 * looks
    user.press("Switch")
    assert user.step() == "SWITCH"
    assert session.position()[:2] == pytest.approx((255.0, 14.5), abs=0.06)
    assert "Now the plunger" not in user.dialog().text


@pytest.mark.slow
@pytest.mark.every_host("only Kalico's SAVE_CONFIG writes into included files")
def test_option_in_an_include_that_the_host_writes(start, host, tmp_path):
    """Kalico's SAVE_CONFIG reaches it where it is told to."""
    if not host.layout.module_dir.endswith("plugins"):
        pytest.skip(f"{host.name} writes into no included file")
    (tmp_path / "own.cfg").write_text("[z_calibration]\nswitch_offset: 0.1\n")
    changes = empty()
    changes[f"include {tmp_path}/own.cfg"] = {}
    changes["danger_options"] = {"autosave_includes": "True"}
    printer, user = user_at(start, "GAP", changes=changes)
    user.press("D2F 0.2 mm")
    printer.session.restart(user.dialog().gcode("Save"))
    own = printer.status("configfile")["settings"]["z_calibration"]
    assert own["switch_offset"] == 0.2
