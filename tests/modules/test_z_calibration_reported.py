"""What owners of [z_calibration] reported of their printers, rebuilt small."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from simprinter import Fault
from simprinter.world import OozeSpec
from tests.docs.documents import part
from tools.kit.load_errors import load
from tools.kit.runs import make_runs
from tools.kit.scenes import SCENES, heated
from tools.kit.z_calibration import (
    BED,
    BODY,
    MICROSTEP,
    PIN,
    SWITCH_OFFSET,
    TRIGGER,
    assert_unharmed,
    calibration,
    section,
    touched_sites,
)

# The offset of a good run, mm: what its bed is above margins around 0
LOWEST = BED + TRIGGER - (BODY + SWITCH_OFFSET)
ROOT = Path(__file__).resolve().parents[2]
WIDE = {"offset_margins": "-5, 5"}


def told(printer, words):
    """The notes of the section that have these words."""
    return [n for n in printer.status("z_calibration")["notes"] if words in n]


def kill_probe(printer, depth):
    """From now on it does not answer; it may be pressed so deep (mm) then."""
    printer.machine.break_down(Fault("stuck_open", site="probe_bed"))
    printer.machine.tolerate("probe_bed", depth)
    printer.machine.tolerate("body_bed", depth)


def stopped_at(text):
    return float(text.split("(stopped at z=")[1].split(")")[0])


# Margins are for the result: how far down a touch may go is another question.  With the
# nozzle beside the pin in the first run it is a case of tests/field


@pytest.mark.parametrize(
    ("restarts", "parameter", "below"),
    [
        # The bed was found, and nothing was homed since: by travel_margin
        (False, "", 1.0),
        # As the history has it: plates differ by less than 2 mm
        (True, "", 2.0),
        # Pin or bed was changed: as if there were no history
        (True, " ACCEPT_CHANGE=1", 5.0 + LOWEST),
    ],
)
def test_dead_probe_after_a_good_run(start, restarts, parameter, below):
    printer = start(changes=section(**WIDE)).homed()
    calibration(printer)
    if restarts:
        printer.session.wait(2.0)
        printer.session.restart("FIRMWARE_RESTART")
        printer.homed()
        assert told(printer, "until a run was good") == []
    kill_probe(printer, below + MICROSTEP)
    text = printer.fail("CALIBRATE_Z" + parameter)
    floor = BED + TRIGGER - below
    assert stopped_at(text) == pytest.approx(floor, abs=2 * MICROSTEP)
    kept = (
        f"the last good run has found the bed {below:g} mm higher; check that"
    )
    first = "the bed is below the low end of offset_margins (-5.000), or the"
    assert (kept in text, first in text) == (not parameter, bool(parameter))
    assert (
        "if pin or bed is elsewhere now, run CALIBRATE_Z ACCEPT" in text
    ) is not bool(parameter)
    assert_unharmed(printer, printer.offset())
    # ACCEPT_CHANGE counts for one run
    text = printer.fail("CALIBRATE_Z")
    floor = BED + TRIGGER - (2.0 if restarts else 1.0)
    assert stopped_at(text) == pytest.approx(floor, abs=2 * MICROSTEP)
    printer.machine.repair()
    calibration(printer)


def test_margins_that_are_narrower_than_plates_differ_count(start):
    printer = start(changes=section(offset_margins="-0.5, 0.5")).homed()
    calibration(printer)
    kill_probe(printer, 0.5 + LOWEST + MICROSTEP)
    text = printer.fail("CALIBRATE_Z")
    assert stopped_at(text) == pytest.approx(
        BED + TRIGGER - 0.5 - LOWEST, abs=2 * MICROSTEP
    )
    assert "below the low end of offset_margins (-0.500)" in text


def test_own_pin_that_is_lower_now_is_found_with_accept_change(start):
    """By the levels of a run before it was too low in the same session."""
    printer = start("separate_pin", changes=section(**WIDE)).homed()
    calibration(printer)
    printer.machine.break_down(
        Fault("trigger_late", site="nozzle_pin", touch=1, mm=1.3)
    )
    printer.machine.tolerate("nozzle_pin", 1.4)
    assert "did not answer" in printer.fail("CALIBRATE_Z")
    printer.machine.repair()
    calibration(printer, "CALIBRATE_Z ACCEPT_CHANGE=1")


def test_shorter_probe_is_found_by_the_bed(start, tmp_path):
    """By 3 mm, with a z_offset that says nothing: no run of before knows better."""
    runs = make_runs(3, moved={"switch": 3.0, "bed": 3.0})
    lines = "".join(json.dumps(run) + "\n" for run in runs)
    (tmp_path / "printer.jsonl").write_text(lines)
    options = {"history": str(tmp_path), **WIDE}
    changes = {"probe": {"z_offset": "0"}, **section(**options)}
    printer = start(changes=changes).homed()
    printer.session.wait(1.0)
    assert told(printer, "until a run was good") == []
    (_, switch, *_), _ = calibration(printer)
    assert switch == pytest.approx(PIN + BODY, abs=MICROSTEP)


def test_accept_change_is_for_its_run(start):
    printer = start(changes=section(**WIDE)).homed()
    calibration(printer)
    calibration(printer, "CALIBRATE_Z ACCEPT_CHANGE=1")
    kill_probe(printer, 1.0 + MICROSTEP)
    text = printer.fail("CALIBRATE_Z_ACCURACY CYCLES=2")
    assert stopped_at(text) == pytest.approx(
        BED + TRIGGER - 1.0, abs=2 * MICROSTEP
    )


def test_another_plate_is_found_after_homing(start):
    """By 1.5 mm lower: plates differ by less than 2 mm, and come with a print."""
    lower = Fault("trigger_late", site="probe_bed", touch=1, mm=1.5)
    printer = start(changes=section(**WIDE)).homed()
    calibration(printer)
    # It is a probe that is late, so it is pressed
    for site in ("probe_bed", "body_bed"):
        printer.machine.tolerate(site, 1.5 + MICROSTEP)
    printer.machine.break_down(lower)
    assert "found the bed 1 mm higher" in printer.fail("CALIBRATE_Z SAMPLES=1")
    printer.machine.repair()
    printer.run("G28")
    printer.machine.break_down(lower)
    printer.run("CALIBRATE_Z SAMPLES=1")
    assert printer.offset() == pytest.approx(LOWEST - 1.5, abs=2 * MICROSTEP)


@pytest.mark.parametrize(
    ("z_offset", "known", "deep"),
    [
        # Never measured: the bed tells how long the probe is, give or take what
        # the bed may be off by
        ("0", "history", 2.0),
        ("0", "session", 1.0),
        ("0", "", 5.0 - 0.16),
        # Too small, so the first way down ends too low without a run before
        ("4", "history", 2.0),
        ("4", "", 5.0 - 0.16),
    ],
)
def test_dead_pin_below_the_body(start, z_offset, known, deep):
    margins = {} if known == "session" else WIDE
    changes = {"probe": {"z_offset": z_offset}, **section(**margins)}
    printer = start(changes=changes).homed()
    if known:
        calibration(printer)
    if known == "history":
        printer.session.wait(2.0)
        printer.session.restart("FIRMWARE_RESTART")
        printer.homed()
    printer.machine.break_down(Fault("stuck_open", site="body_pin"))
    printer.machine.tolerate("body_pin", deep + 3 * MICROSTEP)
    text = printer.fail("CALIBRATE_Z")
    assert text.startswith("z_calibration: switch: the switch did not answer")
    assert stopped_at(text) == pytest.approx(
        PIN + BODY - deep, abs=3 * MICROSTEP
    )
    changed = (
        "or, if pin, bed or probe was changed, run CALIBRATE_Z ACCEPT_CHANGE"
    )
    assert (changed in text) == bool(known)
    # As high as on its way, whatever z_offset says
    printer.session.wait(2.0)
    assert printer.session.position()[2] > PIN + 8.0


@pytest.mark.parametrize(
    ("margins", "history", "is_told"),
    [
        ("-1.9, 1.9", "z_calibration", False),
        ("-2, 2", "z_calibration", True),
        ("-5, 5", "none", True),
    ],
)
def test_wide_margins_are_told_before_the_first_run(
    start, margins, history, is_told
):
    options = {"offset_margins": margins, "history": history}
    printer = start(changes=section(**options))
    printer.session.require_ready()
    printer.session.wait(1.0)
    low = margins.split(",")[0]
    words = f"'offset_margins' down to {low} let a probe that does not answer"
    console = "\n".join(printer.session.console)
    assert len(told(printer, words)) == console.count(words) == is_told


# An offset_gcode that does not do what it says


def test_offset_gcode_that_sets_nothing_fails_the_run(start):
    """Such as one that keeps it in a variable; a misspelt one fails by its name."""
    changes = section(offset_gcode="M400")
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    text = printer.fail("CALIBRATE_Z")
    assert "offset_gcode has left a G-code Z offset of 0.000000 instead of" in (
        text
    )
    assert "Z_CALIBRATION_KEEP_OFFSET" in text
    assert "offset 0.160000 was not applied" in "".join(printer.session.console)
    status = printer.status("z_calibration")
    assert (status["valid"], status["last_query"]) == (False, False)
    assert_unharmed(printer, 0.3)


def test_offset_gcode_that_sets_what_was_measured(start):
    line = "SET_GCODE_OFFSET Z={params.Z|float|round(3)}"
    own = {"offset_gcode": line, "switch_offset": "0.4404"}
    printer = start(changes=section(**own)).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    result, _ = calibration(printer, "CALIBRATE_Z Z_ADJUST=0.05")
    off = abs(printer.offset() - result[-1] - 0.05)
    assert 0.0001 < off < 0.0006
    assert printer.status("z_calibration")["valid"]


def test_offset_gcode_that_adds_on_its_own_is_refused(start):
    line = "SET_GCODE_OFFSET Z={params.Z|float + 0.002}"
    printer = start(changes=section(offset_gcode=line)).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    text = printer.fail("CALIBRATE_Z")
    assert "has left a G-code Z offset of 0.162000 instead of 0.160000" in text
    assert_unharmed(printer, 0.3)


def test_only_offset_gcode_keeps_an_offset(start):
    changes = {
        "gcode_macro LATER": {"gcode": "\n  Z_CALIBRATION_KEEP_OFFSET"},
        **section(offset_gcode="LATER", end_gcode="M400"),
    }
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    told_off = (
        "z_calibration: Z_CALIBRATION_KEEP_OFFSET belongs into offset_gcode"
    )
    assert told_off in printer.fail("Z_CALIBRATION_KEEP_OFFSET")
    calibration(printer)
    assert printer.offset() == pytest.approx(0.3)
    # It is for that run, and it is over
    assert told_off in printer.fail("LATER")
    assert not printer.status("z_calibration")["valid"]


def test_an_offset_is_kept_by_the_run_that_says_so(start):
    code = (
        "\n  {% if printer.gcode_move.homing_origin.x %}"
        "\n  Z_CALIBRATION_KEEP_OFFSET\n  {% endif %}"
    )
    printer = start(changes=section(offset_gcode=code)).homed()
    printer.run("SET_GCODE_OFFSET X=1\nCALIBRATE_Z\nSET_GCODE_OFFSET X=0")
    assert "has left a G-code Z offset of 0.0" in printer.fail("CALIBRATE_Z")


def test_an_offset_of_0_that_a_macro_sets_is_kept(start):
    code = "\n  SET_GCODE_OFFSET Z=0\n  Z_CALIBRATION_KEEP_OFFSET"
    printer = start(changes=section(offset_gcode=code)).homed()
    printer.run("SET_GCODE_OFFSET Z=-0.3")
    calibration(printer)
    assert printer.offset() == 0.0


def test_macros_of_the_document_keep_an_offset_for_later(start, tmp_path):
    document = ROOT / "docs" / "z_calibration.md"
    text = part(
        document.read_text(encoding="utf-8"), "Z_CALIBRATION_KEEP_OFFSET"
    )
    (lines,) = re.findall(r"```cfg\n(.*?)```", text, re.S)
    file = tmp_path / "keep.cfg"
    file.write_text(lines)
    printer = start(changes={f"include {file}": {}}).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    result, _ = calibration(printer)
    assert printer.offset() == pytest.approx(0.3)
    assert not printer.status("z_calibration")["valid"]
    printer.run("USE_MEASURED_OFFSET")
    assert printer.offset() == pytest.approx(result[-1], abs=1e-6)
    assert printer.status("z_calibration")["valid"]


# No number brings the nozzle closer to a bed that only seems to be low


@pytest.mark.parametrize(
    ("endstop", "hints"),
    [
        ("1.6", []),
        (
            "1.68",
            [
                "z position_endstop=1.680 - offset=0.240000 --> possible z"
                " position_endstop=1.440"
            ],
        ),
        (
            "0.84",
            [
                "the bed is 0.600 mm lower than position_endstop=0.840 says;"
                " check that the plate is on and how the probe is seated"
            ],
        ),
    ],
)
def test_hint_names_a_number_only_where_that_lifts_the_nozzle(
    start, endstop, hints
):
    changes = {"stepper_z": {"position_endstop": endstop}}
    lines = start(changes=changes).homed().run("CALIBRATE_Z")
    start_of = "// HINT: "
    found = [line for line in lines if line.startswith(start_of)]
    assert [line[len(start_of) :] for line in found] == hints


def test_hint_comes_once_until_the_offset_changes(start):
    changes = {"stepper_z": {"position_endstop": "1.9"}}
    printer = start(changes=changes).homed()

    def hints():
        return sum("HINT: " in line for line in printer.run("CALIBRATE_Z"))

    assert [hints(), hints()] == [1, 0]
    printer.machine.world.exchange_plate(0.1)
    assert [hints(), hints()] == [1, 0]
    # Small for once, and large again
    printer.machine.world.exchange_plate(-0.5)
    assert hints() == 0
    printer.machine.world.exchange_plate(0.1)
    assert hints() == 1


@pytest.mark.parametrize(
    ("low", "margins", "names"),
    [(-0.9, "-1, 0.8", True), (0.3, "-1, -0.5", False)],
)
def test_refused_offset_names_a_number_only_upwards(start, low, margins, names):
    endstop = PIN - BED - 0.06 - low
    changes = {
        "stepper_z": {"position_endstop": f"{endstop:.4f}"},
        **section(offset_margins=margins),
    }
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.1")
    text = printer.fail("CALIBRATE_Z")
    low, high = map(float, margins.split(","))
    assert f"is outside offset_margins {low:.3f} to {high:.3f} (probe=" in text
    assert ("try" in text) == names
    assert_unharmed(printer, 0.1)


# The room that a touch has


@pytest.mark.parametrize(
    ("axis", "own", "endstop", "told_of"),
    [
        # Klipper's own default, 0
        (None, None, "0", ("stepper_z", 0.0, -1.0)),
        ("-0.74", None, "-0.74", ("stepper_z", -0.74, -1.74)),
        ("1.56", None, "1.6", ("stepper_z", 1.56, 0.6)),
        ("-5", "1.7", "1.6", ("z_calibration", 1.7, 0.6)),
    ],
)
def test_position_min_that_leaves_no_room_is_refused(
    host, axis, own, endstop, told_of
):
    changes = {
        "stepper_z": {"position_min": axis, "position_endstop": endstop},
        **section(position_min=own),
    }
    name, value, wanted = told_of
    state, text = load(host, changes)
    assert state == "error"
    assert (
        f"Option 'position_min' in section '{name}': {value:.3f} leaves no"
        in text
    )
    assert f"position_endstop ({float(endstop):.3f})" in text
    assert f"set it to {wanted:.3f} or lower" in text


@pytest.mark.parametrize(
    ("position_min", "options", "is_told"),
    [
        ("1.55", {}, True),
        ("0.61", {}, True),
        ("0.6", {}, False),
        ("0.6", {"travel_margin": "1.1"}, True),
        ("-5", {"position_min": "1.2"}, True),
        # What the axis allows stays the last word
        ("-5", {"position_min": "-8", "travel_margin": "9"}, True),
        ("-5", {"travel_margin": "0.5"}, False),
        # What the result may be is another question
        ("-5", WIDE, False),
    ],
)
def test_position_min_with_little_room_is_told_and_named_at_the_touch(
    start, position_min, options, is_told
):
    changes = {
        "stepper_z": {"position_min": position_min},
        **section(**options),
    }
    printer = start(changes=changes)
    printer.session.require_ready()
    floor = max(float(position_min), float(options.get("position_min", -5)))
    name = "z_calibration" if floor == 1.2 else "stepper_z"
    wanted = PIN - float(options.get("travel_margin", 1.0))
    notes = told(printer, "the nozzle's touch ends at position_min")
    assert len(notes) == is_told
    if is_told:
        assert f"({floor:.3f}), only {PIN - floor:.3f} mm below" in notes[0]
        assert f"of section '{name}' to {wanted:.3f} or lower" in notes[0]
    printer.homed()
    printer.machine.break_down(Fault("stuck_open", site="nozzle_pin"))
    lowest = max(floor, wanted)
    printer.machine.tolerate("nozzle_pin", PIN - lowest + MICROSTEP)
    text = printer.fail("CALIBRATE_Z")
    assert f"(stopped at z={lowest:.3f}), expected a trigger at" in text
    # The switch may be dead, too: what to look at is as ever
    named = f"lowest point of this touch: position_min ({floor:.3f}) of section '{name}'"
    assert (named in text) == is_told
    assert "check nozzle_xy_position and the switch there" in text


def test_position_min_is_named_where_no_height_is_known(start):
    printer = start("separate_pin").homed()
    printer.machine.break_down(Fault("stuck_open", site="nozzle_pin"))
    printer.machine.tolerate("nozzle_pin", 8.0)
    text = printer.fail("CALIBRATE_Z")
    # The last touch begins at the top again
    assert "nozzle: the switch did not answer (stopped at z=-5.000)" in text
    assert (
        "the lowest point of this touch: position_min (-5.000) of section"
        " 'stepper_z'; home Z again" in text
    )


# The nozzle that does not meet its pin itself


def test_something_below_the_nozzle_is_refused_at_the_fast_touch(start):
    """A probe that sits where the nozzle is, attached before the nozzle's touch."""
    scene = SCENES["cartesian"]
    probe = replace(
        scene.world.mag_probe, x_offset=0.0, y_offset=0.0, body_drop=6.4
    )
    changes = {
        "probe": {"x_offset": "0", "y_offset": "0", "z_offset": "7"},
        **section(
            switch_xy_position="232, 20",
            start_gcode="ATTACH_PROBE",
            before_switch_gcode=None,
            probing_first_fast="True",
        ),
    }
    scene = scene.with_world(mag_probe=probe)
    printer = start(scene, changes=changes).homed()
    before = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    body = probe.body_drop
    assert (
        f"nozzle: triggered at z={0.5 + body:.3f}, {body:.1f} mm above" in text
    )
    assert "position_endstop (0.500)" in text
    assert "something hangs below the nozzle" in text
    assert touched_sites(printer, before) == ["body_pin"]
    assert_unharmed(printer)


def test_endstop_that_sticks_on_the_way_down_is_named(start):
    printer = start().homed()
    printer.run("G90\nG1 Z30 F900")
    fault = Fault("stuck_closed", signal="z_endstop", t=printer.now() + 2.5)
    printer.machine.break_down(fault)
    text = printer.fail("CALIBRATE_Z")
    assert "the Z endstop reads triggered where nothing should press" in text


@pytest.mark.parametrize(("higher", "is_refused"), [(2.9, False), (3.1, True)])
def test_a_longer_tool_is_no_probe(start, higher, is_refused):
    """Tools of a changer differ in length, by less than a probe hangs down."""
    changes = {"force_move": {"enable_force_move": "True"}, **section(**WIDE)}
    printer = start(changes=changes).homed()
    printer.run(f"G90\nG1 Z20\nSET_KINEMATIC_POSITION Z={20 + higher}")
    if is_refused:
        # Z was set since: that comes first
        text = printer.fail("CALIBRATE_Z")
        assert "3.1 mm above position_endstop (1.600), and Z was homed" in text
    else:
        result, _ = calibration(printer)
        assert result[2] == pytest.approx(PIN + higher, abs=MICROSTEP)


def test_lift_near_the_top_hides_no_error(start):
    """It would go 0.1 mm beyond position_max."""
    changes = {
        "force_move": {"enable_force_move": "True"},
        "stepper_z": {"position_max": "15", "homing_positive_dir": "False"},
    }
    printer = start(changes=changes).homed()
    printer.run("G90\nG1 Z4 F600\nM400\nSET_KINEMATIC_POSITION Z=14.5")
    text = printer.fail("CALIBRATE_Z")
    assert "10.5 mm above position_endstop (1.600), and Z was" in text


# Plastic that oozes

OOZES = "at 240 C plastic oozes out of the nozzle: heat it to about 150 C"


def oozing(start, target, rate=0.05, **options):
    """A homed printer with a nozzle as hot as that, out of which plastic comes."""
    scene = SCENES["voron"].with_world(ooze=OozeSpec(0.3, 0.3, rate))
    printer = start(heated(scene), changes=section(**options)).homed()
    printer.run(f"M104 S{target}")
    return printer


def test_hot_nozzle_is_told_where_its_touches_do_not_agree(start):
    printer = oozing(start, 240, samples_tolerance_retries="0")
    text = printer.fail("CALIBRATE_Z")
    assert "nozzle: samples differ by" in text and OOZES in text
    assert "clean the nozzle" not in text
    printer.run("M104 S150")
    text = printer.fail("CALIBRATE_Z")
    assert "clean the nozzle and check the switch for play" in text
    assert "oozes" not in text


@pytest.mark.parametrize(("target", "is_told"), [(180, 0), (181, 1)])
def test_warm_nozzle_is_none(start, target, is_told):
    printer = start(heated(SCENES["voron"])).homed()
    printer.run(f"M104 S{target}")
    for script in (
        *("CALIBRATE_Z", "CALIBRATE_Z_ACCURACY CYCLES=2"),
        *("PROBE_Z_ACCURACY", "Z_CALIBRATION_WAIT MAX=2"),
    ):
        lines = printer.run(script)
        assert sum("plastic oozes" in line for line in lines) == is_told


@pytest.mark.parametrize("site", ["body_pin", "probe_bed"])
def test_probe_whose_touches_differ_does_not_blame_the_nozzle(start, site):
    faults = [Fault("trigger_early", site=site, touch=2, mm=0.1)]
    changes = section(samples_tolerance_retries="0")
    printer = start(changes=changes, faults=faults).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "check how the probe is seated, and probe and Z axis for play" in (
        text
    )
