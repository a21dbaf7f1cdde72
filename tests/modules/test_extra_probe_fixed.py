"""[extra_probe] with 'fixed: True': a switch beside the bed that only the nozzle presses.

Nothing is asked. The nozzle touches the switch, the probe the bed.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault, heated
from simprinter.world.spec import AxisSwitchSpec, PinSpec
from tests.modules.test_axis_twist import compensation
from tools.kit.cases import slow
from tools.kit.docks import DOCK_SCENES
from tools.kit.extra_probe import (
    BED_POINT,
    BESIDE,
    CALIBRATE,
    HEIGHT,
    MICROSTEP,
    NAME,
    fixed_switch,
    section,
    state,
)
from tools.kit.klipper_sections import bed_mesh, profile
from tools.kit.load_errors import load
from tools.kit.prints import of_card
from tools.kit.z_calibration import refusal

OVER = "G90\nG1 Z10 F900\nG1 X{} Y{} F6000".format(*BESIDE)
# Where the nozzle meets the bed after G28, as the probe's z_offset is wrong by that
WRONG = 2.0 - 2.2713
# More than a gap that is right, less than what is looked for
NEAR = 2.5 * MICROSTEP


def gap(printer):
    return printer.gap(BED_POINT)


def fails(printer, words, script=CALIBRATE):
    """It ends with these words; offset, status and saved values are as before."""
    printer.run("SET_GCODE_OFFSET Z=0.3")
    before = state(printer)
    text = printer.fail(script)
    assert text.startswith("extra_probe membrane: ")
    assert words in text
    assert state(printer) == before
    assert printer.session.state()[0] == "ready"
    printer.session.wait(2.0)
    assert printer.session.position()[2] >= 9.99
    return text


def test_right_in_one_command(start):
    printer = start(fixed_switch()).homed()
    lines = printer.run(CALIBRATE)
    # Nothing is asked
    assert not any("action:prompt" in line for line in lines)
    assert printer.status(NAME)["waits_for"] == ""
    assert printer.session.position()[2] == pytest.approx(10.0, abs=0.01)
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)
    assert printer.offset() == pytest.approx(WRONG, abs=0.02)
    assert printer.status(NAME)["last_offset"] == pytest.approx(
        printer.offset()
    )
    assert state(printer)["pending"] == {}
    told = [line for line in lines if f"{NAME}: trigger=" in line]
    assert (
        f"- switch_height=1.500 --> new offset={printer.offset():.6f}"
        in told[0]
    )
    # Neither was pressed hard
    assert printer.machine.truth.depth("nozzle_pin") < 0.1
    assert printer.machine.truth.deepest_in_bed() == 0.0


@pytest.mark.parametrize("height", [-0.5, slow(6.0)])
def test_switch_of_any_height(start, height):
    printer = start(fixed_switch(height)).homed()
    printer.run(CALIBRATE)
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)


def test_save(start):
    printer = start(fixed_switch()).homed()
    lines = printer.run(f"SET_GCODE_OFFSET Z=0.3\n{CALIBRATE} SAVE=1")
    assert printer.offset() == 0.0
    pending = state(printer)["pending"]
    assert list(pending) == ["probe"]
    assert float(pending["probe"]["z_offset"]) == pytest.approx(
        2.2713, abs=NEAR
    )
    assert "// Until then the G-code offset is 0." in lines
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert gap(printer) == pytest.approx(0.0, abs=0.02)
    # And again, on the way to a print
    printer.run(CALIBRATE)
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)


def test_what_the_button_saves_is_not_measured_next_time(start):
    printer = start(fixed_switch()).homed()
    printer.run(f"{CALIBRATE}\nSET_GCODE_OFFSET Z_ADJUST=-0.05 MOVE=1")
    lines = printer.run("Z_OFFSET_APPLY_PROBE")
    words = f"{CALIBRATE} measures without the -0.050 mm of baby steps that"
    (told,) = [line for line in lines if words in line]
    assert f"write switch_height: 1.550 into section '{NAME}'" in told
    printer.session.restart("SAVE_CONFIG")
    printer.run(f"G28\n{CALIBRATE}")
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)
    assert words not in "\n".join(printer.run("Z_OFFSET_APPLY_PROBE"))
    # What it names is right
    printer = start(fixed_switch(), section(switch_height="1.55")).homed()
    printer.run(CALIBRATE)
    assert gap(printer) == pytest.approx(-0.05, abs=NEAR)


def test_saved_height_does_not_depend_on_where_z_is(start):
    # The point of the bed is 0.1 mm lower for Klipper than G28 has found it
    changes = {"force_move": {"enable_force_move": "True"}}
    printer = start(fixed_switch(), changes=changes).homed()
    z = printer.session.position()[2]
    printer.run(f"SET_KINEMATIC_POSITION Z={z - 0.1:.6f}")
    printer.run(f"{CALIBRATE} SAVE=1")
    z_offset = state(printer)["pending"]["probe"]["z_offset"]
    assert float(z_offset) == pytest.approx(2.2713, abs=NEAR)


def test_difference_is_told(start):
    printer = start(fixed_switch()).homed()
    told = "the probe triggers 2.27"
    (line,) = [n for n in printer.run(CALIBRATE) if told in n]
    assert "its z_offset is 2.000: right after another nozzle, and SAVE=1" in (
        line
    )
    own = {"probe": {"z_offset": "2.2"}}
    printer = start(fixed_switch(), changes=own).homed()
    assert not any("the probe triggers" in n for n in printer.run(CALIBRATE))


@pytest.mark.parametrize("saves", [False, True])
def test_mesh_in_force_is_taken_off(start, saves):
    own = bed_mesh("20, 15", "180, 180")
    changes = {"bed_mesh": own, "bed_mesh default": profile([0.2] * 3, own)}
    printer = start(fixed_switch(), changes=changes).homed()
    printer.run("BED_MESH_PROFILE LOAD=default")
    lines = printer.run(f"{CALIBRATE} SAVE={saves:d}")
    assert any("110.0, 110.0, which the probe has" in line for line in lines)
    if saves:
        z_offset = state(printer)["pending"]["probe"]["z_offset"]
        assert float(z_offset) == pytest.approx(2.2713, abs=NEAR)
        return
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)


def test_zero_of_the_mesh_is_where_the_probe_touches(start):
    own = bed_mesh(
        "20, 15",
        "180, 180",
        zero_reference_position="{}, {}".format(*BED_POINT),
    )
    changes = {"bed_mesh": own, **section(bed_xy_position=None)}
    printer = start(fixed_switch(), changes=changes).homed()
    printer.run(f"BED_MESH_CALIBRATE\n{CALIBRATE}")
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)


def test_twist_is_in_what_is_saved(host, start):
    # Whether G28 takes it into account differs from host to host
    scene = fixed_switch()
    changes = compensation(host, scene, 0, 200, 0.1, 0.1)
    printer = start(scene, changes=changes).homed()
    printer.run(f"{CALIBRATE} SAVE=1")
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert gap(printer) == pytest.approx(0.0, abs=0.02)


def test_samples_of_the_probe(start):
    changes = {
        "probe": {
            "samples": "2",
            "samples_tolerance": "0.01",
            "samples_tolerance_retries": "1",
        }
    }
    printer = start(fixed_switch(), changes=changes).homed()
    printer.machine.break_down(
        Fault("trigger_early", site="inductive_bed", touch=1, mm=0.1)
    )
    lines = printer.run(CALIBRATE)
    told = f"// {NAME}: probe: "
    probe = [line for line in lines if line.startswith(told)]
    assert len(probe) == 5
    assert "samples_tolerance" in probe[2] and "trying again" in probe[2]
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)


def test_save_where_z_is_homed_on_a_switch(start):
    scene = fixed_switch()
    z0 = scene.world.bed.z0 - 0.45
    end = AxisSwitchSpec("z_endstop", "z", z0, -1)
    inputs = {**scene.wiring.inputs, "z_endstop": "^PC2"}
    scene = replace(
        scene, wiring=replace(scene.wiring, inputs=inputs)
    ).with_world(switches=(*scene.world.switches, end))
    z_axis = {"endstop_pin": "^PC2", "position_endstop": "0"}
    # The bed is 0.45 mm higher than the user says
    # Beside the bed
    changes = {"stepper_z": z_axis, "safe_z_home": None}
    printer = start(scene, changes=changes).homed()
    printer.run(f"{CALIBRATE} SAVE=1")
    pending = state(printer)["pending"]
    assert list(pending) == ["stepper_z"]
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert gap(printer) == pytest.approx(0.0, abs=0.02)


# The nozzle touches first, the probe afterwards, and the nozzle goes down next
def test_probe_that_docks(start):
    dock = DOCK_SCENES["dock_gantry"]
    place, over = (206.0, 306.0), (150.0, 150.0)
    inputs = {**dock.wiring.inputs, "nozzle_endstop": "^PF6"}
    own = {
        "pin": "^PF6",
        "fixed": "True",
        "switch_height": "1.5",
        "xy_position": "{}, {}".format(*place),
        "bed_xy_position": "{}, {}".format(*over),
    }
    scene = replace(
        dock,
        wiring=replace(dock.wiring, inputs=inputs),
        sections={**dock.sections, NAME: own},
    ).with_world(
        pin=PinSpec(*place, dock.world.bed.z0 + 1.5, signal="nozzle_endstop")
    )
    late = {"dockable_probe": {"allow_delayed_detach": "True"}}
    printer = start(scene, changes=late).homed()
    printer.run(f"ATTACH_PROBE\n{CALIBRATE}")
    status = printer.status("dockable_probe")
    assert status["last_status_name"] == "DOCKED"
    assert printer.gap(over) == pytest.approx(0.0, abs=NEAR)


# In a print


@pytest.mark.parametrize("saves", [False, True])
def test_in_a_print(start, tmp_path, saves):
    lines = ["G28", f"{CALIBRATE} SAVE={saves:d}", "M400"]
    printer = start(fixed_switch(), changes=of_card(tmp_path, lines))
    printer.session.require_ready()
    printer.run("SDCARD_PRINT_FILE FILENAME=print.gcode")
    printer.session.wait(90.0)
    if saves:
        told = "SAVE=1 would print with a G-code Z offset of 0; leave it out"
        assert any(told in line for line in printer.session.console)
        assert printer.offset() == 0.0
        return
    assert printer.status("print_stats")["state"] == "complete"
    assert gap(printer) == pytest.approx(0.0, abs=NEAR)


def test_hot_nozzle(start):
    printer = start(heated(fixed_switch())).homed()
    printer.run(f"M109 S160\n{CALIBRATE}")
    assert not any("may melt" in line for line in printer.session.console)
    own = section(max_temperature="150")
    printer = start(heated(fixed_switch()), changes=own).homed()
    printer.run("M109 S160")
    fails(printer, "C, max_temperature is 150 C; let it cool down")


# What goes wrong


def test_switch_that_does_not_answer(start):
    fault = Fault("stuck_open", signal="nozzle_endstop", t=0.0)
    printer = start(fixed_switch(), faults=[fault]).homed()
    printer.machine.tolerate("nozzle_pin", 2.0)
    text = fails(printer, "the switch did not answer (stopped at z=0.500)")
    assert text.endswith(
        "; press it by hand and look with QUERY_EXTRA_PROBE PROBE=membrane, or"
        " check xy_position and switch_height, or where the switch may be lower set"
        " position_min"
    )
    # Homed 0.27 mm too high
    depth = printer.machine.truth.depth("nozzle_pin")
    assert depth == pytest.approx(1.0 + WRONG, abs=0.02)


@pytest.mark.parametrize(
    ("own", "params", "z"),
    [({"position_min": "1.0"}, "", 1.0), ({}, " FLOOR=0.8", 0.8)],
)
def test_lowest_point_that_is_given(start, own, params, z):
    fault = Fault("stuck_open", signal="nozzle_endstop", t=0.0)
    printer = start(
        fixed_switch(), changes=section(**own), faults=[fault]
    ).homed()
    printer.machine.tolerate("nozzle_pin", 2.0)
    fails(printer, f"(stopped at z={z:.3f})", CALIBRATE + params)


def test_switch_that_reads_triggered(start):
    fault = Fault("stuck_closed", signal="nozzle_endstop", t=0.0)
    printer = start(fixed_switch(), faults=[fault]).homed()
    fails(printer, "the switch reads triggered before it is touched; check it")


def test_height_that_is_wrong(start):
    # As if something lay on the switch
    printer = start(
        fixed_switch(4.0), changes=section(switch_height="2")
    ).homed()
    text = fails(
        printer, "switch_height is 2.000, so the bed would be at z=1.7"
    )
    assert (
        "over 1 mm from Z=0; check switch_height, that nothing lies on" in text
    )


def test_probe_that_does_not_answer(start):
    printer = start(fixed_switch()).homed()
    printer.machine.break_down(
        Fault("trigger_never", site="inductive_bed", touch=1)
    )
    text = fails(printer, "probe: ")
    assert "where the nozzle meets the bed, by what the switch says" in text
    assert text.endswith("; check the probe with QUERY_PROBE and PROBE")
    assert printer.machine.truth.depth("nozzle_bed") < 0.02


def test_probe_that_reads_triggered(start):
    # It has not gone down to the bed, and nothing is said of that
    printer = start(fixed_switch()).homed()
    printer.machine.break_down(
        Fault("stuck_closed", site="inductive_bed", touch=1)
    )
    text = fails(printer, "probe: ")
    assert "the lowest point of this touch" not in text


def test_something_that_lies_on_the_bed(start):
    printer = start(fixed_switch()).homed()
    printer.machine.break_down(
        Fault("trigger_early", site="inductive_bed", touch=1, mm=1.5)
    )
    text = fails(printer, "the probe triggers 3.77")
    assert "its z_offset is 2.000: over 1 mm apart; check that nothing" in text


# EXTRA_PROBE at such a switch


def test_measure_its_height(start):
    # As the document has it: Z=0 is the bed, by paper
    own = {"probe": {"z_offset": "2.2713"}, **section(switch_height=None)}
    printer = start(fixed_switch(), changes=own).homed()
    told = f"// {NAME}: there is no switch_height; set it to how far above"
    assert any(line.startswith(told) for line in printer.session.console)
    text = printer.fail(CALIBRATE)
    assert "there is no switch_height; set it to how far above the bed" in text
    lines = printer.run(f"{OVER}\nEXTRA_PROBE PROBE=membrane")
    assert printer.status(NAME)["last_z_result"] == pytest.approx(
        HEIGHT, abs=0.02
    )
    assert any("Result is z=1." in line for line in lines)


@pytest.mark.parametrize("command", ["EXTRA_PROBE", "EXTRA_PROBE_ACCURACY"])
def test_only_over_the_switch(start, command):
    printer = start(fixed_switch(-0.5)).homed()
    printer.run(f"{OVER}\n{command} PROBE=membrane")
    printer.run("G1 Z10\nG1 X20 Y60 F6000")
    text = printer.fail(f"{command} PROBE=membrane")
    assert "the nozzle is 28.0 mm from the switch at xy_position -8, 60" in text
    assert printer.machine.truth.deepest_in_bed() == 0.0


def test_lowest_point_over_the_switch(start):
    fault = Fault("stuck_open", signal="nozzle_endstop", t=0.0)
    printer = start(fixed_switch(), faults=[fault]).homed()
    printer.machine.tolerate("nozzle_pin", 2.0)
    text = printer.fail(f"{OVER}\nEXTRA_PROBE PROBE=membrane")
    assert "(stopped at z=0.500)" in text
    assert "or check xy_position and switch_height, or where the switch" in text


# Wrong set-ups


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            section(xy_position=None),
            "needs xy_position: X, Y of the toolhead when",
        ),
        (
            section(bed_xy_position=None),
            "needs bed_xy_position, the point of the bed that the probe is to",
        ),
        (
            section(bed_xy_position="240, 110"),
            "Option 'bed_xy_position: 240,110' in section",
        ),
        (
            section(switch_height="-4"),
            "is below the -3.000 that Z goes down to",
        ),
        (
            section(safe_z_height="3.9"),
            "is not 2 mm above the switch, and above where the probe triggers;"
            " set it to 4 or more",
        ),
        (
            {
                **section(switch_height="-0.5", xy_position="50, 60"),
                "bed_mesh": bed_mesh("20, 15", "180, 180"),
            },
            "says that the switch is lower than the bed, but xy_position 50, 60",
        ),
        (
            section(fixed=None),
            "Option 'switch_height: 1.5' in section 'extra_probe membrane' is for",
        ),
        (
            section(z_offset="0.25"),
            "is the thickness of a switch that lies on the bed; with 'fixed: True'",
        ),
        (
            {
                "probe": None,
                "safe_z_home": None,
                "stepper_z": {"endstop_pin": "^PF0", "position_endstop": "0"},
            },
            "needs a [probe] that touches the bed with a switch on a pin",
        ),
    ],
)
def test_set_up_that_cannot_work(host, changes, words):
    message = refusal(host, changes, fixed_switch())
    assert words in message
    assert "extra_probe membrane" in message


def test_switch_that_stands_above_the_bed_is_no_mistake(host):
    changes = {
        **section(switch_height="0.5", xy_position="50, 60"),
        "bed_mesh": bed_mesh("20, 15", "180, 180"),
    }
    assert load(host, changes, fixed_switch())[0] == "ready"


def test_probe_cannot_be_the_switch(host):
    scene = fixed_switch()
    sections = dict(scene.sections)
    own = sections.pop(NAME)
    del own["pin"]
    probe = {**sections["probe"], "x_offset": "0", "y_offset": "0"}
    sections = {**sections, "extra_probe probe": own, "probe": probe}
    sections["stepper_z"] = {
        **sections["stepper_z"],
        "endstop_pin": "^PF6",
        "position_endstop": "0",
    }
    del sections["safe_z_home"]
    message = refusal(host, {}, replace(scene, sections=sections))
    assert "[probe] is the switch there, and nothing is left" in message
