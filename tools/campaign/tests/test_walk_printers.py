"""What walks are on and made of: nothing of the tables is forgotten."""

from itertools import combinations

import pytest

from tools.campaign import doing, walker
from tools.campaign.drawn import (
    card,
    covering,
    features,
    machines,
    mechanics,
    mistakes,
    steps,
    values,
)
from tools.campaign.drawn.machines import BASES, GENERIC
from tools.campaign.drawn.printers import Owned, printers
from tools.campaign.drawn.walking import check_drawn
from tools.kit.product import GCODE, options


@pytest.fixture(scope="module")
def rows():
    return covering.rows(True)


@pytest.mark.parametrize("base", BASES)
def test_each_machine_is_with_everything_that_it_can_have(rows, base):
    of_base = [row for row in rows if row.base == base]
    assert {row.kinematics for row in of_base} == {
        *machines.kinematics_of(base)
    }
    assert {row.z_motors for row in of_base} == {*machines.counts_of(base)}
    assert {row.plate for row in of_base} == {"", "tilt", "bow", "texture"}
    there = BASES[base].sections
    names = frozenset().union(*(row.names for row in of_base))
    alone = {
        name
        for name in features.FEATURES.keys() - {"respond"}
        if name in features.possible({name}, there)
    }
    assert alone <= names


def test_each_pair_of_sections_is_on_a_printer(rows):
    found = {
        pair for row in rows for pair in combinations(sorted(row.names), 2)
    }
    there = {"probe"}
    names = sorted(features.FEATURES.keys() - {"respond"})
    missing = [
        pair
        for pair in combinations(names, 2)
        if set(pair) <= features.possible({*pair, "mesh"}, there)
        and not {*pair} <= {*features.MESHES}
        and not {*pair} <= {*features.FRAMES}
        and pair not in found
    ]
    assert not missing


def test_a_host_without_such_kinematics_gets_no_printer_with_them():
    assert GENERIC in {row.kinematics for row in covering.rows(True)}
    assert GENERIC not in {row.kinematics for row in covering.rows(False)}


def test_no_heat_is_measured_where_klipper_cannot_start_with_it(rows):
    row = next(row for row in rows if row.kinematics == GENERIC)
    drawn = []
    check_drawn(
        printers(row._replace(names=frozenset({"heat", "skew"}))),
        lambda printer: drawn.append(printer),
        1,
        shrinks=False,
    )
    assert drawn[1].kinematics == GENERIC
    assert drawn[1].names == {"skew"}


def test_sections_of_ours_are_left_out(rows):
    assert {row.left_out for row in rows} == {"", *machines.OURS}
    there = (("z_calibration", "speed", "25"), ("dockable_probe", "speed", "7"))
    whole = Owned(options=there)
    rest = Owned(options=there, left_out=("z_calibration",))
    assert whole.has("z_calibration")
    assert not rest.has("z_calibration")
    assert rest.changes()["dockable_probe"] == {"speed": "7"}
    assert "z_calibration" not in rest.changes()
    assert "z_calibration" not in rest.scene.sections
    assert "CALIBRATE_Z" in steps.gcode_of(whole)
    assert "CALIBRATE_Z" not in steps.gcode_of(rest)
    assert Owned.from_data(rest.as_data()) == rest


def test_only_section_of_ours_is_not_left_out():
    assert not machines.can_leave_out("voron", "z_calibration")
    assert machines.can_leave_out("dock_bed", "z_calibration")


def test_probe_is_docked_where_it_would_meet_the_bed_in_homing():
    chosen = {
        base: {option for _, option, _ in values.choices(BASES[base])}
        for base in ("dock_front", "dock_gantry_switch")
    }
    assert values.BEFORE_Z in chosen["dock_gantry_switch"]
    assert values.BEFORE_Z not in chosen["dock_front"]


def test_kinds_of_options():
    kinds = {
        choice[:2]: values.kind_of(choice)
        for choice in values.choices(BASES["dock_bed"])
    }
    assert kinds["z_calibration", "end_gcode"] == "hook"
    assert kinds["dockable_probe", "restore_toolhead"] == "switch"
    assert kinds["dockable_probe", "safe_z_position"] == "switch"
    assert kinds["dockable_probe", "z_hop"] == "switch"
    assert kinds["z_calibration", "samples"] == "number"
    assert kinds["extra_probe membrane", "speed"] == "number"


@pytest.mark.parametrize("section", values.TABLES)
def test_each_row_of_a_table_has_values_or_is_of_the_machine(section):
    chosen = {
        option
        for scene in BASES.values()
        for there, option, _ in values.choices(scene)
        if there == section
    }
    left = {
        row.name
        for row in values.TABLES[section]
        if row.kind is not GCODE
        and not values.is_of_machine(row.name)
        and isinstance(row.default, (bool, int, float, options.Given))
    }
    assert left - chosen == set()


def test_real_values_are_among_them():
    found = {row[:2]: row[2] for row in values.choices(BASES["voron"])}
    assert "350" in found["z_calibration", "speed"]
    assert "0.7" in found["z_calibration", "probing_retract_dist"]
    # That file says in words what it leaves to the default
    assert not any(" " in text for text in found["z_calibration", "samples"])


def test_values_keep_to_the_limits():
    row = options.option(
        "x", options.NUMBER, 4.0, "mm", "", minval=4.0, maxval=7.0
    )
    assert values.of_row(row) == ()
    assert values.of_row(row._replace(limits={})) == ("2", "8")
    assert values.of_row(row._replace(limits={"below": 8.0})) == ("2",)
    assert values.of_row(row._replace(limits={"above": 2.0})) == ("8",)
    count = options.option("x", options.COUNT, 2, "", "", minval=1, maxval=2)
    assert values.of_row(count) == ("1", "2")
    assert values.of_row(count._replace(limits={})) == ("0", "1", "2")


def test_values_of_any_row_follow_from_it():
    """So a new option needs no line here."""
    row = options.option("x", options.NUMBER, 0.0, "mm", "", minval=0.0)
    assert values.of_row(row) == ("1",)
    assert values.of_row(row._replace(limits={"maxval": 20.0})) == ("2",)
    target = row._replace(default=options.Given("y", 8.0, 1.0))
    assert values.of_row(target) == ("0.5", "2")
    assert values.of_row(row._replace(default=None)) == ()
    words = options.choice({"one": 1, "two": 2})
    assert values.of_row(row._replace(kind=words)) == ("one", "two")
    assert values.of_row(row._replace(kind=options.FLAG)) == ("True", "False")


@pytest.mark.parametrize("count", (1, 2, 3))
def test_fewer_motors_are_levelled_in_their_own_way(count):
    scene = machines.built(BASES["dock_gantry_switch"], count, "cartesian")
    assert len(scene.z_motors) == count
    assert "quad_gantry_level" not in scene.sections
    assert ("z_tilt" in scene.sections) == (count > 1)


PRINTS = frozenset({"card", "pause", "mesh"})


def test_print_start_is_that_of_the_document():
    text = card.macros(Owned(names=PRINTS))["gcode_macro PRINT_START"]["gcode"]
    assert text.split("\n  ")[1:] == [
        "SET_GCODE_OFFSET Z=0",
        "BED_MESH_CLEAR",
        "G28",
        "QUAD_GANTRY_LEVEL",
        "G28 Z",
        "BED_MESH_CALIBRATE",
        "CALIBRATE_Z",
    ]


@pytest.mark.slow
def test_print_from_the_card(host):
    printer = Owned(names=PRINTS)
    print_it = ("card", (20, "", "RESUME"))
    outcome = walker.go(printer, (("gcode", "G28"), print_it), host)
    assert not outcome.harm
    assert outcome.done["card"] == 1


@pytest.mark.slow
def test_print_that_another_client_pauses(host):
    paused = ("card", (20, "PAUSE", "CANCEL_PRINT"))
    walk = (("gcode", "G28"), paused, ("gcode", "CALIBRATE_Z"))
    outcome = walker.go(Owned(names=PRINTS), walk, host)
    assert not outcome.harm
    assert outcome.done["CALIBRATE_Z"] == 1


# A dialog with two buttons, and what follows the first
SHOWN = [
    "// action:prompt_begin One",
    "// action:prompt_text Go on?",
    "// action:prompt_footer_button Go on|YES|primary",
    "// action:prompt_footer_button Abort|NO|error",
    "// action:prompt_show",
]
NEXT = [
    "// action:prompt_end",
    *(line.replace("YES", "LATER") for line in SHOWN),
]


class Console:
    """Of a session."""

    def __init__(self, *console):
        self.console = console


@pytest.mark.parametrize(
    ("press", "sent"),
    (
        (doing.answer, ["LATER"]),
        (doing.twice, ["LATER", "LATER"]),
        (doing.late, ["YES"]),
    ),
)
def test_buttons(press, sent):
    found = []
    press(Console(*SHOWN, *NEXT), found.append, 0)
    assert found == sent


@pytest.mark.parametrize("base", BASES)
def test_each_mistake_changes_its_machine(base):
    names = mistakes.possible(BASES[base])
    assert names
    right = Owned(base=base)
    for name in names:
        wrong = Owned(base=base, mistake=name)
        assert wrong.scene != right.scene, name
        assert Owned.from_data(wrong.as_data()) == wrong


def test_each_mistake_is_possible_on_a_machine():
    found = {name for base in BASES for name in mistakes.possible(BASES[base])}
    assert found == set(mistakes.MISTAKES)


@pytest.mark.parametrize("base", BASES)
def test_each_machine_is_built_otherwise(base):
    scene = BASES[base]
    built = Owned(
        base=base,
        screw=0.0 if scene.kinematics == "corexz" else 4.0,
        skew=(0.1, 0.1, 0.1),
        drift=(1e-5,) * 4,
        board=next(iter(mechanics.boards_of(scene)), ""),
    ).scene
    assert built.world.drift.nozzle == 1e-5
    assert len(built.z_skew) == len(scene.z_motors) - 1
    assert bool(built.wiring.boards)
    section = built.sections["stepper_z"]
    assert section["rotation_distance"] in ("4", "40")


def test_fast_touches_are_given_room():
    slow, fast = (
        Owned(base="voron", board="z_endstop", options=rows).scene.world
        for rows in ((), (("z", "homing_speed", "20"),))
    )
    assert fast.overtravel > slow.overtravel > BASES["voron"].world.overtravel


def test_faults_are_in_commands_of_ours_that_do_not_home():
    assert steps.is_breakable("CALIBRATE_Z", ())
    assert not steps.is_breakable("CALIBRATE_Z_ACCURACY CYCLES=2 HOME=1", ())
    assert not steps.is_breakable("G28", ())
    grows = "Z_CALIBRATION_NOZZLE_GROWTH TEMPS=50,70,90"
    assert not steps.is_breakable(grows, ())
    assert steps.is_breakable(grows, ("hot",))
