"""Z_CALIBRATION_SETUP on the simulated printer: forwards, aborted, disturbed."""

from __future__ import annotations

import pytest

from tests.hostkit.setup_user import EMPTY, User
from tests.hostkit.z_calibration import MICROSTEP, calibration, section

pytestmark = pytest.mark.spread

# Where the nozzle and the body of the switch are over the pin
CARTESIAN = {"nozzle": (226.0, 20.0), "switch": (254.0, 14.5)}


def empty(**changes):
    """The section before anything is known."""
    return {**section(**{**EMPTY, **changes.pop("options", {})}), **changes}


def pending(printer):
    return printer.status("configfile")["save_config_pending_items"]


@pytest.mark.each_host
def test_from_an_empty_section_to_the_true_gap(start):
    # Z is homed beside the middle of the pin
    home = {"safe_z_home": {"home_xy_position": "227.3, 20.4"}}
    printer = start("cartesian", changes=empty(**home))
    printer.session.require_ready()
    user = User(printer)
    user.begin()
    user.test_switches()
    user.set_places(**CARTESIAN)
    user.touch()
    user.press("Paper")
    user.lower_to_the_sheet()
    user.press("Here")
    assert user.step() == "SAVE"
    assert pending(printer) == {}
    printer.session.restart(user.dialog().gcode("Save"))
    assert user.dialog() is None
    printer.run("G28")
    result, _ = calibration(printer)
    settings = printer.status("configfile")["settings"]["z_calibration"]
    assert settings["nozzle_xy_position"] == pytest.approx(
        (226.0, 20.0), abs=0.06
    )
    # Paper is as exact as its steps, and its gap is in switch_offset
    assert result[3] == pytest.approx(0.7, abs=0.015)
    x, y = settings["bed_xy_position"]
    gap = printer.gap((x, y))
    assert gap == pytest.approx(0.7 - result[3], abs=2 * MICROSTEP)
