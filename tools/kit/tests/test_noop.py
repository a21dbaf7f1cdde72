"""make noop names the tests that pass although no command of ours does anything."""

from __future__ import annotations

import subprocess
import sys

import pytest

from simprinter.hosts.environment import REPO_ROOT
from simprinter.hosts.hosts import main_host

pytestmark = pytest.mark.slow

FILE = """
def test_nothing_is_told(start):
    assert start().homed().run("CALIBRATE_Z") is not None


def test_nothing_is_told_of_a_membrane(start):
    printer = start("membrane").homed()
    assert printer.run("EXTRA_PROBE PROBE=membrane") is not None


def test_something_happens(start):
    printer = start().homed()
    printer.run("CALIBRATE_Z")
    assert printer.machine.truth.touches[-1].site == "probe_bed"


def test_no_command_of_ours(start):
    assert start().homed().offset() == 0.0


def test_host_s_own_command_that_ours_has_taken_over(start):
    printer = start().homed()
    printer.run("SET_GCODE_OFFSET Z=0.1")
    assert printer.offset() == 0.1
"""


def test_those_that_say_too_little_are_named(tmp_path, monkeypatch):
    monkeypatch.setenv("ONE_HOST", "1")
    path = tmp_path / "test_some.py"
    path.write_text(FILE)
    command = [sys.executable, "-m", "pytest", "-c", "pyproject.toml"]
    command += ["-p", "tools.noop", "-q", "--tb=no", "-r", "", "-n", "2"]
    done = subprocess.run(
        [*command, path], cwd=REPO_ROOT, stdout=subprocess.PIPE, text=True
    )
    assert done.returncode == 1, done.stdout
    name = main_host().name
    _, _, shown = done.stdout.partition("pass although nothing is done")
    assert [line.rpartition("::")[2] for line in shown.splitlines()[1:4]] == [
        f"test_nothing_is_told[{name}]: CALIBRATE_Z",
        f"test_nothing_is_told_of_a_membrane[{name}]: EXTRA_PROBE",
        "2 pass although nothing is done, 1 fail, 2 run no command of ours",
    ]
