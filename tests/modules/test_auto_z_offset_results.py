"""The commands of [auto_z_offset] on the simulated QIDI."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.hosts.session import GcodeError
from simprinter.scene import heated
from tools.kit.auto_z_offset import (
    AIR_GAP,
    CORRECTION,
    DEPTH,
    MICROSTEP,
    POINT,
    PROBE_PLACE,
    SENSOR,
    formulas,
    pending,
    section,
    sites,
    state,
    told,
    touches,
    true_gap,
    with_extras,
)
from tools.kit.cases import slow
from tools.kit.klipper_sections import TOOL
from tools.kit.printer import Printer, has_kinematics
from tools.kit.prints import of_card
from tools.kit.scenes import SCENES

MACHINES = ("qidi", "qidi_two_boards", "piezo_cartesian", "piezo_generic")
STEPS = 2 * MICROSTEP


# AUTO_Z_CALIBRATE


@pytest.mark.parametrize("scene", MACHINES)
def test_calibration_leaves_the_air_gap(host, scene):
    if not has_kinematics(host, SCENES[scene]):
        pytest.skip(f"{host.name} has no kinematics of {scene}")
    with Printer(host, scene) as printer:
        printer.homed()
        before, first = state(printer), len(printer.machine.truth.touches)
        lines = printer.run("AUTO_Z_CALIBRATE")
        assert len(told(lines, "AUTO_Z_CALIBRATE: average of 3")) == 1
        # The probe sees the bed also when the nozzle comes down
        cycle = ["inductive_bed", "nozzle_bed", "inductive_bed"]
        assert sites(printer, first) == cycle * 3
        for n, touch in enumerate(touches(printer, first)):
            over = PROBE_PLACE if n % 3 == 2 else POINT
            assert (touch.x, touch.y) == pytest.approx(over, abs=0.02)
        # A sheet of paper is tried at that point
        position = printer.status("toolhead")["position"]
        assert position[:2] == pytest.approx(list(POINT))
        gap = printer.scene.piezo_gap()
        assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
        after = state(printer)
        for name in ("max_accel", "homed", "currents", "absolute"):
            assert after[name] == before[name]


@pytest.mark.every_host("Kalico's SAVE_CONFIG is another one than Klipper's")
def test_correction_holds_after_a_restart(start):
    printer = start("qidi").homed()
    printer.run("AUTO_Z_CALIBRATE")
    offset, gap = printer.offset(), true_gap(printer)
    assert pending(printer) == {
        "auto_z_offset": {
            "probe_z_correction": f"{offset:.6f}",
            "corrected_probe_z_offset": "0.000000",
        }
    }
    printer.session.restart("SAVE_CONFIG")
    assert f"probe_z_correction = {offset:.6f}" in printer.session.config_text()
    printer.run("G28")
    assert printer.offset() == 0.0
    status = printer.status("auto_z_offset")
    assert status["probe_z_correction"] == pytest.approx(offset, abs=1e-6)
    lines = printer.run("AUTO_Z_LOAD_OFFSET")
    assert told(lines, f"{offset:.6f}, the G-code Z offset is {offset:.6f}")
    assert not told(lines, "there is no probe_z_correction yet")
    assert printer.offset() == pytest.approx(offset, abs=1e-6)
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


def test_result_lines_and_status_of_a_calibration(start):
    printer = start("qidi").homed()
    found = formulas(printer.run("AUTO_Z_CALIBRATE"))
    assert len(found) == 3
    for parts in found:
        assert parts.sensor == pytest.approx(SENSOR, abs=STEPS)
        assert parts.probe == pytest.approx(0.0, abs=STEPS)
        assert (parts.probe_z_offset, parts.z_offset) == (0.0, AIR_GAP)
        assert parts.correction == pytest.approx(
            parts.sensor - (parts.probe - parts.probe_z_offset) + AIR_GAP,
            abs=0.002,
        )
    status = printer.status("auto_z_offset")
    corrections = status["corrections"]
    assert corrections == pytest.approx(
        [parts.correction for parts in found], abs=1e-5
    )
    spread = max(corrections) - min(corrections)
    assert status["spread"] == pytest.approx(spread)
    average = sum(corrections) / 3.0
    assert status["probe_z_correction"] == pytest.approx(average)
    assert status["last_z"] == pytest.approx(SENSOR, abs=STEPS)


# AUTO_Z_MEASURE_OFFSET


def test_measuring_applies_nothing(start):
    printer = start("qidi").homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    lines = printer.run("AUTO_Z_MEASURE_OFFSET")
    (parts,) = formulas(told(lines, "AUTO_Z_MEASURE_OFFSET: "))
    assert parts.correction == pytest.approx(CORRECTION, abs=STEPS)
    assert printer.offset() == pytest.approx(0.3)
    assert pending(printer) == {}
    status = printer.status("auto_z_offset")
    assert status["probe_z_correction"] == 0.0
    assert status["corrections"] == [status["last_result"]["correction"]]
    assert status["spread"] == 0.0
    exact = status["last_result"]
    assert exact["correction"] == pytest.approx(parts.correction, abs=1e-5)
    assert set(exact) == set(parts._fields)


# AUTO_Z_PROBE


def test_probe_where_the_head_is(start):
    printer = start("qidi").homed()
    assert printer.status("auto_z_offset")["last_z"] is None
    printer.run("G90\nG1 X60 Y180 F6000")
    first = len(printer.machine.truth.touches)
    lines = printer.run("AUTO_Z_PROBE")
    unused, touch = touches(printer, first)
    assert touch.site == "nozzle_bed"
    assert (touch.x, touch.y) == pytest.approx((60.0, 180.0), abs=0.02)
    # The bed is 1.2e-4 mm a mm lower there
    there = SENSOR + 1e-4 * ((60 - POINT[0]) - (180 - POINT[1]))
    (line,) = told(lines, "AUTO_Z_PROBE: at X:60.000 Y:180.000")
    z = float(line.split("z=")[1])
    assert z == pytest.approx(there, abs=STEPS)
    # The trigger, not the halt position below it; the toolhead is up again
    assert printer.status("auto_z_offset")["last_z"] == pytest.approx(z)
    position = printer.status("toolhead")["position"]
    assert position[2] == pytest.approx(z + 5.0, abs=1e-6)


# AUTO_Z_HOME_Z


# In the frame of the second probe the bed is at 1.68: a hop counts from the new Z
@pytest.mark.parametrize(("z_offset", "of_probe"), [(0.2, "0"), (-0.1, "3")])
def test_home_z_sets_z_only(start, z_offset, of_probe):
    changes = {
        "probe": {"z_offset": of_probe},
        **section(z_offset=str(z_offset)),
    }
    printer = start("qidi", changes=changes).homed()
    before = printer.status("toolhead")
    lines = printer.run("AUTO_Z_HOME_Z")
    (line,) = told(lines, "AUTO_Z_HOME_Z: the bed sensor triggered at z=")
    assert f"which is z={z_offset:.6f} now" in line
    after = printer.status("toolhead")
    assert after["homed_axes"] == before["homed_axes"] == "xyz"
    assert after["axis_minimum"] == before["axis_minimum"]
    assert after["axis_maximum"] == before["axis_maximum"]
    assert after["position"][:2] == pytest.approx(list(POINT))
    assert after["position"][2] == pytest.approx(z_offset + 5.0, abs=1e-6)
    # As the trigger is z_offset, Z=0 lies as much below it
    expected = -DEPTH - z_offset
    assert true_gap(printer) == pytest.approx(expected, abs=STEPS)
    printer.run("AUTO_Z_PROBE")
    last = printer.status("auto_z_offset")["last_z"]
    assert last == pytest.approx(z_offset, abs=STEPS)
    inside = told(lines, "mm inside the bed; home with G28")
    assert len(inside) == (1 if z_offset > 0 else 0)
    # X and Y are where they were
    printer.run("G28 X Y")
    assert printer.session.state()[0] == "ready"


def test_home_z_keeps_the_gcode_offset_and_says_so(start):
    printer = start("qidi").homed()
    assert not told(printer.run("AUTO_Z_HOME_Z"), "stays, on top of this")
    printer.run("SET_GCODE_OFFSET Z=0.25")
    lines = printer.run("AUTO_Z_HOME_Z")
    assert len(told(lines, "the G-code Z offset of 0.250 stays")) == 1
    assert printer.offset() == pytest.approx(0.25)


# AUTO_Z_LOAD_OFFSET, AUTO_Z_SAVE_GCODE_OFFSET


def test_loading_what_was_never_measured_says_so(start):
    printer = start("qidi").homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    lines = printer.run("AUTO_Z_LOAD_OFFSET")
    assert told(lines, "there is no probe_z_correction yet; run AUTO_Z_CAL")
    assert printer.offset() == 0.0


def test_babysteps_are_saved(start):
    printer = start("qidi").homed()
    printer.run("AUTO_Z_CALIBRATE\nSET_GCODE_OFFSET Z_ADJUST=-0.05")
    offset = printer.offset()
    lines = printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    assert told(lines, f"probe_z_correction: {offset:.6f} (was ")
    assert told(lines, "The SAVE_CONFIG command will update")
    assert not told(lines, "away from before")
    status = printer.status("auto_z_offset")
    assert status["probe_z_correction"] == pytest.approx(offset)
    assert pending(printer) == {
        "auto_z_offset": {
            "probe_z_correction": f"{offset:.6f}",
            "corrected_probe_z_offset": "0.000000",
        }
    }
    printer.run("SET_GCODE_OFFSET Z=0\nAUTO_Z_LOAD_OFFSET")
    assert printer.offset() == pytest.approx(offset, abs=1e-6)


def test_offset_that_is_none_is_not_saved_a_lost_one_is_told(start):
    printer = start("qidi").homed()
    printer.run("AUTO_Z_CALIBRATE")
    before = state(printer)
    printer.run("SET_GCODE_OFFSET Z=10.5")
    text = printer.fail("AUTO_Z_SAVE_GCODE_OFFSET")
    assert "a G-code Z offset of 10.500 is no correction of a probe" in text
    assert pending(printer) == before["pending"]
    assert printer.status("auto_z_offset") == before["status"]
    printer.run("SET_GCODE_OFFSET Z=0")
    lines = printer.run("AUTO_Z_SAVE_GCODE_OFFSET FORCE=1")
    assert told(lines, "1.120 mm away from before; where Z was not homed")


# Touches would then be expected where nobody has measured anything
def test_zero_is_no_first_correction(start):
    printer = start("qidi").homed()
    before = state(printer)
    text = printer.fail("AUTO_Z_SAVE_GCODE_OFFSET")
    assert "holds no correction, and none was saved before" in text
    assert state(printer) == before
    printer.run("AUTO_Z_SAVE_GCODE_OFFSET FORCE=1")
    assert printer.status("auto_z_offset")["probe_z_correction"] == 0.0


# Its macros have added what it differs by
def test_steps_of_another_tool_are_not_saved(start, tmp_path):
    warm = tmp_path / "warm"
    warm.write_text("25000")
    tool = {"extruder1": {**TOOL, "sensor_path": str(warm)}}
    printer = start(heated(SCENES["qidi"]), changes=tool).homed()
    printer.run("AUTO_Z_CALIBRATE\nACTIVATE_EXTRUDER EXTRUDER=extruder1")
    printer.run("SET_GCODE_OFFSET Z_ADJUST=0.3")
    before = state(printer)
    text = printer.fail("AUTO_Z_SAVE_GCODE_OFFSET")
    assert "extruder1 is active, and the correction was applied with" in text
    assert state(printer) == before
    printer.run("AUTO_Z_LOAD_OFFSET\nSET_GCODE_OFFSET Z_ADJUST=0.02")
    printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    saved = printer.status("auto_z_offset")["probe_z_correction"]
    assert saved == pytest.approx(CORRECTION + 0.02, abs=STEPS)


LOAD = "AUTO_Z_LOAD_OFFSET"
STEP = "SET_GCODE_OFFSET Z_ADJUST=0.05"
RESET = "the G-code Z offset is 0, not the -1.120 of the correction"


# What a next print would load, and the nozzle be as much too low or too high
@pytest.mark.parametrize(
    ("script", "words"),
    [
        (f"{LOAD}\nSET_GCODE_OFFSET Z=0", RESET),
        (f"SAVE_GCODE_STATE\n{LOAD}\nRESTORE_GCODE_STATE", RESET),
        (f"PAUSE\n{LOAD}\nRESUME", RESET),
        # Nobody has loaded it since the start
        ("M400", RESET),
        ("SET_GCODE_OFFSET Z=0.1", "is 0.100, with the correction it was -1.1"),
        (f"{LOAD}\nSET_GCODE_OFFSET Z_ADJUST=-0.51", "of more than 0.5 mm"),
    ],
)
def test_what_are_no_baby_steps_is_not_saved(start, script, words):
    options = section(probe_z_correction="-1.12")
    changes = {**options, "pause_resume": {}}
    printer = start("qidi", changes=changes).homed()
    lines = printer.run(script)
    told = "has brought back the G-code Z offset 0.000; it was -1.120, from"
    assert (told in "\n".join(lines)) is ("PAUSE" in script or "SAVE" in script)
    before = state(printer)
    assert words in printer.fail("AUTO_Z_SAVE_GCODE_OFFSET")
    assert state(printer) == before
    printer.run("AUTO_Z_SAVE_GCODE_OFFSET FORCE=1")
    saved = printer.status("auto_z_offset")["probe_z_correction"]
    assert saved == pytest.approx(printer.offset())


def test_what_is_no_offset_is_never_saved(start):
    printer = start("qidi", section(probe_z_correction="-1.12")).homed()
    printer.run(LOAD)
    try:
        printer.run("SET_GCODE_OFFSET Z=nan")
    except GcodeError as e:
        # Kalico takes none
        assert "unable to parse nan" in str(e)
        pytest.skip("the host refuses nan")
    text = printer.fail("AUTO_Z_SAVE_GCODE_OFFSET FORCE=1")
    assert "Z offset of nan is no correction of a probe" in text
    assert state(printer)["pending"] == {}


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("SET_GCODE_OFFSET Z=0", "offset is 0.000, and AUTO_Z_LOAD_OFFSET has"),
        slow("SET_GCODE_OFFSET Z_ADJUST=0.6", "is -0.520, and AUTO_Z_LOAD_OFF"),
        # At once, and not again between two commands
        ("RESTORE_GCODE_STATE", "has brought back the G-code Z offset 0.000"),
        (STEP, ""),
        # A baby step that is taken back
        (f"SAVE_GCODE_STATE\n{STEP}\nRESTORE_GCODE_STATE", ""),
        slow("G28", ""),
        # At the end of a print
        ("PRINT_END", ""),
        # A macro that is still at work is not interrupted
        ("BUSY", ""),
    ],
)
def test_offset_that_has_gone_is_told_once(start, script, words):
    changes = section(probe_z_correction="-1.12")
    busy = f"\n  SET_GCODE_OFFSET Z=0\n  G4 P5000\n  {LOAD}"
    changes["gcode_macro BUSY"] = {"gcode": busy}
    end = "\n  SET_GCODE_OFFSET Z=0\n  M84"
    changes["gcode_macro PRINT_END"] = {"gcode": end}
    printer = start("qidi", changes=changes).homed()
    printer.run(f"SAVE_GCODE_STATE\n{LOAD}")
    before = len(printer.session.console)
    for _ in range(2):
        printer.run(script)
        printer.session.wait(5.0)
    lines = printer.session.console[before:]
    loaded = f"// {LOAD}: "
    found = [
        line
        for line in lines
        if "the G-code Z offset" in line and not line.startswith(loaded)
    ]
    assert len(found) == bool(words)
    assert not words or words in found[0]


def test_offset_of_the_print_before_is_not_missed(start, tmp_path):
    """The start of a file may set 0, and load the correction some lines later."""
    lines = ["SET_GCODE_OFFSET Z=0", "G4 P9000", LOAD, "G4 P9000"]
    changes = section(probe_z_correction="-1.12")
    changes.update(of_card(tmp_path, lines))
    printer = start("qidi", changes=changes).homed()
    printer.run(f"{LOAD}\nSDCARD_PRINT_FILE FILENAME=print.gcode")
    printer.session.wait(30.0)
    assert "offset is 0.000, and" not in "\n".join(printer.session.console)
    assert printer.offset() == pytest.approx(-1.12)


@pytest.mark.parametrize("load", [LOAD, "SET_GCODE_OFFSET Z=-1.12"])
def test_steps_from_what_was_loaded_are_saved(start, load):
    options = section(probe_z_correction="-1.12")
    printer = start("qidi", changes=options).homed()
    printer.run(f"{load}\nSET_GCODE_OFFSET Z_ADJUST=0.5")
    printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    saved = printer.status("auto_z_offset")["probe_z_correction"]
    assert saved == pytest.approx(-0.62)


def test_steps_after_a_save_count_from_there(start):
    options = section(probe_z_correction="-1.12")
    printer = start("qidi", changes=options).homed()
    printer.run(LOAD)
    for _ in range(2):
        printer.run("SET_GCODE_OFFSET Z_ADJUST=0.4\nAUTO_Z_SAVE_GCODE_OFFSET")
    saved = printer.status("auto_z_offset")["probe_z_correction"]
    assert saved == pytest.approx(-0.32)
    # Saved before it, they are part of what the button takes over
    lines = printer.run("Z_OFFSET_APPLY_PROBE")
    assert not told(lines, "baby steps are gone")
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28\nAUTO_Z_LOAD_OFFSET")
    assert true_gap(printer) == pytest.approx(
        printer.scene.piezo_gap() + 0.8, abs=2 * STEPS
    )


def test_first_offset_of_all_is_saved_without_a_correction(start):
    printer = start("qidi").homed()
    printer.run(f"{LOAD}\nSET_GCODE_OFFSET Z=-1.1")
    printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    saved = printer.status("auto_z_offset")["probe_z_correction"]
    assert saved == pytest.approx(-1.1)


# Motor current and acceleration


@pytest.mark.every_host(
    "Kalico's drivers have a current of their own for homing"
)
@pytest.mark.parametrize(
    ("scene", "motors"),
    [
        ("qidi", {"stepper_z": 0.8, "stepper_z1": 1.07}),
        ("piezo_generic", {"left_z": 0.8, "right_z": 1.07}),
    ],
)
def test_current_is_low_while_the_nozzle_goes_down(host, scene, motors):
    if not has_kinematics(host, SCENES[scene]):
        pytest.skip(f"{host.name} has no kinematics of {scene}")
    changes = {"touches": {}, **section(z_current_factor="0.5")}
    modules = with_extras("touches")
    with Printer(host, scene, changes=changes, modules=modules) as printer:
        printer.homed()
        drivers = printer.machine.drivers
        before = {n: d.current() for n, d in drivers.items()}
        homing = len(printer.status("touches")["seen"])
        printer.run("AUTO_Z_MEASURE_OFFSET")
        seen = printer.status("touches")["seen"][homing:]
        # One move down on the bed, one of the probe
        assert [s["moment"] for s in seen] == ["begin", "end"] * 2
        for name, current in motors.items():
            found = [s["currents"][name] for s in seen]
            full = pytest.approx(current, abs=0.03)
            half = pytest.approx(current / 2.0, abs=0.03)
            assert found == [half, half, full, full]
        for name, driver in drivers.items():
            assert driver.current()[1:] == before[name][1:]
            # Low, and only once
            changes_of = [c.run for c in driver.currents if c.ns > 0]
            assert min(changes_of) < 0.6 * before[name].run


def test_current_stays_with_a_factor_of_one(start):
    printer = start("qidi", changes=section(z_current_factor="1.0")).homed()
    drivers = printer.machine.drivers
    before = {name: list(d.currents) for name, d in drivers.items()}
    lines = printer.run("AUTO_Z_MEASURE_OFFSET")
    assert "nozzle_bed" in sites(printer)
    assert {n: d.currents for n, d in drivers.items()} == before
    # Nor is the same one set again
    assert not any("Current" in line for line in lines)
    assert not told(printer.session.console, "z_current_factor")


def test_machine_without_drivers_says_so_once(start):
    printer = start("piezo_cartesian").homed()
    printer.run("AUTO_Z_MEASURE_OFFSET")
    once = sites(printer).count("nozzle_bed")
    printer.run("AUTO_Z_MEASURE_OFFSET")
    assert sites(printer).count("nozzle_bed") == 2 * once > 0
    lines = told(printer.session.console, "z_current_factor has no effect")
    assert len(lines) == 1
    assert "no effect on stepper_z: no TMC driver of its own" in lines[0]
    # What is 1 needs no driver
    other = start("piezo_cartesian", section(z_current_factor="1.0")).homed()
    assert not told(other.session.console, "z_current_factor")


def test_motors_that_move_x_too_keep_their_current(start):
    scene = SCENES["corexz"]
    motors = dict(scene.wiring.motors)
    motors["z"] = replace(motors["z"], uart="PE0")
    scene = replace(scene, wiring=replace(scene.wiring, motors=motors))
    changes = {
        "z_calibration": None,
        "tmc2209 stepper_z": {
            "uart_pin": "PE0",
            "run_current": "0.8",
            "sense_resistor": "0.110",
        },
        **section(pin="PC9", prepare_gcode=""),
    }
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    (line,) = told(printer.session.console, "z_current_factor has no effect")
    # Both belts move Z
    assert "on stepper_x, stepper_z: no TMC driver of its own" in line
    # Nobody could tell later whether Z was homed again
    text = printer.fail("G28\nAUTO_Z_HOME_Z")
    assert "the motors of Z move X or Y, too" in text


def test_one_of_two_motors_without_a_driver(start):
    changes = {"tmc2209 stepper_z1": None}
    printer = start("qidi", changes=changes).homed()
    (line,) = told(printer.session.console, "z_current_factor has no effect")
    assert "on stepper_z1: no TMC driver" in line
    printer.run("AUTO_Z_PROBE")
    assert len(printer.machine.drivers["z"].currents) > 2
    assert printer.machine.drivers["z1"].currents == []


@pytest.mark.parametrize(
    ("probe_accel", "before", "low"), [(50, 1234.5, 50), (500, 300, 300)]
)
def test_acceleration_is_low_while_the_nozzle_goes_down(
    host, probe_accel, before, low
):
    changes = {"touches": {}, **section(probe_accel=str(probe_accel))}
    modules = with_extras("touches")
    with Printer(host, "qidi", changes=changes, modules=modules) as printer:
        printer.homed()
        printer.run(f"SET_VELOCITY_LIMIT ACCEL={before}")
        homing = len(printer.status("touches")["seen"])
        printer.run("AUTO_Z_MEASURE_OFFSET")
        seen = printer.status("touches")["seen"][homing:]
        accels = [s["max_accel"] for s in seen]
        assert accels == [low, low, before, before]
        assert printer.status("toolhead")["max_accel"] == before


# Status while it runs


# Before the probe's first touch: one of its two places, or of three times two
@pytest.mark.parametrize(
    ("command", "part"),
    [("AUTO_Z_MEASURE_OFFSET", 1 / 2), ("AUTO_Z_CALIBRATE", 1 / 6)],
)
def test_phase_and_progress(start, command, part):
    where = "{printer.auto_z_offset.phase}:{printer.auto_z_offset.progress}"
    code = SCENES["qidi"].sections["auto_z_offset"]["prepare_gcode"]
    changes = {
        "respond": {},
        "gcode_macro WHERE": {"gcode": f"\n  RESPOND MSG='at {where}'"},
        "probe": {"activate_gcode": "WHERE"},
        **section(prepare_gcode=f"{code}\n  WHERE", samples="2"),
    }
    printer = start("qidi", changes=changes).homed()
    lines = told(printer.run(command), "echo: at")
    assert lines[0] == "echo: at prepare_gcode:0.0"
    assert f"echo: at probe:{part}" in lines
    status = printer.status("auto_z_offset")
    assert (status["phase"], status["progress"]) == ("idle", 0.0)


# Heat: an inductive probe senses another height

HOT = "when the correction was measured: the probe may sense another height"


def with_chamber(start, tmp_path, min_temp="0"):
    """A heated bed, and a sensor of that name; the file that it reads."""
    path = tmp_path / "chamber"
    path.write_text("25000")
    chamber = {
        "temperature_sensor chamber": {
            "sensor_type": "temperature_host",
            "sensor_path": str(path),
            "min_temp": min_temp,
            "max_temp": "120",
        }
    }
    return start(heated(SCENES["qidi"]), changes=chamber).homed(), path


def test_temperatures_are_kept_with_the_correction(start, tmp_path):
    printer, path = with_chamber(start, tmp_path)
    path.write_text("55000")
    printer.run("M140 S100")
    printer.session.wait(30.0)
    printer.run("AUTO_Z_CALIBRATE")
    saved = pending(printer)["auto_z_offset"]
    assert saved["corrected_bed_temp"] == "100.0"
    assert saved["corrected_chamber_temp"] == "55.0"
    assert not told(printer.run("AUTO_Z_LOAD_OFFSET"), HOT)
    printer.session.restart("SAVE_CONFIG")
    # Cold, as after a night
    path.write_text("25000")
    printer.homed().session.wait(30.0)
    (line,) = told(printer.run("AUTO_Z_LOAD_OFFSET"), HOT)
    assert "was 100 C, the chamber is 25 C and was 55 C when" in line
    assert "run AUTO_Z_CALIBRATE as hot as you print" in line


@pytest.mark.parametrize(
    ("target", "is_told"), [(75, 0), (74, 1), (105, 0), (106, 1)]
)
def test_other_heat_is_told_beyond_15_k(start, target, is_told):
    options = {"probe_z_correction": "0.1", "corrected_bed_temp": "90"}
    changes = section(corrected_probe_z_offset="0", **options)
    printer = start(heated(SCENES["qidi"]), changes=changes).homed()
    printer.run(f"M140 S{target}")
    lines = told(printer.run("AUTO_Z_LOAD_OFFSET"), HOT)
    assert len(lines) == is_told
    printer.run("M140 S0")


def test_measuring_says_how_far_it_is_from_the_correction(start):
    words = "mm from the probe_z_correction in force"
    printer = start("qidi").homed()
    assert not told(printer.run("AUTO_Z_MEASURE_OFFSET"), words)
    printer.run("AUTO_Z_CALIBRATE\nSET_GCODE_OFFSET Z_ADJUST=0.05")
    printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    (line,) = told(printer.run("AUTO_Z_MEASURE_OFFSET"), words)
    assert "that is -0.050 mm from" in line


def test_broken_sensor_of_the_chamber_is_not_kept(start, tmp_path):
    """Nor would Klipper start with it: an open one reads -109 C."""
    printer, path = with_chamber(start, tmp_path, min_temp=None)
    path.write_text("-109300")
    printer.session.wait(30.0)
    printer.run("AUTO_Z_CALIBRATE")
    assert "corrected_chamber_temp" not in pending(printer)["auto_z_offset"]
    printer.session.restart("SAVE_CONFIG")
    assert printer.session.state()[0] == "ready"


def test_macro_named_chamber_is_none(start):
    macro = {"variable_temperature": "'ABS'", "gcode": "\n  G4 P1"}
    printer = start("qidi", changes={"gcode_macro chamber": macro}).homed()
    printer.run("AUTO_Z_CALIBRATE\nAUTO_Z_LOAD_OFFSET")
    assert "corrected_chamber_temp" not in pending(printer)["auto_z_offset"]
