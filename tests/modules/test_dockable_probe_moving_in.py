"""Sections and habits that one comes with, and what hands do in between."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.hosts.session import GcodeError
from tools.campaign.drawn.machines import on_plate
from tools.kit.dockable_probe import (
    ABOVE,
    BED,
    CLEAR,
    FORCE,
    GANTRY,
    HANG,
    QUICK,
    SENSED,
    SERVO,
    SWITCH,
    WAY,
    assert_safe,
    down_by_force,
    moves,
    section,
    trips,
    where,
    with_probe,
)
from tools.kit.docks import on_generic
from tools.kit.printer import has_kinematics
from tools.kit.z_calibration import with_moves

CENTRE = "G1 X150 Y150 Z20 F6000\n"
AROUND = "MOVE_AVOIDING_DOCK X=150 Y=150 SPEED=100"
MESH = "BED_MESH_CALIBRATE PROBE_COUNT=3,3"


def started(start, scene, changes=None, faults=(), **options):
    """A printer whose owner takes one sample, not homed."""
    changes = {**section(**{**QUICK, **options}), **(changes or {})}
    printer = start(scene, changes, faults=list(faults))
    printer.session.require_ready()
    return printer


# activate_gcode and deactivate_gcode


def told(printer, script):
    lines = printer.run(script)
    return [line.split()[-1] for line in lines if "activate" in line]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "wanted"),
    [
        # As Kalico runs them
        ("PROBE", ["activate", "deactivate"]),
        ("ATTACH_PROBE", ["activate"]),
        ("ATTACH_PROBE\nPROBE\nPROBE", ["activate"]),
        ("ATTACH_PROBE\nATTACH_PROBE", ["activate"] * 2),
        ("ATTACH_PROBE\nDETACH_PROBE", ["activate", "deactivate"]),
        ("DETACH_PROBE", ["deactivate"]),
        ("GET_PROBE_STATUS\nQUERY_PROBE", []),
    ],
)
def test_told_that_it_is_used(start, script, wanted):
    options = {
        f"{name}_gcode": f"\n  RESPOND MSG={name}"
        for name in ("activate", "deactivate")
    }
    printer = started(start, SWITCH, {"respond": {}}, **options).homed()
    shown = len(printer.session.console)
    assert told(printer, CENTRE + script) == wanted
    if script.startswith("GET"):
        lines = printer.session.console[shown:]
        assert any("Probe Status: DOCKED" in line for line in lines)


# A dock that a servo swings


@pytest.mark.parametrize("retries", [0, 1])
@pytest.mark.parametrize(
    ("fault", "state"), [("attach_fails", "docked"), ("dock_fails", "attached")]
)
def test_dock_is_put_away_after_a_failure(start, fault, state, retries):
    faults = [Fault(fault, persistent=True)]
    printer = started(
        start, SERVO, faults=faults, dock_retries=str(retries)
    ).homed()
    assert "the probe was not" in printer.fail(CENTRE + "PROBE")
    printer.run("G4 P500\nM400")
    assert not printer.machine.world.dock_is_out(printer.now())
    assert where(printer) == state
    assert_safe(printer)
    # It comes out again when it is needed
    printer.machine.repair()
    printer.run(CENTRE + "PROBE\nG4 P500\nM400")
    assert where(printer) == "docked"
    assert not printer.machine.world.dock_is_out(printer.now())


def test_first_error_counts_where_the_dock_is_not_put_away(start):
    printer = started(
        start,
        SWITCH,
        faults=[Fault("attach_fails", persistent=True)],
        post_attach_gcode="\n  {action_raise_error('second')}",
    ).homed()
    text = printer.fail(CENTRE + "PROBE")
    assert "was not fetched" in text and "second" not in text


def steps(*names):
    return "\n".join(f"MOVE_TO_{name}_PROBE" for name in names)


def is_out(printer):
    printer.run("G4 P500\nM400")
    return printer.machine.world.dock_is_out(printer.now())


def test_part_by_part_the_dock_is_brought_out_and_put_away(start):
    printer = started(start, SERVO).homed()
    printer.run(CENTRE + steps("APPROACH"))
    assert not is_out(printer)
    printer.run(steps("DOCK"))
    assert is_out(printer)
    printer.run(steps("EXTRACT"))
    assert (is_out(printer), where(printer)) == (False, "attached")
    printer.run(CENTRE + steps("DOCK", "DETACH"))
    assert (is_out(printer), where(printer)) == (False, "docked")
    # A probe that is fetched from there
    printer.run(CENTRE + steps("DOCK") + "\nATTACH_PROBE")
    assert (is_out(printer), where(printer)) == (False, "attached")
    # Another way out than the dock's own
    printer.run(CENTRE + steps("DOCK"))
    assert is_out(printer)
    printer.run("MOVE_AVOIDING_DOCK X=20 Y=300")
    assert not is_out(printer)
    assert_safe(printer)


# What brings the dock out depends on what hangs on the toolhead
def test_part_by_part_with_each_of_the_options(start):
    options = {
        f"{when}_{what}_gcode": f"\n  RESPOND MSG={when}_{what}"
        for when in ("pre", "post")
        for what in ("attach", "detach")
    }
    printer = started(start, SWITCH, {"respond": {}}, **options).homed()
    run = printer.run(CENTRE + steps("DOCK", "EXTRACT", "DOCK", "DETACH"))
    said = [line.split()[-1] for line in run if "tach" in line]
    assert said == ["pre_attach", "post_attach", "pre_detach", "post_detach"]


# Part by part: what the pins read before the way into the dock is over


def open_switch(start):
    """A switch that is normally open, and a sensor on the toolhead."""
    options = {"check_open_attach": "False", "dock_sense_pin": None}
    return started(
        start,
        with_probe(SENSED, normally_open=True),
        {"safe_z_home": None},
        **options,
    )


def closed_switch(start):
    return started(start, GANTRY, {"safe_z_home": None})


# The nozzle went down with the probe in the dock
@pytest.mark.slow
@pytest.mark.every_host(
    "homing with the probe is told by other events since 2026-05"
)
@pytest.mark.parametrize("ready", [open_switch, closed_switch])
@pytest.mark.parametrize(
    "script",
    [
        # In the dock when homing leaves it
        f"{steps('DOCK')}\nM400\nG28 Z",
        # Still on the toolhead when the last command is read
        f"{steps('DOCK', 'DETACH')}\n{AROUND}\nG28 Z",
    ],
)
def test_homing_with_what_was_left_in_the_dock(start, ready, script):
    printer = ready(start)
    printer.run("G28 X Y\nATTACH_PROBE")
    printer.run(script)
    assert trips(printer)[:3] == ["attach", "dock", "attach"]
    assert printer.machine.truth.min_gap > HANG - 0.1


# It was seen docked, and is until those moves are gone
def test_docking_of_what_queued_moves_have_fetched(start):
    printer = started(start, SWITCH).homed()
    printer.run(f"{CENTRE}ATTACH_PROBE\nDETACH_PROBE")
    script = steps("APPROACH", "DOCK", "EXTRACT") + "\nDETACH_PROBE"
    printer.run(f"{script}\n{AROUND}\nG1 Z0.3\nM400")
    assert trips(printer) == ["attach", "dock"] * 2
    assert printer.machine.truth.touch_count("body_bed") == 0


# What has changed on the way in and out is believed, as that of a trip is, and what
# has not is as it was known: the way to this dock is not known, and nobody is asked
# whether it hangs on the toolhead.
@pytest.mark.slow
@pytest.mark.parametrize(
    "way", [steps("DOCK", "EXTRACT", "DOCK", "DETACH"), steps("DOCK", "DETACH")]
)
def test_parts_of_the_way_prove_what_a_trip_does(start, way):
    printer = started(start, BED).homed()
    printer.run(f"{CENTRE}ATTACH_PROBE\nDETACH_PROBE\n{way}\nM84\nG28")
    trip = ["attach", "dock"]
    assert trips(printer) == (trip * 2 if "EXTRACT" in way else trip)


# With a broken wire it reads docked on the toolhead, and where it has got back, too
@pytest.mark.slow
@pytest.mark.parametrize(
    "way",
    [
        steps("DOCK", "EXTRACT"),
        steps("DOCK", "EXTRACT", "DOCK", "DETACH"),
        # By a macro of the owner's
        steps("DOCK") + "\nG1 Y270 F3000",
    ],
)
def test_way_out_with_the_probe_proves_nothing(start, way):
    printer = started(start, BED).homed()
    printer.run(f"{CENTRE}ATTACH_PROBE\nDETACH_PROBE")
    printer.machine.hold("probe", True)
    text = printer.fail(f"{way}\nM84\nG28")
    assert "it was not seen docked" in text


# Sense pins, and a switch that is normally open


def test_switch_that_is_normally_open(start):
    scene = with_probe(SENSED, normally_open=True)
    z = SWITCH.sections["stepper_z"]
    for options in (
        {"check_open_attach": "True", "dock_sense_pin": None},
        {"check_open_attach": None, "probe_sense_pin": None},
    ):
        changes = {
            "stepper_z": dict(z),
            "safe_z_home": SWITCH.sections["safe_z_home"],
        }
        wiring = replace(
            scene.wiring,
            inputs={**scene.wiring.inputs, "z_endstop": "^PC2"},
        )
        on_pin = replace(scene, wiring=wiring).with_world(pin=SWITCH.world.pin)
        printer = started(start, on_pin, changes, **options).homed()
        printer.run(CENTRE + f"PROBE\n{MESH}")
        assert trips(printer) == ["attach", "dock"] * 2
        lines = "\n".join(printer.session.console)
        assert "'pin' reads open without the probe, too" in lines


@pytest.mark.parametrize("script", ["G28", "G28 X Y\nATTACH_PROBE\nG28 Z"])
def test_only_stop_of_the_nozzle_has_to_be_seen(start, script):
    # A wire that is broken reads as such a switch does
    fault = Fault("stuck_open", signal="probe", t=0.0)
    printer = started(start, SENSED, faults=[fault])
    text = printer.fail(script)
    assert "'pin' reads open without the probe, as a broken wire does" in text
    assert ("attach" in trips(printer)) is ("ATTACH" in script)
    assert printer.machine.truth.min_gap > 10.0
    # Whoever has such a switch says so
    scene = with_probe(SENSED, normally_open=True)
    printer = started(start, scene, check_open_attach="False").homed()
    assert printer.gap((150.0, 150.0)) == pytest.approx(0.0, abs=0.02)


# By hand


@pytest.mark.parametrize("command", ["PROBE", MESH])
def test_hold_ends_where_somebody_has_put_it_into_the_dock(start, command):
    printer = started(start, SWITCH).homed()
    printer.run(CENTRE + "ATTACH_PROBE")
    machine = printer.machine
    machine.world.lose_probe(printer.now())
    assert "the probe" in printer.fail("PROBE")
    machine.world.bring_probe_back(printer.now())
    printer.run(CENTRE + command)
    assert where(printer) == "docked"


def test_dock_on_the_bed_with_the_probe_on_and_z_not_homed(start):
    printer = started(
        start,
        with_probe(BED, initial="attached"),
        detach_dockable_before_z_home="True",
    )
    text = printer.fail("G28")
    assert (
        "the probe is ATTACHED (pin reads open), and to find the dock Z has"
        in (text)
    )
    assert (
        "take the probe off by hand and put it into the dock, then"
        " SET_PROBE_STATUS STATE=DOCKED and G28" in text
    )
    assert "G28 Z" not in text
    assert printer.machine.truth.touch_count("nozzle_pin") == 0


# It reads as if it were docked then, and the way to this dock needs Z
def test_broken_wire_where_z_is_not_homed(start):
    options = {"detach_dockable_before_z_home": "True"}
    printer = started(start, BED, **options).homed()
    printer.run(f"{CENTRE}ATTACH_PROBE")
    begun = printer.machine.truth.touch_count("nozzle_pin")
    printer.machine.break_down(Fault("stuck_closed", signal="probe", t=0.0))
    for command in ("M84\nG28", "M84\nDETACH_PROBE"):
        text = printer.fail(command)
        assert "the probe reads DOCKED" in text
        assert "take it off before you home" in text
        assert "run SET_PROBE_STATUS STATE=DOCKED where you see it" in text
    assert printer.machine.truth.touch_count("nozzle_pin") == begun
    words = "it was not seen docked"
    assert words in "\n".join(printer.run("GET_PROBE_STATUS"))
    printer.run("SET_PROBE_STATUS STATE=DOCKED")
    assert words not in "\n".join(printer.run("GET_PROBE_STATUS"))


# Two pins that say so are no broken wire
@pytest.mark.parametrize(
    ("scene", "is_trip"), [(SENSED, False), (GANTRY, True)]
)
def test_pins_that_agree_are_believed(start, scene, is_trip):
    printer = started(start, scene).homed()
    printer.run(f"{CENTRE}ATTACH_PROBE")
    assert where(printer) == "attached"
    machine, begun = printer.machine, len(trips(printer))
    machine.world.lose_probe(printer.now())
    printer.session.wait(0.5)
    machine.world.bring_probe_back(printer.now())
    printer.session.wait(0.5)
    printer.run("DETACH_PROBE")
    assert ("dock" in trips(printer, begun + 1)) is is_trip


# As above, with X and Y unknown, too: nothing but what the pins read is asked then
def test_broken_wire_where_nothing_is_homed(start):
    printer = started(start, SWITCH, {"safe_z_home": None})
    pin = printer.scene.sections["safe_z_home"]["home_xy_position"].split(",")
    printer.run("G28 X Y\nG1 X%s Y%s F6000\nG28 Z" % tuple(pin))
    printer.run(f"{CENTRE}ATTACH_PROBE")
    begun = printer.machine.truth.touch_count("nozzle_pin")
    printer.machine.break_down(Fault("stuck_closed", signal="probe", t=0.0))
    text = printer.fail("M84\nG28 Z")
    assert "the probe reads DOCKED" in text
    assert "it was not seen docked" in text
    assert printer.machine.truth.touch_count("nozzle_pin") == begun


# It reads attached while it is in the dock, until it is to be docked
def test_pin_that_chatters_is_no_reason_for_more_trips(start):
    printer = started(start, GANTRY).homed()
    printer.run(f"{CENTRE}ATTACH_PROBE")
    machine, session = printer.machine, printer.session
    machine.world.lose_probe(printer.now())
    session.wait(0.5)
    machine.world.bring_probe_back(printer.now())
    session.wait(0.5)
    printer.run("SET_PROBE_STATUS STATE=UNKNOWN")
    begun = len(trips(printer))
    machine.break_down(Fault("stuck_open", signal="probe", t=0.0))
    command = session.begin("ATTACH_PROBE")
    session.run_until(command, lambda: "proves nothing" in session.console[-1])
    machine.repair()
    session.finish(command)
    assert trips(printer)[begun:] == ["attach"]


@pytest.mark.slow
@pytest.mark.every_host("Kalico's safe_z_home asks a dockable_probe itself")
@pytest.mark.parametrize(
    ("initial", "changes", "hop"),
    [
        ("attached", {"safe_z_home": None}, CLEAR),
        ("docked", {"safe_z_home": None}, 0.0),
        # The owner lifts it
        ("attached", {}, 10.0),
    ],
)
def test_hop_before_x_and_y_are_homed(start, initial, changes, hop):
    printer = started(start, with_probe(GANTRY, initial=initial), changes)
    z = printer.machine.tip().z
    printer.run("G28 X Y")
    assert printer.machine.tip().z == pytest.approx(z + hop, abs=0.02)
    printer.run("G28 X Y")
    if changes:
        # Once
        assert printer.machine.tip().z == pytest.approx(z + hop, abs=0.02)


@pytest.mark.every_host("only hosts since 2025-05 have generic_cartesian")
@pytest.mark.parametrize(
    ("initial", "hop"), [("attached", CLEAR), ("docked", 0)]
)
def test_hop_of_a_generic_cartesian(start, host, initial, hop):
    scene = on_generic(with_probe(GANTRY, initial=initial))
    if not has_kinematics(host, scene):
        pytest.skip("the host has no generic_cartesian")
    printer = started(start, scene, {"safe_z_home": None})
    z = printer.machine.tip().z
    for _again in 1, 2:
        printer.run("G28 X Y")
        assert printer.machine.tip().z == pytest.approx(z + hop, abs=0.02)


def test_hop_before_x_and_y_are_homed_again(start):
    changes = {"safe_z_home": None, **FORCE}
    printer = started(start, GANTRY, changes).homed()
    printer.run(f"{CENTRE}ATTACH_PROBE\n{down_by_force(HANG + 0.5)}\nG28 X Y")
    assert printer.session.position()[2] == pytest.approx(CLEAR, abs=0.02)


# In the dock by hand, or by a macro, and not to a thousandth


@pytest.mark.parametrize("script", ["MOVE_TO_DETACH_PROBE", "G28 X Y"])
@pytest.mark.parametrize("aside", ["0", "0.1", "0.9"])
def test_head_that_was_moved_a_little_in_the_dock(start, script, aside):
    printer = started(start, SWITCH).homed()
    printer.run(
        f"ATTACH_PROBE\nG90\nG1 Z20 F900\nMOVE_TO_DOCK_PROBE\nG91\nG1 X{aside}"
    )
    printer.run(f"G90\n{script}\nM400")
    assert trips(printer) == ["attach", "dock"]
    # The way in has no detour either
    printer.run(
        "MOVE_TO_DOCK_PROBE\nG91\nG1 X0.1\nG90\nMOVE_TO_DOCK_PROBE\nM400"
    )
    assert trips(printer) == ["attach", "dock"]
    assert printer.session.position()[:2] == pytest.approx((50.0, 308.0))


@pytest.mark.parametrize(
    ("options", "script"),
    [
        ({}, "SET_GCODE_OFFSET X=0.05"),
        ({"dock_position": "50.0042, 308"}, ""),
    ],
)
def test_macro_that_ends_a_little_beside_the_dock(start, options, script):
    wiggle = "\n  G90\n  G1 X50 Y306 F3000\n  G1 X50 Y308 F3000"
    options = {**options, "detach_gcode": wiggle}
    printer = started(start, SWITCH, **options).homed()
    printer.run(f"{script}\n{CENTRE}PROBE")
    assert trips(printer) == ["attach", "dock"]


# Down into a dock from above leads only where it is entered from there


@pytest.mark.parametrize(
    "command",
    ["MOVE_TO_DETACH_PROBE", "MOVE_TO_EXTRACT_PROBE", "MOVE_TO_DOCK_PROBE"],
)
def test_from_above_a_dock_that_is_entered_from_the_side(start, command):
    changes = {"moves": {}, **section(**QUICK)}
    printer = start(BED, changes, modules=with_moves()).homed()
    printer.run("G90\nG1 Z60 F900\nG1 X50 Y308 F6000\nM400")
    first, *_ = moves(printer, command)
    # Aside, as high as it is
    assert first[:2] != (50.0, 308.0)
    assert first[2] == pytest.approx(60.0)


@pytest.mark.parametrize(("xy", "goes"), [("50, 308", 40.0), ("150, 155", 0.0)])
def test_dock_that_all_positions_are_above(start, xy, goes):
    options = {
        "dock_position": f"{xy}, 12",
        "approach_position": f"{xy}, 30",
        "detach_position": f"{xy}, 32",
        "detach_gcode": "\n  G4 P100",
        "safe_dock_distance": None,
    }
    changes = {"moves": {}, **section(**{**QUICK, **options})}
    printer = start(ABOVE, changes, modules=with_moves()).homed()
    printer.run("MOVE_TO_APPROACH_PROBE")
    x, y = (float(part) for part in xy.split(","))
    assert printer.session.position()[:2] == pytest.approx([x, y])
    ends = moves(printer, "G28 X Y")
    gone = [math.hypot(end[0] - x, end[1] - y) for end in ends]
    assert max(gone, default=0.0) == pytest.approx(goes, abs=0.1)
    assert printer.session.state()[0] == "ready"


# Out of such a dock the way is up at first, also from a little above its place


@pytest.mark.parametrize(
    "above",
    [
        {},
        {
            "approach_position": "50, 308, 30",
            "detach_position": "50, 308, 32",
            "detach_gcode": "\n  G4 P100",
            "safe_dock_distance": None,
        },
    ],
)
@pytest.mark.parametrize("nudge", ["Z2", "X0.1 Z2"])
@pytest.mark.parametrize("command", ["G28 Z", "G28"])
def test_from_a_little_above_a_dock_that_is_left_upwards(
    start, above, nudge, command
):
    printer = started(start, ABOVE, **above).homed()
    printer.run("MOVE_TO_DOCK_PROBE")
    assert printer.session.position()[:2] == pytest.approx([50.0, 308.0])
    printer.run(f"G91\nG1 {nudge} F600\nG90\nM400")
    try:
        printer.run(command)
    except GcodeError as error:
        # This dock holds nothing back that is lifted
        assert above and "was not docked" in str(error)
    assert_safe(printer)


# Only on the way that it is a part of


def test_detach_gcode_that_lifts_the_head_in_the_dock(start):
    lifts = "\n  G91\n  G1 Z1.5 F600\n  G90"
    printer = started(start, BED, detach_gcode=lifts).homed()
    printer.run("ATTACH_PROBE\nDETACH_PROBE")
    assert trips(printer) == ["attach", "dock"]
    assert_safe(printer)


# A motor that is off lets Z sink as all of them do


@pytest.mark.parametrize(
    "off", ["M84", "SET_STEPPER_ENABLE STEPPER=stepper_z1 ENABLE=0"]
)
def test_height_is_forgotten_with_the_motors(start, off):
    printer = started(start, GANTRY, {"safe_z_home": None})
    printer.run("G28 X Y\nATTACH_PROBE\nDETACH_PROBE\nM400")
    z = printer.machine.tip().z
    printer.run(f"{off}\nG28 X Y\nATTACH_PROBE\nM400")
    assert printer.machine.tip().z == pytest.approx(z + WAY, abs=0.01)


# The gantry hangs askew until it was levelled, which is what fetches the probe


@pytest.mark.parametrize("slope", [0.015, -0.02, 0.025])
def test_gantry_that_hangs_askew(start, slope):
    scene = on_plate(GANTRY, (0.0, slope), 0.0, 0.0)
    printer = started(start, scene)
    printer.run("G28")
    assert trips(printer) == ["attach", "dock"]
    assert_safe(printer)


@pytest.mark.parametrize("retract", ["2", "0.2"])
def test_bed_that_is_bent_and_lifts_that_are_short(start, retract):
    scene = on_plate(SWITCH, (0.0, 0.0), 0.3, 0.0)
    printer = started(start, scene, sample_retract_dist=retract).homed()
    for x in 40, 260:
        printer.run(f"G90\nG1 Z20 F900\nG1 X{x} Y40 F6000\nPROBE\nM400")
    assert_safe(printer)


# The pin that Z is homed on is at one place


@pytest.mark.every_host(
    "some hosts ask for the lowest height at each place, others once"
)
def test_touch_ends_above_the_pin_only_over_it(start, host):
    pin = SWITCH.world.pin
    scene = on_plate(SWITCH, (0.0, 0.0), -0.3, 0.0)
    scene = scene.with_world(pin=replace(pin, z=pin.z + 4.2))
    high = {"stepper_z": {"position_endstop": "5.8"}}
    printer = started(start, scene, high).homed()
    text = printer.fail(f"G90\nG1 Z20 F900\nG1 X{pin.x} Y{pin.y} F6000\nPROBE")
    assert "No trigger" in text
    said = "nothing down to z=6.800, where the nozzle is just clear of the pin"
    assert said in "\n".join(printer.session.console)
    if asks_at_each_place(host):
        printer.run(MESH)
    else:
        # Such a host asks for one height, before anything moves
        assert "No trigger" in printer.fail(MESH)
    assert_safe(printer)


def asks_at_each_place(host):
    """Whether its probe has ours move, or is ours."""
    folder = host.directory / "base" / host.layout.module_dir
    source = (folder.parent / "extras" / "probe.py").read_text()
    is_of_host = "def multi_probe_begin" in source
    return not is_of_host or "self.mcu_probe.probing_move(" in source
