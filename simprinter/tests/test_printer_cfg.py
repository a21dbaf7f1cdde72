"""What a printer.cfg says of its machine."""

from __future__ import annotations

import pytest

from simprinter import printer_cfg
from simprinter.printer_cfg import PrinterCfgError
from simprinter.running import SAMPLE

CFG = (SAMPLE / "printer.cfg").read_text(encoding="utf-8")


def read(folder, text):
    file = folder / "printer.cfg"
    file.write_text(text, encoding="utf-8")
    return printer_cfg.read(file)


def test_steps_are_as_long_as_klippy_makes_them(tmp_path):
    cfg = read(
        tmp_path,
        f"{CFG}[stepper_y]\ngear_ratio: 80:16, 2:1\nmicrosteps: 32\n"
        "full_steps_per_rotation: 400\n",
    )
    motors = cfg.motors()
    assert motors["x"].step_dist == 40.0 / (200 * 16)
    assert motors["y"].step_dist == 40.0 / (400 * 32 * 5 * 2)
    assert motors["x"].enable_pin == "!PA2"


def test_included_files_are_part_of_it(tmp_path):
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "a.cfg").write_text("[fan]\npin: PD1#cools\n")
    (tmp_path / "more" / "b.cfg").write_text(
        "[gcode_macro HELLO]\ngcode:\n  {% if 1 %}\n\n    M117 hi\n  {% endif %}"
    )
    cfg = read(tmp_path, f"[include more/*.cfg]\n{CFG}")
    assert cfg.get("fan", "pin") == "PD1"
    kept = cfg.for_klippy(frozenset(["fan"]))
    assert "fan" not in kept
    macro = kept["gcode_macro HELLO"]["gcode"]
    assert [line.strip() for line in macro.splitlines()] == [
        "",
        "{% if 1 %}",
        "",
        "M117 hi",
        "{% endif %}",
    ]
    # How its owner reaches the board is of no use here
    assert kept["mcu"] == {}


def test_what_was_saved_is_part_of_it_and_comes_last(tmp_path):
    saved = """
#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
#*# [probe]
#*# z_offset = 2.25
#*# samples = 3
#*#
#*# [bed_mesh default]
#*# points =
#*# \t  0.1, 0.2
#*# \t  0.3, 0.4
"""
    cfg = read(tmp_path, CFG + saved)
    assert cfg.get("probe", "z_offset") == "1.5"
    assert cfg.get("probe", "samples") == "3"
    points = cfg.get("bed_mesh default", "points")
    assert points.split() == ["0.1,", "0.2", "0.3,", "0.4"]


def test_pins_are_those_of_a_board(tmp_path):
    cfg = read(
        tmp_path,
        f"{CFG}"
        "[board_pins]\naliases: STOP=PC7, EMPTY=<GND>\n"
        "[mcu tool]\n[board_pins tool]\nmcu: tool\naliases: STOP=gpio3\n"
        "[tmc2209 stepper_x]\nuart_pin: PE0\nuart_address: 2\n"
        "diag_pin: ^PE1\nrun_current: 1\n"
        "[a]\nb: ^!STOP\nc: tool: STOP\nd: probe:z_virtual_endstop\n"
        "e: tmc2209_stepper_x:virtual_endstop\n",
    )
    assert cfg.pin("a", "b") == "^!PC7"
    assert cfg.pin("a", "c") == "tool:gpio3"
    assert cfg.pin("a", "d") is None
    assert cfg.pin("a", "e") == "^PE1"
    assert cfg.pin("a", "f") is None
    assert cfg.boards() == ["tool"]
    motor = cfg.motors()["x"]
    assert (motor.uart, motor.address) == ("PE0", 2)


def test_diag_pin_takes_the_place_of_a_driver_that_is_left_out(tmp_path):
    text = CFG.replace(
        "endstop_pin: ^PC0", "endstop_pin: tmc5160_stepper_x:virtual_endstop"
    )
    cfg = read(
        tmp_path,
        f"{text}[tmc5160 stepper_x]\ncs_pin: PE2\ndiag1_pin: !PE1\n",
    )
    everything = cfg.for_klippy(frozenset())
    assert "virtual" in everything["stepper_x"]["endstop_pin"]
    kept = cfg.for_klippy(frozenset(["tmc5160 stepper_x"]))
    assert kept["stepper_x"]["endstop_pin"] == "!PE1"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("step_pin: PA0", "step_pin: PZ0", ["[stepper_x] step_pin", "'PZ0'"]),
        ("step_pin: PA0", "", ["[stepper_x] step_pin is missing"]),
        (
            "distance: 8",
            "distance: x",
            ["[stepper_z] rotation_distance", "'x'"],
        ),
        ("[stepper_y]", "[other]", ["[stepper_y]", "each axis"]),
        ("microsteps: 16", "", ["[stepper_x] microsteps is missing"]),
        ("kinematics: cartesian", "", ["[printer] kinematics is missing"]),
        ("[mcu]", "[include no.cfg]\n[mcu]", ["there is no no.cfg"]),
        ("[mcu]", "[include printer.cfg]\n[mcu]", ["includes itself"]),
        ("[mcu]", "nothing\n[mcu]", ["klippy cannot read this either"]),
    ],
)
def test_nonsense_is_refused_with_file_section_and_option(
    tmp_path, old, new, told
):
    with pytest.raises(PrinterCfgError) as error:
        cfg = read(tmp_path, CFG.replace(old, new, 1))
        cfg.motors()
        assert cfg.kinematics
    assert all(text in str(error.value) for text in told), error.value
    assert str(tmp_path / "printer.cfg") in str(error.value)


def test_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(PrinterCfgError, match="cannot be read"):
        printer_cfg.read(tmp_path / "no.cfg")
