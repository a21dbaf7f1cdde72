"""Fixtures only: Moonraker, and a lab on each kind of host."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from simprinter.hosts.hosts import all_hosts, missing_hosts
from simprinter.hosts.moonraker_package import find_moonraker
from tools.kit.lab import Lab
from tools.kit.printer import firmware_of


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One host for each place where modules belong, or each of them.

    Of these one for a test, another for another, where it is not marked
    `each_host`; one for all of a file that has a lab of its own.
    """
    for name, scope in (("lab", "package"), ("copied_lab", "function")):
        if name not in metafunc.fixturenames:
            continue
        hosts = all_hosts()
        if not os.environ.get("EVERY_HOST"):
            hosts = list({firmware_of(host): host for host in hosts}.values())
            if "each_host" not in {
                m.name for m in metafunc.definition.own_markers
            }:
                nodeid = metafunc.definition.nodeid
                if name in vars(metafunc.module):
                    nodeid = nodeid.partition("::")[0]
                turn = zlib.crc32(nodeid.encode())
                hosts = [hosts[turn % len(hosts)]]
        ids = [host.name for host in hosts]
        metafunc.parametrize(name, hosts, ids=ids, indirect=True, scope=scope)


@pytest.fixture(scope="session")
def moonraker_python() -> Path:
    """The Python that has Moonraker; a visible skip where it may be missing."""
    python = find_moonraker()
    if python is None:
        pytest.skip(f"NOT TESTED: {missing_hosts()['moonraker']}")
    return python


# As wide as the folder, since making one takes seconds; not wider, since its
# printer lives on meanwhile
@pytest.fixture(scope="package")
def lab(
    request: pytest.FixtureRequest,
    moonraker_python: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Lab]:
    """A printer on which install.sh was run, with Moonraker in front of it."""
    directory = tmp_path_factory.mktemp("lab")
    with Lab(request.param, moonraker_python, directory) as lab:
        lab.install()
        assert lab.obey() == ["klipper", "moonraker"]
        yield lab


@pytest.fixture
def copied_lab(
    request: pytest.FixtureRequest,
    moonraker_python: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Lab]:
    """A printer whose owner has copied z_calibration and runs no scripts."""
    directory = tmp_path_factory.mktemp("lab")
    with Lab(request.param, moonraker_python, directory) as lab:
        lab.copy_by_hand("z_calibration")
        lab.start_klipper()
        lab.moonraker.wait_until_ready()
        yield lab
