"""CALIBRATE_Z_ACCURACY on real klippy: what varies is told, nothing applied."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import NamedTuple

import pytest

from simprinter import Fault
from simprinter.world import DriftSpec, NoiseSpec, OozeSpec
from tools.kit.cases import all_slow_but
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    kept_runs,
    reported,
    section,
    touched_sites,
)

MIDDLING = 0.002
WORN = 0.015
VERDICT = "verdict of CALIBRATE_Z_ACCURACY: "


def cartesian(pin=MIDDLING, probe=MIDDLING, reseat=0.0, **world):
    """The scene that attaches its probe, with noise (mm) on both switches."""
    scene = SCENES["cartesian"]
    return scene.with_world(
        pin=replace(scene.world.pin, noise=NoiseSpec(pin)),
        mag_probe=replace(
            scene.world.mag_probe, noise=NoiseSpec(probe), reseat=reseat
        ),
        **world,
    )


class Cause(NamedTuple):
    """What is wrong with a machine, and words of the verdict."""

    scene: dict
    words: str


CAUSES = {
    "nothing": Cause({}, "nothing stands out"),
    "ooze": Cause(
        {"ooze": OozeSpec(0.06, kept=0.5, rate=0.003)}, "clean the nozzle"
    ),
    "heat": Cause({"drift": DriftSpec(nozzle=0.001)}, "let it warm up"),
    "worn pin": Cause({"pin": WORN}, "exchange the switch of the pin"),
    "worn probe": Cause({"probe": WORN}, "exchange the probe's switch"),
    "loose probe": Cause({"reseat": 0.04}, "seat the probe"),
    "play": Cause({"z_play": 0.05}, "check the Z axis for play"),
}


@pytest.mark.parametrize("name", all_slow_but(["play"], CAUSES))
def test_each_cause_is_told(start, name):
    cause = CAUSES[name]
    printer = start(cartesian(**cause.scene)).homed()
    printer.machine.tolerate("nozzle_pin", 0.2)
    printer.machine.tolerate("body_pin", 0.2)
    line = reported(printer, VERDICT, "CALIBRATE_Z_ACCURACY CYCLES=6")
    assert cause.words in line


def test_progress_is_that_of_all_cycles(start):
    """Two touches of nozzle, switch and bed each; told before the switch."""
    own = SCENES["cartesian"].sections["z_calibration"]
    code = f"{own['before_switch_gcode']}\n  WHERE"
    where = "{printer.z_calibration.progress}"
    changes = {
        "respond": {},
        "gcode_macro WHERE": {"gcode": f"\n  RESPOND MSG='done {where}'"},
        **section(before_switch_gcode=code),
    }
    printer = start(cartesian(), changes=changes).homed()
    told = "\n".join(printer.run("CALIBRATE_Z_ACCURACY CYCLES=2"))
    parts = [float(part) for part in re.findall(r"done (\S+)", told)]
    assert parts == pytest.approx([2 / 12, 8 / 12])


def test_whole_cycles_are_measured_and_nothing_is_applied(start):
    printer = start(cartesian()).homed()
    printer.run("SET_GCODE_OFFSET Z=0.123 MOVE=0")
    before = len(printer.machine.truth.touches)
    count = len(printer.session.console)
    told = reported(printer, VERDICT, "CALIBRATE_Z_ACCURACY CYCLES=2")
    assert "2 cycles are too few" in told
    lines = printer.session.console[count:]
    # Twice per cycle, as [probe] has it
    assert touched_sites(printer, before) == (
        (["nozzle_pin"] * 2 + ["body_pin"] * 2 + ["probe_bed"] * 2) * 2
    )
    assert printer.offset() == pytest.approx(0.123)
    status = printer.status("z_calibration")
    assert (status["last_result"], status["valid"]) == ({}, False)
    assert (status["phase"], status["progress"]) == ("idle", 0.0)
    assert status["history"]["runs"] == 0
    told = [line for line in lines if "CALIBRATE_Z_ACCURACY: " in line]
    told = [line for line in told if VERDICT not in line]
    assert [re.findall(r"ACCURACY: (\w+)", line)[0] for line in told] == [
        "nozzle",
        "switch",
        "bed",
        "offset",
        "one",
    ]
    events = [e.kind for e in printer.machine.truth.events]
    assert events == ["attach", "dock"] * 2
    (record,) = kept_runs(printer)
    assert (record["ok"], record["step"] > 0.0) == (True, True)
    assert [set(cycle) for cycle in record["cycles"]] == [
        {"time", "nozzle", "switch", "bed"}
    ] * 2
    folder = printer.session.data / "config" / "z_calibration"
    (report,) = folder.glob("report-*.svg")
    assert "2 cycles" in report.read_text()


@pytest.mark.slow
def test_cycles_as_they_are_asked_for(start):
    """Probe on the toolhead all the time or not, and homing between them."""
    adding = "\n  SET_GCODE_OFFSET Z_ADJUST=0.1"
    changes = section(samples="auto", end_gcode=adding)
    printer = start(changes=changes).homed()

    def sites(parameters):
        before = len(printer.machine.truth.touches)
        printer.run(f"CALIBRATE_Z_ACCURACY {parameters}")
        # What end_gcode adds is taken back
        assert printer.offset() == pytest.approx(0.0)
        return touched_sites(printer, before)

    assert sites("CYCLES=2 ATTACH=0") == (
        (["nozzle_pin"] * 3 + ["body_pin"] * 3 + ["probe_bed"] * 3) * 2
    )
    assert sites("CYCLES=2 HOME=1").count("nozzle_pin") == 2 * (3 + 2)
    error = printer.fail("CALIBRATE_Z_ACCURACY HOME=1 ATTACH=0")
    assert "HOME=1 with ATTACH=0" in error


@pytest.mark.slow
def test_failure_leaves_everything_as_it_was(start):
    fault = Fault("attach_fails", n=2, command="CALIBRATE_Z_ACCURACY")
    changes = {"respond": {}, **section(error_gcode="\n  RESPOND MSG=ERROR")}
    printer = start(cartesian(), changes=changes, faults=[fault]).homed()
    printer.run("SET_GCODE_OFFSET Z=0.2 MOVE=0")
    error = printer.fail("CALIBRATE_Z_ACCURACY CYCLES=3")
    assert "switch: the probe reads triggered" in error
    assert "".join(printer.session.console).count("ERROR") == 1
    (refused,) = printer.status("z_calibration")["history"]["results"]
    assert not refused["ok"] and refused["reason"] in " ".join(error.split())
    assert printer.offset() == pytest.approx(0.2)
    assert printer.session.state()[0] == "ready"
    assert printer.machine.truth.events[-1].kind in ("dock", "attach_failed")
    printer.run("G28\nCALIBRATE_Z")
    error = printer.fail("CALIBRATE_Z_ACCURACY ATTACH=0")
    assert "ATTACH=0 needs the probe on the toolhead all the time" in error


# Macros bring this probe, and here nobody takes it off before Z is homed on the pin
@pytest.mark.slow
@pytest.mark.parametrize("end_gcode", ["\n  DOCK_PROBE", None])
def test_z_is_not_homed_with_the_probe_on_the_head(start, end_gcode):
    changes = {"z_calibration": {"end_gcode": end_gcode}}
    printer = start("cartesian", changes=changes).homed()
    if end_gcode:
        printer.run("CALIBRATE_Z\nATTACH_PROBE")
    text = printer.fail("CALIBRATE_Z_ACCURACY CYCLES=2 HOME=1")
    assert "put it away before Z is homed" in text
    printer.machine.truth.require_no_crash()


# Only a G28 of the owner's own takes it off
@pytest.mark.slow
def test_homing_that_puts_the_probe_away(start):
    homing = {
        "rename_existing": "G28.1",
        "gcode": "\n  DOCK_PROBE\n  G28.1 {rawparams}",
    }
    changes = {"z_calibration": {"end_gcode": None}, "gcode_macro G28": homing}
    printer = start("cartesian", changes=changes).homed()
    for _ in range(2):
        lines = printer.run("CALIBRATE_Z_ACCURACY CYCLES=2 HOME=1")
        assert any("CALIBRATE_Z_ACCURACY: " in line for line in lines)
    printer.machine.truth.require_no_crash()


# Z is homed with the probe here, which stays on the toolhead until start_gcode docks it
@pytest.mark.slow
def test_homing_that_needs_the_probe_on_the_head(start):
    scene = SCENES["cartesian"]
    inputs = dict(scene.wiring.inputs)
    pin_input = inputs["nozzle_endstop"] = inputs.pop("z_endstop")
    scene = replace(scene, wiring=replace(scene.wiring, inputs=inputs))
    pin = replace(scene.world.pin, signal="nozzle_endstop")
    changes = {
        "stepper_z": {
            "endstop_pin": "probe:z_virtual_endstop",
            "position_endstop": None,
        },
        "safe_z_home": {"home_xy_position": "110, 110"},
        "z_calibration": {
            "endstop_pin": pin_input,
            "start_gcode": "DOCK_PROBE",
            "end_gcode": None,
        },
    }
    printer = start(scene.with_world(pin=pin), changes=changes)
    printer.session.require_ready()
    printer.run("ATTACH_PROBE\nG28")
    for _ in range(2):
        lines = printer.run("CALIBRATE_Z_ACCURACY CYCLES=2 HOME=1")
        assert any("CALIBRATE_Z_ACCURACY: " in line for line in lines)
    printer.machine.truth.require_no_crash()
