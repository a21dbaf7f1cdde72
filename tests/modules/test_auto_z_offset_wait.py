"""AUTO_Z_WAIT on real klippy: the bed is touched until it stands still."""

from __future__ import annotations

import pytest

from simprinter import Fault
from simprinter.world import DriftSpec
from tools.kit.auto_z_offset import (
    POINT,
    section,
    told,
    touches,
)
from tools.kit.cases import slow
from tools.kit.scenes import SCENES
from tools.kit.waiting import STILL, seen

WAIT = "AUTO_Z_WAIT"
MINUTE = 60.0
# mm by which the bed may be pressed that was met lower before
GROWN = 0.3


def growing(nozzle):
    """The scene whose nozzle grows by so many mm a minute."""
    return SCENES["qidi"].with_world(drift=DriftSpec(nozzle=nozzle / MINUTE))


def homed(start, scene="qidi", **more):
    """A homed printer; its bed gives way to a nozzle that has grown."""
    printer = start(scene, **more)
    printer.machine.tolerate("nozzle_bed", GROWN)
    return printer.homed()


def test_printer_that_is_warm_is_seen_in_two_minutes(start):
    printer = homed(start)
    printer.run("SET_GCODE_OFFSET Z=0.2 MOVE=0")
    assert printer.status("auto_z_offset")["movement"] is None
    lines = printer.run(WAIT)
    assert [(m, speed) for m, _, speed in seen(lines)] == [
        (0, None),
        (1, 0.0),
        (2, 0.0),
    ]
    assert lines[-1] == f"// {WAIT}: {STILL}"
    # Z was homed with the probe
    made = [t for t in touches(printer) if t.site == "nozzle_bed"]
    assert [(t.x, t.y) for t in made] == [pytest.approx(POINT, abs=0.02)] * 9
    status = printer.status("auto_z_offset")
    assert status["movement"] == pytest.approx(0.0, abs=1e-9)
    assert (status["phase"], status["last_result"]) == ("idle", {})
    assert printer.status("gcode_move")["homing_origin"][2] == 0.2


def test_others_live_while_it_waits_with_the_toolhead_lifted(start):
    printer = homed(start)
    command = printer.session.begin(WAIT)
    printer.session.wait(30.0)
    status = printer.status("auto_z_offset")
    assert status["phase"] == "waiting"
    # Of 21 times that it may take
    assert status["progress"] == pytest.approx(1 / 21)
    assert printer.machine.tip().z > 2.0
    assert status["movement"] is None
    printer.session.finish(command)
    # Not that of the last time
    command = printer.session.begin(WAIT)
    printer.session.wait(30.0)
    assert printer.status("auto_z_offset")["movement"] is None
    printer.session.finish(command)


@pytest.mark.parametrize(
    ("parameters", "minutes", "ends"),
    [
        ("LIMIT=0.006", 2, "it stands still after 2 minutes"),
        ("MAX=3", 3, "after 3 minutes (MAX) it still moves, by 0.00"),
        slow("LIMIT=0.001 MAX=5.5", 5, "LIMIT is 0.001: what is measured now"),
    ],
)
def test_limits(start, parameters, minutes, ends):
    printer = homed(start, growing(0.0045))
    lines = printer.session.run(f"{WAIT} {parameters}", 1500.0)
    assert [minute for minute, _, _ in seen(lines)] == [*range(minutes + 1)]
    assert ends in lines[-1]
    movement = printer.status("auto_z_offset")["movement"]
    assert movement == pytest.approx(seen(lines)[-1][2], abs=1e-4)
    assert movement > 0.003
    # Nothing ends: what stands behind it in a macro goes on
    printer.run("AUTO_Z_CALIBRATE")


def test_one_bad_touch_is_no_movement(start):
    fault = Fault(
        "trigger_early", site="nozzle_bed", touch=5, mm=0.02, command=WAIT
    )
    changes = section(samples_tolerance="0.03")
    lines = homed(start, faults=[fault], changes=changes).run(WAIT)
    assert "it stands still after 2 minutes" in lines[-1]


def test_touches_that_differ_more_than_the_section_allows_end_it(start):
    fault = Fault(
        "trigger_early", site="nozzle_bed", touch=5, mm=0.05, command=WAIT
    )
    changes = section(samples_tolerance="0.01", samples_tolerance_retries="0")
    printer = homed(start, faults=[fault], changes=changes)
    assert "samples_tolerance" in printer.fail(WAIT)


def test_sensor_that_stays_triggered_ends_it(start):
    # Behind the last of all touches: no other one looks at it
    good = homed(start)
    good.run(f"{WAIT} MAX=2")
    behind = touches(good)[-1].t + 0.1
    fault = Fault("stuck_closed", signal="bed_sensor", t=behind)
    printer = homed(start, faults=[fault])
    assert "reads triggered" in printer.fail(f"{WAIT} MAX=2")


def test_what_triggers_far_above_is_no_touch_of_the_bed(start):
    # Higher than where the minute before has met the bed
    fault = Fault(
        "trigger_early", site="nozzle_bed", touch=4, mm=1.2, command=WAIT
    )
    lines = homed(start, faults=[fault]).run(WAIT)
    assert len(told(lines, "mm above the expected z=")) == 1
    assert [speed for _, _, speed in seen(lines)] == [None, 0.0, 0.0]
