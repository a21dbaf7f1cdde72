"""Z_CALIBRATION_REPORT as a process: klippy goes on, whatever becomes of it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tools.kit.printer import FOLDER, module_files
from tools.kit.z_calibration import calibration, reported, section

REPORT = "Z_CALIBRATION_REPORT"
# So long (s) instead of a minute
SHORT = 2.0


@pytest.fixture
def planted(tmp_path):
    """The modules with another program in place of the report, its lines."""

    def plant(text: str) -> dict[str, Path]:
        files = module_files()
        ignored = shutil.ignore_patterns("__pycache__")
        copy = tmp_path / FOLDER
        shutil.copytree(files[FOLDER], copy, ignore=ignored)
        (copy / "report" / "__main__.py").write_text(text)
        process = copy / "z_calibration" / "report_process.py"
        source = process.read_text()
        assert "\nREPORT_TIME = 60.0\n" in source
        source = source.replace("REPORT_TIME = 60.0", f"REPORT_TIME = {SHORT}")
        process.write_text(source)
        return {**files, FOLDER: copy}

    return plant


def hanging(path: Path) -> str:
    """A program that writes its number there, and does not end."""
    return (
        "import os, time\n"
        f"open({str(path)!r}, 'w').write(str(os.getpid()))\n"
        "time.sleep(1000)\n"
    )


def is_there(path: Path) -> bool:
    """Whether the process whose number stands there lives."""
    try:
        os.kill(int(path.read_text()), 0)
    except ProcessLookupError:
        return False
    return True


def test_it_is_another_process_that_gives_way(start, planted):
    program = (
        "import os, sys\n"
        "print(os.nice(0), sys.argv[1:2], len(sys.stdin.read()))\n"
    )
    printer = start(modules=planted(program))
    printer.session.require_ready()
    # From what klippy has itself, which is ours
    nicest = str(min(os.nice(0) + 19, 19))
    line = reported(printer, f"{nicest} [").partition("z_calibration: ")[2]
    nice, argument, facts = line.split()
    history = printer.session.data / "config" / "z_calibration/printer.jsonl"
    assert (nice, argument) == (nicest, f"['{history}']")
    # What klippy knows comes with it
    assert int(facts) > 1000


def test_failure_is_reported_in_its_words(start, planted):
    program = "import sys\nsys.exit('the disk is full')\n"
    printer = start(modules=planted(program))
    printer.session.require_ready()
    line = reported(printer, "the report has failed")
    assert line.endswith("the report has failed: the disk is full")
    # And again, when it is asked for again
    reported(printer, "the report has failed: the disk is full")
    assert printer.session.state()[0] == "ready"


def test_program_that_cannot_be_run_is_reported(start, planted):
    modules = planted("")
    shutil.rmtree(modules[FOLDER] / "report")
    printer = start(modules=modules)
    printer.session.require_ready()
    line = reported(printer, "the report has failed: ")
    assert "No such file or directory" in line


def test_process_that_cannot_be_started_is_one_sentence(start, planted):
    modules = planted("")
    process = modules[FOLDER] / "z_calibration" / "report_process.py"
    source = process.read_text()
    assert source.count("sys.executable") == 1
    source = source.replace('shutil.which("nice") or "nice"', '"/no/nice"')
    process.write_text(source)
    printer = start(modules=modules).homed()
    text = printer.fail("Z_CALIBRATION_REPORT")
    assert "z_calibration: the report cannot be started: [Errno 2]" in text
    printer.run("CALIBRATE_Z_ACCURACY CYCLES=2")
    console = "\n".join(printer.session.console)
    assert "z_calibration: the report cannot be started: [Errno 2]" in console


def no_file(path: Path, what: str) -> None:
    """Put something in the place of the history that is no file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if what == "folder":
        path.mkdir()
    elif what == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(what)


NO_FILES = ["folder", "pipe", "/dev/zero", "/dev/full"]


@pytest.mark.parametrize("what", NO_FILES)
def test_history_that_is_no_file_still_gives_a_text(start, what):
    """Just then one wants to ask somebody; a pipe held klippy for ever."""
    printer = start().homed()
    path = printer.session.data / "config" / "z_calibration/printer.jsonl"
    no_file(path, what)
    calibration(printer)
    printer.session.restart("RESTART")
    printer.homed()
    calibration(printer)
    notes = printer.status("z_calibration")["notes"]
    assert any("it is no file" in note for note in notes)
    line = reported(printer, "no runs are in the report: it is no file")
    assert str(path) in line
    printer.session.wait(1.0)
    assert any("attach " in line for line in printer.session.console)
    (text,) = path.parent.glob("report-*.txt")
    assert "nozzle_xy_position" in text.read_text()
    if what != "folder":
        path.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("what", ["printer.jsonl", "nowhere/at/all"])
def test_link_that_leads_nowhere_ends_with_a_sentence(start, what):
    """To itself, or to what is not there."""
    printer = start().homed()
    path = printer.session.data / "config" / "z_calibration/printer.jsonl"
    no_file(path, what)
    calibration(printer)
    printer.run(REPORT)
    for _ in range(60):
        if any("the report" in n for n in printer.session.console):
            return
        printer.session.wait(0.5)
    raise AssertionError(printer.session.console)


def test_one_that_hangs_is_ended_and_klippy_goes_on(start, planted, tmp_path):
    number = tmp_path / "number"
    printer = start(modules=planted(hanging(number))).homed()
    printer.run(REPORT)
    lines = printer.run(REPORT)
    assert "a report is under way; wait until it is done" in lines[-1]
    calibration(printer)
    printer.run("G4 P500")
    ended = f"the report took more than {SHORT:.0f} s; ended"
    for _ in range(20):
        if any(ended in line for line in printer.session.console):
            break
        printer.session.wait(0.5)
    assert sum(ended in line for line in printer.session.console) == 1
    assert not is_there(number)
    # The next one may begin
    printer.run(REPORT)


@pytest.mark.parametrize("command", ["RESTART", "emergency_stop"])
def test_none_outlives_klippy(start, planted, tmp_path, command):
    number = tmp_path / "number"
    printer = start(modules=planted(hanging(number))).homed()
    printer.run(REPORT)
    for _ in range(20):
        if number.exists() and number.read_text():
            break
        printer.session.wait(0.05)
    assert is_there(number)
    if command == "RESTART":
        printer.session.restart(command)
        printer.session.require_ready()
    else:
        printer.session.call(command, {})
        printer.session.wait(0.5)
    assert not is_there(number)


def test_much_that_it_says_fills_nothing_up(start, planted):
    """A pipe holds 64 KiB, and klippy reads when the process has ended."""
    program = (
        "import sys\n"
        "print('first')\n"
        "sys.stdout.write('x' * 300000)\n"
        "sys.stderr.write('x' * 300000)\n"
    )
    printer = start(modules=planted(program))
    printer.session.require_ready()
    assert reported(printer, "first").endswith("z_calibration: first")


def test_accuracy_run_waits_for_no_report(start, planted, tmp_path):
    """It is the user's, begun while that was under way."""
    modules = planted(hanging(tmp_path / "number"))
    changes = section(end_gcode=REPORT)
    printer = start(changes=changes, modules=modules).homed()
    lines = printer.run("CALIBRATE_Z_ACCURACY CYCLES=2 ATTACH=0")
    text = f"a report is under way; {REPORT} tells the verdict when it is done"
    assert any(text in line for line in [*lines, *printer.session.console])


def test_verdict_of_an_accuracy_run_comes_with_the_next_report_too(start):
    printer = start().homed()
    printer.run("CALIBRATE_Z_ACCURACY CYCLES=2")
    printer.session.wait(2.0)
    words = "verdict of CALIBRATE_Z_ACCURACY: 2 cycles are too few"
    reported(printer, words)
    # With another last run there is none
    printer.run("CALIBRATE_Z")
    count = len(printer.session.console)
    reported(printer, "attach ")
    assert not any(words in line for line in printer.session.console[count:])


def test_without_a_history_there_is_no_verdict(start):
    printer = start(changes=section(history="none")).homed()
    printer.run("CALIBRATE_Z_ACCURACY CYCLES=2")
    text = "there is no verdict, as 'history' is none"
    assert any(text in line for line in printer.session.console)
