"""The end of the printer while a command touches: no harm, no hints, no host that hangs."""

from __future__ import annotations

import re

import pytest

from simprinter import Fault
from tools.kit.carrying import OVER, SWITCH
from tools.kit.dockable_probe import QUICK
from tools.kit.extra_probe import lay

BEGIN = "EXTRA_PROBE_CALIBRATE PROBE=membrane"
CONTINUE = "EXTRA_PROBE_CONTINUE PROBE=membrane"

# Whoever has pressed the button needs no hints
UNHEARD = "Unable to obtain '\\w+' response"
LATE = (
    f"(Error during homing probe: )?{UNHEARD} .*a board was not heard in time.*"
)
WAITING = "the printer is shut down: Shutdown due to webhooks request"
WORDS = {
    "touching": "Probing failed due to printer shutdown",
    "before": f"(Touch not begun|Probing failed) due to printer shutdown|{UNHEARD}",
    "z waits": f"z_calibration: {WAITING}",
    "auto waits": f"auto_z_offset: {WAITING}",
    "lifting": "extra_probe membrane: ended by a shutdown of the printer",
    # The host says in its own words what it does not get any more
    "unheard": UNHEARD,
    "late probe": f"auto_z_offset: probe: {LATE}",
    "late membrane": f"extra_probe membrane: {LATE}",
}
# Klipper of 2026 waits before a touch for a trigger that never comes, and
# FIRMWARE_RESTART with it, unless the module looks first
LATER = pytest.mark.every_host(
    "since 2026 a host waits for the trigger even after a shutdown"
)
# The button is pressed so long (s) after the command's first touch of the site
STOPPED = [
    ("CALIBRATE_Z", "nozzle_pin", 1.6, "touching"),
    pytest.param("CALIBRATE_Z", "nozzle_pin", 0.15, "before", marks=LATER),
    pytest.param("CALIBRATE_Z", "probe_bed", 0.15, "before", marks=LATER),
    ("PROBE_Z_ACCURACY SAMPLES=2", "nozzle_pin", 0.15, "before"),
    ("Z_CALIBRATION_WAIT", "nozzle_pin", 25.0, "z waits"),
    pytest.param("AUTO_Z_CALIBRATE", "nozzle_bed", 1.4, "before", marks=LATER),
    pytest.param("AUTO_Z_CALIBRATE", "probe_bed", 1.6, "before", marks=LATER),
    ("AUTO_Z_WAIT", "nozzle_bed", 25.0, "auto waits"),
    ("EXTRA_PROBE_ACCURACY PROBE=membrane", "nozzle_membrane", 0.2, "touching"),
    (CONTINUE, "nozzle_membrane", 0.2, "touching"),
    (CONTINUE, "nozzle_membrane", 2.5, "lifting"),
    ("PROBE", "probe_bed", 0.3, "before"),
]
# Neither the speed of before is set again, from where the host takes the toolhead to be,
# nor the G-code offset
OFFSET = 0.3
OTHER = "\n  SET_GCODE_OFFSET Z=1 MOVE=0"
TOLD = "\n  RESPOND MSG='cleaning up'"
CHANGES = {
    "respond": {},
    "dockable_probe": QUICK,
    "z_calibration": {
        "start_gcode": f"{OTHER}\n  G91\n  G1 X1 F1234",
        "before_switch_gcode": "ATTACH_PROBE",
        "end_gcode": TOLD,
        "error_gcode": TOLD,
        "probing_retract_dist": "3",
        "samples": "3",
    },
    "auto_z_offset": {"samples": "2", "prepare_gcode": OTHER},
    "extra_probe membrane": {
        "samples": "3",
        "position_min": "-1",
        "activate_gcode": OTHER,
        "deactivate_gcode": TOLD,
        "deactivate_on_each_sample": "False",
    },
}


def begin(printer, command):
    """The toolhead is where the command touches, and a hand has done its part."""
    printer.run(f"{OVER}M400\nSET_GCODE_OFFSET Z={OFFSET} MOVE=0")
    if command == CONTINUE:
        printer.run(f"{BEGIN} SAVE=1")
    printer.machine.lay_membrane("EXTRA" in command)


@pytest.mark.parametrize(("command", "site", "after", "words"), STOPPED)
def test_emergency_stop(start, command, site, after, words):
    printer = start(SWITCH, CHANGES).homed()
    begin(printer, command)
    lines = len(printer.session.console)
    text = printer.stopped(command, site, after)
    assert re.fullmatch(WORDS[words], text)
    assert "failed, too" not in printer.session.log()
    before, touches = printer.machine.tip(), len(printer.machine.truth.touches)
    printer.session.wait(100.0)
    # No G-code runs to clean up: neither the user's nor what puts the offset back
    if words != "lifting":
        told = printer.session.console[lines:]
        assert not any("cleaning up" in line for line in told)
    if command != "PROBE":
        assert printer.offset() != pytest.approx(OFFSET)
    assert printer.machine.tip() == before
    assert len(printer.machine.truth.touches) == touches
    printer.session.restart("FIRMWARE_RESTART")
    assert printer.status("extra_probe membrane")["waits_for"] == ""
    printer.run("G28")
    begin(printer, command)
    printer.run(command)


MEASURE = "AUTO_Z_MEASURE_OFFSET"
# Of two boards one falls silent so long (s) before a touch of the command
SILENT = [
    ("voron", "CALIBRATE_Z", "zboard", "body_pin", 2, 0.0, "unheard"),
    ("qidi", MEASURE, "U_1", "nozzle_bed", 1, 0.5, "touching"),
    ("qidi", MEASURE, "mcu", "inductive_bed", 2, 0.5, "late probe"),
    (
        "membrane",
        CONTINUE,
        "loadcell",
        "nozzle_membrane",
        2,
        0.5,
        "late membrane",
    ),
]


@pytest.mark.parametrize(
    ("scene", "command", "board", "site", "n", "before", "words"), SILENT
)
def test_board_that_falls_silent(
    start, scene, command, board, site, n, before, words
):
    def ready(*faults):
        printer = start(f"{scene}_two_boards", faults=faults).homed()
        if command == CONTINUE:
            printer.run(BEGIN)
            lay(printer)
        return printer, len(printer.machine.truth.touches)

    printer, first = ready()
    printer.run(command)
    touches = printer.machine.truth.touches[first:]
    when = [touch.t for touch in touches if touch.site == site][n - 1] - before
    printer, _ = ready(Fault("mcu_silent", board=board, t=when))
    # Pressed at that moment
    printer.machine.tolerate("body_pin", 0.07)
    text = printer.fail(command)
    assert re.fullmatch(WORDS[words], text)
    # Nothing is wrong with its switch, nor with the bed
    assert "by hand" not in text and "not the bed" not in text
    # No deeper than a touch, with the trigger seen late
    truth = printer.machine.truth
    assert truth.deepest_in_bed() < 0.06
    assert truth.depth("nozzle_membrane") < 0.06
