"""Every option with every kind of nonsense: refused when klippy starts.

What a range excludes is taken from the tables of the documents, which
tests/docs holds against the modules.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.docs.documents import (
    OPTIONS,
    Option,
    options_of,
    part,
    samples_of,
)
from tools.kit.cases import slow
from tools.kit.extra_probe import NAME
from tools.kit.load_errors import load
from tools.kit.z_calibration import refusal

ROOT = Path(__file__).resolve().parents[2]
SCENES = {
    "z_calibration": "voron",
    "auto_z_offset": "qidi",
    "extra_probe": "membrane",
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
    """An option of a module, as its document has it."""

    module: str
    option: Option

    @property
    def section(self) -> str:
        """Where the option stands."""
        return SECTIONS.get(self.module, self.module)


def documented(module: str) -> list[Case]:
    """All that the tables of options have, old names, too."""
    text = (ROOT / "docs" / f"{module}.md").read_text(encoding="utf-8")
    return [Case(module, option) for option in options_of(part(text, OPTIONS))]


CASES = [case for module in SCENES for case in documented(module)]


def nonsense(case: Case) -> list[str]:
    """Texts that are none of what the option's range allows."""
    option = case.option
    words = option.range
    if words == "G-code":
        return TEMPLATES
    if words == "MCU pin":
        return PINS
    if words == "folder":
        return ["", " "]
    _, refused = samples_of(words)
    return list(dict.fromkeys([*TEXTS, *refused]))


def telling(case: Case) -> list[str]:
    """What only this option's own limits refuse, or else the first of all."""
    limits = [text for text in nonsense(case) if is_number(text)]
    return limits or nonsense(case)[:1]


def others(case: Case) -> list[str]:
    """The rest of it, which the reading of each kind of value refuses."""
    return [text for text in nonsense(case) if text not in telling(case)]


def is_number(text: str) -> bool:
    """Whether it is a finite one."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def message_of(host, case, value):
    """What klippy stops with for one value of an option."""
    own = {case.option.name: value}
    if case.option.name.startswith("probe_") and case.module[0] == "z":
        # Half of a position is another mistake
        other = {"x": "y", "y": "x"}.get(case.option.name[-1])
        if other:
            own[case.option.name[:-1] + other] = "150"
            site = case.option.name.split("_")[1]
            own[f"{site}_xy_position"] = None
    try:
        return refusal(host, {case.section: own}, SCENES[case.module])
    except AssertionError as error:
        raise AssertionError(
            f"{case.option.name}: {value!r}: {error}"
        ) from None


@pytest.mark.parametrize(
    "case", CASES, ids=lambda c: f"{c.module}-{c.option.name}"
)
@pytest.mark.parametrize("texts", [telling, slow(others)])
def test_nonsense_is_a_configuration_error(host, case, texts):
    name, module = case.option.name, case.module
    for value in texts(case):
        message = message_of(host, case, value)
        assert name in message, (value, message)
        # The host says 'module:option' of a template
        assert f"'{module}" in message, (value, message)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", CASES, ids=lambda c: f"{c.module}-{c.option.name}"
)
def test_what_is_missing_is_told_or_has_a_default(host, case):
    state, message = load(
        host,
        {case.section: {case.option.name: None}},
        SCENES[case.module],
    )
    if state != "ready":
        assert "Internal error" not in message
        assert case.option.name in message
        assert f"'{case.section}'" in message
    assert (state == "ready") is (
        (case.module, case.option.name) not in REQUIRED
    )


REQUIRED = {
    ("auto_z_offset", "pin"),
    ("auto_z_offset", "prepare_gcode"),
    ("extra_probe", "pin"),
}


@pytest.mark.parametrize(
    ("module", "option"),
    [
        ("z_calibration", "endstop_pin"),
        ("auto_z_offset", "pin"),
        (NAME, "pin"),
    ],
)
def test_pin_that_no_board_has(host, module, option):
    # The host finds out when it configures the board, and names the pin
    for pin in UNKNOWN_PINS:
        message = refusal(
            host, {module: {option: pin}}, SCENES[module.split()[0]]
        )
        assert f"Pin '{pin}' is not a valid pin name" in message
