"""Two detachable probes, in two docks or on two carriages, on real klippy."""

from __future__ import annotations

import re

import pytest

from simprinter import plugin_printer
from simprinter.running import SAMPLE
from simprinter.tests.test_second_carriage import CFG as TWO_CARRIAGES
from simprinter.tests.test_second_carriage import DY, world_of
from simprinter.world import (
    CarriageSpec,
    DockSpec,
    MagProbeSpec,
    Pose,
    World,
    WorldSpec,
)
from simprinter.world_file import WorldFileError

CFG = (SAMPLE / "printer.cfg").read_text(encoding="utf-8")
# Z homes on a switch of its own; klippy may probe with one, and look at the other
CFG = CFG.replace(
    "endstop_pin: probe:z_virtual_endstop",
    "endstop_pin: ^PC2\nposition_endstop: 0.5",
)
CFG += "[gcode_button other]\npin: ^PC6\npress_gcode:\n"
WORLD = (SAMPLE / "world.toml").read_text(encoding="utf-8")
begin, end = WORLD.index("[inductive_probe]"), WORLD.index("# As printer.cfg")
# Both hang to the left of the nozzle; the second is 1 mm longer
PROBES = """
[[switches]]
signal = "z_endstop"
axis = "z"
trigger_world_mm = 0.5
direction = -1
[switch_probe]
x_from_nozzle_mm = -25
y_from_nozzle_mm = 0
body_below_nozzle_mm = 5
trigger_below_body_mm = 0.5
mode = "dock"
initial = "docked"
[dock]
x_world_mm = 60
y_world_mm = 215
z_world_mm = 20
approach_direction = [0, -1, 0]
release_direction = [1, 0, 0]
[[more_probes]]
signal = "long"
x_from_nozzle_mm = -25
y_from_nozzle_mm = 0
body_below_nozzle_mm = 6
trigger_below_body_mm = 0.5
mode = "dock"
initial = "docked"
[more_probes.dock]
x_world_mm = 150
y_world_mm = 215
z_world_mm = 20
approach_direction = [0, -1, 0]
release_direction = [1, 0, 0]
"""
WORLD = (
    f'{WORLD[:begin]}{PROBES}{WORLD[end:]}z_endstop = "^PC2"\nlong = "^PC6"\n'
)


def fetch(printer, x):
    """Into the dock there and out of it, towards the front."""
    printer.run(f"G90\nG1 Z20 F900\nG1 X{x} Y200 F6000\nG1 Y215\nM400")
    # Klipper of 2023 misses a button that changes twice while G-code runs
    printer.session.wait(0.5)
    printer.run("G1 Y190\nM400")


def strip(printer, x):
    """Into the dock there and out of it, to the right."""
    printer.run(f"G1 Z20 F900\nG1 X{x} Y190 F6000\nG1 Y215\nG1 X{x + 20}\nM400")
    printer.run("G1 Y190\nM400")


def reads(printer):
    """What klippy sees of both switches: True where it reads triggered."""
    lines = printer.run("QUERY_PROBE")
    first = any("TRIGGERED" in line for line in lines)
    printer.session.wait(0.5)
    return first, printer.status("gcode_button other")["state"] == "PRESSED"


def test_which_is_attached_decides_which_switch_answers(start):
    printer = start(plugin_printer.read_scene(CFG, WORLD)).homed()
    # Normally closed: what is not there reads triggered
    assert reads(printer) == (True, True)
    fetch(printer, 60)
    assert reads(printer) == (False, True)
    printer.run("G1 X110 Y110 F6000\nPROBE")
    touch = printer.machine.truth.touches[-1]
    assert (touch.site, touch.trigger_z) == ("probe_bed", pytest.approx(5.5))
    # Where the other one is kept it is not taken along beside the first
    fetch(printer, 150)
    assert reads(printer) == (False, True)
    strip(printer, 60)
    assert reads(printer) == (True, True)
    fetch(printer, 150)
    assert reads(printer) == (True, False)
    truth = printer.machine.truth
    events = [(e.kind, e.signal) for e in truth.events]
    assert events == [
        ("attach", "probe"),
        ("attach_failed", "long"),
        ("dock", "probe"),
        ("attach", "long"),
    ]
    # It is longer: pressed 0.3 mm deep where the first would not touch yet
    printer.run("G1 X110 Y110 F6000\nG1 Z6.2 F300\nM400")
    assert reads(printer) == (True, True)
    assert truth.touches[-1].site == "long_bed"
    assert truth.touches[-1].trigger_z == pytest.approx(6.5)
    # Its body would be on the bed where that of the first is not
    printer.run("G1 Z5.9\nM400")
    crashes = printer.machine.truth.crashes()
    assert [crash.site for crash in crashes] == ["long_body_bed"]
    truth.forget()


ONE_EACH = """
[switch_probe]
x_from_nozzle_mm = 0
y_from_nozzle_mm = 20
body_below_nozzle_mm = 3
trigger_below_body_mm = 0.5
[[more_probes]]
signal = "second"
on_second_carriage = true
x_from_nozzle_mm = 0
y_from_nozzle_mm = 20
body_below_nozzle_mm = 4
trigger_below_body_mm = 0.5
[signals]
second = "^PC5"
"""


def test_each_carriage_has_its_own(start, tmp_path):
    """The probe of klippy is on the second one; the first is parked."""
    world = world_of(TWO_CARRIAGES, tmp_path)
    begin = world.index("[bed_sensor]")
    end = world.index("[signals]")
    world = world[:begin] + ONE_EACH + world[end + len("[signals]") :]
    world = world.replace("bed_sensor =", "probe =")
    cfg = TWO_CARRIAGES.replace("^PC3\nz_offset: 0", "^PC3\nz_offset: 3.5")
    printer = start(plugin_printer.read_scene(cfg, world)).homed()
    assert printer.machine.truth.touches[-1].site == "probe_bed"
    printer.run("G1 X-40 Z10 F6000\nSET_DUAL_CARRIAGE CARRIAGE=1\nG1 X110 Y90")
    # The wire of the first one's hears nothing of the second one's
    printer.run("G1 Z4.3 F300\nM400")
    touch = printer.machine.truth.touches[-1]
    assert touch.site == "second_bed"
    assert touch.y == pytest.approx(90 + DY, abs=0.02)
    assert not printer.machine.world.level(
        "probe", 1e6, *(printer.machine.tip(i) for i in (0, 1))
    )


def test_only_its_own_carriage_takes_it():
    dock = DockSpec(150.0, 215.0, 20.0, approach=(0.0, -1.0, 0.0))
    probe = MagProbeSpec(
        0.0, 20.0, 5.0, 0.5, mode="dock", initial="docked", signal="right",
        on_second=True, dock=dock,
    )  # fmt: skip
    carriage = CarriageSpec(250.0)
    spec = WorldSpec(more_probes=(probe,), second_carriage=carriage)
    for who, state in ((0, "docked"), (1, "attached")):
        world = World(spec, 0)
        for t, y in enumerate((190.0, 215.0, 190.0)):
            poses = [Pose(0.0, y, 20.0), Pose(250.0, y, 20.0)]
            poses[who] = Pose(150.0, y, 20.0)
            world.observe(float(t), *poses)
            # Normally closed: it reads open where it is met
            is_met = who == 1 and t > 0
            assert world.level("right", float(t), *poses) is not is_met
        assert world.probe_state(9.0, "right") == state


def test_each_needs_a_dock_and_a_signal_of_its_own():
    for old, new, wanted in (
        ('signal = "long"\n', "", r"\['probe'\] is that of more"),
        ("[more_probes.dock]", "[more_probes.docks]", "do you mean dock"),
        ('"docked"\n[more', '"docked"\n[drift]\n[ignored', "is unknown"),
        ('"long"\n', '"long"\non_second_carriage = true\n', "what is on it"),
    ):
        assert old in WORLD
        with pytest.raises(WorldFileError, match=wanted):
            plugin_printer.read_scene(CFG, WORLD.replace(old, new))
    without = re.sub(r"\[more_probes.dock\](.|\n)*?(?=\n# As)", "", WORLD)
    with pytest.raises(WorldFileError, match=r"a \[dock\] each"):
        plugin_printer.read_scene(CFG, without)
