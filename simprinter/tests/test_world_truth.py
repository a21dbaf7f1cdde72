"""What the world writes down: touches, depths, drags, crashes."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from simprinter.tests.world_machines import (
    BED,
    BODY_OVER_PIN,
    HIGH,
    MAG,
    MEMBRANE,
    MIDDLE,
    OUTPUT,
    OVER_PIN,
    PIEZO,
    Driver,
    make,
)
from simprinter.world import (
    Bed,
    CrashError,
    DriftSpec,
    Pose,
    World,
    WorldSpec,
)

SURFACE = Bed(BED).height
MIDDLE_BED = SURFACE(*MIDDLE)
PROBE_BED = SURFACE(MIDDLE[0] + 5.0, MIDDLE[1] + 25.0)
SHEET = (30.0, 20.0)
# site, machine, place, trigger height, mm beyond it that are still legal
SITES = [
    ("nozzle_pin", OUTPUT, OVER_PIN, 3.0, 0.05),
    ("body_pin", MAG, BODY_OVER_PIN, 7.9, 0.05),
    ("body_bed", MAG, MIDDLE, PROBE_BED + 4.9, 0.0),
    ("nozzle_bed", OUTPUT, MIDDLE, MIDDLE_BED, 0.0),
    ("nozzle_bed", PIEZO, MIDDLE, MIDDLE_BED - 0.04, 0.05),
    ("nozzle_membrane", MEMBRANE, SHEET, SURFACE(*SHEET) + 0.2, 0.05),
]


# One sum of the same numbers may end a bit higher than another
HAIR = 1e-9


def drive_down(spec: WorldSpec, place: tuple[float, float], z: float) -> Driver:
    if spec is MEMBRANE:
        probe = replace(spec.mag_probe, mode="output", initial="docked")
        spec = replace(spec, mag_probe=probe)
    driver = Driver(make(spec))
    driver.go(*place)
    driver.go(z=z)
    return driver


@pytest.mark.parametrize(("site", "spec", "place", "height", "legal"), SITES)
def test_deeper_than_the_allowance_is_a_crash(site, spec, place, height, legal):
    driver = drive_down(spec, place, height - legal - HAIR)
    truth = driver.world.truth
    truth.require_no_crash()
    assert truth.touch_count(site) == 1
    assert truth.depth(site) == pytest.approx(legal, abs=1e-8)
    driver.go(z=HIGH)
    driver.go(z=height - legal - 0.03)
    deepest = driver.t
    driver.go(z=HIGH)
    assert truth.touch_count(site) == 2
    (crash,) = [crash for crash in truth.crashes() if crash.site == site]
    assert crash.kind == "depth"
    assert crash.depth == pytest.approx(legal + 0.03)
    assert crash.allowed == pytest.approx(legal)
    assert crash.t == deepest
    assert crash.pose == pytest.approx((*place, height - legal - 0.03))
    with pytest.raises(CrashError, match=rf"{site}: .* mm deep"):
        truth.require_no_crash()
    # Others may have been pressed meanwhile
    worst = {crash.site: crash.depth for crash in truth.crashes()}
    truth.require_no_crash({s: depth + HAIR for s, depth in worst.items()})
    with pytest.raises(CrashError, match=site):
        truth.require_no_crash({**worst, site: legal + 0.029})


def test_plunger_may_go_down_to_the_body_only():
    driver = Driver(make(MAG))
    driver.go(z=PROBE_BED + 5.4 + 0.001)
    assert driver.world.truth.touch_count() == 0
    driver.go(z=PROBE_BED + 4.9 + 0.001)
    driver.world.truth.require_no_crash()
    assert driver.world.truth.depth("probe_bed") == pytest.approx(0.499)


def test_pin_past_its_hard_stop_says_so():
    driver = drive_down(OUTPUT, OVER_PIN, 3.0 - 1.2)
    (crash,) = driver.world.truth.crashes()
    assert crash.past_stop == pytest.approx(0.2)
    assert "0.2000 mm past its hard stop" in str(crash)


def test_min_gap_and_deepest_in_bed():
    driver = drive_down(OUTPUT, MIDDLE, MIDDLE_BED + 1.5)
    truth = driver.world.truth
    assert truth.min_gap == pytest.approx(1.5)
    assert truth.deepest_in_bed() == 0.0
    driver.go(z=MIDDLE_BED - 0.25)
    driver.go(z=HIGH)
    assert truth.min_gap == pytest.approx(-0.25)
    assert truth.deepest_in_bed() == pytest.approx(0.25)
    # Unknown beside the plate, and it stays where the plate falls away
    world = World(MAG, 1)
    world.observe(0.0, Pose(-10, 0, 0))
    assert world.truth.min_gap == math.inf
    driver = drive_down(OUTPUT, (250.0, 250.0), 2.0)
    truth = driver.world.truth
    nearest = truth.min_gap
    driver.go(x=40.0)
    assert truth.true_gap(*driver.pose) > nearest + 0.1
    assert truth.min_gap == nearest


DRAGS = [
    ("nozzle_pin", OUTPUT, OVER_PIN, 2.96),
    ("body_pin", MAG, BODY_OVER_PIN, 7.86),
    ("nozzle_bed", PIEZO, MIDDLE, MIDDLE_BED - 0.02),
    ("probe_bed", MAG, MIDDLE, PROBE_BED + 5.5),
    ("nozzle_membrane", MEMBRANE, SHEET, SURFACE(*SHEET) + 0.28),
]


@pytest.mark.parametrize(("site", "spec", "place", "z"), DRAGS)
def test_dragging_is_a_crash(site, spec, place, z):
    driver = drive_down(spec, place, z)
    driver.go(x=place[0] + 0.04)
    truth = driver.world.truth
    truth.require_no_crash()
    driver.go(x=place[0] + 0.1)
    (crash,) = truth.crashes()
    assert (crash.site, crash.kind) == (site, "drag")
    assert crash.depth == pytest.approx(0.1)
    assert "dragged" in str(crash)
    assert truth.drag(site) == pytest.approx(0.1)


def test_axis_beyond_its_hard_stop():
    driver = Driver(make(PIEZO))
    driver.go(y=-5.9)
    driver.world.truth.require_no_crash()
    driver.go(y=-6.2)
    (crash,) = driver.world.truth.crashes()
    assert crash.site == "y_endstop"
    assert crash.depth == pytest.approx(1.2)
    (touch,) = driver.world.truth.touches
    assert touch.trigger_z == pytest.approx(-5.0)


def test_running_sideways_into_the_pin_is_a_crash_arriving_is_none():
    driver = Driver(make(OUTPUT))
    driver.go(190.0, 310.0)
    driver.go(z=1.0)
    truth = driver.world.truth
    truth.require_no_crash()
    driver.go(x=205.0)
    sites = {(c.site, c.kind) for c in truth.crashes()}
    assert sites == {("nozzle_pin", "depth"), ("nozzle_pin", "drag")}
    driver = drive_down(OUTPUT, OVER_PIN, 5.0)
    driver.world.observe(driver.t + 0.1, Pose(201.0, 310.0, 2.97))
    driver.world.truth.require_no_crash()
    assert driver.world.truth.touch_count("nozzle_pin") == 1
    assert driver.world.truth.drag("nozzle_pin") == 0.0


def test_worst_of_several_crashes_is_kept_in_order_of_time():
    driver = drive_down(OUTPUT, OVER_PIN, 2.8)
    driver.go(z=HIGH)
    driver.go(z=2.7)
    driver.go(z=HIGH)
    driver.go(*MIDDLE)
    driver.go(z=MIDDLE_BED - 0.1)
    first, second = driver.world.truth.crashes()
    assert (first.site, second.site) == ("nozzle_pin", "nozzle_bed")
    assert first.depth == pytest.approx(0.3)


def test_what_is_forgotten_is_told_again_only_if_it_happens_again():
    driver = drive_down(OUTPUT, MIDDLE, MIDDLE_BED - 0.5)
    driver.go(z=HIGH)
    truth = driver.world.truth
    assert truth.lowest == MIDDLE_BED - 0.5
    truth.forget()
    assert not truth.crashes()
    driver.go(z=MIDDLE_BED + 0.1)
    assert not truth.crashes()
    assert truth.lowest == MIDDLE_BED + 0.1
    driver.go(z=MIDDLE_BED - 0.2)
    assert [crash.site for crash in truth.crashes()] == ["nozzle_bed"]


def test_hot_nozzle_reaches_deeper_but_not_before_its_time():
    drift = DriftSpec(nozzle=0.1, start=1.0, stop=2.0)
    world = make(replace(OUTPUT, drift=drift))
    world.observe(3.0, Pose(*MIDDLE, MIDDLE_BED + 0.05))
    assert world.truth.deepest_in_bed() == pytest.approx(0.05)
    assert world.truth.crashes()[0].depth == pytest.approx(0.05)
    gaps = [world.truth.true_gap(*MIDDLE, 1.0, t=t) for t in (0.0, 1.0, 1.5)]
    assert gaps[0] == gaps[1] == pytest.approx(gaps[2] + 0.05)
