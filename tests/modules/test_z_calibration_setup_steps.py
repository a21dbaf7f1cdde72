"""Z_CALIBRATION_SETUP disturbed at each of its steps, and aborted there."""

from __future__ import annotations

import re

import pytest

from simprinter.hosts.session import GcodeError
from tools.kit.cases import all_slow_but
from tools.kit.product import OPTIONS as TABLES
from tools.kit.product import ORDER
from tools.kit.setup_user import EMPTY, SETUP, User
from tools.kit.z_calibration import section

STEPS = [name.upper() for name in ORDER]
# Of the section; the axis has an endstop_pin, too
OPTIONS = [
    row.name
    for row in TABLES["z_calibration"]
    if "_" in row.name and row.name != "endstop_pin"
]
# From which step on it is noticed, and the last one that needs what is broken.
# A G28 with a dead endstop is the host's own, and ends below the axis
DISTURBANCES = {
    "motors off": ("NOZZLE", "PAPER"),
    "probe lost": ("SWITCH", "TOUCH_BED"),
    "pin pressed": ("PIN", "TOUCH_BED"),
    "pin released": ("NOZZLE", "TOUCH_SWITCH"),
    "probe pressed": ("HOME", "TOUCH_BED"),
    "probe released": ("HOME", "GAP"),
}
CASES = [
    (disturbance, step)
    for disturbance, (first, last) in DISTURBANCES.items()
    for step in STEPS[STEPS.index(first) : STEPS.index(last) + 1]
    # Nothing is on the toolhead there
    if (disturbance, step) != ("probe lost", "TOUCH_SWITCH")
]


@pytest.fixture
def at_step(start):
    """at_step(step): one who has come so far from an empty section."""

    def begun(step):
        printer = start("cartesian", changes=section(**EMPTY))
        printer.session.require_ready()
        user = User(printer)
        user.begin()
        user.go_to(step)
        printer.run("SET_GCODE_OFFSET Z=0.1")
        return user

    return begun


def disturb(user, disturbance):
    """What stays so from now on."""
    machine = user.machine
    if disturbance == "motors off":
        user.printer.run("M84")
    elif disturbance == "probe lost":
        now = machine.rig.seconds(machine.simulation.clock.now())
        machine.world.lose_probe(now)
    else:
        what, level = disturbance.split()
        user.hold(user.pin if what == "pin" else what, level == "pressed")
    # Of the floors of a first run
    machine.tolerate("nozzle_pin", 1.02)
    machine.tolerate("body_pin", 1.02)
    machine.tolerate("body_bed", 1.02)


def hidden(text):
    """Options that it names, and whose owner has written none of them yet."""
    # Speaks of what that hook has done, so there are some
    if "before_switch_gcode has attached it" in text:
        text = text.replace("before_switch_gcode", "").replace(
            "start_gcode", ""
        )
    return [name for name in OPTIONS if re.search(rf"\b{name}\b", text)]


def assert_aborted(user):
    """Nothing is left of it, and the toolhead is up."""
    printer = user.printer
    said = "\n".join(user.press("Abort"))
    assert "the set-up has ended, nothing was saved" in said
    assert user.dialog() is None
    assert printer.status("configfile")["save_config_pending_items"] == {}
    assert printer.offset() == pytest.approx(0.1)
    assert "no set-up is under way" in printer.fail(f"{SETUP} STEP=PIN")
    if printer.status("toolhead")["homed_axes"] == "xyz":
        assert printer.session.position()[2] > 11.4


# Each once, at steps that ask, look and touch
@pytest.mark.parametrize(
    ("disturbance", "step"),
    all_slow_but(
        [
            ("motors off", "LOOK"),
            ("probe lost", "TOUCH_BED"),
            ("pin pressed", "TOUCH_NOZZLE"),
            ("pin released", "TOUCH_SWITCH"),
            ("probe pressed", "ATTACH"),
            ("probe released", "LOOK"),
        ],
        CASES,
    ),
)
def test_disturbed_at_a_step(at_step, disturbance, step):
    user = at_step(step)
    disturb(user, disturbance)
    # At this step or at one that follows
    with pytest.raises(GcodeError):
        while user.step() != "SAVE":
            user.go_on()
    text = user.dialog().text
    assert "Not done: " in text
    assert hidden(text) == []
    assert_aborted(user)


def test_probe_that_dies_on_the_bed(at_step):
    user = at_step("TOUCH_NOZZLE")
    user.fail_at("probe_bed")
    text = user.dialog().text
    assert "check the place of the bed and the probe (QUERY_PROBE" in text
    assert hidden(text) == []
