"""How [auto_z_offset] moves between its touches, and what it makes of them."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import pytest

from simprinter import Fault
from simprinter.world import NoiseSpec
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
from tools.kit.scenes import SCENES

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


@pytest.mark.slow
def test_printer_with_usual_noise_is_not_refused(start):
    # 0.05 mm between five touches, as real ones are reported to spread, with
    # the tolerance of the specification's own example
    noise = NoiseSpec(latency=0.002, sigma=0.012)
    sensor = replace(SCENES["qidi"].world.bed_sensor, noise=noise)
    scene = SCENES["qidi"].with_world(bed_sensor=sensor)
    for seed in range(3):
        printer = start(scene, seed=seed).homed()
        assert formulas(printer.run("AUTO_Z_CALIBRATE"))


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


# The section of a Q1 Pro with the original module, which takes 35.7 s there
OWNERS = section(
    probe_hop="10",
    offset_samples="4",
    sample_retract_dist="5",
    prepare_gcode="""
  G90
  G0 Z3
  G91
  SET_PIN PIN=bed_sensor VALUE=0
  M400
  {% for iteration in range(20) %}
  G1 Z0.6 F7000
  G1 Z-0.6 F7000
  {% endfor %}
  G1 Z3
  M400
  G90
  SET_PIN PIN=bed_sensor VALUE=1""",
)


@pytest.mark.slow
def test_four_cycles_of_an_owner(start):
    printer = start("qidi", changes=OWNERS).homed()
    taken = seconds(printer, "AUTO_Z_CALIBRATE")
    assert taken <= 27.0
    found = printer.status("auto_z_offset")["corrections"]
    assert found == pytest.approx([CORRECTION] * 4, abs=2 * MICROSTEP)


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


@pytest.mark.slow
def test_current_above_the_limit_of_the_host_is_put_back(start):
    # With this resistor 2.0 A is reported as 2.0097 A, which is refused
    driver = {"sense_resistor": "0.075", "run_current": "2.0"}
    names = ("tmc2209 stepper_z", "tmc2209 stepper_z1")
    printer = start("qidi", changes=dict.fromkeys(names, driver)).homed()
    before = state(printer)["currents"]
    lines = printer.run("AUTO_Z_CALIBRATE")
    assert state(printer)["currents"] == before
    assert told(lines, "could not be set back") == []
    assert formulas(lines)[-1].correction == pytest.approx(
        CORRECTION, abs=2 * MICROSTEP
    )


@pytest.mark.parametrize(
    ("configured", "set_later"), [("1.5", "2.0"), slow("2.0", "2.0")]
)
def test_current_above_the_limit_that_was_set_later(
    start, configured, set_later
):
    """2.0 A is reported as 2.0097 A, and the host takes 2.0 at most."""
    driver = {"sense_resistor": "0.075", "run_current": configured}
    printer = start("qidi", changes={"tmc2209 stepper_z": driver}).homed()
    printer.run(f"SET_TMC_CURRENT STEPPER=stepper_z CURRENT={set_later}")
    before = state(printer)["currents"]
    printer.run("AUTO_Z_PROBE")
    assert state(printer)["currents"] == before


def test_current_near_the_configured_one_is_put_back(start):
    printer = start("qidi").homed()
    printer.run("SET_TMC_CURRENT STEPPER=stepper_z CURRENT=0.83")
    before = state(printer)["currents"]
    printer.run("AUTO_Z_PROBE")
    assert state(printer)["currents"] == before


def test_macro_of_that_name_is_run_for_one_motor_after_another(start):
    """Klipper refuses a macro that runs already."""
    macro = {
        "rename_existing": "SET_TMC_CURRENT_BASE",
        "gcode": "\n  SET_TMC_CURRENT_BASE {rawparams}",
    }
    changes = {"gcode_macro SET_TMC_CURRENT": macro}
    printer = start("qidi", changes=changes).homed()
    before = state(printer)["currents"]
    printer.run("AUTO_Z_PROBE")
    assert state(printer)["currents"] == before
