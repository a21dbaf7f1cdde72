"""What a hand does to a machine while it lives, and what is near its head."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.tests.world_machines import (
    BODY_OVER_PIN,
    DOCK,
    MAG,
    MEMBRANE,
    MIDDLE,
    OVER_PIN,
    PIEZO,
    Driver,
    make,
)
from simprinter.world import Pose

SHIFTS = pytest.mark.parametrize("mm", [0.3, -0.3])


def heights(driver: Driver) -> tuple[float, float, float]:
    """Of nozzle and body on the pin, and of the probe on the bed."""
    found = []
    for place, signal in (
        (OVER_PIN, "z_endstop"),
        (BODY_OVER_PIN, "z_endstop"),
        (MIDDLE, "probe"),
    ):
        driver.go(z=40.0)
        driver.go(*place)
        found.append(driver.touch(signal))
    driver.go(z=40.0)
    return tuple(found)


def gap(driver: Driver) -> float:
    return driver.world.truth.true_gap(*MIDDLE, 10.0, driver.t)


@SHIFTS
def test_another_nozzle_hangs_lower(mm):
    driver = Driver(make(MAG))
    nozzle, body, bed = heights(driver)
    before = gap(driver)
    driver.world.exchange_nozzle(mm)
    assert heights(driver) == pytest.approx((nozzle + mm, body, bed))
    assert gap(driver) == pytest.approx(before - mm)
    driver.world.exchange_nozzle(0.0)
    assert heights(driver) == pytest.approx((nozzle, body, bed))


@SHIFTS
def test_another_plate_is_higher(mm):
    driver = Driver(make(MAG))
    nozzle, body, bed = heights(driver)
    before = gap(driver)
    driver.world.exchange_plate(mm)
    assert heights(driver) == pytest.approx((nozzle, body, bed + mm))
    assert gap(driver) == pytest.approx(before - mm)


def test_a_crash_on_another_plate_is_seen_where_it_is():
    driver = Driver(make(MAG))
    driver.world.exchange_plate(0.4)
    driver.go(*MIDDLE, z=1.0)
    surface = driver.pose.z - driver.world.truth.true_gap(*driver.pose, 0.0)
    driver.go(z=surface - 0.2)
    (crash,) = [
        c for c in driver.world.truth.crashes() if c.site == "nozzle_bed"
    ]
    assert crash.depth == pytest.approx(0.2)


def test_dirt_is_pressed_flat_and_wiped_off():
    driver = Driver(make(MAG))
    driver.go(*OVER_PIN)
    clean = driver.touch("z_endstop")
    driver.world.smear_nozzle(driver.t, 0.1)
    found = [driver.touch("z_endstop") - clean for _ in range(3)]
    assert found == pytest.approx([0.1, 0.07, 0.049])
    assert driver.world.dirt(driver.t) == pytest.approx(0.0343)
    driver.world.smear_nozzle(driver.t, 0.0)
    assert driver.touch("z_endstop") == pytest.approx(clean)


def test_dirt_is_felt_by_a_sensor_below_the_bed_and_by_a_membrane():
    for spec, place, signal in (
        (PIEZO, MIDDLE, "bed_sensor"),
        (MEMBRANE, (30.0, 20.0), "membrane"),
    ):
        driver = Driver(make(spec))
        if signal == "bed_sensor":
            driver.world.set_output("bed_sensor_enable", 0.0, 1.0)
        driver.go(*place)
        clean = driver.touch(signal)
        driver.world.smear_nozzle(driver.t, 0.1)
        assert driver.touch(signal) == pytest.approx(clean + 0.1)
        assert driver.world.dirt(driver.t) == pytest.approx(0.07)


@pytest.mark.parametrize("spec", [MAG, DOCK])
def test_probe_is_taken_off_and_put_on(spec):
    driver = Driver(make(spec))
    world = driver.world
    if spec is DOCK:
        world.put_probe_on(driver.t)
    driver.stay(0.1)
    assert world.probe_state(driver.t) == "attached"
    world.take_probe_off(driver.t)
    driver.stay(0.1)
    assert world.probe_state(driver.t) == "docked"
    assert world.level("probe", driver.t, driver.pose)
    world.put_probe_on(driver.t)
    driver.stay(0.1)
    assert world.probe_state(driver.t) == "attached"


def test_what_is_near():
    """By the name of its place: how far, and whether it is pressed."""
    driver = Driver(make(MAG))
    driver.go(*OVER_PIN)
    here = Pose(*OVER_PIN, 7.0)
    near = {n.site: n for n in driver.world.near(driver.t, here)}
    assert near["nozzle_pin"].distance == pytest.approx(7.0 - MAG.pin.z)
    assert "body_pin" not in near
    driver.go(z=MAG.pin.z - 0.01)
    near = {n.site: n for n in driver.world.near(driver.t, driver.pose)}
    assert near["nozzle_pin"].distance == pytest.approx(-0.01)
    assert near["nozzle_pin"].pressed
    driver.go(z=30.0)
    driver.go(*MIDDLE)
    near = {n.site: n for n in driver.world.near(driver.t, driver.pose)}
    assert set(near) == {"nozzle_bed", "probe_bed", "body_bed"}
    probe = replace(MAG).mag_probe
    hangs = probe.body_drop + probe.switch_offset + probe.pretravel
    lower = near["nozzle_bed"].distance - near["probe_bed"].distance
    # The bed is another one below the probe
    assert lower == pytest.approx(hangs, abs=0.1)
    driver.world.lose_probe(driver.t)
    driver.stay(0.1)
    near = driver.world.near(driver.t, driver.pose)
    assert [n.site for n in near] == ["nozzle_bed"]
