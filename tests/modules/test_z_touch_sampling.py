"""How each touch is sampled: count, result, tolerance, speeds, of all modules."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from simprinter import Fault
from tools.kit.auto_z_offset import PROBE_PLACE, formulas
from tools.kit.cases import slow
from tools.kit.dockable_probe import SWITCH
from tools.kit.extra_probe import NAME
from tools.kit.product import OPTIONS
from tools.kit.z_calibration import MICROSTEP, result_of

Z, AUTO, DOCK = "z_calibration", "auto_z_offset", "dockable_probe"
EXTRA = "EXTRA_PROBE PROBE=membrane"
MEASURE = "AUTO_Z_MEASURE_OFFSET"


class Row(NamedTuple):
    """What is touched.

    section: where the options stand. height: what has come of the touches (mm), from
    the console or the status. name: of the site, in what is told.
    """

    section: str
    scene: Any
    command: str
    site: str
    height: Callable[[Any, list[str]], float]
    name: str
    before: str = ""


def heights(number):
    """Of the line with all heights of z_calibration."""
    return lambda printer, lines: result_of(lines)[number]


ROWS = {
    "nozzle": Row(
        Z, "voron", "CALIBRATE_Z", "nozzle_pin", heights(2), f"{Z}: nozzle: "
    ),
    "switch": Row(
        Z, "voron", "CALIBRATE_Z", "body_pin", heights(1), f"{Z}: switch: "
    ),
    "bed": Row(
        Z, "voron", "CALIBRATE_Z", "probe_bed", heights(0), f"{Z}: bed: "
    ),
    "nozzle of [probe]": Row(
        "probe",
        *("voron", "CALIBRATE_Z", "nozzle_pin", heights(2), f"{Z}: nozzle: "),
    ),
    "bed of [probe]": Row(
        "probe",
        *("voron", "CALIBRATE_Z", "probe_bed", heights(0), f"{Z}: bed: "),
    ),
    "sensor": Row(
        *(AUTO, "qidi", MEASURE, "nozzle_bed"),
        lambda printer, lines: formulas(lines)[-1].sensor,
        f"{AUTO}: bed sensor: ",
    ),
    "probe": Row(
        *(AUTO, "qidi", MEASURE, "inductive_bed"),
        lambda printer, lines: formulas(lines)[-1].probe,
        f"{AUTO}: probe: ",
    ),
    "membrane": Row(
        *(NAME, "membrane", EXTRA, "nozzle_membrane"),
        lambda printer, lines: printer.status(NAME)["last_z_result"],
        f"{NAME}: ",
        "G90\nG1 Z5 F900\nG1 X30 Y20 F6000",
    ),
    "dock": Row(
        *(DOCK, SWITCH, "PROBE", "probe_bed"),
        lambda printer, lines: printer.status("probe")["last_z_result"],
        f"{DOCK}: ",
        "G90\nG1 X150 Y150 Z20 F6000",
    ),
}
# Each by options, and by parameters of those commands that have them
CASES = [
    (name, by)
    for name, row in ROWS.items()
    for by in ("options", "parameters")
    if by == "options" or row.section not in ("probe", AUTO)
]
EARLY = 0.06


def marked(name, by):
    """A case; what parameters do is one function of all modules."""
    marks = [pytest.mark.slow] if by == "parameters" else []
    if ROWS[name].section == "probe":
        why = "older hosts have the options of a probe elsewhere"
        marks.append(pytest.mark.every_host(why))
    return pytest.param(name, by, marks=marks)


each_case = pytest.mark.parametrize(
    ("name", "by"), [marked(*case) for case in CASES]
)


def test_each_module_is_here():
    sampling = {
        name for name in OPTIONS for r in OPTIONS[name] if r.name == "samples"
    }
    assert sampling == {row.section.split()[0] for row in ROWS.values()} - {
        "probe"
    }


def sampled(start, name, by, fixed, **given):
    """A homed printer with these options, or parameters, and a way to run the command.

    fixed: options, whatever it is given by.
    """
    row, params = ROWS[name], ""
    own = dict(fixed)
    if by == "options":
        own.update(given)
    else:
        words = [f"{option.upper()}={value}" for option, value in given.items()]
        params = " ".join(["", *words])
    changes = {row.section: own}
    if row.section == "probe":
        # As that has it
        changes[Z] = {"samples_result": "none"}
    printer = start(row.scene, changes).homed()
    if row.scene == "membrane":
        printer.machine.lay_membrane()

    def run(more=params, go=printer.run):
        printer.run(row.before)
        return go(row.command + more)

    return printer, run


def break_down(printer, name):
    """The second touch triggers early."""
    row = ROWS[name]
    about = {"site": row.site, "command": row.command.split()[0]}
    printer.machine.break_down(
        Fault("trigger_early", touch=2, mm=EARLY, **about)
    )


def counted(printer, name, first):
    """The touches of the site for its height, but for those before."""
    site = ROWS[name].site
    return [
        touch
        for touch in printer.machine.truth.touches[first:]
        if touch.site == site
        # It is met below the nozzle, too, where nobody looks
        and (
            site != "inductive_bed"
            or (touch.x, touch.y) == pytest.approx(PROBE_PLACE, abs=0.02)
        )
    ]


def count(printer, name, run):
    """How often the site is touched for its height."""
    first = len(printer.machine.truth.touches)
    run()
    return len(counted(printer, name, first))


@each_case
def test_count(start, name, by):
    fixed = {} if by == "options" else {"samples": "2"}
    printer, run = sampled(start, name, by, fixed, samples="4")
    assert count(printer, name, run) == 4
    if by == "parameters":
        # For that command only
        assert count(printer, name, lambda: run("")) == 2


@pytest.mark.parametrize(
    ("result", "share"), [("average", 1 / 3), slow("median", 0)]
)
@each_case
def test_result(start, name, by, result, share):
    fixed = {"samples": "3", "samples_tolerance": "0.2"}
    if ROWS[name].section == AUTO:
        # The original module takes it
        result = result.upper()
    printer, run = sampled(start, name, by, fixed, samples_result=result)
    good = ROWS[name].height(printer, run())
    break_down(printer, name)
    off = ROWS[name].height(printer, run()) - good
    assert off == pytest.approx(share * EARLY, abs=2 * MICROSTEP)


@each_case
def test_tolerance_and_retries(start, name, by):
    row, fixed = ROWS[name], {"samples": "3"}
    limits = {"samples_tolerance": "0.05", "samples_tolerance_retries": "1"}
    printer, run = sampled(start, name, by, fixed, **limits)
    good = row.height(printer, run())
    break_down(printer, name)
    lines = run()
    again = [line for line in lines if re.search("trying", line, re.I)]
    assert len(again) == 1
    assert row.height(printer, lines) == pytest.approx(good, abs=2 * MICROSTEP)
    limits["samples_tolerance_retries"] = "0"
    printer, run = sampled(start, name, by, fixed, **limits)
    break_down(printer, name)
    text = run(go=printer.fail)
    # Older hosts sample a dock's probe themselves, and say so in their own words
    if row.section == DOCK and text == "Probe samples exceed samples_tolerance":
        return
    # A plunger does not come to rest to the micrometre
    words = (
        r"samples differ by 0\.0[56]\d\d mm, samples_tolerance is 0\.0500 mm; "
    )
    assert re.match(row.name + words, text)


# Options, in z_calibration under names of its own, parameters, usual values, others,
# and how much more time (s) is between two touches then
SPEEDS = [
    ("speed", "PROBE_SPEED", 2.0, 1.0, 3.0 / 1.0 - 3.0 / 2.0),
    ("lift_speed", "LIFT_SPEED", 10.0, 1.0, 3.0 / 1.0 - 3.0 / 10.0),
    (
        "sample_retract_dist",
        "SAMPLE_RETRACT_DIST",
        3.0,
        5.0,
        2 / 2.0 + 2 / 10.0,
    ),
]
OF_Z = {
    "speed": "probing_second_speed",
    "sample_retract_dist": "probing_retract_dist",
}
# What z_calibration has of [probe] depends on the axis, too
OWN = [case for case in CASES if ROWS[case[0]].section != "probe"]


@pytest.mark.parametrize(("name", "by"), [marked(*case) for case in OWN])
def test_speeds_and_the_lift_between(start, name, by):
    row = ROWS[name]
    own = OF_Z if row.section == Z else {}
    usual = {own.get(option, option): str(at) for option, _, at, *_ in SPEEDS}
    usual["samples"] = "2"

    def span(run, *params):
        first = len(printer.machine.truth.touches)
        run(*params)
        one, two = counted(printer, name, first)
        return two.t - one.t

    printer, run = sampled(start, name, "options", usual)
    before = span(run)
    for option, param, _, value, more in SPEEDS:
        if by == "options":
            changed = {**usual, own.get(option, option): str(value)}
            printer, run = sampled(start, name, by, changed)
            found = span(run)
        else:
            found = span(run, f" {param}={value}")
        assert found - before == pytest.approx(more, abs=0.25), option
