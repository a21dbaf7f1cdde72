"""Ordinary commands in ordinary orders around a dock: nothing is hit."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest

from simprinter.hosts.session import GcodeError
from tests.modules.test_z_calibration_features import Frame
from tools.campaign.drawn.machines import BASES, overridden
from tools.kit.carrying import QUICK, pressed, with_all
from tools.kit.carrying import SWITCH as WITH_ALL
from tools.kit.cases import all_slow_but, slow
from tools.kit.dock_owner import UNKNOWN
from tools.kit.dockable_probe import FORCE, down_by_force, trips, where
from tools.kit.docks import DOCK_SCENES
from tools.kit.klipper_sections import bed_mesh, profile
from tools.kit.printer import firmware_of

OVER = "G90\nG1 Z20 F900\nG1 X150 Y150 F6000"
STAYS = {"restore_toolhead": "False"}
SCREWS = {
    "bed_screws": {
        "screw1": "15, 270",
        "screw2": "240, 30",
        "screw3": "60, 30",
        "speed": "100",
    }
}
MESH = bed_mesh("40, 40", "250, 250")
INTO = "MOVE_TO_DOCK_PROBE"
TWIST = "AXIS_TWIST_COMPENSATION_CALIBRATE"
BY_HAND = "BED_MESH_CALIBRATE METHOD=manual"
AROUND = "MOVE_AVOIDING_DOCK X=20 Y=300 SPEED=100"
# The machine, options of the dock, and what is done
ORDERS = {
    "G28 Z from the dock": ("dock_near_pin", {}, [INTO, "G28 Z"]),
    "Z_TILT_ADJUST from detach_position": (
        "dock_frame",
        {},
        ["MOVE_TO_DETACH_PROBE", "Z_TILT_ADJUST"],
    ),
    "twist from detach_position": (
        "dock_frame",
        {},
        ["MOVE_TO_DETACH_PROBE", TWIST],
    ),
    "a mesh by hand from the dock": ("dock_frame", {}, [INTO, BY_HAND]),
    "into the way of a servo": (
        "dock_servo",
        {},
        ["G1 X60 Y300 F6000", "ATTACH_PROBE"],
    ),
    "into the way of a servo, to dock": (
        "dock_servo",
        {},
        ["ATTACH_PROBE", "G1 X60 Y300 F6000", "DETACH_PROBE"],
    ),
    "twist over a dock": ("dock_above", STAYS, ["PROBE", TWIST]),
    "a mesh by hand over a dock": ("dock_above", STAYS, ["PROBE", BY_HAND]),
    "twist from approach_position over a dock": (
        "dock_above",
        {},
        ["MOVE_TO_APPROACH_PROBE", TWIST],
    ),
    "a servo that was left out": (
        "dock_servo",
        {},
        ["PROBE", INTO, AROUND, "G28"],
    ),
    "screws across the dock": (
        "dock_gantry",
        STAYS,
        ["PROBE", "BED_SCREWS_ADJUST"],
    ),
    "a mesh from over the dock": (
        "dock_above",
        STAYS,
        ["ATTACH_PROBE", "BED_MESH_CALIBRATE"],
    ),
    "EXTRA_PROBE_CALIBRATE from the dock": (
        "dock_gantry_switch",
        {},
        [INTO, "EXTRA_PROBE_CALIBRATE PROBE=membrane"],
    ),
    "a probe that is on, from detach_position": (
        "dock_frame",
        {},
        ["ATTACH_PROBE", "MOVE_TO_DETACH_PROBE", "Z_TILT_ADJUST"],
    ),
    "the same without trips": (
        "dock_frame",
        {},
        [
            "ATTACH_PROBE",
            "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0",
            "MOVE_TO_DETACH_PROBE",
            "Z_TILT_ADJUST",
        ],
    ),
    "G28 from beside the dock": ("dock_gantry", {}, [AROUND, "G28"]),
    "CALIBRATE_Z from the dock": (
        "dock_gantry_switch",
        {},
        [INTO, "CALIBRATE_Z"],
    ),
}
USUAL = ("G28 Z from the dock", "into the way of a servo")


def seen(printer):
    """What any command of these changes something of."""
    truth = printer.machine.truth
    console = len(printer.session.console)
    counts = (len(truth.touches), len(truth.events), console)
    return printer.session.position(), counts


@pytest.mark.parametrize(
    "order", [order if order in USUAL else slow(order) for order in ORDERS]
)
def test_nothing_is_hit(start, order):
    base, options, scripts = ORDERS[order]
    changes = {"dockable_probe": {**QUICK, **options}, **SCREWS}
    printer = start(BASES[base], changes).homed()
    printer.run(OVER)
    for script in scripts:
        before = seen(printer)
        printer.run(script)
        assert script.startswith("SET_") or seen(printer) != before, script
    printer.run("M400")
    printer.session.wait(2.0)
    printer.machine.truth.require_no_crash()
    assert pressed(printer) < 0.1


def over_bed(start, changes=None, scene="dock_gantry", **options):
    """A homed printer with a dock, its toolhead over the middle of the bed."""
    own = {"dockable_probe": {**QUICK, **options}, **(changes or {})}
    printer = start(DOCK_SCENES[scene], own).homed()
    printer.run(OVER)
    return printer


TRIPS = "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH={}"
FIRST_LAYER = "G90\nG1 Z0.3 F600\nG1 X200 Y150 F3000\nG1 X100\n"
PRINT = "SDCARD_PRINT_FILE FILENAME=a.gcode"


def with_card(start, folder, lines, changes=None, **options):
    """A printer with a dock, and a card with one file."""
    (folder / "a.gcode").write_text(lines)
    own = {
        "dockable_probe": {**QUICK, **options},
        "virtual_sdcard": {"path": str(folder)},
        "pause_resume": {},
    }
    return start(DOCK_SCENES["dock_gantry"], {**own, **(changes or {})})


def require_printed(printer):
    """Until it is printed: nothing was hit, and the probe is in the dock."""
    printer.session.wait(120)
    assert printer.status("print_stats")["state"] == "complete"
    printer.machine.truth.require_no_crash()
    assert where(printer) == "docked"


# A first layer may come at once
def test_docking_is_not_delayed_in_a_print(start, tmp_path):
    options = {"allow_delayed_detach": "True"}
    printer = with_card(start, tmp_path, "PROBE\nPROBE\n", **options).homed()
    printer.run(OVER)
    printer.session.wait(5.0)
    assert trips(printer) == ["attach", "dock"]
    printer.run(PRINT)
    require_printed(printer)
    assert trips(printer) == ["attach", "dock"] * 3


# What leaves the probe on the toolhead, the file, and allow_delayed_detach
LEFT_ON = {
    "forgotten": ("ATTACH_PROBE", FIRST_LAYER, "False"),
    "forgotten, motors off": (
        "ATTACH_PROBE\nM84",
        f"G28\n{FIRST_LAYER}",
        "False",
    ),
    "forgotten before homing": ("ATTACH_PROBE", f"G28\n{FIRST_LAYER}", "False"),
    "to be docked in a while": ("PROBE", FIRST_LAYER, "True"),
}


TOLD = "the probe may be on the toolhead (pin reads open), and may meet"


@pytest.mark.parametrize(
    "left_on", all_slow_but(["forgotten", "forgotten, motors off"], LEFT_ON)
)
def test_print_does_not_begin_with_the_probe(start, tmp_path, left_on):
    before, lines, delayed = LEFT_ON[left_on]
    printer = with_card(start, tmp_path, lines, allow_delayed_detach=delayed)
    printer.homed().run(f"{OVER}\n{before}")
    assert where(printer) == "attached"
    printer.run(PRINT)
    if delayed == "False":
        # Whoever has fetched it to stay is told how to go on
        printer.session.wait(60)
        assert printer.status("print_stats")["state"] == "error"
        assert f"{TOLD} the bed from z=7.900 on" in "\n".join(
            printer.session.console
        )
        assert where(printer) == "attached"
        printer.machine.truth.require_no_crash()
        printer.run(f"{OVER}\nDETACH_PROBE\n{PRINT}")
    require_printed(printer)
    # It was where the file says
    assert printer.machine.truth.min_gap == pytest.approx(0.3, abs=0.05)


# A macro that goes back to the print before it runs the command, and a print that is
# higher than the probe is long
RESUMES = {
    "plain": {},
    "macro": {
        "gcode_macro RESUME": {
            "rename_existing": "BASE_RESUME",
            "gcode": "\n  RESTORE_GCODE_STATE NAME=PAUSE_STATE MOVE=1"
            "\n  BASE_RESUME",
        }
    },
}


# Higher than the probe is long there is what was printed
@pytest.mark.parametrize("z", [0.3, slow(40)])
@pytest.mark.parametrize("resume", RESUMES)
def test_print_does_not_go_on_with_the_probe(start, tmp_path, resume, z):
    lines = f"{FIRST_LAYER}G1 Z{z}\nG4 P2000\nPAUSE\nG1 X120\n"
    printer = with_card(start, tmp_path, lines, RESUMES[resume])
    printer.homed().run(f"{OVER}\n{PRINT}")
    printer.session.wait(30)
    assert printer.status("print_stats")["state"] == "paused"
    printer.run("G90\nG1 Z60 F900\nG1 X150 Y150 F6000\nM400")
    put_on(printer)
    for _ in range(2):
        text = printer.fail("RESUME")
        assert f"{TOLD} what is printed on the way down to z={z:.3f}" in text
        assert text.endswith("run DETACH_PROBE first")
        assert printer.session.position()[2] == pytest.approx(60)
        assert printer.status("print_stats")["state"] == "paused"
    printer.run("DETACH_PROBE\nRESUME")
    require_printed(printer)
    assert printer.session.position()[2] == pytest.approx(z)


def put_on(printer):
    """By hand, and say so."""
    printer.machine.world.put_probe_on(printer.now())
    printer.run("SET_PROBE_STATUS STATE=ATTACHED")


# It would be on the toolhead when the print goes on; a trip goes down at a low dock.
# ATTACH_PROBE and PROBE are in test_z_touch_refusals.py.
def test_probe_is_not_fetched_while_a_print_is_paused(start, tmp_path):
    lines = "G90\nG1 Z40 F900\nG4 P2000\nPAUSE\nG1 X120\n"
    printer = with_card(start, tmp_path, lines).homed()
    printer.run(f"{OVER}\n{PRINT}")
    printer.session.wait(30)
    before, begun = printer.session.position(), len(trips(printer))
    assert printer.fail("G28 Z") == (
        "dockable_probe: a print is paused, and the toolhead would go across it;"
        " end it first (CANCEL_PRINT)"
    )
    assert printer.session.position() == pytest.approx(before)
    assert trips(printer, begun) == []
    # What somebody has put on, and perhaps taken off again, may be docked
    put_on(printer)
    printer.machine.world.take_probe_off(printer.now())
    printer.run("DETACH_PROBE")
    assert trips(printer)[-2:] == ["attach", "dock"]
    printer.run("RESUME")
    require_printed(printer)


# Sent line by line, or by a macro, there is no print that the host knows of
def test_macro_goes_down_before_the_probe_is_docked(start):
    # G-code of the dock's begins from where the toolhead is
    macro = "".join(f"\n  {line}" for line in FIRST_LAYER.splitlines())
    printer = over_bed(
        start,
        {"gcode_macro LINES": {"gcode": f"\n  PROBE{macro}"}},
        allow_delayed_detach="True",
        pre_detach_gcode="G1 X160",
    )
    printer.run("LINES\nM400")
    printer.machine.truth.require_no_crash()
    assert where(printer) == "docked"
    assert printer.session.position()[:3] == pytest.approx([100, 150, 0.3])
    # It goes on from where it is
    printer.run("G91\nG1 X5 Z5\nM400")
    assert printer.session.position()[:3] == pytest.approx([105, 150, 5.3])


# What goes down with it may be in the middle of anything, and goes on so
def test_own_gcode_of_a_trip_meets_no_mode_and_leaves_none(start):
    lines = ("PROBE", "M220 S50", "G91", "M83", "G1 Z-5 F6000", "G1 X-40")
    macro = "".join(f"\n  {line}" for line in lines)
    printer = over_bed(
        start,
        {"gcode_macro LINES": {"gcode": macro}},
        allow_delayed_detach="True",
        pre_detach_gcode="\n  M82\n  G1 X160 F1200",
    )
    printer.run("LINES\nM400")
    assert where(printer) == "docked"
    assert printer.session.position()[0] == pytest.approx(110)
    status = printer.status("gcode_move")
    assert status["speed"] == pytest.approx(6000)
    assert not status["absolute_coordinates"]
    assert not status["absolute_extrude"]


# What takes the toolhead down, with a probe that was fetched to stay
DOWN = {
    "G1": "G1 Z5",
    "G91": "G91\nG1 Z-15",
    "arc": "G2 X150 Y150 I10 J0 Z5",
    "state": "G1 X160\nRESTORE_GCODE_STATE NAME=low MOVE=1",
    "offset": "SET_GCODE_OFFSET Z=-15 MOVE=1",
}


@pytest.mark.parametrize("down", all_slow_but(["G1", "state"], DOWN))
def test_probe_that_is_kept_is_not_taken_down(start, down):
    printer = over_bed(start, {"gcode_arcs": {}})
    printer.run("G1 Z5\nSAVE_GCODE_STATE NAME=low\nG1 Z20\nATTACH_PROBE")
    before = printer.session.position()
    text = printer.fail(DOWN[down])
    assert (
        "dockable_probe: the probe may be on the toolhead (pin reads open), and"
        in text
    )
    assert text.endswith("run DETACH_PROBE first")
    if down != "arc":
        assert printer.session.position()[2] == pytest.approx(before[2])
    printer.machine.truth.require_no_crash()
    assert where(printer) == "attached"


# A question of which nobody minds any more; another dock may be where it has been put
@pytest.mark.parametrize(
    "forgets", ["ATTACH_PROBE", slow("ATTACH_PROBE\nG28 Z")]
)
def test_no_lower_while_somebody_is_asked(start, forgets):
    printer = over_bed(start)
    printer.run(f"DOCKABLE_PROBE_SETUP\n{forgets}")
    printer.fail(FIRST_LAYER)
    assert where(printer) == "attached"
    printer.machine.truth.require_no_crash()


# Two pins say that it is in the dock
def test_probe_that_somebody_has_taken_off(start):
    printer = over_bed(start, scene="dock_sensed")
    printer.run("ATTACH_PROBE")
    assert where(printer) == "attached"
    printer.machine.world.take_probe_off(printer.now())
    before = trips(printer)
    begun = printer.now()
    lines = "".join(f"G1 X{100 + i} Z{5 - i / 100} F6000\n" for i in range(100))
    printer.run(f"G1 Z5\n{lines}M400")
    assert printer.session.position()[2] == pytest.approx(4.01)
    assert trips(printer) == before
    # Nobody waits for the pins at each move
    assert printer.now() - begun < 10.0


# A dock that is put away, by the owner's G-code
def test_own_gcode_of_a_trip_goes_where_it_likes(start):
    lines = """
      {% if 'z' in printer.toolhead.homed_axes %}
        G90
        G1 X250 Y305 F6000
        G1 Z5 F900
        G1 Z20
      {% endif %}
    """
    printer = over_bed(start, post_attach_gcode=lines)
    printer.run("ATTACH_PROBE")
    assert where(printer) == "attached"
    printer.machine.truth.require_no_crash()


# What goes up, or stays as high, is no way down, whatever lies between G-code and head
@pytest.mark.parametrize("skew", ["", "SET_SKEW XY=100.4,99.6,70.71"])
def test_probe_that_is_low_may_go_up(start, skew):
    printer = over_bed(start, {"skew_correction": {}, **FORCE})
    printer.run(f"ATTACH_PROBE\n{down_by_force(7.6)}\n{skew}")
    printer.run("G1 Z7.7\nG1 X151\nG1 X152 Z7.8\nM400")
    assert printer.session.position()[2] == pytest.approx(7.8)
    printer.fail("G1 Z7.7")
    assert where(printer) == "attached"


# Others come in front of what looks at moves, and remember what was there before them
OTHERS = {
    "exclude_object": (
        {"exclude_object": {}},
        "EXCLUDE_OBJECT_DEFINE NAME=a CENTER=10,10"
        " POLYGON=[[5,5],[5,15],[15,15],[15,5]]\nEXCLUDE_OBJECT_START NAME=a"
        "\nEXCLUDE_OBJECT_END NAME=a",
        "EXCLUDE_OBJECT_DEFINE RESET=1",
    ),
    "tuning_tower": (
        {},
        "TUNING_TOWER COMMAND=M220 PARAMETER=S START=100 FACTOR=0",
        "TUNING_TOWER COMMAND=M220 PARAMETER=S START=90 FACTOR=0",
    ),
    "skew": ({"skew_correction": {}}, "SET_SKEW XY=141.42,141.42,100", ""),
    "tilt": ({"bed_mesh": None, "bed_tilt": {"z_adjust": "0.5"}}, "", ""),
}


@pytest.mark.parametrize("other", all_slow_but(["exclude_object"], OTHERS))
def test_way_down_is_looked_at_behind_others(start, other):
    sections, begin, end = OTHERS[other]
    printer = over_bed(start, sections)
    printer.run(f"{begin}\nATTACH_PROBE")
    for script in ("G1 X160", end, "G1 X170"):
        printer.run(script)
        assert TOLD in printer.fail("G1 Z5")
        assert printer.session.position()[2] == pytest.approx(20, abs=1)
    printer.run("DETACH_PROBE\nG1 Z5\nG1 X150\nM400")
    tilt = 0.5 if other == "tilt" else 0.0
    assert printer.session.position() == pytest.approx((150, 150, 5 + tilt))
    assert where(printer) == "docked"
    printer.machine.truth.require_no_crash()


# It moves Z by what the frame has grown, with each move and between them
@pytest.mark.slow
def test_way_down_with_a_frame_that_grows(start, tmp_path):
    frame = Frame(tmp_path)
    changes = {"dockable_probe": QUICK, **frame.section()}
    printer = start(DOCK_SCENES["dock_gantry"], changes)
    printer.session.require_ready()
    printer.session.wait(30.0)
    printer.homed()
    printer.run(f"{OVER}\nATTACH_PROBE\nG1 X160\nM400")
    cold = printer.session.position()[2]
    frame.heat(printer, 75.0)
    # By as much no lower: no way down
    printer.run("G1 X170\nG1 X180\nM400")
    assert printer.session.position()[2] == pytest.approx(cold - 0.1, abs=0.01)
    assert TOLD in printer.fail("G1 Z5")
    assert printer.session.position()[2] == pytest.approx(cold - 0.1, abs=0.01)
    frame.heat(printer, 25.0)
    printer.run("G1 X160\nM400")
    assert printer.session.position()[2] == pytest.approx(cold, abs=0.01)
    assert TOLD in printer.fail("G1 Z5")
    printer.run("DETACH_PROBE\nG1 Z5\nM400")
    assert printer.session.position()[2] == pytest.approx(cold - 15.0, abs=0.01)
    assert where(printer) == "docked"
    printer.machine.truth.require_no_crash()


# What has probed leaves the toolhead as high as that; and a mesh lifts it
@pytest.mark.parametrize("retract", ["0.5", "1", "2"])
def test_head_goes_on_from_where_it_has_probed(start, retract):
    mesh = {"bed_mesh": MESH, "bed_mesh default": profile((0.3,) * 3, MESH)}
    printer = over_bed(start, mesh, sample_retract_dist=retract)
    printer.run(f"BED_MESH_PROFILE LOAD=default\n{OVER}\nATTACH_PROBE\nPROBE")
    printer.run("G1 X100 Y100\nG1 Z20\nG1 Z7.7\nM400")
    assert printer.session.position()[2] == pytest.approx(8.0, abs=0.01)
    printer.fail("G1 Z7.5")
    assert where(printer) == "attached"


OVERRIDE = """
  G90
  G0 Z5 F600
  G28 X Y
  G0 X150 Y150 F3600
  G28 Z
"""
# How owners home, with a Z that nobody knows yet
HOMES = {
    "homing_override": {
        "homing_override": {
            "axes": "z",
            "set_position_z": "0",
            "gcode": OVERRIDE,
        },
        "safe_z_home": None,
    },
    "macro": {
        "gcode_macro G28": {
            "rename_existing": "G28.1",
            "gcode": "\n  {% if printer.toolhead.homed_axes %}"
            "\n  G91\n  G1 Z5 F600\n  G90\n  {% endif %}\n  G28.1",
        }
    },
}


@pytest.mark.parametrize("homes", all_slow_but(["homing_override"], HOMES))
@pytest.mark.parametrize("auto", [1, slow(0)])
def test_owners_home_in_their_own_way(start, homes, auto):
    printer = over_bed(start, HOMES[homes])
    printer.run(f"{TRIPS.format(auto)}\nATTACH_PROBE\nG28\nG1 Z20")
    assert where(printer) == "attached"
    printer.fail("G1 Z5")


# Such as to a brush behind the bed
def test_own_gcode_of_a_calibration_goes_where_it_likes(start):
    lines = "\n  G90\n  G1 X200 Y308 F6000\n  G1 Z5 F900\n  G1 Z20"
    own = {"before_switch_gcode": lines, "start_gcode": "ATTACH_PROBE"}
    changes = {"dockable_probe": QUICK, "z_calibration": own}
    printer = start(WITH_ALL, changes).homed()
    assert "new offset=" in "\n".join(printer.run("CALIBRATE_Z"))
    printer.machine.truth.require_no_crash()


# While somebody brings it to its dock, and where no dock is known
def test_probe_is_taken_down_by_hand(start):
    printer = over_bed(start)
    printer.run("ATTACH_PROBE\nG1 X250 Y305\nDOCKABLE_PROBE_SETUP")
    printer.run("G1 Z5\nG1 Z20\nDOCKABLE_PROBE_SETUP STEP=ABORT\nM400")
    printer.fail("G1 Z5")
    assert where(printer) == "attached"


def test_nobody_knows_of_a_dock(start):
    printer = over_bed(start, scene="dock_gantry_switch", **UNKNOWN)
    printer.run("G1 X20 Y305")
    printer.machine.hold("probe", False)
    printer.run("SET_PROBE_STATUS STATE=ATTACHED")
    status = printer.status("dockable_probe")
    assert status["last_status_name"] == "ATTACHED"
    printer.run("G1 Z5\nM400")
    assert printer.session.position()[2] == pytest.approx(5.0)


# What looks at a probe that no trip has attached, as after a restart
LOOKS = {
    "G28": "",
    "GET_PROBE_STATUS": "GET_PROBE_STATUS",
    "set-up": "DOCKABLE_PROBE_SETUP\nDOCKABLE_PROBE_SETUP STEP=ABORT",
}


@pytest.mark.parametrize("looks", LOOKS)
def test_probe_that_is_on_by_hand_is_not_taken_down(start, looks):
    own = {**QUICK, "detach_dockable_before_z_home": "False"}
    changes = {"dockable_probe": own}
    printer = start(DOCK_SCENES["dock_gantry_switch"], changes)
    world = printer.machine.world
    printer.session.require_ready()
    if looks == "G28":
        world.put_probe_on(printer.now())
    printer.run(f"G28\n{OVER}\nM400")
    if looks != "G28":
        world.put_probe_on(printer.now())
    printer.run(LOOKS[looks])
    assert f"{TOLD} the bed" in printer.fail(FIRST_LAYER)
    printer.machine.truth.require_no_crash()
    assert where(printer) == "attached"
    # In its dock by hand, too, it is as it was before
    world.take_probe_off(printer.now())
    printer.run(f"GET_PROBE_STATUS\n{FIRST_LAYER}M400")
    assert printer.session.position()[2] == pytest.approx(0.3)


# Nobody can dock it without trips, and the dock has its own height
def test_where_the_probe_may_be_low(start):
    printer = over_bed(start)
    printer.run(f"{TRIPS.format(0)}\nATTACH_PROBE")
    printer.fail("G1 Z5")
    printer.run("G1 X155\nMOVE_TO_DOCK_PROBE")
    # Out of it and down at once
    printer.fail("G1 X50 Y200 Z5")
    printer.run("G1 Z6\nG1 Z5\nM400")
    assert printer.session.position()[2] == pytest.approx(5.0)
    for place in ("approach_position", "insert_position", "detach_position"):
        where_to = DOCK_SCENES["dock_gantry"].sections["dockable_probe"]
        x, y = (where_to.get(place) or where_to["approach_position"]).split(",")
        printer.run(f"G1 Z20\nG1 X{x} Y{y}\nG1 Z7.8\nG1 Z20")
    assert where(printer) == "attached"


# The circle around the dock reaches over the bed
@pytest.mark.parametrize("auto", [1, 0])
def test_print_below_the_dock(start, tmp_path, auto):
    lines = "G90\nG1 X50 Y272 F6000\nG1 Z0.3 F600\nG1 X80\n"
    printer = with_card(start, tmp_path, lines).homed()
    printer.run(f"{OVER}\nATTACH_PROBE\n{TRIPS.format(auto)}")
    printer.run(PRINT)
    printer.session.wait(20)
    assert printer.status("print_stats")["state"] == "error"
    printer.machine.truth.require_no_crash()
    assert where(printer) == "attached"


# So it is without a print that the host knows of; the owner's macros may go there
@pytest.mark.parametrize("auto", [1, slow(0)])
def test_circle_around_the_dock_is_no_place_to_go_down(start, auto):
    printer = over_bed(start)
    printer.run(f"ATTACH_PROBE\nG1 X50 Y275\n{TRIPS.format(auto)}")
    if auto:
        assert f"{TOLD} the bed" in printer.fail("G1 Z7")
    else:
        printer.run("G1 Z7\nM400")
    printer.machine.truth.require_no_crash()


# Down, in, and out: to the positions, and nowhere else
DOCKS_ITSELF = "G1 X50 Y270 F6000\nG1 Z7.8\nG1 Y308\nG1 X90\nG1 Z20\n"


@pytest.mark.parametrize("auto", [0, slow(1)])
def test_macros_of_a_print_dock_without_trips(start, tmp_path, auto):
    told = "SET_PROBE_STATUS STATE=DOCKED\n"
    lines = f"G90\nG1 Z20 F900\n{DOCKS_ITSELF}{told}G1 X150 Y150\n{FIRST_LAYER}"
    printer = with_card(start, tmp_path, lines).homed()
    printer.run(f"{OVER}\nATTACH_PROBE\n{TRIPS.format(auto)}\n{PRINT}")
    if not auto:
        require_printed(printer)
        return
    printer.session.wait(20)
    assert printer.status("print_stats")["state"] == "error"
    assert where(printer) == "attached"


# What has gone down at the dock would be dragged over the bed from there
@pytest.mark.parametrize(
    ("auto", "place"),
    [(1, "X50 Y270"), (0, "X60 Y275"), slow(0, "X50 Y270")],
)
def test_probe_that_was_let_down_does_not_leave_as_low(start, auto, place):
    printer = over_bed(start)
    printer.run(
        f"ATTACH_PROBE\n{TRIPS.format(auto)}\nG1 {place}\nG1 Z7.5\nG1 Z7.6\nM400"
    )
    before = printer.session.position()
    for lines in ("G1 X150 Y150", "G1 X150 Y150 Z7.8"):
        assert f"{TOLD} the bed" in printer.fail(lines)
        assert printer.session.position() == pytest.approx(before)
    printer.run("G1 Z20\nG1 X150 Y150\nM400")
    assert where(printer) == "attached"
    printer.machine.truth.require_no_crash()


def test_probe_that_was_let_down_is_docked_where_that_is_to_come(start):
    printer = over_bed(start, allow_delayed_detach="True")
    printer.run("PROBE\nG1 X50 Y270\nG1 Z7.5\nG1 X150 Y150\nM400")
    assert printer.session.position() == pytest.approx((150, 150, 7.5))
    assert trips(printer) == ["attach", "dock"]
    printer.machine.truth.require_no_crash()


# Two pins say that it is in the dock
def test_toolhead_that_was_let_down_leaves_as_low_without_the_probe(start):
    printer = over_bed(start, scene="dock_sensed")
    printer.run("ATTACH_PROBE\nG1 X50 Y270\nG1 Z7.5\nM400")
    printer.machine.world.take_probe_off(printer.now())
    printer.run("G1 X150 Y150\nM400")
    assert printer.session.position() == pytest.approx((150, 150, 7.5))


# Afterwards nobody would find the dock, and homing goes on from where the toolhead is
@pytest.mark.slow
@pytest.mark.parametrize("end", ["M84", "SAVE_CONFIG"])
@pytest.mark.parametrize(
    ("base", "restore"), [("dock_bed", "True"), ("dock_near_pin", "False")]
)
def test_what_ends_a_docking_that_is_to_come(start, base, restore, end):
    own = {**QUICK, "allow_delayed_detach": "True", "restore_toolhead": restore}
    printer = start(BASES[base], {"dockable_probe": own}).homed()
    script = f"{OVER}\nBED_MESH_CALIBRATE"
    if end == "SAVE_CONFIG":
        printer.session.restart(f"{script}\n{end}")
    else:
        printer.run(f"{script}\n{end}")
    assert where(printer) == "docked"
    assert trips(printer)[-1] == "dock"
    printer.run("G28\nM400")
    printer.machine.truth.require_no_crash()


# Z is anything for a moment there, and the way to such a dock goes by it
@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "script"),
    [
        ("dock_bed", "ATTACH_PROBE"),
        slow("dock_above", "MOVE_TO_APPROACH_PROBE"),
    ],
)
def test_homing_override_and_a_dock_with_a_height(start, base, script):
    scene = overridden(BASES[base])
    printer = start(scene, {"dockable_probe": dict(QUICK)}).homed()
    printer.run(OVER)
    before = seen(printer)
    printer.run(script)
    assert seen(printer) != before
    printer.run("G28\nG28\nM400")
    assert where(printer) == "docked"
    printer.machine.truth.require_no_crash()


@pytest.mark.every_host("only Kalico has z_tilt_ng")
@pytest.mark.slow
def test_tilt_by_hand_of_kalico(start, host):
    if firmware_of(host) != "Kalico":
        pytest.skip("it has no z_tilt_ng")
    scene = with_all(DOCK_SCENES["dock_frame"])
    tilt = {
        **scene.sections["z_tilt"],
        "points": "100, 100\n  150, 230\n  250, 100",
        "extra_points": "150, 100\n  100, 150\n  250, 150",
    }
    changes = {
        "z_calibration": None,
        "z_tilt": None,
        "z_tilt_ng": tilt,
        "dockable_probe": dict(QUICK),
    }
    flat = replace(scene.world.bed, slope_x=0.0, slope_y=0.0)
    printer = start(scene.with_world(bed=flat), changes).homed()
    printer.run(f"{OVER}\nATTACH_PROBE\nZ_TILT_CALIBRATE METHOD=manual")
    assert where(printer) == "docked"
    with contextlib.suppress(GcodeError):
        printer.run("TESTZ Z=-7\nM400")
    assert pressed(printer) < 0.1


# Older hosts and Kalico take it for paper, whatever it is
@pytest.mark.every_host("older hosts and Kalico take any METHOD for paper")
def test_levelling_by_another_method_never_lowers_the_probe(start):
    scene = with_all(DOCK_SCENES["dock_frame"])
    changes = {"z_calibration": None, "dockable_probe": dict(QUICK)}
    flat = replace(scene.world.bed, slope_x=0.0, slope_y=0.0)
    printer = start(scene.with_world(bed=flat), changes).homed()
    printer.run(f"{OVER}\nATTACH_PROBE\nZ_TILT_ADJUST METHOD=auto")
    # Where it is automatic the probe stays, as whoever has fetched it wants it
    asks = printer.status("manual_probe")["is_active"]
    assert where(printer) == ("docked" if asks else "attached")
    with contextlib.suppress(GcodeError):
        printer.run("TESTZ Z=-7\nM400")
    assert pressed(printer) < 0.1


# "About how far" the probe hangs below the nozzle is what the set-up asks for
@pytest.mark.parametrize("z_offset", ["4", slow("4.8")])
@pytest.mark.parametrize(
    "then", ["PROBE", slow("ATTACH_PROBE"), slow("BED_MESH_CALIBRATE")]
)
def test_z_offset_that_is_too_small(start, z_offset, then):
    printer = over_bed(start, scene="dock_gantry_switch", z_offset=z_offset)
    printer.run(f"PROBE\n{then}\nM400")
    assert printer.machine.truth.drag("probe_bed") < 0.5
    assert pressed(printer) < 0.2
    # Z is another one once it was homed again
    printer.run("G28")
    height = printer.session.position()[2]
    printer.run("ATTACH_PROBE")
    assert where(printer) == "attached"
    assert printer.session.position()[2] >= height


@pytest.mark.parametrize("z", ["4", "12"])
def test_dock_that_is_lower_than_the_probe_hangs_is_told(start, z):
    own = {"dock_position": f"50, 308, {z}"}
    printer = start(DOCK_SCENES["dock_bed"], {"dockable_probe": own})
    printer.session.require_ready()
    printer.session.wait(10.0)
    told = "".join(printer.status("dockable_probe")["notes"])
    assert (f"Z of the dock ({z}) is less than the probe hangs" in told) == (
        z == "4"
    )
