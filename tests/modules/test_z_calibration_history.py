"""[z_calibration]'s history, uncertainty and sampling, on real klippy."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from simprinter import Fault, heated
from simprinter.world import NoiseSpec, OozeSpec
from tools.kit.klipper_sections import TOOL
from tools.kit.runs import make_runs
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    assert_unharmed,
    calibration,
    kept_runs,
    reported,
    section,
)

WORTH = re.compile(r"Z-CALIBRATION: offset (\S+) \+-(\d\.\d{3}) mm$")
NOZZLE = (206.0, 306.0)
BRUSH = (120.0, 300.0)


def voron(sigma=0.0, **world):
    """The voron with noise (mm) on both switches."""
    scene, noise = SCENES["voron"], NoiseSpec(sigma)
    return scene.with_world(
        pin=replace(scene.world.pin, noise=noise),
        mag_probe=replace(
            scene.world.mag_probe, noise=noise, **world.pop("probe", {})
        ),
        **world,
    )


def folder(printer):
    return printer.session.data / "config" / "z_calibration"


def worth_of(lines):
    """The offset and its uncertainty, as the console has them."""
    found = [m for m in map(WORTH.search, lines) if m]
    assert len(found) == 1, lines
    return tuple(map(float, found[0].groups()))


def counts(sites):
    return {site: sites.count(site) for site in dict.fromkeys(sites)}


@pytest.fixture
def with_past(tmp_path):
    """Options of a printer that knows ten runs of touches that vary by 3 um."""

    def write(**options):
        lines = [json.dumps(run) + "\n" for run in make_runs(10, **options)]
        (tmp_path / "printer.jsonl").write_text("".join(lines))
        return {"history": str(tmp_path)}

    return write


# What a run is worth, and its line


def test_each_run_says_what_it_is_worth_and_leaves_a_line(start):
    printer = start().homed()
    lines = printer.run("CALIBRATE_Z")
    offset, worth = worth_of(lines)
    place = [i for i, line in enumerate(lines) if "Z-CALIBRATION" in line]
    assert place[1] == place[0] + 1
    status = printer.status("z_calibration")
    assert status["uncertainty"] == pytest.approx(worth, abs=0.0006)
    assert offset == pytest.approx(status["last_z_offset"], abs=1e-6)
    (line,) = kept_runs(printer)
    assert (line["ok"], line["reason"]) == (True, "")
    assert (line["format"], line["time"] > 1e9) == (4, True)
    assert line["offset"] == pytest.approx(offset, abs=1e-6)
    assert line["uncertainty"] == pytest.approx(status["uncertainty"], abs=1e-6)
    assert line["switch_offset"] == 0.44
    result = status["last_result"]
    for site, name in (("nozzle",) * 2, ("switch",) * 2, ("bed", "probe")):
        record = line["sites"][site]
        assert record["z"] == pytest.approx(result[name], abs=1e-6)
        assert len(record["samples"]) == record["n"] == 3
    assert (line["retries"], line["cleaned"], line["warnings"]) == (0, "", [])
    assert 10.0 < line["duration"] < 40.0
    assert line["temperatures"] == {}
    status = printer.status("z_calibration")["history"]
    assert status["runs"] == 1
    assert status["results"][0]["offset"] == line["offset"]
    texts = report_is_drawn(printer)
    assert any(text.startswith("1 runs") for text in texts)
    # Nobody has forgotten anything after a restart
    printer.session.restart("RESTART")
    printer.session.wait(1.0)
    assert printer.status("z_calibration")["history"] == status


def report_is_drawn(printer, place=None):
    """The texts of the picture."""
    line = reported(printer, "the report is ")
    path = Path(line.split("the report is ")[1].strip())
    assert path.parent == (place or folder(printer))
    return [e.text for e in ET.parse(path).iter() if e.text]


@pytest.mark.slow
def test_refused_run_leaves_its_reason(start):
    faults = [Fault("trigger_never", site="probe_bed", command="CALIBRATE_Z")]
    changes = {"probe": {"samples": "1"}}
    printer = start(heated(SCENES["voron"]), changes=changes, faults=faults)
    printer.homed().machine.tolerate("body_bed", 1.0)
    error = printer.fail("CALIBRATE_Z")
    printer.fail("CALIBRATE_Z BED_POSITION=0,0")
    # Of one sample nobody knows anything
    assert not [line for line in printer.run("CALIBRATE_Z") if "+-" in line]
    assert printer.status("z_calibration")["uncertainty"] is None
    first, second, third = kept_runs(printer)
    assert not first["ok"] and "bed: No trigger" in first["reason"]
    assert first["reason"] in " ".join(error.split())
    assert set(first["sites"]) == {"nozzle", "switch"}
    assert second["sites"] == {} and "BED_POSITION" in second["reason"]
    assert third["ok"] and third["uncertainty"] is None
    assert set(third["temperatures"]) == {"extruder", "heater_bed"}
    assert all(10.0 < value < 40.0 for value in third["temperatures"].values())
    results = printer.status("z_calibration")["history"]["results"]
    assert [r["ok"] for r in results] == [False, False, True]
    assert results[0]["reason"] == first["reason"]


# Where it is, and what may be wrong there


@pytest.mark.slow
def test_history_may_be_elsewhere(start, tmp_path):
    other = tmp_path / "mine"
    options = {"history": str(other), "history_runs": "2"}
    options["target_uncertainty"] = "0.005"
    printer = start(changes=section(**options)).homed()
    text = "option 'target_uncertainty' is ignored without 'samples: auto'"
    assert any(text in line for line in printer.session.console)
    printer.run("CALIBRATE_Z")
    about = {"site": "body_pin", "command": "CALIBRATE_Z"}
    printer.machine.break_down(Fault("trigger_late", mm=0.03, **about))
    printer.run("CALIBRATE_Z")
    printer.run("CALIBRATE_Z")
    # A series of touches that did not agree, and the next one
    retries = [run["retries"] for run in kept_runs(printer, other)]
    assert retries == [0, 2, 0]
    assert printer.status("z_calibration")["history"]["runs"] == 2
    assert not folder(printer).exists()


@pytest.mark.slow
def test_history_may_be_nowhere(start):
    options = {"history": "none", "samples_tolerance": "0.02", **AUTO}
    printer = start(changes=section(**options)).homed()
    text = "option 'samples_tolerance' is ignored with 'samples: auto'"
    assert any(text in line for line in printer.session.console)
    assert "samples=10" in printer.run("PROBE_Z_ACCURACY")[0]
    printer.run("CALIBRATE_Z")
    printer.session.wait(1.0)
    assert not folder(printer).exists()
    assert "'history' is none" in printer.fail("Z_CALIBRATION_REPORT")
    # This run is worth as much as with one
    assert printer.status("z_calibration")["uncertainty"] is not None
    assert printer.status("z_calibration")["history"]["runs"] == 1
    printer.session.restart("RESTART")
    assert printer.status("z_calibration")["history"]["runs"] == 0


def test_what_is_wrong_with_the_file_never_fails_a_run(start):
    printer = start().homed()
    place, path = folder(printer), folder(printer) / "printer.jsonl"

    def told():
        before = len(printer.session.console)
        calibration(printer)
        printer.session.wait(1.0)
        lines = printer.session.console[before:]
        return [line for line in lines if "history" in line]

    place.write_text("mine")
    assert len(told()) == 1 and told() == []
    place.unlink()
    path.mkdir(parents=True)
    assert len(told()) == 1 and told() == []
    path.rmdir()
    path.write_bytes(b"\x00\xff{}\n[1]\n" + b'{"ok": true, "si')
    assert told() == []
    assert b'{"ok": true, "si\n{' in path.read_bytes()
    assert printer.status("z_calibration")["history"]["runs"] == 5
    with path.open("a") as file:
        file.write('{"format": 3}\n{"format": 5}\n')
    printer.session.restart("RESTART")
    printer.session.wait(1.0)
    assert printer.status("z_calibration")["history"]["runs"] == 1
    console = "\n".join(printer.session.console)
    assert f"3 damaged lines of {path} are left out" in console
    text = f"2 lines of {path} are of another version, and left out"
    assert text in console
    # They stay, for that version
    assert b'{"format": 5}' in path.read_bytes()


@pytest.mark.slow
def test_oldest_lines_go_when_klippy_starts(start, tmp_path):
    """Once there are more than a tenth too many; refused ones count, too."""
    path = tmp_path / "printer.jsonl"
    path.write_text("".join(json.dumps(run) + "\n" for run in make_runs(11)))
    options = {"history": str(tmp_path), "history_runs": "10"}
    printer = start(changes=section(**options)).homed()
    assert printer.status("z_calibration")["history"]["runs"] == 10
    assert len(path.read_text().splitlines()) == 11
    printer.run("CALIBRATE_Z")
    assert printer.status("z_calibration")["history"]["runs"] == 10
    printer.session.restart("RESTART")
    printer.session.require_ready()
    lines = path.read_text().splitlines()
    assert len(lines) == 10
    assert json.loads(lines[0])["time"] == make_runs(3)[-1]["time"]
    assert printer.status("z_calibration")["history"]["runs"] == 10


def test_changes_are_for_the_report_and_not_for_the_console(start, tmp_path):
    """A corrected position_endstop is a step of the nozzle's height."""
    lower = dict.fromkeys(("nozzle", "switch", "bed"), 0.25)
    runs = make_runs(20, moved=lower) + make_runs(4, 2)
    path = tmp_path / "printer.jsonl"
    path.write_text("".join(json.dumps(run) + "\n" for run in runs))
    printer = start(changes=section(history=str(tmp_path))).homed()
    printer.run("CALIBRATE_Z")
    printer.session.wait(2.0)
    assert "changed" not in "".join(printer.session.console)
    text = report_is_drawn(printer, tmp_path)
    assert any("the nozzle meets the pin 0.25" in t for t in text)


# The fingerprint


def test_exchanged_nozzle_is_told_once(start, with_past, tmp_path):
    shorter = {"switch": -0.2, "bed": -0.2}
    printer = start(changes=section(**with_past(moved=shorter))).homed()
    text = "switch - nozzle is 6.415 mm and was 6.21"
    assert text in "".join(printer.run("CALIBRATE_Z"))
    (warning,) = printer.status("z_calibration")["warnings"]
    assert text in warning
    told = {"about": "switch - nozzle", "text": warning}
    assert kept_runs(printer, tmp_path)[-1]["warnings"] == [told]
    printer.run("CALIBRATE_Z")
    assert printer.status("z_calibration")["warnings"] == []


@pytest.mark.slow
def test_nozzle_of_another_tool_is_neither_dirt_nor_a_change(start, tmp_path):
    """Its own runs of before are what a run is compared with."""
    longer = {"nozzle": 0.25, "switch": 0.0, "bed": 0.0}
    hot = {"extruder": 150.0}
    runs = make_runs(20, moved=longer, extruder="extruder1", temperatures=hot)
    runs += make_runs(4, 2, extruder="extruder", temperatures={})
    with (tmp_path / "printer.jsonl").open("w") as f:
        f.writelines(json.dumps(run) + "\n" for run in runs)
    changes = section(history=str(tmp_path))
    heat = tmp_path / "temp"
    heat.write_text("150000")
    changes["extruder1"] = {**TOOL, "sensor_path": str(heat)}
    printer = start(heated(SCENES["voron"]), changes).homed()
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.session.wait(1.0)
    printer.run("CALIBRATE_Z")
    printer.session.wait(2.0)
    assert "changed" not in "".join(printer.session.console)
    status = printer.status("z_calibration")
    assert status["warnings"] == []
    middle = status["history"]["switch_nozzle"]
    assert middle == pytest.approx(6.415, abs=0.01)
    # As if that one were no longer than this one any more
    printer.run("ACTIVATE_EXTRUDER EXTRUDER=extruder1\nCALIBRATE_Z")
    (warning,) = printer.status("z_calibration")["warnings"]
    assert re.search(r"switch - nozzle is 6\.41\d mm and was 6\.16", warning)
    own, other = kept_runs(printer, tmp_path)[-2:]
    assert (own["extruder"], other["extruder"]) == ("extruder", "extruder1")
    assert other["temperatures"]["extruder"] == 150.0


@pytest.mark.parametrize(("extruder", "proves"), [("", True), ("b", False)])
def test_good_run_of_another_tool_proves_nothing_of_this_one(
    start, with_past, extruder, proves
):
    """Here with margins so wide that a dead probe would go deep."""
    past = with_past(extruder=extruder)
    printer = start(changes=section(offset_margins="-5, 5", **past))
    printer.session.require_ready()
    printer.session.wait(1.0)
    text = "let a probe that does not answer"
    assert any(text in line for line in printer.session.console) != proves


def test_dirt_of_before_is_no_noise_of_a_clean_nozzle(start):
    """Told once, it asks for no more touches, and for no wider +-."""
    ooze = OozeSpec(0.05, 0.7, x=BRUSH[0], y=BRUSH[1], radius=2.0)
    printer = start(voron(ooze=ooze), changes=section(samples="auto")).homed()
    printer.run("CALIBRATE_Z")
    (text,) = printer.status("z_calibration")["warnings"]
    assert "pressed flat; clean it before CALIBRATE_Z" in text
    told = {"about": "nozzle", "text": text}
    assert kept_runs(printer)[-1]["warnings"] == [told]
    printer.run(f"G90\nG1 Z20 F900\nG1 X{BRUSH[0]} Y{BRUSH[1]} F6000\nM400")
    lines = printer.run("CALIBRATE_Z VERBOSE=1")
    assert printer.status("z_calibration")["warnings"] == []
    # As in a first run
    assert sum("nozzle: touched" in line for line in lines) == 5
    assert worth_of(lines)[1] <= 0.004
    assert [run["dirty"] for run in kept_runs(printer)] == [True, False]


# A number of samples that is found

AUTO = {"samples": "auto"}


@pytest.mark.slow
def test_touches_follow_history_and_target(start, with_past):
    def touches(**options):
        changes = section(**AUTO, **options, **with_past())
        printer = start(voron(0.003), changes=changes).homed()
        printer.session.wait(1.0)
        _, sites = calibration(printer)
        worth = printer.status("z_calibration")["uncertainty"]
        assert min(counts(sites).values()) >= 2
        return len(sites), worth

    usual, exact = touches(), touches(target_uncertainty="0.005")
    assert usual[0] <= 10 < 12 <= exact[0]
    assert 0.0055 < usual[1] < 0.0085
    assert exact[1] < 0.0055


@pytest.mark.slow
def test_target_that_steps_make_impossible_is_told_at_start(start):
    """And in the run where SAMPLES asks for it."""
    text = "target_uncertainty 0.001 is less than what steps of 0.0025 mm"
    changes = section(target_uncertainty="0.001", **AUTO)
    printer = start(changes=changes).homed()
    assert any(text in line for line in printer.session.console)
    assert not any(text in line for line in printer.run("CALIBRATE_Z"))
    assert printer.status("z_calibration")["uncertainty"] < 0.006
    changes = section(target_uncertainty="0.001")
    printer = start(changes=changes).homed()
    assert not any(text in line for line in printer.session.console)
    lines = printer.run("CALIBRATE_Z SAMPLES=auto")
    assert sum(text in line for line in lines) == 1


# clean_gcode

OOZE = OozeSpec(0.05, 0.7, x=BRUSH[0], y=BRUSH[1], radius=2.0)
CLEAN = (
    "\n  G1 X%g Y%g F6000"
    "\n  RESPOND MSG=CLEANED:{printer.z_calibration.phase}" % BRUSH
)


def cleaning(**options):
    return {"respond": {}, **section(clean_gcode=CLEAN, **options)}


@pytest.mark.parametrize("samples", ["auto", "3"])
def test_dirty_nozzle_is_cleaned_once_and_measured_anew(start, samples):
    scene = voron(ooze=OOZE)
    printer = start(scene, changes=cleaning(samples=samples))
    printer.homed()
    lines = printer.run("CALIBRATE_Z")
    text = "\n".join(lines)
    assert text.count("CLEANED:clean_gcode") == 1
    assert "nozzle: the " in text
    assert "cleaning it, then once more" in text
    assert printer.gap() - scene.formula_gap() == pytest.approx(0.0, abs=0.005)
    (line,) = kept_runs(printer)
    assert line["cleaned"] in text
    # Clean as it is now it is left alone
    assert "CLEANED" not in "".join(printer.run("CALIBRATE_Z"))
    assert kept_runs(printer)[1]["cleaned"] == ""


def stiff_residue(with_past):
    """40 um that no touch flattens, and runs of before that had none of it."""
    return voron(ooze=replace(OOZE, height=0.04, kept=1.0)), with_past(
        noise=0.001
    )


@pytest.mark.slow
def test_nozzle_that_departs_is_cleaned_and_all_is_measured_again(
    start, with_past
):
    """The probe is put away for that; what is told is of the second time."""
    scene, past = stiff_residue(with_past)
    changes = cleaning(**past)
    printer = start(scene, changes=changes).homed()
    printer.session.wait(1.0)
    lines = printer.run("CALIBRATE_Z Z_ADJUST=0.1")
    text = "\n".join(lines)
    assert text.count("CLEANED:clean_gcode") == 1
    assert "as hot: cleaning the nozzle, then everything once more" in text
    # Without what is added at the end, once
    gap = printer.gap() - scene.formula_gap()
    assert gap == pytest.approx(0.1, abs=0.005)
    assert printer.status("z_calibration")["warnings"] == []
    assert printer.status("z_calibration")["uncertainty"] < 0.01
    line = kept_runs(printer, Path(past["history"]))[-1]
    assert "switch - nozzle is " in line["cleaned"] and line["ok"]


@pytest.mark.slow
def test_what_cleaning_does_not_help_is_told_after_one_time(start, with_past):
    """As an exchanged nozzle; the uncertainty contains the doubt."""
    scene, past = stiff_residue(with_past)
    changes = cleaning(**past)
    changes["z_calibration"]["clean_gcode"] = "\n  RESPOND MSG=CLEANED"
    printer = start(scene, changes=changes).homed()
    printer.session.wait(1.0)
    text = "\n".join(printer.run("CALIBRATE_Z"))
    assert text.count("CLEANED") == 1
    assert text.count("everything once more") == 1
    (warning,) = printer.status("z_calibration")["warnings"]
    assert "the nozzle is dirty, or" in warning
    assert printer.status("z_calibration")["uncertainty"] > 0.035


@pytest.mark.slow
def test_nozzle_that_cannot_be_cleaned_is_refused_as_before(start):
    scene = voron(z_play=0.2)
    printer = start(scene, changes=cleaning()).homed()
    error = printer.fail("CALIBRATE_Z")
    assert "nozzle: samples differ" in error
    assert "".join(printer.session.console).count("CLEANED") == 1
    assert_unharmed(printer)


@pytest.mark.slow
def test_pin_that_fails_is_no_reason_to_clean(start):
    """The first touch is higher than the second; there is no third."""
    about = {"site": "nozzle_pin", "touch": 3, "command": "CALIBRATE_Z"}
    faults = [Fault("trigger_never", **about)]
    scene = voron(ooze=OozeSpec(0.4, 0.5))
    printer = start(scene, changes=cleaning(**AUTO), faults=faults).homed()
    printer.machine.tolerate("nozzle_pin", 2.0)
    assert "nozzle: the switch did not answer" in printer.fail("CALIBRATE_Z")
    assert "".join(printer.session.console).count("CLEANED") == 0
    assert_unharmed(printer)


@pytest.mark.slow
def test_cleaning_must_not_home(start):
    changes = cleaning(**AUTO)
    changes["z_calibration"]["clean_gcode"] = "\n  G28 Z"
    printer = start(voron(ooze=OOZE), changes=changes).homed()
    error = printer.fail("CALIBRATE_Z")
    assert "Z was homed again" in error
    assert "in clean_gcode; do it before CALIBRATE_Z" in error
