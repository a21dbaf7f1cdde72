"""CALIBRATE_Z where Klipper's own features shift Z: the gap, and what is told."""

from __future__ import annotations

import pytest

from tools.kit.z_calibration import MICROSTEP, result_of

# What is between nozzle and bed at Z=0 after a perfect calibration
GAP = 0.06
POINT = (150.0, 150.0)
MESH = {
    "mesh_min": "40, 40",
    "mesh_max": "250, 250",
    "probe_count": "3, 3",
    "speed": "200",
    "horizontal_move_z": "12",
}
# It is as high as that (mm) from the front to the back, 105 mm apart
SLOPE = (-0.10, 0.05, 0.20)


def mesh(heights=SLOPE, **options):
    """[bed_mesh] with a profile `default`, of heights from front to back."""
    profile = {
        "version": "1",
        "points": "".join(f"\n  {z}, {z}, {z}" for z in heights),
        "algo": "lagrange",
        "tension": "0.2",
        "mesh_x_pps": "2",
        "mesh_y_pps": "2",
        "x_count": "3",
        "y_count": "3",
        "min_x": "40",
        "min_y": "40",
        "max_x": "250",
        "max_y": "250",
    }
    return {"bed_mesh": {**MESH, **options}, "bed_mesh default": profile}


LOAD = "BED_MESH_PROFILE LOAD=default"


# The probe hangs below the head, up to here a mesh of FADING does not fade.
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


def validity(printer):
    status = printer.status("z_calibration")
    return status["measured"], status["valid"], status["reason"]


# Taken off


@pytest.mark.every_host
@pytest.mark.parametrize("error", [0.7, -0.7])
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


@pytest.mark.every_host
@pytest.mark.parametrize(
    ("changes", "script", "point", "told"),
    [
        (mesh(), LOAD, POINT, "bed_mesh is 0.057 mm at 150.0, 150.0"),
        (mesh(), LOAD, (100, 100), "bed_mesh is -0.014 mm at 100.0, 100.0"),
        # Nothing up where the head travels
        (mesh(**FADING), LOAD, POINT, "bed_mesh is 0.057 mm at"),
        (
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


@pytest.mark.every_host
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
