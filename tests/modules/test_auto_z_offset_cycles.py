"""How [auto_z_offset] moves between its touches, and what it makes of them."""

from __future__ import annotations

from itertools import groupby

import pytest

from simprinter import Fault
from tools.kit.auto_z_offset import (
    CORRECTION,
    MICROSTEP,
    PROBE_PLACE,
    formulas,
    seconds,
    section,
    sites,
    state,
    told,
    with_extras,
)
from tools.kit.cases import slow

# Cycles that differ


def test_cycles_that_differ_like_noise_are_told_not_refused(start):
    about = {"site": "nozzle_bed", "touch": 2, "command": "AUTO_Z_CALIBRATE"}
    fault = Fault("trigger_late", mm=0.1, **about)
    printer = start("qidi", faults=[fault])
    printer.machine.tolerate("nozzle_bed", 0.2)
    lines = printer.homed().run("AUTO_Z_CALIBRATE")
    assert len(told(lines, "cycles: they differ by 0.1")) == 1
    assert told(lines, "the touches of one by 0.0250 at most")
    # Not averaged with what the two others agree on
    found = printer.status("auto_z_offset")["probe_z_correction"]
    assert found == pytest.approx(CORRECTION, abs=2.0 * MICROSTEP)
    assert told(printer.run("AUTO_Z_CALIBRATE"), "they differ") == []


# The way down


@pytest.mark.slow
def test_the_head_comes_down_quickly_from_far_above(start):
    printer = start("qidi").homed()
    printer.run("G1 Z100 F1200\nM400")
    assert seconds(printer, "AUTO_Z_PROBE") <= 12.0
    assert "nozzle_bed" in sites(printer)


def test_bed_that_is_where_nobody_expects_it_stops_the_way_down(start):
    # Z was set 60 mm wrong: the bed is met on the quick way
    # prepare_gcode of the scene goes down to Z=3 by itself
    changes = section(prepare_gcode="SET_PIN PIN=bed_sensor VALUE=1")
    changes["force_move"] = {"enable_force_move": "True"}
    printer = start("qidi", changes=changes).homed()
    printer.run("G1 Z60 F1200\nSET_KINEMATIC_POSITION Z=120\nM400")
    printer.machine.tolerate("nozzle_bed", 1.0)
    text = printer.fail("AUTO_Z_PROBE")
    assert "triggered at z=58." in text or "reads triggered" in text
    assert printer.session.state()[0] == "ready"


@pytest.mark.slow
def test_travel_speed(start):
    slow = start("qidi", changes=section(travel_speed="10")).homed()
    usual = start("qidi").homed()
    # 18 mm between the two places, six times and once more at the end
    more = seconds(slow, "AUTO_Z_CALIBRATE")
    more -= seconds(usual, "AUTO_Z_CALIBRATE")
    assert more > 5 * 18.0 * (1 / 10 - 1 / 100)


@pytest.mark.parametrize(
    ("before", "params", "options", "above"),
    [
        ("", "", {}, 2.0),
        # 2.5 mm until the probe has its speed, and as much again
        slow("", "", {"speed": "50"}, 5.0),
        # Nobody knows where the probe triggers
        ("AUTO_Z_HOME_Z", "", {}, None),
        slow("", "ACCEPT_CHANGE=1", {}, None),
    ],
)
def test_way_down_of_the_probe(start, before, params, options, above):
    changes = {"moves": {}, **section(probe_hop="8", **options)}
    modules = with_extras("moves")
    printer = start("qidi", changes=changes, modules=modules).homed()
    printer.run(before)
    first = len(printer.status("moves")["ends"])
    result = formulas(printer.run(f"AUTO_Z_MEASURE_OFFSET {params}"))[-1]
    ends = printer.status("moves")["ends"][first:]
    # Kalico has a move of no length before a touch
    at_place = [z for x, y, z in ends if [x, y] == list(PROBE_PLACE)]
    there = [z for z, _ in groupby(at_place)]
    # The toolhead arrives, goes down quickly, and is lifted
    quick = [] if above is None else [result.probe + above]
    assert there[1:-1] == pytest.approx(quick, abs=0.02)


# The sensor after a touch


@pytest.mark.slow
def test_sensor_that_falls_back_late_is_given_a_moment(start):
    printer = start("qidi").homed()
    session, machine = printer.session, printer.machine
    command = session.begin("AUTO_Z_PROBE")
    count = machine.truth.touch_count
    session.run_until(command, lambda: count("nozzle_bed") == 1)
    machine.hold("bed_sensor", True)
    session.wait(0.9)
    machine.hold("bed_sensor", None)
    session.finish(command)


# Motor currents


def drivers(current):
    """What they report is 0.5 % more: 2.0097 A of 2.0, and the host takes 2.0 at most."""
    driver = {"sense_resistor": "0.075", "run_current": current}
    names = ("tmc2209 stepper_z", "tmc2209 stepper_z1")
    return dict.fromkeys(names, driver)


SET = "SET_TMC_CURRENT STEPPER=stepper_z CURRENT={}"
MACRO = {
    "rename_existing": "SET_TMC_CURRENT_BASE",
    "gcode": "\n  SET_TMC_CURRENT_BASE {rawparams}",
}


@pytest.mark.parametrize(
    ("changes", "script"),
    [
        (drivers("2.0"), ""),
        (drivers("1.5"), SET.format(2.0)),
        ({}, SET.format(0.62)),
        # Near the configured one
        ({}, SET.format(0.83)),
        # Klipper refuses a macro that runs already: one motor after another
        ({"gcode_macro SET_TMC_CURRENT": MACRO}, ""),
    ],
    ids=["above the limit", "set above it", "set", "set near", "macro"],
)
def test_current_in_force_is_put_back(start, changes, script):
    printer = start("qidi", changes=changes).homed()
    printer.run(script)
    before = state(printer)["currents"]
    written = [len(d.currents) for d in printer.machine.drivers.values()]
    lines = printer.run("AUTO_Z_PROBE")
    assert state(printer)["currents"] == before
    assert told(lines, "could not be set back") == []
    # Lowered, and back
    after = [len(d.currents) for d in printer.machine.drivers.values()]
    assert all(b > a + 1 for a, b in zip(written, after))
