"""Some cases of the fault campaign, and that it can find something."""

from __future__ import annotations

from functools import lru_cache

import pytest

from tests.campaign import fault_cases
from tests.campaign.fault_cases import REFUSED, RIGHT, SHUT_DOWN, Setting
from tests.campaign.jobs import JOBS
from tests.hostkit.printer import module_files

Z, ATTACHING = "CALIBRATE_Z", "CALIBRATE_Z, attaching"
PIEZO = "AUTO_Z_CALIBRATE"


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
    (PIEZO, "trigger_never", "bed_sensor", 1, "touch", REFUSED),
    (PIEZO, "stuck_closed", "probe", 1, "touch", REFUSED),
    (PIEZO, "trigger_late", "bed_sensor", 0, "touch", RIGHT),
    (PIEZO, "tmc_change_lost", "z", 0, "write", REFUSED),
    (PIEZO, "template raises", "", 0, "", REFUSED),
    (PIEZO, "cancel", "", 2, "write", SHUT_DOWN),
    ("AUTO_Z_HOME_Z", "stuck_open", "bed_sensor", 0, "touch", REFUSED),
    ("AUTO_Z_LOAD_OFFSET", "stuck_closed", "probe", 0, "", RIGHT),
]


@pytest.mark.half
@pytest.mark.parametrize("which", CASES, ids=lambda w: "-".join(map(str, w)))
def test_fault_is_survived(some_host, which):
    outcome = attempt(some_host, *which[:5])
    assert outcome.problems == ()
    assert outcome.struck
    assert outcome.ended == which[5]
    if outcome.ended == REFUSED:
        assert outcome.message


@pytest.mark.parametrize("nth", [1, 2])
def test_lost_board_is_told_first(host, nth):
    # Moving after it may be an error of the host's own
    outcome = attempt(host, ATTACHING, "mcu_silent", "", nth, "query")
    assert outcome.ended == SHUT_DOWN
    assert outcome.problems == ()


def test_every_operation_gets_every_fault(one_host):
    job, good = JOBS[PIEZO], good_run(one_host, PIEZO)
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


# A module that does something wrong; each must be found by one case

PLANTED = {
    "head stays down": (
        (Z, "trigger_never", "z_endstop", 1, "touch"),
        'with dock, host.always(run.lift, "lifting"):',
        "with dock:",
        "the head is at z=",
    ),
    "offset is lost": (
        (Z, "probe_falls", "", 2, "move"),
        "if self.host.gcode_offset() != z_offset:",
        """z_offset = 0.5
        if self.host.gcode_offset() != z_offset:""",
        "offset was 0.123 and is 0.5",
    ),
    "floor is too low": (
        (Z, "trigger_never", "z_endstop", 1, "touch"),
        "trigger_z = self._probing_move(endstop, floor, speed)",
        "trigger_z = self._probing_move(endstop, floor - 2.0, speed)",
        "the machine was hurt",
    ),
    "samples may differ": (
        (ATTACHING, "trigger_early", "z_endstop", -1, "touch"),
        "if spread <= sampling.tolerance:",
        "if True:",
        "the gap is",
    ),
    "cause is not named": (
        (Z, "stuck_open", "z_endstop", 0, "touch"),
        'raise kind("%s (stopped at z=%.3f)" % (e, self.z()))',
        'raise kind("calibration has failed")',
        "does not name the cause",
    ),
    "error of its own": (
        (PIEZO, "trigger_never", "bed_sensor", 1, "touch"),
        "kind = NoTrigger if self.is_at(floor)",
        "kind = NoTrigger if self.is_there(floor)",
        "the printer is shut down",
    ),
    "nothing is cleaned up": (
        (PIEZO, "trigger_never", "bed_sensor", 1, "touch"),
        "                if not self.printer.is_shutdown():\n"
        "                    action()",
        "                if not failed:\n                    action()",
        "currents was",
    ),
}


@pytest.mark.parametrize("planted", PLANTED)
def test_module_that_does_it_wrong_is_found(some_host, tmp_path, planted):
    which, right, wrong, problem = PLANTED[planted]
    case, good = case_of(some_host, *which)
    name = JOBS[case.job].module
    text = module_files()[name].read_text()
    assert text.count(right) == 1
    broken = tmp_path / f"{name}.py"
    broken.write_text(text.replace(right, wrong))
    modules = {**module_files(), name: broken}
    outcome = fault_cases.attempt(
        some_host, case, good, Setting(modules=modules)
    )
    assert problem in "\n".join(outcome.problems), outcome
