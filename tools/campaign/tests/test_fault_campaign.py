"""Some cases of the fault campaign, and that it can find something."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import lru_cache

import pytest

from tools.campaign import faults, running
from tools.campaign.breaking import PUT_ON, SENSOR_FAULTS, STICKS, Break
from tools.campaign.faults import Case
from tools.campaign.jobs import ALL_JOBS, OfJob
from tools.campaign.judging import is_blind
from tools.campaign.running import Done
from tools.campaign.tests.planting import planted
from tools.campaign.walker import REFUSED, RIGHT, SHUT_DOWN, Outcome
from tools.kit.cases import slow
from tools.kit.printer import ROOT, module_files

Z, ATTACHING = "CALIBRATE_Z", "CALIBRATE_Z, attaching"
LEFT_ON = "CALIBRATE_Z, the probe left on"
AUTO = "AUTO_Z_CALIBRATE"
DOCKABLE = "PROBE, dockable"


@lru_cache(maxsize=None)
def good_run(host, job):
    return faults.good_run(host, ALL_JOBS[job])


def case_of(host, job, fault, subject="", nth=0, kind=""):
    """The nth case of a fault, at operations of a kind only."""
    found = [
        case
        for case in faults.cases(good_run(host, job))
        if case.breaks[0].fault == fault
        and subject in ("", case.breaks[0].subject)
        and kind in ("", case.breaks[0].kind)
    ]
    return found[nth]


def go(host, case, modules=None):
    """That case, judged."""
    return running.go_case(
        case, host, good_run(host, case.job), modules=modules
    )


# (job, fault, subject, which of its cases, at what, how it ends)
CASES = [
    (Z, "stuck_open", "z_endstop", 0, "touch", REFUSED),
    (Z, "stuck_closed", "z_endstop", 3, "move", REFUSED),
    (Z, "stuck_closed", "probe", 2, "query", REFUSED),
    (Z, "trigger_never", "probe", 1, "touch", REFUSED),
    (Z, "trigger_early", "z_endstop", 2, "touch", RIGHT),
    (Z, "probe_falls", "", 2, "move", REFUSED),
    (Z, "cancel", "", 4, "touch", SHUT_DOWN),
    (Z, "mcu_silent", "", 3, "move", SHUT_DOWN),
    # Met in small steps, and by a way that is armed on it
    (LEFT_ON, PUT_ON, "", 0, "", REFUSED),
    (f"{LEFT_ON}, normally open", PUT_ON, "", 0, "", REFUSED),
    (ATTACHING, "template raises", "", 0, "", REFUSED),
    (ATTACHING, "template leaves", "", 1, "", REFUSED),
    (ATTACHING, "template raises", "", 2, "", REFUSED),
    (ATTACHING, "template raises", "", 3, "", REFUSED),
    (ATTACHING, "mcu_silent", "", 1, "touch", SHUT_DOWN),
    ("PROBE_Z_ACCURACY", "stuck_open", "z_endstop", 1, "touch", REFUSED),
    ("CALCULATE_SWITCH_OFFSET", "cancel", "", 0, "", SHUT_DOWN),
    (AUTO, "trigger_never", "bed_sensor", 1, "touch", REFUSED),
    (AUTO, "stuck_closed", "probe", 1, "touch", REFUSED),
    (AUTO, STICKS, "probe", 1, "", REFUSED),
    (AUTO, "trigger_late", "bed_sensor", 0, "touch", RIGHT),
    (AUTO, "tmc_change_lost", "z", 0, "write", REFUSED),
    (AUTO, "template raises", "", 0, "", REFUSED),
    (AUTO, "cancel", "", 2, "write", SHUT_DOWN),
    ("AUTO_Z_HOME_Z", "stuck_open", "bed_sensor", 0, "touch", REFUSED),
    ("AUTO_Z_LOAD_OFFSET", "stuck_closed", "probe", 0, "", RIGHT),
    (DOCKABLE, "trigger_never", "probe", 0, "touch", REFUSED),
    (DOCKABLE, "attach_fails", "", 0, "", REFUSED),
    (DOCKABLE, "template leaves", "", 2, "", REFUSED),
    (DOCKABLE, "dock_fails", "", 0, "", REFUSED),
    (DOCKABLE, "stuck_closed", "probe", 4, "query", REFUSED),
    # It hangs on the toolhead, and reads as if it were docked
    ("EXTRA_PROBE, gantry", "stuck_closed", "probe", 0, "", REFUSED),
    ("AUTO_Z_HOME_Z, servo", "stuck_closed", "probe", 0, "", REFUSED),
]


@pytest.mark.slow
@pytest.mark.parametrize("which", CASES, ids=lambda w: "-".join(map(str, w)))
def test_fault_is_survived(host, which):
    done = go(host, case_of(host, *which[:5]))
    assert done.outcome.harm == ""
    assert done.broken.struck
    assert done.broken.ended == which[5]
    if done.broken.ended == REFUSED:
        assert done.broken.message


@pytest.mark.parametrize("nth", [1, slow(2)])
def test_lost_board_is_told_first(host, nth):
    # Moving after it may be an error of the host's own
    done = go(host, case_of(host, ATTACHING, "mcu_silent", "", nth, "query"))
    assert done.broken.ended == SHUT_DOWN
    assert done.outcome.harm == ""


# Two cases of a job (fault, subject, which, at what), how it ends, whether both
# have struck
PAIRS = [
    # Of two sensors nothing is known any more; the first one is told
    (Z, ("stuck_open", "probe"), ("trigger_never", "z_endstop"), REFUSED, True),
    # Looks at the bed how long the probe is, with a probe that is dead
    (
        Z,
        ("trigger_never", "z_endstop", 5),
        ("trigger_never", "probe"),
        REFUSED,
        True,
    ),
    (
        Z,
        ("stuck_open", "z_endstop", 0, "touch"),
        ("cancel", "", -1, "touch"),
        REFUSED,
        False,
    ),
    (Z, ("mcu_silent", "", 3, "move"), ("cancel", "", -1), SHUT_DOWN, False),
    (Z, ("stuck_closed", "probe"), ("cancel", "", 1), SHUT_DOWN, True),
    # The nozzle stands on the bed, as deep as the first allows, until klippy restarts
    (
        "AUTO_Z_HOME_Z",
        ("stuck_open", "bed_sensor", 4, "move"),
        ("cancel", "", -1, "write"),
        SHUT_DOWN,
        True,
    ),
    # The second fails in the clean-up after the first
    (
        ATTACHING,
        ("template raises", "", 2),
        ("template leaves", "", 3),
        REFUSED,
        True,
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize("which", PAIRS, ids=lambda w: "-".join(map(str, w)))
def test_pair_is_survived(host, which):
    job, first, second, ended, both = which
    one, other = case_of(host, job, *first), case_of(host, job, *second)
    done = go(host, Case(job, (*one.breaks, *other.breaks)))
    assert done.outcome.harm == ""
    assert (done.broken.ended, done.broken.struck) == (ended, both)
    assert is_blind(done.breaks) == (which in PAIRS[:2])


# A module that does something wrong, each to be found by one case: the case,
# lines around the command, and words of what the judge says
PLANTED = {
    "head stays down": (
        (Z, "trigger_never", "z_endstop", 1, "touch"),
        {"failed": 'run("G90\\nG1 Z8 F600\\nM400")'},
        "the toolhead is at z=",
    ),
    "pin is pressed too deep": (
        (Z, "trigger_never", "z_endstop", 1, "touch"),
        {"failed": 'run("G90\\nG1 Z-1 F600\\nG1 Z20 F600\\nM400")'},
        "harm: step 4, gcode 'CALIBRATE_Z\\nM400': nozzle_pin: ",
    ),
    "probe is pressed into the bed": (
        (f"{LEFT_ON}, normally open", PUT_ON),
        {"first": 'run("G90\\nG1 X226 Y20 F6000\\nG1 Z0.4 F600\\nM400")'},
        "body_bed: ",
    ),
    "a trigger in mid air is not named": (
        (AUTO, STICKS, "probe", 1),
        {"failed": 'raise gcmd.error("the probe sees the bed at z=1.762")'},
        "does not name the cause",
    ),
    "cause is not named": (
        (Z, "stuck_open", "z_endstop", 0, "touch"),
        {"failed": 'raise gcmd.error("calibration has failed")'},
        "does not name the cause",
    ),
    "error of its own": (
        (AUTO, "trigger_never", "bed_sensor", 1, "touch"),
        {"failed": "None.is_there()"},
        "shutdown: step 4, gcode 'AUTO_Z_CALIBRATE\\nM400': Internal error",
    ),
    "offset is lost": (
        (AUTO, "trigger_never", "bed_sensor", 1, "touch"),
        {"failed": 'run("SET_GCODE_OFFSET Z=0.5")'},
        "'the G-code offset': (0.123, 0.5)",
    ),
    "result is wrong": (
        (AUTO, "trigger_late", "bed_sensor", 0, "touch"),
        {"done": 'run("SET_GCODE_OFFSET Z_ADJUST=0.01")'},
        "the gap is",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_module_that_does_it_wrong_is_found(host, tmp_path, name):
    which, around, problem = PLANTED[name]
    case = case_of(host, *which)
    job = ALL_JOBS[case.job]
    modules = module_files() | planted(
        tmp_path, job.module, job.script, **around
    )
    done = go(host, case, modules)
    assert problem in done.outcome.harm, done.outcome


# Each of its failures lets the next one be deeper on the pin
DEEPER = r"""
depth = getattr(printer, "depth", 0.0)
printer.depth = depth + 1.5
if depth:
    run("G90\nG1 X206 Y306 F9000\nG1 Z%.3f F600\nG1 Z20 F600\nM400" % -depth)
"""


@pytest.mark.slow
def test_what_only_the_second_fault_shows_is_found(host, tmp_path):
    deeper = module_files() | planted(
        tmp_path, "z_calibration", Z, failed=DEEPER
    )
    case = case_of(host, Z, "stuck_open", "z_endstop", 0, "touch")
    assert go(host, case, deeper).outcome.harm == ""
    again = case._replace(later=case.breaks)
    done = go(host, again, deeper)
    assert "step 8, gcode 'CALIBRATE_Z\\nM400': nozzle_pin" in done.outcome.harm
    assert go(host, again).outcome.harm == ""


def test_pairs_are_drawn():
    singles = [
        [Case(Z, (Break(fault),)) for fault in ("cancel", *SENSOR_FAULTS)],
        [Case(AUTO, (Break("cancel"),))],
    ]
    both, none = faults.pairs(singles, 9, 0)
    assert {len(pair.breaks) for pair in both} == {2}
    assert (len(both), none) == (3, [])
    after, none = faults.pairs(singles, 1, 0, is_after=True)
    assert {what.fault for what in (*after[0].breaks, *after[0].later)} == {
        *SENSOR_FAULTS
    }


def test_case_is_kept(tmp_path):
    case = Case(Z, (Break("stuck_open", "z_endstop", "touch", "z_endstop"),))
    walk = OfJob(job=Z, seed=3), faults.walk(case)
    done = Done(str(case), "klipper", walk, Outcome(harm="harm: x"))
    kept = running.read(running.write(done, tmp_path))
    assert kept[0] == walk[0]
    assert Done("", "", kept, Outcome()).breaks == list(case.breaks)


COMMANDS = {
    "faults": ("--job", "AUTO_Z_LOAD", "--case", "cancel of begin"),
    "walks": ("--count", "1"),
}


@pytest.mark.one_host
@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_command_line(host, tmp_path, name):
    file = tmp_path / "figures.json"
    command = (sys.executable, "-m", "tools.campaign", name, *COMMANDS[name])
    more = ("--host", host.name, "--folder", tmp_path, "--json", file)
    subprocess.run([*command, *more], cwd=ROOT, check=True)
    found = json.loads(file.read_text())
    runs = sum(one["survived"] for one in found.get("faults", ()))
    assert runs + found.get("walks", 0) == 1
