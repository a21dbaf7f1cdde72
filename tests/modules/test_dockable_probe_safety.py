"""What [dockable_probe] does when something is wrong: nothing gets hurt."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.hosts.session import GcodeError
from tools.kit.cases import slow
from tools.kit.dockable_probe import (
    BED,
    CLEAR,
    FLOOR,
    FRAME,
    GANTRY,
    HANG,
    HOMING,
    QUICK,
    SENSED,
    SWITCH,
    WAY,
    assert_safe,
    at,
    section,
    trips,
    where,
    with_probe,
)
from tools.kit.docks import DOCK_SCENES
from tools.kit.scenes import on_gantry

MESH = "BED_MESH_CALIBRATE PROBE_COUNT=3,3"
EXTRACT = (50.0, 270.0)
DETACH = (90.0, 308.0)


def ready(printer):
    """The same printer when it is ready."""
    printer.session.require_ready()
    return printer


def tolerant(printer):
    """Of a dead switch's body on the bed, as deep as the floor lets it."""
    printer.machine.tolerate("body_bed", HANG - 0.4 - 1.0)
    return printer


# Before the first touch: what reads "attached" has to change


@pytest.mark.parametrize("way", HOMING)
def test_stuck_open_before_the_first_homing(start, way):
    # As if the probe were on the toolhead for ever: the classical crash
    fault = Fault("stuck_open", signal="probe", t=0.0)
    printer = ready(start(GANTRY, HOMING[way][0], faults=[fault]))
    text = printer.fail("G28")
    assert "the probe was not docked, it is ATTACHED (pin reads open)" in text
    assert "never changes" in text
    assert printer.machine.truth.touch_count("nozzle_bed") == 0
    assert printer.machine.truth.min_gap > 10.0
    assert at(printer) == pytest.approx(DETACH)


def test_attached_at_the_start_is_docked_and_fetched_again(start):
    printer = start(with_probe(GANTRY, initial="attached"), section(**QUICK))
    printer.homed()
    assert trips(printer) == ["dock", "attach", "dock"]
    assert "proves nothing" in "\n".join(printer.session.console)


def test_reading_that_was_not_seen_to_change_again(start):
    printer = start(GANTRY, section(**QUICK)).homed()
    printer.run("ATTACH_PROBE")
    printer.machine.break_down(
        Fault("stuck_open", site="probe_bed", command="PROBE")
    )
    tolerant(printer)
    # The dead one is found at the touch ...
    assert "No trigger" in printer.fail("PROBE")
    assert "nothing down to z=1.900" in "\n".join(printer.session.console)
    assert printer.session.position()[2] >= CLEAR - 0.01
    # ... and docking shows that it never changes
    assert "never changes" in printer.fail("DETACH_PROBE")
    assert "was not docked" in printer.fail("PROBE")
    assert_safe(printer)
    assert printer.machine.truth.min_gap > 1.5


# Each n-th attempt fails


@pytest.mark.parametrize(
    ("command", "n"), [slow("G28", 1), ("PROBE", 1), slow("PROBE", 2)]
)
@pytest.mark.parametrize("fault", ["attach_fails", "dock_fails"])
def test_attempt_that_fails_is_tried_again(start, fault, command, n):
    changes = section(dock_retries="1", **QUICK)
    faults = [Fault(fault, n=n, command=command)]
    printer = start(GANTRY, changes, faults=faults).homed()
    printer.run("PROBE\nPROBE")
    failed = fault.replace("fails", "failed")
    assert trips(printer).count(failed) == 1
    lines = "\n".join(printer.session.console)
    assert "try 2 of 2" in lines
    assert where(printer) == "docked"


@pytest.mark.parametrize("has_probed", [False, True])
def test_fetching_that_fails(start, has_probed):
    command = "BED_MESH_CALIBRATE"
    fault = Fault("attach_fails", command=command, persistent=True)
    printer = start(SWITCH, section(dock_retries="2", **QUICK), faults=[fault])
    printer.homed()
    printer.run("G1 X150 Y150 Z5 F6000")
    if has_probed:
        printer.run("PROBE")
    before = len(printer.machine.truth.touches)
    text = printer.fail(MESH)
    assert "the probe was not fetched, it is DOCKED (pin reads TRIGGERED)" in (
        text
    )
    assert "in the dock it has to meet the toolhead at dock_position" in text
    assert (
        "where it hangs on the toolhead, a wire is broken, so take it off"
        in text
    )
    assert trips(printer).count("attach_failed") == 3
    assert len(printer.machine.truth.touches) == before
    assert at(printer) == pytest.approx((150.0, 150.0))
    assert printer.session.position()[2] >= CLEAR
    assert_safe(printer)
    printer.machine.repair()
    printer.run("PROBE")
    assert where(printer) == "docked"


def test_docking_that_fails(start):
    fault = Fault("dock_fails", command="PROBE", persistent=True)
    printer = start(GANTRY, section(**QUICK), faults=[fault]).homed()
    text = printer.fail("PROBE")
    assert "the probe was not docked, it is ATTACHED" in text
    assert trips(printer)[-1] == "dock_failed"
    # On its way back already
    assert at(printer) == pytest.approx((152.0, 125.25))
    assert printer.session.position()[2] >= CLEAR - 0.001
    assert_safe(printer)
    printer.machine.repair()
    printer.run("DETACH_PROBE")
    assert where(printer) == "docked"


def test_pin_that_chatters_while_the_head_moves(start):
    # It is read on the way back, and again when the toolhead stands still
    printer = start(SWITCH, section(**QUICK)).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nM400")
    machine, session = printer.machine, printer.session
    command = session.begin("ATTACH_PROBE")
    session.run_until(command, lambda: trips(printer) == ["attach"])
    machine.break_down(Fault("stuck_closed", signal="probe", t=printer.now()))
    session.run_until(command, lambda: machine.tip().y < EXTRACT[1] - 20.0)
    machine.repair()
    session.finish(command)
    assert where(printer) == "attached"
    assert trips(printer) == ["attach"]


def test_empty_dock(start):
    printer = ready(start(with_probe(SENSED, initial="lost")))
    text = printer.fail("G28")
    assert "not fetched, it is UNKNOWN" in text
    assert "dock_sense_pin reads open" in text
    # It did not go there
    assert at(printer) == pytest.approx((152.0, 125.25))
    assert printer.session.state()[0] == "ready"


def test_senses_that_contradict_each_other(start):
    fault = Fault("stuck_closed", signal="probe_sense", t=0.0)
    printer = ready(start(SENSED, section(dock_retries="1"), faults=[fault]))
    text = printer.fail("G28")
    assert "it is UNKNOWN" in text
    assert "probe_sense_pin reads TRIGGERED" in text
    assert "dock_sense_pin reads TRIGGERED" in text
    assert sum("try 2 of 2" in line for line in printer.session.console) == 1


@pytest.mark.parametrize(
    ("signal", "level"),
    [
        ("probe", "stuck_open"),
        ("probe", "stuck_closed"),
        ("probe_sense", "stuck_open"),
        ("probe_sense", "stuck_closed"),
        ("dock_sense", "stuck_open"),
        ("dock_sense", "stuck_closed"),
    ],
)
def test_sense_that_is_stuck_from_the_start(start, signal, level):
    fault = Fault(level, signal=signal, t=0.0)
    printer = ready(start(SENSED, faults=[fault]))
    told = "the probe was not"
    if (signal, level) == ("probe", "stuck_open"):
        # The others tell where the probe is, but this is what stops the nozzle.
        told = "'pin' reads open without the probe, as a broken wire does"
    assert f"dockable_probe: {told}" in printer.fail("G28")
    assert printer.machine.truth.min_gap > 10.0
    assert printer.session.state()[0] == "ready"


# Lost, or dead


@pytest.mark.every_host(
    "where the last look at the probe is depends on how a session ends"
)
def test_probe_lost_at_the_last_touch(start):
    # Nothing touches after it: only a look tells that the result is wrong
    printer = start(SWITCH, section(**QUICK)).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nATTACH_PROBE")
    assert where(printer) == "attached"
    printer.machine.break_down(
        Fault("probe_falls", site="probe_bed", command="PROBE")
    )
    text = printer.fail("PROBE")
    assert "was lost, what was measured is wrong" in text
    assert printer.session.position()[2] >= CLEAR - 0.01
    assert "not fetched" in printer.fail("PROBE")
    assert_safe(printer)


def test_not_back_down_to_nothing(start):
    # Beside the bed; the bare nozzle would be left 1.9 mm over it
    bed = replace(SWITCH.world.bed, x_max=200.0)
    printer = start(SWITCH.with_world(bed=bed), section(**QUICK)).homed()
    printer.run("G1 X250 Y150 Z20 F6000")
    assert "No trigger" in printer.fail("PROBE")
    assert where(printer) == "docked"
    assert printer.session.position()[2] == pytest.approx(CLEAR)


# As QUAD_GANTRY_LEVEL between two G28 does: the toolhead is where it was said to
# be, or said to be somewhere else
@pytest.mark.parametrize("script", ["G1 Z60", "SET_KINEMATIC_POSITION Z=2"])
def test_switch_that_dies_before_z_is_homed_again(start, script):
    changes = {"force_move": {"enable_force_move": "True"}, **section(**QUICK)}
    printer = tolerant(start(GANTRY, changes)).homed()
    printer.run(f"ATTACH_PROBE\nG1 X150 Y150 Z30 F6000\n{script}\nM400")
    assert where(printer) == "attached"
    printer.machine.break_down(
        Fault("stuck_open", site="probe_bed", command="G28")
    )
    assert "No trigger" in printer.fail("G28 Z")
    assert "nothing where the bed was" in "\n".join(printer.session.console)
    printer.session.wait(1.0)
    truth = printer.machine.truth
    assert FLOOR - 0.1 < truth.min_gap < FLOOR + 0.1
    # Up again, clear of the bed
    assert printer.machine.tip().z > truth.min_gap + 5.0
    # It is not believed a second time
    assert "never changes" in printer.fail("G28")
    printer.machine.repair()
    printer.run("G28\nDETACH_PROBE")
    assert where(printer) == "docked"
    assert truth.min_gap > FLOOR - 0.1


@pytest.mark.parametrize("script", ["Z=250", "Z=2", "Z=2\nG1 Z100", "Z=9\nM84"])
def test_home_again_where_z_was_said_to_be_elsewhere(start, script):
    changes = {"force_move": {"enable_force_move": "True"}}
    printer = start(GANTRY, changes).homed()
    printer.run(f"G1 Z30\nSET_KINEMATIC_POSITION {script}\nG28")
    assert printer.gap((150.0, 150.0)) == pytest.approx(0.0, abs=0.02)


def test_touch_elsewhere_is_no_height_of_the_bed_where_z_is_homed(start):
    # As at a corner of a gantry that hangs askew, before it is levelled
    printer = start(GANTRY, section(**QUICK)).homed()
    printer.run("ATTACH_PROBE\nG1 X150 Y150 Z60 F6000\nM400")
    printer.machine.break_down(
        Fault("stuck_closed", signal="probe", t=printer.now() + 2.0)
    )
    assert "was lost, what was measured is wrong" in printer.fail("PROBE")
    printer.machine.repair()
    printer.run("G28")
    assert printer.gap((150.0, 150.0)) == pytest.approx(0.0, abs=0.02)


def test_sense_pin_tells_before_a_touch(start):
    printer = start(SENSED, section(samples="1")).homed()
    printer.run("ATTACH_PROBE\nG1 X150 Y150 Z20 F6000\nM400")
    assert where(printer) == "attached"
    command = printer.session.begin("PROBE_ACCURACY SAMPLES=3")
    touches = printer.machine.truth.touches
    before = len(touches)
    printer.session.run_until(command, lambda: len(touches) > before)
    # While it is lifted, at 10 mm/s
    printer.machine.break_down(
        Fault("stuck_open", signal="probe_sense", t=printer.now() + 0.1)
    )
    with pytest.raises(GcodeError, match="probe_sense_pin reads open"):
        printer.session.finish(command)
    assert len(touches) <= before + 2
    assert_safe(printer)


# Templates that raise


# What is left as it was, and that the next run goes well: test_z_touch_user_gcode.py
@pytest.mark.parametrize(
    ("option", "state", "head"),
    [
        ("attach_gcode", "attached", EXTRACT),
        ("detach_gcode", "docked", DETACH),
        ("deactivate_gcode", "docked", (150.0, 150.0)),
    ],
)
def test_template_that_raises(start, option, state, head):
    raises = "\n  {action_raise_error('no')}"
    printer = start(SWITCH, section(**{option: raises}, **QUICK)).homed()
    printer.run("G1 X150 Y150 Z20 F6000")
    assert "no" in printer.fail("PROBE")
    # The way out of the dock is only queued when the error comes: hosts differ
    # in how far the toolhead has got by then.
    printer.run("M400")
    assert where(printer) == state
    assert at(printer) == pytest.approx(head)
    # deactivate_gcode runs where the toolhead was before
    lowest = CLEAR if option == "deactivate_gcode" else HANG - 0.2
    assert printer.session.position()[2] > lowest - 0.01
    assert_safe(printer)


@pytest.mark.parametrize("name", ["activate", "deactivate"])
def test_head_that_moves_where_it_must_not(start, name):
    changes = section(**{f"{name}_gcode": "\n  G91\n  G1 Z1\n  G90"}, **QUICK)
    printer = start(SWITCH, changes).homed()
    printer.run("G1 X150 Y150 Z20 F6000")
    assert f"the toolhead moved in {name}_gcode" in printer.fail("PROBE")
    assert_safe(printer)


# Not homed


@pytest.mark.parametrize("name", sorted(DOCK_SCENES))
def test_not_homed(start, name):
    printer = ready(start(DOCK_SCENES[name]))
    printer.run("G28 X Y")
    if name in ("dock_bed", "dock_above"):
        # Nobody knows how high the dock is
        assert "not homed: Z;" in printer.fail("ATTACH_PROBE")
        assert where(printer) == "docked"
    else:
        z = printer.machine.tip().z
        printer.run("ATTACH_PROBE")
        assert where(printer) == "attached"
        # Up, and once only
        z += WAY + (8.0 if name == "dock_frame" else 0.0)
        assert printer.machine.tip().z == pytest.approx(z, abs=0.01)
        printer.run("DETACH_PROBE")
        assert printer.machine.tip().z == pytest.approx(z, abs=0.01)
        assert "z" not in printer.status("toolhead")["homed_axes"]
        assert "Must home before probe" in printer.fail("PROBE")


# Where nobody knows Z the toolhead was lifted for the dock, and went down since: the
# probe was dragged along the bed


# Until 2024 (v0.12.0) no command forgets a homed axis, and Z is known there
@pytest.mark.every_host(
    "until 2024 (v0.12.0) no command forgets that an axis was homed"
)
def test_lift_of_before_z_was_homed_and_forgotten(start):
    changes = {"force_move": {"enable_force_move": "True"}}
    printer = ready(start(SWITCH, {**changes, **section(**QUICK)}))
    printer.run("G28 X Y\nATTACH_PROBE\nG28 Z\nG90\nG1 X150 Y150 F6000")
    printer.run("G1 Z0.5 F600\nM400\nSET_KINEMATIC_POSITION CLEAR=Z")
    printer.run("ATTACH_PROBE\nM400")
    assert where(printer) == "attached"
    assert printer.machine.tip().z > CLEAR
    assert printer.machine.truth.depth("body_bed") == 0.0


def test_lift_of_before_the_motors_were_forced(start):
    one_motor = on_gantry(SWITCH, "one_motor", "corexy", z=(150.0, 150.0))
    changes = {
        "force_move": {"enable_force_move": "True"},
        "quad_gantry_level": None,
        **section(**QUICK),
    }
    printer = start(one_motor, changes).homed()
    printer.run("G90\nG1 X150 Y150 Z5 F6000\nM84\nG28 X Y")
    printer.run("MOVE_AVOIDING_DOCK X=150 Y=150 SPEED=100")
    printer.run("ATTACH_PROBE\nDETACH_PROBE")
    z = printer.machine.tip().z
    force = "FORCE_MOVE STEPPER=stepper_z DISTANCE=%g VELOCITY=10\n"
    printer.run(force % -13 + "ATTACH_PROBE\nM400")
    assert printer.machine.tip().z == pytest.approx(z, abs=0.01)
    # Not up again where it was forced up
    printer.run(force % 4 + "DETACH_PROBE\nM400")
    assert printer.machine.tip().z == pytest.approx(z + 4.0, abs=0.01)


# The dock in the way


# Places in the circle around the dock, each relative to it
@pytest.mark.parametrize(
    "scene", [GANTRY, FRAME, slow(BED)], ids=lambda scene: scene.name
)
@pytest.mark.parametrize(
    ("right", "back"), [slow(-30, -8), (35, -18), slow(0, -28), (-2, -16)]
)
def test_from_beside_the_dock(start, scene, right, back):
    # The crash detector knows its body
    printer = start(scene, section(**QUICK)).homed()
    dock = scene.world.dock
    if scene is FRAME:
        # Turned by 90 degrees, against the clock
        right, back = -back, right
    x, y = dock.x + right, dock.y + back
    printer.run(f"MOVE_AVOIDING_DOCK X={x} Y={y}")
    assert printer.session.position()[:2] == pytest.approx((x, y), abs=0.05)
    printer.run("ATTACH_PROBE\nDETACH_PROBE")
    assert where(printer) == "docked"
    assert trips(printer)[-2:] == ["attach", "dock"]
