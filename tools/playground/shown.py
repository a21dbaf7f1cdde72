"""What the page shows of our modules; see Played.more_of_hello."""

from __future__ import annotations

# In their order; of those labelled Calibrate a printer has one
_SHORTCUTS = (
    ("Calibrate", "CALIBRATE_Z", True),
    ("Calibrate", "AUTO_Z_CALIBRATE", True),
    ("Calibrate", "EXTRA_PROBE_CALIBRATE PROBE=membrane SAVE=1", True),
    ("Set up", "Z_CALIBRATION_SETUP", False),
    ("Set up dock", "DOCKABLE_PROBE_SETUP", False),
    ("Report", "Z_CALIBRATION_REPORT", False),
    ("Save config", "SAVE_CONFIG", False),
)

_FIRST = (
    "CALIBRATE_Z",
    "PROBE_Z_ACCURACY",
    "CALCULATE_SWITCH_OFFSET",
    "Z_CALIBRATION",
    "AUTO_Z",
    "EXTRA_PROBE",
    "QUERY_EXTRA",
    "ATTACH_PROBE",
    "DETACH_PROBE",
    "DOCK",
    "GET_PROBE",
    "SET_PROBE",
    "MOVE_",
)

_CORRECTION = "correction of the probe"
_DEVIATION = "standard deviation"
_CARDS = (
    (
        r"^Z-CALIBRATION: probe=.*--> new offset=(-?[\d.]+)",
        "new Z offset",
        "",
        3,
    ),
    (
        r"^Z-CALIBRATION: offset (-?[\d.]+)(?: \+-([\d.]+))? mm",
        *("new Z offset", "", 3),
    ),
    (r"^extra_probe .*--> new offset=(-?[\d.]+)", "new Z offset", "", 3),
    (r"--> new switch_offset=(-?[\d.]+)", "new switch_offset", "", 3),
    (r"--> correction=(-?[\d.]+)", _CORRECTION, "", 3),
    (
        r"^AUTO_Z_CALIBRATE: .*probe_z_correction: (-?[\d.]+)",
        *(_CORRECTION, "", 3),
    ),
    (
        r"^AUTO_Z_PROBE: .*triggered at z=(-?[\d.]+)",
        *("the bed sensor has triggered at Z", "", 3),
    ),
    (
        r"^AUTO_Z_HOME_Z: .*which is z=(-?[\d.]+)",
        *("where the bed sensor triggers is Z", "", 3),
    ),
    (r"^Result(?: is|: .*) z=(-?[\d.]+)", "triggered at Z", "", 3),
    (
        r"^probe z accuracy results: .*standard deviation ([\d.]+)",
        *(f"touches of the nozzle: {_DEVIATION}", "", 4),
    ),
    (
        r"^probe accuracy results: .*standard deviation ([\d.]+)",
        *(f"touches: {_DEVIATION}", "", 4),
    ),
    (
        r"^CALIBRATE_Z_ACCURACY: one CALIBRATE_Z: \+-([\d.]+)",
        *("one CALIBRATE_Z", "± ", 4),
    ),
)

ON_THE_PAGE = {
    "shortcuts": _SHORTCUTS,
    "first": _FIRST,
    "watched": (
        "z_calibration",
        "auto_z_offset",
        "dockable_probe",
        "extra_probe",
    ),
    "cards": _CARDS,
    "verdict": r"(verdict of CALIBRATE_Z_ACCURACY: .*)",
    "report": r"the report is \S*?(report-\w+-\d{8}-\d{6}\.svg)",
    "report_folder": "z_calibration",
}
