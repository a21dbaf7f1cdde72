"""CALIBRATE_Z with a probe that fetches and docks itself, ours or Kalico's."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from simprinter import Fault
from tools.kit.carrying import without_our_dock
from tools.kit.cases import all_slow_but, slow
from tools.kit.dockable_probe import SWITCH, trips, where
from tools.kit.docks import HANG, calibrating
from tools.kit.z_calibration import calibration

SCENE = calibrating(SWITCH)
# What the scene's [z_calibration] says of the switch, and what is so
GAP = 0.485 - 0.44


def z_section(**options):
    """Changes to [z_calibration] only."""
    return {"z_calibration": options}


WAYS = pytest.mark.parametrize(
    "changes",
    [
        {},
        slow(z_section(start_gcode="ATTACH_PROBE", end_gcode="DETACH_PROBE")),
        slow(z_section(before_switch_gcode="ATTACH_PROBE")),
        slow({"dockable_probe": {"auto_attach_detach": "False"}}),
        # The bed is looked at first, in a session of its own
        {"dockable_probe": {"z_offset": "0"}},
    ],
    ids=["by itself", "told", "before the switch", "not automatic", "length"],
)


def assert_calibrated(printer):
    """Two runs, one trip each; what was automatic is so again."""
    automatic = printer.status("dockable_probe")["auto_attach_detach"]
    for _ in range(2):
        before = len(printer.machine.truth.events)
        calibration(printer)
        assert trips(printer, before) == ["attach", "dock"]
        assert where(printer) == "docked"
    status = printer.status("dockable_probe")
    assert status["auto_attach_detach"] is automatic
    assert printer.machine.truth.min_gap > HANG - 0.2
    assert printer.gap() == pytest.approx(GAP, abs=0.01)


@WAYS
def test_calibrate_z(start, changes):
    assert_calibrated(start(SCENE, changes).homed())


@pytest.mark.parametrize("is_attached", [False, True])
def test_place_is_proved_by_an_attached_probe_only(start, is_attached):
    """A later run with the probe attached looks there whether it meets the bed."""
    changes = z_section(start_gcode="ATTACH_PROBE" if is_attached else "M400")
    printer = start(SCENE, changes).homed()
    calibration(printer)
    printer.session.wait(1.0)
    folder = printer.session.data / "config" / "z_calibration"
    (line,) = (folder / "printer.jsonl").read_text().splitlines()
    assert bool(json.loads(line).get("nozzle_at")) is is_attached


# Of which only Kalico has one
@pytest.mark.every_host("only Kalico has a dockable_probe of its own")
@pytest.mark.slow
@WAYS
def test_calibrate_z_with_the_one_that_the_host_has(start, host, changes):
    if not host.layout.module_dir.endswith("plugins"):
        pytest.skip("only Kalico has a dockable_probe of its own")
    ours = without_our_dock()
    assert_calibrated(start(SCENE, changes, modules=ours).homed())


# The pin on the bed, where the probe would meet that before the nozzle meets it
_FRONT = (206.0, 100.0)


def front(scene=SCENE):
    sections = {
        **scene.sections,
        "safe_z_home": {"home_xy_position": "206, 100", "z_hop": "10"},
        "z_calibration": {
            **scene.sections["z_calibration"],
            "nozzle_xy_position": "206, 100",
            "switch_xy_position": "211.5, 75.25",
        },
    }
    x, y = _FRONT
    pin = replace(scene.world.pin, x=x, y=y)
    return replace(scene, sections=sections).with_world(pin=pin)


# start_gcode, before_switch_gcode and end_gcode; the nozzle is touched with the
# probe on the toolhead only where start_gcode says so
HOOKS = {
    "none": (None, None, None),
    "start": ("ATTACH_PROBE", None, None),
    "end": (None, None, "DETACH_PROBE"),
    "before the switch": (None, "ATTACH_PROBE", None),
    "others": ("G4 P1", "G4 P1", "G4 P1"),
    "levelling": ("QUAD_GANTRY_LEVEL\nG28 Z", None, None),
}
BEFORE = {
    "docked": ({}, "G4 P1"),
    "held": ({}, "ATTACH_PROBE"),
    "delayed": ({"allow_delayed_detach": "True"}, "PROBE"),
}


def hooks_of(name):
    names = ("start_gcode", "before_switch_gcode", "end_gcode")
    lines = [
        code and "\n  " + code.replace("\n", "\n  ") for code in HOOKS[name]
    ]
    return z_section(**dict(zip(names, lines)))


@pytest.mark.parametrize("before", all_slow_but(["delayed"], BEFORE))
@pytest.mark.parametrize("hooks", HOOKS)
def test_each_hook_has_its_own_default(start, hooks, before):
    options, script = BEFORE[before]
    scene = SCENE if hooks == "start" else front()
    changes = {"dockable_probe": {"samples": "1", **options}, **hooks_of(hooks)}
    printer = start(scene, changes).homed()
    printer.run(f"G1 X150 Y150 Z20 F6000\n{script}")
    for _ in range(2):
        calibration(printer)
        assert where(printer) == "docked"
        assert printer.machine.truth.depth("body_bed") == 0.0
    status = printer.status("dockable_probe")
    assert status["auto_attach_detach"] is True
    assert printer.gap() == pytest.approx(GAP, abs=0.01)


@pytest.mark.every_host("only Kalico has a dockable_probe of its own")
@pytest.mark.slow
@pytest.mark.parametrize("script", ["G4 P1", "ATTACH_PROBE"])
@pytest.mark.parametrize("hooks", ["none", "before the switch", "end"])
def test_hooks_with_the_one_that_the_host_has(start, host, hooks, script):
    if not host.layout.module_dir.endswith("plugins"):
        pytest.skip("only Kalico has a dockable_probe of its own")
    changes = {"dockable_probe": {"z_hop": "12"}, **hooks_of(hooks)}
    printer = start(front(), changes, modules=without_our_dock()).homed()
    printer.run(script)
    calibration(printer)
    assert where(printer) == "docked"
    assert printer.machine.truth.depth("body_bed") == 0.0
    assert printer.gap() == pytest.approx(GAP, abs=0.01)


@pytest.mark.slow
def test_one_trip_where_start_gcode_attaches_what_is_there(start):
    printer = start(SCENE, hooks_of("start")).homed()
    printer.run("ATTACH_PROBE\nCALIBRATE_Z")
    assert trips(printer) == ["attach", "dock"]


@pytest.mark.slow
def test_probe_is_where_it_was_if_no_trips_are_wanted(start):
    changes = {"dockable_probe": {"auto_attach_detach": "False"}}
    printer = start(front(), changes).homed()
    printer.run("ATTACH_PROBE\nCALIBRATE_Z")
    assert trips(printer) == ["attach", "dock", "attach"]
    printer.run("DETACH_PROBE\nCALIBRATE_Z")
    assert where(printer) == "docked"


@pytest.mark.slow
def test_probe_is_docked_after_an_error_in_end_gcode(start):
    changes = z_section(end_gcode="\n  NO_SUCH_MACRO\n  G1 X999")
    printer = start(front(), changes).homed()
    printer.fail("CALIBRATE_Z")
    assert where(printer) == "docked"


@pytest.mark.slow
def test_cycles_with_the_probe_on_need_it_on(start):
    command = "CALIBRATE_Z_ACCURACY CYCLES=2 ATTACH=0"
    printer = start(front()).homed()
    assert "ATTACH=0 needs the probe on the toolhead" in printer.fail(command)
    assert where(printer) == "docked"
    printer = start(SCENE, hooks_of("start")).homed()
    printer.run(command)
    assert trips(printer) == ["attach", "dock"]


# The dock in the way from the start to the pin
IN_THE_WAY = {
    "CALIBRATE_Z": "CALIBRATE_Z",
    "PROBE_Z_ACCURACY": "PROBE_Z_ACCURACY SAMPLES=2",
}


@pytest.mark.parametrize("command", IN_THE_WAY)
def test_no_way_leads_through_the_dock(start, command):
    printer = start(SCENE).homed()
    printer.run("G1 Z20 F900\nMOVE_AVOIDING_DOCK X=5 Y=306 SPEED=100")
    touched = len(printer.machine.truth.touches)
    printer.run(IN_THE_WAY[command])
    assert len(printer.machine.truth.touches) > touched
    assert printer.machine.truth.crashes() == []


@pytest.mark.slow
def test_automatic_again_after_an_error(start):
    changes = z_section(offset_margins="-0.01, 0.01", bed_xy_position="60, 60")
    printer = start(SCENE, changes).homed()
    assert "offset" in printer.fail("CALIBRATE_Z")
    assert where(printer) == "docked"
    status = printer.status("dockable_probe")
    assert status["auto_attach_detach"] is True


@pytest.mark.slow
def test_probe_that_is_not_there(start):
    fault = Fault("attach_fails", persistent=True)
    printer = start(SCENE, faults=[fault]).homed()
    assert "the probe was not fetched" in printer.fail("CALIBRATE_Z")
    assert printer.machine.truth.min_gap > 9.0
    assert printer.session.state()[0] == "ready"
