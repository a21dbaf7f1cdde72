"""A good and a bad run of every command of auto_z_offset."""

from __future__ import annotations

import pytest

from tests.quick.runs import Run, go_well, go_wrong, ours, started
from tools.kit.auto_z_offset import MICROSTEP, true_gap

# Of the host: baby steps that it loses are told, and where homing leaves Z is noted
GUARDED = {
    "AXIS_TWIST_COMPENSATION_CALIBRATE",
    "BED_MESH_CALIBRATE",
    "G28",
    "RESTORE_GCODE_STATE",
    "Z_OFFSET_APPLY_PROBE",
}
TWISTED = {
    "axis_twist_compensation": {
        "calibrate_start_x": "20",
        "calibrate_end_x": "225",
        "calibrate_y": "120",
    }
}
GOOD = [
    Run("AUTO_Z_PROBE", "the bed sensor triggered at z="),
    Run("AUTO_Z_MEASURE_OFFSET", "--> correction=-1.12"),
    Run("AUTO_Z_CALIBRATE", "probe_z_correction: -1.12"),
    Run("SET_GCODE_OFFSET Z=0\nAUTO_Z_LOAD_OFFSET", "G-code Z offset is -1.12"),
    Run("AUTO_Z_SAVE_GCODE_OFFSET", "probe_z_correction: -1.12"),
    Run("AUTO_Z_TWIST SAMPLE_COUNT=2", "along X: z_compensations: "),
    Run("AUTO_Z_WAIT MAX=2", "it stands still after 2 minutes"),
]
LAST = [
    Run("SET_GCODE_OFFSET Z=0\nAUTO_Z_HOME_Z", "which is z=0.200000 now"),
]


def triggered(printer):
    printer.machine.hold("bed_sensor", True)


def shifted(printer):
    printer.machine.hold("bed_sensor", None)
    printer.run("AUTO_Z_HOME_Z")


SENSOR = "bed sensor: reads triggered"
BAD = [
    Run("AUTO_Z_PROBE", SENSOR, triggered),
    Run("AUTO_Z_HOME_Z", SENSOR),
    Run("AUTO_Z_MEASURE_OFFSET", SENSOR),
    Run("AUTO_Z_CALIBRATE", SENSOR),
    Run("AUTO_Z_TWIST", SENSOR),
    Run("AUTO_Z_WAIT", SENSOR),
    # Z is no more what the probe says
    Run("AUTO_Z_LOAD_OFFSET", "G28", shifted),
    Run("AUTO_Z_SAVE_GCODE_OFFSET", "G28"),
]


@pytest.mark.every_host(
    "the least that each host has to do: every command once"
)
def test_good_run_of_every_command(start):
    printer = started(start, "qidi", TWISTED)
    done = go_well(printer, GOOD)
    wanted = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(wanted, abs=2 * MICROSTEP)
    assert done | go_well(printer, LAST) == ours(printer) - GUARDED


def test_bad_run_of_every_command(start):
    printer = started(start, "qidi", TWISTED)
    assert go_wrong(printer, BAD) == ours(printer) - GUARDED
