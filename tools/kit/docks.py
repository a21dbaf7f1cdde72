"""Machines with a dock: that of machines/dock_gantry_switch.cfg, and others made of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from simprinter.world import DockSpec

from .scenes import SCENES, Scene, machine, on_carriages, on_gantry

# Of the machines here (mm): the probe triggers at this toolhead Z on the bed
HANG = 6.9

# The voron, its dock on the gantry's left; Z homes on the pin
_SWITCH = machine("dock_gantry_switch")


def _gantry() -> Scene:
    """The same, Z homed with the probe."""
    switch = _SWITCH
    z = dict(switch.sections["stepper_z"] or {})
    z.update(endstop_pin="probe:z_virtual_endstop", position_endstop=None)
    sections = {**switch.sections, "stepper_z": z}
    sections["safe_z_home"] = {
        "home_xy_position": "152, 125.25",
        "speed": "100",
        "z_hop": "10",
    }
    wiring = replace(
        switch.wiring,
        inputs={
            k: v for k, v in switch.wiring.inputs.items() if k != "z_endstop"
        },
    )
    return replace(
        switch, name="dock_gantry", sections=sections, wiring=wiring
    ).with_world(pin=None)


def _sensed() -> Scene:
    """The same, with sensors for the probe on the toolhead and in the dock."""
    gantry = _gantry()
    senses = {"probe_sense": "^PC4", "dock_sense": "^PC5"}
    wiring = replace(gantry.wiring, inputs={**gantry.wiring.inputs, **senses})
    options = {
        **(gantry.sections["dockable_probe"] or {}),
        **{f"{name}_pin": pin for name, pin in senses.items()},
    }
    return replace(
        gantry,
        name="dock_sensed",
        sections={**gantry.sections, "dockable_probe": options},
        wiring=wiring,
    ).with_world(probe_sense=True, dock_sense=True)


def _servo() -> Scene:
    """The dock of the file, but a servo swings the dock out, and in again."""
    switch = _SWITCH
    assert switch.world.dock is not None
    out = "\n  SET_SERVO SERVO=dock ANGLE=90\n  G4 P400"
    away = "\n  SET_SERVO SERVO=dock ANGLE=0\n  G4 P400"
    options = {
        **(switch.sections["dockable_probe"] or {}),
        "pre_attach_gcode": out,
        "post_attach_gcode": away,
        "pre_detach_gcode": out,
        "post_detach_gcode": away,
    }
    sections: dict[str, Mapping] = {
        **switch.sections,
        "dockable_probe": options,
        "servo dock": {
            "pin": "PD5",
            "maximum_servo_angle": "180",
            "minimum_pulse_width": "0.0005",
            "maximum_pulse_width": "0.0025",
        },
    }
    wiring = replace(switch.wiring, outputs={"dock_swing": "PD5"})
    scene = replace(switch, name="dock_servo", sections=sections, wiring=wiring)
    return scene.with_world(dock=replace(switch.world.dock, swing=0.3))


def _frame() -> Scene:
    """A bed that goes up and down on three screws, and hangs askew.

    The gantry stands still: its dock is at the left, in the frame, and is left to
    the back. X is homed to the right and then Y along that side, so a dock there
    would be in the way. Z is homed with the probe.
    """
    gantry = _gantry()
    screws = {"z": (-50.0, 18.0), "z1": (150.0, 348.0), "z2": (350.0, 18.0)}
    scene = on_gantry(gantry, "dock_frame", gantry.kinematics, **screws)
    options = {
        **(gantry.sections["dockable_probe"] or {}),
        "dock_position": "2, 200, 8",
        "approach_position": "44, 200",
        "detach_position": "2, 240",
        "dock_fixed_z": "True",
    }
    sections: dict[str, Mapping] = {
        **{k: v for k, v in scene.sections.items() if k != "quad_gantry_level"},
        "dockable_probe": options,
        "z_tilt": {
            "z_positions": "-50, 18\n  150, 348\n  350, 18",
            "points": "40, 20\n  150, 230\n  250, 20",
            "speed": "200",
            "horizontal_move_z": "10",
            "retries": "3",
            "retry_tolerance": "0.02",
        },
    }
    return replace(scene, sections=sections).with_world(
        bed=replace(scene.world.bed, slope_x=0.004, slope_y=-0.006),
        dock=DockSpec(
            2.0,
            200.0,
            0.0,
            approach=(1.0, 0.0, 0.0),
            release=(0.0, 1.0, 0.0),
            lifted=True,
            body=20.0,
        ),
    )


def _bed() -> Scene:
    """A cartesian printer, the dock on the bed: 12 mm high, Z has a switch."""
    switch = _SWITCH
    assert switch.world.dock is not None
    options = {
        **(switch.sections["dockable_probe"] or {}),
        "dock_position": "50, 308, 12",
        "approach_position": "50, 270, 12",
        "detach_position": "90, 308, 12",
        "dock_fixed_z": "False",
    }
    printer = {**(switch.sections["printer"] or {}), "kinematics": "cartesian"}
    return replace(
        switch,
        name="dock_bed",
        kinematics="cartesian",
        sections={
            **{
                name: section
                for name, section in switch.sections.items()
                if name != "quad_gantry_level"
            },
            "dockable_probe": options,
            "printer": printer,
        },
    ).with_world(dock=replace(switch.world.dock, lifted=False, z=12.3, top=12))


def _above() -> Scene:
    """The same, but the probe is taken up out of the dock, which is left that
    way; the toolhead has to be 24.3 mm high over the dock or beside it."""
    bed = _bed()
    assert bed.world.dock is not None
    options = {
        **(bed.sections["dockable_probe"] or {}),
        "approach_position": "50, 308, 30",
        "safe_dock_distance": "40",
    }
    dock = replace(bed.world.dock, approach=(0.0, 0.0, 1.0))
    return replace(
        bed,
        name="dock_above",
        sections={**bed.sections, "dockable_probe": options},
    ).with_world(dock=dock)


def _slinger() -> Scene:
    """A bed slinger: the dock at the right end of its gantry holds the probe back
    when the toolhead goes down in it; it comes in and goes out along X. Z is homed with
    the probe.
    """
    gantry = _gantry()
    assert gantry.world.dock is not None
    options = {
        **(gantry.sections["dockable_probe"] or {}),
        "dock_position": "296, 5",
        "approach_position": "256, 5",
        "detach_position": "256, 5, 2",
        "dock_fixed_z": "True",
    }
    printer = {**(gantry.sections["printer"] or {}), "kinematics": "cartesian"}
    return replace(
        gantry,
        name="dock_slinger",
        kinematics="cartesian",
        sections={
            **{
                name: section
                for name, section in gantry.sections.items()
                if name != "quad_gantry_level"
            },
            "dockable_probe": options,
            "printer": printer,
        },
    ).with_world(
        dock=replace(
            gantry.world.dock,
            x=296.0,
            y=5.0,
            approach=(-1.0, 0.0, 0.0),
            release=(0.0, 0.0, -1.0),
        )
    )


def on_generic(scene: Scene) -> Scene:
    """The same as a generic cartesian, which the world calls cartesian."""
    motors = ("x", "y", *(name for name, _, _ in scene.z_motors))
    names = {motor: f"my_{motor}" for motor in motors}
    return replace(
        scene,
        name=f"{scene.name}_generic",
        kinematics="cartesian",
        sections=on_carriages(scene.sections, names),
    )


def calibrating(scene: Scene) -> Scene:
    """The same with the voron's [z_calibration], nothing said of the probe."""
    section = SCENES["voron"].sections["z_calibration"]
    sections = {**scene.sections, "z_calibration": section}
    return replace(scene, sections=sections)


DOCK_SCENES = {
    scene.name: scene
    for scene in (
        _SWITCH,
        _gantry(),
        _sensed(),
        _servo(),
        _frame(),
        _bed(),
        _above(),
    )
}

# Not like the others: its probe is stripped off only where Z is homed
SLINGER = _slinger()
