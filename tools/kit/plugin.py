"""Every host, printers on it, and what has run where."""

from __future__ import annotations

import gc
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from operator import attrgetter
from typing import Optional

import pytest
from hypothesis import HealthCheck, settings
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

from simprinter.hosts import starting
from simprinter.hosts.hosts import (
    Host,
    all_hosts,
    main_host,
    missing_hosts,
)
from tools.kit import load_errors
from tools.kit.printer import MODULES, Printer
from tools.kit.tables import plain

# A machine that is busy is no failure
settings.register_profile(
    "untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("untimed")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """End what was kept for the next configuration, and the next start."""
    load_errors.close()
    starting.close()
    output = getattr(session.config, "workeroutput", None)
    if output is not None and _LEFT in session.config.stash:
        output["left"] = session.config.stash[_LEFT]


def pytest_collection_finish() -> None:
    """What is there by now stays: the collector need not look at it."""
    gc.freeze()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Which part of all cases: make test, make test-rest or make test-all."""
    parser.addoption(
        "--cases",
        choices=("test", "rest", "all"),
        default="test",
        help="of make test; what it leaves out; both, as of tests that are"
        " named with ::",
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Each host in turn as `host`."""
    if "host" in metafunc.fixturenames:
        is_one = metafunc.definition.get_closest_marker("one_host")
        hosts = [main_host()] if is_one else all_hosts()
        metafunc.parametrize("host", hosts, ids=attrgetter("name"))


_LEFT = pytest.StashKey[int]()


# What -k and the like leave out is nothing that make test-all would run
@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Leave out what --cases does, and count it."""
    cases = config.option.cases
    # Whoever names a test wants to see it run
    if any("::" in name for name in config.args):
        cases = "all"
    if cases != "all":
        wanted = {item: _is_in_make_test(item) for item in items}
        others = [n for n in items if wanted[n] is (cases == "rest")]
        config.hook.pytest_deselected(items=others)
        items[:] = [n for n in items if wanted[n] is (cases == "test")]
        if cases == "test":
            config.stash[_LEFT] = len(others)
    items.sort(key=_turn)
    for item in items:
        host = _host_of(item)
        if host is not None:
            # The reports of a test say on which it was
            item.user_properties.append(("host", host.name))


def _is_in_make_test(item: pytest.Item) -> bool:
    """All but what is slow, on the main host or on every host."""
    if item.get_closest_marker("slow") is not None:
        return False
    host = _host_of(item)
    return (
        host is None
        or item.get_closest_marker("every_host") is not None
        or host == main_host()
    )


def _host_of(item: pytest.Item) -> Optional[Host]:
    """What a test was given, by whatever name."""
    callspec = getattr(item, "callspec", None)
    values = callspec.params.values() if callspec else ()
    return next((value for value in values if isinstance(value, Host)), None)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: WorkerController) -> None:
    """What a worker of xdist has left out: each collects everything."""
    output = getattr(node, "workeroutput", {})
    if "left" in output:
        node.config.stash[_LEFT] = output["left"]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(
    config: pytest.Config, log: Producer
) -> Optional[LoadFileScheduling]:
    """With files that stay in one process, so does what files share."""
    return _ByFile(config, log) if config.option.dist == "loadfile" else None


# Waits for browsers, servers and a clock that nobody turns. One worker goes through
# them, from the beginning, while the others compute: at the end nobody would.
_REAL_TIME = re.compile(
    r"tools/playground/tests/|tools/kit/tests/test_live\.py"
    r"|simprinter/tests/test_play\.py|tests/(?:moonraker|farm)/"
)

# Long, and each by itself
_APART = re.compile(r"tools/campaign/tests/test_walks\.py")


def _turn(item: pytest.Item) -> int:
    """What takes long comes first, so that all workers end at the same time."""
    if _REAL_TIME.match(item.nodeid):
        return 0
    return 1 if _APART.match(item.nodeid) else 2


class _ByFile(LoadFileScheduling):
    def _split_scope(self, nodeid: str) -> str:
        if _APART.match(nodeid):
            return nodeid
        is_waiting = _REAL_TIME.match(nodeid)
        return "real time" if is_waiting else super()._split_scope(nodeid)


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
    terminalreporter.section("hosts")
    terminalreporter.line(plain(rows[0], rows[1:]))


# Behind the last line of pytest itself
@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """How much make test has left out."""
    left = config.stash.get(_LEFT, 0)
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if left and reporter is not None:
        reporter.write_line(f"{left} cases left to make test-all")
