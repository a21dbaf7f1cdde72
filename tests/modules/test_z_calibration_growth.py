"""A nozzle that is longer when it is hot, on real klippy: measured, and part of offsets."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from simprinter import Fault, heated, real
from simprinter.world import DriftSpec, HotendSpec, NoiseSpec
from tools.kit.cases import slow
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    MICROSTEP,
    SWITCH_OFFSET,
    assert_unharmed,
    calibration,
    pending,
    result_of,
    section,
    touched_sites,
)

GROWTH = "Z_CALIBRATION_NOZZLE_GROWTH"
# Of the machine, mm per 100 C
LONGER = 0.0465
# A nozzle that has grown presses the pin that was met higher
GROWN = 0.3
# Printer seconds that a command may take, and in which a nozzle is as hot as it will be
LIMIT = 6000.0
HOT = 300.0


def hot_scene(growth=LONGER, lag=real.BEHIND, noise=0.0, **world):
    """The voron with heaters and a nozzle that grows with its own."""
    scene = SCENES["voron"]
    pin = replace(scene.world.pin, noise=NoiseSpec(noise))
    hotend = HotendSpec(growth, lag)
    return heated(scene.with_world(hotend=hotend, pin=pin, **world))


def homed(start, scene=None, changes=None, **more):
    """A homed printer whose pin gives way to a nozzle that grows."""
    idle = {"idle_timeout": {"timeout": "99999"}, **(changes or {})}
    printer = start(scene or hot_scene(), changes=idle, **more)
    printer.machine.tolerate("nozzle_pin", GROWN)
    return printer.homed()


def run(printer, script):
    """The console lines of a command that takes long."""
    return printer.session.run(script, LIMIT)


def fail(printer, script):
    """The error of one that takes long."""
    with pytest.raises(Exception) as caught:
        run(printer, script)
    assert printer.session.state()[0] == "ready"
    return str(caught.value)


def heat(printer, celsius):
    """The nozzle is as hot as that, and as long as it will be."""
    printer.run(f"M104 S{celsius}")
    printer.session.wait(HOT)


def targets(printer):
    """What the hotend's heater is to have (C)."""
    return printer.status("extruder")["target"]


def growth_of(lines):
    """The growth, and the scatter, that a command has told."""
    (line,) = [n for n in lines if n.startswith(f"// {GROWTH}: ")]
    return tuple(map(float, re.findall(r"(-?\d\.\d{4}) mm", line)))


def saved(printer):
    """What waits for SAVE_CONFIG of [z_calibration]."""
    return pending(printer).get("z_calibration", {})


def off(printer):
    """By how much (mm) the true gap of now is too large."""
    return printer.gap() - printer.scene.formula_gap()


# Measured


@pytest.mark.parametrize("before", [0.0, slow(120.0)])
def test_growth_is_measured_and_saved(start, before):
    printer = homed(start)
    printer.run(f"SET_GCODE_OFFSET Z=0.2 MOVE=0\nM104 S{before}")
    count = len(printer.machine.truth.touches)
    lines = run(printer, GROWTH)
    growth, scatter = growth_of(lines)
    assert growth == pytest.approx(LONGER, abs=0.003)
    assert scatter < 0.003
    assert [n for n in lines if "nozzle to" in n] == [
        f"// z_calibration: nozzle to {celsius} C" for celsius in (60, 110, 160)
    ]
    assert saved(printer) == {"nozzle_growth": f"{growth:.4f}"}
    assert set(touched_sites(printer, count)) == {"nozzle_pin"}
    assert targets(printer) == before
    assert printer.status("z_calibration")["last_result"] == {}
    assert printer.status("z_calibration")["history"]["runs"] == 0
    assert_unharmed(printer, 0.2)


def test_each_touch_waits_until_the_nozzle_stands_still(start):
    # The metal takes minutes more than the thermistor
    printer = homed(start, hot_scene(lag=90.0))
    lines = run(printer, f"{GROWTH} TEMPS=150,100,60,100,150")
    told = [n for n in lines if "nozzle to" in n]
    assert [n.split()[4] for n in told] == ["150", "100", "60", "100", "150"]
    assert growth_of(lines)[0] == pytest.approx(LONGER, abs=0.006)


def test_phase_and_progress(start):
    printer = homed(start)
    command = printer.session.begin(GROWTH)
    printer.session.wait(5.0)
    status = printer.status("z_calibration")
    assert (status["phase"], status["progress"]) == ("heating", 0.0)
    printer.session.wait(20.0)
    status = printer.status("z_calibration")
    assert status["phase"] == "waiting"
    assert status["progress"] == pytest.approx(1 / 48)
    printer.session.finish(command, LIMIT)


# Refused


def test_printer_that_still_warms_up_is_refused(start):
    drift = DriftSpec(nozzle=0.02 / 60.0)
    printer = homed(start, hot_scene(drift=drift))
    printer.machine.tolerate("nozzle_pin", 1.0)
    printer.run("M104 S100")
    text = fail(printer, GROWTH)
    assert "at 60 C the pin still moves, by 0.0" in text
    assert "mm a minute after 15 minutes" in text
    assert targets(printer) == 100.0
    assert saved(printer) == {}


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        # By less than the limit of each minute
        (
            hot_scene(growth=0.005, drift=DriftSpec(nozzle=-0.0025 / 60.0)),
            "the nozzle would be -0.0",
        ),
        (hot_scene(growth=0.45), "the nozzle would be 0.4"),
        # Something gives way while the nozzle is heated the second time
        (
            hot_scene(drift=DriftSpec(nozzle=0.006, start=230.0, stop=240.0)),
            "mm off a straight line (no more than",
        ),
    ],
    ids=["shorter", "far longer", "no line"],
)
def test_growth_that_cannot_be_is_not_saved(start, scene, words):
    printer = homed(start, scene)
    printer.machine.tolerate("nozzle_pin", 1.0)
    text = fail(printer, GROWTH)
    assert words in text
    assert saved(printer) == {}
    assert targets(printer) == 0.0
    assert "needs nozzle_growth" in printer.fail(
        "CALIBRATE_Z EXTRUDER_TEMP=250"
    )


def test_nozzle_that_does_not_get_so_cold(start):
    # Nothing cools it in a hot chamber
    scene = hot_scene()
    heaters = dict(scene.wiring.heaters)
    heaters["extruder"] = replace(heaters["extruder"], ambient=70.0)
    wiring = replace(scene.wiring, heaters=heaters)
    printer = homed(start, replace(scene, wiring=wiring))
    text = fail(printer, GROWTH)
    assert "the nozzle has 70 C after 20 minutes, and should have 60 C" in text
    assert targets(printer) == 0.0


def test_dead_pin_puts_the_target_back(start):
    fault = Fault("trigger_never", site="nozzle_pin", touch=5, command=GROWTH)
    printer = homed(start, hot_scene(growth=0.0), faults=[fault])
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.run("M104 S40\nSET_GCODE_OFFSET Z=0.2 MOVE=0")
    assert "the switch did not answer" in fail(printer, GROWTH)
    assert targets(printer) == 40.0
    assert_unharmed(printer, 0.2)


def test_emergency_stop_leaves_all_as_klipper_does(start):
    printer = homed(start)
    command = printer.session.begin(GROWTH)
    printer.session.wait(5.0)
    printer.session.stop()
    with pytest.raises(Exception, match="shut down|shutdown|stop"):
        printer.session.finish(command)
    printer.session.wait(60.0)
    assert "the heater's target failed" not in printer.session.log()
    printer.session.restart("FIRMWARE_RESTART")
    assert targets(printer) == 0.0


# In an offset


@pytest.mark.parametrize("printing", [250, slow(200)])
def test_gap_is_right_at_the_temperature_of_the_print(start, printing):
    printer = homed(start)
    run(printer, GROWTH)
    heat(printer, 150)
    lines = printer.run(f"CALIBRATE_Z EXTRUDER_TEMP={printing}")
    added = LONGER * (printing - 150) / 100
    offset = result_of(lines)[-1]
    status = printer.status("z_calibration")
    assert status["last_z_offset"] - offset == pytest.approx(added, abs=0.004)
    assert status["valid"]
    (line,) = [n for n in lines if "Z-CALIBRATION: offset" in n]
    said = re.search(
        r"with \+(\S+) mm as the nozzle prints at (\d+) C and was touched at"
        r" (\d+) C$",
        line,
    )
    assert float(said[1]) == pytest.approx(added, abs=0.004)
    assert int(said[2]) == printing and abs(int(said[3]) - 150) <= 3
    heat(printer, printing)
    assert off(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)
    # Without it the nozzle is too low by then
    heat(printer, 150)
    lines = printer.run("CALIBRATE_Z")
    (line,) = [n for n in lines if "Z-CALIBRATION: offset" in n]
    assert line.endswith(
        "without nozzle_growth, as EXTRUDER_TEMP was not given"
    )
    heat(printer, printing)
    assert off(printer) == pytest.approx(-added, abs=2 * MICROSTEP)


def test_growth_of_the_section_and_other_parts_of_the_offset(start):
    printer = homed(start, changes=section(nozzle_growth="0.1"))
    printer.run("M104 S150")
    printer.session.wait(HOT)
    plain = printer.run("CALIBRATE_Z") and printer.offset()
    lines = printer.run("CALIBRATE_Z EXTRUDER_TEMP=250 Z_ADJUST=0.05")
    assert printer.offset() - plain == pytest.approx(0.15, abs=0.006)
    (line,) = [n for n in lines if "Z-CALIBRATION: offset" in n]
    assert re.search(r"with Z_ADJUST=0\.050, with \+0\.(09|10)", line)
    assert "taken off" not in line
    # A print that is colder than the touch needs less
    heat(printer, 180)
    warm = printer.run("CALIBRATE_Z") and printer.offset()
    printer.run("CALIBRATE_Z EXTRUDER_TEMP=130")
    assert printer.offset() - warm == pytest.approx(-0.05, abs=0.006)


def test_paper_with_a_cold_nozzle_gives_the_same_switch_offset(start):
    """By the length that the nozzle has when it meets the paper."""
    printer = homed(start, changes=section(nozzle_growth=str(LONGER)))
    heat(printer, 150)
    for parameters in ("", "EXTRUDER_TEMP=250"):
        printer.run(f"CALIBRATE_Z {parameters}")
        # Beside the bed, as this printer keeps its probe attached
        printer.run("G1 Z20 F900\nG1 X20 Y305 F6000\nM400")
        status = printer.status("z_calibration")
        here = status["last_result"]["offset"]
        printer.run(f"G1 Z{here - printer.offset():.6f} F300\nM400")
        (line,) = [
            n
            for n in printer.run("CALCULATE_SWITCH_OFFSET")
            if "new switch_offset" in n
        ]
        new = float(line.split("=")[-1])
        # It stands where the nozzle of now meets the bed
        assert new == pytest.approx(SWITCH_OFFSET, abs=0.004), parameters


def test_nozzle_whose_temperature_nobody_knows(start):
    printer = start(changes=section(nozzle_growth="0.05")).homed()
    text = printer.fail("CALIBRATE_Z EXTRUDER_TEMP=250")
    assert "this printer has no extruder" in text
    # Nothing is asked of those who do not use it
    calibration(printer, "CALIBRATE_Z EXTRUDER_TEMP=")
