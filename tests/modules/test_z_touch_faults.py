"""One fault of a sensor at a touch: what is told, how deep it went, and what is left.

make faults does each kind at each operation of a run, and judges by rules; here is said
what comes of it.
"""

from __future__ import annotations

import re

import pytest

from simprinter import Fault
from tools.kit.auto_z_offset import true_gap
from tools.kit.dockable_probe import QUICK, section, where
from tools.kit.docks import DOCK_SCENES
from tools.kit.extra_probe import as_probe, lay
from tools.kit.z_calibration import with_extra

TWIST = {
    "calibrate_start_x": "20",
    "calibrate_end_x": "225",
    "calibrate_y": "126.75",
}
# A probe of others, which cannot be told where a touch ends
OTHERS = """
class Hidden:
    def __init__(self, inner):
        self.__dict__.update(inner=inner)
    def __getattr__(self, name):
        if name in ("z_position", "probe_session", "homing_helper"):
            raise AttributeError(name)
        found = getattr(self.inner, name)
        if name == "mcu_probe":
            # The same one each time, as of a host
            found = self.__dict__[name] = Hidden(found)
        return found
printer.objects["probe"] = Hidden(probe)
"""
CODE = "\n  G90\n  SET_PIN PIN=bed_sensor VALUE=1\n  SET_GCODE_OFFSET Z=1"
# By name: scene, changes, what is run before, and how high the toolhead is lifted (mm)
PRINTERS = {
    "voron": (
        *("voron", {"z_calibration": {"start_gcode": "SET_GCODE_OFFSET Z=1"}}),
        *("", 13.8),
    ),
    "qidi": (
        "qidi",
        {
            "axis_twist_compensation": TWIST,
            "auto_z_offset": {"prepare_gcode": CODE},
        },
        *("", 3.67),
    ),
    "saved": (
        *("qidi", {"auto_z_offset": {"probe_z_correction": "-1.12"}}),
        *("", 3.67),
    ),
    # With retries or without, cycles as far apart as the fault makes them
    **{
        f"{name}{retries}": (
            "qidi",
            {
                "auto_z_offset": {
                    "samples_tolerance_retries": f"{retries}",
                    "cycles_tolerance": "0.05",
                    **known,
                }
            },
            # Less high above what is no bed
            *("", 3.1),
        )
        for name, known in (
            ("new", {}),
            ("known", {"probe_z_correction": "-1.12"}),
        )
        for retries in (0, 1)
    },
    "other-voron": ("voron", {"extra": {}}, "", 13.8),
    "other-qidi": ("qidi", {"extra": {}}, "", 3.67),
    "membrane": (
        *("membrane", {}, "G90\nG1 Z5 F900\nG1 X30 Y20 F6000\nM400", 5.1),
    ),
    "asked": ("membrane", {}, "EXTRA_PROBE_CALIBRATE PROBE=membrane", 10.0),
}
CONTINUE = "EXTRA_PROBE_CONTINUE PROBE=probe"
PARAMS = {
    "CALIBRATE_Z_ACCURACY": " CYCLES=2",
    "PROBE_Z_ACCURACY": " SAMPLES=3",
    "Z_CALIBRATION_WAIT": " MAX=2",
    "AUTO_Z_WAIT": " MAX=2",
    "EXTRA_PROBE": " PROBE=membrane",
    "EXTRA_PROBE_CONTINUE": " PROBE=membrane",
}

# ... is for what another test holds
Z = "z_calibration:"
AUTO = "auto_z_offset:"
EXTRA = "extra_probe membrane:"
PRESSED = (
    "the Z endstop reads triggered where nothing should press it; check it with"
    " QUERY_ENDSTOPS..."
)
OFF = (
    "the probe reads triggered, and was attached before: it has come off, or its wire is"
    " broken; look where it is before the toolhead moves ..."
)
SENSOR = (
    f"{AUTO} bed sensor: the switch did not answer (stopped at z=...), the lowest point"
    " of this touch: {}; raise speed ... prepare_gcode ... 'pin: PC1' ..."
)
MEMBRANE = (
    f"{EXTRA} the switch did not answer (stopped at z={{}}); press it by hand and look"
    " with QUERY_EXTRA_PROBE PROBE=membrane, or where the bed may be lower "
)
FIND_BED = "find it with EXTRA_PROBE_CALIBRATE, or set position_min"
LOWER_FLOOR = "begin again with a lower FLOOR, ready to stop"
WORDS = {
    "nozzle": f"{Z} nozzle: the switch did not answer (stopped at z=0.600), expected a"
    " trigger at z=1.600; home Z again (G28 Z) after any levelling, then check ...",
    "switch": f"{Z} switch: the switch did not answer (stopped at z=7.060), expected a"
    " trigger at z=8.060; check switch_xy_position, how the probe is seated, and ...",
    "bed": f"{Z} bed: No trigger on probe after full movement (stopped at z=5.855),"
    " expected a trigger at z=6.855; ...",
    "nozzle-pressed": f"{Z} nozzle: {PRESSED}",
    "switch-pressed": f"{Z} switch: {PRESSED}",
    "switch-off": f"{Z} switch: {OFF}",
    "bed-off": f"{Z} bed: {OFF}",
    "position_min": SENSOR.format("position_min of section 'stepper_z'"),
    "1.000-below": SENSOR.format(
        "1.000 mm below the expected trigger at z=-1.3..."
    ),
    "0.350-below": SENSOR.format(
        "0.350 mm below the expected trigger at z=-1.3..."
    ),
    "reads": f"{AUTO} bed sensor: reads triggered at z=..., where nothing should press"
    " it; check that prepare_gcode turns it on ... QUERY_ENDSTOPS (a '!' in front"
    " of it turns the meaning)",
    "unseen": f"{AUTO} probe: No trigger on probe after full movement (stopped at ...",
    "probe": f"{AUTO} probe: ...; check the probe with QUERY_PROBE and PROBE",
    "not-bed": f"{AUTO} probe: No trigger on probe after full movement (stopped at z=...)"
    " where the bed sensor triggered: that was not the bed, or ...; check the probe ...",
    "above": f"{AUTO} bed sensor: triggered at z=..., ... mm above the expected z=-1...;"
    " clean the nozzle and the bed, ...",
    "over-0.5": f"{AUTO} bed sensor: triggered at z=0.680, which is above z=0.500, the"
    " highest that the probe leaves for it; clean the nozzle and the bed, ...",
    "cycles": f"{AUTO} cycles: samples differ by 0.1000 mm, cycles_tolerance is 0.0500"
    " mm; clean the nozzle and check that nothing shakes the bed ...",
    "too-high": f"{AUTO} the probe sees the bed at z=0.300 instead of 0.000; check ...",
    "too-low": f"{AUTO} the probe sees the bed at z=-0.300 instead of 0.000; check ...",
    "to-0.1": MEMBRANE.format("-0.100") + FIND_BED,
    "to-1.0": MEMBRANE.format("-1.000") + LOWER_FLOOR,
    "early": f"{EXTRA} ...triggered...; look with QUERY_EXTRA_PROBE PROBE=membrane while"
    " nothing presses it: where it reads triggered then, pin needs another '!', or its"
    " wire is broken",
    # Of dockable_probe, and of the host
    "nothing": "No trigger on ... after full movement...",
    "unmoved": "dockable_probe: the probe triggered before the toolhead moved, at z=...",
    "wrong": "dockable_probe: the probe was lost, what was measured is wrong, at z=...",
    "lost": "dockable_probe: the probe was lost in a touch, at z=... probe_sense_pin"
    " reads open...",
}


def rows(table):
    """The rows of a table, one for each touch, and their names."""
    found = []
    for line in table.strip().splitlines():
        *names, touches, words, depth = line.split()
        for touch in touches.split(","):
            row = (*names, int(touch), words, float(depth))
            found.append(pytest.param(*row, id=" ".join((*names, touch))))
    return found


COLUMNS = ("on", "command", "site", "kind", "touch", "words", "depth")
# Printer, command, site, kind, at which of the touches there, words, and how deep what is
# touched was pressed, in mm
FAULTS = """
voron CALIBRATE_Z          nozzle_pin stuck_open      1,3 nozzle         1.0
voron CALIBRATE_Z          nozzle_pin trigger_never   2   nozzle         1.0
voron CALIBRATE_Z          nozzle_pin stuck_closed    1,2 nozzle-pressed 0
voron CALIBRATE_Z          nozzle_pin trigger_early+0.3 1,3 right          0
voron CALIBRATE_Z          nozzle_pin trigger_late+0.3 2   right          0.3
voron CALIBRATE_Z          body_pin   stuck_open      1,3 switch         0.955
voron CALIBRATE_Z          body_pin   trigger_never   2   switch         0.955
voron CALIBRATE_Z          body_pin   stuck_closed    1,3 switch-pressed 0
voron CALIBRATE_Z          body_pin   trigger_early+0.3 1,2 right          0
voron CALIBRATE_Z          body_pin   trigger_late+0.3 3   right          0.3
voron CALIBRATE_Z          body_pin   falls_at_touch  2   switch-off     0
voron CALIBRATE_Z          body_pin   falls_at_lift   1   switch-off     0
voron CALIBRATE_Z          body_pin   falls_at_lift   3   bed-off        0
voron CALIBRATE_Z          probe_bed  stuck_open      1,3 bed            1.16
voron CALIBRATE_Z          probe_bed  trigger_never   2   bed            1.16
voron CALIBRATE_Z          probe_bed  stuck_closed    1,3 bed-off        0
voron CALIBRATE_Z          probe_bed  trigger_early+0.3 2   right          0
voron CALIBRATE_Z          probe_bed  trigger_late+0.3 1   right          0.3
voron CALIBRATE_Z          probe_bed  falls_at_touch  3   bed-off        0
voron CALIBRATE_Z          probe_bed  falls_at_lift   1   bed-off        0
voron CALIBRATE_Z_ACCURACY probe_bed  trigger_never   4   bed            1.16
voron PROBE_Z_ACCURACY     nozzle_pin trigger_never   3   nozzle         1.0
voron Z_CALIBRATION_WAIT   nozzle_pin trigger_never   5   nozzle         1.0
qidi  AUTO_Z_CALIBRATE     nozzle_bed trigger_never   1   position_min   2.69
qidi  AUTO_Z_CALIBRATE     nozzle_bed stuck_open      2,3 0.350-below    0.36
qidi  AUTO_Z_CALIBRATE     nozzle_bed stuck_closed    1,3 reads          0
qidi  AUTO_Z_CALIBRATE     inductive_bed stuck_open   1,3 unseen         0.01
qidi  AUTO_Z_CALIBRATE     inductive_bed stuck_closed 1,2 probe          0.01
qidi  AUTO_Z_CALIBRATE     inductive_bed trigger_early+0.3 2  too-high       0.01
qidi  AUTO_Z_CALIBRATE     inductive_bed trigger_late+0.3 3   too-low        0.01
new0  AUTO_Z_CALIBRATE     nozzle_bed trigger_late+0.1 1,2,3 cycles 0.11
new1  AUTO_Z_CALIBRATE     nozzle_bed trigger_late+0.1 1,2,3 right  0.11
new1  AUTO_Z_CALIBRATE     nozzle_bed trigger_late+0.5 1 above      0.51
new1  AUTO_Z_CALIBRATE     nozzle_bed trigger_late+0.5 2,3 0.350-below 0.36
new0  AUTO_Z_CALIBRATE     nozzle_bed trigger_early+1.6 1 not-bed   0
new0  AUTO_Z_CALIBRATE     nozzle_bed trigger_early+2.0 1 over-0.5  0
known0 AUTO_Z_CALIBRATE    nozzle_bed trigger_early+1.5 1,2,3 above 0.01
known1 AUTO_Z_CALIBRATE    nozzle_bed trigger_early+1.5 1,2,3 right 0.01
saved AUTO_Z_CALIBRATE     nozzle_bed stuck_open      1   1.000-below    1.01
saved AUTO_Z_CALIBRATE     nozzle_bed trigger_never   2   0.350-below    0.36
qidi  AUTO_Z_HOME_Z        nozzle_bed stuck_open      1   position_min   2.69
qidi  AUTO_Z_TWIST         nozzle_bed trigger_never   4   1.000-below    1.01
qidi  AUTO_Z_WAIT          nozzle_bed trigger_never   4   0.350-below    0.36
other-voron CALIBRATE_Z    probe_bed  trigger_never   1,3 bed            1.16
other-qidi AUTO_Z_CALIBRATE inductive_bed trigger_never 1,3 unseen        0.01
membrane EXTRA_PROBE       nozzle_membrane trigger_never 2 to-0.1        0.552
membrane EXTRA_PROBE       nozzle_membrane stuck_closed 1,2 early        0
asked EXTRA_PROBE_CONTINUE nozzle_membrane trigger_never 1 to-1.0        1.452
asked EXTRA_PROBE_CONTINUE nozzle_membrane stuck_open 3   to-1.0         1.452
asked EXTRA_PROBE_CONTINUE nozzle_membrane stuck_closed 1,3 early        0
"""
# The second way down of homing hardly goes deeper than the first one
DOCKED = """
dock_gantry G28                probe_bed stuck_open     2 nothing 1.0
dock_gantry G28                probe_bed stuck_closed   1,2 unmoved 0
dock_gantry G28                probe_bed falls_at_touch 1 unmoved 0
dock_gantry G28                probe_bed falls_at_lift  2 wrong   0
dock_gantry PROBE              probe_bed stuck_open     1 nothing 5.0
dock_gantry PROBE              probe_bed stuck_closed   2 unmoved 0
dock_gantry PROBE              probe_bed falls_at_lift  1 unmoved 0
dock_gantry PROBE              probe_bed falls_at_touch 2 wrong   0
dock_gantry BED_MESH_CALIBRATE probe_bed stuck_open     3 nothing 5.0
dock_gantry BED_MESH_CALIBRATE probe_bed stuck_closed   1 unmoved 0
dock_gantry BED_MESH_CALIBRATE probe_bed falls_at_touch 3 unmoved 0
dock_sensed G28                probe_bed falls_at_touch 2 lost    0
dock_sensed PROBE              probe_bed falls_at_touch 1 lost    0
dock_sensed PROBE              probe_bed falls_at_lift  2 wrong   0
dock_sensed BED_MESH_CALIBRATE probe_bed falls_at_lift  3 lost    0
"""
# What leads to the command, and the command
DOCKED_COMMANDS = {
    "G28": "G28",
    "PROBE": "G28|G1 X150 Y150 Z20 F6000|PROBE",
    "BED_MESH_CALIBRATE": "G28|BED_MESH_CALIBRATE PROBE_COUNT=3,3",
}
PRESSABLE = ("nozzle_pin", "body_pin", "probe_bed", "nozzle_bed")


def fault(kind, **about):
    """The fault of a row."""
    if kind.startswith("falls_at_"):
        return Fault("probe_falls", when=kind[len("falls_at_") :], **about)
    kind, _, mm = kind.partition("+")
    return Fault(kind, **about, **({"mm": float(mm)} if mm else {}))


def state(printer):
    """All that a command that fails leaves as it was."""
    names = ("gcode_move", "toolhead", "configfile")
    move, head, config = printer.statuses(*names).values()
    drivers = printer.machine.drivers
    return {
        "offset": move["homing_origin"][2],
        "absolute": move["absolute_coordinates"],
        "homed": head["homed_axes"],
        "max_accel": head["max_accel"],
        "pending": dict(config["save_config_pending_items"]),
        "currents": {n: driver.current()[1:] for n, driver in drivers.items()},
    }


def assert_told(words, text):
    """The text is in these words, with any others for each ... of them."""
    told = ".*".join(map(re.escape, WORDS[words].split("...")))
    assert re.fullmatch(told, text, re.DOTALL), text


def assert_pressed(printer, depth):
    """So deep, and no more."""
    deepest = max(map(printer.machine.truth.depth, PRESSABLE))
    assert deepest == pytest.approx(depth, abs=0.02)


def assert_right(printer):
    """The true gap is what the formula of the module makes it."""
    if printer.scene.name == "qidi":
        gap, wanted = true_gap(printer), printer.scene.piezo_gap()
    else:
        gap, wanted = printer.gap(), printer.scene.formula_gap()
    assert gap == pytest.approx(wanted, abs=0.01)


def tolerant(printer, depth):
    """Of what the row says; what lies below it is met as well."""
    for site in (*PRESSABLE, "body_bed", "nozzle_membrane"):
        printer.machine.tolerate(site, depth + 0.35)
    return printer


@pytest.mark.parametrize(COLUMNS, rows(FAULTS))
def test_fault(start, tmp_path, on, command, site, kind, touch, words, depth):
    scene, changes, before_it, top = PRINTERS[on]
    broken = fault(kind, site=site, touch=touch, command=command)
    modules = with_extra(tmp_path, OTHERS) if "extra" in changes else None
    printer = tolerant(start(scene, changes, [broken], modules=modules), depth)
    printer.homed().run(f"SET_GCODE_OFFSET Z=0.123 MOVE=0\n{before_it}")
    if scene == "membrane":
        lay(printer)
    before = state(printer)
    script = command + PARAMS.get(command, "")
    if words == "right":
        printer.run(script)
        assert_right(printer)
        assert_pressed(printer, depth)
        return
    assert_told(words, printer.fail(script))
    assert state(printer) == before
    printer.session.wait(2.0)
    assert printer.session.position()[2] >= top - 0.01
    assert_pressed(printer, depth)
    if on != "asked" and "falls" not in kind:
        # The next one goes well
        printer.machine.repair()
        printer.run(script)
        if command in ("CALIBRATE_Z", "AUTO_Z_CALIBRATE"):
            assert_right(printer)


@pytest.mark.parametrize(COLUMNS, rows(DOCKED))
def test_fault_of_a_docked_probe(
    start, on, command, site, kind, touch, words, depth
):
    broken = fault(kind, site=site, touch=touch, command=command)
    options = section(**{**QUICK, "samples": "2"})
    printer = tolerant(start(DOCK_SCENES[on], options, [broken]), depth)
    printer.session.require_ready()
    *first, last = DOCKED_COMMANDS[command].split("|")
    for script in first:
        printer.run(script)
    assert_told(words, printer.fail(last))
    assert printer.session.state()[0] == "ready"
    assert (where(printer) == "lost") is ("falls" in kind)
    assert_pressed(printer, depth)
    # Nothing goes on with what it measured
    assert "Mesh Bed Leveling Complete" not in printer.session.console


# By scene: a command, where its probe touches, and the lowest Z of the axis (mm)
FLOORS = [
    ("voron", {}, "CALIBRATE_Z", "probe_bed", -5.0),
    ("qidi", {}, "AUTO_Z_MEASURE_OFFSET", "inductive_bed", -4.0),
    ("membrane", as_probe(), CONTINUE, "nozzle_membrane", -3.0),
]


@pytest.mark.every_host("a host's floor is kept in other places by each")
@pytest.mark.parametrize("fails", [False, True])
@pytest.mark.parametrize(("scene", "changes", "command", "site", "low"), FLOORS)
def test_host_probes_to_its_own_floor_again(
    start, scene, changes, command, site, low, fails
):
    printer = start(scene, changes).homed()
    if command == CONTINUE:
        printer.run("EXTRA_PROBE_CALIBRATE PROBE=probe")
        lay(printer)
    for touched in (site, "body_bed", "nozzle_bed"):
        printer.machine.tolerate(touched, 12.0)
    if fails:
        name = command.split()[0]
        dead = Fault("trigger_never", site=site, command=name)
        printer.machine.break_down(dead)
    (printer.fail if fails else printer.run)(command)
    printer.machine.break_down(Fault("stuck_open", site=site, command="PROBE"))
    assert "No trigger" in printer.fail("PROBE")
    # The lowest of the axis, not of the command
    lowest = printer.status("toolhead")["position"][2]
    assert lowest == pytest.approx(low, abs=0.01)
