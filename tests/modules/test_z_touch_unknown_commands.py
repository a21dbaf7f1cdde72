"""G-code of the user with a command that the printer does not know.

Klipper answers one with a line, not with an error, and goes on.
"""

from __future__ import annotations

import pytest

from simprinter.world import OozeSpec
from tools.kit.auto_z_offset import section as auto_z_section
from tools.kit.cases import slow
from tools.kit.dockable_probe import SWITCH, assert_safe
from tools.kit.dockable_probe import section as dockable_section
from tools.kit.docks import calibrating
from tools.kit.extra_probe import NAME
from tools.kit.extra_probe import section as extra_section
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import assert_unharmed, calibration, section

UNKNOWN = "is no command or macro of this printer; check how it is spelt"

# For each module: scene, changes with a name that is misspelt, the option, and what fails
OF_MODULES = {
    "auto_z_offset": (
        "qidi",
        auto_z_section(prepare_gcode="PREPARE_SENSOR"),
        "prepare_gcode",
        "AUTO_Z_CALIBRATE",
    ),
    "dockable_probe": (
        SWITCH,
        dockable_section(pre_attach_gcode="OPEN_DOKC"),
        "pre_attach_gcode",
        "ATTACH_PROBE",
    ),
    NAME: (
        "membrane",
        extra_section(activate_gcode="SWITCH_FANS_OF"),
        "activate_gcode",
        "EXTRA_PROBE PROBE=membrane",
    ),
}


def notes_of(printer, name):
    """The lines of a section about unknown commands, since klippy has started."""
    start = f"// {name}: "
    return [
        line
        for line in printer.session.console
        if line.startswith(start) and "is no command" in line
    ]


@pytest.mark.parametrize(
    "option",
    ["start_gcode", slow("before_switch_gcode"), "end_gcode", "offset_gcode"],
)
def test_run_fails_and_names_option_and_word(start, option):
    printer = start(changes=section(**{option: "ATACH_PROBE FAST=1"})).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    text = printer.fail("CALIBRATE_Z")
    assert f"z_calibration: {option}: ATACH_PROBE {UNKNOWN}" in text
    assert printer.status("z_calibration")["last_query"] is False
    assert_unharmed(printer, 0.3)


def test_clean_gcode_that_is_misspelt_does_not_clean(start):
    scene = SCENES["voron"].with_world(ooze=OozeSpec(0.05, 0.7))
    changes = section(clean_gcode="CLEAN_NOZZEL")
    printer = start(scene, changes=changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert f"clean_gcode: CLEAN_NOZZEL {UNKNOWN}" in text
    assert_unharmed(printer)


def test_macro_that_a_template_runs_is_heard(start):
    changes = {
        "gcode_macro PRINT_PREPARE": {"gcode": "\n  G90\n  ATACH_PROBE"},
        **section(start_gcode="PRINT_PREPARE"),
    }
    printer = start(changes=changes).homed()
    # Nothing of it can be seen at start
    assert notes_of(printer, "z_calibration") == []
    text = printer.fail("CALIBRATE_Z")
    assert f"start_gcode: ATACH_PROBE {UNKNOWN}" in text
    # What a person types is none of ours
    printer.run("ATACH_PROBE")
    assert "ATACH_PROBE" in printer.fail("CALIBRATE_Z")


def test_error_of_the_template_comes_first(start):
    code = "\n  ATACH_PROBE\n  G90\n  G1 X9999 F6000"
    printer = start(changes=section(start_gcode=code)).homed()
    assert "start_gcode: Move out of range" in printer.fail("CALIBRATE_Z")


def test_error_gcode_that_is_misspelt_hides_no_error(start):
    changes = section(error_gcode="TELL_M", start_gcode="ATACH_PROBE")
    printer = start(changes=changes).homed()
    assert "start_gcode: ATACH_PROBE" in printer.fail("CALIBRATE_Z")
    after = f"after the error: error_gcode: TELL_M {UNKNOWN}"
    assert any(after in line for line in printer.session.console)


@pytest.mark.parametrize("code", ["M300", slow("M117 DONE"), slow("m300 S9")])
def test_letter_and_number_is_told_and_fails_nothing(start, code):
    """Slicers send them to printers without a buzzer or a display, too."""
    printer = start(changes=section(end_gcode=code)).homed()
    before = len(printer.session.console)
    calibration(printer)
    word = code.upper().split()[0]
    line = f"// z_calibration: end_gcode: {word} is no command of this printer"
    lines = printer.session.console[before:]
    assert any(told.startswith(line) for told in lines)


@pytest.mark.parametrize("name", list(OF_MODULES))
def test_every_module_hears_and_tells_it(start, name):
    scene, changes, option, command = OF_MODULES[name]
    printer = start(scene, changes=changes).homed()
    (word,) = changes[next(iter(changes))].values()
    text = printer.fail(command)
    (note,) = notes_of(printer, name) or [""]
    assert f"{option}: {word} {UNKNOWN}" in note
    assert f"{option}: {word} {UNKNOWN}" in text


def test_what_can_be_seen_is_told_when_klippy_is_ready(start):
    code = """
  {% set x = 3 %}
  {% if x %} ATACH_PROBE
  {% endif %}
  G28X0
  SET_GCODE_{% if x %}OFFSET{% endif %} Z=0
  MACRO_{x}
  ; NEITHER_THIS
  {% set y = [
    NOR_THIS
  ] %}
  KNOWN ; AND_NOT_THIS
  M107
  m117 DONE
  ATACH_PROBE"""
    changes = {
        "gcode_macro known": {"gcode": "G90"},
        **section(end_gcode=code, start_gcode="Z_CALIBRATION_KEEP_OFFSET"),
    }
    printer = start(changes=changes)
    printer.session.require_ready()
    notes = notes_of(printer, "z_calibration")
    words = [note.split(": ")[2].split()[0] for note in notes]
    assert words == ["ATACH_PROBE", "M117"]
    told = printer.status("z_calibration")["notes"]
    assert any(f"end_gcode: ATACH_PROBE {UNKNOWN}" in note for note in told)


def test_what_comes_after_a_template_within_another_is_heard(start):
    """The dock has G-code of its own, which is done by then."""
    changes = {
        "dockable_probe": {"pre_attach_gcode": "G4 P1"},
        **section(start_gcode="\n  ATTACH_PROBE\n  ATACH_PROBE"),
    }
    printer = start(calibrating(SWITCH), changes=changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert f"start_gcode: ATACH_PROBE {UNKNOWN}" in text


@pytest.mark.parametrize(
    ("part", "command"),
    [("APPROACH", "ATTACH_PROBE"), slow("INSERT", "DETACH_PROBE")],
)
def test_macro_over_a_part_of_a_trip_is_heard(start, part, command):
    """It is G-code of the user as well, and fetching goes on without its words."""
    macro = {"rename_existing": "_THEIRS", "gcode": "\n  OPEN_DOKC\n  _THEIRS"}
    changes = {f"gcode_macro MOVE_TO_{part}_PROBE": macro}
    printer = start(SWITCH, changes).homed()
    printer.run("G90\nG1 X100 Y100 Z30 F6000")
    if command == "DETACH_PROBE":
        printer.run("ATTACH_PROBE")
    text = printer.fail(command)
    assert f"MOVE_TO_{part}_PROBE: OPEN_DOKC {UNKNOWN}" in text
    assert_safe(printer)
