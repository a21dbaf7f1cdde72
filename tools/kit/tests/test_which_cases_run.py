"""make test and make test-rest run every case between them."""

from __future__ import annotations

import subprocess
import sys

import pytest

from simprinter.hosts.environment import REPO_ROOT
from simprinter.hosts.hosts import all_hosts, main_host

pytestmark = pytest.mark.slow

FILE = """
import pytest


def test_without_a_host():
    pass


@pytest.mark.parametrize("n", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_table(host, n):
    pass


@pytest.mark.every_host
@pytest.mark.parametrize("n", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_hosts_differ_in(host, n):
    pass


@pytest.mark.slow
def test_long():
    pass


@pytest.mark.one_host
def test_tool(host):
    pass
"""


@pytest.fixture
def collected(tmp_path):
    """collected(part): names of the cases of --cases, in their order."""
    path = tmp_path / "test_some.py"
    path.write_text(FILE)

    def names(part):
        command = [sys.executable, "-m", "pytest", "-c", "pyproject.toml"]
        command += ["--collect-only", "-q", "-p", "no:xdist", "--cases", part]
        done = subprocess.run(
            [*command, path], cwd=REPO_ROOT, stdout=subprocess.PIPE, text=True
        )
        assert done.returncode == 0, done.stdout
        lines = done.stdout.splitlines()
        return [line.partition("::")[2] for line in lines if "::" in line]

    return names


@pytest.mark.parametrize("workers", [0, 2])
def test_last_line_counts_what_is_left(tmp_path, workers):
    path = tmp_path / "test_some.py"
    path.write_text(FILE)
    command = [sys.executable, "-m", "pytest", "-c", "pyproject.toml"]
    command += ["-k", "long or without", "-n", str(workers), path]
    ends = []
    for part in ("test", "all"):
        done = subprocess.run(
            [*command, "--cases", part],
            cwd=REPO_ROOT,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert done.returncode == 0, done.stdout
        ends.append(done.stdout.splitlines()[-1])
    assert ends[0] == "1 cases left to make test-all"
    assert "2 passed" in ends[1]


def test_each_case_is_in_one_of_both(collected):
    test, rest, everything = map(collected, ("test", "rest", "all"))
    assert test == [
        "test_without_a_host",
        f"test_table[{main_host().name}-1]",
        *(f"test_what_hosts_differ_in[{h.name}-1]" for h in all_hosts()),
        f"test_tool[{main_host().name}]",
    ]
    assert len({*everything}) == 3 + 4 * len(all_hosts())
    assert sorted(test + rest) == sorted(everything)
