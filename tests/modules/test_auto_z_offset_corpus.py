"""[auto_z_offset] sections of real printers, see tools/kit/corpus.py."""

from __future__ import annotations

import pytest

from tools.kit.auto_z_offset import MICROSTEP
from tools.kit.auto_z_offset_corpus import build
from tools.kit.corpus import each, load
from tools.kit.printer import Printer
from tools.kit.z_calibration import refusal

ENTRIES = load("auto_z_offset")

# What mends it, on a machine whose sensor is always on
MENDED = {"pin": "PC1", "prepare_gcode": ""}

# Index of a broken entry: what is at fault, the first one to be told of first
BROKEN = {
    # The vendor's templates: nothing turns the sensor on
    **dict.fromkeys((1, 6, *range(10, 16)), ("prepare_gcode",)),
    # A template
    17: ("pin",),
    # What an issue shows of it
    30: ("pin", "prepare_gcode"),
}
FAULTY = [entry for entry in ENTRIES if entry.index in BROKEN]
INSIDE_BED = "mm inside the bed"

# Old: they tell where the probe is or what the original module had saved
OLD = {"calibrated_z_offset", "x_offset", "y_offset"}


def check_start(printer, machine):
    """One line for each old option, a nozzle in the bed, too much speed."""
    entry = machine.entry
    printer.session.require_ready()
    start = "// auto_z_offset: "
    lines = [n for n in printer.session.console if n.startswith(start)]
    expected = [f"option '{name}' " for name in OLD & set(entry.options)]
    if entry.number("z_offset", 0.2) < 0.0:
        expected.append(INSIDE_BED)
    if machine.is_limited:
        expected.append("is limited to")
    # How deep a first touch may go, where the owner has not said so
    lowest = float(printer.scene.sections["stepper_z"]["position_min"] or 0.0)
    if entry.number("probe_z_min", None) is None and lowest <= -2.0:
        expected.append("until AUTO_Z_CALIBRATE has run once")
    for words in expected:
        assert len([line for line in lines if words in line]) == 1, lines
    assert len(lines) == len(expected), lines


def check_result(lines, entry):
    """The result is told; so is a nozzle in the bed, behind it."""
    results = [n for n, line in enumerate(lines) if "AUTO_Z_CALIBRATE:" in line]
    inside = [n for n, line in enumerate(lines) if INSIDE_BED in line]
    assert len(results) == 1, lines
    assert len(inside) == (entry.number("z_offset", 0.2) < 0.0), lines
    assert all(n > results[0] for n in inside), lines


def check_touches(printer, machine, first):
    """Both sensors were used at one point, and nothing else was touched."""
    probe = printer.scene.world.inductive
    x, y = machine.bed
    nozzle, probed = (x, y), (x - probe.x_offset, y - probe.y_offset)
    expected = {
        ("nozzle_bed", nozzle),
        ("inductive_bed", probed),
        # Nobody looks, but it senses the bed before the nozzle is there
        ("inductive_bed", nozzle),
    }
    found = set()
    for touch in printer.machine.truth.touches[first:]:
        place = nozzle if abs(touch.x - x) < 1.0 else probed
        assert (touch.x, touch.y) == pytest.approx(place, abs=0.02), touch
        found.add((touch.site, place))
    assert found == expected


def check_calibration(host, machine):
    """It starts, and AUTO_Z_CALIBRATE leaves the right gap."""
    with Printer(host, machine.scene) as printer:
        check_start(printer, machine)
        printer.homed()
        first = len(printer.machine.truth.touches)
        check_result(printer.run("AUTO_Z_CALIBRATE"), machine.entry)
        check_touches(printer, machine, first)
        gap = printer.gap(machine.bed)
    assert gap == pytest.approx(machine.gap, abs=2 * MICROSTEP)


# Most of the options; a nozzle probe, a BLTouch are slow
@each([n for n in ENTRIES if n.index not in BROKEN], (21,))
def test_entry_calibrates(entry, host):
    check_calibration(host, build(entry, host))


@each(FAULTY, (1, 17, 30))
def test_broken_entry_is_refused(entry, host):
    """Also when its owner has mended but the first of its faults; then it calibrates."""
    added = {}
    for option in BROKEN[entry.index]:
        message = refusal(host, {}, build(entry, host, added).scene)
        assert message.startswith(f"Option '{option}")
        assert "in section 'auto_z_offset' " in message
        added[option] = MENDED[option]
    check_calibration(host, build(entry, host, added))
