"""Every kind of axis and sensor of the world, as real klippy meets it."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from simprinter import Fault, Scene
from simprinter.wiring import Motor, Wiring
from simprinter.world import (
    BedSpec,
    DockSpec,
    InductiveSpec,
    MagProbeSpec,
    MembraneSpec,
    PinSpec,
    Pose,
    WorldSpec,
)

START = Pose(100.0, 100.0, 30.0)
BED_Z = 0.25
MICROSTEP = 0.0025
MOTORS = {
    "x": Motor("PA0", "PA1", 0.0125),
    "y": Motor("PA3", "!PA4", 0.0125),
    "z": Motor("PB0", "PB1", MICROSTEP),
}


def bare(kinematics="cartesian", inputs=None, outputs=None, **world):
    """A machine that needs no homing: klippy is told where it is."""
    sections = {
        "mcu": {},
        "printer": {
            "kinematics": kinematics,
            "max_velocity": "300",
            "max_accel": "3000",
        },
        "force_move": {"enable_force_move": "True"},
    }
    for name, motor in MOTORS.items():
        sections[f"stepper_{name}"] = {
            "step_pin": motor.step_pin,
            "dir_pin": motor.dir_pin,
            "microsteps": "16",
            "rotation_distance": "8" if name == "z" else "40",
            "endstop_pin": f"^PG{'xyz'.index(name)}",
            "position_endstop": "0",
            "position_min": "-5",
            "position_max": "300",
        }
    if kinematics in ("corexz", "hybrid_corexz"):
        # Both motors share the belt
        sections["stepper_z"]["rotation_distance"] = "40"
        motors = {**MOTORS, "z": Motor("PB0", "PB1", 0.0125)}
    else:
        motors = MOTORS
    return Scene(
        name="bare",
        kinematics=kinematics,
        z_motors=[("z", 0.0, 0.0)],
        world=WorldSpec(bed=BedSpec(z0=BED_Z), **world),
        wiring=Wiring(motors, inputs or {}, outputs or {}),
        sections=sections,
        start=START,
    )


def placed(printer):
    """The same printer, ready and told where its head is."""
    printer.session.require_ready()
    x, y, z = START
    printer.run(f"SET_KINEMATIC_POSITION X={x} Y={y} Z={z}\nG90")
    return printer


@pytest.mark.parametrize(
    "kinematics",
    ["cartesian", "corexy", "corexz", "hybrid_corexy", "hybrid_corexz"],
)
def test_head_goes_where_klippy_sends_it(start, kinematics):
    printer = placed(start(bare(kinematics)))
    targets = [(40.0, 160.0, 12.0), (180.0, 33.0, 55.0), (10.0, 10.0, 30.0)]
    for x, y, z in targets:
        printer.run(f"G1 X{x} Y{y} Z{z} F9000\nM400")
        printer.session.wait(1.0)
        # Half a microstep of each motor that takes part
        assert printer.machine.tip() == pytest.approx((x, y, z), abs=0.02)


PROBE = {"pin": "^PC3", "z_offset": "0.1", "speed": "5"}


def with_probe(scene, **more):
    """The scene with a [probe] on PC3 and other sections."""
    sections = {**scene.sections, "probe": PROBE, **more}
    return replace(scene, sections=sections)


def test_two_membrane_switches(start):
    """Each has a pin, a site and a hand that lays it."""
    thin = MembraneSpec(100.0, 100.0, 0.3, radius=8.0)
    thick = MembraneSpec(
        130.0, 100.0, 1.2, radius=8.0, laid=False, signal="thick"
    )
    scene = bare(
        inputs={"membrane": "^PC4", "thick": "^PC3"},
        membrane=thin,
        more_membranes=(thick,),
    )
    printer = placed(start(with_probe(scene)))
    with pytest.raises(ValueError, match="'membrane', 'thick'"):
        printer.machine.lay_membrane(signal="no")
    printer.run("G1 X130 F9000\nM400")
    assert "nozzle_thick" not in {n.site for n in printer.machine.near()}
    printer.machine.lay_membrane(signal="thick")
    assert "nozzle_thick" in {n.site for n in printer.machine.near()}
    printer.machine.break_down(
        Fault("trigger_late", site="nozzle_thick", mm=0.04)
    )
    printer.run("PROBE\nM400")
    z = BED_Z + 1.2 - 0.04
    assert printer.machine.tip().z == pytest.approx(z, abs=2 * MICROSTEP)
    printer.run("G1 Z10\nM400")
    truth = printer.machine.truth
    assert truth.touch_count("nozzle_thick") == 1
    assert truth.touch_count("nozzle_membrane") == 0
    # The other one is pressed, which that probe does not hear
    printer.run(f"G1 X100 F9000\nG1 Z{BED_Z + 0.28}\nM400")
    assert printer.machine.truth.touch_count("nozzle_membrane") == 1
    assert probe_is_open(printer)


def test_coil_beside_a_probe_that_touches(start):
    """Z homes on the coil; the [probe] is the one with a plunger."""
    scene = bare(
        inputs={"probe": "^PC3", "coil": "^PG2"},
        mag_probe=MagProbeSpec(0.0, 20.0, 6.0, 0.5),
        inductive=InductiveSpec(20.0, 0.0, 8.0, signal="coil"),
    )
    # A host that has homed with a second touch goes up again, or does not
    z = {**scene.sections["stepper_z"], "homing_retract_dist": "0"}
    printer = placed(start(with_probe(scene, stepper_z=z)))
    printer.run("G28 Z\nM400")
    truth = printer.machine.truth
    assert truth.touch_count("inductive_bed") == 1
    assert truth.touch_count("probe_bed") == 0
    tip = printer.machine.tip().z
    assert tip == pytest.approx(BED_Z + 8.0, abs=2 * MICROSTEP)
    printer.run("PROBE\nM400")
    assert printer.machine.truth.touch_count("probe_bed") == 1
    tip = printer.machine.tip().z
    assert tip == pytest.approx(BED_Z + 6.5, abs=2 * MICROSTEP)


def test_two_pins(start):
    """The nozzle presses the one, the probe's body and plunger the other."""
    pin = PinSpec(100.0, 100.0, 3.0, signal="nozzle_pin")
    other = PinSpec(140.0, 100.0, 14.0, signal="other")
    scene = bare(
        inputs={"nozzle_pin": "^PC4", "other": "^PC3", "probe": "^PC5"},
        mag_probe=MagProbeSpec(0.0, 20.0, 6.0, 0.5, plunger_on_pin=True),
        pin=pin,
        more_pins=(other,),
    )
    printer = placed(start(with_probe(scene)))
    printer.run("G1 X140 Y100 F9000\nPROBE\nM400")
    assert printer.machine.tip().z == pytest.approx(14.0, abs=2 * MICROSTEP)
    printer.run("G1 Z30\nG1 Y80\nPROBE\nM400")
    assert printer.machine.tip().z == pytest.approx(20.0, abs=2 * MICROSTEP)
    sites = {touch.site for touch in printer.machine.truth.touches}
    assert sites == {"nozzle_other", "body_other", "plunger_other"}


def probe_is_open(printer):
    """What QUERY_PROBE says: an absent probe reads triggered."""
    line = printer.run("QUERY_PROBE")[-1]
    return re.search(r"probe: (\w+)", line).group(1) == "open"


def test_probe_is_taken_and_left_by_moves(start):
    scene = bare(
        inputs={"probe": "^PC3", "probe_sense": "^PC4"},
        mag_probe=MagProbeSpec(
            0.0, 20.0, 6.0, 0.5, mode="dock", initial="docked"
        ),
        dock=DockSpec(200.0, 20.0, 10.0),
        probe_sense=True,
    )
    printer = placed(start(with_probe(scene)))
    assert not probe_is_open(printer)
    printer.run("G1 X200 Y60 Z10 F9000\nG1 Y20\nG1 Y60\nM400")
    assert probe_is_open(printer)
    printer.run("G1 Y20\nG1 X240\nM400")
    assert not probe_is_open(printer)
    kinds = [event.kind for event in printer.machine.truth.events]
    assert kinds == ["attach", "dock"]
