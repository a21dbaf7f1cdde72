"""Plugins that others have written start here, and run a first command.

From checkouts of their own: STRANGERS names the folder that these are in, each
under the name of its repository. Nothing of theirs is kept here.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import pytest

from simprinter.hosts.hosts import all_hosts
from simprinter.hosts.session import SessionError
from simprinter.plugin_printer import start
from simprinter.running import SAMPLE

STRANGERS = os.environ.get("STRANGERS", "")
CFG = (SAMPLE / "printer.cfg").read_text(encoding="utf-8")

# Z homes on a pin that the nozzle presses; a switch hangs to the right of it
CFG_PIN = CFG.replace(
    "endstop_pin: probe:z_virtual_endstop",
    "endstop_pin: ^PC2\nposition_endstop: 1",
)
for old, new in (
    ("position_min: -3", "position_min: -5"),
    ("x_offset: -25", "x_offset: 25"),
    ("z_offset: 1.5", "z_offset: 6.5"),
    ("home_xy_position: 110, 110", "home_xy_position: 200, 200"),
):
    assert old in CFG_PIN
    CFG_PIN = CFG_PIN.replace(old, new)
PROBE = CFG_PIN[CFG_PIN.index("[probe]") : CFG_PIN.index("[safe_z_home]")]

WORLD = """
[start]
x_world_mm = 20
y_world_mm = 20
z_world_mm = 10
[bed]
x_max_world_mm = 220
y_max_world_mm = 220
[z_pin]
x_world_mm = 200
y_world_mm = 200
trigger_z_world_mm = 1.0
noise.sigma_mm = 0.001
[[switches]]
signal = "x_endstop"
axis = "x"
trigger_world_mm = 0
direction = -1
[[switches]]
signal = "y_endstop"
axis = "y"
trigger_world_mm = 0
direction = -1
[switch_probe]
x_from_nozzle_mm = 25
y_from_nozzle_mm = 0
body_below_nozzle_mm = 6
trigger_below_body_mm = 0.5
[signals]
x_endstop = "^PC0"
y_endstop = "^PC1"
z_endstop = "^PC2"
probe = "^PC3"
"""
# The nozzle is sensed on the bed, too, or on a switch of 1 mm that lies there
SENSED = (SAMPLE / "world.toml").read_text(encoding="utf-8")
SENSED = SENSED.replace("[signals]", "[bed_sensor]\n[signals]")
SENSED += 'bed_sensor = "^PC5"\n'
LAID = SENSED.replace(
    "[bed_sensor]",
    "[membrane]\nx_world_mm = 110\ny_world_mm = 110\nthickness_mm = 1.0\n"
    "radius_mm = 10.0\npress_mm = 0.1",
).replace("bed_sensor", "membrane")
DOCKED = WORLD.replace(
    "trigger_below_body_mm = 0.5",
    """trigger_below_body_mm = 0.5
mode = "dock"
initial = "docked"
[dock]
x_world_mm = 100
y_world_mm = 215
z_world_mm = 20
approach_direction = [0, -1, 0]
release_direction = [1, 0, 0]
""",
).replace(
    "[signals]",
    """[machine]
senses_probe = true
[signals]
probe_sense = "!PC4"
""",
)


class Stranger(NamedTuple):
    """A plugin, a printer that it is made for, and what it does first."""

    files: tuple[str, ...]
    cfg: str
    world: str
    gcode: str
    told: str
    touched: tuple[str, ...] = ()
    events: tuple[str, ...] = ()


PLUGINS = {
    "klipper_z_calibration": Stranger(
        ("z_calibration.py",),
        f"{CFG_PIN}\n[z_calibration]\nnozzle_xy_position: 200, 200\n"
        "switch_xy_position: 175, 200\nbed_xy_position: 100, 100\n"
        "switch_offset: 0.5\nclearance: 15\n",
        WORLD,
        "G28\nCALIBRATE_Z",
        "switch",
        ("nozzle_pin", "body_pin", "probe_bed"),
    ),
    "klipper_dockable_probe": Stranger(
        ("dockable_probe.py",),
        CFG_PIN.replace(PROBE, "")
        + "\n[dockable_probe]\npin: ^PC3\nx_offset: 25\nz_offset: 6.5\n"
        "probe_sense_pin: !PC4\n"
        "dock_position: 100, 215, 20\napproach_position: 100, 190, 20\n"
        "detach_position: 130, 215, 20\nsafe_z_position: 110, 110\n",
        DOCKED,
        "G28\nG1 Z25 F600\nATTACH_PROBE",
        "",
        (),
        ("attach",),
    ),
    "extra-probe": Stranger(
        ("extra_probe.py",),
        f"{CFG}\n[extra_probe bed]\npin: ^PC5\n",
        LAID,
        "G28\nG1 Z5 F600\nEXTRA_PROBE PROBE=bed",
        "is z=0.9",
        ("nozzle_membrane",),
    ),
    "klipper-toolchanger": Stranger(
        ("klipper/extras/tools_calibrate.py",),
        f"{CFG}\n[tools_calibrate]\npin: ^PC5\n",
        SENSED,
        "G28\nTOOL_CALIBRATE_QUERY_PROBE",
        "Calibration Probe: open",
    ),
    "klipper_tmc_autotune": Stranger(
        ("autotune_tmc.py", "motor_constants.py", "motor_database.cfg"),
        f"{CFG}\n[tmc2209 stepper_x]\nuart_pin: PE0\nrun_current: 0.8\n"
        "sense_resistor: 0.110\n"
        "[autotune_tmc stepper_x]\nmotor: ldo-36sth20-1004ahg\n",
        (SAMPLE / "world.toml").read_text(encoding="utf-8"),
        "AUTOTUNE_TMC STEPPER=stepper_x\nDUMP_TMC STEPPER=stepper_x",
        "PWMCONF",
    ),
}


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", PLUGINS)
def test_plugin_of_somebody_else_runs_a_first_command(name):
    """On the newest host that it starts on: some have not followed Klipper."""
    if not (Path(STRANGERS) / name).is_dir() or not STRANGERS:
        pytest.skip(f"STRANGERS names no folder with a checkout of {name}")
    stranger = PLUGINS[name]
    extras = [Path(STRANGERS) / name / file for file in stranger.files]
    refused = []
    for host in reversed(all_hosts()):
        try:
            printer = start(host, stranger.cfg, stranger.world, extras)
        except SessionError as error:
            refused.append(f"{host.name}: {error}")
            continue
        with printer:
            lines = printer.run(stranger.gcode)
            told = "\n".join(lines)
            assert stranger.told in told, told
            touched = {touch.site for touch in printer.touches}
            assert set(stranger.touched) <= touched
            events = [event.kind for event in printer.truth.events]
            assert events == list(stranger.events)
        return
    raise AssertionError("\n".join(refused))
