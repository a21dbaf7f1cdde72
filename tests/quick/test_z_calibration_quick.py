"""A good and a bad run of every command of z_calibration."""

from __future__ import annotations

import pytest

from simprinter import heated
from tests.quick.runs import Run, go_well, go_wrong, ours, started
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import MICROSTEP, section

# It can heat its nozzle
HEATED = heated(SCENES["voron"])
# Of the host: what has moved the pin, and what end_gcode sets, is looked at
GUARDED = {"G28", "RESTORE_GCODE_STATE", "SET_GCODE_OFFSET"}
BESIDE = "G90\nG1 Z20 F900\nG1 X20 Y305 F6000\nG1 Z5 F900"


def has_report(printer):
    """Drawn by a process of its own, and reported when it is there."""
    for _ in range(60):
        if any("the report is" in line for line in printer.session.console):
            return True
        printer.session.wait(0.5)
    return False


GOOD = [
    Run("CALIBRATE_Z_ACCURACY CYCLES=2", "one CALIBRATE_Z: +-"),
    Run("PROBE_Z_ACCURACY SAMPLES=2", "maximum 1.60"),
    Run("Z_CALIBRATION_WAIT MAX=2", "it stands still after 2 minutes"),
    Run("Z_CALIBRATION_NOZZLE_GROWTH", "0.0000 mm longer for each 100 C"),
    Run("CALIBRATE_Z", "--> new offset=0.16"),
    Run(
        "SET_GCODE_OFFSET Z_ADJUST=0.02\nZ_OFFSET_APPLY_PROBE",
        "CALIBRATE_Z measures anew",
    ),
    Run("Z_CALIBRATION_SAVE_GCODE_OFFSET", "--> new switch_offset=0.420"),
    Run("Z_OFFSET_APPLY_ENDSTOP", "position_endstop"),
    Run(
        f"CALIBRATE_Z\n{BESIDE}\nG1 Z0.04 F300\nCALCULATE_SWITCH_OFFSET",
        "--> new switch_offset=0.3",
    ),
    Run("Z_CALIBRATION_REPORT", "", check=has_report),
    Run("G28\nZ_CALIBRATION_SETUP", "action:prompt_show"),
]
END = "Z_CALIBRATION_SETUP STEP=ABORT"


def pressed(printer):
    printer.machine.hold("z_endstop", True)


def let_go(printer):
    printer.machine.hold("z_endstop", None)


BAD = [
    Run("Z_CALIBRATION_KEEP_OFFSET", "belongs into offset_gcode"),
    Run("CALCULATE_SWITCH_OFFSET", "CALIBRATE_Z"),
    Run("Z_CALIBRATION_SAVE_GCODE_OFFSET", "CALIBRATE_Z"),
    Run("Z_CALIBRATION_REPORT", "'history' is none"),
    Run("Z_CALIBRATION_SETUP STEP=PIN", "no set-up is under way"),
    Run("CALIBRATE_Z", "nozzle: the Z endstop reads triggered", pressed),
    Run("CALIBRATE_Z_ACCURACY", "the Z endstop reads triggered"),
    Run("PROBE_Z_ACCURACY", "the Z endstop reads triggered"),
    Run("Z_CALIBRATION_WAIT", "the Z endstop reads triggered"),
    Run("Z_CALIBRATION_NOZZLE_GROWTH", "has no extruder"),
    Run("Z_OFFSET_APPLY_PROBE", "saves as ever", let_go, False),
    Run("Z_OFFSET_APPLY_ENDSTOP", "saves as ever", None, False),
]


@pytest.mark.every_host(
    "the least that each host has to do: every command once"
)
def test_good_run_of_every_command(start):
    printer = started(start, HEATED, {})
    # That one is for a macro in offset_gcode
    alone = {"Z_CALIBRATION_KEEP_OFFSET"}
    assert go_well(printer, GOOD) == ours(printer) - GUARDED - alone
    printer.run(END)
    # The baby step counts in each run that follows
    gap = printer.scene.formula_gap() + 0.02
    assert printer.gap() == pytest.approx(gap, abs=2 * MICROSTEP)


def test_bad_run_of_every_command(start):
    changes = section(history="none", save_button="switch_offset")
    printer = started(start, "voron", changes)
    assert go_wrong(printer, BAD) == ours(printer) - GUARDED
    assert printer.machine.truth.deepest_in_bed() == 0.0
