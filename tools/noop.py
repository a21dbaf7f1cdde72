"""A plugin of pytest: which tests pass although nothing is done? (make noop)

On every printer the commands of our modules do nothing. A test that runs one of
them and passes holds what must not happen, and not what must. Tests that run none,
such as of what is refused when klippy starts, are only counted.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from simprinter.hosts.hosts import Host, Installed
from tools.kit.printer import MODULES, ROOT

EXTRA = ROOT / "tools" / "kit" / "extras" / "noop.py"
# What the report of a test calls them
_RUN = "commands that did nothing"

_calls = Path(tempfile.mkdtemp(prefix="noop-")) / "calls"
_install = Host.install


def install(host: Host, modules: Mapping[str, Path]) -> Installed:
    """As Host.install does, with commands of ours that do nothing."""
    if not {*MODULES} & {*modules}:
        return _install(host, modules)
    installed = _install(host, {**modules, "noop": EXTRA})
    section = f"[noop]\ncalls: {_calls}\n"
    return replace(installed, config=section + installed.config)


def pytest_configure() -> None:
    """From now on so on every printer."""
    Host.install = install


def pytest_unconfigure() -> None:
    """No more."""
    Host.install = _install
    _calls.unlink(missing_ok=True)
    _calls.parent.rmdir()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Nothing has been run for it yet."""
    _calls.write_text("")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Its report has the commands that were run for it."""
    yield
    names = sorted(set(_calls.read_text().split()))
    item.user_properties.append((_RUN, " ".join(names)))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """A test that passes is the failure here."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None:
        session.exitstatus = 1 if _passed(reporter)[0] else 0


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter,
) -> None:
    """Those that pass, with the commands that did nothing."""
    found, others = _passed(terminalreporter)
    failed = sum(
        len(terminalreporter.stats.get(kind, ()))
        for kind in ("failed", "error")
    )
    terminalreporter.section("pass although nothing is done")
    for nodeid, names in found:
        terminalreporter.line(f"{nodeid}: {names}")
    terminalreporter.line(
        f"{len(found)} pass although nothing is done, {failed} fail,"
        f" {others} run no command of ours"
    )


def _passed(
    reporter: pytest.TerminalReporter,
) -> tuple[list[tuple[str, str]], int]:
    """Those that pass, with their commands, and how many have run none."""
    passed = [
        (report.nodeid, dict(report.user_properties).get(_RUN, ""))
        for report in reporter.stats.get("passed", ())
    ]
    found = sorted(row for row in passed if row[1])
    return found, len(passed) - len(found)
