"""Machines as they are at home: what their owners have measured."""

from __future__ import annotations

import math
import statistics

import pytest

from simprinter import Machine, real
from simprinter.tests.world_machines import Driver, make
from tools.kit.docks import DOCK_SCENES
from tools.kit.scenes import SCENES

VORON = SCENES["voron"]


@pytest.mark.parametrize("name", [*SCENES, *DOCK_SCENES])
def test_every_machine_can_be_real(name):
    scene = {**SCENES, **DOCK_SCENES}[name]
    spec = real.as_real(scene, 1).world
    assert real.as_real(scene, 1).sections == scene.sections
    for part in ("pin", "mag_probe", "inductive", "bed_sensor", "membrane"):
        perfect, found = getattr(scene.world, part), getattr(spec, part)
        if perfect is None:
            assert found is None
            continue
        assert 0.001 <= found.noise.sigma <= 0.002
        # What it is else stays
        assert found.noise.latency == perfect.noise.latency
    probe = spec.mag_probe
    assert probe is None or (probe.reseat > 0.0) == (probe.mode != "fixed")
    with Machine(real.as_real(scene, 1)):
        pass


def test_switch_varies_as_those_of_owners_do():
    spec = real.as_real(VORON).world
    driver = Driver(make(spec, seed=2), speed=400.0)
    x, y = VORON.world.pin.x, VORON.world.pin.y
    driver.go(x, y, 20.0)
    heights = [driver.touch("z_endstop") for _ in range(600)]
    middle = statistics.median(heights)
    near = [z for z in heights if abs(z - middle) < 0.02]
    assert statistics.stdev(near) == pytest.approx(0.0014, rel=0.15)
    assert 1 <= len(heights) - len(near) <= 9
    assert max(heights) - middle == pytest.approx(0.0275, abs=0.008)


def test_plate_is_rough_from_millimetre_to_millimetre():
    bed = real.textured(VORON.world.bed, 1)
    rows = bed.mesh.heights
    steps = [b - a for row in rows for a, b in zip(row, row[1:])]
    assert 0.09 < max(steps) <= real.TEXTURE
    assert abs(statistics.mean(z for row in rows for z in row)) < 0.001
    assert (bed.mesh.x_max - bed.mesh.x_min) / (len(rows[0]) - 1) == real.GRID
    assert real.textured(VORON.world.bed, 2) != bed
    assert real.textured(bed, 2) == bed


def test_heights_grow_as_in_the_plot_and_then_stand():
    drift = real.warming_up()
    grown = drift.tau * -math.expm1(-600.0 / drift.tau)
    nozzle, body, bed = (
        1000.0 * grown * sum(getattr(drift, part) for part in parts)
        for parts in (("pin", "nozzle"), ("pin", "body"), ("bed", "body"))
    )
    assert nozzle == pytest.approx(34.0, rel=0.1)
    assert body == pytest.approx(10.0, rel=0.1)
    assert bed == pytest.approx(23.0, rel=0.1)
    later = drift.tau * -math.expm1(-1200.0 / drift.tau)
    assert later / grown < 1.1
