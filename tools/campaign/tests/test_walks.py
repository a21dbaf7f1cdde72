"""Walks do no harm; one that would is found, and shown again."""

import pytest

from tools.campaign import running, tables, walker
from tools.campaign.drawn import values
from tools.campaign.drawn.printers import Owned
from tools.campaign.drawn.steps import OVER_MEMBRANE, PROBE
from tools.campaign.running import Done
from tools.campaign.tests.planting import planted
from tools.campaign.walker import Outcome
from tools.kit.cases import all_slow_but
from tools.kit.printer import module_files

TOGETHER = 10
USUAL = range(1, 11, TOGETHER)
DOCK = Owned(names=frozenset({"pause"}), too_high=0.1, bow=-0.2)
AGAIN, FIXED = "CALIBRATE_Z", "SET_GCODE_OFFSET Z=0.05"
# The probe that its owner has fetched would meet the bed first
HELD = (
    ("gcode", "G28"),
    ("gcode", "ATTACH_PROBE"),
    ("hand", "lay_membrane"),
    ("gcode", f"{OVER_MEMBRANE}\nEXTRA_PROBE PROBE=membrane"),
)


# About once on each printer of the covering array
@pytest.mark.timeout(900)
@pytest.mark.parametrize("first", all_slow_but(USUAL, range(1, 301, TOGETHER)))
def test_no_order_of_commands_does_harm(host, first):
    for seed in range(first, first + TOGETHER):
        done = running.go_drawn(seed, host, simpler=0)
        assert not done.outcome.harm, f"seed {seed}: {done.walk}"


@pytest.fixture
def product(tmp_path):
    """product(module, command, ...): our modules with planted()'s among them."""
    return lambda *what, **lines: (
        module_files() | planted(tmp_path, *what, **lines)
    )


# Whatever hangs on the toolhead: past all that looks at G-code's own moves
DOWN = 'printer.lookup_object("toolhead").manual_move([None, None, 1.0], 10.0)'


@pytest.mark.one_host
def test_harm_is_found(host, product):
    lowers = product("extra_probe", "EXTRA_PROBE", first=DOWN)
    outcome = walker.go(DOCK, HELD, host, lowers)
    assert outcome.kind == "harm"
    assert "step 4, gcode" in outcome.harm
    assert not walker.go(DOCK, HELD, host).harm


@pytest.mark.one_host
@pytest.mark.slow
def test_a_touch_beside_a_hand_is_found(host, product):
    asks = ("gcode", "EXTRA_PROBE_CALIBRATE PROBE=membrane")
    walk = ("gcode", "G28"), asks, ("gcode", "CALIBRATE_Z")
    asks_nobody = product("z_calibration", AGAIN, first='return run("G28 Z")')
    outcome = walker.go(DOCK, walk, host, asks_nobody)
    assert outcome.kind == "moved"
    assert "nozzle_pin while somebody is asked" in outcome.harm
    assert not walker.go(DOCK, walk, host).harm


# A run that ends in an error when all is measured
NOT_READY = Owned(options=(("z_calibration", "end_gcode", values.ASKS),))
REFUSED = (
    ("gcode", "G28"),
    ("gcode", "SET_GCODE_OFFSET Z=0.1"),
    ("gcode", "CALIBRATE_Z"),
)


@pytest.mark.one_host
@pytest.mark.slow
def test_what_a_refusal_leaves_is_found(host, product):
    outcome = walker.go(NOT_READY, REFUSED, host)
    assert not outcome.harm
    assert outcome.refusals
    slow = 'run("SET_VELOCITY_LIMIT ACCEL=77")'
    forgets = product("z_calibration", AGAIN, failed=slow)
    outcome = walker.go(NOT_READY, REFUSED, host, forgets)
    assert outcome.kind == "left behind"
    assert "max_accel" in outcome.harm


# One's own macro that has homing begin without an offset, after an error, too
HOMES = Owned(
    names=frozenset({"wrapped_homing"}),
    options=(("z_calibration", "error_gcode", "G28 X"),),
)


@pytest.mark.one_host
@pytest.mark.slow
def test_what_an_owner_wants_is_not_left_behind(host):
    refused = ("gcode", "M84"), *REFUSED[1:]
    outcome = walker.go(HOMES, refused, host)
    assert not outcome.harm
    assert outcome.refusals


# Macros are to dock it, and its owner has tried the dock out
NO_TRIPS = Owned(
    options=(
        ("dockable_probe", "auto_attach_detach", "False"),
        ("dockable_probe", "detach_dockable_before_z_home", "False"),
    ),
    names=frozenset({"card"}),
)
PRINTS = ("print", ("CALIBRATE_Z", 0)), ("card", (1, "", "CANCEL_PRINT"))


@pytest.mark.one_host
@pytest.mark.slow
@pytest.mark.parametrize("prints", PRINTS)
def test_who_wants_no_trips_prints_without_the_probe(host, prints):
    walk = ("gcode", "G28"), ("gcode", "ATTACH_PROBE"), prints
    outcome = walker.go(NO_TRIPS, walk, host)
    assert not outcome.harm
    assert outcome.done[prints[0]] == 1


# What is right, and was called harm: an end_gcode that happens to set what was
# measured, an offset that is rounded, an owner who puts away what he has fetched
RIGHT = (
    (
        Owned("voron", options=(("z_calibration", "end_gcode", FIXED),)),
        ("SET_GCODE_OFFSET Z=0.1", "Z_CALIBRATION_SAVE_GCODE_OFFSET", AGAIN),
    ),
    (
        Owned("cartesian"),
        ("SET_GCODE_OFFSET Z_ADJUST=-0.05", f"{AGAIN}_ACCURACY ATTACH=0"),
    ),
    (
        Owned("dock_gantry", names=frozenset({"card"})),
        ("AUTO_Z_CALIBRATE", "ATTACH_PROBE"),
    ),
)


@pytest.mark.one_host
@pytest.mark.slow
@pytest.mark.parametrize(("owned", "commands"), RIGHT)
def test_what_is_right_is_no_harm(host, owned, commands):
    walk = [("gcode", text) for text in ("G28", AGAIN, *commands)]
    if "card" in owned.names:
        walk.append(("card", (1, "", "CANCEL_PRINT")))
    outcome = walker.go(owned, walk, host)
    assert not outcome.harm
    assert outcome.done["card"] == ("card" in owned.names)


# Nor is a print that ends a question, or a touch at the mesh's zero
@pytest.mark.one_host
@pytest.mark.slow
def test_nobody_is_asked_any_more_after_a_print(host):
    owned = Owned("dock_above", names=frozenset({"card"}))
    asks = "EXTRA_PROBE_CALIBRATE PROBE=membrane FLOOR=-0.5"
    walk = (
        ("gcode", "G28"),
        ("gcode", asks),
        ("card", (1, "", "CANCEL_PRINT")),
        ("gcode", AGAIN),
        ("gcode", "EXTRA_PROBE_ABORT PROBE=membrane"),
        ("gcode", AGAIN),
    )
    outcome = walker.go(owned, walk, host)
    assert not outcome.harm
    assert outcome.done[AGAIN] == 2


@pytest.mark.one_host
@pytest.mark.slow
def test_gap_is_looked_at_where_the_plate_was_touched(host):
    owned = Owned(
        "dock_frame", z_motors=3, names=frozenset({"mesh_zero", "saved_mesh"})
    )
    for between in "BED_MESH_CLEAR", "BED_MESH_PROFILE LOAD=default":
        walk = [
            ("gcode", text) for text in ("G28", between, "AUTO_Z_CALIBRATE")
        ]
        outcome = walker.go(owned, walk, host)
        assert not outcome.harm
        assert outcome.done["AUTO_Z_CALIBRATE"] == 1


# The probe waits on the toolhead a while, as it may be wanted again
WAITS = Owned(options=(("dockable_probe", "allow_delayed_detach", "True"),))
LATER = (
    ("gcode", "G28"),
    ("macro", (PROBE[1], "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0")),
)
OUTLIVES = """
reactor.register_callback(
    lambda eventtime: gcode.run_script("DETACH_PROBE"), reactor.monotonic() + 1
)
"""


@pytest.mark.one_host
@pytest.mark.slow
def test_what_a_macro_leaves_pending_is_found(host, product):
    outlives = product("dockable_probe", "SET_DOCKABLE_PROBE", done=OUTLIVES)
    outcome = walker.go(WAITS, LATER, host, outlives)
    assert outcome.kind == "moved"
    assert "while nobody asks for it" in outcome.harm
    assert not walker.go(WAITS, LATER, host).harm


def test_walk_is_kept(tmp_path):
    outcome = Outcome(harm="harm: x", kind="harm")
    done = Done("7", "klipper", (DOCK, HELD), outcome)
    assert running.read(running.write(done, tmp_path)) == (DOCK, HELD)


def test_seed_draws_the_same_again(host):
    first, again = (running.go_drawn(3, host, simpler=0) for _ in range(2))
    assert first.walk == again.walk
    assert first.outcome == again.outcome


def test_figures_as_a_table():
    figures = {
        "walks": 10,
        "steps": 90,
        "harmed": {"harm": 1, "lie": 2, "hang": 3, "shutdown": 4},
        "refused": {"not homed": 5, "Tuesday": 2},
        "healthy": {"Tuesday": 2},
    }
    lines = tables.walks_table(figures).splitlines()
    numbers = [cell.strip() for cell in lines[2].strip("|").split("|")]
    assert numbers == ["10", "90", "1", "0", "7", "2", "7", "2"]
    assert lines[3:] == ["", "- 2: `Tuesday`"]


# A switch that breaks meanwhile

BROKEN = (
    ("gcode", "G28"),
    ("break", ("stuck_open", "z_endstop", "begin")),
    ("gcode", "CALIBRATE_Z"),
    ("mend", "stuck_open"),
    ("gcode", "G28"),
    ("gcode", "CALIBRATE_Z"),
)


@pytest.mark.one_host
def test_fault_is_named_and_what_it_leads_to_is_bounded(host, product):
    owned = Owned(base="voron")
    outcome = walker.go(owned, BROKEN, host)
    assert not outcome.harm
    assert outcome.ends[:2] == ["", ""]
    assert "the switch did not answer" in outcome.ends[2]
    assert outcome.ends[3:] == ["", "", ""]
    # Without the fault nothing may be pressed like that
    deeper = product("z_calibration", "CALIBRATE_Z", failed=DEEPER)
    outcome = walker.go(owned, BROKEN, host, deeper)
    assert outcome.kind == "harm"
    assert "nozzle_pin" in outcome.harm


# On the pin, where it has ended 1 mm below the trigger
DEEPER = """
printer.lookup_object("toolhead").manual_move([None, None, 0.3], 10.0)
printer.lookup_object("toolhead").wait_moves()
printer.lookup_object("toolhead").manual_move([None, None, 20.0], 10.0)"""


@pytest.mark.one_host
@pytest.mark.slow
def test_fault_that_is_not_named_is_found(host, product):
    hides = 'raise printer.command_error("not today")'
    modules = product("z_calibration", "CALIBRATE_Z", failed=hides)
    outcome = walker.go(Owned(base="voron"), BROKEN, host, modules)
    assert outcome.kind == "hidden"
    assert "stuck_open: 'not today'" in outcome.harm


# What an owner has got wrong, or built otherwise


@pytest.mark.one_host
@pytest.mark.slow
def test_mistake_is_a_reason_and_no_excuse_for_a_wrong_gap(host, product):
    owned = Owned(base="voron", mistake="nozzle beside pin")
    walk = (("gcode", "G28"), ("gcode", "CALIBRATE_Z"))
    outcome = walker.go(owned, walk, host)
    assert outcome.ends[1] and not outcome.harm and not outcome.healthy
    # Z=0 is found whatever the owner believes of the endstop
    wide = (("z_calibration", "offset_margins", "-5, 5"),)
    owned = Owned(base="voron", mistake="endstop too high", options=wide)
    assert walker.go(owned, walk, host).ends == ["", ""]
    wrong = product(
        "z_calibration",
        "CALIBRATE_Z",
        done='run("SET_GCODE_OFFSET Z_ADJUST=0.3 MOVE=0")',
    )
    for other in (owned, Owned(base="voron")):
        outcome = walker.go(other, walk, host, wrong)
        assert outcome.kind == "wrong offset", outcome


@pytest.mark.one_host
@pytest.mark.slow
def test_printer_that_is_built_otherwise_is_right(host):
    owned = Owned(
        base="voron",
        screw=7.77,
        microsteps=8,
        skew=(0.1, -0.1, 0.05),
        drift=(1e-4, -1e-4, 5e-5, 0.0),
        board="z_endstop",
        latency=0.005,
        options=(("z", "homing_speed", "20"), ("probe", "speed", "2.0")),
    )
    walk = (("gcode", "G28"), ("gcode", "CALIBRATE_Z"), ("wait", 200))
    outcome = walker.go(owned, walk, host)
    assert (outcome.harm, outcome.ends) == ("", ["", "", ""])
