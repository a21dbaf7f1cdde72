"""Some cases of the fault campaign, and that it can find something."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import pytest

from tools.campaign import fault_cases
from tools.campaign.fault_cases import (
    REFUSED,
    RIGHT,
    SHUT_DOWN,
    Case,
    GoodRun,
    Pair,
    Setting,
)
from tools.campaign.jobs import COMPARED, JOBS
from tools.campaign.operations import Operation
from tools.campaign.running import Plan, draw_pairs, plan
from tools.campaign.tests.planting import planted
from tools.kit.cases import all_slow_but, slow
from tools.kit.printer import module_files

Z, ATTACHING = "CALIBRATE_Z", "CALIBRATE_Z, attaching"
AUTO = "AUTO_Z_CALIBRATE"
DOCKABLE = "PROBE, dockable"


@lru_cache(maxsize=None)
def good_run(host, job):
    return fault_cases.good_run(host, JOBS[job])


def case_of(host, job, fault, subject="", nth=0, kind=""):
    """The nth case of a fault, at operations of a kind only."""
    good = good_run(host, job)
    found = [
        case
        for case in fault_cases.cases(JOBS[job], good)
        if case.fault == fault
        and case.subject in (subject, case.subject if not subject else "")
        and (not kind or good.operations[case.at - 1].kind == kind)
    ]
    return found[nth], good


def attempt(host, *which):
    case, good = case_of(host, *which)
    return fault_cases.attempt(host, case, good)


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
    (ATTACHING, "template raises", "", 0, "", REFUSED),
    (ATTACHING, "template leaves", "", 1, "", REFUSED),
    (ATTACHING, "template raises", "", 2, "", REFUSED),
    (ATTACHING, "template raises", "", 3, "", REFUSED),
    (ATTACHING, "mcu_silent", "", 1, "touch", SHUT_DOWN),
    ("PROBE_Z_ACCURACY", "stuck_open", "z_endstop", 1, "touch", REFUSED),
    ("CALCULATE_SWITCH_OFFSET", "cancel", "", 0, "", SHUT_DOWN),
    (AUTO, "trigger_never", "bed_sensor", 1, "touch", REFUSED),
    (AUTO, "stuck_closed", "probe", 1, "touch", REFUSED),
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
]


@pytest.mark.slow
@pytest.mark.parametrize("which", CASES, ids=lambda w: "-".join(map(str, w)))
def test_fault_is_survived(host, which):
    outcome = attempt(host, *which[:5])
    assert outcome.problems == []
    assert outcome.struck
    assert outcome.ended == which[5]
    if outcome.ended == REFUSED:
        assert outcome.message


@pytest.mark.parametrize("nth", [1, slow(2)])
def test_lost_board_is_told_first(host, nth):
    # Moving after it may be an error of the host's own
    outcome = attempt(host, ATTACHING, "mcu_silent", "", nth, "query")
    assert outcome.ended == SHUT_DOWN
    assert outcome.problems == []


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
    # The second fails in the clean-up after the first
    (
        ATTACHING,
        ("template raises", "", 2),
        ("template leaves", "", 3),
        REFUSED,
        True,
    ),
]


def pair_of(host, first, second):
    (one, good), (other, _) = case_of(host, *first), case_of(host, *second)
    return Pair(one, other), good


@pytest.mark.slow
@pytest.mark.parametrize("which", PAIRS, ids=lambda w: "-".join(map(str, w)))
def test_pair_is_survived(host, which):
    job, first, second, ended, both = which
    pair, good = pair_of(host, (job, *first), (job, *second))
    outcome = fault_cases.attempt(host, pair, good)
    assert outcome.problems == []
    assert (outcome.ended, outcome.struck) == (ended, both)
    assert outcome.is_blind() == (which in PAIRS[:2])


@pytest.mark.parametrize("fault", [slow("trigger_early"), "trigger_late"])
@pytest.mark.parametrize("samples", [slow(2), 3])
def test_two_touches_that_agree(host, monkeypatch, fault, samples):
    name = "AUTO_Z_HOME_Z"
    job = replace(JOBS[name], samples=samples)
    monkeypatch.setitem(JOBS, name, job)
    pair, good = pair_of(
        host,
        (name, fault, "bed_sensor", 0),
        (name, fault, "bed_sensor", 1),
    )
    outcome = fault_cases.attempt(host, pair, good)
    # Only where no third could have told
    assert bool(outcome.problems) == (samples == 3)
    assert outcome.error == pytest.approx(0.3, abs=0.01)


def test_pair_is_judged_and_shown_again(host):
    first, second = (Z, "trigger_never", "z_endstop", 1), (Z, "stuck_open")
    pair, good = pair_of(host, first, second)
    good = good._replace(depths=dict.fromkeys(good.depths, -1.0))
    outcome = fault_cases.attempt(host, pair, good)
    assert "the machine was hurt" in outcome.problems[0]
    again = plan(Setting(), str(pair), Z, host, (0, 1)).cases
    assert again == (pair,)


def test_pairs_are_drawn_over_all_commands():
    def one(job, count):
        cases = tuple(Case(job, at, "cancel") for at in range(count))
        return Plan(None, job, Setting(), None, cases)

    plans = [one(Z, 60), one(AUTO, 20), one(MESH, 2)]
    drawn = draw_pairs(plans, 80, 5)
    assert drawn == draw_pairs(plans, 80, 5) != draw_pairs(plans, 80, 6)
    counts = [len(part.cases) for part in drawn]
    assert sum(counts) == 80
    assert counts[0] > counts[1] > counts[2]
    pairs = [pair for part in drawn for pair in part.cases]
    assert len(set(pairs)) == 80
    assert all(a.job == b.job and a.at < b.at for a, b in pairs)
    # No more than there are
    assert len(draw_pairs([one(MESH, 3)], 9, 1)[0].cases) == 3


MESH = "BED_MESH_CALIBRATE, dockable"


def test_long_command_is_broken_at_its_ends_and_in_the_middle():
    touches = [Operation("touch", "probe", at) for at in range(5)]
    operations = [touches[0], Operation("move", "z", 9), *touches[1:]]
    good = GoodRun(tuple(operations), 0, {"attach": 2, "dock": 0}, {}, 0.0)
    found = list(fault_cases.cases(JOBS[MESH], good))
    # 0 is before the first one
    assert {c.at for c in found if c.fault == "stuck_open"} == {0, 1, 2, 4, 6}
    assert {c.at for c in found if c.fault == "attach_fails"} == {1, 2}


def test_others_get_options_that_ours_does_without():
    assert Setting().job(MESH) is JOBS[MESH]
    plugin = Setting(0, {"dockable_probe": Path("x")}, True).job(MESH).changes
    assert plugin["dockable_probe"]["dock_position"] == "50, 308, 0"
    assert plugin["safe_z_home"] is None
    builtin = Setting(0, {}, True).job(MESH).changes
    assert builtin["dockable_probe"]["z_hop"] == "8.9"
    assert set(COMPARED) < set(JOBS)


def test_only_harm_is_judged_of_others(host):
    case, good = case_of(host, DOCKABLE, "attach_fails")
    good = good._replace(gap=1.0)
    setting = Setting(0, module_files(), True)
    wrong = case._replace(fault="stuck_closed", at=0, subject="probe")
    assert fault_cases.attempt(host, wrong, good, setting).problems == []
    assert fault_cases.attempt(host, wrong, good).problems


def test_every_operation_gets_every_fault(host):
    job, good = JOBS[AUTO], good_run(host, AUTO)
    kinds = {operation.kind for operation in good.operations}
    assert kinds == {"touch", "query", "move", "write"}
    # Begin, and up to its end: bed sensor and probe, each stuck in both ways,
    # the board, and the host
    found = list(fault_cases.cases(job, good))
    for at in range(len(good.operations) + 1):
        here = {(c.fault, c.subject) for c in found if c.at == at}
        assert here >= {
            ("stuck_open", "bed_sensor"),
            ("stuck_closed", "probe"),
            ("mcu_silent", "mcu"),
            ("cancel", ""),
        }
    touches = [o for o in good.operations if o.kind == "touch"]
    assert len(touches) == 4
    assert sum(c.fault == "trigger_late" for c in found) == 4
    writes = [o for o in good.operations if o.kind == "write"]
    assert sum(c.fault == "tmc_change_lost" for c in found) == len(writes)
    assert len(found) == len(set(found))
    # Each template in both ways
    assert sum(c.fault.startswith("template") for c in found) == 2


# A module that does something wrong, each to be found by one case: the case,
# lines around the command, and words of what the judge says
PLANTED = {
    "head stays down": (
        (Z, "trigger_never", "z_endstop", 1, "touch"),
        {"failed": 'run("G90\\nG1 Z8 F600")'},
        "the head is at z=",
    ),
    "pin is pressed too deep": (
        (Z, "trigger_never", "z_endstop", 1, "touch"),
        {"failed": 'run("G90\\nG1 Z-1 F600\\nG1 Z20 F600")'},
        "the machine was hurt",
    ),
    "cause is not named": (
        (Z, "stuck_open", "z_endstop", 0, "touch"),
        {"failed": 'raise gcmd.error("calibration has failed")'},
        "does not name the cause",
    ),
    "error of its own": (
        (AUTO, "trigger_never", "bed_sensor", 1, "touch"),
        {"failed": "module.is_there()"},
        "the printer is shut down",
    ),
    "offset is lost": (
        (AUTO, "trigger_never", "bed_sensor", 1, "touch"),
        {"failed": 'run("SET_GCODE_OFFSET Z=0.5")'},
        "offset was 0.123 and is 0.5",
    ),
    "result is wrong": (
        (AUTO, "trigger_late", "bed_sensor", 0, "touch"),
        {"done": 'run("SET_GCODE_OFFSET Z_ADJUST=0.01")'},
        "the gap is",
    ),
}


@pytest.mark.parametrize(
    "name", all_slow_but(["head stays down", "result is wrong"], PLANTED)
)
def test_module_that_does_it_wrong_is_found(host, tmp_path, name):
    which, around, problem = PLANTED[name]
    case, good = case_of(host, *which)
    modules = module_files() | planted(
        tmp_path, JOBS[case.job].script, **around
    )
    outcome = fault_cases.attempt(host, case, good, Setting(modules=modules))
    assert problem in "\n".join(outcome.problems), outcome
