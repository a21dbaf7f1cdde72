"""The tests of programs are there only where programs are given."""

from __future__ import annotations

import pytest

from simprinter.hosts.hosts import Host
from tests.firmware.programs import given, program_for

collect_ignore_glob = [] if given() else ["test_firmware_*.py"]


@pytest.fixture(autouse=True)
def fitting(request: pytest.FixtureRequest) -> None:
    """A host that no program is for has nothing to run on."""
    callspec = getattr(request.node, "callspec", None)
    host = callspec.params.get("host") if callspec and given() else None
    if isinstance(host, Host) and program_for(host) is None:
        pytest.skip(f"no program that {host.name} would take is given")
