"""Every host, printers on it, and what has run where."""

from __future__ import annotations

import gc
import re
import subprocess
from collections import Counter
from collections.abc import Callable, Generator, Iterator
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
from tools.kit import failing, load_errors
from tools.kit.cases import drawn
from tools.kit.printer import MODULES, ROOT, Printer
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
    """Which part of all cases runs, and on which hosts."""
    parser.addoption(
        "--cases",
        choices=("test", "rest", "each", "one", "all"),
        default="test",
        help="of make test; what it leaves out; both, each case on its host;"
        " on the main host; every case on every host. Of tests that are named"
        " with :: the first three mean: on the main host",
    )
    parser.addoption(
        "--host-seed",
        metavar="TEXT",
        help="what draws, with a case's name, the host that it runs on"
        " (default: the commit), to run the same again",
    )


def pytest_configure(config: pytest.Config) -> None:
    """The draw is the same in all workers: xdist hands them these options."""
    if config.option.host_seed is None:
        config.option.host_seed = _commit()


def _commit() -> str:
    command = ["git", "rev-parse", "--short=12", "HEAD"]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    except OSError:
        return "none"
    # What was downloaded as an archive has no commit
    return done.stdout.strip() or "none"


def pytest_report_header(config: pytest.Config) -> str:
    """How to run the same cases on the same hosts again."""
    return f"hosts: drawn with --host-seed {config.option.host_seed}"


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Each host in turn as `host`."""
    if "host" in metafunc.fixturenames:
        is_one = metafunc.definition.get_closest_marker("one_host")
        hosts = [main_host()] if is_one else all_hosts()
        metafunc.parametrize("host", hosts, ids=attrgetter("name"))


_LEFT = pytest.StashKey[int]()


# What -k and the like leave out is nothing that make test-rest would run
@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Leave out what --cases does, and count what make test-rest would run."""
    for item in items:
        _require_reason(item)
    cases = _cases(config)
    kept = [item for item in items if _is_on_its_host(item, cases)]
    if cases in ("test", "rest"):
        slow = {item for item in kept if item.get_closest_marker("slow")}
        if cases == "test":
            config.stash[_LEFT] = len(slow)
        kept = [item for item in kept if (item in slow) is (cases == "rest")]
    wanted = {*kept}
    config.hook.pytest_deselected(items=[i for i in items if i not in wanted])
    items[:] = sorted(kept, key=_turn)
    for item in items:
        host = _host_of(item)
        if host is not None:
            # The reports of a test say on which it was
            item.user_properties.append(("host", host.name))


def _cases(config: pytest.Config) -> str:
    """Those of --cases; whoever names tests wants to see them run."""
    cases = config.option.cases
    is_named = any("::" in name for name in config.args)
    return "one" if is_named and cases != "all" else cases


def _require_reason(item: pytest.Item) -> None:
    for mark in item.iter_markers("every_host"):
        if not (mark.args and str(mark.args[0]).strip()):
            raise pytest.UsageError(
                f"{item.nodeid}: every_host needs the reason, in words, why"
                " one host is not enough"
            )


def _is_on_its_host(item: pytest.Item, cases: str) -> bool:
    """Whether a case runs on the host that it was given."""
    host, config = _host_of(item), item.config
    if host is None or cases == "all":
        return True
    if cases == "one":
        # Brackets name a host, too
        return any("[" in n for n in config.args) or host == main_host()
    if item.get_closest_marker("one_host"):
        return True
    if item.get_closest_marker("every_host"):
        return True
    # The case without its host
    test, _, values = item.nodeid.partition("[")
    case = f"{test}[{values.replace(host.name, '', 1)}"
    return drawn(case, config.option.host_seed, all_hosts()) == host


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
    r"|simplay/tests/test_play\.py|tests/moonraker/"
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


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """No printer of the test before is of interest any more."""
    failing.forget()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A test that has failed shows what its printers have told."""
    report = yield
    if report.failed:
        whole = _cases(item.config) == "one"
        report.sections += failing.sections(item.nodeid, whole)
    return report


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
        reporter.write_line(f"{left} cases left to make test-rest")
