"""[z_calibration] sections of real printers, see tests/corpus.

Some entries run, each on one of the hosts; with CORPUS=all in the environment
all do, on every host.
"""

from __future__ import annotations

import pytest

from tests.hostkit.hosts import Host, find_hosts
from tests.hostkit.printer import Printer
from tests.hostkit.z_calibration_corpus import (
    MICROSTEP,
    VIRTUAL_ENDSTOP,
    CorpusMachine,
    Entry,
    build,
    load,
    refusal,
    some,
    spread,
)

HOSTS = find_hosts()
ENTRIES = load()

# How far a probe's body may hang, beside the usual (mm)
OTHER_BODIES = (5.2, 8.9)

# Index of a broken entry: the option that the host names
BROKEN = {
    # Positions of a template, "X,Y"
    31: "nozzle_xy_position",
    # An empty position beside one under the old names
    33: "nozzle_xy_position",
    # Marks of a merge conflict in several values
    48: "nozzle_xy_position",
    # The documentation's text as values
    57: "nozzle_xy_position",
}
WORKING = [entry for entry in ENTRIES if entry.index not in BROKEN]
MEASURED = [entry for entry in WORKING if "z_offset" in entry.probe]
VIRTUAL = [entry for entry in WORKING if entry.homes_with_probe]

# What the module has ever been given, old names included
NUMBERS = {
    "clearance",
    "lift_speed",
    "max_deviation",
    "position_min",
    "probe_bed_x",
    "probe_bed_y",
    "probe_nozzle_x",
    "probe_nozzle_y",
    "probe_switch_x",
    "probe_switch_y",
    "probing_retract_dist",
    "probing_second_speed",
    "probing_speed",
    "safe_z_height",
    "samples",
    "samples_tolerance",
    "samples_tolerance_retries",
    "speed",
    "switch_offset",
}
PAIRS = {
    "bed_xy_position",
    "nozzle_xy_position",
    "offset_margins",
    "switch_xy_offsets",
    "switch_xy_position",
    "wiggle_xy_offsets",
}
TEXTS = {
    "before_switch_gcode",
    "calibration_endstop_pin",
    "end_gcode",
    "probing_first_fast",
    "samples_result",
    "start_gcode",
}


def other_length(entry: Entry) -> float:
    """A body (mm) that is far from what the file says of the probe."""
    z_offset = float(entry.probe["z_offset"])
    return max(OTHER_BODIES, key=lambda body: abs(body - z_offset))


def check_touches(printer: Printer, machine: CorpusMachine, first: int) -> None:
    """Each site was touched, and nothing else, where it has to be."""
    places = machine.places
    expected = {
        "nozzle_pin": places.pin,
        "body_pin": places.switch,
        # The probe is over its point; the truth knows of the head
        "probe_bed": head_over(machine),
    }
    touches = printer.machine.truth.touches[first:]
    assert {touch.site for touch in touches} == set(expected)
    for touch in touches:
        at = pytest.approx(expected[touch.site], abs=0.02)
        assert (touch.x, touch.y) == at, touch


def head_over(machine: CorpusMachine) -> tuple[float, float]:
    """Where the head is while the probe touches the bed."""
    probe = machine.scene.world.mag_probe
    assert probe is not None
    x, y = machine.places.touched
    return x - probe.x_offset, y - probe.y_offset


def true_gap(printer: Printer, machine: CorpusMachine) -> float:
    """The true gap at Z=0 over the point that was touched, mm."""
    # Some leave the probe at the head
    printer.run("SET_PIN PIN=probe_magnet VALUE=0\nG4 P500")
    printer.run("G90\nG1 Z20 F900\nM400")
    printer.session.wait(0.5)
    return printer.machine.gap_at_zero(20.0, machine.places.touched)


def check_calibration(host: Host, machine: CorpusMachine) -> None:
    """It starts, and CALIBRATE_Z leaves the right gap."""
    with Printer(host, machine.scene) as printer:
        printer.homed()
        if machine.preparation:
            printer.run(machine.preparation)
        first = len(printer.machine.truth.touches)
        lines = printer.run(machine.command)
        assert [line for line in lines if "Z-CALIBRATION:" in line], lines
        check_touches(printer, machine, first)
        gap = true_gap(printer, machine)
    assert gap == pytest.approx(machine.gap, abs=2 * MICROSTEP)


def test_every_entry_is_accounted_for():
    assert (len(WORKING), len(BROKEN), len(ENTRIES)) == (116, 4, 120)
    assert (len(MEASURED), len(VIRTUAL)) == (61, 21)
    assert {e.index for e in ENTRIES if looks_broken(e)} == set(BROKEN)


def looks_broken(entry: Entry) -> bool:
    """Broken by a rule that knows nothing of the module."""
    return any(
        not looks_right(name, text) for name, text in entry.options.items()
    )


def looks_right(name: str, text: str) -> bool:
    """Whether an option exists, and has as many numbers as it takes."""
    wanted = {**dict.fromkeys(NUMBERS, 1), **dict.fromkeys(PAIRS, 2)}
    if name not in wanted:
        return name in TEXTS
    try:
        return len([float(part) for part in text.split(",")]) == wanted[name]
    except ValueError:
        return False


@pytest.mark.parametrize(("entry", "host"), spread(some(WORKING, 8), HOSTS))
def test_entry_calibrates(entry, host):
    check_calibration(host, build(entry, host))


@pytest.mark.parametrize(("entry", "host"), spread(some(MEASURED, 6), HOSTS))
def test_z_offset_need_not_be_right(entry, host):
    check_calibration(host, build(entry, host, other_length(entry)))


@pytest.mark.parametrize(("entry", "host"), spread(VIRTUAL, HOSTS))
def test_probe_as_z_endstop_is_refused(entry, host):
    machine = build(entry, host).with_virtual_endstop()
    message = refusal(host, machine.scene)
    assert f"Option 'endstop_pin: {VIRTUAL_ENDSTOP}'" in message
    assert "in section 'stepper_z' is the probe" in message
    assert "set it to the pin of that switch, or give the pin as" in message
    assert "endstop_pin in section 'z_calibration'" in message


@pytest.mark.parametrize(
    ("entry", "host"),
    spread((ENTRIES[index] for index in sorted(BROKEN)), HOSTS),
)
def test_broken_entry_is_refused(entry, host):
    message = refusal(host, build(entry, host).scene)
    option = f"ption '{BROKEN[entry.index]}' in section 'z_calibration'"
    assert option in message
