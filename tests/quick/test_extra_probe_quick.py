"""A good and a bad run of every command of extra_probe."""

from __future__ import annotations

import pytest

from tests.quick.runs import Run, go_well, go_wrong, ours, started
from tools.kit.extra_probe import (
    ABORT,
    CALIBRATE,
    CONTINUE,
    MICROSTEP,
    lay,
    true_gap,
)

TO = "PROBE=membrane"
# Over the membrane
ABOVE = "G90\nG1 Z10\nG1 X30 Y20 F6000"


def taken(printer):
    printer.machine.lay_membrane(False)


GOOD = [
    Run(f"{ABOVE}\nEXTRA_PROBE {TO} FLOOR=-1", "Result is z=", lay),
    Run(f"G1 Z10\nEXTRA_PROBE_ACCURACY {TO} SAMPLES=2", "standard deviation"),
    Run(f"QUERY_EXTRA_PROBE {TO}", "membrane: open"),
    Run(f"G1 Z10\n{CALIBRATE}", "action:prompt_show", taken),
    Run(ABORT, "nothing was changed"),
    Run(CALIBRATE, "action:prompt_show"),
    Run(CONTINUE, "", lay),
    Run(CONTINUE, "--> new offset=0.4", taken),
]


def stuck(printer):
    printer.machine.hold("membrane", True)


def let_go(printer):
    printer.machine.hold("membrane", None)


TRIGGERED = "triggered"
BAD = [
    Run(f"{ABOVE}\nEXTRA_PROBE {TO}", TRIGGERED, stuck),
    Run(f"EXTRA_PROBE_ACCURACY {TO}", TRIGGERED),
    Run(f"QUERY_EXTRA_PROBE {TO}", "membrane: TRIGGERED", None, False),
    Run(CONTINUE, "nothing was asked"),
    Run(ABORT, "nothing was asked"),
    Run(f"M84\n{CALIBRATE}", "not homed", let_go),
]


# Of the host: where it has left the frame is looked at, what would lose a saved value is
# refused, and an offset that is brought back is told
GUARDED = {"G28", "RESTORE_GCODE_STATE", "Z_OFFSET_APPLY_ENDSTOP"}


@pytest.mark.every_host(
    "the least that each host has to do: every command once"
)
def test_good_run_of_every_command(start):
    printer = started(start, "membrane", {})
    assert go_well(printer, GOOD) == ours(printer) - GUARDED
    assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)


def test_bad_run_of_every_command(start):
    printer = started(start, "membrane", {})
    assert go_wrong(printer, BAD) == ours(printer) - GUARDED
    assert printer.machine.truth.deepest_in_bed() == 0.0
