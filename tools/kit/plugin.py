"""Every host, printers on it, and what has run where."""

from __future__ import annotations

import gc
import os
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from operator import attrgetter
from typing import Optional

import pytest
from hypothesis import HealthCheck, settings
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from simprinter.hosts import starting
from simprinter.hosts.hosts import Host, all_hosts, missing_hosts
from tools.kit import load_errors
from tools.kit.printer import MODULES, Printer

# A machine that is busy is no failure
settings.register_profile(
    "untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("untimed")


def pytest_sessionfinish() -> None:
    """End what was kept for the next configuration, and the next start."""
    load_errors.close()
    starting.close()


def pytest_collection_finish() -> None:
    """What is there by now stays: the collector need not look at it."""
    gc.freeze()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Each host in turn as `host`; EVERY_HOST=1: as `some_host`, too."""
    names = ["host", "some_host"] if os.environ.get("EVERY_HOST") else ["host"]
    for name in names:
        if name in metafunc.fixturenames:
            metafunc.parametrize(name, all_hosts(), ids=attrgetter("name"))


def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Of a test marked `spread`, each case runs on one of the hosts.

    On another one for another case. EVERY_HOST=1: on each; so do those marked
    `each_host`, where all others in their file are spread. Of one marked
    `some`, some of the cases run without it; one marked `long` does not.
    """
    if not os.environ.get("EVERY_HOST"):
        left_out = _left_out(items)
        chosen = {i for i in items if i not in left_out and _is_its_turn(i)}
        others = [item for item in items if item not in chosen]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item in chosen]
        for item in items:
            for mark in item.iter_markers("long"):
                reason = f"{mark.args[0]}: EVERY_HOST=1"
                item.add_marker(pytest.mark.skip(reason=reason))
    for item in items:
        if item.path.parent.name == "unit":
            item.add_marker("quick")
        callspec = getattr(item, "callspec", None)
        for value in callspec.params.values() if callspec else ():
            if isinstance(value, Host):
                _noted(item, value)


def _left_out(items: list[pytest.Item]) -> set[pytest.Item]:
    """What does not run of the tests marked `some`, on whichever host.

    Half of a table's cases run; of 6 and more every third, of 16 and more
    every fourth; or every nth, where the mark gives n.
    """
    cases: dict[str, list[str]] = {}
    marked = [item for item in items if item.get_closest_marker("some")]
    for item in marked:
        case = _case(item)
        table = cases.setdefault(case.partition("[")[0], [])
        if case not in table:
            table.append(case)
    return {item for item in marked if not _is_chosen(item, cases)}


def _is_chosen(item: pytest.Item, cases: dict[str, list[str]]) -> bool:
    case = _case(item)
    table = cases[case.partition("[")[0]]
    mark = item.get_closest_marker("some")
    assert mark is not None
    usual = 2 + (len(table) >= 6) + (len(table) >= 16)
    step = mark.args[0] if mark.args else usual
    number = table.index(case)
    # Shifted in each round, as the last option has as few values
    return (number + number // step) % step == 0


def _case(item: pytest.Item) -> str:
    """Its name without that of its host."""
    host = getattr(item, "callspec", None) and item.callspec.params.get("host")
    return item.nodeid.replace(host.name, "") if host else item.nodeid


def _is_its_turn(item: pytest.Item) -> bool:
    host = getattr(item, "callspec", None) and item.callspec.params.get("host")
    if host is None or item.get_closest_marker("spread") is None:
        return True
    if item.get_closest_marker("each_host") is not None:
        return True
    return _drawn(_case(item)) is host


def _drawn(case: str) -> Host:
    """The host of a case that runs on one."""
    hosts = all_hosts()
    return hosts[zlib.crc32(case.encode()) % len(hosts)]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(
    config: pytest.Config, log: Producer
) -> Optional[LoadFileScheduling]:
    """With files that stay in one process, so does what files share."""
    return _ByFile(config, log) if config.option.dist == "loadfile" else None


class _ByFile(LoadFileScheduling):
    # Making a printer with Moonraker takes seconds
    _TOGETHER = re.compile(r"tests/moonraker/test_(?!dialogs|setup)")

    def _split_scope(self, nodeid: str) -> str:
        found = self._TOGETHER.match(nodeid)
        return found[0] if found else super()._split_scope(nodeid)


@pytest.fixture
def some_host(request: pytest.FixtureRequest) -> Host:
    """One of the hosts, another for another test: for long tables."""
    return _noted(request.node, _drawn(request.node.nodeid))


@pytest.fixture
def one_host(request: pytest.FixtureRequest) -> Host:
    """Any host, for what takes long and does not depend on it."""
    return _noted(request.node, all_hosts()[-1])


def _noted(item: pytest.Item, host: Host) -> Host:
    """The same host; the reports of a test say on which it was."""
    item.user_properties.append(("host", host.name))
    return host


@pytest.fixture
def start(host: Host) -> Iterator[Callable[..., Printer]]:
    """start(scene, changes, faults, seed ...): a Printer on the host."""
    with ExitStack() as stack:
        yield lambda *args, **options: stack.enter_context(
            Printer(host, *args, **options)
        )


# A test of one module is in test_<module>_<topic>.py
_MODULE = re.compile(rf"/test_({'|'.join(MODULES)})_\w+\.py")
_NO_HOST = "(no host)"
_KINDS = ("passed", "failed", "error", "skipped")


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter,
) -> None:
    """What came of the tests, for each host and module."""
    counts: Counter[tuple[str, str, str]] = Counter()
    for kind in _KINDS:
        for report in terminalreporter.stats.get(kind, ()):
            noted = dict(getattr(report, "user_properties", ()))
            found = _MODULE.search(report.nodeid)
            module = found[1] if found else "other"
            counts[noted.get("host", _NO_HOST), module, kind] += 1

    def cell(*place: str) -> str:
        passed, failed, error, skipped = (
            counts[(*place, kind)] for kind in _KINDS
        )
        return f"{passed}/{failed + error}/{skipped}"

    ran = {module for _, module, _ in counts}
    columns = [name for name in (*MODULES, "other") if name in ran]
    hosts = sorted({host for host, _, _ in counts})
    rows = [["passed/failed/skipped", *columns]]
    for host in hosts:
        rows.append([host, *(cell(host, name) for name in columns)])
    for host in missing_hosts() if {*hosts} - {_NO_HOST} else ():
        rows.append([host, *("MISSING" for _ in columns)])
    widths = [max(map(len, column)) for column in zip(*rows)]
    terminalreporter.section("hosts")
    for row in rows:
        line = "  ".join(map(str.ljust, row, widths))
        terminalreporter.line(line.rstrip())
