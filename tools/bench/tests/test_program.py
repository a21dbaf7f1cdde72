"""The program of the benchmark, with modules that do not run."""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from simprinter.hosts.hosts import main_host
from tools.bench import __main__ as bench
from tools.bench import cost, timing
from tools.bench.commands import AUTO_Z_CALIBRATE, CALIBRATE_Z
from tools.bench.timing import Subject, attempt
from tools.kit.printer import module_files

# One run of the program is behind most of them
pytestmark = [pytest.mark.timeout(300), pytest.mark.slow]

TIMED = (CALIBRATE_Z, AUTO_Z_CALIBRATE)
RUNS = timing.RUNS[:1]
CELL = re.compile(r"(\d+\.\d\d)/(\d+\.\d\d)=(\d+\.\d\d)")

MODULES = {
    "same": None,
    "no_start": "def load_config(config):\n    raise config.error('not me')\n",
    # Klippy insists on somebody reading every option
    "no_command": (
        "def load_config(config):\n"
        "    for option in config.get_prefix_options(''):\n"
        "        config.get(option)\n"
    ),
    "dead": "import os\ndef load_config(config):\n    os._exit(3)\n",
}
REASONS = {
    "no_start": "not me",
    "dead": "klippy has ended",
    "missing": "there is no file",
}


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """One run of it with many modules: files by name, output, figures.

    The first process of the tests that needs it runs it, for all of them.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    told = folder / "bench_program.json"
    with open(folder / "bench_program.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not told.exists():
            told.write_text(json.dumps(run_program(folder / "bench")))
    found = json.loads(told.read_text())
    found["files"] = {name: Path(file) for name, file in found["files"].items()}
    return SimpleNamespace(**found)


def run_program(folder):
    """Run it there; all that the tests look at."""
    folder.mkdir()
    files = {"missing": folder / "missing.py"}
    for name, text in MODULES.items():
        files[name] = folder / f"{name}.py"
        if text is None:
            shutil.copy(module_files()["z_calibration"], files[name])
        else:
            files[name].write_text(text)
    host = main_host().name
    # The one that works comes last, after all that do not
    order = sorted(files, key=lambda name: name == "same")
    options = [word for name in order for word in ("--module", files[name])]
    written = folder / "figures.json"
    options += ["--builtin", "--host", host, "--json", written]
    options += ["--seeds", 0, "--no-chart"]
    output = io.StringIO()
    with contextlib.redirect_stdout(output), in_folder(folder):
        status = bench.main([str(option) for option in options])
    figures = json.loads(written.read_text())
    timings = {
        entry["module"]: entry
        for entry in figures["timings"]
        if entry["host"] == host and entry["command"] == "CALIBRATE_Z"
    }
    return {
        "host": host,
        "status": status,
        "files": {name: str(file) for name, file in files.items()},
        "lines": output.getvalue().splitlines(),
        "all_figures": figures,
        "figures": timings,
        "kept": (folder / "performance.json").read_text(),
    }


@contextlib.contextmanager
def in_folder(folder):
    """Let the program write there, not over an owner's figures, and hurry."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "folder", lambda: folder)
        # As for any other; each takes seconds
        patch.setattr(bench, "COMMANDS", TIMED)
        patch.setattr(timing, "RUNS", RUNS)
        # Each takes as long as a start of klippy
        patch.setattr(cost, "LOADINGS", 1)
        yield


def line_of(program, name):
    """The line of a module on the program's host, about CALIBRATE_Z."""
    begin = next(
        number
        for number, line in enumerate(program.lines)
        if line.startswith("CALIBRATE_Z: ")
    )
    found = [
        line for line in program.lines[begin:] if line.startswith(f"  {name}  ")
    ]
    return found[0]


def test_modules_that_do_not_run_are_reported_with_the_reason(program):
    assert program.status == 0
    for name, words in REASONS.items():
        file = str(program.files[name])
        assert words in program.figures[file]["failure"]
        assert program.figures[file]["runs"] == []
        assert words in line_of(program, file)
        assert not CELL.search(line_of(program, file))
    entry = program.figures[str(program.files["no_command"])]
    # Klippy says so on the console only
    assert "has not touched nozzle_pin, body_pin, probe_bed" in entry["failure"]


def test_own_module_of_the_host(program):
    entry = program.figures["the host's own"]
    if program.host.startswith("klipper"):
        assert "z_calibration" in entry["failure"]
    else:
        assert len(entry["runs"]) == len(RUNS)


def test_printed_numbers_are_the_figures(program):
    file = str(program.files["same"])
    for name in ("ours", file):
        runs = program.figures[name]["runs"]
        cells = CELL.findall(line_of(program, name))
        assert len(cells) == len(runs) == len(RUNS)
        for cell, run in zip(cells, runs):
            wanted = [run[key] for key in ("seconds", "bound", "ratio")]
            assert list(map(float, cell)) == pytest.approx(wanted, abs=0.006)
        assert re.search(r" 9  3\+3\+3  CPU ", line_of(program, name))
    times, _, cpu = line_of(program, f"ours / {file}").partition("  CPU ")
    assert float(cpu) > 0.0
    runs = zip(program.figures["ours"]["runs"], program.figures[file]["runs"])
    wanted = [first["seconds"] / other["seconds"] for first, other in runs]
    printed = list(map(float, times.split()[-len(RUNS) :]))
    assert printed == pytest.approx(wanted, abs=0.006)
    assert wanted == pytest.approx([1.0] * len(RUNS), abs=0.1)


def test_every_command_is_timed_beside_its_lower_bound(program):
    timings = program.all_figures["timings"]
    assert {entry["host"] for entry in timings} == {program.host}
    own = {e["command"]: e["runs"] for e in timings if e["module"] == "ours"}
    assert {name: len(runs) for name, runs in own.items()} == {
        command.name: len(RUNS) for command in TIMED
    }
    tables = [line for line in program.lines if "lower bound of" in line]
    starts = {
        (entry["command"], *(round(p, 1) for p in run["start"]))
        for entry in timings
        for run in entry["runs"]
    }
    assert len(tables) == len(starts)


def test_loading_is_measured(program):
    costs = {c["module"]: c for c in program.all_figures["costs"]}
    same = costs[str(program.files["same"])]
    own = costs["z_calibration"]
    assert own["memory_kib"] == pytest.approx(same["memory_kib"], rel=0.05)
    assert 100.0 < own["memory_kib"] < 2000.0
    assert min(cost["import_ms"] for cost in costs.values()) > 0.0
    assert str(program.files["missing"]) not in costs
    assert (same["other"], own["other"]) == (True, False)


def test_figures_are_kept_from_the_first_phases_on(program):
    assert json.loads(program.kept) == program.all_figures


def test_unknown_host_is_said(capsys):
    assert bench.main(["--host", "no such host"]) == 1
    assert "no such host" in capsys.readouterr().out


def test_own_failure_is_the_programs(monkeypatch, capsys, host, tmp_path):
    missing = Subject("ours", {"z_calibration": tmp_path / "missing.py"})
    assert "there is no file" in attempt(host, missing, CALIBRATE_Z)
    monkeypatch.setattr(bench, "ours", lambda module: missing)
    monkeypatch.setattr(bench, "COMMANDS", (CALIBRATE_Z,))
    options = ["--host", host.name, "--seeds", "0", "--no-chart"]
    with in_folder(tmp_path):
        assert bench.main(options) == 1
    assert "there is no file" in capsys.readouterr().out
