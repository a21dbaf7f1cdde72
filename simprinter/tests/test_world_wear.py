"""What makes real heights vary: ooze, heat, the seat of a probe, play."""

from __future__ import annotations

import math
import statistics
from dataclasses import replace

import pytest

from simprinter.tests.world_machines import (
    BODY_OVER_PIN,
    HIGH,
    MAG,
    MIDDLE,
    OUTPUT,
    OVER_PIN,
    Driver,
    make,
)
from simprinter.world import (
    DriftSpec,
    HotendSpec,
    NoiseSpec,
    OozeSpec,
    WorldSpec,
)

PIN_Z = MAG.pin.z


def excess(driver: Driver, count: int) -> list[float]:
    """How much higher (mm) than the bare tip's each touch of the pin is."""
    driver.go(*OVER_PIN)
    return [driver.touch("z_endstop") - PIN_Z for _ in range(count)]


# Ooze


def test_ooze_is_pressed_flat_touch_by_touch():
    driver = Driver(make(replace(MAG, ooze=OozeSpec(0.08, kept=0.5))))
    assert excess(driver, 4) == pytest.approx([0.08, 0.04, 0.02, 0.01])


def test_ooze_comes_out_again_up_to_its_height():
    ooze = OozeSpec(0.08, kept=0.0, rate=0.001)
    driver = Driver(make(replace(MAG, ooze=ooze)))
    assert excess(driver, 1) == pytest.approx([0.08])
    driver.go(z=HIGH)
    driver.stay(40.0)
    driver.go(z=HIGH)
    assert 0.03 < excess(driver, 1)[0] < 0.08
    driver.go(z=HIGH)
    driver.stay(400.0)
    assert excess(driver, 1) == pytest.approx([0.08])


def test_brush_takes_the_ooze_away():
    x, y = MIDDLE
    ooze = OozeSpec(0.08, kept=1.0, x=x + 20.0, y=y, radius=3.0)
    driver = Driver(make(replace(MAG, ooze=ooze)))
    assert excess(driver, 2) == pytest.approx([0.08, 0.08])
    driver.go(z=HIGH)
    driver.go(x + 24.0, y)
    assert excess(driver, 1) == pytest.approx([0.08])
    driver.go(z=HIGH)
    driver.go(x + 21.0, y)
    assert excess(driver, 1) == pytest.approx([0.0], abs=1e-9)


def test_ooze_is_no_matter_of_probe_and_bed():
    plain, oozing = (
        Driver(make(spec))
        for spec in (MAG, replace(MAG, ooze=OozeSpec(0.08, kept=1.0)))
    )
    for driver in (plain, oozing):
        driver.go(*BODY_OVER_PIN)
    assert oozing.touch("z_endstop") == plain.touch("z_endstop")


@pytest.mark.parametrize(
    "wrong", [{"height": 0.0}, {"kept": 1.1}, {"rate": -1}]
)
def test_ooze_that_cannot_be(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        OozeSpec(**{"height": 0.1, **wrong})


# Heat


def test_growth_levels_off():
    steady = DriftSpec(nozzle=0.001)
    slowing = replace(steady, tau=20.0)
    gaps = []
    for drift in (steady, slowing):
        world = make(replace(MAG, drift=drift))
        at = [world.truth.true_gap(*MIDDLE, 5.0, t) for t in (0.0, 20.0, 1e4)]
        gaps.append([at[0] - gap for gap in at[1:]])
    assert gaps[0] == pytest.approx([0.02, 10.0])
    assert gaps[1] == pytest.approx([0.02 * (1 - math.exp(-1)), 0.02])
    with pytest.raises(ValueError, match="tau"):
        DriftSpec(tau=0.0)


def test_nozzle_follows_its_heater():
    spec = HotendSpec(growth=0.05, lag=20.0)
    world = make(replace(MAG, hotend=spec))
    cold = world.truth.true_gap(*MIDDLE, 5.0, 0.0)
    for t, celsius in ((0.0, 25.0), (20.0, 225.0), (40.0, 225.0)):
        world.heat_hotend(t, celsius)
    gap = world.truth.true_gap(*MIDDLE, 5.0, 40.0)
    assert cold - gap == pytest.approx(0.1 * (1 - math.exp(-2)))
    world.heat_hotend(1e4, 225.0)
    gap = world.truth.true_gap(*MIDDLE, 5.0, 1e4)
    assert cold - gap == pytest.approx(0.1)
    # Without one no heater matters
    plain = make(MAG)
    plain.heat_hotend(0.0, 25.0)
    plain.heat_hotend(9.0, 225.0)
    assert plain.truth.true_gap(*MIDDLE, 5.0, 9.0) == pytest.approx(cold)


# The seat of the probe


def body_heights(spec: WorldSpec, attach_each_time: bool) -> list[float]:
    driver = Driver(make(spec), speed=400.0)
    found = []
    for number in range(40):
        if attach_each_time or number == 0:
            driver.go(z=HIGH)
            driver.world.set_output("probe_attach", driver.t, 0.0)
            driver.stay(1.0)
            driver.world.set_output("probe_attach", driver.t, 1.0)
            driver.stay(1.0)
        driver.go(*BODY_OVER_PIN)
        found.append(driver.touch("z_endstop"))
    return found


def test_probe_hangs_elsewhere_each_time_it_is_attached():
    probe = replace(OUTPUT.mag_probe, reseat=0.04)
    spec = replace(OUTPUT, mag_probe=probe)
    again = body_heights(spec, True)
    assert statistics.stdev(again) == pytest.approx(0.04, rel=0.35)
    assert max(map(abs, again)) < PIN_Z + probe.body_drop + 0.121
    once = body_heights(spec, False)
    assert once == pytest.approx([once[0]] * 40)
    assert body_heights(OUTPUT, True) == pytest.approx(
        [PIN_Z + probe.body_drop] * 40
    )


# Play


def test_play_shows_at_every_touch_whatever_it_is():
    driver = Driver(make(replace(MAG, z_play=0.05)), speed=400.0)
    for place, height in (
        (OVER_PIN, PIN_Z),
        (BODY_OVER_PIN, PIN_Z + MAG.mag_probe.body_drop),
    ):
        driver.go(z=HIGH)
        driver.go(*place)
        found = [driver.touch("z_endstop") - height for _ in range(200)]
        assert min(found) >= -1e-9 and max(found) <= 0.05
        assert statistics.stdev(found) == pytest.approx(0.05 / 12**0.5, rel=0.2)


def test_play_leaves_the_noise_as_it_is():
    pin = replace(MAG.pin, noise=NoiseSpec(sigma=0.003))
    plain = excess(Driver(make(replace(MAG, pin=pin))), 20)
    shaky = excess(Driver(make(replace(MAG, pin=pin, z_play=0.05))), 20)
    assert all(0.0 <= b - a <= 0.05 for a, b in zip(plain, shaky))
