"""Which cases of long tables run without EVERY_HOST."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from simprinter.hosts.environment import REPO_ROOT
from simprinter.hosts.hosts import find_hosts

# Spread over the hosts, with tables of which some cases run
FILE = "tests/modules/test_auto_z_offset_safety.py"
SHARED = "test_single_fault_of_a_sensor"
# Marked each_host
NOT_SPREAD = ("emergency_stop", "homes_to_something_else")


def collected(**environment):
    """Names of the cases, without that of the host; one for each item."""
    known = {k: v for k, v in os.environ.items() if k != "EVERY_HOST"}
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q"]
    done = subprocess.run(
        [*command, "-p", "no:xdist", FILE],
        cwd=REPO_ROOT,
        env={**known, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    lines = [line for line in done.stdout.splitlines() if "::" in line]
    # The name of one may begin with that of another
    names = [host.name for host in find_hosts()]
    for name in sorted(names, key=len, reverse=True):
        lines = [line.replace(name, "HOST") for line in lines]
    return [line.partition("::")[2] for line in lines]


@pytest.fixture(scope="module")
def all_cases():
    return set(collected(EVERY_HOST="1"))


@pytest.fixture(scope="module")
def chosen():
    return collected()


def plain(name):
    """A case that says its host or, of a table for some host, does not."""
    return name.replace("HOST-", "").replace("[HOST]", "").replace("-HOST", "")


def test_each_case_runs_on_one_host(all_cases, chosen):
    once = [n for n in chosen if not any(word in n for word in NOT_SPREAD)]
    assert len(once) == len(set(once))
    found = {plain(name) for name in chosen}
    left_out = {name for name in all_cases if plain(name) not in found}
    # Only tables marked `some` lose anything
    assert {name.partition("[")[0] for name in left_out} == {
        SHARED,
        "test_axes_must_be_homed",
        "test_driver_that_does_not_answer",
        "test_lost_connection_is_the_only_end_of_the_printer",
        "test_measurement_inside_a_measurement",
        "test_trigger_in_mid_air",
        "test_trigger_that_is_late",
    }


def test_share_of_a_table_has_every_value(all_cases, chosen):
    full = {plain(name) for name in all_cases if name.startswith(SHARED)}
    share = {plain(name) for name in chosen if name.startswith(SHARED)}
    assert share < full
    # The mark says every eighth, shifted in each round
    assert len(share) == len(full) // 9
    for value in ("-None]", "--1.12]", "[trigger_never", "[stuck_open", "-3-"):
        assert any(value in name for name in share), value
