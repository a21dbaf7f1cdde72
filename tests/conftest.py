"""Fixtures only: every host, and printers on it."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from operator import attrgetter

import pytest
from hypothesis import HealthCheck, settings

from tests.hostkit import load_errors, starting
from tests.hostkit.hosts import Host, all_hosts
from tests.hostkit.printer import Printer

# A machine that is busy is no failure
settings.register_profile(
    "untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("untimed")


def pytest_sessionfinish() -> None:
    """End what was kept for the next configuration, and the next start."""
    load_errors.close()
    starting.close()


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
    `half`, half of the cases run without it.
    """
    if os.environ.get("EVERY_HOST"):
        return
    halved = _halved(items)
    chosen = {i for i in items if i not in halved and _is_its_turn(i)}
    config.hook.pytest_deselected(items=[i for i in items if i not in chosen])
    items[:] = [item for item in items if item in chosen]


def _halved(items: list[pytest.Item]) -> set[pytest.Item]:
    """Half of the cases, on whichever host, of each test marked `half`."""
    cases: dict[str, list[str]] = {}
    left_out = set()
    for item in items:
        if item.get_closest_marker("half") is None:
            continue
        case = _case(item)
        table = cases.setdefault(case.partition("[")[0], [])
        if case not in table:
            table.append(case)
        number = table.index(case)
        # By pairs, as every second one would be one value of the last option
        if (number + number // 2) % 2:
            left_out.add(item)
    return left_out


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


@pytest.fixture
def some_host(request: pytest.FixtureRequest) -> Host:
    """One of the hosts, another for another test: for long tables."""
    return _drawn(request.node.nodeid)


@pytest.fixture
def one_host() -> Host:
    """Any host, for what takes long and does not depend on it."""
    return all_hosts()[-1]


@pytest.fixture
def start(host: Host) -> Iterator[Callable[..., Printer]]:
    """start(scene, changes, faults, seed ...): a Printer on the host."""
    with ExitStack() as stack:
        yield lambda *args, **options: stack.enter_context(
            Printer(host, *args, **options)
        )
