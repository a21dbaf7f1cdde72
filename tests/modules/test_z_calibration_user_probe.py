"""A probe that G-code of the user attaches, with or without the help of the host.

Of such a probe its switch tells where it is, and [probe] may put it away by itself.
"""

from __future__ import annotations

import pytest

from tools.kit.cases import slow
from tools.kit.scenes import servo
from tools.kit.setup_user import EMPTY, User
from tools.kit.z_calibration import (
    BED,
    BODY,
    MICROSTEP,
    PIN,
    SWITCH_OFFSET,
    TRIGGER,
    assert_unharmed,
    calibration,
    section,
)

ATTACH = "\n  SET_PIN PIN=magnet VALUE=1\n  G4 P300"
DETACH = "\n  SET_PIN PIN=magnet VALUE=0\n  G4 P300"
OFFSET = BED + TRIGGER - (BODY + SWITCH_OFFSET)

LEFT = "the probe is still attached after end_gcode, and would meet the bed"


def attaching(probe=None, **options):
    """Sections with an output that attaches it; start_gcode and end_gcode do so."""
    own = {"start_gcode": ATTACH, "end_gcode": DETACH, **options}
    return {
        "output_pin magnet": {"pin": "PD0"},
        "probe": probe or {},
        **section(**own),
    }


def right(printer, script="CALIBRATE_Z"):
    """Run it; the gap is right."""
    result, _ = calibration(printer, script)
    assert result[-1] == pytest.approx(OFFSET, abs=2 * MICROSTEP)


######################################################################
# Left on the toolhead
######################################################################


def warnings(printer):
    return printer.status("z_calibration")["warnings"]


@pytest.mark.parametrize("end_gcode", ["", slow("\n  G4 P300")])
def test_probe_that_stays_attached_is_a_warning(start, end_gcode):
    """Wrappers dock it later, so it is no error."""
    printer = start(servo(), changes=attaching(end_gcode=end_gcode)).homed()
    lines = printer.run("CALIBRATE_Z")
    assert sum(LEFT in line for line in lines) == 1
    assert sum(LEFT in text for text in warnings(printer)) == 1
    assert printer.status("z_calibration")["valid"]
    # Now it was attached before, perhaps on purpose
    lines = printer.run("CALIBRATE_Z")
    assert not any(LEFT in line for line in lines)
    assert warnings(printer) == []


# As Klicky's macros do; what a macro raises ends with an empty line
RAISE = "\n  {action_raise_error('Probe dock failed!')}"


@pytest.mark.parametrize(
    "end_gcode", [RAISE, slow("DETACH_PROBE"), slow("G1 Z1 F-1")]
)
def test_failed_run_says_that_the_probe_is_still_attached(start, end_gcode):
    printer = start(servo(), changes=attaching(end_gcode=end_gcode)).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "z_calibration: end_gcode: " in text
    assert LEFT in text
    assert "\n" not in text
    assert_unharmed(printer)


def test_run_that_has_not_seen_the_probe_says_nothing_of_it(start):
    # start_gcode has, and the nozzle fails before anybody looks for it
    changes = attaching(before_switch_gcode="\n  G4 P1", end_gcode="")
    changes["z_calibration"]["nozzle_xy_position"] = "100, 300"
    printer = start(servo(), changes=changes).homed()
    printer.machine.tolerate("nozzle_bed", 1.0)
    assert LEFT not in printer.fail("CALIBRATE_Z")


def test_accuracy_warns_as_well(start):
    printer = start(servo(), changes=attaching(end_gcode="")).homed()
    lines = printer.run("CALIBRATE_Z_ACCURACY CYCLES=2")
    assert sum(LEFT in line for line in lines) == 1


######################################################################
# Put away by [probe]
######################################################################


# z_offset: about right, never measured, and wrong by so much
@pytest.mark.parametrize("z_offset", ["6.9", "0", slow("9.5"), slow("4")])
@pytest.mark.parametrize("each", [True, False])
@pytest.mark.parametrize("normally_open", [False, True])
def test_probe_that_its_own_gcode_puts_away(
    start, z_offset, each, normally_open
):
    """After a session of the host, or after each touch, it need not be where it was."""
    probe = {
        "z_offset": z_offset,
        "activate_gcode": ATTACH,
        "deactivate_gcode": DETACH,
        "deactivate_on_each_sample": str(each),
    }
    changes = attaching(probe=probe)
    printer = start(servo(normally_open), changes=changes).homed()
    for _ in range(2):
        right(printer)
        assert warnings(printer) == []


@pytest.mark.parametrize("each", [True, False])
def test_it_is_attached_for_the_nozzle_of_each_cycle(start, each):
    """ATTACH=0 runs start_gcode again where the host may have put it away."""
    probe = {
        "activate_gcode": ATTACH,
        "deactivate_gcode": DETACH,
        "deactivate_on_each_sample": str(each),
    }
    printer = start(servo(), changes=attaching(probe=probe)).homed()
    lines = printer.run("CALIBRATE_Z_ACCURACY CYCLES=3 ATTACH=0")
    cycles = [line for line in lines if ": cycle " in line]
    assert len(cycles) == 3
    offsets = [float(line.split("offset=")[1]) for line in cycles]
    assert offsets == pytest.approx([OFFSET] * 3, abs=2 * MICROSTEP)


def test_start_gcode_runs_once_where_nothing_puts_it_away(start):
    changes = {
        "respond": {},
        **attaching(start_gcode=ATTACH + "\n  RESPOND MSG=STARTED"),
    }
    printer = start(servo(), changes=changes).homed()
    lines = printer.run("CALIBRATE_Z_ACCURACY CYCLES=3 ATTACH=0")
    assert "\n".join(lines).count("STARTED") == 1


def test_way_down_on_the_probe_does_not_put_it_away(start):
    """Older hosts run activate_gcode and deactivate_gcode around any move of its switch."""
    noted = "\n  RESPOND MSG={}"
    probe = {
        "activate_gcode": ATTACH + noted.format("ACTIVATED"),
        "deactivate_gcode": DETACH + noted.format("DEACTIVATED"),
        "deactivate_on_each_sample": "False",
    }
    changes = {"respond": {}, **attaching(probe=probe)}
    printer = start(servo(), changes=changes).homed()
    for _ in range(2):
        text = "\n".join(printer.run("CALIBRATE_Z"))
        assert text.count(" ACTIVATED") == 1
        assert text.count(" DEACTIVATED") == 1
    assert printer.offset() == pytest.approx(OFFSET, abs=2 * MICROSTEP)
    assert printer.status("z_calibration")["last_result"][
        "nozzle"
    ] == pytest.approx(PIN, abs=2 * MICROSTEP)


@pytest.mark.parametrize("each", [True, slow(False)])
def test_setup_measures_it_right(start, each):
    probe = {
        "activate_gcode": ATTACH,
        "deactivate_gcode": DETACH,
        "deactivate_on_each_sample": str(each),
        "z_offset": "0",
    }
    printer, _ = set_up(start, attaching(probe=probe))
    told = "\n".join(printer.session.console)
    for name, z in (("nozzle", PIN), ("switch", PIN + BODY)):
        assert f"{name} at z={z:.3f}"[:-1] in told
    assert f"bed at z={BED + TRIGGER:.3f}"[:-1] in told


def set_up(start, changes, by_hand=""):
    """Set it up to the step after the touches; 'by_hand' attaches the probe before."""
    changes["z_calibration"].update(EMPTY)
    printer = start(servo(), changes=changes).homed()
    user = User(printer)
    user.begin()
    user.test_switches()
    printer.run(by_hand)
    user.set_places(nozzle=(206.0, 306.0), switch=(211.5, 281.25))
    user.touch()
    assert user.step() == "GAP"
    return printer, user


@pytest.mark.parametrize("end_gcode", ["\n  G4 P300", slow(DETACH)])
def test_setup_says_that_the_probe_is_still_attached(start, end_gcode):
    changes = attaching(end_gcode=end_gcode)
    printer, _ = set_up(start, changes)
    told = "\n".join(printer.session.console)
    assert told.count(LEFT) == (end_gcode != DETACH)


def test_setup_says_nothing_of_a_probe_put_on_by_hand(start):
    """Nothing puts it away but the user, who is told to by the step with the sheet."""
    changes = attaching(start_gcode="", end_gcode="")
    printer, user = set_up(start, changes, by_hand=ATTACH)
    assert LEFT not in "\n".join(printer.session.console)
    assert "take it off" in user.refused("Paper")
