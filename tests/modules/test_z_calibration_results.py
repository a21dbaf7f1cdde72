"""[z_calibration] on real klippy in front of the simulated machine."""

from __future__ import annotations

import math
import re

import pytest

from simprinter import Fault, Machine
from simprinter.hosts.session import GcodeError, run_batch
from tools.kit.printer import (
    Printer,
    dialect_of,
    has_kinematics,
    module_files,
)
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    BED,
    BODY,
    MICROSTEP,
    PIN,
    SWITCH_OFFSET,
    TRIGGER,
    assert_unharmed,
    calibration,
    marked,
    refusal,
    result_of,
    section,
    touched_sites,
    with_dead_pin,
    with_extra,
)

# The measurement


@pytest.mark.every_host(
    "the gap above all, whatever a host has changed in its moves"
)
@pytest.mark.parametrize("scene", ["voron", "cartesian"])
def test_gap_is_what_the_formula_predicts(start, scene):
    printer = start(scene).homed()
    printer.run("CALIBRATE_Z")
    predicted = printer.scene.formula_gap()
    assert printer.gap() == pytest.approx(predicted, abs=2 * MICROSTEP)


def test_result_line_and_status_hold_the_heights(start):
    # An offset that has more than three digits
    given = 0.441234
    printer = start(changes=section(switch_offset=str(given)))
    printer.session.require_ready()
    status = printer.status("z_calibration")
    assert status == {
        "last_query": False,
        "last_z_offset": 0.0,
        "last_result": {},
        "measured": False,
        "valid": False,
        "reason": "not calibrated yet",
        "warnings": [],
        "notes": [],
        "uncertainty": None,
        "z_adjust": 0.0,
        "applied": 0.0,
        "history": {
            "runs": 0,
            "results": [],
            "spread": {"nozzle": None, "switch": None, "bed": None},
            "switch_nozzle": None,
        },
        "movement": None,
        "phase": "idle",
        "progress": 0.0,
    }
    printer.run("G28\nSET_GCODE_OFFSET Z=0.9")
    (probe, switch, nozzle, switch_offset, offset), _ = calibration(printer)
    # The toolhead does not move with the new offset
    printer.run("M400")
    assert printer.session.position()[2] == pytest.approx(13.8, abs=1e-6)
    assert nozzle == pytest.approx(PIN, abs=MICROSTEP)
    assert switch == pytest.approx(PIN + BODY, abs=MICROSTEP)
    assert probe == pytest.approx(BED + TRIGGER, abs=MICROSTEP)
    assert switch_offset == round(given, 3)
    assert offset == pytest.approx(probe - (switch - nozzle + given), abs=0.002)
    assert not math.isclose(offset, round(offset, 3), abs_tol=1e-6)
    status = printer.status("z_calibration")
    assert status["last_query"] is True
    assert (status["valid"], status["reason"]) == (True, "")
    assert status["warnings"] == []
    assert (status["phase"], status["progress"]) == ("idle", 0.0)
    assert status["last_z_offset"] == pytest.approx(offset, abs=1e-6)
    parts = status["last_result"]
    assert parts["switch_offset"] == given
    assert parts["offset"] == status["last_z_offset"]
    assert status["applied"] == pytest.approx(offset, abs=1e-6)
    assert [round(parts[k], 3) for k in ("probe", "switch", "nozzle")] == [
        probe,
        switch,
        nozzle,
    ]
    assert printer.offset() == pytest.approx(offset, abs=1e-6)


def test_batch_run_gives_the_same_result(host):
    with Printer(host) as printer:
        live, _ = calibration(printer.homed())
    scene = SCENES["voron"]
    with Machine(scene, dialect=dialect_of(host)) as machine:
        batch = run_batch(
            host.install(module_files()),
            machine,
            scene.config(machine.link.path),
            "G28\nCALIBRATE_Z\nG1 X150 Y150 Z10 F6000\nM400\n",
        )
        assert batch.status == 0, batch.tail()
        assert result_of(batch.log.splitlines()) == live
        gap = machine.gap_at_zero(10.0)
    assert gap == pytest.approx(scene.formula_gap(), abs=2 * MICROSTEP)


@pytest.mark.parametrize("deactivate", ["activate", "deactivate"])
def test_probe_that_cannot_be_made_ready_ends_the_run(start, deactivate):
    # With its own pin to be told apart: fails once, when told to
    changes = {
        "gcode_macro READY": {
            "variable_broken": "0",
            "gcode": "\n  {% if printer['gcode_macro READY'].broken %}"
            "\n    { action_raise_error('not ready') }\n  {% endif %}",
        },
        "probe": {f"{deactivate}_gcode": "READY"},
    }
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_VARIABLE MACRO=READY VARIABLE=broken VALUE=1")
    assert "not ready" in printer.fail("CALIBRATE_Z")
    assert printer.status("z_calibration")["last_query"] is False
    assert_unharmed(printer)
    printer.run("SET_GCODE_VARIABLE MACRO=READY VARIABLE=broken VALUE=0")
    calibration(printer)


def test_retract_is_never_zero(start):
    changes = {"stepper_z": {"homing_retract_dist": "0"}}
    printer = start(changes=changes).homed()
    _, sites = calibration(printer)
    assert sites.count("nozzle_pin") == 3


AXIS_OPTIONS = (
    "endstop_pin",
    "position_endstop",
    "position_min",
    "position_max",
    "homing_speed",
    "homing_retract_dist",
)


@pytest.mark.every_host("only hosts since 2025-05 have generic_cartesian")
@pytest.mark.parametrize("name", ["z", "lift"])
def test_axis_of_generic_cartesian(host, name):
    if not has_kinematics(host, SCENES["generic"]):
        pytest.skip(f"{host.name} has no generic_cartesian")
    changes = {
        "printer": {"kinematics": "generic_cartesian"},
        "tmc2209 stepper_z": None,
    }
    for axis, carriage in (("x", "x"), ("y", "y"), ("z", name)):
        stepper = dict(SCENES["cartesian"].sections[f"stepper_{axis}"])
        own = {k: stepper.pop(k) for k in AXIS_OPTIONS if k in stepper}
        changes[f"stepper_{axis}"] = None
        changes[f"carriage {carriage}"] = {**own, "axis": axis}
        changes[f"stepper my_{axis}"] = {**stepper, "carriages": carriage}
    with Printer(host, "cartesian", changes=changes) as printer:
        printer.homed().run("CALIBRATE_Z")
        predicted = printer.scene.formula_gap()
        assert printer.gap() == pytest.approx(predicted, abs=2 * MICROSTEP)


def test_macro_named_like_the_offset_command_is_left_alone(start):
    changes = marked("SET_GCODE_OFFSET")
    changes["gcode_macro SET_GCODE_OFFSET"]["rename_existing"] = "PLAIN_OFFSET"
    printer = start(changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    assert not any("SET_GCODE_OFFSET" in line for line in lines)
    assert printer.offset() == pytest.approx(result_of(lines)[-1], abs=1e-6)


def test_klippy_knows_version_help_and_settings(start):
    printer = start()
    printer.session.require_ready()
    assert re.search(r"z_calibration \d+\.\d+\.\d+", printer.session.log())
    helped = "\n".join(printer.run("HELP"))
    assert re.search(r"CALIBRATE_Z\s*:\s*Measure nozzle", helped)
    for name in ("PROBE_Z_ACCURACY", "CALCULATE_SWITCH_OFFSET"):
        assert re.search(rf"{name}\s*: \w+", helped), name
    settings = printer.status("configfile")["settings"]["z_calibration"]
    # Numbers, with the defaults
    assert settings["switch_offset"] == SWITCH_OFFSET
    assert list(settings["nozzle_xy_position"]) == [206.0, 306.0]
    assert (settings["travel_margin"], settings["speed"]) == (1.0, 50.0)
    assert settings["probing_first_fast"] is False


# Templates


def test_end_gcode_reads_the_result_of_its_own_run(start):
    """As upstream has it, where the offset is set by then."""
    fields = ("last_z_offset", "last_result.nozzle", "last_query")
    look = " ".join(f"{{printer.z_calibration.{name}}}" for name in fields)
    changes = {"respond": {}, **section(end_gcode=f"RESPOND MSG='seen {look}'")}
    printer = start(changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    result = result_of(lines)
    (seen,) = [line for line in lines if "seen" in line]
    _, _, offset, nozzle, query = seen.split()
    assert float(offset) == pytest.approx(result[-1], abs=1e-5)
    assert float(nozzle) == pytest.approx(result[2], abs=1e-3)
    assert query == "True"


def test_start_gcode_may_home(start):
    changes = {"gcode_macro home_it": {"gcode": "G28 Z"}}
    changes.update(section(start_gcode="Home_It"))
    printer = start(changes=changes)
    printer.session.require_ready()
    printer.run("G28 X Y")
    calibration(printer)


@pytest.mark.parametrize("start_gcode", [None, "LOOK_AT_IT"])
def test_before_switch_gcode_that_attaches_nothing(start, start_gcode):
    """Its words say nothing; the probe is on the toolhead all the time."""
    changes = {"gcode_macro LOOK_AT_IT": {"gcode": "\n  G90\n  G0 Z20"}}
    own = {"start_gcode": start_gcode, "before_switch_gcode": "look_at_it"}
    printer = start(changes={**changes, **section(**own)}).homed()
    for _ in range(2):
        calibration(printer)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("ATTACH_PROBE\n  M84", "the motors were turned off"),
        ("G28 Z\n  ATTACH_PROBE", "Z was homed again"),
    ],
)
def test_frame_that_changes_between_nozzle_and_switch(start, code, words):
    changes = section(before_switch_gcode=code)
    printer = start("cartesian", changes=changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert f"{words} in before_switch_gcode" in text
    assert "do it before CALIBRATE_Z" in text
    assert set(touched_sites(printer)) == {"nozzle_pin"}
    assert printer.session.state()[0] == "ready"


def test_end_gcode_that_homes_leaves_a_result_that_does_not_hold(start):
    printer = start(changes=section(end_gcode="G28 Z")).homed()
    lines = printer.run("CALIBRATE_Z")
    assert result_of(lines)
    told = [line for line in lines if "the offset holds no more" in line]
    assert len(told) == 1
    assert "Z was homed again after measuring, in end_gcode" in told[0]
    status = printer.status("z_calibration")
    assert (status["valid"], status["reason"]) == (False, "Z was homed again")


def test_failing_end_gcode_does_not_hide_the_first_error(start):
    changes = marked("LAST", LAST="{ action_raise_error('second error') }")
    changes.update(section(end_gcode="LAST"))
    printer = with_dead_pin(start, changes=changes)
    text = printer.fail("CALIBRATE_Z")
    assert "nozzle" in text
    assert "second error" not in text
    assert "second error" in printer.session.log()
    assert_unharmed(printer)


def test_template_that_stops_the_printer_is_the_last_thing_run(start):
    changes = marked("LAST")
    stop = "ATTACH_PROBE\n  { action_emergency_stop('enough') }"
    changes.update(section(before_switch_gcode=stop, end_gcode="LAST"))
    printer = start("cartesian", changes=changes).homed()
    before = len(printer.session.console)
    assert "enough" in printer.fail("CALIBRATE_Z")
    printer.session.wait(2.0)
    assert "echo: LAST" not in printer.session.console[before:]
    assert "failed, too" not in printer.session.log()
    assert printer.session.state()[0] == "shutdown"


# What may go wrong on the way


def test_probe_that_is_not_attached_never_goes_down(start):
    changes = section(before_switch_gcode=None)
    printer = start("cartesian", changes=changes).homed()
    printer.session.wait(3.0)
    before, at = len(printer.machine.truth.touches), printer.machine.tip()
    text = printer.fail("CALIBRATE_Z")
    assert "not attached" in text
    assert "start_gcode or before_switch_gcode" in text
    assert "QUERY_PROBE" in text
    # Nothing was touched, and the only move was the lift
    assert touched_sites(printer, before) == []
    printer.session.wait(3.0)
    tip = printer.machine.tip()
    assert (tip.x, tip.y) == (at.x, at.y)
    assert tip.z >= at.z
    assert printer.session.state()[0] == "ready"


def test_probe_may_stand_on_the_bed_before(start):
    printer = start().homed()
    printer.run("G1 X150 Y120 Z15 F6000\nPROBE")
    calibration(printer)


def test_probe_that_fails_to_attach_never_goes_down(start):
    faults = [Fault("attach_fails", command="CALIBRATE_Z")]
    printer = start("cartesian", faults=faults).homed()
    before = len(printer.machine.truth.touches)
    command = printer.session.begin("CALIBRATE_Z")
    printer.session.run_until(
        command, lambda: len(touched_sites(printer, before)) == 2
    )
    # The next move that looks would be the way down to the switch
    printer.machine.break_down(
        Fault("stuck_open", signal="z_endstop", strikes="never")
    )
    with pytest.raises(GcodeError, match="not attached"):
        printer.session.finish(command)
    assert touched_sites(printer, before) == ["nozzle_pin"] * 2


def test_probe_that_is_known_to_come_late_is_refused_before(start):
    printer = start("cartesian").homed()
    printer.run("CALIBRATE_Z")
    before = len(printer.machine.truth.touches)
    for command in ("CALIBRATE_Z", "PROBE_Z_ACCURACY"):
        text = printer.fail(f"ATTACH_PROBE\n{command}")
        assert "is attached already, and before_switch_gcode has" in text
    assert touched_sites(printer, before) == []
    printer.run("DOCK_PROBE\nCALIBRATE_Z")


@pytest.mark.parametrize(
    ("site", "noticed"), [("nozzle", "switch"), ("switch", "bed")]
)
def test_endstop_that_stays_pressed_after_the_last_touch(host, site, noticed):
    where = {"nozzle": "nozzle_pin", "switch": "body_pin"}[site]
    with Printer(host) as printer:
        printer.homed().run("CALIBRATE_Z")
        last = max(
            touch.t
            for touch in printer.machine.truth.touches
            if touch.site == where
        )
    # The same run again: it sticks the moment it was pressed last
    fault = Fault("stuck_closed", signal="z_endstop", t=last + 0.01)
    with Printer(host, faults=[fault]) as printer:
        text = printer.homed().fail("CALIBRATE_Z")
        # At its own site when the second run is a little late
        assert text.startswith(
            tuple(
                f"z_calibration: {where}: the Z endstop reads triggered"
                for where in (site, noticed)
            )
        )
        assert_unharmed(printer)


def test_failure_keeps_the_last_result_and_offset(start):
    printer = start().homed()
    printer.machine.tolerate("nozzle_pin", 1.01)
    good, _ = calibration(printer)
    status = printer.status("z_calibration")
    about = {"site": "nozzle_pin", "touch": 2, "command": "CALIBRATE_Z"}
    printer.machine.break_down(Fault("trigger_never", **about))
    printer.fail("CALIBRATE_Z")
    # Not of the last run, but of the last good one
    now = printer.status("z_calibration")
    expected = {**status, "last_query": False, "history": now["history"]}
    assert now == expected
    assert_unharmed(printer, good[-1])


def test_switch_offset_beyond_the_travel_height(start):
    printer = start(changes=section(switch_offset="300")).homed()
    text = printer.fail("CALIBRATE_Z")
    assert (
        "bed: the toolhead is at z=280.000, this touch ends at z=305.4" in text
    )
    assert "correct switch_offset (larger than any switch has it) or" in text
    assert "probe_bed" not in touched_sites(printer)
    assert_unharmed(printer)


# Set-ups that are refused when klippy connects


# By option: what a command has instead, and what is said without
MISSING = [
    (
        *("nozzle_xy_position", "NOZZLE_POSITION=206,306"),
        "no place for the nozzle; run Z_CALIBRATION_SETUP, set"
        " nozzle_xy_position, or add",
    ),
    (
        *("switch_xy_position", "SWITCH_POSITION=211.5,281.25"),
        "no place for the switch; run Z_CALIBRATION_SETUP, set"
        " switch_xy_position or switch_xy_offsets, or add",
    ),
    (
        *("bed_xy_position", "BED_POSITION=150,150"),
        "no place for the bed; run Z_CALIBRATION_SETUP, set bed_xy_position,"
        " or zero_reference_position in section 'bed_mesh', or add",
    ),
    (
        *("switch_offset", "SWITCH_OFFSET=0.44"),
        "no switch_offset; run Z_CALIBRATION_SETUP, set it in section",
    ),
]


@pytest.mark.parametrize(("option", "parameter", "words"), MISSING)
def test_option_that_is_missing_may_come_with_the_command(
    start, option, parameter, words
):
    changes = section(**{option: None})
    if option == "nozzle_xy_position":
        changes["safe_z_home"] = None
        changes["homing_override"] = {
            "axes": "xyz",
            "set_position_z": "0",
            "gcode": "\n  G91\n  G1 Z10 F600\n  G90\n  G28 X Y"
            "\n  G1 X206 Y306 F6000\n  G28 Z",
        }
    printer = start(changes=changes).homed()
    homing = len(printer.machine.truth.touches)
    # A place is told at start, too
    console = "\n".join(printer.session.console)
    assert (words in console) == ("place" in words)
    text = printer.fail("CALIBRATE_Z")
    assert words in text
    assert f"add {parameter.split('=')[0]}=" in text
    assert touched_sites(printer, homing) == []
    calibration(printer, f"CALIBRATE_Z {parameter}")
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


TOWER = {
    "microsteps": "16",
    "rotation_distance": "40",
    "position_endstop": "300",
    "arm_length": "330",
}
DELTA = {
    "printer": {
        "kinematics": "delta",
        "max_z_velocity": "100",
        "max_z_accel": None,
    },
    "safe_z_home": None,
    "probe": {"pin": "^PD3"},
    **{f"stepper_{a}": None for a in ("x", "y", "z", "z1", "z2", "z3")},
    **{
        f"stepper_{name}": {
            "step_pin": f"PB{pins}",
            "dir_pin": f"PB{pins + 1}",
            "enable_pin": f"!PB{pins + 2}",
            "endstop_pin": f"^PC{pins}",
            **TOWER,
        }
        for name, pins in (("a", 0), ("b", 3), ("c", 6))
    },
}
OTHER_PROBE = {"control_pin": "PD1", "z_offset": "2"}
VIRTUAL = {
    "endstop_pin": "probe:z_virtual_endstop",
    "position_endstop": None,
}
UNSUITABLE = {
    "no probe": ({"probe": None}, "Section 'probe' is missing"),
    "bltouch": (
        {"probe": None, "bltouch": {**OTHER_PROBE, "sensor_pin": "^PC3"}},
        "Section 'bltouch'",
    ),
    "smart_effector": (
        {"probe": None, "smart_effector": {**OTHER_PROBE, "pin": "^PC3"}},
        "Section 'smart_effector'",
    ),
    "virtual endstop": (
        {"stepper_z": VIRTUAL},
        "Option 'endstop_pin: probe:z_virtual_endstop' in section 'stepper_z'"
        " is the probe: z_calibration needs a Z endstop",
    ),
    "motor with an endstop of its own": (
        {"stepper_z1": {"endstop_pin": "^PC5"}},
        "does not stop these Z motors: stepper_z1;",
    ),
    "delta": (DELTA, "Option 'kinematics: delta' in section 'printer' has no"),
}


@pytest.mark.parametrize(
    ("changes", "words"), UNSUITABLE.values(), ids=UNSUITABLE
)
def test_printer_that_cannot_be_calibrated(host, changes, words):
    assert words in refusal(host, changes)


# Parts of the host that others change: QIDI's, for one, exchange what belongs
# to mcu_probe
STRANGE = {
    "no endstop": (
        "query = printer.lookup_object('query_endstops')\n"
        "query.endstops = [e for e in query.endstops if 'z' not in e[1]]",
        "the printer knows no endstop of that section",
    ),
    "no mcu_probe": (
        "probe.mcu_probe = None",
        "Section 'probe' is missing, or no switch on an endstop pin",
    ),
    "no steppers": (
        "outer = probe.mcu_probe\n"
        "for endstop in (outer, getattr(outer, 'mcu_endstop', outer)):\n"
        "    endstop.get_steppers = lambda: []",
        "Section 'probe' is missing, or no switch on an endstop pin",
    ),
    "samples_result": (
        "for name in ('param_helper', 'probe_session'):\n"
        "    helper = getattr(probe, name, probe)\n"
        "    if hasattr(helper, 'samples_result'):\n"
        "        helper.samples_result = 'submaxmin'",
        "set it to median or average",
    ),
}


@pytest.mark.slow
@pytest.mark.every_host("each host has other objects behind its probe")
@pytest.mark.parametrize(("code", "words"), STRANGE.values(), ids=STRANGE)
def test_host_that_is_not_as_expected(host, tmp_path, code, words):
    modules = with_extra(tmp_path, code)
    with Printer(host, changes={"extra": {}}, modules=modules) as printer:
        state, message = printer.session.start()
        assert state == "error"
        assert words in message
        assert "Internal error" not in message


@pytest.mark.slow
@pytest.mark.every_host(
    "what a probing move gives goes through other hands on each host"
)
def test_heights_are_those_of_the_trigger_not_of_the_halt(start, tmp_path):
    # As with endstop and motors on boards of their own, only more so
    code = """
probing_move = homing.probing_move
def changed(*args, **options):
    x, y, z = probing_move(*args, **options)[:3]
    return [x, y, z + 0.25, 0.0]
homing.probing_move = changed
"""
    modules = with_extra(tmp_path, code)
    printer = start(changes={"extra": {}}, modules=modules).homed()
    (probe, switch, nozzle, _, _), _ = calibration(printer)
    assert nozzle == pytest.approx(PIN + 0.25, abs=MICROSTEP)
    assert switch == pytest.approx(PIN + BODY + 0.25, abs=MICROSTEP)
    assert probe == pytest.approx(BED + TRIGGER + 0.25, abs=MICROSTEP)
