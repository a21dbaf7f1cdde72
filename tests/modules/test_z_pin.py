"""Over the pin that Z is homed on, and how far below it the nozzle looks."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from tools.kit.carrying import SWITCH
from tools.kit.dockable_probe import QUICK, section
from tools.kit.extra_probe import lay
from tools.kit.scenes import SCENES

# Where the pin is (mm), and the toolhead Z of its trigger
PIN = SCENES["voron"].world.pin
PIN_Z = 1.6
OVER_PIN = f"G90\nG1 Z20 F900\nG1 X{PIN.x} Y{PIN.y} F6000\n"
MEMBRANE = "EXTRA_PROBE PROBE=membrane"


def ready(start, changes=None, **more):
    changes = {**section(**QUICK), **(changes or {})}
    printer = start(SWITCH, changes, **more)
    for site in "nozzle_pin", "nozzle_bed":
        printer.machine.tolerate(site, 8.0)
    return printer.homed()


# With no bed below it the sensor stays silent, as a dead one does
@pytest.mark.parametrize(
    "changes",
    [
        {},
        # Nobody says that it is a pin, but it lies beside the mesh
        {"z_calibration": None},
        # As it was named before, where a macro homes
        {
            "z_calibration": {
                "nozzle_xy_position": None,
                "probe_nozzle_x": f"{PIN.x}",
                "probe_nozzle_y": f"{PIN.y}",
            },
            "safe_z_home": None,
            "homing_override": {
                "axes": "z",
                "gcode": f"\n  G28 X\n  G28 Y\n  G1 X{PIN.x} Y{PIN.y} F6000\n  G28 Z",
            },
        },
        # An owner who lets a touch go deep means the bed
        {"auto_z_offset": {"probe_z_min": "-4"}},
    ],
    ids=["z_calibration", "mesh", "old names", "probe_z_min"],
)
@pytest.mark.parametrize("command", ["AUTO_Z_PROBE", MEMBRANE])
def test_pin_is_pressed_one_millimetre(start, command, changes):
    if command == MEMBRANE and "auto_z_offset" in changes:
        pytest.skip("of another section")
    printer = ready(start, changes)
    before = printer.machine.truth.depth("nozzle_pin")
    text = printer.fail(OVER_PIN + command)
    assert f"(stopped at z={PIN_Z - 1.0:.3f})" in text
    pressed = printer.machine.truth.depth("nozzle_pin") - before
    assert pressed == pytest.approx(1.0, abs=0.02)
    told = text + "\n".join(printer.session.console)
    assert "the toolhead is over" in told and "pin of the Z endstop" in told


def test_membrane_over_the_pin_in_a_dialog(start):
    printer = ready(
        start, {"extra_probe membrane": {"xy_position": f"{PIN.x}, {PIN.y}"}}
    )
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=membrane")
    lay(printer)
    shown = "\n".join(printer.session.console)
    assert "it stops at Z=0.600" in shown
    assert "The toolhead is over the pin of the Z endstop; move it." in shown


# Beside it, and half a pin's width nearer
@pytest.mark.parametrize(("away", "is_over"), [(4.5, True), (5.5, False)])
def test_how_near_the_pin(start, away, is_over):
    printer = ready(start)
    text = printer.fail(
        f"G90\nG1 Z20 F900\nG1 X{PIN.x - away} Y{PIN.y}\nEXTRA_PROBE PROBE=membrane"
    )
    assert ("(stopped at z=0.600)" in text) is is_over


# A switch of the axis, which is everywhere, also where Z is homed over the mesh; and
# one at its other end
@pytest.mark.slow
@pytest.mark.parametrize(
    ("mesh_min", "floor"), [("5, 5", -0.1), ("60, 60", 1.0)]
)
def test_homed_over_the_mesh_is_no_pin(start, mesh_min, floor):
    changes = {
        "stepper_z": {"position_endstop": "2"},
        "safe_z_home": {"home_xy_position": "30, 20"},
        "bed_mesh": {"mesh_min": mesh_min, "mesh_max": "200, 200"},
        "probe": {"pin": "^PF0", "z_offset": "2", "x_offset": "5"},
    }
    fault = Fault("stuck_open", signal="membrane")
    printer = start("membrane", changes, faults=[fault]).homed()
    printer.machine.tolerate("nozzle_bed", 4.0)
    text = printer.fail("G1 X30 Y20 F6000\nEXTRA_PROBE PROBE=membrane")
    assert f"(stopped at z={floor:.3f})" in text


# The bed may be lower than the owner believes, by as much as a pin is too high
@pytest.mark.slow
@pytest.mark.parametrize("low", [0.0, 1.9])
def test_bed_below_where_the_pin_puts_it(start, low):
    bed = replace(SWITCH.world.bed, z0=SWITCH.world.bed.z0 - low)
    scene = SWITCH.with_world(bed=bed)
    printer = start(scene, section(**QUICK)).homed()
    printer.run("G90\nG1 Z20 F900\nG1 X150 Y150 F6000\nAUTO_Z_PROBE")
    assert printer.machine.truth.touches[-1].site == "nozzle_bed"
    assert printer.machine.truth.crashes() == []


@pytest.mark.slow
def test_dead_sensor_where_z_is_homed_on_a_switch(start):
    fault = Fault("stuck_open", site="nozzle_bed")
    printer = ready(start, faults=[fault])
    text = printer.fail("G90\nG1 Z20 F900\nG1 X150 Y150 F6000\nAUTO_Z_PROBE")
    assert "(stopped at z=-2.000)" in text
    assert "2 mm below where Z is homed, and below Z=0; raise speed" in text
    assert ", or set probe_z_min if the bed may be lower" in text
    # It was lower than the -5 of the axis
    printer = ready(
        start, {"auto_z_offset": {"probe_z_min": "-3"}}, faults=[fault]
    )
    text = printer.fail("G90\nG1 Z20 F900\nG1 X150 Y150 F6000\nAUTO_Z_PROBE")
    assert "(stopped at z=-3.000)" in text
