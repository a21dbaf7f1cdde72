"""[extra_probe NAME]: touching with it, its options and its status."""

from __future__ import annotations

import re
import statistics

import pytest

from simprinter import Fault
from simprinter.world import NoiseSpec
from tests.modules.test_axis_twist import compensation
from tools.kit.extra_probe import (
    BED,
    CALIBRATE,
    MICROSTEP,
    NAME,
    PROBE_BED,
    THICKNESS,
    heights,
    membrane,
    section,
    state,
)
from tools.kit.printer import Printer
from tools.kit.prints import of_card
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import refusal, with_moves

ABOVE = "G90\nG1 Z5 F900\nG1 X30 Y20 F6000"
PROBE = f"{ABOVE}\nEXTRA_PROBE PROBE=membrane"
TOUCH = re.compile(r"^// probe at (\S+),(\S+) is z=(\S+)$")
RESULT = re.compile(r"^// Result is z=(\S+)$")


def touches(lines):
    """Heights of the single touches, as told."""
    return [float(m[3]) for m in map(TOUCH.match, lines) if m]


def result(lines):
    """The result, as told."""
    (found,) = [m for m in map(RESULT.match, lines) if m]
    return float(found[1])


def laid(start, scene="membrane", **options):
    """A homed printer with the membrane on its bed."""
    printer = start(scene, **options).homed()
    printer.machine.lay_membrane()
    return printer


def noisy(sigma, **noise):
    """The membrane with a trigger point that is not quite exact."""
    return membrane(noise=NoiseSpec(sigma=sigma, **noise))


# EXTRA_PROBE


def test_lines_and_result_of_a_touch(start):
    printer = laid(start, changes=section(samples="2"))
    lines = printer.run(PROBE)
    z = BED + THICKNESS
    assert [m.groups()[:2] for m in map(TOUCH.match, lines) if m] == [
        ("30.000", "20.000")
    ] * 2
    assert touches(lines) == pytest.approx([z, z], abs=MICROSTEP)
    assert lines[-1] == f"// Result is z={result(lines):.6f}"
    assert result(lines) == pytest.approx(z, abs=MICROSTEP)
    status = printer.status(NAME)
    assert status["last_z_result"] == pytest.approx(result(lines), abs=1e-6)
    # Where the last touch ended, as after PROBE
    at = printer.session.position()[2]
    assert z - 0.1 < at < z + MICROSTEP
    assert printer.offset() == 0.0


def test_lift_speed_is_the_speed_by_default(start):
    printer = laid(start, changes=section(lift_speed=None, speed="4"))
    lines = printer.run(f"{ABOVE}\nEXTRA_PROBE_ACCURACY PROBE=membrane")
    assert "(samples=10 " in lines[0]
    assert lines[0].endswith(" speed=4.0 lift_speed=4.0)")


NONSENSE = {
    "SAMPLES=0": "SAMPLES",
    "SAMPLES=x": "SAMPLES",
    "PROBE_SPEED=0": "PROBE_SPEED",
    # Some hosts do not take it for a number
    "PROBE_SPEED=nan": "PROBE_SPEED=nan",
    "LIFT_SPEED=-1": "LIFT_SPEED",
    "SAMPLE_RETRACT_DIST=0": "SAMPLE_RETRACT_DIST",
    "SAMPLES_TOLERANCE=-0.1": "SAMPLES_TOLERANCE",
    "SAMPLES_TOLERANCE_RETRIES=-1": "SAMPLES_TOLERANCE_RETRIES",
    "SAMPLES_RESULT=mode": "SAMPLES_RESULT has to be median or average",
}


def test_parameter_that_makes_no_sense(start):
    printer = laid(start)
    printer.run(ABOVE)
    for params, words in NONSENSE.items():
        assert words in printer.fail(f"EXTRA_PROBE PROBE=membrane {params}")
    assert heights(printer) == []
    assert printer.session.state()[0] == "ready"


# Whoever prints has cleared the bed
def test_print_that_begins_ends_the_question(start, tmp_path):
    printer = laid(start, changes=of_card(tmp_path, [PROBE, "G4 P100"]))
    printer.run(CALIBRATE)
    printer.run("SDCARD_PRINT_FILE FILENAME=print.gcode")
    printer.session.wait(60.0)
    assert len(heights(printer)) == 3


# Homed on a switch no lower than that triggers, and a tenth of a millimetre: see
# test_touch_without_a_question; never below the axis
@pytest.mark.parametrize(
    ("scene", "changes", "low", "floor"),
    [
        ("membrane", section(position_min="0.15"), BED, 0.15),
        ("membrane_and_probe", {}, PROBE_BED, -1.0),
        (
            "membrane",
            {
                "stepper_z": {"position_min": "-0.5"},
                **section(position_min="-2"),
            },
            *(BED, -0.5),
        ),
    ],
)
def test_floor_of_a_touch(start, scene, changes, low, floor):
    # A dead membrane is pressed, and the bed below it
    fault = Fault("stuck_open", site="nozzle_membrane")
    printer = laid(start, scene, faults=[fault], changes=changes)
    printer.machine.tolerate("nozzle_membrane", 2.0)
    printer.machine.tolerate("nozzle_bed", 2.0)
    text = printer.fail(PROBE)
    assert f"(stopped at z={floor:.3f})" in text
    assert "press it by hand and look with QUERY_EXTRA_PROBE" in text
    lowest = printer.machine.truth.min_gap
    assert lowest == pytest.approx(floor - low, abs=0.01)
    printer.session.wait(2.0)
    assert printer.session.position()[2] == pytest.approx(5.0)


def test_no_twist_compensation(host, start):
    scene = SCENES["membrane_and_probe"]
    changes = compensation(host, scene, 20, 200, 0.4, 0.4, 0.4)
    changes["probe"] = {"x_offset": "17.6"}
    printer = laid(start, scene, changes=changes)
    z = result(printer.run(PROBE))
    # The toolhead stands where it was when the membrane triggered
    assert z == pytest.approx(printer.session.position()[2], abs=0.1)


# The G-code around a touch

NOTE = "\n  RESPOND MSG={}"


def noted(lines):
    """What the templates have said, between the touches."""
    words = {"// probe at": "touch", "echo: on": "on", "echo: off": "off"}
    return [w for x in lines for b, w in words.items() if x.startswith(b)]


@pytest.mark.parametrize(
    ("each", "expected"),
    [
        (None, ["on", "off", "touch"] * 2),
        ("true", ["on", "off", "touch"] * 2),
        ("false", ["on", "touch", "touch", "off"]),
    ],
)
@pytest.mark.parametrize("command", ["EXTRA_PROBE", "EXTRA_PROBE_ACCURACY"])
def test_activation(start, each, expected, command):
    changes = {
        "respond": {},
        **section(
            activate_gcode=NOTE.format("on"),
            deactivate_gcode=NOTE.format("off"),
            deactivate_on_each_sample=each,
        ),
    }
    printer = laid(start, changes=changes)
    call = f"{ABOVE}\n{command} PROBE=membrane SAMPLES=2"
    assert noted(printer.run(call)) == expected


@pytest.mark.parametrize("each", ["true", "false"])
def test_deactivation_after_a_failed_touch(start, each):
    changes = {
        "respond": {},
        **section(
            activate_gcode=NOTE.format("on"),
            deactivate_gcode=NOTE.format("off"),
            deactivate_on_each_sample=each,
            position_min="1",
        ),
    }
    printer = start("membrane", changes=changes).homed()
    printer.fail(PROBE)
    assert noted(printer.session.console) == ["on", "off"]


# EXTRA_PROBE_ACCURACY

FIGURES = re.compile(
    r"// probe accuracy results: maximum (\S+), minimum (\S+), range (\S+),"
    r" average (\S+), median (\S+), standard deviation (\S+)$"
)


def test_accuracy_figures_are_those_of_the_touches(start):
    # The tolerance is no matter
    changes = section(samples_tolerance="0.0001")
    printer = laid(start, noisy(0.01), changes=changes, seed=3)
    printer.run(ABOVE)
    before = state(printer)
    lines = printer.run("EXTRA_PROBE_ACCURACY PROBE=membrane SAMPLES=6")
    z = touches(lines)
    assert len(z) == 6
    assert max(z) - min(z) > 0.01
    (found,) = [m for m in map(FIGURES.match, lines) if m]
    expected = (
        max(z),
        min(z),
        max(z) - min(z),
        statistics.fmean(z),
        statistics.median(z),
        statistics.pstdev(z),
    )
    assert tuple(map(float, found.groups())) == pytest.approx(
        expected, abs=2e-6
    )
    assert state(printer) == before
    printer.session.wait(2.0)
    assert printer.session.position()[2] == pytest.approx(5.0)


def test_accuracy_begins_with_what_it_does(start):
    printer = laid(start)
    lines = printer.run(
        f"{ABOVE}\nEXTRA_PROBE_ACCURACY PROBE=membrane SAMPLES=2 PROBE_SPEED=2"
        " LIFT_SPEED=4 SAMPLE_RETRACT_DIST=1"
    )
    assert lines[0] == (
        "// EXTRA_PROBE_ACCURACY at X:30.000 Y:20.000 Z:5.000 (samples=2"
        " retract=1.000 speed=2.0 lift_speed=4.0)"
    )


# QUERY_EXTRA_PROBE and status


def test_query_tells_what_the_pin_reads(start):
    printer = laid(start)
    lines = printer.run(f"{ABOVE}\nQUERY_EXTRA_PROBE PROBE=membrane")
    assert lines == ["// extra probe membrane: open"]
    assert printer.status(NAME)["last_query"] is False
    # A finger
    printer.machine.break_down(Fault("stuck_closed", signal="membrane", t=0.0))
    lines = printer.run("QUERY_EXTRA_PROBE PROBE=membrane")
    assert lines == ["// extra probe membrane: TRIGGERED"]
    assert printer.status(NAME)["last_query"] is True


@pytest.mark.parametrize(
    ("scene", "z_offset"), [("membrane", 0.0), ("membrane_and_probe", 2.0)]
)
def test_status_beside_a_probe_or_none(start, scene, z_offset):
    printer = start(scene)
    printer.session.require_ready()
    assert printer.status(NAME) == {
        "name": "membrane",
        "last_query": False,
        "last_z_result": 0.0,
        "default_probe_z_offset": z_offset,
        "last_offset": None,
        "waits_for": "",
    }


def test_status_before_klippy_is_ready(host, tmp_path):
    # And beside a probe that has no offsets
    source = tmp_path / "odd.py"
    source.write_text(
        "class Odd:\n"
        "    def get_status(self, eventtime):\n"
        "        return {'name': 'odd'}\n"
        "def load_config(config):\n"
        "    printer = config.get_printer()\n"
        "    printer.add_object('probe', Odd())\n"
        "    def look():\n"
        "        probe = printer.lookup_object('extra_probe membrane')\n"
        "        assert probe.get_status(0.)['default_probe_z_offset'] == 0.\n"
        "    printer.register_event_handler('klippy:mcu_identify', look)\n"
        "    return Odd()\n"
    )
    changes = {"odd": {}}
    modules = {**with_moves(), "odd": source}
    with Printer(host, "membrane", changes, modules=modules) as printer:
        printer.session.require_ready()
        assert printer.status(NAME)["default_probe_z_offset"] == 0.0


def test_several_sections(start):
    # The other one is not touched: its pin is not wired
    changes = {
        "extra_probe pin": {"pin": "^PG5", "samples": "2"},
        "extra_probe third": {"pin": "^PG6"},
    }
    printer = laid(start, changes=changes)
    lines = printer.run("QUERY_EXTRA_PROBE PROBE=pin")
    assert lines == ["// extra probe pin: open"]
    z = result(printer.run(PROBE))
    assert z == pytest.approx(BED + THICKNESS, abs=MICROSTEP)
    assert printer.status("extra_probe pin")["last_z_result"] == 0.0
    assert printer.status("extra_probe third")["name"] == "third"
    line = printer.run("QUERY_ENDSTOPS")[-1]
    # It stands on it
    assert "extra_probe membrane:TRIGGERED" in line
    assert "extra_probe pin:open" in line


# Configurations that cannot work


@pytest.mark.parametrize(
    ("scene", "own", "words"),
    [
        (
            "membrane_and_probe",
            {"pin": "^!PF0"},
            "is the pin of section 'probe'; give the pin of the switch, or"
            " call the section 'extra_probe probe' where [probe] is the switch",
        ),
        (
            "membrane",
            {"xy_position": "300, 20"},
            "Option 'xy_position: 300,20' in section 'extra_probe membrane'"
            " needs the toolhead at X=300.000, outside its -13.000 to 220.000",
        ),
        (
            "membrane",
            {"safe_z_height": "251"},
            "Option 'safe_z_height: 251' in section 'extra_probe membrane' is"
            " above the 250.000 of Z; lower it",
        ),
    ],
)
def test_option_that_cannot_be_used(host, scene, own, words):
    message = refusal(host, section(**own), scene)
    assert words in message
    assert "extra_probe membrane" in message


def test_two_sections_of_one_pin(host):
    changes = {"extra_probe other": {"pin": "^!PF5"}}
    message = refusal(host, changes, "membrane")
    assert "Option 'pin: ^!PF5' in section 'extra_probe other' is the pin" in (
        message
    )
    assert "of option 'pin' in section 'extra_probe membrane', too" in message


def test_machine_without_a_z_axis(host):
    changes = {
        "printer": {
            "kinematics": "none",
            "max_velocity": "100",
            "max_accel": "100",
        },
        **{f"stepper_{axis}": None for axis in "xyz"},
    }
    message = refusal(host, changes, "membrane")
    assert "extra_probe membrane cannot be used on this machine" in message


@pytest.mark.parametrize("command", ["EXTRA_PROBE", "EXTRA_PROBE_ACCURACY"])
def test_head_below_the_lowest_point_has_no_floor_to_give(start, command):
    """FLOOR is a parameter of EXTRA_PROBE_CALIBRATE only."""
    printer = start("membrane", changes=section(position_min="5")).homed()
    printer.run("G90\nG1 Z4 F600")
    text = printer.fail(f"{command} PROBE=membrane")
    assert "is at z=4.000, this touch ends at z=5.000 already" in text
    assert "begin higher up" in text and "FLOOR" not in text
    # The switch is not what is wrong
    assert "QUERY_EXTRA_PROBE" not in text
