"""EXTRA_PROBE_CALIBRATE: the true gap, what is asked, what is saved."""

from __future__ import annotations

import pytest

from simprinter import heated
from simprinter.world import NoiseSpec
from tools.kit.cases import slow
from tools.kit.dialogs import dialogs_of
from tools.kit.extra_probe import (
    ABORT,
    BED,
    CALIBRATE,
    CONTINUE,
    MICROSTEP,
    NAME,
    POINT,
    PROBE_BED,
    THICKNESS,
    as_probe,
    calibrate,
    heights,
    lay,
    membrane,
    press,
    section,
    state,
    touch,
    true_gap,
)
from tools.kit.klipper_sections import TOOL
from tools.kit.printer import has_kinematics, saved_before
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import refusal, with_moves

SCENE_NAMES = ["membrane", "membrane_and_probe"]
BEDS = {"membrane": BED, "membrane_and_probe": PROBE_BED}
# What SAVE=1 corrects in each of them
HOMED_AT = {
    "membrane": ("stepper_z", "position_endstop", 0.0),
    "membrane_and_probe": ("probe", "z_offset", 2.0),
}


def gap_is_right(printer):
    """The nozzle meets the bed at Z=0, where the membrane lay."""
    return true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)


# The gap


@pytest.mark.parametrize("scene", [*SCENE_NAMES, "membrane_two_boards"])
def test_gap_is_right_afterwards(start, scene):
    printer = start(scene).homed()
    assert not gap_is_right(printer)
    lines = calibrate(printer)
    bed = BEDS.get(scene, BED)
    assert printer.offset() == pytest.approx(bed, abs=2 * MICROSTEP)
    assert gap_is_right(printer)
    assert lines[-1] == (
        f"// extra_probe membrane: trigger={bed_of(printer) + THICKNESS:.6f}"
        f" - z_offset=0.250 --> new offset={bed_of(printer):.6f}"
    )
    # Nothing is pressed but the membrane
    assert len(heights(printer)) == 3
    assert printer.machine.truth.deepest_in_bed() == 0.0


def bed_of(printer):
    return printer.status(NAME)["last_offset"]


@pytest.mark.parametrize("own", [{}, {"samples_result": "average"}])
def test_sampling_is_that_of_the_section(start, own):
    noise = NoiseSpec(sigma=0.01)
    changes = section(samples="3", samples_tolerance="1", **own)
    printer = start(membrane(noise=noise), changes=changes, seed=3).homed()
    lines = touch(printer)
    z = [float(x.split("z=")[1]) for x in lines if x.startswith("// probe at")]
    wanted = sum(z) / 3 if own else sorted(z)[1]
    assert sum(z) / 3 != pytest.approx(sorted(z)[1], abs=1e-4)
    printer.run(CONTINUE)
    assert printer.offset() == pytest.approx(wanted - THICKNESS, abs=2e-6)


@pytest.mark.parametrize(
    ("z_offset", "low"),
    [
        (
            2.5,
            ["That is low; check that the switch is z_offset=2.500 mm thick."],
        ),
        (THICKNESS, []),
    ],
)
def test_decimal_point_too_many_is_asked_for(start, z_offset, low):
    # Z=0 would be that far in the bed
    changes = section(z_offset=str(z_offset))
    printer = start("membrane", changes=changes).homed()
    (shown,) = dialogs_of(touch(printer))
    told, *hints = shown.texts
    bed = float(told.rstrip(".").split("z=")[-1])
    assert bed == pytest.approx(BED + THICKNESS - z_offset, abs=MICROSTEP)
    assert hints == ["Continue makes that Z=0.", *low]


@pytest.mark.parametrize("asks", ["switch", "removal"])
def test_nozzle_of_another_extruder_is_another_height(start, tmp_path, asks):
    warm = tmp_path / "warm"
    warm.write_text("25000")
    tool = {"extruder1": {**TOOL, "sensor_path": str(warm)}}
    printer = start(heated(SCENES["membrane"]), changes=tool).homed()
    if asks == "removal":
        touch(printer)
    else:
        printer.run(CALIBRATE)
        lay(printer)
    printer.run("ACTIVATE_EXTRUDER EXTRUDER=extruder1")
    text = printer.fail(CONTINUE)
    assert "another extruder is active since the calibration began" in text
    assert printer.offset() == 0.0


# Saved


@pytest.mark.parametrize("scene", SCENE_NAMES)
def test_saved_and_homed_again(start, scene):
    name, option, before = HOMED_AT[scene]
    printer = start(scene).homed()
    # That of before counts no more
    printer.run("SET_GCODE_OFFSET Z=0.3")
    lines = calibrate(printer, f"{CALIBRATE} SAVE=1")
    new = before - BEDS[scene]
    pending = state(printer)["pending"]
    assert float(pending[name][option]) == pytest.approx(new, abs=0.004)
    assert pending[NAME] == {"saved_homing_z": pending[name][option]}
    assert f"// {name}: {option}: {pending[name][option]}" in "\n".join(lines)
    # Nothing counts twice; it tells what was measured, though that is not applied
    assert printer.offset() == 0.0
    last = printer.status(NAME)["last_offset"]
    assert last == pytest.approx(BEDS[scene], abs=0.005)
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert printer.offset() == 0.0
    assert gap_is_right(printer)
    # And again: there is nothing left to correct
    lines = touch(printer)
    printer.machine.lay_membrane(False)
    printer.run(CONTINUE)
    assert abs(printer.offset()) <= 2 * MICROSTEP


@pytest.mark.parametrize("scene", SCENE_NAMES)
def test_saved_twice_before_a_restart(start, scene):
    # The second one measures in the frame of the first
    printer = start(scene).homed()
    calibrate(printer, f"{CALIBRATE} SAVE=1")
    calibrate(printer, f"{CALIBRATE} SAVE=1")
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert gap_is_right(printer)


@pytest.mark.every_host("only hosts since 2025-05 have generic_cartesian")
def test_saving_where_z_is_a_carriage(start, host):
    if not has_kinematics(host, SCENES["membrane_generic"]):
        pytest.skip("the host has no generic_cartesian")
    printer = start("membrane_generic").homed()
    calibrate(printer, f"{CALIBRATE} SAVE=1")
    saved = state(printer)["pending"]["carriage z"]["position_endstop"]
    assert float(saved) == pytest.approx(-BED, abs=0.004)
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert gap_is_right(printer)


@pytest.mark.every_host("what the buttons save is theirs")
@pytest.mark.parametrize(
    ("scene", "button"),
    [
        ("membrane", "Z_OFFSET_APPLY_ENDSTOP"),
        ("membrane_and_probe", "Z_OFFSET_APPLY_PROBE"),
    ],
)
def test_button_does_not_overwrite_what_waits(start, scene, button):
    """It counts from the value of before: the nozzle would be in the bed after SAVE_CONFIG."""
    name, option, _ = HOMED_AT[scene]
    printer = start(scene).homed()
    calibrate(printer, f"{CALIBRATE} SAVE=1")
    before = state(printer)["pending"]
    assert "Z Offset is 0" in "\n".join(printer.run(button))
    step = "SET_GCODE_OFFSET Z_ADJUST=-0.05 MOVE=1"
    printer.run(step)
    text = printer.fail(button)
    waits = f"{option}: {before[name][option]} of section '{name}' waits for"
    assert f"{NAME}: {waits} SAVE_CONFIG, and {button}" in text
    assert state(printer)["pending"] == before
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert gap_is_right(printer)
    # And then it may
    printer.run(step)
    printer.run(button)
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert true_gap(printer) == pytest.approx(-0.05, abs=2 * MICROSTEP)


def test_saving_with_a_bltouch(start):
    # It homes with what the inductive probe of the machine senses
    probe = SCENES["membrane_and_probe"].sections["probe"]
    options = {k: v for k, v in probe.items() if k != "pin"}
    changes = {
        "probe": None,
        "bltouch": {
            "sensor_pin": probe["pin"],
            "control_pin": "PH5",
            "pin_up_reports_not_triggered": "False",
            "pin_up_touch_mode_reports_triggered": "False",
            **options,
        },
    }
    printer = start("membrane_and_probe", changes=changes).homed()
    calibrate(printer, f"{CALIBRATE} SAVE=1")
    new = float(state(printer)["pending"]["bltouch"]["z_offset"])
    assert new == pytest.approx(2.2713, abs=2 * MICROSTEP)


def test_saving_where_nobody_knows_the_zero(start, tmp_path):
    source = tmp_path / "scanner.py"
    source.write_text(
        "class Scanner:\n"
        "    def __init__(self, config):\n"
        "        self.printer = config.get_printer()\n"
        "        self.pins = self.printer.lookup_object('pins')\n"
        "        self.pins.register_chip('scanner', self)\n"
        "    def setup_pin(self, kind, params):\n"
        "        endstop = self.pins.setup_pin('endstop', '^PC2')\n"
        "        endstop.get_position_endstop = lambda: 0.\n"
        "        return endstop\n"
        "def load_config(config):\n"
        "    return Scanner(config)\n"
    )
    changes = {
        "scanner": {},
        "force_move": {"enable_force_move": "true"},
        "stepper_z": {
            "endstop_pin": "scanner:z_virtual_endstop",
            "position_endstop": None,
        },
    }
    modules = {**with_moves(), "scanner": source}
    printer = start("membrane", changes=changes, modules=modules)
    printer.session.require_ready()
    # Some hosts can home only with a probe of theirs there
    printer.run("SET_KINEMATIC_POSITION X=0 Y=0 Z=10")
    text = printer.fail(f"{CALIBRATE} SAVE=1")
    assert text == (
        "extra_probe membrane: SAVE=1: it is not known where Z gets its zero with"
        " 'scanner:z_virtual_endstop'; leave SAVE out"
    )
    # Without it is all the same
    printer.run(CALIBRATE)
    assert printer.status(NAME)["waits_for"] == "switch"


# The floor, and what is told of it

FLOOR_LINE = "Continue lowers the nozzle. If the switch does not answer, it stops at Z={:.3f}"
UNSAVED = "which can be inside the bed"


@pytest.mark.parametrize(
    ("own", "params", "floor", "is_told"),
    [
        ({}, "", -1.0, True),
        ({"position_min": "-0.3"}, " FLOOR=0.2", 0.2, False),
        # The axis ends at -3
        ({}, " FLOOR=-4", -3.0, False),
        # Saved: half of 0.25 mm, or of 1 mm
        ({"saved_homing_z": "0.12"}, "", 0.125, False),
        ({"saved_homing_z": "0", "z_offset": "1"}, "", 0.5, False),
        ({"saved_homing_z": "0", "position_min": "-0.7"}, "", -0.7, False),
        # Something else was done to position_endstop since
        ({"saved_homing_z": "0.13"}, "", -1.0, True),
    ],
)
def test_floor(start, own, params, floor, is_told):
    printer = start("membrane", changes=section(**own)).homed()
    text = "\n".join(printer.run(CALIBRATE + params))
    # Nobody has laid the membrane; where that is unsafe it was pressed at least
    printer.machine.tolerate("nozzle_bed", 4.0)
    if is_told:
        assert FLOOR_LINE.format(floor) not in text
        assert "the switch was not pressed after" in printer.fail(CONTINUE)
        text = "\n".join(press(printer))
    assert FLOOR_LINE.format(floor) in text
    assert (UNSAVED in text) is is_told
    text = printer.fail(CONTINUE)
    assert f"(stopped at z={floor:.3f})" in text
    lowest = printer.machine.truth.min_gap
    assert lowest == pytest.approx(floor - BED, abs=0.01)


def test_saved_with_a_probe_that_homes(start):
    # Its z_offset is what counts
    changes = section(saved_homing_z="2")
    printer = start("membrane_and_probe", changes=changes).homed()
    text = "\n".join(printer.run(CALIBRATE))
    assert FLOOR_LINE.format(0.125) in text


def assert_right_once_saved(printer, section):
    """SAVE=1 changes that section, and after G28 Z=0 is the bed."""
    calibrate(printer.homed(), f"{CALIBRATE} SAVE=1")
    pending = printer.status("configfile")["save_config_pending_items"]
    assert set(pending) == {section, NAME}
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)


@pytest.mark.every_host(
    "until 2024-07 and on Kalico it homes Z to position_endstop"
)
def test_saved_where_a_probe_homes_to_something_else(host, start):
    """Some hosts ask for position_endstop there, and home Z to that."""
    probe = dict(SCENES["membrane_and_probe"].sections["probe"])
    changes = {
        "probe": None,
        "smart_effector": {**probe, "recovery_time": "0"},
        "stepper_z": {"position_endstop": "1.7"},
    }
    printer = start("membrane_and_probe", changes=changes)
    kind, message = printer.session.start()
    if kind == "error":
        assert "'position_endstop' is not valid" in message
        pytest.skip(f"{host.name}: {message.splitlines()[0]}")
    assert_right_once_saved(printer, "stepper_z")


def test_saved_where_a_switch_has_left_its_height(start):
    """As Z_ENDSTOP_CALIBRATE had saved it: hosts pass over it and say nothing."""
    printer = start("membrane_and_probe")
    printer.session.require_ready()
    saved_before(printer, "stepper_z", "position_endstop = -0.5")
    assert_right_once_saved(printer, "probe")


# The way


def test_way_to_the_membrane(start):
    changes = {"moves": {}, **section(safe_z_height="12")}
    printer = start("membrane", changes=changes, modules=with_moves()).homed()
    before = len(printer.status("moves")["ends"])
    printer.run(CALIBRATE)
    ends = printer.status("moves")["ends"][before:]
    # Up, then across, and there before anybody is asked
    assert [end[2] for end in ends] == pytest.approx([12.0, 12.0])
    assert ends[-1][:2] == list(POINT)
    tip = printer.machine.tip()
    assert (tip.x, tip.y) == pytest.approx(POINT, abs=0.02)
    lay(printer)
    printer.run(CONTINUE)
    assert printer.session.position()[2] == pytest.approx(12.0)


def test_head_that_is_higher(start):
    # Not slowly all the way
    printer = start("membrane").homed()
    printer.run(f"G1 Z80 F900\n{CALIBRATE}")
    assert printer.session.position()[2] == pytest.approx(80.0)
    lay(printer)
    clock = printer.machine.simulation.clock
    before = clock.now()
    printer.run(CONTINUE)
    # 70 mm at lift_speed, 10 mm at speed, and two more touches
    assert (clock.now() - before) * 1e-9 < 16.0
    assert printer.session.position()[2] == pytest.approx(10.0)
    printer.run(CONTINUE)
    assert gap_is_right(printer)


def test_without_a_position_it_is_where_the_head_is(start):
    changes = section(xy_position=None)
    scene = membrane(x=100.0, y=60.0)
    printer = start(scene, changes=changes).homed()
    printer.run("G1 Z5 F900\nG1 X101 Y61 F6000")
    calibrate(printer)
    assert printer.gap((101.0, 61.0)) == pytest.approx(0.0, abs=2 * MICROSTEP)


def test_switch_may_be_taken_away_with_the_head_aside(start):
    printer = start("membrane").homed()
    touch(printer)
    printer.run("G1 X150 Y150 F6000")
    printer.machine.lay_membrane(False)
    printer.run(CONTINUE)
    assert gap_is_right(printer)


# What is asked


def test_questions(start):
    printer = start("membrane").homed()
    lines = printer.run(CALIBRATE)
    (first,) = dialogs_of(lines)
    # For those who see no dialog; the first line closes one that may be open
    answers = f"// {NAME}: then {CONTINUE}, or {ABORT}"
    assert lines[1].startswith(f"// {NAME}: Lay the switch on the bed.")
    assert lines[2] == answers

    def buttons(question):
        go_on = f"{CONTINUE} QUESTION={question.upper()}"
        return [("Continue", go_on, "primary"), ("Abort", ABORT, "error")]

    assert first.headline == "Step 1 of 3: Lay the switch on the bed"
    assert first.is_open
    assert first.texts == [
        "Flat and right below the nozzle, which is clean.",
        "Continue waits until you press the switch once with a finger.",
    ]
    first.assert_stands_alone()
    assert first.footer_buttons == buttons("switch")
    assert printer.status(NAME)["waits_for"] == "switch"
    lay(printer)
    hand = dialogs_of(printer.session.console)[-1]
    assert hand.headline == "Step 2 of 3: Take your hand away"
    assert hand.texts == [
        "The switch was pressed, and works.",
        "Keep a hand on the emergency stop.",
        "Continue lowers the nozzle. If the switch does not answer, it stops at"
        " Z=-1.000, which can be inside the bed.",
    ]
    hand.assert_stands_alone()
    assert hand.footer_buttons == buttons("hand")
    assert printer.status(NAME)["waits_for"] == "hand"
    lines = printer.run(CONTINUE)
    # Closed before anything is touched
    assert lines[0] == "// action:prompt_end"
    (second,) = dialogs_of(lines)
    assert answers in lines
    assert any("Take the switch away. Triggered at" in line for line in lines)
    z = BED + THICKNESS
    assert second.headline == "Step 3 of 3: Take the switch away"
    assert second.is_open
    text, last = second.texts
    assert last == "Continue makes that Z=0."
    told = float(text.split("z=")[1].split(",")[0])
    assert told == pytest.approx(z, abs=2 * MICROSTEP)
    assert second.footer_buttons == buttons("removal")
    assert printer.status(NAME)["waits_for"] == "removal"
    assert printer.offset() == 0.0
    lines = printer.run(CONTINUE)
    assert dialogs_of(lines) == []
    assert lines[0] == "// action:prompt_end"
    assert printer.status(NAME)["waits_for"] == ""


def test_button_that_is_pressed_twice(start):
    # The second press waits until the touch has ended
    printer = start("membrane").homed()
    (first,) = dialogs_of(printer.run(f"{CALIBRATE} SAVE=1"))
    lay(printer)
    go_on = first.gcode("Continue")
    told = "QUESTION=switch is not what is asked now, which is hand"
    assert printer.fail(go_on) == f"{NAME}: {told}"
    assert printer.status(NAME)["waits_for"] == "hand"
    go_on = dialogs_of(printer.session.console)[-1].gcode("Continue")
    text = printer.fail(f"{go_on}\n{go_on}")
    told = "QUESTION=hand is not what is asked now, which is removal"
    assert text == f"{NAME}: {told}"
    assert printer.status(NAME)["waits_for"] == "removal"
    assert state(printer)["pending"] == {}
    second = dialogs_of(printer.session.console)[-1]
    assert second.is_open
    printer.run(second.footer_buttons[0][1])
    assert state(printer)["pending"] != {}


# The nozzle's temperature


@pytest.mark.parametrize(
    ("own", "celsius", "outcome"),
    [
        ({}, 55, ""),
        ({}, 65, "warning"),
        ({"max_temperature": "100"}, 105, "100 C; let it cool down"),
        slow({"max_temperature": "200"}, 150, "warning"),
    ],
)
def test_temperature(start, own, celsius, outcome):
    printer = start(heated(SCENES["membrane"]), changes=section(**own)).homed()
    printer.run(f"M104 S{celsius}")
    if outcome not in ("", "warning"):
        text = printer.fail(CALIBRATE)
        assert f"the nozzle has, or is to have, {celsius}" in text
        assert outcome in text
        return
    (dialog,) = dialogs_of(printer.run(CALIBRATE))
    warning = "The nozzle has, or is to have, "
    assert (warning in dialog.text) is (outcome == "warning")
    assert ("a membrane may melt." in dialog.text) is bool(outcome)


def test_nozzle_that_is_still_hot(start):
    printer = start(heated(SCENES["membrane"])).homed()
    text = printer.fail(f"M109 S140\nM104 S0\n{CALIBRATE}")
    assert "max_temperature is 120 C; let it cool down" in text


@pytest.mark.parametrize("celsius", [80, 130])
def test_nozzle_that_is_heated_while_somebody_is_asked(start, celsius):
    printer = start(heated(SCENES["membrane"])).homed()
    printer.run(CALIBRATE)
    lay(printer)
    printer.run(f"M104 S{celsius}")
    if celsius > 120:
        assert "max_temperature is 120 C" in printer.fail(CONTINUE)
        assert heights(printer) == []
        return
    lines = printer.run(CONTINUE)
    warning = f"// {NAME}: The nozzle has, or is to have, {celsius} C: a"
    assert any(line.startswith(warning) for line in lines)


# [probe] is the membrane


@pytest.mark.every_host("the touches are those of the host's own probe then")
@pytest.mark.parametrize("save", [False, True])
def test_membrane_that_is_the_probe(start, save):
    printer = start("membrane", changes=as_probe()).homed()
    printer.run(f"EXTRA_PROBE_CALIBRATE PROBE=probe SAVE={save:d}")
    lay(printer)
    printer.run("EXTRA_PROBE_CONTINUE PROBE=probe")
    assert len(heights(printer)) == 3
    printer.machine.lay_membrane(False)
    printer.run("EXTRA_PROBE_CONTINUE PROBE=probe")
    if save:
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28")
        assert printer.offset() == 0.0
        text = "\n".join(printer.run("EXTRA_PROBE_CALIBRATE PROBE=probe"))
        assert FLOOR_LINE.format(0.125) in text
    assert gap_is_right(printer)


def test_floor_of_a_membrane_that_is_the_probe(start):
    printer = start("membrane", changes=as_probe(position_min="0.2")).homed()
    # The bed is higher than that, and nothing lies on it
    printer.machine.tolerate("nozzle_bed", 0.27)
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=probe")
    text = printer.fail("EXTRA_PROBE_CONTINUE PROBE=probe")
    assert "No trigger" in text
    assert "(stopped at z=0.200); check the probe with QUERY_PROBE" in text
    printer.session.wait(2.0)
    assert printer.session.position()[2] == pytest.approx(10.0)


def test_own_options_of_a_membrane_that_is_the_probe(start):
    own = {"samples": "2", "z_offset": "0.35", "speed": "1.5"}
    changes = as_probe(**own)
    printer = start("membrane", changes=changes).homed()
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=probe")
    lay(printer)
    clock = printer.machine.simulation.clock
    before = clock.now()
    printer.run("EXTRA_PROBE_CONTINUE PROBE=probe")
    # 9.3 mm at 1.5 mm/s
    assert (clock.now() - before) * 1e-9 > 6.0
    assert len(heights(printer)) == 2
    printer.run("EXTRA_PROBE_CONTINUE PROBE=probe")
    printer.machine.lay_membrane(False)
    assert true_gap(printer) == pytest.approx(-0.1, abs=2 * MICROSTEP)


def test_probe_has_commands_of_its_own(start):
    printer = start("membrane", changes=as_probe()).homed()
    for command in ("EXTRA_PROBE", "QUERY_EXTRA_PROBE"):
        lines = printer.run(f"{command} PROBE=probe")
        assert f'Unknown command:"{command}"' in lines[-1]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"probe": None}, "is missing or no switch on a pin"),
        ({"probe": {"x_offset": "1"}}, "has an x_offset or y_offset"),
        ({"probe": {"y_offset": "-2"}}, "has an x_offset or y_offset"),
        (
            {
                "stepper_z": {
                    "endstop_pin": "probe:z_virtual_endstop",
                    "position_endstop": None,
                }
            },
            "homes Z, and so finds nothing new",
        ),
    ],
)
def test_probe_that_is_no_membrane(host, changes, words):
    merged = as_probe()
    for name, options in changes.items():
        known = merged.get(name) or {}
        merged[name] = None if options is None else {**known, **options}
    message = refusal(host, merged, "membrane")
    assert message.startswith("Section 'extra_probe probe' stands for [probe]")
    assert words in message


def test_pin_of_a_section_that_stands_for_the_probe(host):
    message = refusal(host, as_probe(pin="^!PF5"), "membrane")
    assert "Option 'pin' is not valid in section 'extra_probe probe'" in message


# Two at a time


def test_other_section_is_not_asked(start):
    options = {"pin": "^PG5", "z_offset": "0.3"}
    changes = {"extra_probe other": options}
    printer = start("membrane", changes=changes).homed()
    printer.run(CALIBRATE)
    text = printer.fail("EXTRA_PROBE_CONTINUE PROBE=other")
    assert text == (
        "extra_probe other: nothing was asked; begin with EXTRA_PROBE_CALIBRATE"
        " PROBE=other"
    )
    # It has closed the dialog, not the question
    printer.machine.lay_membrane()
    press(printer)
    printer.run(CONTINUE)
    printer.machine.lay_membrane(False)
    printer.run(CONTINUE)
    assert gap_is_right(printer)


def test_other_section_asks_already(start):
    changes = {
        **as_probe(),
        "extra_probe other": {"pin": "^PG5", "z_offset": "0.3"},
    }
    printer = start("membrane", changes=changes).homed()
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=other")
    at = printer.session.position()
    text = printer.fail("EXTRA_PROBE_CALIBRATE PROBE=probe")
    assert "section 'extra_probe other' waits for an answer" in text
    assert printer.session.position() == at
    printer.run("EXTRA_PROBE_ABORT PROBE=other")
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=probe")
