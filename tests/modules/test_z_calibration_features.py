"""CALIBRATE_Z where Klipper's own features shift Z: the gap, and what is told."""

from __future__ import annotations

import pytest

from tools.kit.cases import slow
from tools.kit.klipper_sections import bed_mesh, profile
from tools.kit.z_calibration import (
    LIFT,
    MICROSTEP,
    SAVE,
    kept_runs,
    result_of,
    validity,
    with_extra,
)

# What is between nozzle and bed at Z=0 after a perfect calibration
GAP = 0.06
POINT = (150.0, 150.0)
MESH = bed_mesh("40, 40", "250, 250")
# It is as high as that (mm) from the front to the back, 105 mm apart
SLOPE = (-0.10, 0.05, 0.20)


def mesh(heights=SLOPE, **options):
    """[bed_mesh] with a profile `default`, of heights from front to back."""
    own = {**MESH, **options}
    return {"bed_mesh": own, "bed_mesh default": profile(heights, own)}


LOAD = "BED_MESH_PROFILE LOAD=default"
# The probe hangs below the toolhead, up to here a mesh of FADING does not fade.
NEAR = 9.0
FADING = {"fade_start": "9.5", "fade_end": "12", "fade_target": "0"}


def gap_near(printer, xy=POINT, z=NEAR):
    """As printer.gap(), from a height at which a mesh does not fade."""
    x, y = xy
    printer.run(f"G90\nG1 Z20 F900\nG1 X{x} Y{y} F6000\nG1 Z{z} F900\nM400")
    printer.session.wait(0.5)
    gap = printer.machine.gap_at_zero(z, xy)
    printer.run("G1 Z20 F900")
    return gap


def assert_right(printer, gap=GAP, xy=POINT):
    """The true gap at Z=0 over that point."""
    assert gap_near(printer, xy) == pytest.approx(gap, abs=2 * MICROSTEP)


# Taken off


@pytest.mark.parametrize("error", [0.7, slow(-0.7)])
def test_mesh_of_a_probe_with_a_wrong_z_offset(start, error):
    changes = {"bed_mesh": MESH, "probe": {"z_offset": f"{6.9 + error}"}}
    printer = start(changes=changes).homed()
    lines = printer.run("BED_MESH_CALIBRATE\nCALIBRATE_Z")
    assert_right(printer)
    (told,) = [line for line in lines if "z_calibration: bed_mesh is" in line]
    assert "mm at 150.0, 150.0, where the bed was measured: taken off" in told
    assert "set zero_reference_position of section 'bed_mesh'" in told
    status = printer.status("z_calibration")
    assert [f"// z_calibration: {text}" for text in status["warnings"]] == [
        told
    ]
    shift = float(told.split()[4])
    offset = result_of(lines)[-1] - shift
    assert abs(shift) > 0.5
    # The line of the result is what was measured, in the frame of Z
    assert status["last_z_offset"] == pytest.approx(offset, abs=0.001)
    assert printer.offset() == pytest.approx(offset, abs=0.001)


TILT = {"x_adjust": "0.001", "y_adjust": "-0.0002", "z_adjust": "0.03"}


@pytest.mark.parametrize(
    ("changes", "script", "point", "told"),
    [
        (mesh(), LOAD, POINT, "bed_mesh is 0.057 mm at 150.0, 150.0"),
        slow(mesh(), LOAD, (100, 100), "bed_mesh is -0.014 mm at 100.0, 100.0"),
        # Nothing up where the toolhead travels
        (mesh(**FADING), LOAD, POINT, "bed_mesh is 0.057 mm at"),
        slow(
            mesh(),
            f"{LOAD}\nBED_MESH_OFFSET Y=30",
            POINT,
            "bed_mesh is 0.100 mm at",
        ),
        ({"bed_tilt": TILT}, "", POINT, "bed_tilt shifts Z by 0.150 mm there"),
    ],
)
def test_shift_is_taken_off_where_the_bed_is_measured(
    start, changes, script, point, told
):
    printer = start(changes=changes).homed()
    printer.run(script)
    x, y = point
    lines = printer.run(f"CALIBRATE_Z BED_POSITION={x},{y}")
    assert_right(printer, xy=point)
    assert told in "\n".join(lines)


class Frame:
    """Its thermometer, as a file that [temperature_host] reads."""

    def __init__(self, folder):
        self.path = folder / "temp"
        self.set(25.0)

    def set(self, celsius):
        self.path.write_text(f"{celsius * 1000:.0f}")

    def section(self, name="z_thermal_adjust"):
        return {
            name: {
                "temp_coeff": "0.002",
                "sensor_type": "temperature_host",
                "sensor_path": str(self.path),
                "min_temp": "0",
                "max_temp": "100",
                "smooth_time": "1",
            }
        }

    def heat(self, printer, celsius):
        self.set(celsius)
        printer.session.wait(30.0)


@pytest.mark.slow
@pytest.mark.parametrize("has_mesh", [False, True])
def test_heat_is_taken_off_once_and_goes_on(start, tmp_path, has_mesh):
    frame = Frame(tmp_path)
    printer = start(changes={**frame.section(), **(mesh() if has_mesh else {})})
    printer.session.require_ready()
    printer.session.wait(30.0)
    printer.homed()
    if has_mesh:
        printer.run(LOAD)
    frame.heat(printer, 75.0)
    lines = printer.run("CALIBRATE_Z")
    told = "z_thermal_adjust shifts Z by -0.100 mm there now: taken off"
    assert told in "\n".join(lines)
    assert_right(printer)
    assert told in printer.status("z_calibration")["warnings"]
    # From here on as ever: 10 K more are 0.02 mm
    frame.heat(printer, 85.0)
    printer.run("G1 X20 F6000")
    assert_right(printer, GAP - 0.02)
    assert validity(printer) == (True, True, "")


@pytest.mark.slow
@pytest.mark.parametrize("change", ["REF_TEMP=75", "TEMP_COEFF=0"])
def test_heat_that_is_set_anew_is_noticed(start, tmp_path, change):
    frame = Frame(tmp_path)
    printer = start(changes=frame.section())
    printer.session.require_ready()
    printer.session.wait(30.0)
    printer.homed()
    frame.heat(printer, 75.0)
    printer.run("CALIBRATE_Z\nSET_Z_THERMAL_ADJUST")
    assert validity(printer) == (True, True, "")
    printer.run(f"SET_Z_THERMAL_ADJUST {change}")
    told = "SET_Z_THERMAL_ADJUST has moved Z=0 by 0.100 mm since CALIBRATE_Z"
    assert validity(printer)[:2] == (False, False)
    assert told in validity(printer)[2]
    assert told in printer.fail(SAVE)
    printer.run("CALIBRATE_Z")
    assert validity(printer) == (True, True, "")
    assert_right(printer)


@pytest.mark.slow
@pytest.mark.parametrize("celsius", [25.0, 75.0])
def test_heat_that_is_turned_off_and_on_has_moved_nothing(
    start, tmp_path, celsius
):
    """Macros turn it on after CALIBRATE_Z and off in PRINT_END: the shift stays."""
    frame = Frame(tmp_path)
    printer = start(changes=frame.section())
    printer.session.require_ready()
    printer.session.wait(30.0)
    printer.homed()
    printer.run("SET_Z_THERMAL_ADJUST ENABLE=0")
    frame.heat(printer, celsius)
    printer.run("CALIBRATE_Z")
    assert_right(printer)
    for is_on in (1, 0, 1):
        printer.run(f"SET_Z_THERMAL_ADJUST ENABLE={is_on}")
        assert validity(printer) == (True, True, "")
        printer.run("G1 X20 F6000\nG1 X30 F6000")
        assert_right(printer)
    printer.run(f"SET_GCODE_OFFSET Z_ADJUST=0.02\n{SAVE} SAVE=0")
    # While it is off the reference moves nothing; when it is on it does
    printer.run("SET_Z_THERMAL_ADJUST ENABLE=0 REF_TEMP=0")
    assert validity(printer) == (True, True, "")
    printer.run("SET_Z_THERMAL_ADJUST ENABLE=1")
    assert "has moved Z=0 by -0.050 mm" in validity(printer)[2]


@pytest.mark.slow
def test_heat_that_counts_below_a_height_only_is_asked_for_there(
    start, tmp_path
):
    """Where the toolhead travels nothing has changed since homing."""
    frame = Frame(tmp_path)
    changes = frame.section()
    changes["z_thermal_adjust"]["z_adjust_off_above"] = "5"
    printer = start(changes=changes)
    printer.session.require_ready()
    printer.session.wait(30.0)
    printer.homed()
    frame.heat(printer, 75.0)
    lines = printer.run("CALIBRATE_Z")
    told = "z_thermal_adjust shifts Z by -0.100 mm there now: taken off"
    assert told in "\n".join(lines)
    assert "another feature" not in "\n".join(lines)
    assert_right(printer)


# Left alone, and told


@pytest.mark.slow
def test_what_is_the_same_over_pin_and_bed_is_taken_off(start, tmp_path):
    modules = with_extra(tmp_path, LIFT % ("True",))
    printer = start(changes={"extra": {}, **mesh()}, modules=modules).homed()
    lines = printer.run(f"{LOAD}\nCALIBRATE_Z")
    text = "another feature shifts Z by 0.120 mm, over the pin and over the bed"
    assert text in "\n".join(lines)
    assert_right(printer)
    warnings = printer.status("z_calibration")["warnings"]
    assert sum(text in warning for warning in warnings) == 1
    # None of them is about the touches
    (run,) = kept_runs(printer)
    told = [(w["about"], w["text"]) for w in run["warnings"]]
    assert told == list(zip(("bed_mesh", "another"), warnings))


def test_what_differs_over_pin_and_bed_is_refused(start, tmp_path):
    modules = with_extra(tmp_path, LIFT % ("position[1] > 200.0",))
    printer = start(changes={"extra": {}}, modules=modules).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "0.120 mm over the pin and by 0.000 mm over the bed" in text
    assert text.endswith("turn it off before CALIBRATE_Z")
    assert printer.offset() == 0.0


# Until it changes


def test_switch_offset_is_calculated_over_the_mesh_only(start):
    """Beyond it Z holds the height of its rim."""
    changes = mesh(zero_reference_position="150, 150")
    printer = start(changes=changes).homed()
    printer.run("BED_MESH_CALIBRATE MESH_MIN=20,50 MESH_MAX=90,250")
    printer.run("CALIBRATE_Z")
    assert validity(printer) == (True, True, "")
    text = printer.fail("G1 X150 Y150 Z1 F6000\nCALCULATE_SWITCH_OFFSET SAVE=1")
    assert "the bed mesh ends before X150.0 Y150.0" in text
    (line,) = printer.run(
        "G1 X80 Y150 F6000\nG1 Z0.05\nCALCULATE_SWITCH_OFFSET"
    )
    assert "new switch_offset=" in line


@pytest.mark.parametrize(
    ("before", "after", "is_other"),
    [
        slow("", LOAD, True),
        (LOAD, "BED_MESH_CLEAR", True),
        slow(LOAD, "BED_MESH_OFFSET Y=30", True),
        (LOAD, LOAD, False),
        slow(LOAD, f"BED_MESH_CLEAR\n{LOAD}", False),
        # As high there by chance
        slow(LOAD, "BED_MESH_OFFSET X=30", False),
    ],
)
def test_result_ends_with_another_height_of_the_mesh(
    start, before, after, is_other
):
    printer = start(changes=mesh()).homed()
    printer.run(f"{before}\nCALIBRATE_Z")
    assert validity(printer) == (True, True, "")
    printer.run(after)
    is_measured, is_valid, reason = validity(printer)
    assert (is_measured, is_valid) == (not is_other, not is_other)
    assert reason.startswith("bed_mesh is") is is_other
    assert ("mm at 150.0, 150.0 and was" in reason) is is_other
    if is_other:
        for command in ("CALCULATE_SWITCH_OFFSET", SAVE):
            assert "run that when the mesh is loaded" in printer.fail(command)
        # Until it is as it was, or measured again
        printer.run("CALIBRATE_Z")
        assert validity(printer) == (True, True, "")
    assert_right(printer)


@pytest.mark.slow
@pytest.mark.parametrize("changes", [mesh(), {"bed_tilt": TILT}])
def test_switch_offset_by_paper_needs_no_place_without_a_shift(start, changes):
    printer = start(changes=changes).homed()
    printer.run(f"{LOAD if 'bed_mesh' in changes else ''}\nCALIBRATE_Z")
    # Somewhere else, as high in the air as G-code says
    printer.run("G1 X100 Y100 Z20 F6000\nG1 Z10 F900\nM400")
    (answer,) = printer.run("CALCULATE_SWITCH_OFFSET SWITCH_OFFSET=20")
    assert answer.endswith("new switch_offset=10.000")
