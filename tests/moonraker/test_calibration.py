"""A calibration as a web interface runs and shows it."""

from __future__ import annotations

import itertools
import re

import pytest

from simprinter.hosts.moonraker import MoonrakerError
from tests.moonraker.updates import calibrated

pytestmark = pytest.mark.slow

MICROSTEP = 0.0025
SITES = ["nozzle", "switch", "bed"]


def lines_since(lab, time):
    """(type, message) of the console since then."""
    store = lab.moonraker.get("/server/gcode_store")["gcode_store"]
    return [(e["type"], e["message"]) for e in store if e["time"] > time]


def last_time(lab):
    """When the console showed its last line."""
    store = lab.moonraker.get("/server/gcode_store")["gcode_store"]
    return store[-1]["time"] if store else 0.0


def test_console_shows_the_calibration(lab):
    before = last_time(lab)
    offset = calibrated(lab)["last_z_offset"]
    lines = lines_since(lab, before)
    assert [m for kind, m in lines if kind == "command"] == ["G28\nCALIBRATE_Z"]
    said = [message for kind, message in lines if kind == "response"]
    for site in SITES:
        place = rf"// z_calibration: {site} at z=[\d.]+ \(3 touches, 0\.00\d mm"
        assert sum(bool(re.match(place, line)) for line in said) == 1, said
    result, worth = said[-2:]
    assert result.startswith("// Z-CALIBRATION: probe=")
    assert result.endswith(f"new offset={offset:.6f}")
    assert worth.startswith(f"// Z-CALIBRATION: offset {offset:.3f} +-")
    move = lab.moonraker.status("gcode_move")
    assert move["homing_origin"][2] == pytest.approx(offset)
    with lab.standing() as printer:
        gap = printer.scene.formula_gap()
        assert printer.gap() == pytest.approx(gap, abs=MICROSTEP)
        assert printer.machine.board.journal.shutdowns == []


def test_status_changes_while_a_calibration_runs(lab):
    with lab.moonraker.listen() as listener:
        begun = listener.call(
            "printer.objects.subscribe", objects={"z_calibration": None}
        )["status"]["z_calibration"]
        assert begun["phase"] == "idle" and begun["progress"] == 0.0
        last = calibrated(lab)
        changes = listener.collect(
            "notify_status_update",
            lambda params: params[0]["z_calibration"].get("phase") == "idle",
        )
    merged, phases, progress = dict(begun), [], []
    for status, _ in changes:
        merged.update(status["z_calibration"])
        phases.append(merged["phase"])
        progress.append(merged["progress"])
    # Whatever is over within a quarter of a second may be missing
    in_order = [phase for phase, _ in itertools.groupby(phases)]
    assert [p for p in in_order if p in SITES] == SITES
    assert in_order[-1] == "idle"
    assert progress[:-1] == sorted(progress[:-1])
    assert progress[-2:] == [1.0, 0.0]
    assert merged == last
    assert last["valid"]
    assert last["last_z_offset"] == last["last_result"]["offset"] != 0.0


def failure(lab, script):
    """The text that a script ends with, which the console shows, too."""
    before = last_time(lab)
    with pytest.raises(MoonrakerError) as caught:
        lab.moonraker.run(script)
    assert caught.value.status == 400
    text = caught.value.text
    assert ("response", f"!! {text}") in lines_since(lab, before)
    assert lab.moonraker.status("z_calibration")["phase"] == "idle"
    return text


def test_calibration_that_cannot_begin_tells_why(lab):
    lab.moonraker.run("M84")
    assert failure(lab, "CALIBRATE_Z") == (
        "z_calibration: not homed: X, Y, Z; home all axes (G28) first"
    )
    calibrated(lab)


def test_calibration_that_fails_on_the_way_tells_why(lab):
    before = calibrated(lab)
    # So large that the probe does not go down to the bed
    text = failure(lab, "CALIBRATE_Z SWITCH_OFFSET=3")
    assert text.startswith("z_calibration: bed: No trigger on probe")
    after = lab.moonraker.status("z_calibration")
    assert after["last_z_offset"] == before["last_z_offset"]
