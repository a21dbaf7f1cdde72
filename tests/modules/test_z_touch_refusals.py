"""Every command that moves, where it must not: its words, and nothing has moved."""

from __future__ import annotations

import pytest

from tools.kit.carrying import (
    ASK,
    ATTACH,
    AUTO,
    DOCK_SETUP,
    EXTRA,
    HOMES,
    OVER,
    SECTION,
    SETUPS,
    SWITCH,
    TOUCHES,
    TRIPS,
    Z_SETUP,
    Z,
)
from tools.kit.dockable_probe import QUICK
from tools.kit.scenes import heated

# How the printer comes there, and out of it again
PRINT = "SDCARD_PRINT_FILE FILENAME=a.gcode"
STATES = {
    "not homed": ("M84", "G28"),
    "X homed": ("M84\nG28 X", "G28"),
    "X and Y homed": ("M84\nG28 X Y", "G28"),
    "manual probe": ("MANUAL_PROBE", "ABORT"),
    "membrane asks": (ASK[0], "EXTRA_PROBE_ABORT PROBE=membrane"),
    "other one asks": (
        "EXTRA_PROBE_CALIBRATE PROBE=other",
        "EXTRA_PROBE_ABORT PROBE=other",
    ),
    "set-up": (Z_SETUP[0], "Z_CALIBRATION_SETUP STEP=ABORT"),
    "set-up of the dock": (DOCK_SETUP[0], "DOCKABLE_PROBE_SETUP STEP=ABORT"),
    "printing": (PRINT, "CANCEL_PRINT"),
    "has extruded": ("SDCARD_PRINT_FILE FILENAME=b.gcode", "CANCEL_PRINT"),
    "paused": (f"{PRINT}\nG4 P100\nPAUSE", "CANCEL_PRINT"),
    # OctoPrint sends the lines itself: nothing but PAUSE tells of its print
    "paused by OctoPrint": ("PAUSE", "CLEAR_PAUSE"),
}

HOME = "home all axes (G28) first"
WAY = "the way to the dock is not known before; home first"
MANUAL = "a manual probe is under way; end it with ACCEPT or ABORT first"
WAITS = "waits for an answer, and somebody's hand may be near; answer with"
MEMBRANE_WAITS = (
    f"{WAITS} EXTRA_PROBE_CONTINUE PROBE=membrane,"
    " or EXTRA_PROBE_ABORT PROBE=membrane"
)
OTHER_WAITS = (
    f"section 'extra_probe other' {WAITS} EXTRA_PROBE_CONTINUE PROBE=other,"
    " or EXTRA_PROBE_ABORT PROBE=other"
)
SETUP_WAITS = (
    f"section 'z_calibration' {WAITS} Z_CALIBRATION_SETUP,"
    " or Z_CALIBRATION_SETUP STEP=ABORT"
)
DOCK_WAITS = (
    f"section 'dockable_probe' {WAITS} DOCKABLE_PROBE_SETUP,"
    " or DOCKABLE_PROBE_SETUP STEP=ABORT"
)
BUSY = "a print is under way ({}); end it first"
ACROSS = "a print is {}, and the toolhead would go across it; end it first (CANCEL_PRINT)"
GOES_ON = (
    "a print is paused (PAUSE), and goes on from here; end it (CANCEL_PRINT), or"
    " CLEAR_PAUSE where there is none"
)
DURING = "not during a print"
# Which commands say what of it, behind the name of their section
REFUSED = [
    ("not homed", TOUCHES + ASK, f"not homed: X, Y, Z; {HOME}"),
    ("not homed", TRIPS, f"not homed: X, Y; {WAY} (G28 X Y)"),
    ("X homed", TOUCHES + ASK, f"not homed: Y, Z; {HOME}"),
    ("X homed", TRIPS, f"not homed: Y; {WAY} (G28 Y)"),
    ("X and Y homed", TOUCHES + ASK, f"not homed: Z; {HOME}"),
    ("manual probe", TOUCHES + HOMES + ASK + SETUPS + ATTACH, MANUAL),
    (
        "membrane asks",
        Z + HOMES + AUTO + SETUPS,
        f"section 'extra_probe membrane' {MEMBRANE_WAITS}",
    ),
    ("membrane asks", EXTRA, f"EXTRA_PROBE_CALIBRATE {MEMBRANE_WAITS}"),
    ("other one asks", TOUCHES + ASK + SETUPS, OTHER_WAITS),
    ("set-up", TOUCHES + ASK + DOCK_SETUP, SETUP_WAITS),
    ("set-up of the dock", TOUCHES + ASK + Z_SETUP, DOCK_WAITS),
    ("printing", ASK, BUSY.format("printing")),
    ("printing", SETUPS, DURING),
    (
        "has extruded",
        Z + AUTO + ATTACH + ("PROBE",),
        ACROSS.format("under way"),
    ),
    ("paused", ASK, BUSY.format("paused")),
    ("paused", DOCK_SETUP, DURING),
    (
        "paused",
        Z + AUTO + Z_SETUP + ATTACH + ("PROBE",),
        ACROSS.format("paused"),
    ),
    ("paused by OctoPrint", ASK + SETUPS, GOES_ON),
]

# Where all axes are homed no G-code of the user's moves a toolhead that has not moved
MOVES = "\n  {% if printer.toolhead.homed_axes == 'xyz' %}G28 X{% endif %}"


OPTIONS = {
    "pause_resume": {},
    "extruder": {"min_extrude_temp": "0"},
    "dockable_probe": QUICK,
    "extra_probe other": {"pin": "^PG5", "z_offset": "0.3"},
    "auto_z_offset": {"prepare_gcode": "\n  G90\n  G0 Z3"},
    "z_calibration": {
        "start_gcode": "ATTACH_PROBE",
        "end_gcode": MOVES,
        "error_gcode": MOVES,
    },
}


@pytest.mark.parametrize("state", STATES)
def test_refused(start, tmp_path, state):
    (tmp_path / "a.gcode").write_text("G4 P500\n" * 99)
    (tmp_path / "b.gcode").write_text("G1 E5 F300\n" + "G4 P500\n" * 99)
    card = {"virtual_sdcard": {"path": str(tmp_path)}}
    printer = start(heated(SWITCH), {**OPTIONS, **card}).homed()
    into, out = STATES[state]
    for script in (f"{OVER}M400", *into.splitlines()):
        printer.run(script)
    printer.session.wait(2.0)
    wanted = {
        command: f"{SECTION[command]}: {words}"
        for where, commands, words in REFUSED
        for command in commands
        if where == state
    }
    before, touches = printer.machine.tip(), len(printer.machine.truth.touches)
    assert {command: printer.fail(command) for command in wanted} == wanted
    printer.session.wait(2.0)
    assert printer.machine.tip() == before
    assert len(printer.machine.truth.touches) == touches
    # Nothing is left of it
    printer.run(f"{out}\nPROBE_Z_ACCURACY SAMPLES=1\n{OVER}\nAUTO_Z_PROBE")
    printer.run(f"{ASK[0]}\nEXTRA_PROBE_ABORT PROBE=membrane\nPROBE")
