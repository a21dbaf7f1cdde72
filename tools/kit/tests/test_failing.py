"""A test that fails shows what its printers have told."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from simprinter.hosts.environment import REPO_ROOT, build_dir
from simprinter.hosts.hosts import main_host

FILE = """
from tools.kit.printer import Printer


def test_passes(start):
    start().homed().run("M117")


def test_left_printer(host):
    with Printer(host) as printer:
        printer.homed()
        printer.fail("CALIBRATE_Z NOZZLE_POSITION=0")
    assert printer.gap == 0


def test_printer_that_stays(start):
    start("qidi").homed()
    start().homed().run("G1 Z900")
"""


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """What pytest has shown of these tests, and where it has put files."""
    path = tmp_path_factory.mktemp("fails") / "test_that_fails_here.py"
    path.write_text(FILE)
    command = [sys.executable, "-m", "pytest", "-c", "pyproject.toml"]
    command += ["-p", "no:xdist", "--cases", "one", path]
    done = subprocess.run(
        command, cwd=REPO_ROOT, stdout=subprocess.PIPE, text=True
    )
    yield done.stdout
    for name in ("test_left_printer", "test_printer_that_stays"):
        folder = f"{name}-{main_host().name}"
        shutil.rmtree(build_dir() / "failed" / folder)


def parts(shown):
    """Texts by their titles, for each test that has failed."""
    _, *tests = re.split(r"(?m)^_{3,} (\w+)\[.* _{3,}$", shown)
    found = {}
    for name, text in zip(tests[::2], tests[1::2]):
        _, *titled = re.split(r"(?m)^-{3,} (.*) -{3,}$", text)
        found[name] = dict(zip(titled[::2], titled[1::2]))
    return found


def test_console_log_and_configuration_are_shown(shown):
    host = f"printer 1 on {main_host().name}"
    found = parts(shown)
    assert [*found] == ["test_left_printer", "test_printer_that_stays"]
    left = found["test_left_printer"]
    assert "!! " in left[f"{host}: the end of console.txt"]
    log = left[f"{host}: the end of klippy.log"]
    assert log.strip() and "Stats " not in log
    assert "[z_calibration]\n" in left[f"{host}: printer.cfg"]
    assert (
        f"::test_left_printer[{main_host().name}]"
        in (left["again"].partition("=" * 20)[0])
    )
    # Both printers of the other one
    logs = [
        title
        for title in found["test_printer_that_stays"]
        if title.endswith("klippy.log")
    ]
    assert len(logs) == 2


def test_files_are_kept_and_can_be_run(shown):
    host = f"printer 1 on {main_host().name}"
    left = parts(shown)["test_left_printer"]
    folder, _, names = left[f"{host}: its files"].strip().rpartition(": ")
    for name in names.split(", "):
        assert (Path(folder) / name).read_text().strip(), name
    sent = (Path(folder) / "commands.gcode").read_text().splitlines()
    assert sent == ["G28", "CALIBRATE_Z NOZZLE_POSITION=0"]
    _, line = left[f"{host}: by hand"].strip().splitlines()
    done = subprocess.run(
        shlex.split(line),
        cwd=REPO_ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert "> CALIBRATE_Z NOZZLE_POSITION=0" in done.stdout
    assert "NOZZLE_POSITION" in done.stdout.splitlines()[-1]
