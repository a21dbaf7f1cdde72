"""Every option with every kind of nonsense: refused when klippy starts.

What a limit excludes is taken from the tables of options; of z_calibration, whose
old names have limits of their own, from the table of its document, which tests/docs
holds against the module. One that is left out has its default, or is asked for.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.docs.documents import (
    OPTIONS,
    options_of,
    part,
    samples_of,
    text_of,
)
from tools.kit.dockable_probe import SENSED
from tools.kit.extra_probe import NAME
from tools.kit.load_errors import load
from tools.kit.product import GCODE, HISTORY, OLD_POSITIONS, options
from tools.kit.product import OPTIONS as TABLES
from tools.kit.z_calibration import refusal

ROOT = Path(__file__).resolve().parents[2]
SCENES = {
    "z_calibration": "voron",
    "auto_z_offset": "qidi",
    "extra_probe": "membrane",
    "dockable_probe": SENSED,
}
# As a [dockable_probe] of other releases uses each of its positions
OLD_DOCK = {
    "approach_position": None,
    "detach_position": None,
    "dock_angle": "270",
    "detach_angle": "0",
    "dock_safe_distance": "38",
}
# Where it is not the module's name
SECTIONS = {"extra_probe": NAME}
# No number, no pair, no word of any option
TEXTS = ["", "much", "nan", "-inf", "1e400", "1,2,3,4"]
# Whatever it is given for, G-code is a template
TEMPLATES = ["{", "{% if %}", "{ 1 +", "{% for x in y %}"]
PINS = ["", " ", "^", "much:PC1", "1 2", "probe:z_virtual_endstop"]
# Where the host speaks of a pin that its board does not have, it names the pin
UNKNOWN_PINS = ["PZ77", "PC1,PC2", "13.5"]


class Case(NamedTuple):
    """An option of a module, what it must not accept, and whether it is required."""

    module: str
    name: str
    nonsense: list[str]
    required: bool = False

    @property
    def section(self) -> str:
        """Where the option stands."""
        return SECTIONS.get(self.module, self.module)

    def __str__(self) -> str:
        return f"{self.module}-{self.name}"


def excluded(words: str) -> list[str]:
    """Texts that are none of what a range of a document allows."""
    if words == "G-code":
        return TEMPLATES
    if words == "MCU pin":
        return PINS
    _, refused = samples_of(words)
    return [*TEXTS, *refused]


def refused_by(row: options.Option) -> list[str]:
    """Texts that a row of a table must not accept."""
    if row.kind is GCODE:
        return [*TEMPLATES, *options.nonsense(row)]
    if row.kind is options.PIN:
        return [*PINS, *options.nonsense(row)]
    if row.kind is HISTORY:
        return ["", " "]
    return [*TEXTS, *options.nonsense(row)]


def declared(module: str, rows: tuple[options.Option, ...]) -> list[Case]:
    """All that a table of its options has."""
    return [
        Case(
            module,
            row.name,
            [
                text
                for text in dict.fromkeys(refused_by(row))
                # A blank pin or position of [dockable_probe] is none, or is told by
                # the host alone
                if text.strip(" ^")
                or module != "dockable_probe"
                or text in options.nonsense(row)
            ],
            row.default is options.REQUIRED,
        )
        for row in rows
    ]


def old_names(module: str) -> list[Case]:
    """What else the tables of its document have: names that old sections use."""
    rows = {row.name for row in TABLES[module]}
    return [
        Case(module, option.name, list(dict.fromkeys(excluded(option.range))))
        for option in options_of(part(text_of(module), OPTIONS))
        if option.name not in rows
    ]


CASES = [
    *(case for module in SCENES for case in declared(module, TABLES[module])),
    *old_names("z_calibration"),
    *declared("dockable_probe", OLD_POSITIONS),
]


def telling(case: Case) -> list[str]:
    """What only this option's own limits refuse, or else the first of all."""
    limits = [text for text in case.nonsense if is_number(text)]
    return limits or case.nonsense[:1]


def others(case: Case) -> list[str]:
    """The rest of it, which the reading of each kind of value refuses."""
    return [text for text in case.nonsense if text not in telling(case)]


def is_number(text: str) -> bool:
    """Whether it is a finite one."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def message_of(host, case, value):
    """What klippy stops with for one value of an option."""
    own = {case.name: value}
    if case.name in {row.name for row in OLD_POSITIONS}:
        own = {**OLD_DOCK, **own}
    if case.name.startswith("probe_") and case.module[0] == "z":
        # Half of a position is another mistake
        other = {"x": "y", "y": "x"}.get(case.name[-1])
        if other:
            own[case.name[:-1] + other] = "150"
            site = case.name.split("_")[1]
            own[f"{site}_xy_position"] = None
    try:
        return refusal(host, {case.section: own}, SCENES[case.module])
    except AssertionError as error:
        raise AssertionError(f"{case.name}: {value!r}: {error}") from None


def assert_refused(host, case, texts):
    """Each of them, by the name of the option and of its section."""
    for value in texts:
        message = message_of(host, case, value)
        assert case.name in message, (value, message)
        # The host says 'module:option' of a template
        assert f"'{case.module}" in message, (value, message)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_nonsense_is_a_configuration_error(host, case):
    assert_refused(host, case, telling(case))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
def test_other_nonsense_and_none(host, case):
    assert_refused(host, case, others(case))
    changes = {case.section: {case.name: None}}
    state, message = load(host, changes, SCENES[case.module])
    if state != "ready":
        assert "Internal error" not in message
        assert case.name in message
        assert f"'{case.section}'" in message
    assert (state == "ready") is not case.required


@pytest.mark.parametrize("module", SCENES)
def test_option_that_is_none(host, module):
    section = SECTIONS.get(module, module)
    message = refusal(host, {section: {"much": "1"}}, SCENES[module])
    assert f"Option 'much' is not valid in section '{section}'" in message


@pytest.mark.parametrize(
    ("module", "option"),
    [
        ("z_calibration", "endstop_pin"),
        ("auto_z_offset", "pin"),
        (NAME, "pin"),
        ("dockable_probe", "pin"),
    ],
)
def test_pin_that_no_board_has(host, module, option):
    # The host finds out when it configures the board, and names the pin
    for pin in UNKNOWN_PINS:
        message = refusal(
            host, {module: {option: pin}}, SCENES[module.split()[0]]
        )
        assert f"Pin '{pin}' is not a valid pin name" in message


def test_negative_switch_offset_says_what_it_means(host):
    message = refusal(host, {"z_calibration": {"switch_offset": "-0.1"}})
    assert (
        "Option 'switch_offset' in section 'z_calibration' is -0.1, and cannot be"
        " negative: the plunger triggers below the switch body" in message
    )
    assert "check switch_xy_position, the endstop and its pin" in message


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("samples", "99999999999999999999999", "maximum of 1000"),
        ("offset_margins", "1e5", "has to be 10000 at most, and is -100000"),
        ("speed", "1e-10", "has to be 0.01 mm/s at least, and is 1e-10"),
        ("lift_speed", "1e308", "has to be 1000000 at most, and is 1e+308"),
        ("nozzle_xy_position", "1e5, 1", "has to be 10000 at most"),
    ],
)
def test_what_no_printer_has_is_refused_with_its_range(
    host, name, value, words
):
    message = refusal(host, {"z_calibration": {name: value}})
    assert f"'{name}' in section 'z_calibration'" in message
    assert words in message


def test_fast_printers_have_a_large_acceleration(host):
    state, _ = load(host, {"auto_z_offset": {"probe_accel": "50000"}}, "qidi")
    assert state == "ready"
