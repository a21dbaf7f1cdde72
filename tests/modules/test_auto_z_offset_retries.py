"""`retries` of [auto_z_offset]: what was touched wrong is measured once more."""

from __future__ import annotations

import pytest

from simprinter import Fault
from tools.kit.auto_z_offset import (
    CORRECTION,
    MICROSTEP,
    lowest,
    section,
    sites,
    state,
    told,
)
from tools.kit.cases import slow
from tools.kit.scenes import SCENES

PREPARE = SCENES["qidi"].sections["auto_z_offset"]["prepare_gcode"]


def broken(kind, site, touch=1, **more):
    """A fault at that touch of AUTO_Z_CALIBRATE."""
    return Fault(
        kind, site=site, touch=touch, command="AUTO_Z_CALIBRATE", **more
    )


def trying(start, *faults, retries="2", **options):
    """A homed printer that knows nothing of its bed."""
    code = f"{PREPARE}\n  RESPOND MSG=PREPARED"
    own = section(retries=retries, prepare_gcode=code, **options)
    printer = start("qidi", faults=list(faults), changes={"respond": {}, **own})
    printer.machine.tolerate("nozzle_bed", 5.0)
    return printer.homed()


@pytest.mark.parametrize(
    "fault",
    [
        broken("trigger_never", "nozzle_bed"),
        slow(broken("trigger_never", "nozzle_bed", 2)),
        broken("trigger_never", "inductive_bed", 2),
        # Far above where the touch before has met the bed
        slow(broken("trigger_early", "nozzle_bed", 2, mm=1.0)),
    ],
    ids=str,
)
def test_touch_that_goes_wrong_once(start, fault):
    printer = trying(start, fault, samples_tolerance_retries="0")
    before = len(printer.session.console)
    printer.run("AUTO_Z_CALIBRATE")
    lines = printer.session.console[before:]
    (line,) = told(lines, "; try 2 of 3 begins")
    assert len(told(lines, "echo: PREPARED")) == 2
    # Those of the try that has failed do not count
    found = printer.status("auto_z_offset")
    assert found["probe_z_correction"] == pytest.approx(
        CORRECTION, abs=2 * MICROSTEP
    )
    assert len(found["corrections"]) == 3


@pytest.mark.parametrize("retries", ["0", "1", "2"])
def test_touch_that_never_gets_right(start, retries):
    tries = int(retries) + 1
    faults = [
        broken("trigger_never", "nozzle_bed", number + 1)
        for number in range(tries)
    ]
    printer = trying(start, *faults, retries=retries)
    before, first = state(printer), len(printer.machine.truth.touches)
    lines = len(printer.session.console)
    text = printer.fail("AUTO_Z_CALIBRATE")
    assert "bed sensor: " in text and "begins" not in text
    said = printer.session.console[lines:]
    assert len(told(said, " begins")) == tries - 1
    assert len(told(said, "echo: PREPARED")) == tries
    assert sites(printer, first).count("nozzle_bed") == tries
    assert state(printer) == before
    depth = lowest(printer)
    alone = trying(start, faults[0], retries="0")
    alone.fail("AUTO_Z_CALIBRATE")
    assert depth == pytest.approx(lowest(alone), abs=2 * MICROSTEP)


def test_false_trigger_does_not_count_for_the_next_try(start):
    """Early by 1 mm: the second touch of the first try finds no bed."""
    fault = broken("trigger_early", "nozzle_bed", mm=1.0)
    printer = trying(start, fault, samples="2")
    printer.run("AUTO_Z_CALIBRATE")
    found = printer.status("auto_z_offset")["probe_z_correction"]
    assert found == pytest.approx(CORRECTION, abs=2 * MICROSTEP)


@pytest.mark.parametrize(
    ("fault", "own", "script"),
    [
        (None, {"prepare_gcode": "NOBODY_KNOWS"}, "AUTO_Z_CALIBRATE"),
        (None, {}, "M84\nAUTO_Z_CALIBRATE"),
        (broken("stuck_closed", "nozzle_bed", 2), {}, "AUTO_Z_CALIBRATE"),
        # Of a command that is not tried again
        slow(
            Fault(
                "trigger_never",
                site="inductive_bed",
                touch=1,
                command="AUTO_Z_MEASURE_OFFSET",
            ),
            {},
            "AUTO_Z_MEASURE_OFFSET",
        ),
    ],
    ids=str,
)
def test_what_was_not_touched_wrong_is_refused_at_once(
    start, fault, own, script
):
    printer = start(
        "qidi",
        faults=[fault] if fault else [],
        changes=section(retries="2", **own),
    )
    printer.machine.tolerate("nozzle_bed", 5.0)
    before = len(printer.homed().session.console)
    printer.fail(script)
    assert told(printer.session.console[before:], " begins") == []


@pytest.mark.parametrize("retries", ["1", "2"])
def test_bed_that_was_met_is_expected_in_the_next_try(start, retries):
    """A cycle was good, then the sensor is dead: 1 mm, and not down to position_min."""
    dead = [
        broken("trigger_never", "nozzle_bed", number)
        for number in range(2, 3 + int(retries))
    ]
    printer = trying(start, *dead, retries=retries)
    before = state(printer)
    text = printer.fail("AUTO_Z_CALIBRATE")
    assert "1.000 mm below the expected trigger at z=-1.3" in text
    assert lowest(printer) <= 1.1
    # The command has failed, and has taught nothing
    assert state(printer) == before
