"""docs/<module>.md says what the module does, no more, no less.

A real klippy is asked which options, commands, parameters, fields and phases
there are, loads every default and range, and runs every example; numbers with
names are those of the sources, and messages.md has a test of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.docs.documents import (
    COMMANDS,
    DOCS,
    NUMBERS,
    OPTIONS,
    STATUS,
    Option,
    headings,
    link_problems,
    names,
    normal,
    options_of,
    part,
    rows,
    samples_of,
    shown_answers,
    spans,
    text_of,
)
from tests.docs.pictures import numbers
from tests.docs.records import AUTO_Z_OFFSET, MODULES, SHOWN, Z_CALIBRATION
from tests.docs.running import Options, Running, Step, differ
from tests.docs.sources import all_constants, constants
from tools.kit.auto_z_offset import POINT

FLOORS = "How low can a touch go?"
BRAKING = "How deep does a dead sensor let the nozzle go?"
# Of a board, and of no section
FREE_PIN = "^PC7"
# What is left of a number with three digits behind the point
ROUNDED = 6e-4

Found = Iterator[str]


def unlike(what: str, written: set[str], real: set[str]) -> Found:
    """What is only in one of the two."""
    yield from (f"{what}: not in the module: {n}" for n in written - real)
    yield from (f"{what}: not in the document: {n}" for n in real - written)


# Options


def documented_options(running: Running, text: str) -> list[Option]:
    """Options that are not those of other releases."""
    old = part(text, running.module.old)
    return options_of(part(text, OPTIONS).replace(old, ""))


def old_options(running: Running, text: str) -> dict[str, list[str]]:
    """Options of other releases: the cells that follow."""
    found = rows(part(text, running.module.old))
    return {spans(row[0])[0]: row[1:] for row in found}


def old_givens(name: str, cells: list[str]) -> list[dict[str, Any]]:
    """How to give an old option: with its twin, without its new name."""
    new = spans(cells[0])[:1] if cells[0].startswith("`") else []
    twin = {"_x": "_y", "_y": "_x"}.get(name[-2:])
    names_given = [name, name[:-2] + twin] if twin else [name]
    values = ["1"]
    if new:
        is_pin = cells[1] == "MCU pin"
        values = [FREE_PIN] if is_pin else samples_of(cells[1])[0]
    return [
        {**dict.fromkeys(new), **dict.fromkeys(names_given, value)}
        for value in values
    ]


def wrong_options(running: Running, text: str) -> Found:
    options = documented_options(running, text)
    written = [option.name for option in options]
    old = old_options(running, text)
    written += old
    # Some are only looked for where they are given
    for given in ({}, *(g for item in old.items() for g in old_givens(*item))):
        running.load(**given)
    asked = running.asked[running.module.name]
    yield from unlike("option", set(written), asked)
    for name in written:
        if written.count(name) > 1:
            yield f"option twice: {name}"


def given_default(running: Running, option: Option) -> str:
    """The documented default as one would write it; empty: there is none."""
    words = spans(option.default)
    if option.default == "-" or len(words) not in (1, 2):
        return ""
    if len(words) == 1:
        return words[0]
    section = running.load().file["settings"].get(words[1].strip("[]"), {})
    value = section.get(words[0], "not there")
    if option.default.startswith("twice "):
        value *= 2.0
    return ", ".join(map(str, value if isinstance(value, list) else [value]))


def wrong_defaults(running: Running, text: str) -> Found:
    """Options that are given as their defaults change nothing."""
    plain, late = running.load(), running.module.late
    own = plain.file["settings"][running.module.name]
    options = documented_options(running, text)
    givens = {}
    for option in options:
        if option.name in late:
            if option.default != late[option.name]:
                yield f"{option.name}: default {option.default}"
        elif value := given_default(running, option):
            givens[option.name] = value
        elif own.get(option.name) and option.name not in running.module.given:
            yield f"{option.name}: is {own[option.name]} by default"
    whole = running.load(**givens)
    if whole.error:
        yield f"the defaults: {whole.error}"
    elif not differ(plain, whole):
        return
    for name, value in givens.items():
        given = running.load(**{name: value})
        (words,) = [o.range for o in options if o.name == name]
        # An option may count elsewhere, too, once it is given
        own_places = {
            place
            for other in samples_of(words)[0]
            for place in differ(plain, running.load(**{name: other}))
        }
        if own_places <= differ(plain, given):
            yield f"{name}: {value} is not the default"


def wrong_ranges(running: Running, text: str) -> Found:
    """What a range has is taken, and makes a difference.

    What it excludes is given to the hosts by tests/modules.
    """
    for option in documented_options(running, text):
        values, refused = samples_of(option.range)
        if refused:
            givens = [{option.name: value} for value in values]
            yield from taken(running, option.name, givens)
        elif option.range not in ("G-code", "MCU pin", "folder"):
            yield f"{option.name}: a range of no known kind: {option.range}"


def taken(running: Running, name: str, givens: list[dict]) -> Found:
    """Whether each may be given, and whether one makes a difference."""
    loads = [running.load(**given) for given in givens]
    for given, load in zip(givens, loads):
        if load.error:
            yield f"{given}: {load.error}"
    if not any(differ(running.load(), load) for load in loads):
        yield f"{name}: makes no difference"


def wrong_old_options(running: Running, text: str) -> Found:
    """Klippy says of each what the document says; a new name works as well."""
    for name, cells in old_options(running, text).items():
        givens = old_givens(name, cells)
        words = re.match(r"`?([\w ]+)", cells[0])[1]
        if words in givens[0]:
            yield from taken(running, name, givens)
        for line in running.load(**givens[0]).said:
            if f"'{name}'" in line and words in line:
                break
        else:
            yield f"{name}: klippy does not say {words!r}"


# Commands, status


def wrong_commands(running: Running, text: str) -> Found:
    """Commands with a heading of their own, and the parameters below it."""
    section = part(text, COMMANDS)
    documented = {title for _, title, _ in headings(section)}
    yield from unlike("command", documented, running.commands)
    running.example(text)
    for name in sorted(documented):
        asked = running.asked.get(name, set())
        yield from unlike(f"{name}, parameter", names(part(text, name)), asked)


def wrong_status(running: Running, text: str) -> Found:
    status = running.status(text)
    section = part(text, STATUS)
    table = {spans(row[0])[0]: row[1] for row in rows(section)}
    yield from unlike("field", set(table), set(status))
    for field, real in (
        ("phase", running.phases | running.module.phases | {"idle"}),
        ("last_result", set(status["last_result"])),
    ):
        yield from unlike(field, set(spans(table.get(field, ""))), real)
    (macro,) = re.findall(r"```ini\n(.*?)```", section, re.DOTALL)
    for name, below in re.findall(r"\bz\.(\w+)(?:\.(\w+))?", macro):
        if name not in status or (below and below not in status[name]):
            yield f"the macro uses {name}.{below}"


# Sources


def as_floats(
    constant: tuple[str, tuple[float, ...]],
) -> tuple[str, tuple[float, ...]]:
    """A number with its name, as the table has it: 3 as 3.0."""
    name, value = constant
    return name, tuple(map(float, value))


def wrong_constants(running: Running, text: str) -> Found:
    """The table of built-in numbers, and where they are named in a sentence."""
    real = all_constants(running.module.name)
    table = {
        (spans(row[0])[0], tuple(float(word) for word in row[1].split(",")))
        for row in rows(part(text, NUMBERS))
    }
    yield from unlike(
        "constant", set(map(str, table)), {str(as_floats(c)) for c in real}
    )
    for name, number in re.findall(r"`([A-Z_]+)`\s+\((-?[\d.]+) mm\)", text):
        if (name, (float(number),)) not in real:
            yield f"{name} is not {number}"
    names_of_real = {name for name, _ in real}
    for name in set(re.findall(r"`([A-Z]+_[A-Z_]+)` \(", text)):
        if name not in names_of_real:
            yield f"there is no {name}"


# The run of the picture


def wrong_answers(running: Running, text: str) -> Found:
    """What the console shows, and the status after it."""
    shown = shown_answers(text)
    steps = zip(running.module.steps.items(), running.example(text))
    for (script, wanted), step in steps:
        if wanted == SHOWN:
            lines = [x for x in shown.pop(script, []) if "probe at " not in x]
            # What Klipper says of each motor around each touch is left out
            answer = [x for x in step.answer if "Run Current: " not in x]
            if answer != lines:
                yield f"{script}: {step.answer}"
        elif wanted and wanted not in step.answer:
            yield f"{script}: {step.answer}"
    yield from (f"not run: {script}" for script in shown)


def filled(formula: str, values: dict[str, float]) -> str:
    """A formula with numbers for its names, which may have spaces for _."""
    for name in sorted(values, key=len, reverse=True):
        pattern = rf"\b{name.replace('probe_z', 'probe z')}\b"
        formula = re.sub(pattern, f"{values[name]:.3f}", formula)
    return formula


def wrong_terms(running: Running, text: str) -> Found:
    """The table of heights is the picture, and the picture is the run."""
    shown = numbers(running.module.name)
    result = running.result(text)
    for name, value in result.items():
        if shown.get(name) != pytest.approx(value, abs=1e-6):
            yield f"the picture: {name} is {value}"
    table = rows(part(text, "What is measured?"))
    terms = {row[0]: row[1] for row in table if len(row) == 3}
    for term, number in terms.items():
        value = eval(filled(term, result))
        if float(number) != pytest.approx(value):
            yield f"{term} is {value}"
    plain = {t.replace("probe z", "probe_z") for t in terms if " - " not in t}
    yield from unlike("term", plain, set(result))


def wrong_formulas(running: Running, text: str) -> Found:
    """Below a formula the same with numbers, which have to be right."""
    result = running.result(text)
    found = re.findall(r"```\n(\w.* = .*)\n([-\d].* = .*)\n```", text)
    real = [filled(formula, result) for formula, _ in found]
    complete = [line for line in real if not re.search("[a-z]", line)]
    written = [re.sub(r"\s+", "", numbers) for _, numbers in found]
    if not complete:
        yield "no formula of the result"
    for line in complete:
        if line.replace(" ", "") not in written:
            yield f"formula: {line}"
    for line in written:
        left, right = line.split("=")
        if float(left) != pytest.approx(eval(right)):
            yield f"formula: {line}"


# Floors


def floors_of(text: str, column: int) -> list[float]:
    """Examples of the table of floors; of a range of heights the lowest."""
    table = rows(part(text, FLOORS))
    return [float(row[column].split(" to ")[0]) for row in table]


def unlike_numbers(
    what: str, real: list[float], written: list[float], off: float = ROUNDED
) -> Found:
    """Numbers that the document does not have."""
    if real != pytest.approx(written, abs=off):
        yield f"{what}: {real}, not {written}"


def wrong_floors_of_pin(running: Running, text: str) -> Found:
    """z_calibration: where each touch of a run without a fault could end."""

    def runs(count: int, **changes: Options) -> list[Step]:
        own = {**running.module.surroundings, "stepper_z": low, **changes}
        return running.run(*["CALIBRATE_Z"] * count, changes=own)

    low = {"position_endstop": "1.9", "position_min": "-2"}
    common = running.example(text)
    apart = runs(
        2,
        duplicate_pin_override={"pins": "PC2"},
        z_calibration={"endstop_pin": "^PC2"},
    )
    unmeasured = runs(1, probe={"z_offset": "0"})
    # The bed is looked at before the switch
    look = unmeasured[0].floors["switch"][0]
    for number, column in ((0, 2), (1, 4)):
        floors, own_pin = common[number].floors, apart[number].floors
        nozzle, switch, bed = (
            min(floors[site]) for site in ("nozzle", "switch", "bed")
        )
        real = [nozzle, min(own_pin["nozzle"]), switch, bed, look]
        yield from unlike_numbers("floors", real, floors_of(text, column))


def wrong_first_height(running: Running, text: str) -> Found:
    """z_calibration: how high the first run travels over the pin."""
    known = constants(running.module.name)
    least = known["UNMEASURED_PROBE"][0] + known["TRAVEL_MARGIN"][0]
    if f"at least {least:g} mm above the pin" not in normal(text):
        yield f"the first run travels at least {least:g} mm above the pin"


def wrong_floors_of_bed(running: Running, text: str) -> Found:
    """auto_z_offset: the same, and up to where a trigger is believed."""
    first, second, corrected, accepted = running.run(
        "AUTO_Z_CALIBRATE",
        "AUTO_Z_PROBE",
        "G28\nAUTO_Z_PROBE",
        "AUTO_Z_PROBE ACCEPT_CHANGE=1",
        changes=running.plain,
    )
    sensor, again = first.floors["bed sensor"][:2]
    at = [s.floors["bed sensor"][0] for s in (accepted, corrected, second)]
    real = [sensor, *at, again, first.floors["probe"][0]]
    yield from unlike_numbers("floors", real, floors_of(text, 3))
    # As far above what is expected as below
    known, shown = constants("auto_z_offset"), numbers("auto_z_offset")
    (above,) = known["ABOVE_PROBE"]
    table = rows(part(text, FLOORS))
    high = [float(row[3].split(" to ")[1]) for row in table if " to " in row[3]]
    mirrored = [2 * shown["sensor"] - z for z in (*at[1:], again)]
    yield from unlike_numbers(
        "triggers", [shown["probe"] + above, *mirrored], high
    )


def wrong_rooms(running: Running, text: str) -> Found:
    """auto_z_offset: what a dead sensor costs, by the formulas above it."""
    known = constants("auto_z_offset")
    (reserve,), (margin,) = known["BRAKING_RESERVE"], known["EXPECTED_MARGIN"]
    section = part(text, BRAKING)
    for formula in (
        f"room = speed^2 / (2 * acceleration) + {reserve:g}",
        f"highest speed = sqrt(2 * acceleration * {margin - reserve:g})",
    ):
        if formula not in section:
            yield formula
    for row in rows(section):
        speed, accel, fastest, room = map(float, row)
        highest = min(speed, math.sqrt(2.0 * accel * (margin - reserve)))
        yield from unlike_numbers("speed", [highest], [fastest], 6e-3)
        needed = highest**2 / (2.0 * accel) + reserve
        yield from unlike_numbers("room", [needed], [room])


def wrong_gap(running: Running, text: str) -> Found:
    """auto_z_offset: the true gap of the picture, in the middle of the axes."""
    gap = running.gap("AUTO_Z_CALIBRATE", POINT)
    wanted = numbers("auto_z_offset")["true_gap"]
    # Two microsteps, and what is left of them
    yield from unlike_numbers("gap", [gap], [wanted], 6e-3)


def wrong_links(running: Running, text: str) -> Found:
    name = running.module.name
    yield from link_problems(text, DOCS / f"{name}.md")
    if f"]({name}.svg)" not in text:
        yield "the picture is not shown"


CHECKS = (
    wrong_options,
    wrong_defaults,
    wrong_ranges,
    wrong_old_options,
    wrong_commands,
    wrong_status,
    wrong_constants,
    wrong_answers,
    wrong_terms,
    wrong_formulas,
    wrong_links,
)
OWN_CHECKS = {
    Z_CALIBRATION.name: (wrong_floors_of_pin, wrong_first_height),
    AUTO_Z_OFFSET.name: (wrong_floors_of_bed, wrong_rooms, wrong_gap),
}


def problems(running: Running, text: str) -> Found:
    """All that is wrong in a document."""
    for check in (*CHECKS, *OWN_CHECKS.get(running.module.name, ())):
        yield from check(running, text)


@pytest.mark.slow
@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.name)
def test_document_is_right(host, module):
    text = text_of(module.name)
    with Running(host, module) as running:
        assert list(problems(running, text)) == []
