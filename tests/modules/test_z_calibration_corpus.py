"""[z_calibration] sections of real printers, see tools/kit/corpus.py."""

from __future__ import annotations

import pytest

from tools.kit.corpus import each, load
from tools.kit.printer import Printer
from tools.kit.z_calibration import MICROSTEP, refusal
from tools.kit.z_calibration_corpus import build, probe_of

ENTRIES = load("z_calibration")

# How far a probe's body may hang, beside the usual (mm)
OTHER_BODIES = (5.2, 8.9)

# nozzle_xy_position of these is no pair: of a template, "X,Y"; empty, beside one
# under the old names; the mark of a merge conflict; the documentation's text.
BROKEN = (31, 33, 48, 57)
WORKING = [entry for entry in ENTRIES if entry.index not in BROKEN]


def check_touches(printer, machine, first):
    """Each site was touched, and nothing else, where it has to be."""
    probe = machine.scene.world.mag_probe
    x, y = machine.touched
    expected = {
        "nozzle_pin": machine.pin,
        "body_pin": machine.switch,
        # The probe is over its point; the truth knows of the toolhead
        "probe_bed": (x - probe.x_offset, y - probe.y_offset),
    }
    touches = printer.machine.truth.touches[first:]
    assert {touch.site for touch in touches} == set(expected)
    for touch in touches:
        at = pytest.approx(expected[touch.site], abs=0.02)
        assert (touch.x, touch.y) == at, touch


def true_gap(printer, machine):
    """The true gap at Z=0 over the point that was touched, mm."""
    # Some leave the probe at the toolhead
    printer.run("SET_PIN PIN=probe_magnet VALUE=0\nG4 P500")
    printer.run("G90\nG1 Z20 F900\nM400")
    printer.session.wait(0.5)
    return printer.machine.gap_at_zero(20.0, machine.touched)


def check_calibration(host, machine):
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


# Beacon and z_tilt, old names of all options, nearly every other option
@each(WORKING, (15, 21, 44))
def test_entry_calibrates(entry, host):
    check_calibration(host, build(entry, host))


# A z_offset of 0, one that fits, one that is much too long
@each([n for n in WORKING if "z_offset" in probe_of(n)], (21, 41, 115))
def test_z_offset_need_not_be_right(entry, host):
    z_offset = float(probe_of(entry)["z_offset"])
    body = max(OTHER_BODIES, key=lambda body: abs(body - z_offset))
    check_calibration(host, build(entry, host, body))


@each([entry for entry in ENTRIES if entry.index in BROKEN], BROKEN)
def test_broken_entry_is_refused(entry, host):
    message = refusal(host, {}, build(entry, host).scene)
    assert "ption 'nozzle_xy_position' in section 'z_calibration'" in message
