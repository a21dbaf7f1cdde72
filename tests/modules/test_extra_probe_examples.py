"""examples/extra_probe: each is included and used, on every host.

As an owner would: `[include FILE.cfg]` below the sections of the printer, its
macro, a hand that lays the membrane, SAVE_CONFIG.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from simprinter import heated
from tools.kit.cases import all_slow_but
from tools.kit.extra_probe import (
    BED,
    CONTINUE,
    MICROSTEP,
    NAME,
    PROBE_BED,
    fixed_switch,
    lay,
    true_gap,
)
from tools.kit.scenes import SCENES

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "extra_probe"
# The scene that each is for, what it is to save, and from which value on
OWNERS = {
    "z_switch": ("membrane", "stepper_z", "position_endstop", 0.0 - BED),
    "z_switch_macros": ("membrane", "stepper_z", "position_endstop", 0.0 - BED),
    "probe_homing": (
        "membrane_and_probe",
        "probe",
        "z_offset",
        2.0 - PROBE_BED,
    ),
    "probe_homing_macros": (
        "membrane_and_probe",
        "probe",
        "z_offset",
        2.0 - PROBE_BED,
    ),
}
FIXED = "beside_the_bed"
MACROS = [name for name in OWNERS if name.endswith("_macros")]


def owned(start, name, **options):
    """A printer whose owner has included the example."""
    scene = heated(SCENES[OWNERS[name][0]])
    path = EXAMPLES / f"{name}.cfg"
    changes = {NAME: None, f"include {path}": {}}
    printer = start(scene, changes=changes, **options)
    printer.session.require_ready()
    return printer


def use(printer, name):
    """What its owner does up to SAVE_CONFIG; the console lines."""
    if name in MACROS:
        lay(printer)
        lines = printer.run("MEASURE_MEMBRANE")
        printer.machine.lay_membrane(False)
        return lines
    lines = printer.run("CALIBRATE_Z_ZERO")
    lay(printer)
    lines += printer.run(CONTINUE)
    printer.machine.lay_membrane(False)
    return lines + printer.run(CONTINUE)


@pytest.mark.parametrize("name", all_slow_but(["z_switch"], OWNERS))
def test_example_ends_with_the_bed_at_zero(start, name):
    _, section, option, wanted = OWNERS[name]
    printer = owned(start, name)
    use(printer, name)
    pending = printer.status("configfile")["save_config_pending_items"]
    saved = float(pending[section][option])
    assert saved == pytest.approx(wanted, abs=2 * MICROSTEP)
    # The macros apply it at once, too; the command takes that back
    if name in MACROS:
        assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)
    else:
        assert printer.offset() == 0.0
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert printer.offset() == 0.0
    assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)
    # There is nothing left to correct, and the sign would show
    lines = use(printer, name)
    if name not in MACROS:
        assert "stops at Z=0.125" in "\n".join(lines)
    pending = printer.status("configfile")["save_config_pending_items"]
    for options in pending.values():
        for value in options.values():
            assert float(value) == pytest.approx(wanted, abs=0.01)


@pytest.mark.parametrize("saves", [False, True])
def test_switch_beside_the_bed(start, saves):
    over = (191.0, 165.0)
    scene = heated(fixed_switch(at=(289.0, 361.0), over=over, size=370.0))
    path = EXAMPLES / f"{FIXED}.cfg"
    changes = {NAME: None, f"include {path}": {}}
    printer = start(scene, changes=changes).homed()
    if saves:
        printer.run("EXTRA_PROBE_CALIBRATE PROBE=nozzle_switch SAVE=1")
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28")
    printer.run("M109 S150\nZ_OFFSET_FROM_SWITCH")
    assert printer.gap(over) == pytest.approx(0.0, abs=2.5 * MICROSTEP)


def test_every_example_is_run():
    assert {path.stem for path in EXAMPLES.iterdir()} == {*OWNERS, FIXED}
