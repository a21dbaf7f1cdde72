"""[auto_z_offset] sections of real printers, see tests/corpus.

Some entries run, each on one of the hosts; with CORPUS=all in the environment
all do, on every host.
"""

from __future__ import annotations

import math
from operator import attrgetter

import pytest

from tests.hostkit.auto_z_offset_corpus import (
    AutoMachine,
    build,
    last_value,
)
from tests.hostkit.hosts import Host
from tests.hostkit.printer import Printer
from tests.hostkit.z_calibration_corpus import (
    MICROSTEP,
    WHOLE,
    Entry,
    load,
    refusal,
    some,
)

pytestmark = [] if WHOLE else pytest.mark.spread
ENTRIES = load("auto_z_offset")

# What the message has to say of an option that is missing
REMEDIES = {
    "pin": ("give the pin of the bed sensor, as in 'pin: U_1:PC1'",),
    "prepare_gcode": (
        "write the G-code that turns the bed sensor on",
        "or nothing behind the colon if none is needed",
    ),
}
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
WORKING = [entry for entry in ENTRIES if entry.index not in BROKEN]
FAULTY = [entry for entry in ENTRIES if entry.index in BROKEN]
INDEX = attrgetter("index")
INSIDE_BED = "mm inside the bed"

NUMBERS = {
    "calibrated_z_offset",
    "lift_speed",
    "offset_samples",
    "probe_accel",
    "probe_hop",
    "probe_z_min",
    "sample_retract_dist",
    "samples",
    "samples_tolerance",
    "samples_tolerance_retries",
    "speed",
    "x_offset",
    "y_offset",
    "z_current_factor",
    "z_offset",
}
# Old: they tell where the probe is or what the original module had saved
OLD = {"calibrated_z_offset", "x_offset", "y_offset"}


def own_lines(lines: list[str]) -> list[str]:
    """What the module has said."""
    start = "// auto_z_offset: "
    return [line[len(start) :] for line in lines if line.startswith(start)]


def check_start(printer: Printer, machine: AutoMachine) -> None:
    """One line for each old option, a nozzle in the bed, too much speed."""
    entry = machine.entry
    printer.session.require_ready()
    lines = own_lines(printer.session.console)
    expected = [f"option '{name}' " for name in OLD & set(entry.options)]
    if entry.number("z_offset", 0.2) < 0.0:
        expected.append(INSIDE_BED)
    if machine.is_limited:
        expected.append("is limited to")
    for words in expected:
        assert len([line for line in lines if words in line]) == 1, lines
    assert len(lines) == len(expected), lines


def check_result(lines: list[str], entry: Entry) -> None:
    """The result is told; so is a nozzle in the bed, behind it."""
    results = [n for n, line in enumerate(lines) if "AUTO_Z_CALIBRATE:" in line]
    inside = [n for n, line in enumerate(lines) if INSIDE_BED in line]
    assert len(results) == 1, lines
    assert len(inside) == (entry.number("z_offset", 0.2) < 0.0), lines
    assert all(n > results[0] for n in inside), lines


def check_touches(printer: Printer, machine: AutoMachine, first: int) -> None:
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


def check_calibration(host: Host, machine: AutoMachine) -> None:
    """It starts, and AUTO_Z_CALIBRATE leaves the right gap."""
    with Printer(host, machine.scene) as printer:
        check_start(printer, machine)
        printer.homed()
        first = len(printer.machine.truth.touches)
        check_result(printer.run("AUTO_Z_CALIBRATE"), machine.entry)
        check_touches(printer, machine, first)
        gap = printer.gap(machine.bed)
    smallest, largest = machine.gaps
    assert smallest - 2 * MICROSTEP < gap < largest + 2 * MICROSTEP


def test_every_entry_is_accounted_for():
    assert (len(WORKING), len(BROKEN), len(ENTRIES)) == (22, 10, 32)
    for entry in ENTRIES:
        assert missing(entry) == BROKEN.get(entry.index, ()), entry.index
        for name, text in entry.options.items():
            assert looks_right(name, text), (entry.index, name)
    # The switch is the other way round
    reverse = {e.index for e in ENTRIES if last_value(e) == "0"}
    assert reverse == {16, 27}


def missing(entry: Entry) -> tuple[str, ...]:
    """What it lacks, by a rule that knows nothing of the module."""
    lacks = {
        # Only G-code may be nothing
        "pin": not entry.options.get("pin"),
        "prepare_gcode": "prepare_gcode" not in entry.options,
    }
    return tuple(name for name, lacking in lacks.items() if lacking)


def looks_right(name: str, text: str) -> bool:
    """Whether an option exists, and is what it has to be."""
    if name in NUMBERS:
        try:
            return math.isfinite(float(text))
        except ValueError:
            return False
    if name == "samples_result":
        return text in ("average", "median")
    return name in REMEDIES


def test_every_touch_reaches_the_speed_that_the_entry_asks_for(one_host):
    """So the gap is known exactly."""
    found = set()
    for entry in ENTRIES:
        left, asked = build(entry, one_host).speeds
        found |= {entry.index} if left < asked else set()
    assert found == set()


@pytest.mark.parametrize("entry", some(WORKING, 8), ids=INDEX)
def test_entry_calibrates(entry, host):
    check_calibration(host, build(entry, host))


@pytest.mark.parametrize("entry", FAULTY, ids=INDEX)
def test_broken_entry_is_refused(entry, host):
    """Also when its owner has mended but the first of its faults."""
    added = {}
    for option in BROKEN[entry.index]:
        message = refusal(host, build(entry, host, added).scene)
        head, found, remedy = message.partition(f"Option '{option}")
        assert found and not head, message
        assert "section 'auto_z_offset'" in remedy
        for words in REMEDIES[option]:
            assert words in remedy
        added[option] = MENDED[option]


@pytest.mark.parametrize("entry", some(FAULTY, 5), ids=INDEX)
def test_mended_entry_calibrates(entry, host):
    added = {name: MENDED[name] for name in BROKEN[entry.index]}
    check_calibration(host, build(entry, host, added))
