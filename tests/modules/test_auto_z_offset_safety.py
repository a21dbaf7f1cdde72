"""What [auto_z_offset] does when something is wrong: nothing gets hurt."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.hosts.session import GcodeError
from simprinter.mcu.tmc import IFCNT
from tools.campaign.drawn.machines import on_plate
from tools.kit.auto_z_offset import (
    DEPTH,
    MICROSTEP,
    POINT,
    lowest,
    section,
    sites,
    state,
    told,
    touches,
    true_gap,
)
from tools.kit.carrying import SWITCH, with_all
from tools.kit.cases import all_slow_but, slow
from tools.kit.docks import DOCK_SCENES, HANG
from tools.kit.printer import Printer, module_files, saved_before
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import with_extra

STEPS = 2 * MICROSTEP
PREPARE = SCENES["qidi"].sections["auto_z_offset"]["prepare_gcode"]
# Depth of the nozzle (mm) that one touch at 5 mm/s takes, with its overshoot
ONE_TOUCH = DEPTH + 0.01


def before_and_after(printer, script="AUTO_Z_CALIBRATE"):
    """Run what must fail; its text, and both states."""
    before = state(printer)
    text = printer.fail(script)
    assert printer.session.state()[0] == "ready"
    printer.session.wait(1.0)
    return text, before, state(printer)


def assert_lifted(printer):
    """The toolhead is well above the bed."""
    tip = printer.machine.tip()
    gap = printer.machine.truth.true_gap(tip.x, tip.y, tip.z)
    assert gap > 3.6


# A sensor that does not fall back


@pytest.mark.parametrize(
    "command", ["AUTO_Z_PROBE", "AUTO_Z_HOME_Z", "AUTO_Z_MEASURE_OFFSET"]
)
def test_sensor_that_stays_triggered_after_the_touch(start, command):
    """No other touch looks at it; the probe would be compared with that one."""

    def at_60(*faults):
        """A printer at the same time each time, and its state before."""
        printer = start("qidi", faults=faults).homed()
        before, clock = state(printer), printer.machine.simulation.clock
        printer.session.wait(60.0 - printer.machine.rig.seconds(clock.now()))
        return printer, before

    good, _ = at_60()
    good.run(command)
    nozzle = sites(good).index("nozzle_bed")
    then = touches(good)[nozzle].t + 0.1
    fault = Fault("stuck_closed", signal="bed_sensor", t=then)
    printer, before = at_60(fault)
    text = printer.fail(command)
    assert "bed sensor: reads triggered at z=3.6" in text
    assert sites(printer) == sites(good)[: nozzle + 1]
    assert state(printer) == before


# What is known of the bed


@pytest.mark.parametrize(
    ("script", "floor"),
    [
        ("M400", "1.000 mm below the expected trigger at z=-1.3"),
        ("G28 Z", "position_min of section 'stepper_z'; "),
        ("SET_KINEMATIC_POSITION Z=10", "position_min of section 'stepper_z'"),
    ],
)
def test_touch_says_where_the_next_one_ends_in_its_frame(start, script, floor):
    changes = {"force_move": {"enable_force_move": "true"}}
    printer = start("qidi", changes=changes)
    printer.machine.tolerate("nozzle_bed", 10.0)
    printer.homed().run(f"AUTO_Z_PROBE\n{script}")
    about = {"site": "nozzle_bed", "command": "AUTO_Z_PROBE"}
    printer.machine.break_down(Fault("trigger_never", **about))
    assert f"of this touch: {floor}" in printer.fail("AUTO_Z_PROBE")
    assert (lowest(printer) <= ONE_TOUCH + 1.0) is (script == "M400")


def test_probe_that_sees_the_bed_elsewhere(start):
    # Z was set by somebody else
    shift = 0.12
    changes = {"force_move": {"enable_force_move": "true"}}
    printer = start("qidi", changes=changes).homed()
    z = printer.status("toolhead")["position"][2]
    printer.run(f"SET_KINEMATIC_POSITION Z={z + shift}")
    text, before, after = before_and_after(printer)
    words = f"the probe sees the bed at z={shift:.3f}"
    assert f"{words} instead of 0.000; check the probe with QUERY_PROBE" in text
    assert "home Z again (G28) after" in text
    assert after == before
    # Nothing is applied by this one
    assert told(printer.run("AUTO_Z_MEASURE_OFFSET"), words)
    printer.run("G28 Z\nAUTO_Z_CALIBRATE")
    gap = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    # Less is nothing
    printer.run("G28 Z")
    z = printer.status("toolhead")["position"][2]
    printer.run(f"SET_KINEMATIC_POSITION Z={z + shift / 1.5}\nAUTO_Z_CALIBRATE")


@pytest.mark.parametrize(
    "command", ["LOAD_OFFSET", slow("SAVE_GCODE_OFFSET"), slow("CALIBRATE")]
)
def test_correction_means_nothing_after_home_z(start, command):
    # Loaded there, Z=0 would be 1.4 mm inside the bed
    printer = start("qidi", changes=section(probe_z_correction="-1.12"))
    printer.homed().run("AUTO_Z_HOME_Z")
    text, before, after = before_and_after(printer, f"AUTO_Z_{command}")
    assert "Z was set by AUTO_Z_HOME_Z" in text
    assert "home Z with the probe (G28) first" in text
    assert after == before
    # What is saved is counted from what was loaded
    loads = "AUTO_Z_PROBE\nG28 Z\nAUTO_Z_LOAD_OFFSET"
    printer.run(f"{loads}\nAUTO_Z_{command}")


def test_motor_that_was_off_does_not_end_it(start):
    options = section(probe_z_correction="-1.12")
    printer = start("qidi", changes=options).homed()
    off = "SET_STEPPER_ENABLE STEPPER=stepper_z ENABLE=0"
    printer.run(f"AUTO_Z_HOME_Z\n{off}")
    for command in ("AUTO_Z_LOAD_OFFSET", "AUTO_Z_SAVE_GCODE_OFFSET"):
        assert "Z was set by AUTO_Z_HOME_Z" in printer.fail(command)
    # Z is to be homed with the probe then, and the offset is still that of before
    printer.run("M84")
    text = printer.fail("AUTO_Z_SAVE_GCODE_OFFSET")
    assert "Z was set by AUTO_Z_HOME_Z" in text
    printer.run("AUTO_Z_LOAD_OFFSET\nG28\nAUTO_Z_LOAD_OFFSET")


def wrong_probe(start, slope_x, slope_y, sigma=0.0):
    """A gantry on a slope, and a probe that is 1.2 mm wrong, which is known."""
    scene = with_all(DOCK_SCENES["dock_gantry"])
    bed = replace(scene.world.bed, slope_x=slope_x, slope_y=slope_y)
    probe = scene.world.mag_probe
    probe = replace(probe, noise=replace(probe.noise, sigma=sigma))
    scene = scene.with_world(mag_probe=probe)
    wrong = 1.2
    options = section(
        probe_z_correction=f"{0.15 - wrong}",
        corrected_probe_z_offset=f"{HANG - wrong}",
    )
    hangs = {"z_calibration": None, "dockable_probe": {}, **options}
    hangs["dockable_probe"]["z_offset"] = f"{HANG - wrong}"
    averaged = {"samples": "3", "samples_result": "average"}
    hangs["dockable_probe"].update(averaged if sigma else {})
    return start(scene.with_world(bed=bed), hangs).homed()


# In the second two pairs of motors turn as far, in the others by less than a step
# more, and by what the probe's noise makes of that
@pytest.mark.parametrize(
    ("slope_y", "sigma"),
    [(0.0005, 0.0), slow(0.0, 0.0), slow(6e-6, 0.003)],
)
def test_levelling_of_the_host_does_not_end_it_either(start, slope_y, sigma):
    printer = wrong_probe(start, 0.0008, slope_y, sigma)
    printer.run("AUTO_Z_HOME_Z\nQUAD_GANTRY_LEVEL")
    for command in ("LOAD_OFFSET", "SAVE_GCODE_OFFSET"):
        text, before, after = before_and_after(printer, f"AUTO_Z_{command}")
        assert "Z was set by AUTO_Z_HOME_Z" in text
        assert after == before
    # Nor is the bed where the correction says
    printer.run("AUTO_Z_PROBE")
    printer.run("G28 Z\nAUTO_Z_LOAD_OFFSET\nAUTO_Z_SAVE_GCODE_OFFSET")


# "Too many retries", and Z is the probe's all the same
@pytest.mark.slow
def test_z_tilt_that_fails_in_the_end(start):
    scene = with_all(DOCK_SCENES["dock_frame"])
    probe = scene.world.mag_probe
    probe = replace(probe, noise=replace(probe.noise, sigma=0.003))
    changes = {"z_calibration": None, **section(probe_z_correction="0.16")}
    changes["z_tilt"] = {"retries": "1", "retry_tolerance": "0.0001"}
    changes["dockable_probe"] = {"z_offset": f"{HANG - 0.4}"}
    printer = start(scene.with_world(mag_probe=probe), changes).homed()
    easy = "RETRY_TOLERANCE=0.05 RETRIES=5"
    printer.run(f"Z_TILT_ADJUST {easy}\nG28\nAUTO_Z_HOME_Z")
    assert "retries" in printer.fail("Z_TILT_ADJUST")
    printer.run("AUTO_Z_LOAD_OFFSET")


def test_z_that_is_set_after_levelling_is_another_one(start):
    scene = with_all(DOCK_SCENES["dock_gantry"])
    bed = replace(scene.world.bed, slope_x=0.0008, slope_y=0.0005)
    changes = {
        "force_move": {"enable_force_move": "true"},
        "z_calibration": None,
    }
    printer = start(scene.with_world(bed=bed), changes).homed()
    # The motors stay where levelling leaves them
    printer.run("AUTO_Z_HOME_Z\nATTACH_PROBE\nQUAD_GANTRY_LEVEL")
    assert "Z was set by AUTO_Z_HOME_Z" in printer.fail("AUTO_Z_LOAD_OFFSET")
    z = printer.status("toolhead")["position"][2]
    printer.run(f"SET_KINEMATIC_POSITION Z={z + 1.0}\nAUTO_Z_LOAD_OFFSET")


# Z=0 is where the probe sees the bed then, as after G28
@pytest.mark.every_host(
    "who gets a probe's results, and as what, changed in 2024 and 2026"
)
def test_z_tilt_sets_z_with_the_probe(start):
    scene = with_all(DOCK_SCENES["dock_frame"])
    bed = replace(scene.world.bed, slope_x=0.0008, slope_y=0.0005)
    changes = {"z_calibration": None, **section(probe_z_correction="0.16")}
    changes["dockable_probe"] = {"z_offset": f"{HANG - 0.4}"}
    printer = start(scene.with_world(bed=bed), changes).homed()
    printer.run("AUTO_Z_HOME_Z")
    assert "Z was set by AUTO_Z_HOME_Z" in printer.fail("AUTO_Z_LOAD_OFFSET")
    printer.run("Z_TILT_ADJUST\nAUTO_Z_LOAD_OFFSET")


MESH = "BED_MESH_CALIBRATE PROBE_COUNT=3,3"


# The points of levelling lie lower than the middle, where Z was homed
@pytest.mark.parametrize(
    ("script", "is_told", "zero"),
    [
        ("Z_TILT_ADJUST", True, None),
        ("Z_TILT_ADJUST\nG28 Z", False, None),
        # Probed since, it goes with where Z is now
        (f"Z_TILT_ADJUST\n{MESH}", False, None),
        (
            f"Z_TILT_ADJUST\n{MESH}\nBED_MESH_PROFILE LOAD=default",
            False,
            None,
        ),
        # Whatever Z=0 has moved by, such a mesh is 0 at its point
        (f"Z_TILT_ADJUST\n{MESH}", True, "150, 150"),
        (f"G28 Z\n{MESH}", False, "150, 150"),
        # One of before does not
        (f"{MESH}\nZ_TILT_ADJUST", True, None),
        (
            f"{MESH} PROFILE=old\nZ_TILT_ADJUST\n{MESH} PROFILE=new"
            "\nBED_MESH_PROFILE LOAD=old",
            True,
            None,
        ),
        ("", False, None),
        # What holds the axis nobody sees, and nobody has homed
        ("Z_TILT_ADJUST\nM84", False, None),
    ],
)
def test_correction_of_a_z_that_levelling_has_moved(
    start, script, is_told, zero
):
    scene = on_plate(with_all(DOCK_SCENES["dock_frame"]), (0.0, 0.0), 0.2, 0.0)
    changes = {"z_calibration": None, **section(probe_z_correction="0.16")}
    changes["bed_mesh"] = {"zero_reference_position": zero}
    printer = start(scene, changes).homed()
    printer.run(script)
    lines = printer.run("AUTO_Z_LOAD_OFFSET")
    assert told(lines, "the G-code Z offset is 0.16")
    assert bool(told(lines, "as levelling does")) is is_told
    if is_told:
        # What it advises makes Z=0 another one, and is enough
        levelled = printer.gap(printer.bed_point())
        lines = printer.run("G28 Z\nAUTO_Z_LOAD_OFFSET")
        assert abs(printer.gap(printer.bed_point()) - levelled) > 0.1
        assert not told(lines, "as levelling does")


# The lines of a macro are one command: between them nothing is told
@pytest.mark.every_host("what they send when Z is homed, set and levelled")
@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("Z_TILT_ADJUST", "the Z motors were levelled"),
        slow("SET_KINEMATIC_POSITION Z=10.5", "Z was homed again or set"),
        ("Z_TILT_ADJUST\nG28 Z", ""),
        slow("G28\nG28 Z", ""),
        slow(f"Z_TILT_ADJUST\n{MESH}", ""),
        slow("Z_TILT_ADJUST\nM84", ""),
        slow("AUTO_Z_HOME_Z", ""),
    ],
)
def test_what_moves_z_from_the_offset_is_told_once(start, script, words):
    changes = {
        "z_calibration": None,
        "force_move": {"enable_force_move": "True"},
        "gcode_macro MOVES": {"gcode": "\n  " + script.replace("\n", "\n  ")},
        **section(probe_z_correction="0.16"),
    }
    scene = with_all(DOCK_SCENES["dock_frame"])
    printer = start(scene, changes).homed()
    printer.run("AUTO_Z_LOAD_OFFSET\nG91\nG1 Z1 F600\nG90")
    printer.session.wait(3.0)
    before = len(printer.session.console)
    for _ in range(2):
        if "M84" in script:
            printer.homed()
        printer.run("MOVES")
        printer.session.wait(5.0)
    found = [
        line
        for line in printer.session.console[before:]
        if "the offset of AUTO_Z_LOAD_OFFSET was 0.160" in line
    ]
    assert len(found) == bool(words)
    assert not words or words in found[0]


@pytest.mark.parametrize("is_levelled", [False, True])
def test_steps_that_make_good_for_levelling_are_told(start, is_levelled):
    scene = on_plate(with_all(DOCK_SCENES["dock_frame"]), (0.0, 0.0), 0.2, 0.0)
    correction = section(probe_z_correction="0.16")
    printer = start(scene, {"z_calibration": None, **correction}).homed()
    printer.run("AUTO_Z_LOAD_OFFSET")
    script = "Z_TILT_ADJUST" if is_levelled else "G28 Z"
    printer.run(f"{script}\nSET_GCODE_OFFSET Z_ADJUST=-0.1")
    before = printer.gap(printer.bed_point())
    lines = printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    assert bool(told(lines, "steps that make good for it")) is is_levelled
    printer.run("G28 Z\nAUTO_Z_LOAD_OFFSET")
    wrong = printer.gap(printer.bed_point())
    assert (abs(wrong - before) > 0.1) is is_levelled
    # What it advises is right
    printer.run(f"G28\n{script}\nG28 Z\nAUTO_Z_CALIBRATE")
    sensor = scene.world.bed_sensor
    right = scene.number("auto_z_offset", "z_offset") - sensor.press_depth
    assert printer.gap(printer.bed_point()) == pytest.approx(right, abs=STEPS)
    assert wrong < right - 0.05


# The nozzle was 0.1 mm inside the bed in a print of walk 8573
@pytest.mark.parametrize("zero", ["150, 150", None])
def test_mesh_with_a_zero_where_a_switch_homes_z(start, zero):
    changes = {"z_calibration": None, **section(probe_z_correction="-0.34")}
    changes["bed_mesh"] = {"zero_reference_position": zero}
    printer = start(SWITCH, changes).homed()
    words = "the bed mesh has a zero of its own: the gap is wrong"
    assert bool(told(printer.session.console, words)) is bool(zero)
    assert not told(printer.run("AUTO_Z_LOAD_OFFSET"), words)
    lines = printer.run(f"{MESH}\nAUTO_Z_LOAD_OFFSET")
    assert bool(told(lines, words)) is bool(zero)


def test_homing_in_prepare_gcode_is_the_frame(start):
    code = f"G28 Z\n  {PREPARE}"
    printer = start("qidi", changes=section(prepare_gcode=code)).homed()
    printer.run("AUTO_Z_HOME_Z\nAUTO_Z_CALIBRATE")
    gap = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


def test_home_z_with_a_correction_in_force(start):
    # Z=0 would be 1.3 mm inside the bed
    printer = start("qidi").homed()
    printer.run("SET_GCODE_OFFSET Z=-1.12")
    text, before, after = before_and_after(printer, "AUTO_Z_HOME_Z")
    assert "with the G-code Z offset of -1.120 in force" in text
    assert "1.320 mm inside the bed at Z=0; run SET_GCODE_OFFSET" in text
    assert after == before
    printer.run("SET_GCODE_OFFSET Z=0\nAUTO_Z_HOME_Z")


def test_home_z_with_an_offset_that_does_no_harm(start):
    # Z=0 stays above where the sensor triggers
    printer = start("qidi", changes=section(z_offset="-0.3")).homed()
    printer.run("SET_GCODE_OFFSET Z=-0.1\nAUTO_Z_HOME_Z")
    assert "nozzle_bed" in sites(printer)
    assert printer.offset() == pytest.approx(-0.1)


def test_absurd_correction_is_not_saved(start):
    # It could not be read again
    printer = start("qidi", changes=section(z_offset="-9.5")).homed()
    text, before, after = before_and_after(printer)
    assert "a correction of -10.820 mm is none, 10 mm is the limit" in text
    assert after == before


# prepare_gcode


def test_prepare_gcode_that_turns_the_motors_off(start):
    changes = section(prepare_gcode=f"{PREPARE}\n  M84")
    printer = start("qidi", changes=changes).homed()
    text = printer.fail("AUTO_Z_CALIBRATE")
    assert "not homed any more after prepare_gcode: X, Y, Z; take M84" in text
    assert printer.session.state()[0] == "ready"


def test_prepare_gcode_that_moves_the_head_away(start):
    code = f"{PREPARE}\n  G90\n  G1 X30 Y40 Z8 F6000"
    printer = start("qidi", changes=section(prepare_gcode=code)).homed()
    printer.run(f"G90\nG1 X{POINT[0]} Y{POINT[1]} F6000")
    first = len(printer.machine.truth.touches)
    printer.run("AUTO_Z_PROBE")
    nozzle = [t for t in touches(printer, first) if t.site == "nozzle_bed"]
    assert nozzle
    for touch in nozzle:
        assert (touch.x, touch.y) == pytest.approx(POINT, abs=0.02)


def test_prepare_gcode_that_leaves_the_head_below(start):
    code = f"{PREPARE}\n  G90\n  G1 Z-1.2 F600"
    changes = section(prepare_gcode=code, probe_z_min="-1.1")
    printer = start("qidi", changes=changes).homed()
    # It is lifted before it travels, and so before it touches
    text = printer.fail("AUTO_Z_PROBE")
    assert "(stopped at z=-1.100)" in text


# The offset and what is saved


# Drivers


def writes(printer):
    """Number of register writes that both drivers have seen so far."""
    return {n: d.read(IFCNT) for n, d in printer.machine.drivers.items()}


# Writes of one command with one touch: the stepper_z1 driver changes its
# range, too (counted by test_writes_of_one_touch)
WRITES = {"z": 2, "z1": 4}


def test_writes_of_one_touch(start):
    printer = start("qidi").homed()
    seen = []
    for _ in range(3):
        before = writes(printer)
        printer.run("AUTO_Z_PROBE")
        after = writes(printer)
        seen.append({n: after[n] - before[n] for n in after})
    # A busy host may send one twice
    assert min(seen, key=lambda s: sum(s.values())) == WRITES


# Of each driver the first write that reduces and that restores it
@pytest.mark.parametrize(
    ("driver", "n"),
    all_slow_but(
        [("z", 0), ("z1", 2)],
        [(d, n) for d, count in WRITES.items() for n in range(count)],
    ),
)
def test_driver_that_does_not_answer(host, driver, n):
    with Printer(host, "qidi") as printer:
        printer.homed()
        before = state(printer)
        fault = Fault("tmc_change_lost", driver=driver, n=n + 1)
        printer.machine.break_down(fault)
        text = ""
        try:
            printer.run("AUTO_Z_PROBE")
        except GcodeError as error:
            text = str(error)
        after = state(printer)
        assert after["currents"] == before["currents"]
        assert after["max_accel"] == before["max_accel"]
        # Failing to reduce it ends the command, failing to restore it once
        # does not
        reducing = n < WRITES[driver] / 2
        assert bool(text) is reducing
        if reducing:
            assert "Unable to write tmc uart" in text
            assert after == before
        printer.session.wait(1.0)
        assert_lifted(printer)


def test_driver_that_never_answers_again(start):
    printer = start("qidi").homed()
    # The first change reduces the current
    fault = Fault("tmc_change_lost", driver="z", n=2, persistent=True)
    printer.machine.break_down(fault)
    text = printer.fail("AUTO_Z_PROBE")
    line = (
        "auto_z_offset: the current of stepper_z could not be set back:"
        " Unable to write tmc uart"
    )
    assert line in text
    assert "SET_TMC_CURRENT STEPPER=stepper_z CURRENT=0.79" in text
    assert told(printer.session.console, line)
    assert printer.machine.drivers["z"].current().run < 0.3
    # The other one is as it was
    assert printer.machine.drivers["z1"].current().run > 1.0


def test_first_error_stays_the_first(start):
    # No trigger down to there, then the driver does not answer any more
    changes = section(probe_z_min="-1.1")
    printer = start("qidi", changes=changes).homed()
    fault = Fault("tmc_change_lost", driver="z", n=2, persistent=True)
    printer.machine.break_down(fault)
    text = printer.fail("AUTO_Z_PROBE")
    assert text.startswith(
        "auto_z_offset: bed sensor: the switch did not answer"
    )
    assert told(printer.session.console, "stepper_z could not be set back")
    printer.session.wait(1.0)
    assert_lifted(printer)


DRIVER = """
class Driver:
    def __init__(self, config):
        self.calls = []
        self.fields = self.current_helper = self
        if config.getboolean("own_home_current"):
            self.req_home_current = 1.0
        self.printer = config.get_printer()
        gcode = self.printer.lookup_object("gcode")
        if config.getboolean("has_command"):
            gcode.register_mux_command(
                "SET_TMC_CURRENT", "STEPPER", "stepper_z", self.set_current
            )

    def lookup_register(self, name, default=None):
        return name if name == "globalscaler" else default

    def set_current(self, gcmd):
        toolhead = self.printer.lookup_object("toolhead")
        print_time = toolhead.get_last_move_time()
        self.calls.append((gcmd.get_float("CURRENT"), print_time))

    def get_status(self, eventtime):
        return {"run_current": 1.0, "calls": list(self.calls)}


def load_config(config):
    driver = Driver(config)
    config.get_printer().add_object("tmc5160 stepper_z", driver)
    return driver
"""


@pytest.mark.parametrize(
    ("own", "command", "calls"),
    [(False, True, [0.33, 1.0]), (True, True, []), (False, False, [])],
)
def test_driver_that_is_better_left_alone(start, tmp_path, own, command, calls):
    # A stand-in, as the simulated board has no SPI: Kalico's TMC5160 shuts the
    # printer down at small currents
    source = tmp_path / "stand_in.py"
    source.write_text(DRIVER)
    options = {"own_home_current": str(own), "has_command": str(command)}
    modules = {**module_files(), "stand_in": source}
    changes = {"stand_in": options}
    printer = start("piezo_cartesian", changes=changes, modules=modules)
    printer.homed()
    begun = []
    printer.machine.rig.on_steps.append(lambda ns: begun.append(ns / 1e9))
    print_time = printer.status("toolhead")["estimated_print_time"]
    ahead = print_time - printer.machine.simulation.clock.now() / 1e9
    printer.run("AUTO_Z_PROBE")
    assert "nozzle_bed" in sites(printer)
    found = printer.status("tmc5160 stepper_z")["calls"]
    assert [amps for amps, _ in found] == calls
    # It settles in 130 ms, says its data sheet
    for _, changed in found:
        later = [t + ahead for t in begun if t + ahead > changed]
        assert min(later) > changed + 0.13
    notes = told(printer.session.console, "z_current_factor has no effect")
    assert len(notes) == (0 if calls else 1)


# Other probes


def test_smart_effector(start):
    """It is right, and ends where a dead one would press the nozzle further."""
    # Told where Z is, as Kalico cannot home with it
    probe = dict(SCENES["qidi"].sections["probe"])
    changes = {
        "probe": None,
        "smart_effector": {**probe, "recovery_time": "0.1"},
        "force_move": {"enable_force_move": "true"},
        "safe_z_home": None,
        "stepper_z": {"endstop_pin": "^PC8", "position_endstop": "0"},
    }
    printer = start("qidi", changes=changes)
    printer.session.require_ready()
    x, y, z = SCENES["qidi"].start
    z -= 0.3130 + 1.2713
    printer.run(f"SET_KINEMATIC_POSITION X={x} Y={y} Z={z}\nG90\nG1 Z10 F900")
    printer.run("AUTO_Z_CALIBRATE")
    gap = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    printer.machine.break_down(Fault("trigger_never", site="inductive_bed"))
    text = printer.fail("AUTO_Z_CALIBRATE")
    assert "auto_z_offset: probe: No trigger" in text
    assert lowest(printer) <= ONE_TOUCH + STEPS


@pytest.mark.slow
@pytest.mark.every_host(
    "until 2024-07 and on Kalico it homes Z to position_endstop"
)
def test_smart_effector_that_homes_to_something_else(host, start):
    # Some hosts ask for position_endstop, and home Z to that; others refuse
    probe = dict(SCENES["qidi"].sections["probe"])
    changes = {
        "probe": None,
        "smart_effector": {**probe, "recovery_time": "0", "z_offset": "0.1"},
        "stepper_z": {"position_endstop": "-0.7"},
    }
    printer = start("qidi", changes=changes)
    kind, message = printer.session.start()
    if kind == "error":
        assert "'position_endstop' is not valid" in message
        pytest.skip(f"{host.name}: {message.splitlines()[0]}")
    printer.run("G28\nAUTO_Z_LOAD_OFFSET")
    # What it has set is the difference, and no correction
    text = printer.fail("AUTO_Z_SAVE_GCODE_OFFSET")
    assert "holds no correction, and none was saved" in text
    gap = printer.scene.piezo_gap()
    printer.run("AUTO_Z_CALIBRATE")
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    correction = printer.status("auto_z_offset")["probe_z_correction"]
    assert printer.offset() == pytest.approx(correction - 0.8, abs=1e-6)
    printer.run("SET_GCODE_OFFSET Z_ADJUST=0.05\nAUTO_Z_SAVE_GCODE_OFFSET")
    printer.session.restart("SAVE_CONFIG")
    lines = printer.run("G28\nAUTO_Z_LOAD_OFFSET")
    assert told(
        lines, "-0.800000 more, as position_endstop of section 'stepper_z'"
    )
    assert true_gap(printer) == pytest.approx(gap + 0.05, abs=STEPS)
    printer.run("AUTO_Z_CALIBRATE")
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


@pytest.mark.slow
@pytest.mark.every_host(
    "hosts take position_endstop of a probe, pass over it or refuse it"
)
def test_height_that_a_switch_has_left_is_none(start):
    """As Z_ENDSTOP_CALIBRATE had saved it: hosts pass over it and say nothing."""
    printer = start("qidi")
    printer.session.require_ready()
    saved_before(printer, "stepper_z", "position_endstop = -0.5")
    gap = printer.scene.piezo_gap()
    printer.homed().run("AUTO_Z_CALIBRATE")
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    printer.run("G28\nAUTO_Z_LOAD_OFFSET")
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


HIDDEN = """
class Hidden:  # Whose switch nobody sees
    def __init__(self, inner):
        self.__dict__.update(inner=inner)
    def __getattr__(self, name):
        if name in ("z_position", "probe_session", "mcu_probe"):
            raise AttributeError(name)
        return getattr(self.inner, name)
printer.objects["probe"] = Hidden(probe)
"""


def test_probe_that_cannot_be_told_where_to_end_is_refused(start, tmp_path):
    modules = with_extra(tmp_path, HIDDEN)
    printer = start("qidi", {"extra": {}}, modules=modules)
    kind, message = printer.session.start()
    assert kind == "error"
    assert "Internal error" not in message
    assert "Section 'probe' (Hidden): this probe cannot be told" in message
