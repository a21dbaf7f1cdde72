"""Which cases make test runs, which it leaves out, and that both are all."""

from __future__ import annotations

import functools
import subprocess
import sys

import pytest

from simprinter.hosts.environment import REPO_ROOT
from simprinter.hosts.hosts import all_hosts, usual_hosts
from tools.kit.plugin import usual_host

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
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("some") / "test_some.py"
    path.write_text(FILE)
    return path


@functools.cache
def run(*words):
    """What pytest says."""
    command = [sys.executable, "-m", "pytest", "-c", "pyproject.toml"]
    command += map(str, words)
    done = subprocess.run(
        command, cwd=REPO_ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def collected(*words):
    """Names of the cases, in their order."""
    lines = run("--collect-only", "-q", "-p", "no:xdist", *words).splitlines()
    return [line.partition("::")[2] for line in lines if "::" in line]


def test_make_test_runs_what_is_quick_and_what_hosts_differ_in(file):
    names = [host.name for host in all_hosts()]
    one = usual_host(file).name
    assert collected(file) == [
        "test_without_a_host",
        f"test_table[{one}-1]",
        *(f"test_what_hosts_differ_in[{name}-1]" for name in names),
    ]


def test_rest_is_all_others(file):
    cases = [collected(file, "--cases", part) for part in ("test", "rest")]
    everything = collected(file, "--cases", "all")
    assert len(everything) == 2 + 4 * len(all_hosts())
    assert len(set(everything)) == len(everything)
    assert sorted(sum(cases, [])) == sorted(everything)
    assert not {*cases[0]} & {*cases[1]}


@pytest.mark.parametrize(
    "workers", [0, pytest.param(2, marks=pytest.mark.slow)]
)
def test_what_is_left_is_counted_in_the_last_line(file, workers):
    # What nobody has asked for is not left
    lines = run(file, "-n", workers, "-k", "long or without").splitlines()
    assert lines[-1] == "1 cases left to make test-all"


def test_nothing_is_left_by_make_test_all(file):
    out = run(file, "--cases", "all", "-k", "long or without")
    assert "2 passed" in out and "left to" not in out


def test_whoever_names_a_test_sees_it_run(file):
    assert collected(f"{file}::test_long") == ["test_long"]


def test_files_take_turns_where_there_are_packages_only(tmp_path, monkeypatch):
    files = [tmp_path / f"test_{letter}.py" for letter in "abcd"]
    for path in files:
        path.touch()
    hosts = usual_hosts()
    turns = [hosts[i % len(hosts)] for i in range(4)]
    assert [usual_host(path) for path in files] == turns
