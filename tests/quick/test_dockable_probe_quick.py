"""A good and a bad run of every command of dockable_probe, and of PROBE."""

from __future__ import annotations

import pytest

from simprinter import Fault
from tests.quick.runs import Run, go_well, go_wrong, ours, started
from tools.kit.dockable_probe import GANTRY, HANG, QUICK, section, where

# Of the host, with our look at the probe in front: test_z_touch_carrying.py
GUARDED = {
    "AXIS_TWIST_COMPENSATION_CALIBRATE",
    "BED_MESH_CALIBRATE",
    "BED_SCREWS_ADJUST",
    "BED_TILT_CALIBRATE",
    "DELTA_CALIBRATE",
    "G28",
    "M18",
    "M24",
    "M84",
    "MANUAL_PROBE",
    "PROBE",
    "PROBE_ACCURACY",
    "PROBE_CALIBRATE",
    "QUAD_GANTRY_LEVEL",
    "RESUME",
    "SAVE_CONFIG",
    "SCREWS_TILT_CALCULATE",
    "Z_ENDSTOP_CALIBRATE",
    "Z_TILT_ADJUST",
    "Z_TILT_AUTODETECT",
    "Z_TILT_CALIBRATE",
}


def place_of(option):
    x, y = GANTRY.sections["dockable_probe"][f"{option}_position"].split(",")
    return float(x), float(y)


DOCK, DETACH = place_of("dock"), place_of("detach")
# Out of the dock as into it
APPROACH = EXTRACT = INSERT = place_of("approach")


def is_at(place):
    return lambda printer: (
        printer.session.position()[:2] == pytest.approx(list(place))
    )


def is_there(place):
    return lambda printer: where(printer) == place


def is_not_automatic(printer):
    return not printer.status("dockable_probe")["auto_attach_detach"]


GOOD = [
    Run("GET_PROBE_STATUS", "Probe Status: DOCKED"),
    Run("QUERY_DOCKABLE_PROBE", "Probe Status: DOCKED"),
    Run("MOVE_AVOIDING_DOCK X=150 Y=140", "", check=is_at((150.0, 140.0))),
    Run("PROBE", "Result", check=is_there("docked")),
    Run("ATTACH_PROBE", "", check=is_there("attached")),
    Run("SET_PROBE_STATUS STATE=ATTACHED", ""),
    Run("MOVE_TO_INSERT_PROBE", "", check=is_at(INSERT)),
    Run("MOVE_TO_DOCK_PROBE", "", check=is_at(DOCK)),
    Run("MOVE_TO_DETACH_PROBE", "", check=is_at(DETACH)),
    Run("MOVE_TO_APPROACH_PROBE", "", check=is_at(APPROACH)),
    Run("MOVE_TO_DOCK_PROBE", "", check=is_at(DOCK)),
    Run("MOVE_TO_EXTRACT_PROBE", "", check=is_at(EXTRACT)),
    Run("DETACH_PROBE", "", check=is_there("docked")),
    Run("SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0", "", check=is_not_automatic),
    # More in test_dockable_probe_setup.py
    Run("DOCKABLE_PROBE_SETUP", "Put the probe on the toolhead"),
]


def stuck_in_the_dock(printer):
    printer.machine.break_down(Fault("attach_fails", persistent=True))


def mended(printer):
    printer.machine.repair()
    printer.run("ATTACH_PROBE")
    printer.machine.break_down(Fault("dock_fails", persistent=True))


HOMED = "not homed"
BAD = [
    Run("DOCKABLE_PROBE_SETUP STEP=OUT", "no set-up is under way"),
    Run("PROBE", "was not fetched", stuck_in_the_dock),
    Run("ATTACH_PROBE", "was not fetched"),
    Run("DETACH_PROBE", "was not docked", mended),
    Run("GET_PROBE_STATUS", "Probe Status: ATTACHED", None, False),
    Run("QUERY_DOCKABLE_PROBE", "Probe Status: ATTACHED", None, False),
    Run("SET_PROBE_STATUS STATE=DOCKED", "put it there first"),
    Run("SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=2", "AUTO_ATTACH_DETACH"),
    *(
        Run(f"M84\n{command}", HOMED)
        for command in (
            "MOVE_AVOIDING_DOCK X=150 Y=150",
            "MOVE_TO_APPROACH_PROBE",
            "MOVE_TO_DOCK_PROBE",
            "MOVE_TO_EXTRACT_PROBE",
            "MOVE_TO_INSERT_PROBE",
            "MOVE_TO_DETACH_PROBE",
        )
    ),
]


# Hosts before 2023-08 do not know the section, and no command here needs it
WITHOUT_TWIST = {"axis_twist_compensation": None}


@pytest.mark.every_host(
    "the least that each host has to do: every command once"
)
def test_good_run_of_every_command(start):
    changes = {**section(**QUICK), **WITHOUT_TWIST}
    printer = started(start, GANTRY, changes)
    done = go_well(printer, GOOD)
    assert done == ours(printer) - GUARDED | {"PROBE"}
    assert where(printer) == "docked"
    assert printer.machine.truth.min_gap == pytest.approx(HANG, abs=0.02)


def test_bad_run_of_every_command(start):
    changes = {**section(dock_retries="0", **QUICK), **WITHOUT_TWIST}
    printer = started(start, GANTRY, changes)
    done = go_wrong(printer, BAD)
    assert done == ours(printer) - GUARDED | {"PROBE"}
    assert printer.machine.truth.min_gap > HANG - 0.2
