"""What both modules leave to z_touch when something is wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import heated
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    BODY,
    calibration,
    refusal,
    section,
    touched_sites,
    with_extra,
)

USERS = [("heater_bed", "PH1"), ("output_pin lamp", "PH5")]


def sharing(user, pin, order, **first):
    """A printer with these two on one pin, in that order, after the first."""
    sections = {**first, **heated(SCENES["voron"]).sections}
    own = {**sections.pop("z_calibration"), "endstop_pin": f"!{pin}"}
    both = {"z_calibration": own, user: sections.pop(user, {"pin": pin})}
    sections.update({name: both[name] for name in order(both)})
    return replace(SCENES["voron"], name="sharing", sections=sections)


@pytest.mark.parametrize("order", [list, reversed])
@pytest.mark.parametrize(("user", "pin"), USERS)
def test_pin_that_something_else_uses(host, user, pin, order):
    # Shared, the bed would get the endstop's polarity, and heat
    message = refusal(host, {}, sharing(user, pin, order))
    own = f"Option 'endstop_pin: !{pin}' in section 'z_calibration'"
    assert message.startswith(own) == (order is reversed)
    words = f"pin {pin} used multiple times in config"
    if order is reversed:
        # Which one, as it was made before
        words = f"in section '{user}', too, and two options cannot have one pin"
    assert words in message


def fall_silent(machine, begin, board="zboard"):
    """Nobody hears from a board for a moment."""

    def is_silent():
        now = machine.rig.seconds(machine.simulation.clock.now())
        return begin < now < begin + 0.12

    machine.boards[board].is_silent = is_silent


@pytest.mark.slow
def test_lost_message_is_no_missing_trigger(host):
    # The body is 0.75 mm lower than z_offset says, so 0.25 mm above the floor
    scene = "voron_two_boards"
    changes = {"probe": {"z_offset": f"{BODY + 0.44 + 0.75}"}}
    with Printer(host, scene, changes) as printer:
        calibration(printer.homed())
        touches = printer.machine.truth.touches
        begin = min(t.t for t in touches if t.site == "body_pin") - 0.08
    with Printer(host, scene, changes) as printer:
        fall_silent(printer.homed().machine, begin)
        text = printer.fail("CALIBRATE_Z")
        assert text.startswith("z_calibration: switch: ")
        assert "Communication timeout during homing" in text
        # No fault of the switch, nor of its place
        assert "run it again" in text
        assert "switch_xy_position" not in text
        stopped = float(text.split("(stopped at z=")[1].split(")")[0])
        assert 0.25 < stopped - (1.6 + BODY - 0.25) < 0.5
        # Nobody looks at the bed how long the probe is
        assert "probe_bed" not in touched_sites(printer)
        # The printer is as good as before
        calibration(printer)


@pytest.mark.slow
def test_lost_message_near_the_start_is_no_pressed_switch(host):
    # Samples begin 0.4 mm above the last trigger, and the pin is pressed when
    # the motors stop
    scene, changes = "voron_two_boards", section(probing_retract_dist="0.4")
    with Printer(host, scene, changes) as printer:
        calibration(printer.homed())
        touches = printer.machine.truth.touches
        begin = [t.t for t in touches if t.site == "nozzle_pin"][-1] - 0.012
    with Printer(host, scene, changes) as printer:
        fall_silent(printer.homed().machine, begin)
        text = printer.fail("CALIBRATE_Z")
    # Older ones say 'homing probe'
    assert "Communication timeout during homing" in text, text
    assert "(stopped at" in text


@pytest.mark.slow
def test_lost_message_while_the_host_probes(host):
    with Printer(host, "qidi_two_boards") as printer:
        printer.homed().run("AUTO_Z_MEASURE_OFFSET")
        begin = printer.machine.truth.touches[-1].t - 0.08
    with Printer(host, "qidi_two_boards") as printer:
        fall_silent(printer.homed().machine, begin, "U_1")
        text = printer.fail("AUTO_Z_MEASURE_OFFSET")
        assert text.startswith("auto_z_offset: probe: ")
        assert "a board was not heard in time" in text
        assert "QUERY_PROBE" not in text
        printer.run("AUTO_Z_MEASURE_OFFSET")


def test_clean_up_that_meets_an_error_of_the_host_is_the_end(start, tmp_path):
    # Somebody's handler, once the run has failed
    code = """
def arm(gcmd):
    printer.register_event_handler("toolhead:manual_move", lambda: {}["x"])
gcode.register_command("ARM", arm)
"""
    changes = {
        "extra": {},
        **section(before_switch_gcode="G1 Z5\n  ARM\n  G1 X9999"),
    }
    modules = with_extra(tmp_path, code)
    printer = start(changes=changes, modules=modules).homed()
    # The first error is told
    assert "Move out of range" in printer.fail("CALIBRATE_Z")
    state, message = printer.session.state()
    assert state == "shutdown"
    assert message.startswith(
        "z_calibration: lifting failed after another error: 'x'"
    )
