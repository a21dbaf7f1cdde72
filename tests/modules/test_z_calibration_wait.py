"""Z_CALIBRATION_WAIT on real klippy: the pin is touched until it stands still."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.world import DriftSpec, NoiseSpec, OozeSpec
from tools.kit.cases import slow
from tools.kit.scenes import SCENES
from tools.kit.waiting import STILL, seen
from tools.kit.z_calibration import (
    PIN,
    assert_unharmed,
    calibration,
    kept_runs,
    reported,
    section,
    touched_sites,
)

WAIT = "Z_CALIBRATION_WAIT"
# mm by which a pin may be pressed that was met higher before
GROWN = 0.3
# Homed cold, and the first touch comes some seconds later
MINUTE = 60.0


def growing(**drift):
    """The scene whose nozzle grows, per minute instead of second."""
    rate = drift.pop("nozzle") / MINUTE
    return SCENES["voron"].with_world(drift=DriftSpec(nozzle=rate, **drift))


def homed(start, *scene, **more):
    """A homed printer; its pin gives way to a nozzle that has grown."""
    printer = start(*scene, **more)
    printer.machine.tolerate("nozzle_pin", GROWN)
    return printer.homed()


def test_printer_that_is_warm_is_seen_in_two_minutes(start):
    printer = homed(start)
    printer.run("SET_GCODE_OFFSET Z=0.2 MOVE=0")
    before = len(printer.machine.truth.touches)
    assert printer.status("z_calibration")["movement"] is None
    lines = printer.run(WAIT)
    assert [(m, speed) for m, _, speed in seen(lines)] == [
        (0, None),
        (1, 0.0),
        (2, 0.0),
    ]
    assert [z for _, z, _ in seen(lines)] == pytest.approx([PIN] * 3, abs=0.004)
    assert lines[-1] == f"// {WAIT}: {STILL}"
    # [probe] has 2 here
    assert touched_sites(printer, before) == ["nozzle_pin"] * 9
    status = printer.status("z_calibration")
    assert status["movement"] == pytest.approx(0.0, abs=1e-9)
    assert status["phase"] == "idle"
    assert (status["last_result"], status["valid"]) == ({}, False)
    assert status["history"]["runs"] == 0
    assert_unharmed(printer, 0.2)


def test_others_live_while_it_waits(start):
    printer = homed(start)
    command = printer.session.begin(WAIT)
    printer.session.wait(30.0)
    status = printer.status("z_calibration")
    assert status["phase"] == "waiting"
    # Of 21 times that it may take
    assert status["progress"] == pytest.approx(1 / 21)
    # Lifted to the travel height
    assert printer.machine.tip().z > PIN + 10.0
    assert status["movement"] is None
    printer.session.wait(60.0)
    status = printer.status("z_calibration")
    assert status["progress"] == pytest.approx(2 / 21)
    assert status["movement"] == pytest.approx(0.0, abs=1e-9)
    printer.session.finish(command)
    # Not that of the last time
    command = printer.session.begin(WAIT)
    printer.session.wait(30.0)
    assert printer.status("z_calibration")["movement"] is None
    printer.session.finish(command)


@pytest.mark.parametrize(
    ("parameters", "minutes", "ends"),
    [
        ("LIMIT=0.006", 2, "it stands still after 2 minutes"),
        ("MAX=3", 3, "after 3 minutes (MAX) it still moves, by 0.00"),
        slow("LIMIT=0.001 MAX=5.5", 5, "LIMIT is 0.001: what is measured now"),
        slow("", 20, "after 20 minutes (MAX)"),
    ],
)
def test_limits(start, parameters, minutes, ends):
    printer = homed(start, growing(nozzle=0.0045))
    lines = printer.session.run(f"{WAIT} {parameters}", 1500.0)
    assert [minute for minute, _, _ in seen(lines)] == [*range(minutes + 1)]
    assert ends in lines[-1]
    last = seen(lines)[-1][2]
    assert printer.status("z_calibration")["movement"] == pytest.approx(
        last, abs=1e-4
    )
    # Nothing ends: what stands behind it in a macro goes on
    calibration(printer)


def test_growth_that_ends_is_seen_by_two_small_movements(start):
    # It grows for some two minutes after the first touch
    printer = homed(start)
    begins = printer.machine.truth.touches[-1].t
    scene = growing(nozzle=0.02, start=begins, stop=begins + 150.0)
    printer = homed(start, scene)
    lines = printer.run(WAIT)
    speeds = [speed for _, _, speed in seen(lines)[1:]]
    assert [abs(speed) < 0.003 for speed in speeds] == [
        False,
        False,
        False,
        True,
        True,
    ]
    # The pin is met higher by a nozzle that is longer
    assert speeds[0] == pytest.approx(0.02, abs=0.003)


def test_pin_that_is_met_lower_each_time_does_not_stand_still(start):
    printer = homed(start, growing(nozzle=-0.025))
    lines = printer.run(f"{WAIT} MAX=2")
    assert "it still moves, by 0.02" in lines[-1]
    assert printer.status("z_calibration")["movement"] < -0.015


@pytest.mark.parametrize(
    ("samples", "count"), [("1", 3), ("5", 5), slow("auto", 3)]
)
def test_touches_each_time(start, samples, count):
    changes = {"probe": {"samples": "2"}, **section(samples=samples)}
    printer = homed(start, changes=changes)
    before = len(printer.machine.truth.touches)
    printer.run(f"{WAIT} MAX=2")
    assert len(touched_sites(printer, before)) == 3 * count


def test_bad_touches_end_nothing(start):
    world = SCENES["voron"].world
    noise = NoiseSpec(0.001, outlier_chance=0.1, outlier_size=0.03)
    scene = SCENES["voron"].with_world(pin=replace(world.pin, noise=noise))
    changes = section(samples_tolerance="0.001", samples_tolerance_retries="0")
    printer = homed(start, scene, changes=changes)
    lines = printer.run(f"{WAIT} LIMIT=0.008")
    assert "it stands still" in lines[-1]


def test_one_bad_touch_is_no_movement(start):
    fault = Fault(
        "trigger_early", site="nozzle_pin", touch=5, mm=0.05, command=WAIT
    )
    printer = homed(start, faults=[fault])
    lines = printer.run(WAIT)
    assert "it stands still after 2 minutes" in lines[-1]


def test_each_minute_however_long_the_touches_take(start):
    changes = section(samples="5", probing_retract_dist="9", lift_speed="2")
    printer = homed(start, changes=changes)
    printer.run(f"{WAIT} MAX=2.5")
    at = [t.t for t in printer.machine.truth.touches if t.site == "nozzle_pin"]
    first = at[-15::5]
    assert [b - a for a, b in zip(first, first[1:])] == pytest.approx(
        [MINUTE] * 2, abs=3.0
    )


def test_motors_stay_on_while_it_waits(start):
    changes = {"idle_timeout": {"timeout": "30"}}
    printer = homed(start, changes=changes)
    printer.run(f"{WAIT} MAX=3\nCALIBRATE_Z")


def test_report_shows_how_far_the_pin_has_moved(start):
    printer = homed(start, growing(nozzle=0.02))
    heights = [z for _, z, _ in seen(printer.run(f"{WAIT} MAX=2"))]
    folder = printer.session.data / "config" / "z_calibration"
    (kept,) = kept_runs(printer)
    assert [minute for minute, _ in kept["waited"]] == pytest.approx(
        [0.0, 1.0, 2.0], abs=0.2
    )
    assert [z for _, z in kept["waited"]] == pytest.approx(heights, abs=1e-4)
    assert kept["ok"] is False
    reported(printer, "the report is ")
    (picture,) = folder.glob("report-*.svg")
    assert ": 2 minutes, then it still moved" in picture.read_text()
    # It is no run that the next ones are compared with
    assert printer.status("z_calibration")["history"]["runs"] == 0
    calibration(printer)
    printer.session.restart("RESTART")
    assert printer.status("z_calibration")["history"]["runs"] == 1


def test_dirty_nozzle_is_cleaned_once_without_the_offset_in_force(start):
    # A height in it is what it is in CALIBRATE_Z
    cleaned = "\n  RESPOND MSG=CLEANED_AT_{printer.gcode_move.homing_origin.z}"
    changes = {"respond": {}, **section(samples="6", clean_gcode=cleaned)}
    ooze = OozeSpec(0.1, kept=0.7)
    scene = SCENES["voron"].with_world(ooze=ooze)
    printer = homed(start, scene, changes=changes)
    printer.run("SET_GCODE_OFFSET Z=0.2 MOVE=0")
    lines = printer.run(f"{WAIT} MAX=4")
    assert sum("CLEANED_AT_0.0" in line for line in lines) == 1
    assert printer.offset() == 0.2


# What goes wrong meanwhile


@pytest.mark.every_host("only Kalico has a command that ends a wait")
def test_interrupt_of_kalico(start, host):
    if host.name != "kalico":
        pytest.skip("no HEATER_INTERRUPT")
    printer = homed(start)
    command = printer.session.begin(WAIT)
    printer.session.wait(30.0)
    printer.run("HEATER_INTERRUPT")
    with pytest.raises(Exception, match="interrupted"):
        printer.session.finish(command)
    assert_unharmed(printer)
