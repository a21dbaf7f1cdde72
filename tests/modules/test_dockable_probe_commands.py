"""What [dockable_probe] does when everything is well, on every host."""

from __future__ import annotations

import pytest

from simprinter import Fault
from tools.kit.cases import slow
from tools.kit.dockable_probe import (
    ABOVE,
    BED,
    CLEAR,
    FORCE,
    FRAME,
    GANTRY,
    HANG,
    HOMING,
    QUICK,
    SENSED,
    SERVO,
    SWITCH,
    down_by_force,
    moves,
    section,
    trips,
    where,
)
from tools.kit.z_calibration import with_moves

SCENES = pytest.mark.parametrize(
    "scene",
    [GANTRY, SWITCH, slow(SENSED), SERVO, slow(FRAME), BED, slow(ABOVE)],
    ids=lambda scene: scene.name,
)
MESH = "BED_MESH_CALIBRATE PROBE_COUNT=3,3"


@pytest.mark.every_host(
    "a host asks its probe itself, in sessions since 2024-06, or as Kalico"
)
def test_everything_that_probes(start):
    printer = start(GANTRY, section(**QUICK)).homed()
    for command in (
        "PROBE",
        "PROBE_ACCURACY SAMPLES=2",
        "QUERY_PROBE",
        MESH,
        "QUAD_GANTRY_LEVEL",
        "SCREWS_TILT_CALCULATE",
    ):
        before = len(printer.machine.truth.events)
        printer.run(command)
        assert where(printer) == "docked", command
        once = [] if command == "QUERY_PROBE" else ["attach", "dock"]
        assert trips(printer, before) == once, command
        if command == "PROBE":
            # Docked: nothing hangs lower than the nozzle any more
            z = printer.session.position()[2]
            assert z == pytest.approx(HANG, abs=0.02)
    lines = "\n".join(printer.session.console)
    assert "Mesh Bed Leveling Complete" in lines
    assert "probe: TRIGGERED" in lines
    status = printer.status("probe")
    assert status["last_z_result"] == pytest.approx(HANG, abs=0.01)
    assert printer.machine.truth.min_gap == pytest.approx(HANG, abs=0.02)


@pytest.mark.every_host(
    "the calibrations of probe and twist ask for offsets in three ways"
)
def test_offsets_are_calibrated_as_with_any_probe(start):
    printer = start(GANTRY, section(**QUICK)).homed()
    printer.run("PROBE_CALIBRATE\nTESTZ Z=-1\nACCEPT")
    lines = "\n".join(printer.session.console)
    assert "dockable_probe: z_offset: " in lines
    printer.run("SET_GCODE_OFFSET Z=0.1\nZ_OFFSET_APPLY_PROBE")
    last = "\n".join(printer.session.console[-4:])
    assert "dockable_probe: z_offset: 6.800" in last
    printer.run("AXIS_TWIST_COMPENSATION_CALIBRATE SAMPLE_COUNT=2")
    printer.run("ACCEPT")
    printer.run("ACCEPT")
    assert where(printer) == "docked"
    printer.run(MESH)
    assert where(printer) == "docked"


@SCENES
def test_attached_until_it_is_detached(start, scene):
    printer = start(scene, section(**QUICK)).homed()
    printer.run(f"G1 X150 Y150 Z20 F6000\nPROBE\n{MESH}")
    assert where(printer) == "docked"
    printer.run("BED_MESH_CLEAR\nG1 X150 Y150 Z30 F6000\nM400")
    place = printer.session.position()
    printer.run("ATTACH_PROBE")
    assert where(printer) == "attached"
    assert printer.session.position() == pytest.approx(place, abs=0.001)
    before = len(printer.machine.truth.events)
    # Pressed on the bed it still is attached
    printer.run(f"PROBE\nPROBE\n{MESH}\nATTACH_PROBE\nPROBE")
    assert trips(printer, before) == []
    assert printer.status("dockable_probe")["last_status_name"] == "ATTACHED"
    printer.run("BED_MESH_CLEAR\nG1 X150 Y150 Z30 F6000\nDETACH_PROBE")
    assert where(printer) == "docked"
    assert printer.session.position() == pytest.approx(place, abs=0.001)
    printer.run("DETACH_PROBE")
    assert trips(printer, before) == ["dock"]
    # Where the bed hangs askew, it is nearer to the nozzle than to the probe
    assert printer.machine.truth.min_gap > HANG - 0.2


def test_probe_that_is_pressed_is_not_fetched_again(start):
    changes = {"moves": {}, **section(**QUICK), **FORCE}
    printer = start(GANTRY, changes, modules=with_moves()).homed()
    printer.run("ATTACH_PROBE\nG90\nG1 X150 Y150 F6000")
    # As a command of the owner's leaves it: the pin reads as without a probe
    printer.run(down_by_force(HANG - 0.2))
    assert "pin reads TRIGGERED" in "".join(printer.run("GET_PROBE_STATUS"))
    ends = moves(printer, "ATTACH_PROBE\nPROBE")
    assert all(end[:2] == pytest.approx((150, 150)) for end in ends)
    assert where(printer) == "attached"


def test_probe_that_is_pressed_until_the_head_has_gone_up_is_there(start):
    changes = {**section(auto_attach_detach="False", **QUICK), **FORCE}
    printer = start(SWITCH, changes).homed()
    printer.run("ATTACH_PROBE\nG90\nG1 X150 Y150 F6000")
    printer.run(down_by_force(HANG - 0.2))
    # The pin is read while the toolhead goes up, and again when it is there.
    printer.run("G1 Z20 F600\nPROBE")
    assert where(printer) == "attached"


@pytest.mark.parametrize("way", HOMING)
def test_where_z_is_homed_with_the_probe(start, way):
    changes, place = HOMING[way]
    printer = start(GANTRY, changes).homed()
    touches = [
        touch
        for touch in printer.machine.truth.touches
        if touch.site == "probe_bed"
    ]
    assert len(touches) == 2
    for touch in touches:
        assert (touch.x, touch.y) == pytest.approx(place, abs=0.02)
    assert where(printer) == "docked"
    assert printer.session.position()[2] >= CLEAR
    # Z=0 is where the nozzle meets the bed
    gap = printer.gap((150.0, 150.0))
    assert gap == pytest.approx(0.0, abs=0.02)


# Delayed


def test_two_commands_and_one_trip(start):
    printer = start(GANTRY, section(allow_delayed_detach="True", **QUICK))
    printer.homed()
    printer.run(MESH)
    assert trips(printer) == ["attach"]
    place = printer.session.position()
    assert where(printer) == "attached"
    printer.session.wait(6.0)
    assert where(printer) == "docked"
    assert printer.session.position() == pytest.approx(place, abs=0.001)


def test_attach_while_docking_is_delayed(start):
    printer = start(GANTRY, section(allow_delayed_detach="True", **QUICK))
    printer.homed()
    printer.run("PROBE\nATTACH_PROBE")
    printer.session.wait(6.0)
    assert where(printer) == "attached"


def test_delayed_docking_that_fails_is_told(start):
    changes = section(allow_delayed_detach="True", **QUICK)
    fault = Fault("dock_fails", persistent=True)
    printer = start(GANTRY, changes, faults=[fault]).homed()
    printer.session.wait(8.0)
    assert "the probe was not docked" in printer.session.console[-1]
    assert printer.session.state()[0] == "ready"


# Told by hand


def test_automatic_off(start):
    printer = start(GANTRY, section(**QUICK)).homed()
    printer.run("SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0")
    assert printer.status("dockable_probe")["auto_attach_detach"] is False
    before = len(printer.machine.truth.events)
    text = printer.fail("PROBE")
    assert "the probe is DOCKED at z=" in text
    assert text.endswith(
        "(pin reads TRIGGERED); auto_attach_detach is off, so it is not fetched"
        " by itself; run ATTACH_PROBE"
    )
    printer.run("ATTACH_PROBE\nPROBE\nDETACH_PROBE")
    assert trips(printer, before) == ["attach", "dock"]
    printer.run("SET_DOCKABLE_PROBE\nSET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=1")
    printer.run("PROBE")
    assert trips(printer, before) == ["attach", "dock"] * 2


def test_probe_put_on_by_hand(start):
    printer = start(GANTRY, section(**QUICK)).homed()
    text = printer.fail("SET_PROBE_STATUS STATE=ATTACHED")
    assert "STATE=ATTACHED, but the probe is DOCKED (pin reads TRIGGERED)" in (
        text
    )
    text = printer.fail("SET_PROBE_STATUS STATE=NOWHERE")
    assert "STATE has to be ATTACHED, DOCKED, UNKNOWN" in text
    printer.run("ATTACH_PROBE\nSET_PROBE_STATUS STATE=ATTACHED")
    before = len(printer.machine.truth.events)
    # Nobody has seen it change, and it stays then
    printer.run("G1 X150 Y150 Z20\nPROBE")
    assert trips(printer, before) == ["dock", "attach"]
    printer.run("SET_PROBE_STATUS STATE=unknown\nPROBE")
    assert trips(printer, before) == ["dock", "attach"] * 2 + ["dock"]


@pytest.mark.every_host(
    "the status of [probe] is the host's until 2024-06, and ours since"
)
def test_status_as_other_plugins_have_it(start):
    printer = start(GANTRY, section(**QUICK)).homed()
    for name in ("last_query", "last_z_result", "name"):
        own = printer.status("dockable_probe")[name]
        assert own == printer.status("probe")[name]
    assert printer.status("probe")["name"] == "dockable_probe"
    # As Kalico counts
    for script, state in (("ATTACH", 1), ("DETACH", 2)):
        printer.run(f"{script}_PROBE")
        assert printer.status("dockable_probe")["last_status"] == state
    assert printer.status("dockable_probe")["last_status_name"] == "DOCKED"
    assert printer.status("dockable_probe")["auto_attach_detach"] is True
    for command in ("GET_PROBE_STATUS", "QUERY_DOCKABLE_PROBE"):
        lines = printer.run(command)
        assert lines[0].endswith("Probe Status: DOCKED")
        assert lines[1].endswith("pin reads TRIGGERED")


# Parts of the way


def test_parts_of_the_way(start):
    changes = {
        "moves": {},
        **section(
            extract_position="10, 308",
            insert_position="12, 300",
            detach_position="50, 270",
        ),
    }
    printer = start(SWITCH, changes, modules=with_moves()).homed()
    for part, place in (
        ("APPROACH", (50.0, 270.0)),
        ("DOCK", (50.0, 308.0)),
        ("DETACH", (50.0, 270.0)),
        ("INSERT", (12.0, 300.0)),
        ("EXTRACT", (10.0, 308.0)),
    ):
        printer.run(f"MOVE_TO_{part}_PROBE")
        assert printer.session.position()[:2] == pytest.approx(place), part


def test_move_around_the_dock(start):
    changes = {"moves": {}, **section(safe_dock_distance="30")}
    printer = start(GANTRY, changes, modules=with_moves()).homed()
    printer.run("G1 X5 Y300 Z20 F6000\nM400")
    ends = moves(printer, "MOVE_AVOIDING_DOCK X=100 Y=300 SPEED=200")
    assert ends[-1] == (100.0, 300.0, 20.0)
    assert min(y for _, y, _ in ends) < 280.0
    # Only X: Y stays; without a SPEED as fast as travel_speed
    fast = printer.machine.simulation.virtual_ns
    printer.run("MOVE_AVOIDING_DOCK X=200\nM400")
    between = printer.machine.simulation.virtual_ns
    printer.run("MOVE_AVOIDING_DOCK X=100 SPEED=20\nM400")
    slowly = printer.machine.simulation.virtual_ns
    assert printer.session.position() == pytest.approx((100.0, 300.0, 20.0))
    assert slowly - between > 3 * (between - fast)
    assert "SPEED" in printer.fail("MOVE_AVOIDING_DOCK X=100 SPEED=0")
