"""Commands of [z_calibration]: parameters, wrappers, results."""

from __future__ import annotations

import re
import statistics
from dataclasses import replace

import pytest

from tools.kit.cases import slow
from tools.kit.dockable_probe import SWITCH
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    MICROSTEP,
    PIN,
    SAVE,
    assert_unharmed,
    calibration,
    pending,
    section,
    touched_sites,
)

# Behind the bed, where the probe has nothing to stand on
BESIDE = "G1 Z20 F900\nG1 X20 Y305 F6000\nG1 Z5 F900"

CALCULATE = "CALCULATE_SWITCH_OFFSET"

# CALIBRATE_Z


@pytest.mark.parametrize(("own", "given"), [(0.44, 0.0), (0.0, 0.54)])
def test_switch_offset_of_the_command(start, own, given):
    printer = start(changes=section(switch_offset=str(own))).homed()
    result, _ = calibration(printer, f"CALIBRATE_Z SWITCH_OFFSET={given}")
    assert result[3] == given
    assert printer.gap() == pytest.approx(0.5 - given, abs=2 * MICROSTEP)
    # For that run only
    result, _ = calibration(printer)
    assert result[3] == own


def test_macro_around_the_command(start):
    changes = {
        "gcode_macro CALIBRATE_Z": {
            "rename_existing": "BASE_CALIBRATE_Z",
            "gcode": "\n  G28\n  BASE_CALIBRATE_Z {rawparams}\n  G1 X20 F6000",
        }
    }
    printer = start(changes=changes)
    printer.session.require_ready()
    # As every host takes parameters
    result, _ = calibration(printer, "calibrate_z switch_offset=0.5")
    assert result[3] == 0.5
    assert printer.offset() == pytest.approx(result[-1], abs=1e-6)


GROWTH = "Z_CALIBRATION_NOZZLE_GROWTH"
NO_PAIR = "has to be X and Y in mm, such as 100,100"
WRONG = [
    *((f"CALIBRATE_Z NOZZLE_POSITION={xy}", NO_PAIR) for xy in ("1", "1,2,3")),
    ("CALIBRATE_Z SWITCH_POSITION=a,b", f"SWITCH_POSITION {NO_PAIR}"),
    ("CALIBRATE_Z BED_POSITION=nan,1", f"BED_POSITION {NO_PAIR}"),
    (
        "CALIBRATE_Z SWITCH_OFFSET=-0.1",
        "SWITCH_OFFSET is -0.1, and cannot be negative: the plunger triggers below",
    ),
    ("CALIBRATE_Z SWITCH_OFFSET=1e5", "SWITCH_OFFSET has to be 10000 at most"),
    ("CALIBRATE_Z SWITCH_OFFSET=x", "SWITCH_OFFSET=x"),
    ("CALIBRATE_Z SWITCH_OFFSET=nan", "SWITCH_OFFSET"),
    (
        "CALIBRATE_Z NOZZLE_POSITION=301,10",
        "z_calibration: NOZZLE_POSITION=301,10 needs the toolhead at X=301.000",
    ),
    (
        "CALIBRATE_Z SWITCH_POSITION=1,311",
        "z_calibration: SWITCH_POSITION=1,311 needs the toolhead at Y=311.000",
    ),
    (
        "CALIBRATE_Z BED_POSITION=1,20",
        "z_calibration: BED_POSITION=1,20 needs the toolhead at Y=-4.750",
    ),
    ("CALIBRATE_Z SAMPLES=0", "SAMPLES"),
    ("CALIBRATE_Z SAMPLES=some", "SAMPLES=some"),
    ("CALIBRATE_Z SAMPLES=1001", "SAMPLES must have maximum of 1000"),
    ("PROBE_Z_ACCURACY SAMPLES=1001", "SAMPLES must have maximum of 1000"),
    ("CALIBRATE_Z SAMPLES_TOLERANCE_RETRIES=1001", "maximum of 1000"),
    (
        "CALIBRATE_Z PROBE_SPEED=1e-5",
        "PROBE_SPEED has to be 0.01 mm/s at least, and is 1e-05",
    ),
    (
        "CALIBRATE_Z LIFT_SPEED=1e308",
        "LIFT_SPEED has to be 1000000 at most, and is 1e+308",
    ),
    ("CALIBRATE_Z SAMPLES_TOLERANCE=-1", "SAMPLES_TOLERANCE"),
    ("CALIBRATE_Z SAMPLES_TOLERANCE_RETRIES=x", "SAMPLES_TOLERANCE_RETRIES=x"),
    ("CALIBRATE_Z SAMPLES_RESULT=none", "SAMPLES_RESULT"),
    ("CALIBRATE_Z PROBE_SPEED=nan", "PROBE_SPEED"),
    ("CALIBRATE_Z LIFT_SPEED=0", "LIFT_SPEED"),
    ("CALIBRATE_Z SAMPLE_RETRACT_DIST=0", "SAMPLE_RETRACT_DIST"),
    ("PROBE_Z_ACCURACY SAMPLES=0", "SAMPLES"),
    ("PROBE_Z_ACCURACY SAMPLES=1.5", "SAMPLES=1.5"),
    ("PROBE_Z_ACCURACY PROBE_SPEED=0", "PROBE_SPEED"),
    ("PROBE_Z_ACCURACY PROBE_SPEED=inf", "PROBE_SPEED"),
    ("PROBE_Z_ACCURACY LIFT_SPEED=-1", "LIFT_SPEED"),
    ("PROBE_Z_ACCURACY SAMPLE_RETRACT_DIST=0", "SAMPLE_RETRACT_DIST"),
    ("PROBE_Z_ACCURACY NOZZLE_POSITION=1", f"NOZZLE_POSITION {NO_PAIR}"),
    (
        "PROBE_Z_ACCURACY NOZZLE_POSITION=1,311",
        "NOZZLE_POSITION=1,311 needs the toolhead",
    ),
    ("Z_CALIBRATION_WAIT LIMIT=0", "LIMIT"),
    ("Z_CALIBRATION_WAIT LIMIT=some", "LIMIT=some"),
    ("Z_CALIBRATION_WAIT MAX=1.9", "MAX must have minimum of 2.0"),
    ("Z_CALIBRATION_WAIT MAX=121", "MAX must have maximum of 120.0"),
    ("CALCULATE_SWITCH_OFFSET SWITCH_OFFSET=-1", "SWITCH_OFFSET"),
    (f"{SAVE} SAVE=often", "SAVE=often"),
    (f"{SAVE} FORCE=x", "FORCE=x"),
    *((f"CALIBRATE_Z Z_ADJUST={mm}", "Z_ADJUST") for mm in (0.51, -0.51)),
    ("CALIBRATE_Z Z_ADJUST=nan", "Z_ADJUST"),
    # The body of the probe would press the pin again
    *(
        (f"CALIBRATE_Z {place}", "mm from where it touches the switch")
        for place in ("BED_POSITION=209.5,306", "SWITCH_POSITION=152,125.25")
    ),
    ("CALIBRATE_Z EXTRUDER_TEMP=99", "EXTRUDER_TEMP must have minimum of 100"),
    ("CALIBRATE_Z EXTRUDER_TEMP=501", "EXTRUDER_TEMP must have maximum of 500"),
    ("CALIBRATE_Z EXTRUDER_TEMP=hot", "EXTRUDER_TEMP=hot"),
    ("CALIBRATE_Z EXTRUDER_TEMP=250", "EXTRUDER_TEMP needs nozzle_growth"),
    *(
        (f"{GROWTH} TEMPS={temps}", words)
        for temps, words in (
            ("60,110,181", "from hotter nozzles plastic oozes"),
            ("49,110,160", "50 to 180 C"),
            ("60,nan,160", "50 to 180 C"),
            ("60,160", "three temperatures or more: two make no line"),
            ("60,160,60", "three temperatures or more: two make no line"),
            ("60,79,160", "20 C apart, each from the one before"),
            ("60,warm,160", "temperatures in C, such as 60,110,160"),
        )
    ),
    (GROWTH, "this printer has no extruder"),
    *(
        (f"CALIBRATE_Z_ACCURACY {parameters}", words)
        for parameters, words in (
            ("CYCLES=1", "CYCLES must have minimum of 2"),
            ("CYCLES=many", "CYCLES=many"),
            ("CYCLES=201", "CYCLES must have maximum of 200"),
        )
    ),
]


@pytest.mark.parametrize("name", ["SAMPLES", "LIFT_SPEED", "BED_POSITION"])
def test_long_parameter_is_quoted_in_part(host, calibrated, name):
    text = calibrated(host).fail(f"CALIBRATE_Z {name}={'x' * 5000}")
    assert f"'CALIBRATE_Z {name}=xxx" in text
    assert "..." in text and len(text.strip()) < 250


@pytest.mark.parametrize(
    ("scene", "begin", "answer"),
    [
        ("voron", "Z_CALIBRATION_SETUP", "STEP"),
        slow("voron", "Z_CALIBRATION_SETUP STEP=PIN", "ANSWER"),
        slow(SWITCH, "DOCKABLE_PROBE_SETUP", "STEP"),
        (
            "membrane",
            "EXTRA_PROBE_CALIBRATE PROBE=membrane",
            "EXTRA_PROBE_CONTINUE PROBE=membrane QUESTION",
        ),
    ],
)
def test_long_answer_to_a_dialog_is_quoted_in_part(start, scene, begin, answer):
    printer = start(scene).homed()
    printer.run(begin.split(" STEP")[0])
    command = "" if answer.startswith("EXTRA") else f"{begin} "
    text = printer.fail(f"{command}{answer}={'x' * 5000}")
    assert f"{answer.split()[-1]}=xxx".upper() in text.upper()
    assert "..." in text and len(text.strip()) < 250


@pytest.mark.parametrize(("script", "words"), WRONG)
def test_parameter_that_makes_no_sense(host, calibrated, script, words):
    printer = calibrated(host)
    before = len(printer.machine.truth.touches)
    text = printer.fail(script)
    # Some are the host's own sentences
    assert words in text
    assert text.startswith(("z_calibration: ", f"Error on '{script}': "))
    assert touched_sites(printer, before) == []
    assert pending(printer) == {}
    assert printer.session.state()[0] == "ready"


def test_blank_parameter_counts_as_not_given(start):
    # Macros pass them on: NOZZLE_POSITION={params.NOZZLE_POSITION}
    printer = start().homed()
    plain, _ = calibration(printer)
    names = ("NOZZLE_POSITION", "SWITCH_POSITION", "BED_POSITION")
    blank = "= ".join((*names, "SWITCH_OFFSET="))
    assert calibration(printer, f"CALIBRATE_Z {blank}")[0] == plain
    plain = printer.run("PROBE_Z_ACCURACY")
    blank = "SAMPLES= PROBE_SPEED= LIFT_SPEED= SAMPLE_RETRACT_DIST="
    assert printer.run(f"PROBE_Z_ACCURACY {blank}") == plain


# PROBE_Z_ACCURACY

ACCURACY = re.compile(
    r"probe z accuracy results: maximum (\S+), minimum (\S+), range (\S+),"
    r" average (\S+), median (\S+), standard deviation (\S+)"
)


def accuracy(lines):
    """The six figures, in the order of the line."""
    (found,) = [m for m in map(ACCURACY.search, lines) if m]
    return tuple(map(float, found.groups()))


def heights(lines):
    """Every single touch."""
    return [
        float(line.split("touched at z=")[1])
        for line in lines
        if "touched at z=" in line
    ]


def noisy():
    """The voron with a pin that is not quite exact."""
    scene = SCENES["voron"]
    noise = replace(scene.world.pin.noise, sigma=0.01)
    return scene.with_world(pin=replace(scene.world.pin, noise=noise))


@pytest.mark.parametrize(
    ("script", "places"),
    [
        ("CALIBRATE_Z", ["nozzle", "switch", "bed"]),
        ("PROBE_Z_ACCURACY SAMPLES=3", []),
        ("CALIBRATE_Z_ACCURACY CYCLES=2", []),
    ],
)
def test_single_touches_are_told_on_request(start, script, places):
    """One line a place, or a cycle; klippy.log has each touch, always."""
    printer = start().homed()
    lines = printer.run(script)
    assert heights(lines) == []
    found = [
        m[1]
        for line in lines
        if (
            m := re.search(
                r"(\w+) at z=[\d.]+ \(3 touches, 0.000 mm apart", line
            )
        )
    ]
    assert found == places
    cycles = [line for line in lines if ": cycle " in line]
    assert len(cycles) == (2 if "CYCLES" in script else 0)
    for number, line in enumerate(cycles, 1):
        assert line == (
            f"// z_calibration: cycle {number}: nozzle at z=1.600, switch at"
            " z=8.015, bed at z=7.015, offset=0.160"
        )
    touches = len(touched_sites(printer)) - 2
    assert printer.session.log().count(": touched at z=") == touches - (
        touches % 3
    )
    assert len(heights(printer.run(f"{script} VERBOSE=1"))) >= 3
    # Of that command
    assert heights(printer.run(script)) == []
    assert "VERBOSE" in printer.fail(f"{script} VERBOSE=2")


def test_accuracy_figures_are_those_of_the_touches(start):
    printer = start(noisy(), seed=3).homed()
    lines = printer.run("PROBE_Z_ACCURACY SAMPLES=6 VERBOSE=1")
    z = heights(lines)
    assert len(z) == 6
    assert max(z) - min(z) > 0.01
    expected = (
        max(z),
        min(z),
        max(z) - min(z),
        statistics.fmean(z),
        statistics.median(z),
        statistics.pstdev(z),
    )
    assert accuracy(lines) == pytest.approx(expected, abs=2e-6)
    assert statistics.fmean(z) == pytest.approx(PIN, abs=0.02)
    assert_unharmed(printer)
    # It measures, nothing else
    assert printer.status("z_calibration")["last_query"] is False


def test_accuracy_uses_the_settings_of_the_module(start):
    changes = section(samples="5", probing_retract_dist="2.5", lift_speed="7")
    printer = start(changes=changes).homed()
    for params, place in (
        ("", (206.0, 306.0)),
        ("NOZZLE_POSITION=205,307", (205.0, 307.0)),
    ):
        lines = printer.run(f"PROBE_Z_ACCURACY VERBOSE=1 {params}")
        assert (
            "// PROBE_Z_ACCURACY at X:%.3f Y:%.3f (samples=5 retract=2.500"
            " speed=3.0 lift_speed=7.0)" % place
        ) in lines
        assert len(heights(lines)) == 5
        touch = printer.machine.truth.touches[-1]
        assert touch.site == "nozzle_pin"
        assert (touch.x, touch.y) == pytest.approx(place, abs=0.02)


def spacing(printer, params):
    """Seconds between two touches of PROBE_Z_ACCURACY."""
    before = len(printer.machine.truth.touches)
    printer.run(f"PROBE_Z_ACCURACY SAMPLES=2 {params}")
    first, second = printer.machine.truth.touches[before:]
    return second.t - first.t


def test_accuracy_parameters(start):
    # 3 mm up at 10 and down at 3 mm/s
    printer = start().homed()
    usual = spacing(printer, "")
    for params, more in (
        ("PROBE_SPEED=1", 3 / 1 - 3 / 3),
        ("LIFT_SPEED=2", 3 / 2 - 3 / 10),
        ("SAMPLE_RETRACT_DIST=5", 2 / 10 + 2 / 3),
        ("sample_retract_dist=5", 2 / 10 + 2 / 3),
    ):
        changed = spacing(printer, params)
        assert changed - usual == pytest.approx(more, abs=0.2), params


# CALCULATE_SWITCH_OFFSET


def test_new_switch_offset_gives_the_gap_that_was_wanted(start):
    # 0.06 mm are between nozzle and bed at Z=0; 0.1 is wanted
    printer = start().homed()
    calibration(printer)
    printer.run(f"{BESIDE}\nG1 Z0.04 F300\nM400")
    lines = printer.run("CALCULATE_SWITCH_OFFSET")
    assert lines == [
        "// z_calibration: switch_offset=0.440 - (current_z=0.200 -"
        " z_offset=0.160) --> new switch_offset=0.400"
    ]
    printer.run("G1 Z20 F900")
    calibration(printer, "CALIBRATE_Z SWITCH_OFFSET=0.4")
    assert printer.gap() == pytest.approx(0.1, abs=2 * MICROSTEP)


def test_new_switch_offset_starts_from_the_one_that_was_used(start):
    printer = start().homed()
    calibration(printer, "CALIBRATE_Z SWITCH_OFFSET=0.5")
    printer.run(f"{BESIDE}\nG1 Z0 F300\nM400")
    (line,) = printer.run("CALCULATE_SWITCH_OFFSET")
    assert line.endswith("--> new switch_offset=0.500")
    (line,) = printer.run("CALCULATE_SWITCH_OFFSET SWITCH_OFFSET=0.6")
    assert line.endswith("--> new switch_offset=0.600")
    # Nothing is changed by it
    assert pending(printer) == {}


def test_save_writes_the_option(start):
    printer = start().homed()
    calibration(printer)
    printer.run(f"{BESIDE}\nG1 Z0.04 F300\nM400")
    assert "SAVE=often" in printer.fail("CALCULATE_SWITCH_OFFSET SAVE=often")
    assert pending(printer) == {}
    lines = printer.run("CALCULATE_SWITCH_OFFSET SAVE=1")
    assert "SAVE_CONFIG" in "\n".join(lines)
    assert printer.status("configfile")["save_config_pending"] is True
    assert pending(printer) == {"z_calibration": {"switch_offset": "0.400"}}


FIRST = "run CALIBRATE_Z first, then move the nozzle to where Z=0 should be"
STEPS = "baby steps count from the last CALIBRATE_Z; run it, then correct the"


@pytest.mark.parametrize(
    ("script", "reason", "after"),
    [
        ("", "not calibrated yet", {CALCULATE: FIRST, SAVE: STEPS}),
        (
            "CALIBRATE_Z\nG28 Z",
            *("Z was homed again", {CALCULATE: FIRST, SAVE: STEPS}),
        ),
        # Baby steps may still be saved after a print
        (
            "CALIBRATE_Z\nM84",
            *("the motors were turned off", {CALCULATE: FIRST}),
        ),
        ("CALIBRATE_Z\nG28 Z\nM84", "Z was homed again", {SAVE: STEPS}),
    ],
)
def test_new_switch_offset_needs_a_result_that_holds(
    start, script, reason, after
):
    printer = start().homed()
    printer.run(script)
    printer.run("SET_GCODE_OFFSET Z_ADJUST=0.02")
    for command, words in after.items():
        text = printer.fail(f"{command} SAVE=1")
        assert text.startswith(f"z_calibration: {reason}; {words}")
    assert pending(printer) == {}


def test_switch_offset_cannot_become_negative(start):
    printer = start().homed()
    calibration(printer)
    printer.run(f"{BESIDE}\nM400")
    text = printer.fail("CALCULATE_SWITCH_OFFSET SAVE=1")
    assert "new switch_offset=-4.560, which cannot be negative" in text
    assert printer.status("configfile")["save_config_pending"] is False
