"""Which part of all cases runs, and on which hosts."""

from __future__ import annotations

import functools
import subprocess
import sys
from collections import Counter

import pytest

from simprinter.hosts.environment import REPO_ROOT
from simprinter.hosts.hosts import all_hosts, main_host
from tools.kit.cases import drawn

pytestmark = pytest.mark.slow

FILE = """
import pytest


def test_without_a_host():
    pass


@pytest.mark.parametrize("n", [*range(8), pytest.param(8, marks=pytest.mark.slow)])
def test_table(host, n):
    pass


@pytest.mark.every_host("each is another one")
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
NO_REASON = """
import pytest


@pytest.mark.every_host{}
def test_what_hosts_differ_in(host):
    pass
"""

HOSTS = [host.name for host in all_hosts()]
MAIN = main_host().name


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """run(*options, names, text): pytest on a file with that text."""
    path = tmp_path_factory.mktemp("cases") / "test_some.py"

    @functools.cache
    def run(*options, names="", text=FILE):
        path.write_text(text)
        command = [sys.executable, "-m", "pytest", "-c", "pyproject.toml"]
        return subprocess.run(
            [*command, *options, f"{path}{names}"],
            cwd=REPO_ROOT,
            stdout=subprocess.PIPE,
            text=True,
        )

    return run


@pytest.fixture
def collected(run):
    """collected(*options, names): which cases would run, in their order."""

    def collected(*options, names=""):
        listing = ("--collect-only", "-q", "-p", "no:xdist")
        done = run(*listing, *options, names=names)
        assert done.returncode == 0, done.stdout
        lines = done.stdout.splitlines()
        return [line.partition("::")[2] for line in lines if "::" in line]

    return collected


def on(hosts, test, *values):
    """Names of the cases of a test on these hosts."""
    return [f"{test}[{'-'.join([host, *values])}]" for host in hosts]


def hosts_of(cases, test, value):
    """On which hosts one case of a test is."""
    return [host for host in HOSTS if f"{test}[{host}-{value}]" in cases]


@pytest.mark.parametrize("workers", [0, 2])
def test_last_line_counts_what_is_left(run, workers):
    options = ("-k", "long or without", "-n", str(workers))
    ends = []
    for part in ("test", "each"):
        done = run(*options, "--cases", part)
        assert done.returncode == 0, done.stdout
        ends.append(done.stdout.splitlines()[-1])
    assert ends[0] == "1 cases left to make test-rest"
    assert "2 passed" in ends[1]


def test_each_case_is_in_one_of_both(collected):
    test, rest, each = (
        collected("--cases", part) for part in ("test", "rest", "each")
    )
    assert not {*test} & {*rest}
    assert sorted(test + rest) == sorted(each)
    assert "test_long" in rest and "test_without_a_host" in test


def test_each_case_is_on_one_host(collected):
    each = collected("--cases", "each")
    for n in range(9):
        assert len(hosts_of(each, "test_table", n)) == 1
    differing = "test_what_hosts_differ_in"
    for n in (1, 2):
        assert hosts_of(each, differing, n) == HOSTS
    assert [case for case in each if case.startswith("test_tool")] == (
        on([MAIN], "test_tool")
    )


def test_every_case_is_on_every_host(collected):
    cases = collected("--cases", "all")
    assert len(cases) == 2 + (9 + 2) * len(HOSTS) + 1
    for n in range(9):
        assert hosts_of(cases, "test_table", n) == HOSTS


def test_in_time_all_hosts_see_all_cases():
    for case in (
        "test_some.py::test_table[-1]",
        "test_some.py::test_table[-2]",
    ):
        seen = Counter(drawn(case, f"{seed}", "abcde") for seed in range(500))
        assert sorted(seen) == [*"abcde"]
        assert min(seen.values()) > 60
    # No two cases go together for ever
    pairs = {
        tuple(drawn(f"test_table[-{n}]", f"{seed}", "abcde") for n in (1, 2))
        for seed in range(500)
    }
    assert len(pairs) == 25


def test_seed_draws_the_same_again(run, collected):
    shown = run("--collect-only").stdout
    (line,) = (n for n in shown.splitlines() if n.startswith("hosts: "))
    seed = line.rpartition(" ")[2]
    assert collected("--host-seed", seed) == collected()
    # And in the workers of xdist, which collect by themselves
    done = run("-n", "2", "-v", "--host-seed", "7")
    ran = {
        line.partition("::")[2].strip()
        for line in done.stdout.splitlines()
        if "PASSED" in line
    }
    assert ran == {*collected("--host-seed", "7")}


def test_named_test_runs_on_the_main_host_slow_or_not(collected):
    table = [*map(str, range(9))]
    assert collected(names="::test_table") == [
        case for n in table for case in on([MAIN], "test_table", n)
    ]
    differing = "test_what_hosts_differ_in"
    assert len(collected(names=f"::{differing}")) == 2
    everywhere = collected("--cases", "all", names=f"::{differing}")
    assert len(everywhere) == 2 * len(HOSTS)


def test_named_case_runs_where_it_says(collected):
    case = f"test_table[{HOSTS[-1]}-8]"
    assert collected(names=f"::{case}") == [case]


def test_every_host_without_a_reason_is_refused(run):
    options = ("--collect-only", "-p", "no:xdist")
    for reason in ("", "(' ')"):
        done = run(*options, text=NO_REASON.format(reason))
        assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert run(*options, text=NO_REASON.format("('why')")).returncode == 0
