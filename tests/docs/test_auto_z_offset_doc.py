"""docs/auto_z_offset.md says what auto_z_offset.py does, no more, no less.

The tests at the end show that every check finds what is wrong in changed
copies of the two texts.
"""

from __future__ import annotations

import configparser
import math
import re
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple, Optional

import pytest

from tests.docs.auto_z_offset_picture import EXAMPLE, PICTURE, draw
from tests.docs.documents import (
    OPTIONS,
    VALUE,
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
    refusal,
    rows,
    spans,
    status_problems,
    template,
    told_by_module,
)
from tests.docs.documents import load as load_module
from tests.hostkit.printer import Printer

ROOT = Path(__file__).resolve().parents[2]
MODULE = ROOT / "auto_z_offset.py"
DOCUMENT = ROOT / "docs" / "auto_z_offset.md"
EXAMPLES = sorted((ROOT / "examples" / "auto_z_offset").glob("*.cfg"))
MIGRATION = "How do I migrate from the original module?"
BRAKING = "How deep does a dead sensor let the nozzle go?"
# Of the machine in the examples: mm/s^2, and its position_endstop in mm
MAX_ACCEL = 3000.0
HOMED_Z = 1.2
# What z_offset of its probe was changed to: mm
MOVED_Z_OFFSET = 1.05

load = partial(load_module, "auto_z_offset")

# The document


def documented_options(text: str) -> list[Option]:
    return options_of(part(text, OPTIONS))


def documented_old_options(text: str) -> list[str]:
    return [spans(row[0])[0] for row in rows(part(text, MIGRATION))]


# The module

REQUIRED = {"pin": "PC1", "prepare_gcode": ""}
AXIS = {"endstop_pin": "probe:z_virtual_endstop", "position_min": "-4"}


class Loaded(NamedTuple):
    """What became of a configuration."""

    section: Section
    plugin: Any


def configure(
    source: Source,
    own: Optional[dict[str, str]] = None,
    axis: Optional[dict[str, str]] = None,
    required: Optional[dict[str, str]] = None,
) -> Loaded:
    """The module as the host loads it; required: what goes without saying."""
    given = REQUIRED if required is None else required
    sections = {
        "auto_z_offset": {**given, **(own or {})},
        "stepper_z": {**AXIS, **(axis or {})},
        "probe": {"pin": "PF0"},
    }
    section = Section("auto_z_offset", sections)
    return Loaded(section, source.module.load_config(section))


# Where the value of an option ends up, in the object or below its settings
PLACES = {
    "probe_z_min": "floor.z",
    "z_current_factor": "current_factor",
    "samples": "sampling.samples",
    "samples_tolerance": "sampling.tolerance",
    "samples_tolerance_retries": "sampling.retries",
    "samples_result": "sampling.result",
    "sample_retract_dist": "sampling.retract_dist",
    "speed": "sampling.speed",
    "lift_speed": "sampling.lift_speed",
}


def value_of(plugin: Any, name: str) -> Any:
    if name == "probe_z_correction":
        return plugin.correction or 0.0
    value = plugin.settings
    for attribute in PLACES.get(name, name).split("."):
        value = getattr(value, attribute)
    return value


# (a) Options


def wrong_option_names(code: str, text: str) -> list[str]:
    written = [option.name for option in documented_options(text)]
    written += documented_old_options(text)
    return option_name_problems(configure(load(code)).section.read, written)


def wrong_known_options(code: str, _: str) -> list[str]:
    source = load(code)
    old = {name for name, _ in source.module.OLD_OPTIONS}
    read = configure(source).section.read
    found = known_option_problems(
        "auto_z_offset",
        source.module.OPTIONS,
        read - old,
        partial(configure, source),
    )
    for name in sorted(old):
        message = refusal(partial(configure, source), {f"{name}_": "1"})
        if not message.endswith("is not known; remove it"):
            found.append(f"misspelt: {name}: {message or 'is taken'}")
    return found


def wrong_defaults(code: str, text: str) -> list[str]:
    source = load(code)
    return [
        f"{option.name}: {problem}"
        for option in documented_options(text)
        for problem in [default_problem(source, option)]
        if problem
    ]


def default_problem(source: Source, option: Option) -> str:
    """What is wrong with the default of one option; empty: nothing."""
    if option.default == "-":
        rest = {k: v for k, v in REQUIRED.items() if k != option.name}
        try:
            configure(source, required=rest)
        except configparser.Error as error:
            return "" if "is missing" in str(error) else str(error)
        return "is not required"
    plugin = configure(source).plugin
    if option.default == "middle of the axes":
        limits = [(-5.0, 245.0), (-4.0, 258.0), (-4.0, 248.0)]
        plugin.host.axis_limits = lambda: limits
        site = plugin.bed_site()
        return "" if site[:2] == (120.0, 127.0) else f"is {site}"
    if " of " not in option.default:
        return literal_problem(option.default, value_of(plugin, option.name))
    name, section = spans(option.default)
    if (name, section) == ("z_offset", "[probe]"):
        correction = followed(source, {})
        changed = correction != EXAMPLE.correction
        return f"makes it {correction}" if changed else ""
    if section != "[stepper_z]":
        return f"comes from {section}"
    other = configure(source, axis={name: "-1.5"}).plugin
    value = value_of(other, option.name)
    return "" if value == -1.5 else f"is {value} with -1.5 there"


def wrong_ranges(code: str, text: str) -> list[str]:
    ranges = {o.name: o.range for o in documented_options(text)}
    return range_problems(ranges, partial(configure, load(code)))


def wrong_old_options(code: str, text: str) -> list[str]:
    """Every option of the original module is told of, and those only."""
    source = load(code)
    real = dict(source.module.OLD_OPTIONS)
    written = documented_old_options(text)
    found = [f"only in one: {name}" for name in set(real) ^ set(written)]
    happens = {spans(r[0])[0]: r[1] for r in rows(part(text, MIGRATION))}
    for name in set(real) & set(written):
        plugin = configure(source, {name: "1"}).plugin
        # "is not run: move ..." -> "not run"
        what = re.match(r"is (?:not run|ignored)", real[name])
        said = what[0][3:] if what else "ignored"
        if not happens[name].startswith(said):
            found.append(f"{name}: {real[name]}")
        if [f"option '{name}' {real[name]}"] != plugin.notes:
            found.append(f"{name}: klippy says {plugin.notes}")
        if plugin.lost_gcode != ("refuse to start" in happens[name]):
            found.append(f"{name}: refuses: {plugin.lost_gcode}")
    if configure(source, {"activate_gcode": ""}).plugin.lost_gcode:
        found.append("activate_gcode: refuses an empty one")
    if not configure(source, {"z_offset": "-0.1"}).plugin.notes:
        found.append("z_offset: nothing is said of a negative one")
    return found


# (b) Commands, (c) status


def asking(called: str, text: str) -> str:
    """The parameter that a call asks the command for."""
    return text if called == "gcmd.get" else ""


def wrong_commands(code: str, text: str) -> list[str]:
    source = load(code)
    return command_problems(
        text,
        configure(source).section.commands,
        lambda name: parameters(source, "AutoZOffset", name, asking),
    )


def wrong_status(code: str, text: str) -> list[str]:
    source = load(code)
    plugin = configure(source).plugin
    found = []
    if plugin.get_status(0.0)["last_result"]:
        found.append("before the first result")
    plugin.results = (example_result(source),)
    fields = plugin.get_status(0.0)
    words = {
        "last_result": set(fields.get("last_result", ())),
        "phase": phases(source),
    }
    return found + status_problems(text, fields, words)


def example_result(source: Source) -> Any:
    """The cycle of the picture as the module keeps it."""
    zc = source.module
    parts = EXAMPLE[:4]
    return zc.Result(*parts, correction=zc.correction(*parts))


# (d) Messages

# Texts of the module that nobody is shown: lines of G-code, and reasons that
# only z_calibration tells
NOT_SHOWN = {
    f"{VALUE} {VALUE}={VALUE} CURRENT={VALUE}",
    f"SET_VELOCITY_LIMIT ACCEL={VALUE}",
    "Z was homed again",
    "Z was homed again or set",
    "the Z motors were levelled",
    "the motors were turned off",
}


def wrong_messages(code: str, text: str) -> list[str]:
    known = messages(load(code))
    found = [f"not in the code: {line!r}" for line in NOT_SHOWN - known]
    # The code has its name as a value
    named = text.replace("`auto_z_offset: ", "`<name>: ")
    return found + message_problems(named, known - NOT_SHOWN)


# (e) Numbers


def wrong_constants(code: str, text: str) -> list[str]:
    return constant_problems(load(code), text)


def example_plugin(
    source: Source, axis: Optional[dict[str, str]] = None
) -> Any:
    """The module on the machine of the picture."""
    plugin = configure(source, axis=axis).plugin
    plugin.host.probe_offsets = lambda: (0.0, 0.0, EXAMPLE.probe_z_offset)
    plugin.host.toolhead_status = lambda: {"max_accel": MAX_ACCEL}
    plugin.host.z_datum = lambda: [0.0]
    return plugin


def followed(source: Source, own: dict[str, str]) -> Optional[float]:
    """The correction of the picture after z_offset of the probe changed."""
    own = {"probe_z_correction": f"{EXAMPLE.correction}", **own}
    plugin = configure(source, own).plugin
    plugin.host.probe_offsets = lambda: (0.0, 0.0, MOVED_Z_OFFSET)
    plugin.follow_probe()
    if bool(plugin.notes) is (plugin.correction == EXAMPLE.correction):
        return None
    return plugin.correction


def wrong_floors(code: str, text: str) -> list[str]:
    """The examples of the table of floors."""
    zc = load(code).module
    plugin = example_plugin(load(code))
    settings = plugin.settings
    unknown = plugin.expected()
    plugin.correction = EXAMPLE.correction
    saved = plugin.expected()
    plugin.mark, plugin.sensor_z = plugin.frame.mark(), EXAMPLE.sensor
    before = plugin.expected()
    higher = EXAMPLE.sensor + 0.1
    again = zc.expect_again(EXAMPLE.sensor, higher, settings.sampling)
    plugin.mark, plugin.host.homes_with_probe = None, False
    by_switch = plugin.expected()
    known = (unknown, by_switch, saved, before, again)
    accel = plugin.host.braking_accel(settings.probe_accel)
    motion = settings.sampling.speed, accel
    real = [
        [zc.sensor_floor(settings.floor, e, *motion).z, e.high] for e in known
    ]
    real = [[z for z in ends if math.isfinite(z)] for ends in real]
    real.append([EXAMPLE.sensor])
    table = rows(part(text, "How low can a touch go?"))
    written = [list(map(float, row[3].split(" to "))) for row in table]
    found = []
    for ours, theirs in zip_longest(real, written, fillvalue=[]):
        if theirs != pytest.approx(ours, abs=1e-9):
            found.append(f"{ours}, not {theirs}")
    # What is believed
    for expected in known:
        high = min(expected.high, 99.0)
        if not accepts(zc, high - 0.001, expected):
            found.append(f"no trigger just below {high} with {expected}")
        if high == expected.high and accepts(zc, high + 0.001, expected):
            found.append(f"a trigger just above {high} with {expected}")
    highest = configure(load(code), axis={"position_min": "-20"}).plugin
    if highest.settings.floor.z != zc.LOWEST_FLOOR:
        found.append(f"floor of a deep axis: {highest.settings.floor}")
    return found


def wrong_rooms(code: str, text: str) -> list[str]:
    """The table of what a dead sensor costs, whoever limits it."""
    source = load(code)
    zc = source.module
    host = example_plugin(source).host
    expected = zc.expect_near(0.0, 0.0)
    found = []
    for row in rows(part(text, BRAKING)):
        speed, accel, nozzle_speed, room = map(float, row)
        host.toolhead_status = lambda: {"max_accel": MAX_ACCEL}
        limits = [host.braking_accel(accel)]
        host.z_axis = host.z_axis._replace(max_accel=accel)
        limits.append(host.braking_accel(0.0))
        host.z_axis = host.z_axis._replace(max_accel=MAX_ACCEL)
        host.toolhead_status = lambda accel=accel: {"max_accel": accel}
        limits.append(host.braking_accel(MAX_ACCEL))
        for limit in limits:
            fastest = zc.fastest_touch(speed, limit)
            if fastest != pytest.approx(nozzle_speed, abs=6e-3):
                found.append(f"{speed}, {accel}: at {fastest} mm/s")
            z = zc.sensor_floor(zc.Floor(-4.0, ""), expected, fastest, limit).z
            if -z != pytest.approx(room, abs=6e-4):
                found.append(f"{speed}, {accel}: {-z}, not {room}")
        shallow = zc.sensor_floor(zc.Floor(-0.01, ""), expected, speed, accel)
        if shallow.z != -0.01:
            found.append("below probe_z_min")
        own = {"speed": f"{speed}", "probe_accel": f"{accel}"}
        plugin = configure(source, own).plugin
        plugin.host.toolhead_status = lambda: {"max_accel": MAX_ACCEL}
        plugin.note_speed()
        if bool(plugin.notes) is not (nozzle_speed < speed):
            found.append(f"{speed}, {accel}: klippy says {plugin.notes}")
    room = zc.KNOWN_MARGIN - zc.BRAKING_RESERVE
    if f"highest speed = sqrt(2 * acceleration * {room:g})" not in text:
        found.append(f"highest speed: {room}")
    return found


def wrong_followed_correction(code: str, text: str) -> list[str]:
    """What another z_offset of the probe adds to the correction."""
    source = load(code)
    then = EXAMPLE.probe_z_offset
    saved = {"corrected_probe_z_offset": f"{then}"}
    real = followed(source, saved)
    if real is None:
        return ["it is not told, or for nothing"]
    numbers = real, EXAMPLE.correction, MOVED_Z_OFFSET, then
    line = "{:.3f} = {:.3f} + ({:.3f} - {:.3f} )".format(*numbers)
    found = [] if line in normal(text) else [line]
    same = {"corrected_probe_z_offset": f"{MOVED_Z_OFFSET}"}
    if followed(source, same) != EXAMPLE.correction:
        found.append("changes with the same z_offset")
    # Both commands save the two together
    plugin = example_plugin(source)
    written: dict[str, float] = {}
    plugin.host.save_option = written.__setitem__
    plugin.host.gcode_offset = lambda: EXAMPLE.correction
    plugin.cmd_AUTO_Z_SAVE_GCODE_OFFSET(Anything())
    names = "probe_z_correction", "corrected_probe_z_offset"
    if written != dict(zip(names, (EXAMPLE.correction, then))):
        found.append(f"saves {written}")
    return found


def wrong_applied_offset(code: str, text: str) -> list[str]:
    """What position_endstop adds to the correction."""
    plugin = example_plugin(load(code), {"position_endstop": f"{HOMED_Z}"})
    plugin.correction = EXAMPLE.correction
    applied: list[float] = []
    plugin.host.apply_offset = applied.append
    plugin.cmd_AUTO_Z_LOAD_OFFSET(Anything())
    formula = "{:.3f} = {:.3f} + ({:.3f} - {:.3f} )"
    numbers = plugin.correction, HOMED_Z, EXAMPLE.probe_z_offset
    line = formula.format(*applied, *numbers)
    found = [] if line in normal(text) else [line]
    plugin.host.gcode_offset = lambda: applied[0]
    saved: list[float] = []
    plugin.host.save_option = lambda _, value: saved.append(value)
    plugin.cmd_AUTO_Z_SAVE_GCODE_OFFSET(Anything())
    if saved != pytest.approx([EXAMPLE.correction, EXAMPLE.probe_z_offset]):
        found.append(f"saves {saved}")
    plugin.host.homes_with_probe = False
    if plugin.host.homed_bed_z() != 0.0:
        found.append("counts where a switch homes Z")
    return found


def accepts(zc: Any, z: float, expected: Any) -> bool:
    try:
        zc.check_expected(z, expected)
    except zc.CalibrationError:
        return False
    return True


def wrong_example(code: str, text: str) -> list[str]:
    """Formula, terms and console are one run: that of the picture."""
    source = load(code)
    result = example_result(source)
    real = {
        name.replace("probe_z", "probe z"): value
        for name, value in result._asdict().items()
    }
    real["probe - probe z_offset"] = EXAMPLE.bed_by_probe
    terms = {
        r[0]: float(r[1])
        for r in rows(part(text, "What is measured?"))
        if len(r) == 3
    }
    found = [f"term: {name}" for name in set(terms) ^ set(real)]
    found += [
        f"{name} is {real.get(name)}"
        for name, value in terms.items()
        if real.get(name) != pytest.approx(value, abs=1e-9)
    ]
    if result.correction != pytest.approx(EXAMPLE.correction):
        found.append("the picture's correction")
    shown = configure(source).plugin.formula("cycle", result)
    if f"auto_z_offset: {shown}" not in text:
        found.append(f"console: {shown}")
    last = template(source, "AUTO_Z_CALIBRATE: ")
    last %= ("average", 3, 0.0, result.correction, "")
    if last.strip() not in text:
        found.append(f"console: {last}")
    formula = "{4:.3f} = {0:.3f} - ({1:.3f} - {2:.3f} ) + {3:.3f}"
    if formula.format(*result) not in normal(text):
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
    wrong_old_options,
    wrong_commands,
    wrong_status,
    wrong_messages,
    wrong_constants,
    wrong_floors,
    wrong_rooms,
    wrong_followed_correction,
    wrong_applied_offset,
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
    assert draw(EXAMPLE) != draw(EXAMPLE._replace(sensor=-0.33))
    assert "prefers-color-scheme:dark" in draw(EXAMPLE)


# Configurations and runs that the document and the examples show


# What the sections of the document take for granted
SURROUNDINGS: dict[str, dict[str, str]] = {
    "respond": {},
    "probe": {"z_offset": f"{EXAMPLE.probe_z_offset}"},
    "gcode_macro BED_MESH_PROFILE": {"gcode": "G4 P1"},
}


def test_example_is_that_of_a_run(one_host, text):
    blocks = ini_blocks(text)
    assert set(blocks["auto_z_offset"]) >= set(REQUIRED)
    (shown,) = re.findall(r"```\n> AUTO_Z_CALIBRATE\n(.*?)```", text, re.DOTALL)
    with Printer(one_host, "qidi", {**blocks, **SURROUNDINGS}) as printer:
        printer.homed()
        assert printer.run("CHECK_PROBE") == [
            "echo: not measured since klippy started, saved is 0.0"
        ]
        answer = told_by_module(printer.run("AUTO_Z_CALIBRATE"))
        assert answer == told_by_module(shown.splitlines())
        assert printer.run("CHECK_PROBE") == ["echo: -0.12, spread 0.0"]
        middle = 119.75, 126.75
        assert printer.gap(middle) == pytest.approx(EXAMPLE.gap, abs=0.006)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_configuration_is_read(path, code):
    content = path.read_text(encoding="utf-8")
    assert content.startswith("#")
    assert f"# [include {path.name}]" in normal(content)
    parser = configparser.ConfigParser(
        delimiters=":", interpolation=None, inline_comment_prefixes="#"
    )
    parser.read_string(content)
    own = dict(parser["auto_z_offset"])
    loaded = configure(load(code), own, required={})
    loaded.plugin.host.toolhead_status = lambda: {"max_accel": MAX_ACCEL}
    loaded.plugin.note_speed()
    assert loaded.plugin.notes == []
    assert loaded.plugin.settings.z_offset > 0.0
    assert not {"probe_z_correction", "corrected_probe_z_offset"} & set(own)
    begin = parser["gcode_macro PRINT_START"]["gcode"].split("\n")
    commands = [line.split()[0] for line in begin if line.strip()]
    assert "AUTO_Z_CALIBRATE" not in commands
    assert commands.index("AUTO_Z_LOAD_OFFSET") > max(
        commands.index(name) for name in ("G28", "BED_MESH_PROFILE")
    )
    calibrate = parser["gcode_macro CALIBRATE_OFFSET"]["gcode"]
    order = [calibrate.index(name) for name in ("G28", "AUTO_Z_CALIBRATE")]
    assert order == sorted(order)


def test_there_are_examples():
    assert {path.stem for path in EXAMPLES} == {"plus4", "q1_pro", "x_max3"}


# What is changed in the document, and which check has to see it
CHANGES_OF_TEXT = {
    "option left out": (wrong_option_names, r"(?m)^\| `probe_hop`.*\n", ""),
    "option too many": (wrong_option_names, r"`probe_hop` \|", "`hop` |"),
    "default": (wrong_defaults, r"\| `5.0` \|", "| `6.0` |"),
    "word as default": (wrong_defaults, r"\| `average` \|", "| `median` |"),
    "default of another section": (
        wrong_defaults,
        r"\| `position_min` of",
        "| `position_max` of",
    ),
    "no default": (wrong_defaults, r"\| `0.33` \|", "| - |"),
    "range": (wrong_ranges, "mm/s, > 0", "mm/s, ≥ 0"),
    "limits": (wrong_ranges, "-10 to 10", "-10 to 11"),
    "smallest hop": (wrong_ranges, "mm, ≥ 4", "mm, ≥ 3"),
    "count": (wrong_ranges, "count, ≥ 1", "count, ≥ 0"),
    "kind of range": (wrong_ranges, "X, Y in mm", "somewhere"),
    "old option left out": (wrong_old_options, r"(?m)^\| `x_offset`.*\n", ""),
    "old option, what happens": (
        wrong_old_options,
        r"`deactivate_gcode` \| not run",
        "`deactivate_gcode` | ignored",
    ),
    "command": (wrong_commands, "### AUTO_Z_PROBE", "### AUTO_PROBE"),
    "parameter left out": (wrong_commands, r"(?m)^\| `ACCEPT_CHANGE`.*\n", ""),
    "parameter too many": (
        wrong_commands,
        "(?m)^Takes the G-code Z offset",
        r"|a|b|\n|---|---|\n| `SAVE` | 0 |\n\n\g<0>",
    ),
    "field": (wrong_status, r"\| `spread` ", "| `range` "),
    "part of the result": (wrong_status, "`sensor`, `probe`,", "`probe`,"),
    "phase": (wrong_status, "`bed sensor` or `probe`", "`probe`"),
    "field in the macro": (wrong_status, r"z\.spread", "z.range"),
    "message left out": (wrong_messages, r"(?m)^\| `trying again`.*\n", ""),
    "word of a message": (wrong_messages, "before the head moved", "too soon"),
    "message too many": (
        wrong_messages,
        r"(?m)^\| `trying again`.*\n",
        r"\g<0>| `giving up` | it is | nothing |\n",
    ),
    "constant": (wrong_constants, r"`STALE_Z` \| 0.1", "`STALE_Z` | 0.4"),
    "constant left out": (wrong_constants, r"(?m)^\| `STALE_Z`.*\n", ""),
    "constant in a sentence": (
        wrong_constants,
        r"`KNOWN_MARGIN` \(1.0 mm\)",
        "`KNOWN_MARGIN` (1.1 mm)",
    ),
    "floor": (wrong_floors, r"\| -1.320 to", "| -1.220 to"),
    "highest trigger": (wrong_floors, "to 0.680", "to 0.780"),
    "nothing known": (wrong_floors, "to 1.500", "to 1.000"),
    "kind of touch left out": (wrong_floors, r"(?m)^\| with a corr.*\n", ""),
    "room to brake": (wrong_rooms, r"\| 1.000 \|\n\| 10 ", "| 1.100 |\n| 10 "),
    "speed of the nozzle": (wrong_rooms, r"\| 9.49 \|", "| 10.00 |"),
    "highest speed": (wrong_rooms, r"acceleration \* 0.9", "acceleration * 1"),
    "followed correction": (wrong_followed_correction, "-0.070 ", "-0.170 "),
    "default that follows": (
        wrong_defaults,
        r"`z_offset` of `\[probe\]` \|",
        "`z_offset` of `[bltouch]` |",
    ),
    "applied offset": (wrong_applied_offset, "0.080  ", "-0.320 "),
    "term": (wrong_example, r"\| -0.120 \|", "| -0.130 |"),
    "console": (wrong_example, "correction=-0.120000", "correction=-0.130000"),
    "last line": (wrong_example, "correction: -0.12", "correction: -0.13"),
    "formula": (wrong_example, r"\) \+ 0.200", ") - 0.200"),
    "link": (wrong_links, r"\(#limits\)", "(#limit)"),
    "picture": (wrong_links, r"\(auto_z_offset.svg\)", "(a.svg)"),
}


@pytest.mark.parametrize("name", CHANGES_OF_TEXT)
def test_change_of_the_document_is_noticed(name, code, text):
    change = Change(*CHANGES_OF_TEXT[name])
    assert change.check(code, change.of(text))


# And what is changed in the module
CHANGES_OF_CODE = {
    "option": (wrong_option_names, '"z_current_factor"', '"z_factor"'),
    "option not known": (wrong_known_options, '    "probe_accel",\n', ""),
    "option not read": (
        wrong_known_options,
        '    "probe_accel",\n',
        r'\g<0>    "accel",\n',
    ),
    "option known twice": (
        wrong_known_options,
        '    "probe_accel",\n',
        r"\g<0>\g<0>",
    ),
    "unknown options": (wrong_known_options, "        check_options.*\n", ""),
    "default": (wrong_defaults, '"speed", (.*), 5.0', r'"speed", \1, 6.0'),
    "default of a word": (wrong_defaults, '"average"\n', '"median"\n'),
    "middle": (wrong_defaults, r"\(x_min \+ x_max\) / 2.0", "x_min"),
    "required": (
        wrong_defaults,
        r'"Option .%s. in section .%s. is missing; write',
        r'"Option %s in %s: no value; write',
    ),
    "range": (
        wrong_ranges,
        '"lift_speed", parse_positive',
        '"lift_speed", parse_not_negative',
    ),
    "limits": (wrong_ranges, "LARGEST_OFFSET = 10.0", "LARGEST_OFFSET = 9.0"),
    "old option": (wrong_old_options, '    \\("recovery_time".*\n', ""),
    "empty activate_gcode": (
        wrong_old_options,
        r'"activate_gcode", ""\).strip\(\) != ""',
        '"activate_gcode", None) is not None',
    ),
    "negative z_offset": (
        wrong_old_options,
        "    if note:\n        notes.append.*\n",
        "",
    ),
    "command": (wrong_commands, '            "AUTO_Z_HOME_Z",\n', ""),
    "parameter": (wrong_commands, '"ACCEPT_CHANGE", "0"', '"ACCEPT", "0"'),
    "field": (wrong_status, '"spread": spread', '"range": spread'),
    "phase": (wrong_status, 'watch.enter\\("probe"\\)', 'watch.enter("bed")'),
    "message": (wrong_messages, "before the head moved", "before it moved"),
    "message too many": (wrong_messages, "\\Z", '\nNEW = "who reads this"\n'),
    "constant": (wrong_constants, "STALE_Z = 0.1", "STALE_Z = 0.6"),
    "constant too many": (wrong_constants, "\\Z", "\nNEW_ONE = 1.0\n"),
    "misspelt old option": (
        wrong_known_options,
        "if similar not in OPTIONS",
        "if not similar",
    ),
    "margin of a correction": (
        wrong_floors,
        "correction - z_offset, KNOWN_MARGIN",
        "correction - z_offset, TOUCH_MARGIN",
    ),
    "margin of a command before": (
        wrong_floors,
        "self.sensor_z, KNOWN_MARGIN",
        "self.sensor_z, TOUCH_MARGIN",
    ),
    "margin of a touch": (wrong_floors, r"TOUCH_MARGIN \+ sampl", "sampl"),
    "lowest touch": (wrong_floors, r"z = min\(z, before\)", "z = before"),
    "sign of the air gap": (
        wrong_floors,
        r"bed_z \+ correction - z_offset",
        "bed_z + correction + z_offset",
    ),
    "lowest floor": (
        wrong_floors,
        r"max\(z_axis.position_min, LOWEST_FLOOR\)",
        "z_axis.position_min",
    ),
    "trigger above": (wrong_floors, "z <= expected.high", "z <= 9.0"),
    "trigger above the probe's": (
        wrong_floors,
        r"probe_z \+ ABOVE_PROBE",
        "probe_z",
    ),
    "probe on a machine with a switch": (
        wrong_floors,
        r" or not self\.host\.homes_with_probe:",
        ":",
    ),
    "braking distance": (wrong_rooms, r"/ \(2.0 \* accel", "/ (accel"),
    "highest speed": (wrong_rooms, r"2.0 \* accel \* room", "accel * room"),
    "line on the speed": (
        wrong_rooms,
        "if speed < settings",
        "if 0 > settings",
    ),
    "followed correction": (
        wrong_followed_correction,
        "z_offset - self.corrected_z_offset",
        "self.corrected_z_offset - z_offset",
    ),
    "line on the correction": (
        wrong_followed_correction,
        r"(?s)self.notes.append\(\n            .the probe's.*?\n        \)\n",
        "pass\n",
    ),
    "correction without its z_offset": (
        wrong_followed_correction,
        r'        self.host.save_option\("corrected.*\n',
        "",
    ),
    "correction of nothing known": (
        wrong_defaults,
        "        if self.correction is None or self.corrected_z_offset is None",
        "        self.corrected_z_offset = self.corrected_z_offset or 0.0\n"
        "        if self.correction is None",
    ),
    "reserve": (wrong_rooms, "- braking - BRAKING_RESERVE", "- braking"),
    "acceleration": (wrong_rooms, r", self.z_axis.max_accel\]", "]"),
    "braking below the floor": (wrong_rooms, "if low <= floor.z", "if 0 > 1"),
    "applied offset": (
        wrong_applied_offset,
        r"apply_offset\(z_offset \+ bed_z\)",
        "apply_offset(z_offset)",
    ),
    "saved offset": (
        wrong_applied_offset,
        r"gcode_offset\(\) - self.host.homed_bed_z\(\)",
        "gcode_offset()",
    ),
    "formula": (
        wrong_example,
        r"\(probe - probe_z_offset\) \+ z",
        "(probe + probe_z_offset) + z",
    ),
    "sign in the formula": (
        wrong_example,
        r"\) \+ z_offset\n",
        ") - z_offset\n",
    ),
}


@pytest.mark.parametrize("name", CHANGES_OF_CODE)
def test_change_of_the_module_is_noticed(name, code, text):
    change = Change(*CHANGES_OF_CODE[name])
    assert change.check(change.of(code), text)
