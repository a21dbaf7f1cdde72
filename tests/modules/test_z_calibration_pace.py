"""CALIBRATE_Z loses no time, and still looks before it goes down."""

from __future__ import annotations

import functools
from collections import Counter
from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.world import NoiseSpec
from tools.bench import commands
from tools.kit.cases import slow
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    BODY,
    MICROSTEP,
    PIN,
    SWITCH_OFFSET,
    calibration,
    section,
    with_moves,
)

# Of the voron scene: where G28 leaves the toolhead, and the travel height
HOMED_Z = 10.0
TRAVEL_Z = 13.8


def ends(printer, script="CALIBRATE_Z"):
    """Where each move of a command ended (mm)."""
    before = len(printer.status("moves")["ends"])
    printer.run(script)
    return printer.status("moves")["ends"][before:]


def test_head_over_the_pin_is_not_lifted_first(watched):
    printer = watched()
    # The first move is the lift between two touches
    assert ends(printer)[0][2] < HOMED_Z


@pytest.mark.slow
@pytest.mark.parametrize(
    "place", ["Z2", "X205.5", "Y305.5"], ids=["low", "beside", "behind"]
)
def test_head_elsewhere_is_lifted_first(watched, place):
    printer = watched()
    printer.run(f"G90\nG1 {place} F600\nM400")
    assert ends(printer)[0][2] == TRAVEL_Z


def test_probe_is_looked_at_when_its_owner_has_attached_it(start):
    """Also where the way to the switch takes less than the look is ahead."""
    voron, cartesian = SCENES["voron"], SCENES["cartesian"]
    probe = replace(voron.world.mag_probe, mode="output", attach_time=0.45)
    outputs = cartesian.wiring.outputs
    scene = replace(voron, wiring=replace(voron.wiring, outputs=outputs))
    again = "\n  G90\n  G1 Z20 F900\n  SET_PIN PIN=probe_magnet VALUE=0\n"
    again += "  G4 P500\n  ATTACH_PROBE"
    changes = section(before_switch_gcode=again, speed="300")
    for name in ("output_pin probe_magnet", "gcode_macro ATTACH_PROBE"):
        changes[name] = cartesian.sections[name]
    changes["output_pin probe_magnet"] = {
        **cartesian.sections["output_pin probe_magnet"],
        "value": "1",
    }
    calibration(start(scene.with_world(mag_probe=probe), changes).homed())


# With the section of make bench, printer s: what is configured, and what hosts take to
# stop and begin again
LONGEST = 15.4


@pytest.mark.slow
@pytest.mark.every_host("hosts wait for what boards tell at times of their own")
def test_count_takes_as_long_as_configured(start):
    """Whenever it begins: hosts wait for what boards tell at their own times."""
    command = commands.CALIBRATE_Z
    printer = start(command.scene, command.changes)
    printer.session.require_ready()
    clock, seconds = printer.machine.simulation.clock, []
    for phase in range(5):
        printer.run("G28\nM400")
        printer.session.wait(0.05 * phase)
        began = clock.now()
        printer.run("CALIBRATE_Z\nM400")
        seconds.append((clock.now() - began) * 1e-9)
        assert printer.status("z_calibration")["valid"]
    assert max(seconds) <= LONGEST


def armings(printer, script="CALIBRATE_Z"):
    """How often each signal was armed by a command."""
    found = []
    listen = printer.machine.rig.on_operation.append
    listen(lambda kind, signal, ns: found.append((kind, signal)))
    printer.run(script)
    return Counter(signal for kind, signal in found if kind == "touch")


def test_bed_is_looked_for_only_where_nobody_has_met_the_pin(start):
    """Neither where Z is homed, nor in a second run."""
    printer = start().homed()
    # Each way down is a move of its own
    assert armings(printer) == {"z_endstop": 8, "probe": 4}
    printer.run("G28")
    beside = "CALIBRATE_Z NOZZLE_POSITION=207.2,306"
    first, second = [armings(printer, beside)["z_endstop"] for _ in range(2)]
    assert first > 20 and second == 8


@pytest.mark.slow
def test_place_of_the_pin_is_known_from_the_history(start):
    """Of one of its own nobody else knows; the probe is asked on the way down."""
    printer = start("separate_pin").homed()
    began = armings(printer)["nozzle_endstop"]
    printer.session.wait(1.0)
    printer.session.restart("RESTART")
    printer.homed().session.wait(1.0)
    assert began > 20
    assert armings(printer)["nozzle_endstop"] < 10


# The body meets the pin where the way down ends, or so much (mm) above or below
@pytest.mark.parametrize(
    "below", [slow(-1.5), -0.3, slow(-0.02), 0.0, slow(0.02), 0.3]
)
def test_pin_is_met_where_the_way_down_ends(start, below):
    z_offset = BODY + SWITCH_OFFSET - 0.5 + below
    changes = {"probe": {"z_offset": f"{z_offset:.4f}"}}
    printer = start(changes=changes).homed()
    (_, switch, *_), sites = calibration(printer)
    assert switch == pytest.approx(PIN + BODY, abs=MICROSTEP)
    # A touch is as slow as configured: what is met before is no sample
    assert sites.count("body_pin") == (3 if below > 0.01 else 4)
    assert printer.machine.truth.depth("body_pin") <= 0.02


@pytest.mark.slow
@pytest.mark.parametrize("mm", [3.7, 2.998])
def test_what_bounces_on_the_way_down_is_no_sample(start, mm):
    """Nor where it ends, and the toolhead stands before the touch begins."""
    early = Fault(
        "trigger_early", site="body_pin", command="CALIBRATE_Z", mm=mm
    )
    z_offset = f"{BODY + SWITCH_OFFSET:.4f}"
    changes = {
        "probe": {"z_offset": z_offset, "samples_tolerance_retries": "0"}
    }
    printer = start(changes=changes, faults=[early]).homed()
    (_, switch, *_), _ = calibration(printer)
    assert switch == pytest.approx(PIN + BODY, abs=MICROSTEP)


# What the section leaves open is the module's


def auto(**options):
    return section(samples="auto", **options)


def noisy(scene="voron", pin=None, probe=None, **world):
    """A scene whose switches are so."""
    made, before = SCENES[scene], SCENES[scene].world
    return made.with_world(
        pin=replace(before.pin, noise=NoiseSpec(**(pin or {}))),
        mag_probe=replace(before.mag_probe, noise=NoiseSpec(**(probe or {}))),
        **world,
    )


def spans(printer):
    """Seconds between the second and third touch of each site, and on the way."""
    before = len(printer.machine.truth.touches)
    printer.run("CALIBRATE_Z")
    times = {}
    for touch in printer.machine.truth.touches[before:]:
        times.setdefault(touch.site, []).append(touch.t)
    nozzle, switch, bed = (
        times[site] for site in ("nozzle_pin", "body_pin", "probe_bed")
    )
    return {
        "nozzle": nozzle[2] - nozzle[1],
        "switch": switch[2] - switch[1],
        "bed": bed[2] - bed[1],
        "to the switch": switch[0] - nozzle[-1],
        "to the bed": bed[0] - switch[-1],
    }


@functools.cache
def usual_spans(host):
    return measured_spans(host)


def measured_spans(host, **sections):
    own = auto(**sections.pop("z_calibration", {}))
    with Printer(host, changes={**own, **sections}) as printer:
        return spans(printer.homed())


def longer(pin, bed):
    """So much more (s) between two samples."""
    return {"nozzle": pin, "switch": pin, "bed": bed}


# The voron's probe is lifted at 10 mm/s.  Its pin is touched at 3, its bed at 5 mm/s,
# with a lift of 0.5 mm where the section leaves it open.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "more"),
    [
        (section(probing_retract_dist="2"), longer(1.5 / 3, 1.5 / 5)),
        (section(lift_speed="1"), longer(0.5, 0.5)),
        # Down, too
        (section(lift_speed="5"), {"to the switch": 17 / 5 - 17 / 10}),
        (section(probing_speed="3"), {"to the bed": 6.3 / 3 - 6.3 / 10}),
        (section(speed="40"), {"to the bed": 165.7 / 40 - 165.7 / 100}),
        # Half of it is enough to stop from 4 mm/s, with two boards, too
        (section(travel_margin="0.2"), {"to the bed": 6.3 / 4 - 6.3 / 10}),
        # What the axis has is for the pin only
        (
            {"stepper_z": {"second_homing_speed": "0.5"}},
            longer(0.5 / 0.5 - 0.5 / 3, 0.0),
        ),
        # Half the homing speed of 8 where there is no second one
        (
            {"stepper_z": {"second_homing_speed": None, "homing_speed": "1"}},
            longer(0.5 / 0.5 - 0.5 / 3, 0.0),
        ),
        # Of homing, where the user says nothing of these touches
        ({"stepper_z": {"homing_retract_dist": "6"}}, longer(0.0, 0.0)),
    ],
    ids=lambda value: "-".join(value),
)
def test_owner_has_the_last_word(host, changes, more):
    usual, found = usual_spans(host), measured_spans(host, **changes)
    left = {part: found[part] - usual[part] for part in more}
    # Hosts need other times to stop and begin again
    assert left == pytest.approx(more, abs=0.3)


@pytest.mark.parametrize(
    ("limit", "lift", "homing", "fastest"),
    [
        # Hosts would let Z go as fast as X and Y do then, 300 mm/s
        (None, "7", "4", 7.0),
        (None, "4", "7", 7.0),
        ("6", "4", "9", 6.0),
        ("15", "10", "8", 10.0),
    ],
)
@pytest.mark.parametrize("samples", ["3", "auto"])
def test_z_is_moved_as_fast_as_elsewhere(
    start, limit, lift, homing, fastest, samples
):
    """The larger of lift_speed of [probe] and homing_speed, up and on its way down."""
    changes = {
        "printer": {"max_z_velocity": limit},
        "probe": {"lift_speed": lift},
        "stepper_z": {"homing_speed": homing},
        **section(samples=samples),
    }
    printer = start(changes=changes).homed()
    printer.run("G1 X150 Y150 Z100 F6000\nM400")
    rig, touches = printer.machine.rig, printer.machine.truth.touches
    count = len(touches)
    began = rig.seconds(printer.machine.simulation.clock.now())
    found = spans(printer)
    # 98 mm down to above the pin, armed
    down = touches[count].t - began
    assert 98 / fastest < down < 98 / fastest + 5
    # Some 12 mm up, the way between, and down again
    assert found["to the switch"] > 12 / fastest


PLAIN, LATE = SCENES["voron"], noisy(pin={"hysteresis": 0.7})


@pytest.mark.parametrize(
    ("scene", "options", "params", "lifts"),
    [
        (PLAIN, {}, "SAMPLE_RETRACT_DIST=2", [2.0, 2.0]),
        (PLAIN, {}, "", [0.5, 0.5]),
        # A longer one that is needed is found once
        (LATE, {}, "", [0.5, 1.0, 1.0, 1.0]),
        # A nozzle that is wiggled is lifted as its owner has it
        (PLAIN, {"wiggle_xy_offsets": "1, 1"}, "", [3.0]),
        (PLAIN, {"wiggle_xy_offsets": "0, 0"}, "", [0.5, 0.5]),
    ],
)
def test_lift_between_two_touches(start, scene, options, params, lifts):
    changes = {"moves": {}, **auto(**options)}
    printer = start(scene, changes, modules=with_moves()).homed()
    found = ends(printer, f"CALIBRATE_Z {params}")[: len(lifts)]
    assert [z - PIN for _, _, z in found] == pytest.approx(lifts, abs=0.01)


@pytest.mark.parametrize(
    "scene",
    [
        noisy(pin={"hysteresis": 0.7}, probe={"hysteresis": 1.2}),
        noisy(pin={"sigma": 0.003}, probe={"sigma": 0.003}, z_play=0.02),
    ],
    ids=["hysteresis", "play"],
)
def test_lift_is_as_long_as_the_switch_needs(start, scene):
    printer = start(scene, auto()).homed()
    calibration(printer)
    gap = printer.gap() - printer.scene.formula_gap()
    assert abs(gap) <= 0.02 + 2 * MICROSTEP


@pytest.mark.parametrize("touch", [1, 2], ids=["first", "second"])
def test_switch_that_stays_pressed_is_no_long_lift(start, touch):
    """Nothing opens so late; the message is what it says of that switch."""
    about = {"site": "nozzle_pin", "touch": touch, "command": "CALIBRATE_Z"}
    faults = [Fault("stuck_closed", **about)]
    text = start(changes=auto(), faults=faults).homed().fail("CALIBRATE_Z")
    assert "the Z endstop reads triggered where nothing should press" in text


def test_touch_that_met_nothing_is_not_repeated(start):
    about = {"site": "nozzle_pin", "touch": 2, "command": "CALIBRATE_Z"}
    faults = [Fault("trigger_never", **about)]
    changes = auto(offset_margins="-0.5, 1", travel_margin="0.5")
    printer = start(changes=changes, faults=faults)
    printer.machine.tolerate("nozzle_pin", 0.5 + MICROSTEP)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "did not answer" in text


def test_plunger_that_the_pin_presses_is_lifted_clear(start):
    """Though it still is after the lift between two touches."""
    world = SCENES["voron"].world
    probe = replace(world.mag_probe, plunger_on_pin=True, switch_offset=0.9)
    scene = SCENES["voron"].with_world(mag_probe=probe)
    printer = start(scene, auto()).homed()
    lines = printer.run("CALIBRATE_Z")
    (told,) = [line for line in lines if "presses the plunger" in line]
    assert "correct switch_xy_position" in told
    (warning,) = printer.status("z_calibration")["warnings"]
    assert told.endswith(warning)


@pytest.mark.parametrize("samples", ["3", "auto"])
def test_head_stays_as_high_as_it_is_on_its_way(watched, samples):
    """As high as the user's macro has left it: a dock may be in between."""
    printer = watched(samples=samples)
    printer.run("G90\nG1 X150 Y150 Z60 F6000\nM400")
    assert [z for _, _, z in ends(printer)[:2]] == [60.0, 60.0]


@pytest.mark.parametrize("margin", [0.2, 0.4])
def test_what_stands_in_the_way_is_pressed_by_half_the_margin(start, margin):
    """A plate that is higher than in the last run, met on the quick way down.

    Its switch is told 20 ms late, as over a slow line to another board; touches
    are so slow that this is nothing.
    """
    options = {"travel_margin": f"{margin}", "offset_margins": "-4, 4"}
    changes = {**auto(**options), "probe": {"speed": "2"}}
    scene = noisy(probe={"latency": 0.02})
    printer = start(scene, changes=changes).homed()
    (before, *_), _ = calibration(printer)
    printer.machine.world.exchange_plate(2.0)
    (after, *_), _ = calibration(printer)
    assert after - before == pytest.approx(2.0, abs=2 * MICROSTEP)
    assert printer.machine.truth.depth("probe_bed") <= margin / 2.0


@pytest.mark.slow
def test_first_way_goes_along_x_then_along_y(watched):
    printer = watched()
    printer.run("G1 X50 Y60 Z20 F6000\nM400")
    places = [(x, y) for x, y, _ in ends(printer)]
    first = places.index((206.0, 306.0))
    assert places[first - 1] == (206.0, 60.0)
