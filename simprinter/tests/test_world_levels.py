"""Where each signal triggers: exact heights, just inside and outside."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
    BedSensorSpec,
    DriftSpec,
    MembraneSpec,
    NoiseSpec,
    Pose,
    WorldSpec,
)

EDGE = 1e-6
SURFACE = Bed(BED).height
TWISTED = replace(PIEZO, inductive=replace(PIEZO.inductive, twist=0.001))
BENT = replace(
    PIEZO, inductive=replace(PIEZO.inductive, bend=1e-5, twist_y=-0.002)
)


def bed_below_probe(x: float, y: float) -> float:
    return SURFACE(x + 5.0, y + 25.0)


CASES = [
    (MAG, "z_endstop", OVER_PIN, 3.0),
    (MAG, "z_endstop", BODY_OVER_PIN, 3.0 + 4.9),
    (MAG, "probe", MIDDLE, bed_below_probe(*MIDDLE) + 5.4),
    (PIEZO, "bed_sensor", MIDDLE, SURFACE(*MIDDLE) - 0.04),
    (PIEZO, "probe", MIDDLE, SURFACE(167.6, 150.0) + 2.5),
    (TWISTED, "probe", MIDDLE, SURFACE(167.6, 150.0) + 2.5 + 0.15),
    (BENT, "probe", MIDDLE, SURFACE(167.6, 150.0) + 2.5 + 0.225 - 0.3),
    (PIEZO, "z_endstop", MIDDLE, 0.0),
    (MEMBRANE, "membrane", (30.0, 20.0), SURFACE(30.0, 20.0) + 0.2),
]


@pytest.mark.parametrize(("spec", "signal", "place", "height"), CASES)
def test_triggers_exactly_at_its_height(spec, signal, place, height):
    world = make(spec)
    if "bed_sensor_enable" in world.outputs:
        world.set_output("bed_sensor_enable", 0.0, 1.0)
    assert world.level(signal, 1.0, Pose(*place, height - EDGE)) is True
    assert world.level(signal, 1.0, Pose(*place, height + EDGE)) is False


@pytest.mark.parametrize("spec", [MAG, PIEZO, MEMBRANE])
@given(
    place=st.tuples(st.floats(-20, 320), st.floats(-20, 330)),
    one=st.floats(-3, 15),
    other=st.floats(-3, 15),
)
def test_lower_never_releases(spec, place, one, other):
    world = make(spec)
    low, high = Pose(*place, min(one, other)), Pose(*place, max(one, other))
    for signal in world.signals:
        if world.level(signal, 1.0, high):
            assert world.level(signal, 1.0, low)


SHEET = WorldSpec(
    bed=BED, membrane=MembraneSpec(30, 20, 0.3, half_x=3, half_y=2)
)


@pytest.mark.parametrize(
    ("spec", "signal", "place", "there"),
    [
        (MAG, "z_endstop", (202.0, 310.0), True),
        (MAG, "z_endstop", (202.001, 310.0), False),
        (MAG, "z_endstop", (200.0, 307.999), False),
        (MAG, "z_endstop", (201.399, 278.601), True),
        (MAG, "z_endstop", (201.401, 285.0), False),
        (MAG, "probe", (295.0, 275.0), True),
        (MAG, "probe", (295.001, 275.0), False),
        (MAG, "probe", (200.0, 275.001), False),
        (PIEZO, "x_endstop", (300.0, 0), True),
        (PIEZO, "x_endstop", (299.999, 0), False),
        (PIEZO, "y_endstop", (0, -5.0), True),
        (PIEZO, "y_endstop", (0, -4.999), False),
        (SHEET, "membrane", (33, 22), True),
        (SHEET, "membrane", (33.001, 20), False),
        (SHEET, "membrane", (30, 22.001), False),
        (MEMBRANE, "membrane", (38.0, 20.0), True),
        (MEMBRANE, "membrane", (38.001, 20.0), False),
    ],
)
def test_nothing_to_press_beside_it(spec, signal, place, there):
    # Deep enough for everything, so that only the place matters
    assert make(spec).level(signal, 1.0, Pose(*place, -1.0)) is there


def test_tip_or_body_presses_the_pin_whichever_is_lower():
    beside = replace(MAG.mag_probe, x_offset=3.0, y_offset=0.0)
    taken_off = replace(beside, mode="output", initial="docked")
    # Both are over the pin; the body hangs lower
    for probe, height in ((beside, 7.9), (taken_off, 3.0)):
        world = make(replace(MAG, mag_probe=probe))
        assert world.level("z_endstop", 1.0, Pose(200, 310, height - EDGE))
        assert not world.level("z_endstop", 1.0, Pose(200, 310, height + EDGE))


def test_bed_sensor_needs_its_output():
    world = make(PIEZO)
    pressing = Pose(*MIDDLE, SURFACE(*MIDDLE) - 0.1)
    assert not world.level("bed_sensor", 1.0, pressing)
    world.set_output("bed_sensor_enable", 2.0, 1.0)
    assert not world.level("bed_sensor", 1.999, pressing)
    assert world.level("bed_sensor", 2.0, pressing)
    world.set_output("bed_sensor_enable", 3.0, 0.0)
    assert world.level("bed_sensor", 2.999, pressing)
    assert not world.level("bed_sensor", 3.0, pressing)
    always = make(WorldSpec(bed=BED, bed_sensor=BedSensorSpec()))
    assert always.level("bed_sensor", 1.0, pressing)
    assert always.outputs == ()


def test_missing_probe_reads_triggered():
    world = make(OUTPUT)
    assert world.level("probe", 0.0, Pose(*MIDDLE, HIGH))
    assert not world.level("probe_sense", 0.0, Pose(*MIDDLE, HIGH))
    assert world.level("dock_sense", 0.0, Pose(*MIDDLE, HIGH))


def test_hysteresis_holds_a_committed_touch():
    noise = NoiseSpec(hysteresis=0.05)
    world = make(replace(MAG, pin=replace(MAG.pin, noise=noise)))
    driver = Driver(world)
    driver.go(*OVER_PIN)
    slack = Pose(*OVER_PIN, 3.04)
    assert not world.level("z_endstop", driver.t, slack)
    driver.go(z=3.0)
    assert world.level("z_endstop", driver.t, slack)
    assert not world.level("z_endstop", driver.t, Pose(*OVER_PIN, 3.0501))
    driver.go(z=3.06)
    assert not world.level("z_endstop", driver.t, slack)


@pytest.mark.parametrize(
    ("drift", "pin", "body", "bed", "gap"),
    [
        # mm by which each height moves in 10 s; gap: true_gap's change
        (DriftSpec(nozzle=0.01), 0.1, 0.0, 0.0, -0.1),
        (DriftSpec(pin=0.01), 0.1, 0.1, 0.0, 0.0),
        (DriftSpec(bed=-0.01), 0.0, 0.0, -0.1, 0.1),
        (DriftSpec(body=0.01), 0.0, 0.1, 0.1, 0.0),
        (DriftSpec(pin=0.01, start=5.0), 0.05, 0.05, 0.0, 0.0),
        (DriftSpec(pin=0.01, stop=2.0), 0.02, 0.02, 0.0, 0.0),
    ],
)
def test_thermal_growth(drift, pin, body, bed, gap):
    driver = Driver(make(replace(MAG, drift=drift)))
    cold = driver.world.truth.true_gap(*MIDDLE, 1.0)
    hot = driver.world.truth.true_gap(*MIDDLE, 1.0, t=10.0)
    assert hot - cold == pytest.approx(gap)
    driver.t = 10.0
    driver.go(*OVER_PIN)
    driver.t = 10.0
    assert driver.find("z_endstop") == pytest.approx(3.0 + pin)
    driver.pose = Pose(*BODY_OVER_PIN, HIGH)
    assert driver.find("z_endstop") == pytest.approx(7.9 + body)
    driver.pose = Pose(*MIDDLE, HIGH)
    plate = bed_below_probe(*MIDDLE) + 5.4
    assert driver.find("probe") == pytest.approx(plate + bed)


def test_level_changes_nothing_and_observe_goes_forwards():
    world = make(MAG)
    for z in (0.0, 3.0, 60.0):
        for signal in world.signals:
            world.level(signal, 5.0, Pose(*OVER_PIN, z))
    assert world.truth.touches == []
    # Still takes an earlier time: level() did not commit the later one
    world.observe(2.0, Pose(*MIDDLE, HIGH))
    with pytest.raises(ValueError, match="before"):
        world.observe(1.9, Pose(*MIDDLE, HIGH))


def test_membrane_that_is_laid_and_taken_away():
    sheet = MembraneSpec(30, 20, 0.3, radius=5, laid=False)
    world = make(WorldSpec(bed=BED, membrane=sheet))
    tip = Pose(30.0, 20.0, SURFACE(30.0, 20.0) + 0.2)
    seen = []
    for is_laid in (None, True, False, True):
        if is_laid is not None:
            world.lay_membrane(is_laid)
        seen.append(world.level("membrane", 1.0, tip))
    assert seen == [False, True, False, True]
