"""Faults: counting, validation, and each one in the world."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

import simprinter
from simprinter import Machine
from simprinter.faults import Fault, FaultError, Faults
from simprinter.plugin_printer import read_scene
from simprinter.running import SAMPLE
from simprinter.tests.world_machines import (
    BODY_OVER_PIN,
    DOCK,
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
from simprinter.world import Bed, CarriageSpec, Pose, World

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
    # It may serve two printers
    for faults in (Faults([fault]), Faults([fault])):
        assert faults.unfired() == [fault]
        found = [faults.fires("attach_fails") for _ in range(4)]
        assert found == [fault if strikes else None for strikes in struck]
        assert faults.unfired() == []


def test_only_the_subject_meant_is_counted_from_its_adding_on():
    one = Fault("tmc_read_error", driver="z", n=3)
    every = Fault("tmc_write_error", n=2)
    added = Fault("tmc_read_error", driver="z", n=1)
    faults = Faults([one, every])
    assert not faults.fires("tmc_read_error", "z")
    assert not faults.fires("tmc_read_error", "x")
    assert not faults.fires("tmc_write_error", "x")
    assert faults.fires("tmc_write_error", "z") == every
    faults.add(added)
    assert list(faults) == [one, every, added]
    assert faults.fires("tmc_read_error", "z") == added
    assert faults.fires("tmc_read_error", "z") == one


def test_of_a_command_only_what_it_does_is_counted():
    fault = Fault("attach_fails", n=2, command="probe")
    faults = Faults([fault])

    def fires() -> bool:
        return faults.fires("attach_fails") is not None

    assert not any([fires(), fires(), fires()])
    for script in ("PROBE_ACCURACY SAMPLES=3", "G28", "; PROBE\n"):
        faults.script_begins(script)
        assert not any([fires(), fires(), fires()])
        faults.script_ends(script)
    # Each anew
    faults.script_begins("PROBE")
    assert not fires()
    faults.script_ends("PROBE")
    assert not fires()
    script = "\n probe SAMPLES=3 ; the second\nM400"
    faults.script_begins(script)
    # Another waits until it has ended
    faults.script_begins("M114")
    assert [fires(), fires(), fires()] == [False, True, False]
    faults.script_ends("M114")
    faults.script_ends(script)
    # Once
    faults.script_begins("PROBE")
    assert not any([fires(), fires(), fires()])


@pytest.mark.parametrize(
    "text",
    [
        "Fault('stuck_open', site='nozzle_pin', touch=2, command='G28')",
        "Fault('stuck_closed', signal='probe', t=0.0)",
        "Fault('trigger_early', signal='probe', mm=0.3)",
        "Fault('mcu_silent', t=2.0)",
        "Fault('dock_fails', n=1)",
    ],
)
def test_fault_reads_as_it_is_written(text):
    assert repr(eval(text)) == text


def test_readme_lists_all_faults_and_sites():
    readme = Path(simprinter.__file__).with_name("README.md").read_text()
    section = readme.split("## Faults")[1].split("\n## ")[0]
    faults, sites = re.split(r"\n\| site .*", section)
    rows = re.findall(r"(?m)^\| `(.+?)` \|", faults)
    listed = [name for row in rows for name in row.split("`, `")]
    with pytest.raises(ValueError, match="unknown fault") as error:
        Fault("none")
    assert sorted(listed) == re.findall(r"'(\w+)'", str(error.value))[1:]
    # Each site that some machine has, but for switches of axes
    probe = replace(MAG.mag_probe, plunger_on_pin=True)
    known = set()
    second = CarriageSpec(280.0)
    for spec in (replace(MEMBRANE, mag_probe=probe), PIEZO):
        spec = replace(spec, second_carriage=second)
        with pytest.raises(ValueError, match="no such site") as error:
            make(spec, Fault("stuck_open", site="none"))
        have = str(error.value).split("have")[1]
        known.update(re.findall(r"'(\w+)'", have))
    told = {*re.findall(r"`(\w+)`", sites)} - {"x_endstop", "body_bed"}
    assert told == {site for site in known if not site.endswith("endstop")}


def test_what_stays_outlives_its_command():
    fault = Fault("dock_fails", command="PROBE", persistent=True)
    faults = Faults([fault])
    assert faults.fires("dock_fails") is None
    faults.script_begins("PROBE")
    assert faults.fires("dock_fails") is fault
    faults.script_ends("PROBE")
    assert faults.fires("dock_fails") is fault


def test_command_in_the_middle_of_a_script_is_refused():
    faults = Faults([Fault("attach_fails", command="PROBE")])
    with pytest.raises(ValueError, match="begins is known of a script that"):
        faults.script_begins("G28\nPROBE")
    faults.script_begins("PROBE\nPROBE")
    faults.fires("attach_fails")
    faults.script_begins("G28\nPROBE")


def test_what_has_not_struck_is_told():
    fault = Fault("attach_fails", n=2)
    never = Fault("dock_fails", strikes="never")
    faults = Faults([fault, never, Fault("tmc_read_error", strikes="may")])
    with pytest.raises(FaultError, match="has not struck: .*attach_fails"):
        faults.require_struck()
    for _ in range(2):
        faults.fires("attach_fails")
    faults.require_struck()
    faults.fires("dock_fails")
    with pytest.raises(FaultError, match="never to strike.*dock_fails"):
        faults.require_struck()
    # That they were taken away excuses nothing
    for found in (Faults([fault]), faults):
        found.clear()
        assert found.unfired() == []
        with pytest.raises(FaultError, match="a fault"):
            found.require_struck()


def test_leaving_a_machine_tells_what_has_not_struck():
    scene = read_scene(SAMPLE / "printer.cfg", SAMPLE / "world.toml")
    fault = Fault("trigger_never", site="inductive_bed")
    told = pytest.raises(FaultError, match="has not struck: .*inductive_bed")
    with told, Machine(scene, faults=[fault]):
        pass
    # An error that is there already is told
    told = pytest.raises(RuntimeError, match="mine")
    with told, Machine(scene, faults=[fault]):
        raise RuntimeError("mine")


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
        ({"name": "stuck_open"}, "a site or a signal"),
        ({"name": "stuck_open", "signal": "p", "site": "s"}, "a site or a sig"),
        ({"name": "stuck_open", "signal": "p", "touch": 2}, "of a site, not"),
        ({"name": "stuck_open", "signal": "p", "n": 2}, "know .*'touch'"),
        ({"name": "stuck_open", "site": "p", "touch": 0}, "touch 0 is not an"),
        ({"name": "stuck_open", "site": "p", "t": 1}, "nothing is counted"),
        ({"name": "attach_fails", "strikes": "often"}, "strikes 'often' not"),
        ({"name": "stuck_open", "signal": "probe", "mm": 1}, "know .*'t'"),
        (
            {"name": "stuck_open", "signal": "p", "t": 1, "command": "G28"},
            "nothing is counted",
        ),
        (
            {"name": "stuck_open", "signal": "p", "t": 1, "persistent": False},
            "it stays",
        ),
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


@pytest.mark.parametrize(
    "about", [{"signal": "bed_sensor"}, {"site": "nozzle_membrane"}]
)
def test_fault_of_what_is_not_there_is_refused(about):
    with pytest.raises(ValueError, match=f"no such {next(iter(about))}, have"):
        make(MAG, Fault("trigger_never", **about))


def over_pin(*faults: Fault) -> Driver:
    driver = Driver(make(MAG, *faults))
    driver.go(*OVER_PIN)
    return driver


def arm(driver: Driver) -> None:
    driver.world.touch_armed("z_endstop", driver.t)


DEEP = Pose(*OVER_PIN, 2.0)
ABOVE = Pose(*OVER_PIN, 30.0)


def levels(driver: Driver) -> tuple[bool, bool]:
    """What the pin's signal says pressed, and let go."""
    level = driver.world.level
    pressed, free = (level("z_endstop", driver.t, p) for p in (DEEP, ABOVE))
    return pressed, free


@pytest.mark.parametrize("name", ["stuck_open", "stuck_closed"])
@pytest.mark.parametrize("persistent", [True, False])
def test_signal_stuck_from_its_next_arming_for_ever_or_once(name, persistent):
    driver, stuck = over_pin(), name == "stuck_closed"
    arm(driver)
    driver.world.expect_faults()
    assert levels(driver) == (True, False)
    fault = Fault(name, signal="z_endstop", persistent=persistent)
    driver = over_pin(fault)
    for armed in range(4):
        is_stuck = armed == 1 or (persistent and armed > 1)
        expected = (stuck, stuck) if is_stuck else (True, False)
        assert levels(driver) == expected
        arm(driver)
    assert not driver.world.level("probe", driver.t, ABOVE)


def end(driver: Driver) -> None:
    driver.world.touch_ended("z_endstop")


@pytest.mark.parametrize("name", ["stuck_open", "stuck_closed"])
def test_stuck_as_the_nth_touch_of_a_site_is_looked_for(name):
    """Not as something else is, and whatever looks meet nothing."""
    fault = Fault(name, site="nozzle_pin", touch=2)
    driver = over_pin(fault)
    world, stuck = driver.world, name == "stuck_closed"

    def looks(lowest: float) -> None:
        arm(driver)
        driver.go(z=lowest)
        end(driver)
        driver.go(z=HIGH)

    # Two that meet nothing, one by the body, and the first
    looks(3.1)
    looks(3.1)
    driver.go(*BODY_OVER_PIN)
    looks(7.9)
    driver.go(*OVER_PIN)
    looks(3.0)
    # While nothing looks any more, though it had met nothing
    arm(driver)
    end(driver)
    driver.go(z=3.0)
    driver.go(z=HIGH)
    # And where another site is
    driver.go(*BODY_OVER_PIN)
    arm(driver)
    assert world.level("z_endstop", driver.t, Pose(*BODY_OVER_PIN, 7.9))
    # What is said of places is so before they are reached
    assert levels(driver) == (stuck, stuck)
    driver.stay(1.0)
    end(driver)
    assert levels(driver) == (True, False)
    driver.go(*OVER_PIN)
    assert levels(driver) == (True, False)
    # It is only passed before that begins
    world.touch_armed("z_endstop", driver.t + 1.0)
    driver.go(*BODY_OVER_PIN)
    driver.stay(2.0)
    end(driver)
    driver.go(*OVER_PIN)
    assert levels(driver) == (True, False)
    # From its beginning on
    world.touch_armed("z_endstop", driver.t + 1.0)
    driver.stay(0.5)
    assert levels(driver) == (True, False)
    driver.stay(1.0)
    assert levels(driver) == (stuck, stuck)
    end(driver)
    driver.stay(1.0)
    assert levels(driver) == (stuck, stuck)
    # It stays so while another begins to look
    world.touch_armed("z_endstop", driver.t + 1.0)
    assert levels(driver) == (stuck, stuck)


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
        ("trigger_early", 9.5, True, [3.0, 12.5, 12.5], 0.0),
        # It is reported late: the pin is pressed as far as that takes
        ("trigger_late", 0.7, False, [3.0, 2.3, 3.0], 0.7),
        ("trigger_late", 0.7, True, [3.0, 2.3, 2.3], 0.7),
    ],
)
def test_trigger_elsewhere(name, mm, persistent, heights, depth):
    options = {"touch": 2, "persistent": persistent, "mm": mm}
    faults = Faults([Fault(name, site="nozzle_pin", **options)])
    driver = Driver(World(MAG, 1, faults))
    driver.go(*OVER_PIN)
    found = []
    for number in range(3):
        # A look that ends in the air is none
        arm(driver)
        driver.go(z=14.0)
        end(driver)
        assert bool(faults.unfired()) is (number < 2)
        found.append(driver.touch("z_endstop", lift=12))
        end(driver)
    assert found == pytest.approx(heights)
    assert faults.unfired() == []
    truth = driver.world.truth
    in_air = sum(height > 3.0 for height in heights)
    assert truth.touch_count("nozzle_pin") == 3 - in_air
    assert truth.depth("nozzle_pin") == pytest.approx(depth)
    kinds = [(crash.site, crash.kind) for crash in truth.crashes()]
    assert kinds == ([("nozzle_pin", "depth")] if depth else [])
    driver.world.touch_armed("z_endstop", driver.t)
    faults.clear()
    driver.world.mend()
    assert driver.find("z_endstop") == pytest.approx(3.0)


def test_fault_is_made_known_while_its_touch_is_sought():
    faults = Faults()
    driver = Driver(World(MAG, 1, faults))
    driver.go(*OVER_PIN)
    arm(driver)
    faults.add(Fault("trigger_late", site="nozzle_pin", mm=0.7))
    driver.world.expect_faults()
    assert driver.find("z_endstop") == pytest.approx(2.3)
    driver.go(z=3.0)
    assert faults.unfired() == []
    # The touch of now is over
    faults.add(Fault("stuck_open", site="nozzle_pin"))
    driver.world.expect_faults()
    driver.go(z=2.3)
    assert driver.world.level("z_endstop", driver.t, DEEP)
    end(driver)
    driver.go(z=HIGH)
    arm(driver)
    assert levels(driver) == (False, False)


def test_arming_while_the_last_touch_still_presses_is_no_touch():
    faults = Faults([Fault("trigger_never", site="nozzle_pin", touch=2)])
    driver = Driver(World(MAG, 1, faults))
    driver.go(*OVER_PIN)
    arm(driver)
    driver.go(z=3.0)
    end(driver)
    # Before it is lifted, as klippy does
    arm(driver)
    driver.stay(0.1)
    assert len(faults.unfired()) == 1
    driver.go(z=5.0)
    assert len(faults.unfired()) == 1
    driver.go(z=2.9)
    assert faults.unfired() == []


def test_body_is_not_looked_for_while_it_is_in_the_dock():
    fault = Fault("stuck_closed", site="body_pin", persistent=False)
    second = Fault("trigger_never", site="body_pin", touch=2)
    driver = Driver(World(DOCK, 1, Faults([fault, second])))
    driver.go(*BODY_OVER_PIN)
    arm(driver)
    driver.stay(0.1)
    assert levels(driver) == (True, False)
    end(driver)
    driver.world.put_probe_on(driver.t)
    arm(driver)
    assert levels(driver) == (True, False)
    driver.stay(0.1)
    assert levels(driver) == (True, True)
    # That was the first touch, also if it goes on to press, and the only first
    driver.go(z=7.9)
    end(driver)
    driver.go(z=HIGH)
    arm(driver)
    driver.go(z=7.9)
    assert not driver.world.level("z_endstop", driver.t, driver.pose)


def test_trigger_elsewhere_of_an_axis_switch():
    faults = Faults([Fault("trigger_early", site="z_endstop", touch=2, mm=2.0)])
    driver = Driver(World(PIEZO, 1, faults))
    found = [driver.touch("z_endstop", lift=12) for _ in range(3)]
    assert found == pytest.approx([0.0, 2.0, 0.0])
    assert faults.unfired() == []
    assert driver.world.truth.touch_count("z_endstop") == 2


def test_signal_that_triggers_elsewhere_at_its_next_arming():
    early = Fault("trigger_early", signal="z_endstop", mm=9.5)
    driver = over_pin(early)
    found = [driver.touch("z_endstop", lift=12) for _ in range(2)]
    assert found == pytest.approx([12.5, 3.0])


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
    driver = over_pin(Fault("trigger_never", site="nozzle_pin", touch=2))
    driver.touch("z_endstop")
    assert driver.world.level("z_endstop", driver.t, DEEP)
    arm(driver)
    assert not driver.world.level("z_endstop", driver.t, DEEP)
    driver.go(z=2.5)
    end(driver)
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
    fault = Fault("probe_falls", site="body_pin", touch=n, when=when)
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
    driver = Driver(make(MAG, Fault("probe_falls", touch=2)))
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
