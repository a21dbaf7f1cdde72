"""The tests of programs are there only where programs are given."""

from __future__ import annotations

import pytest

from simprinter.hosts.hosts import Host
from tests.firmware.programs import given, program_for

collect_ignore_glob = [] if given() else ["test_firmware_*.py"]
# Tells of a host that no program is for, once
ONCE = "test_host_speaks_with_a_program"


def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """A host that no program is for has nothing else to run on."""
    useless = [item for item in items if _is_useless(item)]
    config.hook.pytest_deselected(items=useless)
    items[:] = [item for item in items if item not in useless]


def _is_useless(item: pytest.Item) -> bool:
    callspec = getattr(item, "callspec", None)
    host = callspec.params.get("host") if callspec else None
    return (
        item.path.name.startswith("test_firmware_")
        and isinstance(host, Host)
        and ONCE not in item.name
        and program_for(host) is None
    )
