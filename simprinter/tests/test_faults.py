"""Faults: counting, validation, and each one in the world."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from simprinter.faults import Fault, Faults
from simprinter.tests.world_machines import (
    BODY_OVER_PIN,
    DOCK,
    HIGH,
    MAG,
    MIDDLE,
    OUTPUT,
    OVER_PIN,
    PIEZO,
    Driver,
    make,
)
from simprinter.world import Bed, Pose, World

FAR = Pose(*MIDDLE, HIGH)
BED_AT_MIDDLE = Bed(PIEZO.bed).height(*MIDDLE)


@pytest.mark.parametrize(
    ("n", "persistent", "struck"),
    [
        (1, False, [True, False, False, False]),
        (3, False, [False, False, True, False]),
        (1, True, [True, True, True, True]),
        (3, True, [False, False, True, True]),
    ],
)
def test_nth_operation_once_or_from_then_on(n, persistent, struck):
    fault = Fault("attach_fails", n=n, persistent=persistent)
    # It may serve two runs
    for faults in (Faults([fault]), Faults([fault])):
        assert faults.unfired() == [fault]
        found = [faults.fires("attach_fails") for _ in range(4)]
        assert found == [fault if strikes else None for strikes in struck]
        assert faults.unfired() == []


def test_only_the_subject_meant_is_counted_from_its_adding_on():
    one = Fault("tmc_read_error", n=3, driver="z")
    every = Fault("tmc_write_error", n=2)
    added = Fault("tmc_read_error", n=1, driver="z")
    faults = Faults([one, every])
    assert not faults.fires("tmc_read_error", "z")
    assert not faults.fires("tmc_read_error", "x")
    assert not faults.fires("tmc_write_error", "x")
    assert faults.fires("tmc_write_error", "z") == every
    faults.add(added)
    assert list(faults) == [one, every, added]
    assert faults.fires("tmc_read_error", "z") == added
    assert faults.fires("tmc_read_error", "z") == one


def test_faults_by_time_of_one_board_or_all():
    faults = Faults([Fault("mcu_silent", t=2.5, board="zboard")])
    assert faults.begins("mcu_silent", "zboard") == 2.5
    assert not faults.due("mcu_silent", 2.499, "zboard")
    assert not faults.due("mcu_silent", 3.0, "mcu")
    assert len(faults.unfired()) == 1
    assert faults.due("mcu_silent", 2.5, "zboard")
    assert faults.unfired() == []
    assert Faults([Fault("mcu_silent", t=2.5)]).due("mcu_silent", 3.0, "mcu")
    assert Faults().begins("mcu_silent") == math.inf
    with pytest.raises(ValueError, match="due"):
        faults.fires("mcu_silent")
    for ask in (faults.fires, faults.begins):
        with pytest.raises(ValueError, match="unknown fault"):
            ask("nothing")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ({"name": "stuk_open"}, "know .*stuck_open"),
        ({"name": "stuck_open"}, r"missing \['signal'\]"),
        ({"name": "stuck_open", "signal": "probe", "mm": 1}, "know .*'t'"),
        ({"name": "stuck_open", "signal": "p", "t": 1, "n": 2}, "clash"),
        ({"name": "trigger_early", "signal": "probe"}, r"missing \['mm'\]"),
        ({"name": "trigger_early", "signal": "p", "mm": 0}, "above zero"),
        ({"name": "probe_falls", "site": "nozzle_bed"}, "body_pin"),
        ({"name": "probe_falls", "when": "later"}, "touch or lift"),
        ({"name": "attach_fails", "n": 0}, "integer"),
        ({"name": "mcu_silent", "t": -1}, "zero or more"),
        ({"name": "tmc_read_error", "signal": "z"}, "know .*driver"),
    ],
)
def test_wrong_faults_are_refused(args, message):
    with pytest.raises(ValueError, match=message):
        Fault(**args)


def test_fault_of_a_signal_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="no such signal"):
        make(MAG, Fault("trigger_never", signal="bed_sensor"))


def over_pin(*faults: Fault) -> Driver:
    driver = Driver(make(MAG, *faults))
    driver.go(*OVER_PIN)
    return driver


def arm(driver: Driver) -> None:
    driver.world.touch_armed("z_endstop", driver.t)


DEEP = Pose(*OVER_PIN, 2.0)
ABOVE = Pose(*OVER_PIN, 30.0)


@pytest.mark.parametrize("name", ["stuck_open", "stuck_closed"])
@pytest.mark.parametrize("persistent", [True, False])
def test_stuck_from_the_nth_arming_for_ever_or_once(name, persistent):
    fault = Fault(name, n=2, persistent=persistent, signal="z_endstop")
    driver = over_pin(fault)
    world, stuck = driver.world, name == "stuck_closed"
    for armed in range(4):
        is_stuck = armed == 2 or (persistent and armed > 2)
        expected = (stuck, stuck) if is_stuck else (True, False)
        seen = [world.level("z_endstop", driver.t, p) for p in (DEEP, ABOVE)]
        assert tuple(seen) == expected
        arm(driver)
    assert not world.level("probe", driver.t, ABOVE)


def test_stuck_by_time():
    faults = Faults([Fault("stuck_closed", signal="probe", t=3.0)])
    world = World(MAG, 1, faults)
    world.touch_armed("probe", 2.0)
    assert not world.level("probe", 2.999, FAR)
    assert world.level("probe", 3.0, FAR)
    world.observe(2.9, FAR)
    assert len(faults.unfired()) == 1
    world.observe(3.1, FAR)
    assert faults.unfired() == []
    # Gone with the fault
    faults.clear()
    world.mend()
    assert not world.level("probe", 4.0, FAR)


@pytest.mark.parametrize(
    ("name", "mm", "persistent", "heights", "depth"),
    [
        # Nothing is there to be touched where it triggers early
        ("trigger_early", 9.5, False, [3.0, 12.5, 3.0], 0.0),
        # It is reported late: the pin is pressed as far as that takes
        ("trigger_late", 0.7, False, [3.0, 2.3, 3.0], 0.7),
        ("trigger_late", 0.7, True, [3.0, 2.3, 2.3], 0.7),
    ],
)
def test_trigger_elsewhere(name, mm, persistent, heights, depth):
    options = {"n": 2, "persistent": persistent, "mm": mm}
    driver = over_pin(Fault(name, signal="z_endstop", **options))
    found = [driver.touch("z_endstop", lift=12) for _ in range(3)]
    assert found == pytest.approx(heights)
    truth = driver.world.truth
    assert truth.touch_count("nozzle_pin") == (3 if depth else 2)
    assert truth.depth("nozzle_pin") == pytest.approx(depth)
    kinds = [(crash.site, crash.kind) for crash in truth.crashes()]
    assert kinds == ([("nozzle_pin", "depth")] if depth else [])
    driver.world.touch_armed("z_endstop", driver.t)
    driver.world.mend()
    assert driver.find("z_endstop") == pytest.approx(3.0)


def test_faults_of_a_switched_bed_sensor():
    """Only a stuck one says anything while it is off."""

    def level(z, on, *faults):
        world = make(PIEZO, *faults)
        world.set_output("bed_sensor_enable", 0.0, float(on))
        world.touch_armed("bed_sensor", 1.0)
        return world.level("bed_sensor", 2.0, Pose(*MIDDLE, z))

    surface = -0.04 + BED_AT_MIDDLE
    low, high = surface - 0.02, surface + 0.02
    assert level(low, True)
    assert not level(low, False)
    assert not level(high, True)
    for on in (False, True):
        fault = {"signal": "bed_sensor"}
        assert level(high, on, Fault("stuck_closed", **fault))
        assert not level(low, on, Fault("stuck_open", **fault))
        assert not level(low, on, Fault("trigger_never", **fault))
        early = Fault("trigger_early", mm=0.03, **fault)
        late = Fault("trigger_late", mm=0.03, **fault)
        assert level(high, on, early) == on
        assert not level(low, on, late)
        assert level(low - 0.02, on, late) == on


def test_trigger_never_hides_the_contact_but_not_from_the_truth():
    driver = over_pin(Fault("trigger_never", n=2, signal="z_endstop"))
    arm(driver)
    assert driver.world.level("z_endstop", driver.t, DEEP)
    arm(driver)
    assert not driver.world.level("z_endstop", driver.t, DEEP)
    driver.go(z=2.5)
    (crash,) = driver.world.truth.crashes()
    assert crash.site == "nozzle_pin"
    driver.go(z=HIGH)
    arm(driver)
    assert driver.world.level("z_endstop", driver.t, DEEP)


@pytest.mark.parametrize(
    ("when", "after_touch"), [("touch", "lost"), ("lift", "attached")]
)
@pytest.mark.parametrize("n", [1, 2])
def test_probe_falls_at_the_nth_touch_of_the_pin(n, when, after_touch):
    fault = Fault("probe_falls", n=n, site="body_pin", when=when)
    driver = Driver(make(MAG, fault))
    driver.touch("probe")
    driver.go(z=HIGH)
    driver.go(*BODY_OVER_PIN)
    for _ in range(n - 1):
        driver.touch("z_endstop")
        assert driver.world.probe_state(driver.t) == "attached"
    driver.go(z=7.9)
    assert driver.world.probe_state(driver.t) == after_touch
    driver.go(z=HIGH)
    assert driver.world.probe_state(driver.t) == "lost"
    assert driver.world.level("probe", driver.t, FAR)
    kinds = [event.kind for event in driver.world.truth.events]
    assert kinds == ["lost"]


def test_without_its_probe_the_head_goes_past_the_pin():
    """The accident of the predecessors: next sample meets no body."""
    # At any site: the second touch of all
    driver = Driver(make(MAG, Fault("probe_falls", n=2)))
    driver.touch("probe")
    driver.go(z=HIGH)
    driver.go(*BODY_OVER_PIN)
    driver.touch("z_endstop")
    assert driver.find("z_endstop") == pytest.approx(-5.0)
    driver.go(z=7.9 - 4.9 - 2.0)
    driver.go(z=-4.0)
    sites = [crash.site for crash in driver.world.truth.crashes()]
    assert sites == ["nozzle_bed"]


def test_output_fails_to_attach_and_to_dock():
    world = make(OUTPUT, Fault("attach_fails"), Fault("dock_fails"))
    states = []
    for t, value in enumerate((1, 0, 1, 0, 1, 0), start=1):
        world.set_output("probe_attach", float(t), float(value))
        world.observe(t + 0.5, FAR)
        states.append(world.probe_state(t + 0.5))
    # The first attempts of both fail
    assert states == ["docked"] * 2 + ["attached"] * 3 + ["docked"]
    kinds = [event.kind for event in world.truth.events]
    assert kinds == ["attach_failed", "attach", "dock_failed", "dock"]


@pytest.mark.parametrize(
    ("name", "initial", "way", "after"),
    [
        ("attach_fails", "docked", (20, 280), "attached"),
        ("dock_fails", "attached", (40, 300), "docked"),
    ],
)
def test_move_fails_to_change_the_probe(name, initial, way, after):
    probe = replace(DOCK.mag_probe, initial=initial)
    driver = Driver(make(replace(DOCK, mag_probe=probe), Fault(name)))
    driver.go(20, 280, 20)
    for state in (initial, after):
        driver.go(20, 300)
        driver.go(*way)
        assert driver.world.probe_state(driver.t) == state
