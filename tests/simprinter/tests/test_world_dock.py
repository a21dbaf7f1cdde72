"""Attaching and docking the probe, by output and by moves."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.simprinter.tests.world_machines import (
    DOCK,
    HIGH,
    MAG,
    MIDDLE,
    OUTPUT,
    Driver,
    make,
)
from tests.simprinter.world import Pose

IN_DOCK = (20.0, 300.0)
FAR = Pose(*MIDDLE, HIGH)


def events(driver: Driver) -> list[str]:
    return [event.kind for event in driver.world.truth.events]


def at_dock(initial: str) -> Driver:
    spec = DOCK
    if initial != "docked":
        probe = replace(DOCK.mag_probe, initial=initial)
        spec = replace(DOCK, mag_probe=probe)
    driver = Driver(make(spec))
    driver.go(20.0, 280.0)
    driver.go(z=20.0)
    driver.go(*IN_DOCK)
    return driver


def leave(driver: Driver, way: str) -> None:
    x, y = IN_DOCK
    if way == "approach":
        driver.go(y=y - 20)
    elif way == "release":
        driver.go(x=x + 20)
    elif way == "up":
        driver.go(z=40)
    else:
        driver.go(x=x - 15)


@pytest.mark.parametrize(
    ("initial", "way", "after"),
    [
        ("docked", "approach", "attached"),
        ("docked", "release", "docked"),
        ("docked", "up", "docked"),
        ("docked", "left", "docked"),
        ("attached", "approach", "attached"),
        ("attached", "release", "docked"),
        ("attached", "up", "attached"),
        ("attached", "left", "attached"),
        ("lost", "approach", "lost"),
        ("lost", "release", "lost"),
    ],
)
def test_the_way_out_decides(initial, way, after):
    driver = at_dock(initial)
    leave(driver, way)
    assert driver.world.probe_state(driver.t) == after
    changed = initial != after
    kinds = {"attached": ["attach"], "docked": ["dock"]}
    assert events(driver) == (kinds[after] if changed else [])


@pytest.mark.parametrize(
    ("height", "after"), [(17.1, "attached"), (16.9, "docked")]
)
def test_reach_counts_in_all_directions(height, after):
    driver = Driver(make(DOCK), speed=10.0)
    driver.go(20.0, 280.0)
    driver.go(z=height)
    driver.go(*IN_DOCK)
    driver.go(20.0, 280.0)
    assert driver.world.probe_state(driver.t) == after


def test_senses_follow_the_probe():
    driver = Driver(make(DOCK))
    world = driver.world

    def senses() -> tuple[bool, bool, bool]:
        names = ("probe", "probe_sense", "dock_sense")
        seen = [world.level(n, driver.t, driver.pose) for n in names]
        return seen[0], seen[1], seen[2]

    assert senses() == (True, False, True)
    driver.go(20.0, 280.0)
    driver.go(z=20.0)
    driver.go(*IN_DOCK)
    # Joined: the head has contact to the probe, which still is in the dock
    assert senses() == (False, True, True)
    leave(driver, "approach")
    assert senses() == (False, True, False)
    driver.go(*IN_DOCK)
    assert senses() == (False, True, True)
    leave(driver, "release")
    assert senses() == (True, False, True)


def test_output_attaches_after_its_time():
    world = make(OUTPUT)
    world.set_output("probe_attach", 1.0, 1.0)
    assert world.level("probe", 1.249, FAR)
    assert not world.level("probe_sense", 1.249, FAR)
    assert not world.level("probe", 1.25, FAR)
    assert world.level("probe_sense", 1.25, FAR)
    assert world.truth.events == []
    world.observe(1.3, FAR)
    assert world.truth.events == [(1.25, "attach")]
    # Asked for a moment before the change, with latency say
    assert world.level("probe", 1.249, FAR)
    world.set_output("probe_attach", 2.0, 0.0)
    assert world.level("probe_sense", 2.249, FAR)
    assert world.level("dock_sense", 2.25, FAR)
    world.observe(3.0, FAR)
    assert world.truth.events[1:] == [(2.25, "dock")]


def test_same_output_again_is_no_attempt():
    world = make(OUTPUT)
    world.set_output("probe_attach", 1.0, 0.0)
    world.set_output("probe_attach", 1.1, 1.0)
    world.set_output("probe_attach", 1.2, 0.8)
    world.observe(2.0, FAR)
    assert world.truth.events == [(pytest.approx(1.35), "attach")]


def test_output_taken_back_in_time_changes_nothing():
    world = make(OUTPUT)
    world.set_output("probe_attach", 1.0, 1.0)
    world.set_output("probe_attach", 1.1, 0.0)
    world.observe(2.0, FAR)
    assert world.probe_state(2.0) == "docked"
    assert world.truth.events == []


def test_fixed_probe_stays():
    driver = Driver(make(MAG))
    driver.go(*IN_DOCK)
    assert driver.world.probe_state(driver.t) == "attached"
    assert driver.world.outputs == ()
