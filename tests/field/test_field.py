"""What owners reported, as files: README.md says how to add one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from simprinter.hosts.hosts import Host
from simprinter.plugin_printer import read_scene
from tests.field.cases import HERE, NAMES, read, world_of
from tools.kit.printer import Printer


@pytest.mark.parametrize("name", NAMES)
def test_reported_case(host: Host, name: str) -> None:
    """Each step ends as its case wants it, and nothing is hit or pressed."""
    case = read(name)
    start = case.get("start", {})
    scene = read_scene(HERE / name / "printer.cfg", world_of(case))
    with Printer(host, scene) as printer:
        state, message = printer.session.start()
        if "refused" in start:
            assert state == "error", message
            assert_has(message, start["refused"])
            return
        assert state == "ready", message
        printer.session.wait(2.0)
        assert_has("\n".join(printer.session.console), start.get("says", []))
        for step in case.get("step", []):
            take(printer, step)


def take(printer: Printer, step: Mapping[str, Any]) -> None:
    """Run a step's commands, and look at all that it wants of them."""
    for site, depth in step.get("deepest", {}).items():
        printer.machine.tolerate(site, depth)
    before = len(printer.session.console)
    if "refused" in step:
        error = printer.fail(step["run"])
        assert_has(error, step["refused"])
        assert_lacks(error, step.get("refused_without", []))
    else:
        printer.run(step["run"])
    printer.session.wait(step.get("wait", 0.5))
    told = "\n".join(printer.session.console[before:])
    assert_has(told, step.get("says", []))
    assert_lacks(told, step.get("says_not", []))
    for name, wanted in step.get("status", {}).items():
        status = printer.status(name)
        assert {key: status[key] for key in wanted} == wanted
    if "gap" in step:
        gap = printer.gap(tuple(step.get("over", (150, 150))))
        assert gap == pytest.approx(step["gap"], abs=step.get("within", 0.02))


def assert_has(text: str, wanted: list[str]) -> None:
    """Each of these words is in the text."""
    for words in wanted:
        assert words in text, f"{words!r} is not in:\n{text}"


def assert_lacks(text: str, unwanted: list[str]) -> None:
    """None of them is."""
    for words in unwanted:
        assert words not in text, f"{words!r} is in:\n{text}"
