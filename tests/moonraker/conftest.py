"""Fixtures only: Moonraker, and a lab on each kind of host."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from simprinter.hosts.hosts import all_hosts, missing_hosts
from simprinter.hosts.moonraker_package import find_moonraker
from tools.kit.lab import Lab


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A lab on each host."""
    for name, scope in (("lab", "package"), ("copied_lab", "function")):
        if name in metafunc.fixturenames:
            ids = [host.name for host in all_hosts()]
            metafunc.parametrize(
                name, all_hosts(), ids=ids, indirect=True, scope=scope
            )


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
