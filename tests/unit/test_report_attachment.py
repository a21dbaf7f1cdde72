"""What an owner attaches when he asks has no names of persons, places, computers."""

from __future__ import annotations

import pytest

from z_touch.report.attachment import (
    commands_of,
    harmless,
    sections_of,
    value_of,
    without_names,
)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "cannot read /home/anna/printer_data/config/a.cfg: x",
            "cannot read <path>: x",
        ),
        ("in ~/mine/a.cfg, line 3", "in <path>, line 3"),
        ("see https://anna.example/hook?key=1 now", "see <address> now"),
        ("ask anna@example.org", "ask <address>"),
        ("from 192.168.1.7:7125", "from <address>"),
        ("on Annas-Printer it is", "on <name> it is"),
        (
            "z=1.500, 3/8 of 2.0 mm and 12/2026",
            "z=1.500, 3/8 of 2.0 mm and 12/2026",
        ),
    ],
)
def test_names_are_left_out(text, told):
    assert without_names(text, ["annas-printer"]) == told


def test_of_gcode_there_are_the_names_of_commands():
    template = """
        {% if printer.idle %}
          ATTACH_PROBE SPEED=3
        {% endif %}
        RUN_SHELL_COMMAND CMD=tell ; with key 123
        M118 anna's printer
    """
    assert commands_of(template) == "ATTACH_PROBE RUN_SHELL_COMMAND M118"
    told = value_of("start_gcode", template, [])
    assert told == "runs ATTACH_PROBE RUN_SHELL_COMMAND M118"
    assert value_of("end_gcode", "", []) == ""


@pytest.mark.parametrize(
    ("template", "commands"),
    [
        ("M117 Hello {name} Smith", "M117"),
        ("M118 key={k} s3cr3t {% if a %}tok123{% endif %}", "M118"),
        ('{action_respond_info("a } hunter2")}\nG28', "G28"),
        ("{action_raise_error('anna\\'s')} s3cr3t", ""),
        ("G1 X{x} Y{y} F{f}\n  G28 Z", "G1 G28"),
        ("{# for anna #} G28 # and tom", "G28"),
        ("{% if a %} G28 {% endif %}", "G28"),
        ("M118 open { s3cr3t\nG28", "M118"),
    ],
)
def test_nothing_behind_a_value_is_a_command(template, commands):
    assert commands_of(template) == commands


@pytest.mark.parametrize(
    "option", ["serial", "canbus_uuid", "api_token", "filename", "host"]
)
def test_private_options_have_no_value(option):
    assert value_of(option, "abc123", []) == "(left out)"


def test_only_sections_that_count_are_told():
    settings = {
        "mcu": {"serial": "/dev/serial/by-id/1234"},
        "gcode_macro wifi": {"gcode": "M118 secret"},
        "stepper_z1": {"endstop_pin": "^PA1"},
        "bed_mesh": {"mesh_min": [10.0, 20.0]},
        "bed_mesh default": {"points": "1, 2"},
        "z_calibration": {"switch_offset": 0.44, "history": "/home/anna/h"},
    }
    assert list(sections_of(settings, "z_calibration", [])) == [
        "[z_calibration]",
        "history: <path>",
        "switch_offset: 0.44",
        "",
        "[bed_mesh]",
        "mesh_min: 10.0, 20.0",
        "",
        "[stepper_z1]",
        "endstop_pin: ^PA1",
        "",
    ]


def test_texts_anywhere_in_a_record():
    record = {"ok": False, "reason": "see /a/b", "sites": {"bed": [1.0, None]}}
    wanted = {**record, "reason": "see <path>"}
    assert harmless(record, []) == wanted
