"""Every scene is a whole machine on which real klippy homes and measures.

On those with a piezo bed auto_z_offset's own tests do so.
"""

from __future__ import annotations

import math
from dataclasses import replace
from operator import attrgetter

import pytest

from simprinter import Fault, heated
from simprinter.plugin_printer import read_scene
from simprinter.printer_cfg import PrinterCfg
from simprinter.tests.test_delta import CFG as DELTA
from simprinter.world import Bed
from simprinter.world_file.wiring import kinematics_of
from tools.kit.docks import DOCK_SCENES, SLINGER, calibrating, on_generic
from tools.kit.printer import Printer, has_kinematics
from tools.kit.scenes import SCENES

CALIBRATING = [n for n in SCENES if "z_calibration" in SCENES[n].sections]
MICROSTEP = 0.0025
# Radius of the plunger of a D2F, mm
PLUNGER = 1.0
# Klippy retries a register's write so often
ATTEMPTS = 5


def ready(start, host, scene, **options):
    """A printer, or a skipped test where the host cannot have it."""
    if not has_kinematics(host, scene):
        kinematics = scene.sections["printer"]["kinematics"]
        pytest.skip(f"{host.name} has no {kinematics}")
    return start(scene, **options)


def microstep(printer):
    """What one microstep of a Z motor moves, mm."""
    return printer.scene.wiring.motors["z"].step_dist


def require_z_level(printer):
    """All Z motors were stopped at once, and no board shut down."""
    printer.session.wait(0.5)
    travel = printer.machine.rig.travel(printer.machine.simulation.clock.now())
    heights = [travel[motor] for motor, _, _ in printer.scene.z_motors]
    assert max(heights) - min(heights) == pytest.approx(0.0, abs=1e-9)
    for board in printer.machine.boards.values():
        assert board.journal.shutdowns == []


@pytest.mark.parametrize("name", SCENES)
def test_wiring_and_configuration_name_the_same_pins(name):
    scene = heated(SCENES[name])
    assert scene.name == name
    written = [
        value
        for options in scene.sections.values()
        for key, value in (options or {}).items()
        if key.endswith("pin")
    ]
    wired = [
        *scene.wiring.inputs.values(),
        *scene.wiring.outputs.values(),
        *(heater.pin for heater in scene.wiring.heaters.values()),
        *(pin for m in scene.wiring.motors.values() for pin in m.pins()),
    ]
    assert set(wired) <= set(written)
    assert len(set(written)) == len(written)


@pytest.mark.parametrize(
    "scene",
    [*SCENES.values(), *DOCK_SCENES.values(), on_generic(SLINGER)],
    ids=attrgetter("name"),
)
def test_motors_are_those_that_the_configuration_describes(scene):
    """Also of machines that are made of others, beside any file."""
    written = {
        section: {k: v for k, v in options.items() if v is not None}
        for section, options in scene.sections.items()
    }
    boards = {f"mcu {name}": {} for name in scene.wiring.boards}
    cfg = PrinterCfg(scene.name, {**written, **boards})
    assert cfg.motors() == scene.wiring.motors
    assert kinematics_of(cfg) == scene.kinematics


def touches_beside(scene):
    """Where the pin meets the probe, from its plunger: mm in X and in Y."""
    x, y = map(
        float, scene.sections["z_calibration"]["switch_xy_position"].split(",")
    )
    probe, pin = scene.world.mag_probe, scene.world.pin
    return pin.x - x - probe.x_offset, pin.y - y - probe.y_offset


@pytest.mark.parametrize(
    "scene",
    [
        *(SCENES[name] for name in CALIBRATING),
        *(calibrating(s) for s in DOCK_SCENES.values() if s.world.pin),
    ],
    ids=attrgetter("name"),
)
def test_body_beside_the_plunger_is_over_the_pin(scene):
    beside = touches_beside(scene)
    assert math.hypot(*beside) >= PLUNGER + scene.world.pin.radius
    assert max(map(abs, beside)) < scene.world.mag_probe.half_width


@pytest.mark.slow
@pytest.mark.parametrize("name", CALIBRATING)
def test_calibration_ends_at_the_gap_of_the_formula(start, host, name):
    printer = ready(start, host, SCENES[name]).homed()
    require_z_level(printer)
    wanted = printer.scene.formula_gap()
    # It would be no wonder otherwise
    assert abs(printer.gap() - wanted) > 10 * microstep(printer)
    printer.run("CALIBRATE_Z\nG1 X150 Y150 Z20 F3000\nM400")
    printer.session.wait(0.5)
    # Half a belt that ran on would carry the toolhead aside as well as down
    assert printer.machine.tip().x == pytest.approx(150.0, abs=0.02)
    assert printer.gap() == pytest.approx(wanted, abs=2 * microstep(printer))
    samples = int(printer.scene.number("probe", "samples"))
    for site in ("nozzle_pin", "body_pin", "probe_bed"):
        assert printer.machine.truth.touch_count(site) >= samples


def test_two_membranes_of_one_owner(start):
    """Each has a section, a place, a height, and a hand that lays it."""
    scene = SCENES["membrane"]
    first, section = scene.world.membrane, "extra_probe membrane"
    other = replace(first, x=100.0, thickness=0.5, signal="thick")
    scene = replace(
        scene,
        sections={
            **scene.sections,
            "extra_probe thick": {
                **scene.sections[section],
                "pin": "^!PF6",
                "xy_position": "100, 20",
                "z_offset": "0.45",
            },
        },
        wiring=replace(
            scene.wiring, inputs={**scene.wiring.inputs, "thick": "^!PF6"}
        ),
    ).with_world(more_membranes=(other,))
    printer = start(scene).homed()
    for signal, x in (("membrane", 30), ("thick", 100)):
        printer.machine.lay_membrane(signal=signal)
        printer.run(f"G1 Z10\nG1 X{x} Y20\nEXTRA_PROBE PROBE={signal}")
        printer.machine.lay_membrane(False, signal)
    bed = Bed(scene.world.bed)
    heights = {
        touch.site: touch.trigger_z - bed.height(touch.x, touch.y)
        for touch in printer.machine.truth.touches
        if touch.site.startswith("nozzle_")
    }
    assert heights == pytest.approx(
        {"nozzle_membrane": 0.25, "nozzle_thick": 0.45}, abs=1e-6
    )


ON_A_DELTA = [
    {"z_calibration": {"nozzle_xy_position": "0, 0", "switch_offset": "0.5"}},
    {"auto_z_offset": {"pin": "PC7", "z_offset": "0.2"}},
    {"extra_probe thin": {"pin": "PC7", "z_offset": "0.2"}},
    {
        "probe": None,
        "dockable_probe": {
            "pin": "^PC3",
            "z_offset": "6.9",
            "dock_position": "0, 90",
            "approach_position": "0, 70",
            "detach_position": "30, 90",
        },
    },
]


@pytest.mark.parametrize("sections", ON_A_DELTA, ids=lambda s: [*s][-1])
def test_delta_is_refused_by_each_module(start, sections):
    state, told = start(read_scene(DELTA), sections).session.start()
    assert state == "error"
    name = [*sections][-1]
    assert "'kinematics: delta'" in told
    assert f"{name} cannot be used on this machine" in told
    assert f"remove section '{name}'" in told


@pytest.mark.every_host("hosts have other kinematics")
def test_kinematics_that_a_host_does_not_have(start, host):
    assert has_kinematics(host, SCENES["voron"])
    assert has_kinematics(host, SCENES["corexz"])
    sections = {**SCENES["voron"].sections, "printer": {"kinematics": "spiral"}}
    unknown = replace(SCENES["voron"], sections=sections)
    assert not has_kinematics(host, unknown)
    state, _ = start("generic").session.start()
    expected = has_kinematics(host, SCENES["generic"])
    assert state == ("ready" if expected else "error")


def set_current(printer, amperes):
    """Ask for a current; what the driver does once it has it, A RMS."""
    printer.run(f"SET_TMC_CURRENT STEPPER=stepper_z CURRENT={amperes}")
    printer.session.wait(0.2)
    return printer.machine.drivers["z"].current()[1:]


@pytest.mark.parametrize("tries", [ATTEMPTS - 1, ATTEMPTS, "change"])
def test_writes_to_a_driver_that_are_lost(host, tries):
    """One less than klippy's attempts is not even noticed."""
    changes = {"auto_z_offset": None}
    with Printer(host, "qidi", changes, modules={}) as printer:
        printer.session.require_ready()
        # A change is lost however often klippy tries it again
        if tries == "change":
            faults = [Fault("tmc_change_lost", driver="z")]
        else:
            faults = [
                Fault("tmc_write_error", driver="z", n=n)
                for n in range(1, tries + 1)
            ]
        for fault in faults:
            printer.machine.break_down(fault)
        driver = printer.machine.drivers["z"]
        before = driver.current()[1:]
        if tries == ATTEMPTS - 1:
            assert set_current(printer, 0.4) != before
        else:
            text = printer.fail("SET_TMC_CURRENT STEPPER=stepper_z CURRENT=0.4")
            assert "Unable to write tmc uart 'stepper_z'" in text
            assert driver.current()[1:] == before
        # Nothing is left to fail. Another value: Kalico takes the first one
        # for set
        before = driver.current()[1:]
        assert set_current(printer, 0.5) != before
