"""Attaching and docking the probe, by output and by moves."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.tests.world_machines import (
    DOCK,
    HIGH,
    MIDDLE,
    OUTPUT,
    Driver,
    make,
)
from simprinter.world import Pose

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


# Ways out of the dock
WAYS = {
    "approach": {"y": 280.0},
    "release": {"x": 40.0},
    "up": {"z": 40.0},
    "left": {"x": 5.0},
}


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
    driver.go(**WAYS[way])
    assert driver.world.probe_state(driver.t) == after
    changed = initial != after
    kinds = {"attached": ["attach"], "docked": ["dock"]}
    assert events(driver) == (kinds[after] if changed else [])


# In a dock that goes up and down with the toolhead, and is left along Y both times
@pytest.mark.parametrize(
    ("stroke", "after"),
    [
        (-4.0, "docked"),
        (-2.0, "attached"),
        (0.0, "attached"),
        (4.0, "attached"),
    ],
)
def test_stroke_that_strips_the_probe_off(stroke, after):
    dock = replace(DOCK.dock, lifted=True, release=(0.0, 0.0, -1.0))
    probe = replace(DOCK.mag_probe, initial="attached")
    driver = Driver(make(replace(DOCK, mag_probe=probe, dock=dock)))
    driver.go(20.0, 280.0)
    driver.go(z=20.0)
    driver.go(*IN_DOCK)
    driver.go(z=20.0 + stroke)
    driver.go(20.0, 280.0)
    assert driver.world.probe_state(driver.t) == after


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


def at(driver: Driver) -> str:
    return driver.world.probe_state(driver.t)


def test_dock_that_is_left_upwards():
    dock = replace(DOCK.dock, approach=(0, 0, 1), body=15.0, top=10.0)
    driver = Driver(make(replace(DOCK, dock=dock)))
    # Over it, and straight down
    driver.go(*IN_DOCK)
    driver.go(z=20.0)
    driver.go(z=40.0)
    assert at(driver) == "attached"
    assert not driver.world.truth.crashes()
    driver.go(z=20.0)
    driver.go(40.0)
    assert at(driver) == "docked"
    assert not driver.world.truth.crashes()
    # Lower than its top from the side, and straight down beside the middle
    driver.go(y=310.0)
    assert not driver.world.truth.crashes()
    driver.go(30.0)
    assert driver.world.truth.crashes()[0].site == "dock"


SWUNG = replace(
    DOCK, dock=replace(DOCK.dock, swing=0.3, body=15.0, approach=(0, -1, 0))
)


def swung(*, out: bool) -> Driver:
    driver = Driver(make(SWUNG))
    driver.go(20.0, 270.0)
    driver.go(z=20.0)
    if out:
        driver.world.set_output("dock_swing", driver.t, 0.075)
    driver.stay(0.4)
    return driver


def test_dock_that_a_servo_swings_out():
    driver = swung(out=True)
    driver.go(*IN_DOCK)
    driver.go(20.0, 270.0)
    driver.world.set_output("dock_swing", driver.t, 0.025)
    driver.stay(0.4)
    # It is not in the way any more, but for where it would be met
    driver.go(30.0, 290.0)
    assert at(driver) == "attached"
    assert not driver.world.truth.crashes()
    driver.go(20.0, 300.0)
    assert driver.world.truth.crashes()[0].depth > 2.9
    assert at(driver) == "attached"


@pytest.mark.parametrize("out", [False, True])
def test_servo_that_swings_the_dock_against_the_head(out):
    driver = swung(out=out)
    # In its lane, clear of it while it stands still
    driver.go(20.0, 290.0)
    assert not driver.world.truth.crashes()
    driver.world.set_output("dock_swing", driver.t, 0.025 if out else 0.075)
    driver.stay(0.1)
    assert driver.world.truth.crashes()[0].site == "dock"


def test_nothing_is_fetched_from_a_dock_that_is_in():
    driver = swung(out=False)
    driver.go(*IN_DOCK)
    driver.go(20.0, 270.0)
    assert at(driver) == "docked"
    assert driver.world.truth.crashes()[0].site == "dock"


def test_probe_that_is_normally_open():
    probe = replace(DOCK.mag_probe, normally_open=True, initial="attached")
    driver = Driver(make(replace(DOCK, mag_probe=probe)))
    closed = replace(probe, normally_open=False)
    usual = Driver(make(replace(DOCK, mag_probe=closed)))
    assert not driver.world.level("probe", driver.t, driver.pose)
    assert driver.find("probe") == pytest.approx(usual.find("probe"))
    driver.world.lose_probe(driver.t)
    usual.world.lose_probe(usual.t)
    assert not driver.world.level("probe", driver.t, driver.pose)
    assert usual.world.level("probe", usual.t, usual.pose)


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
    # Joined: the toolhead has contact to the probe, which still is in the dock
    assert senses() == (False, True, True)
    driver.go(**WAYS["approach"])
    assert senses() == (False, True, False)
    driver.go(*IN_DOCK)
    assert senses() == (False, True, True)
    driver.go(**WAYS["release"])
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
    assert world.truth.events == [(1.25, "attach", "probe")]
    # Asked for a moment before the change, with latency say
    assert world.level("probe", 1.249, FAR)
    world.set_output("probe_attach", 2.0, 0.0)
    assert world.level("probe_sense", 2.249, FAR)
    assert world.level("dock_sense", 2.25, FAR)
    world.observe(3.0, FAR)
    assert world.truth.events[1:] == [(2.25, "dock", "probe")]


@pytest.mark.parametrize(
    ("outputs", "events"),
    [
        # The same again is no attempt
        ([(1.0, 0.0), (1.1, 1.0), (1.2, 0.8)], [(1.35, "attach")]),
        # Taken back in time it changes nothing
        ([(1.0, 1.0), (1.1, 0.0)], []),
    ],
)
def test_output_that_changes_before_it_is_done(outputs, events):
    world = make(OUTPUT)
    for t, value in outputs:
        world.set_output("probe_attach", t, value)
    world.observe(2.0, FAR)
    found = [(pytest.approx(t), kind) for t, kind, _ in world.truth.events]
    assert found == events
    assert world.probe_state(2.0) == ("attached" if events else "docked")
