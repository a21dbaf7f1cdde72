"""CALIBRATE_Z with a probe that fetches and docks itself, ours or Kalico's."""

from __future__ import annotations

import pytest

from simprinter import Fault
from simprinter.docks import HANG, calibrating
from tools.kit.dockable_probe import SWITCH, trips, where
from tools.kit.printer import FOLDER, module_files
from tools.kit.z_calibration import calibration

SCENE = calibrating(SWITCH)
# What the scene's [z_calibration] says of the switch, and what is so
GAP = 0.485 - 0.44


def z_section(**options):
    """Changes to [z_calibration] only."""
    return {"z_calibration": options}


WAYS = pytest.mark.parametrize(
    "changes",
    [
        {},
        z_section(start_gcode="ATTACH_PROBE", end_gcode="DETACH_PROBE"),
        z_section(before_switch_gcode="ATTACH_PROBE"),
        {"dockable_probe": {"auto_attach_detach": "False"}},
        # The bed is looked at first, in a session of its own
        {"dockable_probe": {"z_offset": "0"}},
    ],
    ids=["by itself", "told", "before the switch", "not automatic", "length"],
)


def assert_calibrated(printer):
    """Two runs, one trip each; what was automatic is so again."""
    automatic = printer.status("dockable_probe")["auto_attach_detach"]
    for _ in range(2):
        before = len(printer.machine.truth.events)
        calibration(printer)
        assert trips(printer, before) == ["attach", "dock"]
        assert where(printer) == "docked"
    status = printer.status("dockable_probe")
    assert status["auto_attach_detach"] is automatic
    assert printer.machine.truth.min_gap > HANG - 0.2
    assert printer.gap() == pytest.approx(GAP, abs=0.01)


@WAYS
def test_calibrate_z(start, changes):
    assert_calibrated(start(SCENE, changes).homed())


# Of which only Kalico has one
@pytest.mark.every_host
@WAYS
def test_calibrate_z_with_the_one_that_the_host_has(start, host, changes):
    if not host.layout.module_dir.endswith("plugins"):
        pytest.skip("only Kalico has a dockable_probe of its own")
    files = module_files()
    ours = {name: files[name] for name in ("z_calibration", FOLDER)}
    assert_calibrated(start(SCENE, changes, modules=ours).homed())


def test_automatic_again_after_an_error(start):
    changes = z_section(offset_margins="-0.01, 0.01", bed_xy_position="60, 60")
    printer = start(SCENE, changes).homed()
    assert "offset" in printer.fail("CALIBRATE_Z")
    assert where(printer) == "docked"
    status = printer.status("dockable_probe")
    assert status["auto_attach_detach"] is True


def test_probe_that_is_not_there(start):
    fault = Fault("attach_fails", persistent=True)
    printer = start(SCENE, faults=[fault]).homed()
    assert "the probe was not fetched" in printer.fail("CALIBRATE_Z")
    assert printer.machine.truth.min_gap > 9.0
    assert printer.session.state()[0] == "ready"
