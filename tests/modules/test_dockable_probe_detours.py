"""Where [dockable_probe] takes the toolhead: to the very point, and on which way."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.world import Pose
from tools.kit.dockable_probe import (
    ABOVE,
    FRAME,
    GANTRY,
    QUICK,
    SERVO,
    SWITCH,
    WAY,
    at,
    moves,
    section,
    trips,
    where,
)
from tools.kit.docks import DOCK_SCENES
from tools.kit.klipper_sections import bed_mesh
from tools.kit.z_calibration import with_moves

EXTRACT = (50.0, 270.0)
DETACH = (90.0, 308.0)
# In the circle of the dock, clear of the dock itself; the second one with the
# probe over the bed
BESIDE = (80.0, 300.0)
PROBED = (62.0, 274.0)


def started(start, scene, changes=None, **options):
    """A printer that records its moves, not homed."""
    changes = {
        "moves": {},
        **section(**{**QUICK, **options}),
        **(changes or {}),
    }
    printer = start(scene, changes, modules=with_moves())
    printer.session.require_ready()
    return printer


def last_touch(printer, site):
    touches = [t for t in printer.machine.truth.touches if t.site == site]
    return touches[-1].x, touches[-1].y


# Z goes down where the toolhead was put


@pytest.mark.parametrize("restore", ["True", "False"])
@pytest.mark.parametrize("point", [BESIDE, (206.0, 306.0)])
def test_on_the_pin_after_docking(start, point, restore):
    pin = replace(SWITCH.world.pin, x=point[0], y=point[1])
    home = {"safe_z_home": {"home_xy_position": "%g, %g" % point}}
    printer = started(
        start,
        SWITCH.with_world(pin=pin),
        home,
        detach_dockable_before_z_home="True",
        restore_toolhead=restore,
    ).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nATTACH_PROBE\nG28 Z")
    assert trips(printer) == ["attach", "dock"]
    assert last_touch(printer, "nozzle_pin") == pytest.approx(point, abs=0.02)
    assert printer.machine.truth.min_gap > 0.0


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("restore", ["True", "False"])
def test_probed_where_the_head_was(start, held, restore):
    printer = started(start, SWITCH, restore_toolhead=restore).homed()
    printer.run("G1 X150 Y150 Z20 F6000\n" + "ATTACH_PROBE" * held)
    assert (trips(printer) == ["attach"]) is held
    printer.run("G1 X%g Y%g\nPROBE" % PROBED)
    assert last_touch(printer, "probe_bed") == pytest.approx(PROBED, abs=0.02)
    stays = held or restore == "True"
    assert at(printer) == pytest.approx(PROBED if stays else DETACH)


# The docking of homing has left it beside the dock, straight behind which the bed is
@pytest.mark.parametrize(
    "command",
    [
        "BED_MESH_CALIBRATE",
        "Z_TILT_ADJUST",
        "BED_MESH_CALIBRATE METHOD=manual\nABORT",
    ],
)
def test_no_way_across_the_dock_where_docking_has_left_the_head(start, command):
    scene = DOCK_SCENES["dock_frame"]
    printer = started(start, scene, restore_toolhead="False").homed()
    assert at(printer) == pytest.approx((2.0, 240.0))
    printer.run(f"{command}\nM400")
    assert trips(printer)[-2:] == ["attach", "dock"]
    printer.machine.truth.require_no_crash()


# The host goes down to 10 mm from where fetching has ended, and then across
@pytest.mark.parametrize("distance", [None, "0", "1"])
def test_no_way_down_into_the_dock_where_fetching_has_left_the_head(
    start, distance
):
    mesh = {"bed_mesh": bed_mesh("40, 40", "200, 200", horizontal_move_z="10")}
    own = {"restore_toolhead": "False", **QUICK}
    if distance is not None:
        own["safe_dock_distance"] = distance
    changes = {**mesh, **section(**own)}
    printer = start(ABOVE, changes).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nPROBE\nBED_MESH_CALIBRATE")
    assert trips(printer) == ["attach", "dock"] * 2
    printer.machine.truth.require_no_crash()


# Whatever the owner wants of the toolhead: the host goes on from where it has probed
@pytest.mark.parametrize("restore", ["True", "False"])
def test_paper_is_put_where_the_probe_was(start, restore):
    printer = started(start, SWITCH, restore_toolhead=restore).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nPROBE_CALIBRATE")
    assert where(printer) == "docked"
    assert at(printer) == pytest.approx((148.0, 174.75))


# Straight from the dock to those points the way is across it
@pytest.mark.parametrize(
    "script",
    [
        "AXIS_TWIST_COMPENSATION_CALIBRATE SAMPLE_COUNT=2\nACCEPT",
        "G1 X150 Y100 Z20 F6000\nG1 X60\nPROBE_CALIBRATE",
    ],
)
def test_no_paper_across_the_dock(start, script):
    scene = DOCK_SCENES["dock_frame"]
    printer = started(start, scene, restore_toolhead="False").homed()
    printer.run(script)
    assert where(printer) == "docked"
    printer.run("ABORT")
    printer.machine.truth.require_no_crash()


# The end of X is on the dock's other side
@pytest.mark.parametrize("then", ["M400", "MOVE_AVOIDING_DOCK X=135 Y=300"])
def test_no_homing_across_the_dock_where_docking_has_left_the_head(start, then):
    dock = replace(SWITCH.world.dock, x=170.0, release=(-1.0, 0.0, 0.0))
    printer = started(
        start,
        SWITCH.with_world(dock=dock),
        dock_position="170, 308",
        approach_position="170, 270",
        detach_position="130, 308",
        restore_toolhead="False",
    ).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nPROBE")
    assert at(printer) == pytest.approx((130.0, 308.0))
    printer.run(f"{then}\nG28 X")
    printer.machine.truth.require_no_crash()


# Straight before the dock homing goes into it; beside it, where docking has left
# the toolhead, it does not.  It went 0.0 mm deep, and 2.8 where the dock is swung away.
@pytest.mark.parametrize("scene", [SWITCH, SERVO], ids=lambda s: s.name)
@pytest.mark.parametrize(
    ("script", "is_moved"),
    [
        ("ATTACH_PROBE\nDETACH_PROBE", False),
        ("ATTACH_PROBE", True),
        ("MOVE_TO_APPROACH_PROBE", True),
        ("MOVE_TO_DOCK_PROBE", False),
    ],
)
def test_no_homing_into_the_dock(start, scene, script, is_moved):
    printer = start(scene, section(restore_toolhead="False", **QUICK)).homed()
    printer.run(f"G1 X150 Y150 Z20 F6000\n{script}\nG28 Y")
    # On the side where X ends, as far away as its nearest position
    x = printer.session.position()[0]
    assert x == pytest.approx(88.0 if is_moved else DETACH[0], abs=0.01)
    printer.run("G28 X")
    printer.machine.truth.require_no_crash()


# In either order, as macros have it
@pytest.mark.parametrize("command", ["G28 X Y", "G28", "G28 X\nG28 Y"])
@pytest.mark.parametrize("scene", [SWITCH, FRAME], ids=lambda s: s.name)
def test_homing_from_each_position_of_the_dock(start, scene, command):
    printer = start(scene, section(restore_toolhead="False", **QUICK)).homed()
    for position in ("APPROACH", "EXTRACT", "INSERT", "DETACH"):
        printer.run(f"MOVE_TO_{position}_PROBE")
        if position in ("APPROACH", "DETACH"):
            option = f"{position.lower()}_position"
            x, y, *_ = scene.sections["dockable_probe"][option].split(",")
            there = pytest.approx([float(x), float(y)])
            assert printer.session.position()[:2] == there
        printer.run(command)
    printer.machine.truth.require_no_crash()


def test_nothing_is_touched_where_docking_has_left_the_head(start):
    printer = started(start, SWITCH, restore_toolhead="False").homed()
    printer.run("G1 X150 Y150 Z20 F6000\nPROBE")
    touches = len(printer.machine.truth.touches)
    text = printer.fail("PROBE")
    assert "the toolhead stands beside the dock; move it to where" in text
    assert len(printer.machine.truth.touches) == touches
    printer.run("G1 X150 Y150 F6000\nPROBE")
    assert len(printer.machine.truth.touches) == touches + 1


def test_nothing_is_touched_in_the_dock(start):
    printer = started(start, SWITCH).homed()
    printer.run("G1 Z20\nMOVE_TO_DOCK_PROBE")
    touches = len(printer.machine.truth.touches)
    text = printer.fail("PROBE")
    assert "the toolhead stands in the dock (X=50.000 Y=308.000)" in text
    assert len(printer.machine.truth.touches) == touches
    # What only fetches it ends beside the dock
    printer.run("ATTACH_PROBE")
    assert at(printer) == pytest.approx(EXTRACT)


# Out of reach


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("X=999", "X=999.000 is outside of 0.000 to 300.000"),
        ("Y=-0.1", "Y=-0.100 is outside of 0.000 to 310.000"),
        ("X=50.2 Y=308", "50.200, 308.000 is in the dock; MOVE_TO_DOCK_PROBE"),
    ],
)
def test_move_out_of_reach(start, place, words):
    printer = started(start, SWITCH).homed()
    before = printer.session.position()
    assert words in printer.fail(f"MOVE_AVOIDING_DOCK {place}")
    assert printer.session.position() == before
    # Rounded by less than a step
    printer.run("MOVE_AVOIDING_DOCK X=300.01")
    assert printer.session.position()[0] == pytest.approx(300.0)


# Up and down


def heights(printer, script):
    """True Z of the nozzle after each line."""
    found = []
    for line in script.split("\n"):
        printer.run(line)
        found.append(printer.machine.tip().z)
    return found


def test_docked_probe_stays_docked_without_a_move(start):
    printer = started(start, GANTRY, {"safe_z_home": None})
    script = "DETACH_PROBE\nM84\nDETACH_PROBE\nG28 X Y\nDETACH_PROBE"
    z = printer.machine.tip().z
    assert heights(printer, script) == pytest.approx([z] * 5)
    # And the next time it is fetched
    printer.run("ATTACH_PROBE\nDETACH_PROBE")
    assert trips(printer) == ["attach", "dock"]


def test_hop_of_the_owner_after_a_docking(start):
    printer = started(start, GANTRY, {"safe_z_home": None}, z_hop="31")
    z = printer.machine.tip().z
    printer.run("G28 X Y\nDETACH_PROBE\nATTACH_PROBE")
    assert printer.machine.tip().z == pytest.approx(z + 31.0, abs=0.01)


# A dock with a height of its own


@pytest.mark.parametrize(
    ("approach", "way"),
    [
        # Through the body of the dock, were it reached from below
        ("50, 306.5, 30", [(50.0, 306.5, 30.0), (50.0, 308.0, 12.0)]),
        ("50, 308, 30", [(50.0, 308.0, 30.0), (50.0, 308.0, 12.0)]),
    ],
)
def test_dock_that_is_entered_from_above(start, approach, way):
    printer = started(
        start, ABOVE, approach_position=approach, safe_dock_distance=None
    ).homed()
    printer.run("G1 X150 Y150 Z20 F6000\nM400")
    ends = moves(printer, "ATTACH_PROBE")
    assert ends[0] == (150.0, 150.0, 30.0)
    assert [end for end in ends if end in way][:2] == way
    assert where(printer) == "attached"
    assert ends[-1] == (150.0, 150.0, 20.0)
    ends = moves(printer, "DETACH_PROBE")
    assert [end for end in ends if end in way][:2] == way
    assert (90.0, 308.0, 12.0) in ends
    assert where(printer) == "docked"
    # From within, too
    printer.run("MOVE_TO_DOCK_PROBE\nATTACH_PROBE")
    assert where(printer) == "attached"


def test_way_around_a_dock_that_is_entered_from_above(start):
    printer = started(start, ABOVE).homed()
    printer.run("G1 X5 Y200 Z30 F6000\nG1 Y300\nATTACH_PROBE")
    printer.run("G1 X120 Y300\nDETACH_PROBE")
    assert trips(printer) == ["attach", "dock"]
    assert at(printer) == pytest.approx((120.0, 300.0))


# Step by step


def test_into_the_dock_from_where_the_head_stands(start):
    # As the document sets it up; nobody has looked at the pins
    dock = replace(SWITCH.world.dock, lanes=((-15.0, -35.0, 0.0),))
    scene = SWITCH.with_world(dock=dock)
    printer = started(start, scene, insert_position="35, 273").homed()
    printer.run("G1 X150 Y150 Z20 F6000\nMOVE_TO_APPROACH_PROBE")
    assert moves(printer, "MOVE_TO_DOCK_PROBE") == [(50.0, 308.0, 20.0)]
    printer.run("MOVE_TO_EXTRACT_PROBE\nMOVE_TO_INSERT_PROBE")
    assert moves(printer, "MOVE_TO_DOCK_PROBE") == [(50.0, 308.0, 20.0)]
    printer.run("MOVE_TO_EXTRACT_PROBE\nG1 X150 Y150\nM400")
    # From elsewhere by what hangs on the toolhead now
    ends = moves(printer, "MOVE_TO_DOCK_PROBE")
    assert (35.0, 273.0, 20.0) in ends
    printer.run("MOVE_TO_DETACH_PROBE\nM400")
    assert where(printer) == "docked"


# Homing ends beside the dock


# The corner is in the circle, and it is behind it: the document says so
@pytest.mark.parametrize("begin", [(200.0, 120.0), (299.0, 300.0)])
def test_no_way_out_of_the_corner_behind_the_dock(start, begin):
    dock = replace(
        GANTRY.world.dock, x=280.0, y=288.0, release=(-1.0, 0.0, 0.0), body=15.0
    )
    printer = started(
        start,
        replace(GANTRY.with_world(dock=dock), start=Pose(*begin, 12.0)),
        dock_position="280, 288",
        approach_position="280, 250",
        detach_position="240, 288",
        safe_z_position="150, 130",
    )
    printer.run("G28 X Y")
    assert at(printer) == pytest.approx((300.0, 310.0), abs=0.02)
    z = printer.machine.tip().z
    text = printer.fail("ATTACH_PROBE")
    assert "no way from 300." in text
    assert "lower safe_dock_distance (38.000)" in text
    assert at(printer) == pytest.approx((300.0, 310.0), abs=0.02)
    assert printer.machine.tip().z == pytest.approx(z + WAY, abs=0.01)
