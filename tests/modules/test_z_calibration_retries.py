"""`retries` of [z_calibration]: what was touched wrong is measured once more."""

from __future__ import annotations

import json

import pytest

from simprinter import Fault
from tools.kit.cases import slow
from tools.kit.dockable_probe import SWITCH, trips, where
from tools.kit.docks import calibrating
from tools.kit.runs import make_runs
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    MICROSTEP,
    assert_unharmed,
    kept_runs,
    marked,
    result_of,
    section,
    touched_sites,
    with_dead_pin,
)

GAP = 0.06
HOOKS = {
    "start_gcode": "START",
    "clean_gcode": "CLEAN",
    "end_gcode": "LAST",
    "error_gcode": "PANIC",
}


def changes(retries="2", **options):
    return {
        **marked("START", "CLEAN", "LAST", "PANIC"),
        **section(retries=retries, **HOOKS, **options),
    }


def told(printer, before):
    """What the macros have said, and which tries there were."""
    lines = printer.session.console[before:]
    words = ("echo: ", " begins")
    found = [line for line in lines if any(word in line for word in words)]
    return [line.replace("echo: ", "").split("; ")[-1] for line in found]


FIRST = ["START", "LAST", "try 2 of 3 begins", "START", "CLEAN"]


def fail_once(start, fault, **options):
    """A homed printer in whose first try that happens."""
    return start(changes=changes(**options), faults=[fault]).homed()


@pytest.mark.parametrize(
    "fault",
    [
        Fault(
            "trigger_never", site="nozzle_pin", touch=2, command="CALIBRATE_Z"
        ),
        slow(
            Fault(
                "trigger_never", site="body_pin", touch=2, command="CALIBRATE_Z"
            )
        ),
        Fault(
            "trigger_never", site="probe_bed", touch=2, command="CALIBRATE_Z"
        ),
        # Outside of offset_margins, or of what touches may differ by
        slow(
            Fault(
                "trigger_late",
                site="probe_bed",
                touch=2,
                mm=0.2,
                command="CALIBRATE_Z",
            )
        ),
    ],
    ids=lambda fault: f"{fault.name} {fault.subject}",
)
def test_touch_that_goes_wrong_once(start, fault):
    own = {"samples_tolerance": "0.02", "samples_tolerance_retries": "0"}
    printer = fail_once(start, fault, **own)
    for site in ("nozzle_pin", "body_pin", "body_bed"):
        printer.machine.tolerate(site, 1.01)
    before = len(printer.session.console)
    lines = printer.run("CALIBRATE_Z")
    assert result_of(lines)
    # The probe is put away first, the nozzle cleaned before it touches again
    assert told(printer, before) == [*FIRST, "LAST"]
    assert printer.gap() == pytest.approx(GAP, abs=2 * MICROSTEP)
    assert [run["ok"] for run in kept_runs(printer)] == [False, True]
    # Of the try that failed: what has failed
    (line,) = [line for line in lines if "try 2 of 3" in line]
    assert fault.subject.split("_")[0].replace("body", "switch") in line or (
        "bed" in line
    )


def test_offset_outside_its_margins_is_measured_again(start):
    early = {"site": "nozzle_pin", "mm": 0.4, "command": "CALIBRATE_Z"}
    own = {"samples": "1", "offset_margins": "-1, 0.3", "retries": "1"}
    printer = fail_once(start, Fault("trigger_early", touch=1, **early), **own)
    lines = printer.run("CALIBRATE_Z")
    (line,) = [line for line in lines if "try 2 of 2" in line]
    assert "is outside offset_margins" in line
    assert printer.gap() == pytest.approx(GAP, abs=2 * MICROSTEP)


@pytest.mark.parametrize("retries", ["0", "1", "2"])
def test_touch_that_never_gets_right(start, retries):
    """The error of the last try; error_gcode once; no deeper than one try."""
    tries = int(retries) + 1
    printer = with_dead_pin(start, touch=1, changes=changes(retries))
    for number in range(1, tries):
        printer.machine.break_down(
            Fault(
                "trigger_never",
                site="nozzle_pin",
                touch=number + 1,
                command="CALIBRATE_Z",
            )
        )
    printer.run("SET_GCODE_OFFSET Z=0.123")
    before = len(printer.session.console)
    touches = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "nozzle: the switch did not answer" in text
    assert "begins" not in text
    said = told(printer, before)
    assert said.count("START") == said.count("LAST") == tries
    assert said.count("CLEAN") == tries - 1
    assert [word for word in said if "begins" in word] == [
        f"try {number} of {tries} begins" for number in range(2, tries + 1)
    ]
    assert said[-1] == "PANIC" and said.count("PANIC") == 1
    assert touched_sites(printer, touches) == ["nozzle_pin"] * tries
    assert printer.machine.truth.depth("nozzle_pin") <= 1.01
    assert_unharmed(printer, 0.123)
    assert len(kept_runs(printer)) == tries
    assert not printer.status("z_calibration")["last_query"]


@pytest.mark.parametrize(
    ("own", "script", "words"),
    [
        ({"start_gcode": "NOBODY_KNOWS"}, "CALIBRATE_Z", "NOBODY_KNOWS"),
        ({}, "M84\nCALIBRATE_Z", "not homed"),
        ({}, "CALIBRATE_Z SWITCH_OFFSET=-1", "SWITCH_OFFSET"),
        slow({}, "CALIBRATE_Z BED_POSITION=1000,0", "BED_POSITION"),
        slow({"end_gcode": "M84"}, "CALIBRATE_Z", "not homed"),
        ({"end_gcode": "SET_GCODE_OFFSET Z=1"}, "CALIBRATE_Z", "end_gcode"),
    ],
)
def test_what_was_not_touched_wrong_is_refused_at_once(
    start, own, script, words
):
    printer = start(
        changes={**changes(), **section(**{**HOOKS, "retries": "2", **own})}
    )
    before = len(printer.homed().session.console)
    assert words in printer.fail(script)
    said = told(printer, before)
    assert [word for word in said if "begins" in word] == []
    assert said.count("PANIC") == 1


def test_probe_that_comes_off_is_not_tried_again(start):
    fault = Fault(
        "probe_falls", site="probe_bed", touch=2, command="CALIBRATE_Z"
    )
    printer = fail_once(start, fault)
    before = len(printer.session.console)
    printer.fail("CALIBRATE_Z")
    assert [word for word in told(printer, before) if "begins" in word] == []
    printer.machine.truth.require_no_crash()


def test_probe_that_stays_on_ends_the_tries(start):
    """Nothing touches with a nozzle that has the probe beside it."""
    scene = SCENES["cartesian"]
    fault = Fault(
        "trigger_never", site="probe_bed", touch=2, command="CALIBRATE_Z"
    )
    own = {"respond": {}, **section(retries="2", end_gcode="M400")}
    printer = start(scene, changes=own, faults=[fault]).homed()
    printer.machine.tolerate("body_bed", 1.01)
    touches = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "the probe is still attached after end_gcode" in text
    sites = touched_sites(printer, touches)
    assert "nozzle_pin" not in sites[sites.index("body_pin") :]


def test_switch_is_as_far_below_the_nozzle_as_in_the_try_before(start):
    """In the first run of all, with a z_offset that was never measured."""
    # The bed, where it is measured and where it tells how long the probe is; then the switch
    dead = {"command": "CALIBRATE_Z", "strikes": "may"}
    touches = [("probe_bed", n) for n in (3, 4)]
    touches += [("body_pin", n) for n in (6, 7)]
    faults = [
        Fault("trigger_never", site=site, touch=n, **dead)
        for site, n in touches
    ]
    own = {"probe": {"z_offset": "0"}, **changes(retries="1")}
    printer = start(changes=own, faults=faults).homed()
    for site in ("body_pin", "body_bed"):
        printer.machine.tolerate(site, 6.0)
    text = printer.fail("CALIBRATE_Z")
    assert printer.machine.truth.depth("body_pin") <= 1.01, text


def test_accuracy_is_not_tried_again(start):
    fault = Fault(
        "trigger_never",
        site="nozzle_pin",
        touch=2,
        command="CALIBRATE_Z_ACCURACY",
    )
    printer = fail_once(start, fault)
    printer.machine.tolerate("nozzle_pin", 1.01)
    before = len(printer.session.console)
    printer.fail("CALIBRATE_Z_ACCURACY CYCLES=2")
    assert [w for w in told(printer, before) if "begins" in w] == []


def test_progress_begins_again(start):
    own = changes()
    own["gcode_macro START"] = {
        "gcode": "\n  RESPOND MSG=at:{printer.z_calibration.progress}"
    }
    fault = Fault(
        "trigger_never", site="body_pin", touch=2, command="CALIBRATE_Z"
    )
    printer = start(changes=own, faults=[fault]).homed()
    printer.machine.tolerate("body_pin", 1.01)
    assert printer.run("CALIBRATE_Z").count("echo: at:0.0") == 2


# What ends a print ends the tries: a second client, or a macro


@pytest.mark.parametrize("end", ["M112", "CANCEL_PRINT"])
def test_print_that_ends_meanwhile(start, tmp_path, end):
    own = changes(retries="1")
    own["gcode_macro LAST"] = {"gcode": f"\n  RESPOND MSG=LAST\n  {end}"}
    own["virtual_sdcard"] = {"path": str(tmp_path)}
    own["pause_resume"] = {}
    (tmp_path / "print.gcode").write_text("CALIBRATE_Z\nG4 P9000\n")
    fault = Fault("trigger_never", site="body_pin", touch=2)
    printer = start(changes=own, faults=[fault]).homed()
    printer.machine.tolerate("body_pin", 1.01)
    before = len(printer.session.console)
    printer.run("SDCARD_PRINT_FILE FILENAME=print.gcode")
    printer.session.wait(90.0)
    said = told(printer, before)
    assert [word for word in said if "begins" in word] == []
    assert said.count("LAST") == 1
    assert (printer.session.state()[0] == "shutdown") == (end == "M112")


# With a dock


@pytest.mark.slow
def test_probe_is_docked_before_each_try(start):
    scene = calibrating(SWITCH)
    fault = Fault(
        "trigger_never", site="body_pin", touch=2, command="CALIBRATE_Z"
    )
    printer = start(scene, section(retries="1"), faults=[fault]).homed()
    printer.machine.tolerate("body_pin", 1.01)
    before = len(printer.machine.truth.events)
    assert result_of(printer.run("CALIBRATE_Z"))
    assert trips(printer, before) == ["attach", "dock"] * 2
    assert where(printer) == "docked"


@pytest.mark.slow
def test_probe_that_cannot_be_docked_meets_nothing(start):
    scene = calibrating(SWITCH)
    faults = [
        Fault("trigger_never", site="body_pin", touch=2, command="CALIBRATE_Z"),
        Fault("dock_fails", n=1, command="CALIBRATE_Z"),
    ]
    printer = start(scene, section(retries="1"), faults=faults).homed()
    printer.machine.tolerate("body_pin", 1.01)
    before = len(printer.session.console)
    touches = len(printer.machine.truth.touches)
    assert "switch: the switch did not answer" in printer.fail("CALIBRATE_Z")
    lines = printer.session.console[before:]
    assert [line for line in lines if "begins" in line] == []
    assert touched_sites(printer, touches)[-1] == "body_pin"


# Touches of a try that has failed make no run noisier


@pytest.mark.slow
def test_touches_of_a_failed_try_are_no_noise(start, tmp_path):
    def uncertainty(*faults):
        folder = tmp_path / f"{len(faults)}"
        folder.mkdir()
        (run,) = make_runs(1)
        (folder / "printer.jsonl").write_text(json.dumps(run) + "\n")
        own = {"samples_tolerance": "0.05", "samples": "5"}
        own["samples_tolerance_retries"] = "0"
        printer = start(
            changes=changes(history=str(folder), **own), faults=list(faults)
        ).homed()
        lines = printer.run("CALIBRATE_Z")
        assert any("begins" in line for line in lines) == bool(faults)
        return printer.status("z_calibration")["uncertainty"]

    fault = Fault(
        "trigger_early",
        site="body_pin",
        touch=4,
        mm=0.06,
        command="CALIBRATE_Z",
    )
    assert uncertainty(fault) == pytest.approx(uncertainty(), abs=1e-6)


@pytest.mark.parametrize("retries", ["0", "1", "2"])
def test_pin_of_its_own_is_where_the_try_before_has_met_it(start, retries):
    """Otherwise nobody knows in the first run how high it stands."""
    faults = [
        Fault(
            "trigger_never", site="probe_bed", touch=2, command="CALIBRATE_Z"
        ),
        *(
            Fault(
                "trigger_never",
                site="nozzle_pin",
                touch=touch,
                command="CALIBRATE_Z",
                strikes="may",
            )
            for touch in (5, 6)
        ),
    ]
    own = changes(retries)
    printer = start(SCENES["separate_pin"], changes=own, faults=faults).homed()
    for site in ("nozzle_pin", "body_bed"):
        printer.machine.tolerate(site, 6.0)
    printer.fail("CALIBRATE_Z")
    assert printer.machine.truth.depth("nozzle_pin") <= 1.01
