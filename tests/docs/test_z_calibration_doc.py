"""docs/z_calibration.md says what z_calibration.py does, no more, no less.

The tests at the end show that every check finds what is wrong in changed
copies of the two texts.
"""

from __future__ import annotations

import configparser
import re
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Optional

import pytest

from tests.docs.documents import (
    OPTIONS,
    Anything,
    Change,
    Option,
    Section,
    Source,
    command_problems,
    constant_problems,
    ini_blocks,
    known_option_problems,
    link_problems,
    literal_problem,
    message_problems,
    messages,
    normal,
    option_name_problems,
    options_of,
    parameters,
    part,
    phases,
    range_problems,
    rows,
    spans,
    status_problems,
    template,
    told_by_module,
)
from tests.docs.documents import load as load_module
from tests.docs.z_calibration_picture import EXAMPLE, PICTURE, draw
from tests.hostkit.printer import Printer

ROOT = Path(__file__).resolve().parents[2]
MODULE = ROOT / "z_calibration.py"
DOCUMENT = ROOT / "docs" / "z_calibration.md"
OLD_NAMES = "Old names"

load = partial(load_module, "z_calibration")

# The document


def documented_options(text: str) -> list[Option]:
    """Options that are not old names."""
    return options_of(part(text, OPTIONS).replace(part(text, OLD_NAMES), ""))


def documented_old_names(text: str) -> dict[str, str]:
    """Old name -> new name."""
    return {spans(r[0])[0]: spans(r[1])[0] for r in rows(part(text, OLD_NAMES))}


# The module

AXIS = {
    "endstop_pin": "PA1",
    "position_endstop": "1.9",
    "position_min": "-2.0",
    "homing_speed": "7.25",
    "second_homing_speed": "3.125",
    "homing_retract_dist": "2.75",
}
PROBE = {
    "samples": 4,
    "samples_tolerance": 0.011,
    "samples_tolerance_retries": 5,
    "samples_result": "average",
    "speed": 4.5,
    "sample_retract_dist": 1.75,
    "lift_speed": 9.5,
    "z_offset": 6.9,
}


class Loaded(NamedTuple):
    """What became of a configuration."""

    section: Section
    settings: Any
    lines: list[str]


def configure(
    source: Source,
    own: Optional[dict[str, str]] = None,
    axis: Optional[dict[str, str]] = None,
    probe: Optional[dict[str, Any]] = None,
    **others: dict[str, str],
) -> Loaded:
    """The module as the host loads it, completed by axis and probe."""
    sections = {
        "z_calibration": own or {},
        "stepper_z": {**AXIS, **(axis or {})},
        **others,
    }
    section = Section("z_calibration", sections)
    plugin = source.module.load_config(section)
    given = {**PROBE, **(probe or {})}
    sampling = source.module.Sampling(
        samples=given["samples"],
        tolerance=given["samples_tolerance"],
        retries=given["samples_tolerance_retries"],
        result=given["samples_result"],
        speed=given["speed"],
        retract_dist=given["sample_retract_dist"],
        lift_speed=given["lift_speed"],
    )
    settings = source.module.complete(
        plugin.settings, sampling, given["z_offset"], 280.0
    )
    return Loaded(section, settings, plugin.old_names.lines)


# Where the value of an option ends up; None: not among the settings
PLACES: dict[str, Optional[str]] = {
    "nozzle_xy_position": "nozzle",
    "switch_xy_position": "switch",
    "bed_xy_position": None,  # completed when a command asks for it
    "wiggle_xy_offsets": "wiggle",
    "probing_second_speed": "pin.speed",
    "probing_retract_dist": "pin.retract_dist",
    "lift_speed": "pin.lift_speed",
    "samples": "pin.samples",
    "samples_tolerance": "pin.tolerance",
    "samples_tolerance_retries": "pin.retries",
    "samples_result": "pin.result",
    "probing_first_fast": "first_fast",
    "endstop_pin": None,
}


def example_result(source: Source) -> Any:
    """The run of the picture as the module keeps it."""
    return source.module.Result(**EXAMPLE._asdict(), offset=EXAMPLE.offset)


def value_of(settings: Any, name: str) -> Any:
    place = PLACES.get(name, name)
    assert place is not None
    for attribute in place.split("."):
        settings = getattr(settings, attribute)
    if hasattr(settings, "origin"):
        return settings.x, settings.y
    return settings


# (a) Options

# A changed value for what a default comes from
CHANGED = {
    "samples": 9,
    "samples_tolerance_retries": 9,
    "samples_result": "median",
    "home_xy_position": "1.5,2.5",
    "z_offset": 4.25,
}


def wrong_option_names(code: str, text: str) -> list[str]:
    written = [option.name for option in documented_options(text)]
    written += documented_old_names(text)
    return option_name_problems(configure(load(code)).section.read, written)


def wrong_known_options(code: str, _: str) -> list[str]:
    source = load(code)
    read = configure(source).section.read
    return known_option_problems(
        "z_calibration",
        source.module.OPTIONS,
        read,
        partial(configure, source),
    )


def wrong_defaults(code: str, text: str) -> list[str]:
    source = load(code)
    found = [
        f"{option.name}: {problem}"
        for option in documented_options(text)
        for problem in [default_problem(source, option)]
        if problem
    ]
    # [safe_z_home] says where the other endstop is
    apart = configure(
        source,
        {"endstop_pin": "PA2"},
        safe_z_home={"home_xy_position": "1.5,2.5"},
    )
    if apart.settings.nozzle is not None:
        found.append(f"with endstop_pin: {apart.settings.nozzle}")
    if "must be given" not in own_pin_row(text):
        found.append("endstop_pin: what must be given with it")
    return found


def own_pin_row(text: str) -> str:
    (row,) = [r for r in rows(part(text, OPTIONS)) if "`endstop_pin`" in r[0]]
    return row[-1]


def default_problem(source: Source, option: Option) -> str:
    found = configure(source)
    if option.name in found.section.templates | {"offset_gcode", "error_gcode"}:
        return "" if option.default == "-" else "templates have no default"
    if PLACES.get(option.name, "") is None:
        return ""
    value = value_of(found.settings, option.name)
    if option.default == "-":
        return "" if value is None else f"is {value}"
    if " of " not in option.default:
        return literal_problem(option.default, value)
    name, section = spans(option.default)
    changed = CHANGED.get(name, 1.5)
    if section == "[stepper_z]":
        other = configure(source, axis={name: str(changed)})
    elif section == "[probe]":
        other = configure(source, probe={name: changed})
    else:
        others = {section.strip("[]"): {name: str(changed)}}
        other = configure(source, **others)
    new = value_of(other.settings, option.name)
    if name == "home_xy_position":
        changed = (1.5, 2.5)
    elif option.default.startswith("twice"):
        changed *= 2.0
    return "" if new == changed else f"is {new} with {changed} there"


def wrong_ranges(code: str, text: str) -> list[str]:
    ranges = {o.name: o.range for o in documented_options(text)}
    for row in rows(part(text, OLD_NAMES)):
        ranges[spans(row[0])[0]] = row[2]

    def besides(name: str) -> dict[str, str]:
        if match := re.fullmatch("(probe_.*_)([xy])", name):
            return {match[1] + "yx"["xy".index(match[2])]: "1"}
        return {}

    return range_problems(ranges, partial(configure, load(code)), besides)


def wrong_old_names(code: str, text: str) -> list[str]:
    source = load(code)
    told = set()
    for old, new in documented_old_names(text).items():
        options = {old: "0.5"}
        if old.startswith("probe_"):
            options = {old[:-1] + axis: "0.5" for axis in "xy"}
        told |= {
            (old, new)
            for line in configure(source, options).lines
            if f"'{old}'" in line and f"'{new}" in line
        }
    return [
        f"{old} is not told as {new}"
        for old, new in documented_old_names(text).items()
        if (old, new) not in told
    ]


# (b) Commands


def asking(called: str, text: str) -> str:
    """The parameter that a call asks the command for."""
    if called == "self.site_param":
        return text.upper() + "_POSITION"
    return text if called in ("self.param", "number", "gcmd.get") else ""


def wrong_commands(code: str, text: str) -> list[str]:
    source = load(code)
    return command_problems(
        text,
        configure(source).section.commands,
        lambda name: parameters(source, "ZCalibration", name, asking),
    )


# (c) Status


def status(source: Source) -> dict[str, Any]:
    zc = source.module
    plugin = zc.ZCalibration.__new__(zc.ZCalibration)
    plugin.last_result = example_result(source)
    plugin.frame = Anything()
    plugin.mark = None
    plugin.watch = zc.Watch(print)
    return plugin.get_status(0.0)


def wrong_status(code: str, text: str) -> list[str]:
    source = load(code)
    fields = status(source)
    words = {
        "last_result": set(fields.get("last_result", ())),
        "phase": phases(source),
    }
    return status_problems(text, fields, words)


# (d) Messages


def wrong_messages(code: str, text: str) -> list[str]:
    return message_problems(text, messages(load(code)))


# (e) Numbers


def wrong_constants(code: str, text: str) -> list[str]:
    source = load(code)
    found = constant_problems(source, text)
    least = source.module.UNMEASURED_PROBE + source.module.TRAVEL_MARGIN
    if f"at least {least:g} mm above the pin" not in normal(text):
        found.append("height of the first run over the pin")
    return found + wrong_plain_commands(source, text)


# Every numbered command that a host or a macro may have, and words
COMMANDS_TO_TRY = (
    *(f"{letter}{number}" for letter in "GMT" for number in range(1000)),
    *("G00", "G01", "G1.1", "G38.2", "ATTACH_PROBE", "SET_SERVO", "G", "M"),
)


def wrong_plain_commands(source: Source, text: str) -> list[str]:
    """The commands that attach no probe, tried one by one."""
    sentence = re.search(r"more than (.*?), and not", normal(text))
    if not sentence:
        return ["the sentence of the commands that attach no probe"]
    written = spans(sentence[1])
    found = [f"never tried: {n}" for n in set(written) - set(COMMANDS_TO_TRY)]
    found += [f"twice: {n}" for n in written if written.count(n) > 1]
    for command in COMMANDS_TO_TRY:
        forms = [command, f" {command} X1 Y2 ; as it was", f"\n{command}\n\n"]
        # "G1X10" is a G1, "ATTACH_PROBEX10" another macro
        forms += [f"{command}X10", f"{command} ATTACH_PROBE", "; " + command]
        for form in (*forms, *map(str.lower, forms)):
            plain = command in written or form.startswith(";")
            if source.module.attaches_probe(form, "") is plain:
                found.append(
                    f"attaches {'a' if plain else 'no'} probe: {form!r}"
                )
                break
    return found


def wrong_floors(code: str, text: str) -> list[str]:
    """The examples of the table of floors."""
    source = load(code)
    zc = source.module
    settings = configure(source, {"switch_offset": "0.44"}).settings
    apart = settings._replace(position_endstop=None)
    last = example_result(source)
    nozzle, switch = EXAMPLE.nozzle, EXAMPLE.switch

    def of_nozzle(chosen: Any, last: Any, sure: bool = True) -> float:
        expected = zc.expect_nozzle(chosen, last, sure and last is not None)
        return zc.nozzle_floor(chosen, expected)

    def of_switch(last: Any) -> float:
        sure = last is not None
        expected = zc.expect_switch(settings, nozzle, last, sure)
        return zc.switch_floor(settings, nozzle, expected)

    bed = zc.bed_floor(settings, nozzle, switch)
    look = zc.unmeasured_bed_floor(settings, nozzle)
    expected = [
        [of_nozzle(settings, None), of_nozzle(settings, last)],
        [of_nozzle(apart, None), of_nozzle(apart, last)],
        [of_switch(None), of_switch(last)],
        [bed, bed],
        [look, look],
    ]
    table = rows(part(text, "How low can a touch go?"))
    written = [[float(row[2]), float(row[4])] for row in table]
    found = [
        f"row {number + 1}: {real}, not {shown}"
        for number, (real, shown) in enumerate(zip(expected, written))
        if real != pytest.approx(shown, abs=1e-9)
    ] + ["number of rows"] * (len(expected) != len(written))
    # What the table says in words
    wide = {"offset_margins": (-1.5, 1.0)}
    known = of_nozzle(apart._replace(**wide), last, False)
    if known != pytest.approx(nozzle - 1.5):
        found.append(f"pin of its own after homing again: {known}")
    for above, raised in ((0.3, 0.3), (-0.3, 0.0)):
        real = zc.unmeasured_bed_floor(settings, nozzle + above)
        if real != pytest.approx(look + raised):
            found.append(f"look with a nozzle {above} higher: {real}")
    return found


def wrong_example(code: str, text: str) -> list[str]:
    """Formula, terms and console are one run: that of the picture."""
    source = load(code)
    zc = source.module
    parts = (EXAMPLE.probe, EXAMPLE.switch, EXAMPLE.nozzle)
    offset = zc.offset(*parts, EXAMPLE.switch_offset)
    result = (*parts, EXAMPLE.switch_offset, offset)
    terms = {
        r[0]: float(r[1])
        for r in rows(part(text, "What is measured?"))
        if len(r) == 3
    }
    real = {**EXAMPLE._asdict(), "offset": offset}
    real["switch - nozzle"] = EXAMPLE.switch - EXAMPLE.nozzle
    found = [
        f"{name} is {real.get(name)}"
        for name, value in terms.items()
        if real.get(name) != pytest.approx(value, abs=1e-9)
    ]
    found += [f"term: {name}" for name in set(terms) ^ set(real)]
    hint = (parts[2], offset, parts[2] - offset)
    corrected = zc.corrected_switch_offset(0.44, offset + 0.05, offset)
    calculation = (0.44, offset + 0.05, offset, corrected)
    for start, values in (
        ("Z-CALIBRATION:", result),
        ("HINT:", hint),
        ("switch_offset=", calculation),
    ):
        shown = template(source, start) % values
        if shown not in text:
            found.append(f"console: {shown}")
    formula = "{:.3f} = {:.3f} - ({:.3f} - {:.3f} + {:.3f})"
    if formula.format(offset, *result[:4]) not in normal(text):
        found.append("formula")
    return found


# (f) Picture, (g) links


def wrong_links(_: str, text: str) -> list[str]:
    return link_problems(text, DOCUMENT, PICTURE)


CHECKS = (
    wrong_option_names,
    wrong_known_options,
    wrong_defaults,
    wrong_ranges,
    wrong_old_names,
    wrong_commands,
    wrong_status,
    wrong_messages,
    wrong_constants,
    wrong_floors,
    wrong_example,
    wrong_links,
)


@pytest.fixture(scope="module")
def code() -> str:
    return MODULE.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def text() -> str:
    return DOCUMENT.read_text(encoding="utf-8")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_document_is_right(check, code, text):
    assert check(code, text) == []


def test_picture_is_what_the_script_draws():
    assert PICTURE.read_bytes() == draw(EXAMPLE).encode("utf-8")


def test_picture_follows_the_numbers():
    assert draw(EXAMPLE) != draw(EXAMPLE._replace(nozzle=1.95))
    assert "prefers-color-scheme:dark" in draw(EXAMPLE)


def test_complete_configuration_of_the_document_is_read(code, text):
    (block,) = re.findall(r"```ini\n(\[z_calibration\].*?)```", text, re.DOTALL)
    parser = configparser.ConfigParser(delimiters=":")
    parser.read_string(block)
    own = dict(parser["z_calibration"])
    loaded = configure(load(code), own)
    assert set(own) <= loaded.section.read
    assert loaded.lines == []


# What the sections of the document take for granted
SURROUNDINGS: dict[str, dict[str, str]] = {
    "respond": {},
    "display_status": {},
    "stepper_z": {"position_endstop": f"{EXAMPLE.nozzle}"},
    **{
        f"gcode_macro {name}": {"gcode": "G4 P1"}
        for name in (
            "ATTACH_PROBE",
            "DOCK_PROBE",
            "CLEAN_NOZZLE",
            "QUAD_GANTRY_LEVEL",
        )
    },
}


def test_examples_are_those_of_a_run(one_host, text):
    changes = {**ini_blocks(text), **SURROUNDINGS}
    blocks = re.findall(r"```\n> (.*?)\n(.*?)```", text, re.DOTALL)
    shown = {command: answer.splitlines() for command, answer in blocks}
    accuracy = "PROBE_Z_ACCURACY SAMPLES=3"
    with Printer(one_host, "voron", changes) as printer:
        printer.homed()
        for command in (accuracy, "CALIBRATE_Z"):
            answer = told_by_module(printer.run(command))
            assert answer == told_by_module(shown[command])
        answer = printer.run("CALIBRATE_Z_IF_NEEDED")
        assert answer == [
            "echo: offset 0.46 holds, measured with switch_offset 0.44"
        ]
        printer.run("G28 Z")
        answer = printer.run("CALIBRATE_Z_IF_NEEDED")
        assert answer[0] == "echo: calibrating: Z was homed again"
        printed = printer.run("PRINT_START BED=40 EXTRUDER=160")
        assert told_by_module(shown["CALIBRATE_Z"])[-1] in printed


# What is changed in the document, and which check has to see it
CHANGES_OF_TEXT = {
    "option left out": (
        wrong_option_names,
        r"(?m)^\| `travel_margin`.*\n",
        "",
    ),
    "option too many": (
        wrong_option_names,
        "`travel_margin` \\|",
        "`margin` |",
    ),
    "default": (wrong_defaults, "\\| `50.0` \\|", "| `60.0` |"),
    "default of another section": (
        wrong_defaults,
        "\\| `second_homing_speed` of",
        "| `homing_speed` of",
    ),
    "default of the probe": (
        wrong_defaults,
        "\\| `samples_result` of",
        "| `samples` of",
    ),
    "no default": (wrong_defaults, "\\| `false` \\|", "| - |"),
    "range": (wrong_ranges, "mm/s, > 0", "mm/s, ≥ 0"),
    "count": (wrong_ranges, "count, ≥ 1", "count, ≥ 0"),
    "kind of range": (wrong_ranges, "low, high in mm", "some mm"),
    "old name": (
        wrong_old_names,
        "`max_deviation` \\| `offset_margins`",
        "`max_deviation` | `safe_z_height`",
    ),
    "command": (wrong_commands, "### PROBE_Z_ACCURACY", "### PROBE_Z"),
    "parameter left out": (wrong_commands, r"(?m)^\| `ACCEPT_CHANGE`.*\n", ""),
    "parameter too many": (wrong_commands, "\\| `SAVE` ", "| `SAVE_NOW` "),
    "field": (wrong_status, "\\| `reason` ", "| `why` "),
    "part of the result": (wrong_status, "`probe`, `switch`,", "`probe`,"),
    "phase": (wrong_status, "`before_switch_gcode`, `switch`", "`switch`"),
    "field in the macro": (wrong_status, "z.reason", "z.why"),
    "message left out": (wrong_messages, r"(?m)^\| `trying again`.*\n", ""),
    "word of a message": (wrong_messages, "is far from", "is away from"),
    "message too many": (
        wrong_messages,
        r"(?m)^\| `trying again`.*\n",
        r"\g<0>| `giving up` | it is | nothing |\n",
    ),
    "constant": (wrong_constants, r"`STALE_Z` \| 0.5", "`STALE_Z` | 0.4"),
    "constant left out": (wrong_constants, r"(?m)^\| `STALE_Z`.*\n", ""),
    "constant in a sentence": (
        wrong_constants,
        r"`GEOMETRY_JUMP` \(0.5 mm\)",
        "`GEOMETRY_JUMP` (0.6 mm)",
    ),
    "height of the first run": (wrong_constants, "least 11 mm", "least 10 mm"),
    "commands that move": (wrong_constants, "`G90`, ", ""),
    "too many commands that move": (
        wrong_constants,
        "`G90`, ",
        r"\g<0>`G28`, ",
    ),
    "sentence of the commands": (
        wrong_constants,
        ", and not the same",
        " and not the same",
    ),
    "place of a pin of its own": (
        wrong_defaults,
        "must be given \\|",
        "helps |",
    ),
    "floor": (wrong_floors, "5.855", "5.955"),
    "term": (wrong_example, r"\| 6.415 \|", "| 6.515 |"),
    "console": (wrong_example, "new offset=0.460000", "new offset=0.470000"),
    "formula": (wrong_example, r"\+ 0.440\)", "+ 0.450)"),
    "link": (wrong_links, r"\(#tuning\)", "(#tuneing)"),
    "picture": (wrong_links, r"\(z_calibration.svg\)", "(z.svg)"),
}


@pytest.mark.parametrize("name", CHANGES_OF_TEXT)
def test_change_of_the_document_is_noticed(name, code, text):
    change = Change(*CHANGES_OF_TEXT[name])
    assert change.check(code, change.of(text))


# And what is changed in the module
CHANGES_OF_CODE = {
    "option": (wrong_option_names, '"travel_margin", parse', '"margin", parse'),
    "option not known": (wrong_known_options, '    "position_min",\n', ""),
    "option not read": (
        wrong_known_options,
        '    "position_min",\n',
        r'\g<0>    "position_max",\n',
    ),
    "option known twice": (
        wrong_known_options,
        '    "position_min",\n',
        r"\g<0>\g<0>",
    ),
    "unknown options": (wrong_known_options, "        check_options.*\n", ""),
    "no suggestion": (
        wrong_known_options,
        "remedy = .is .* else .*",
        "remedy = 'remove it'",
    ),
    "default": (wrong_defaults, "TRAVEL_SPEED = 50.0", "TRAVEL_SPEED = 60.0"),
    "place of a pin of its own": (
        wrong_defaults,
        "if site is not None or host.endstop_pin is not None:",
        "if site is not None:",
    ),
    "range": (
        wrong_ranges,
        '"lift_speed", parse_positive',
        '"lift_speed", parse_not_negative',
    ),
    "old name": (
        wrong_old_names,
        'text_of\\("clearance", "safe_z_height"\\)',
        'text_of("clearance", "safe_z")',
    ),
    "command": (wrong_commands, '"PROBE_Z_ACCURACY",', ""),
    "parameter": (wrong_commands, '"ACCEPT_CHANGE"', '"ACCEPT"'),
    "field": (wrong_status, '"valid": not reason', '"is_valid": not reason'),
    "phase": (wrong_status, 'watch.enter\\("bed"\\)', 'watch.enter("plate")'),
    "message": (wrong_messages, "before the head moved", "before it moved"),
    "message too many": (wrong_messages, "\\Z", '\nNEW = "who reads this"\n'),
    "constant": (wrong_constants, "STALE_Z = 0.5", "STALE_Z = 0.6"),
    "constant too many": (wrong_constants, "\\Z", "\nNEW_ONE = 1.0\n"),
    "command that moves": (wrong_constants, r"\|M204", ""),
    "another command that moves": (wrong_constants, r"\|M204", r"\g<0>|M205"),
    "more digits": (wrong_constants, r"\(\?!\[0-9.\]\)", ""),
    "spelling": (wrong_constants, ", re.IGNORECASE", ""),
    "comments": (wrong_constants, r'line.split\(";"\)\[0\]', "line"),
    "empty lines": (wrong_constants, r" if line\.strip\(\)\]", "]"),
    "floor": (
        wrong_floors,
        "gap \\+ settings.offset_margins\\[0\\]\\)",
        "gap)",
    ),
    "floor of a pin of its own": (
        wrong_floors,
        "homed_z = expected.z",
        r"\g<0> if expected.sure else None",
    ),
    "floor of a pin of its own, margins": (
        wrong_floors,
        "homed_z - reach",
        "homed_z - settings.travel_margin",
    ),
    "look with a nozzle that touched higher": (
        wrong_floors,
        "floor \\+= max",
        "floor -= max",
    ),
    "formula": (
        wrong_example,
        "return probe - \\(switch",
        "return probe + (switch",
    ),
}


@pytest.mark.parametrize("name", CHANGES_OF_CODE)
def test_change_of_the_module_is_noticed(name, code, text):
    change = Change(*CHANGES_OF_CODE[name])
    assert change.check(change.of(code), text)
