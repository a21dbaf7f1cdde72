"""Noise: one draw per touch, from the seed and nothing else."""

from __future__ import annotations

import statistics
from dataclasses import replace

import pytest

from simprinter.tests.world_machines import (
    HIGH,
    MAG,
    OVER_PIN,
    Driver,
    make,
)
from simprinter.world import NoiseSpec, WorldSpec


def noisy(**noise: float) -> WorldSpec:
    return replace(MAG, pin=replace(MAG.pin, noise=NoiseSpec(**noise)))


def series(
    spec: WorldSpec, count: int, seed: int = 1, looks: int = 0
) -> list[float]:
    driver = Driver(make(spec, seed=seed), speed=400.0)
    driver.go(*OVER_PIN)
    heights = []
    for _ in range(count):
        heights.append(driver.touch("z_endstop"))
        for _ in range(looks):
            driver.find("z_endstop")
    return heights


def test_sigma_is_recovered():
    heights = series(noisy(sigma=0.01), 600)
    assert statistics.mean(heights) == pytest.approx(3.0, abs=0.002)
    assert statistics.stdev(heights) == pytest.approx(0.01, rel=0.1)
    assert len(set(heights)) == 600
    assert series(MAG, 5) == pytest.approx([3.0] * 5, abs=1e-12)


def test_same_seed_same_numbers_whatever_else_happens():
    spec = noisy(sigma=0.01, outlier_chance=0.2, outlier_size=0.1)
    heights = series(spec, 20)
    assert series(spec, 20, looks=3) == heights
    assert series(spec, 20, seed=2) != heights
    # Arming without a touch, and touches of another signal
    probe = replace(MAG.mag_probe, noise=NoiseSpec(sigma=0.01))
    driver = Driver(make(replace(spec, mag_probe=probe)))
    driver.touch("probe")
    driver.go(z=HIGH)
    driver.go(*OVER_PIN)
    found = []
    for _ in range(5):
        driver.world.touch_armed("z_endstop", driver.t)
        found.append(driver.touch("z_endstop"))
    assert found == heights[:5]


@pytest.mark.parametrize(
    ("lift", "arms", "same"),
    [(0.15, False, True), (0.5, False, False), (0.1, True, False)],
)
def test_small_lift_is_the_same_touch_unless_armed(lift, arms, same):
    driver = Driver(make(noisy(sigma=0.01)))
    driver.go(*OVER_PIN)
    first = driver.find("z_endstop")
    driver.go(z=first)
    driver.go(z=first + lift)
    if arms:
        driver.world.touch_armed("z_endstop", driver.t)
    again = driver.find("z_endstop")
    assert (again == pytest.approx(first, abs=1e-9)) is same


def test_arming_while_pressed_does_not_move_the_trigger_of_the_touch():
    """As klippy does, before the lift that comes first."""
    driver = Driver(make(noisy(outlier_chance=0.5, outlier_size=0.3)))
    driver.go(*OVER_PIN)
    for _ in range(30):
        trigger = driver.find("z_endstop")
        driver.go(z=trigger - 0.01)
        driver.world.touch_armed("z_endstop", driver.t)
        driver.go(z=trigger - 0.02)
        driver.go(z=trigger + 2.0)
    assert driver.world.truth.depth("nozzle_pin") == pytest.approx(0.02)


def test_outliers():
    spec = noisy(outlier_chance=0.25, outlier_size=0.3)
    heights = series(spec, 400)
    early = [z for z in heights if z == pytest.approx(3.3)]
    exact = [z for z in heights if z == pytest.approx(3.0)]
    assert len(early) + len(exact) == 400
    assert 70 <= len(early) <= 130
    # One is no touch on the way up
    driver = Driver(make(noisy(outlier_chance=0.5, outlier_size=1.0)))
    driver.go(*OVER_PIN)
    for _ in range(30):
        driver.touch("z_endstop")
    assert driver.world.truth.touch_count("nozzle_pin") == 30


def test_touch_record_has_the_trigger_of_that_touch():
    driver = Driver(make(noisy(sigma=0.01)))
    driver.go(*OVER_PIN)
    heights = []
    for _ in range(5):
        driver.world.touch_armed("z_endstop", driver.t)
        heights.append(driver.find("z_endstop"))
        driver.go(z=heights[-1] - 0.02)
        driver.go(z=6.0)
    recorded = [touch.trigger_z for touch in driver.world.truth.touches]
    assert recorded == pytest.approx(heights, abs=1e-9)
