"""The judge of walks sees each kind of harm, and what is right it lets be."""

import pytest

from tools.campaign import claims, walker
from tools.campaign.breaking import Break
from tools.campaign.claims import HOMED_OR_SET, MOTORS_OFF, Facts
from tools.campaign.drawn import values
from tools.campaign.drawn.printers import Owned
from tools.campaign.drawn.steps import OVER_MEMBRANE
from tools.campaign.judging import Gone, HarmError
from tools.campaign.walker import Walker
from tools.kit.printer import Printer

# It judges walks, which make test has some of
pytestmark = [pytest.mark.slow, pytest.mark.one_host]

SWITCH = Owned("dock_gantry_switch")
# Z is homed with the probe
PROBED = Owned("dock_gantry")
MEMBRANE = Owned("membrane")
HOMED = "G28\nG90\nG1 Z20 F1200"
CALIBRATED = ["Z-CALIBRATION: probe=6.8 - (switch=8.0 - nozzle=1.6"]
CORRECTED = ["AUTO_Z_CALIBRATE: median of 1, range 0: probe_z_correction: 0.1"]
PUT_DOWN = [
    "extra_probe membrane: trigger=0.2 - z_offset=0.25 --> new offset=0"
]
BESIDE_BED = "G1 X100 Y305 F9000\nG1 Z%g F1200\nM400"


@pytest.fixture
def judged(host):
    """judged(owned): a homed printer and its judge, as a step begins."""
    printers = []

    def make(owned):
        scene, changes = owned.scene, owned.changes()
        printer = Printer(host, scene, changes, (), owned.seed)
        printers.append(printer)
        printer.homed()
        printer.run(HOMED)
        printer.session.wait(2.0)
        judge = Walker(printer, owned, walker.Outcome(), print).judge
        judge.begin()
        return printer, judge

    yield make
    for printer in printers:
        printer.session.close()
        printer.machine.close()


def sort_of(judge, kind, script="", refusal="", lines=()):
    """What the judge says of a step; empty: nothing."""
    try:
        judge.end(Gone(kind, script, refusal, lines))
    except HarmError as error:
        return error.sort
    return ""


def test_low_place_with_nothing_in_the_way(judged):
    printer, judge = judged(SWITCH)
    printer.run(BESIDE_BED % 0.5)
    assert sort_of(judge, "gcode", "G1") == ""
    judge.begin()
    printer.run(BESIDE_BED % -3.0)
    assert sort_of(judge, "gcode", "G1") == "too low"


def test_bed_is_pressed_only_where_no_membrane_was_laid(judged):
    printer, judge = judged(MEMBRANE)
    # The owner has his zero below the bed
    touch = "G1 X30 Y20 F6000\nG1 Z%g F600\nM400\nG1 Z20 F600\nM400"
    printer.run(touch % 0.1)
    script = "EXTRA_PROBE PROBE=membrane"
    assert sort_of(judge, "gcode", script) == ""
    judge.begin()
    printer.run(touch % 0.1)
    assert sort_of(judge, "gcode", "AUTO_Z_PROBE") == "harm"
    judge.begin()
    printer.run(touch % -1.3)
    assert sort_of(judge, "gcode", script) == "harm"


# A host keeps the last move back for a while, and the world lives on when it is asked
def test_nozzle_that_is_lifted_presses_nothing(judged):
    printer, judge = judged(MEMBRANE)
    script = "EXTRA_PROBE PROBE=membrane"
    refusal = "extra_probe membrane: the switch did not answer"
    printer.run("G1 X30 Y20 F6000\nG1 Z0.1 F600\nM400")
    assert "nozzle_bed" in {n.site for n in printer.machine.near() if n.pressed}
    assert sort_of(judge, "gcode", script, refusal) == "left behind"
    printer.run("G1 Z20 F1200")
    assert sort_of(judge, "gcode", script, refusal) == ""


def test_head_that_moves_by_itself(judged):
    printer, judge = judged(SWITCH)
    assert sort_of(judge, "wait") == ""
    judge.begin()
    # To the dock, which it may
    printer.run("G1 X140 F3000\nM400")
    assert sort_of(judge, "wait") == ""
    printer.run("SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0")
    judge.begin()
    printer.run("G1 X150 F3000\nM400")
    assert sort_of(judge, "wait") == "moved"


def test_head_on_its_last_way_does_not_move_by_itself(judged):
    printer, judge = judged(SWITCH)
    printer.run("SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0\nG1 X140 F1200")
    judge.begin("wait")
    printer.session.wait(3.0)
    assert sort_of(judge, "wait") == ""
    printer.run("G1 X180 F1200")
    judge.begin()
    printer.session.wait(3.0)
    assert sort_of(judge, "wait") == "moved"


def test_head_that_a_pending_docking_moves_is_not_elsewhere(judged):
    printer, judge = judged(
        Owned(
            "dock_gantry_switch",
            options=(
                ("dockable_probe", "allow_delayed_detach", "True"),
                ("dockable_probe", "restore_toolhead", "False"),
            ),
        )
    )
    move = "MOVE_AVOIDING_DOCK X=140 Y=150"
    printer.run(f"G1 X150 Y150 F9000\nPROBE\n{move}")
    assert sort_of(judge, "gcode", move) == ""


def test_head_that_drives_off_when_its_command_has_ended(judged):
    printer, judge = judged(SWITCH)
    printer.run("SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0")
    printer.run("G1 X120 F1200")
    assert sort_of(judge, "gcode", "G1") == ""
    printer.run("G1 X140 F1200")
    printer.session.begin("M400\nG1 X180 F3000")
    assert sort_of(judge, "gcode", "G1") == "moved"


def test_head_that_a_refused_command_has_moved_while_somebody_is_asked(judged):
    printer, judge = judged(SWITCH)
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=membrane")
    judge.begin()
    assert (
        sort_of(judge, "gcode", "CALIBRATE_Z\n", "it waits for an answer") == ""
    )
    judge.begin()
    printer.run("G1 X70 F3000")
    assert (
        sort_of(judge, "gcode", "CALIBRATE_Z\n", "it waits for an answer")
        == "moved"
    )


def test_head_that_moves_while_somebody_is_asked(judged):
    printer, judge = judged(SWITCH)
    printer.run("EXTRA_PROBE_CALIBRATE PROBE=membrane")
    judge.begin()
    printer.run("G1 X70 F3000\nM400")
    assert sort_of(judge, "wait") == "moved"


def test_place_that_the_head_was_not_sent_to(judged):
    printer, judge = judged(SWITCH)
    move = "MOVE_AVOIDING_DOCK X=140 Y=150"
    printer.run(move)
    assert sort_of(judge, "gcode", move) == ""
    judge.begin()
    printer.run("PROBE")
    places = "G1 X%d Y150 F9000\nPROBE"
    assert sort_of(judge, "gcode", places % 140) == ""
    judge.begin()
    printer.run("PROBE")
    assert sort_of(judge, "gcode", places % 145) == "elsewhere"


def test_place_that_is_another_one_by_a_skew(judged):
    owned = Owned("dock_gantry_switch", names=frozenset({"skew"}))
    printer, judge = judged(owned)
    places = "SET_SKEW XY=100.5,99.5,70.7\nG1 X140 Y150 F9000\nPROBE"
    printer.run(places)
    assert sort_of(judge, "gcode", places) == ""


def test_nozzle_that_is_left_on_the_pin(judged):
    printer, judge = judged(SWITCH)
    printer.run("G1 X206 Y306 F9000\nG1 Z1.59 F600\nM400")
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "no") == "left behind"


@pytest.mark.parametrize(
    "change",
    [
        "SET_GCODE_OFFSET Z=0.1",
        "G91",
        "M83",
        "SET_VELOCITY_LIMIT VELOCITY=100",
        "SET_VELOCITY_LIMIT ACCEL=100",
    ],
)
def test_what_a_refusal_has_left(judged, change):
    printer, judge = judged(SWITCH)
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "no") == ""
    judge.begin()
    printer.run(change)
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "no") == "left behind"


# The way over the membrane was refused, which the walk itself goes
def test_mode_that_the_step_itself_has_left(judged):
    printer, judge = judged(SWITCH)
    printer.run("G91")
    judge.begin()
    printer.run("G90")
    script, refusal = "EXTRA_PROBE PROBE=membrane", "no"
    over = f"{OVER_MEMBRANE}\n{script}"
    assert sort_of(judge, "gcode", over, refusal) == ""
    assert sort_of(judge, "gcode", script, refusal) == "left behind"


# What its owner's own G-code has set, which only z_calibration undoes
OWN = ("extra_probe membrane", "dockable_probe", "z_calibration")


@pytest.mark.parametrize("section", OWN)
def test_mode_of_the_owner_s_own(judged, section):
    option = {"z_calibration": "start_gcode"}.get(section, "activate_gcode")
    own = ((section, option, "M83"),)
    printer, judge = judged(Owned("dock_gantry_switch", options=own))
    printer.run("M83")
    left = "left behind" if section == "z_calibration" else ""
    assert sort_of(judge, "gcode", "DETACH_PROBE") == left


@pytest.mark.parametrize("change", ["G91", "SET_VELOCITY_LIMIT ACCEL=100"])
def test_what_a_good_run_has_left(judged, change):
    printer, judge = judged(SWITCH)
    printer.run("SET_GCODE_OFFSET Z=0.1")
    assert sort_of(judge, "gcode", "DETACH_PROBE") == ""
    judge.begin()
    printer.run(change)
    assert sort_of(judge, "gcode", "DETACH_PROBE") == "left behind"


def test_correction_that_is_loaded_again(judged):
    printer, judge = judged(PROBED)
    for script in ("AUTO_Z_CALIBRATE", "G28", "AUTO_Z_LOAD_OFFSET"):
        lines = printer.run(script)
        assert sort_of(judge, "gcode", script, "", lines) == "", script
        judge.begin()
    printer.run("SET_GCODE_OFFSET Z=0.6")
    told = sort_of(judge, "gcode", "AUTO_Z_LOAD_OFFSET", "", lines)
    assert told == "wrong offset"


@pytest.mark.parametrize(
    ("owned", "script", "lines"),
    [
        # Nothing has run, as last_query knows
        (SWITCH, "CALIBRATE_Z\nG90", CALIBRATED),
        (PROBED, "AUTO_Z_CALIBRATE", CORRECTED),
        (MEMBRANE, "EXTRA_PROBE_CONTINUE", PUT_DOWN),
    ],
)
def test_gap_that_is_not_the_one_promised(judged, owned, script, lines):
    printer, judge = judged(owned)
    printer.run("SET_GCODE_OFFSET Z=0.6")
    assert sort_of(judge, "print", script, lines=lines) == "wrong offset"
    told = [*lines, "WARNING: it is wrong by 0.6 mm"]
    judge.begin()
    assert sort_of(judge, "print", script, lines=told) == ""


@pytest.mark.parametrize("adjust", [0.0, 0.05])
def test_gap_at_another_point_and_with_an_adjustment(judged, adjust):
    printer, judge = judged(Owned("dock_gantry_switch", bow=0.3))
    script = f"CALIBRATE_Z BED_POSITION=100,120 Z_ADJUST={adjust:g}"
    assert sort_of(judge, "gcode", script, "", printer.run(script)) == ""


# Baby steps, and what a state of before brings back
CHANGES = "SET_GCODE_OFFSET Z_ADJUST=0.1 MOVE=1", "RESTORE_GCODE_STATE NAME=own"


@pytest.mark.parametrize("change", CHANGES)
def test_result_that_is_valid_no_more(judged, change, monkeypatch):
    printer, judge = judged(SWITCH)
    printer.run("SAVE_GCODE_STATE NAME=own")
    lines = printer.run("CALIBRATE_Z")
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "", lines) == ""
    judge.begin()
    printer.run(change)
    assert sort_of(judge, "gcode", change) == ""
    # As if it were valid for ever
    monkeypatch.setattr(judge.gaps, "_is_valid", lambda status: True)
    judge.begin()
    assert sort_of(judge, "gcode", change) == "wrong offset"


def test_result_is_valid_no_more_without_a_frame(judged, monkeypatch):
    printer, judge = judged(SWITCH)
    lines = printer.run("CALIBRATE_Z")
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "", lines) == ""
    judge.begin()
    printer.run("M84")
    assert sort_of(judge, "gcode", "M84") == ""
    monkeypatch.setattr(judge.gaps, "_is_valid", lambda status: True)
    assert sort_of(judge, "gcode", "M84") == "wrong offset"


def test_saved_baby_steps_are_what_is_right_from_then_on(judged):
    printer, judge = judged(SWITCH)
    for script in (
        "CALIBRATE_Z",
        "SET_GCODE_OFFSET Z_ADJUST=0.1 MOVE=1",
        "Z_CALIBRATION_SAVE_GCODE_OFFSET",
        "CALIBRATE_Z",
    ):
        lines = printer.run(script)
        assert sort_of(judge, "gcode", script, "", lines) == "", script
        judge.begin()
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.1 MOVE=1")
    told = sort_of(judge, "gcode", "CALIBRATE_Z", "", CALIBRATED)
    assert told == "wrong offset"


def test_what_was_not_saved_is_not_right(judged):
    printer, judge = judged(SWITCH)
    lines = printer.run("CALIBRATE_Z")
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "", lines) == ""
    printer.run("SET_GCODE_OFFSET Z_ADJUST=0.1 MOVE=1")
    judge.begin()
    save = "Z_CALIBRATION_SAVE_GCODE_OFFSET"
    assert judge.gaps.steps == 0.0
    list(judge.gaps.wrong(save, (), is_refused=True))
    assert judge.gaps.steps == 0.0
    list(judge.gaps.wrong(save, ()))
    assert judge.gaps.steps == pytest.approx(0.1, abs=0.002)


def test_what_two_clients_save_at_once_nobody_knows(judged):
    printer, judge = judged(SWITCH)
    lines = printer.run("CALIBRATE_Z")
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "", lines) == ""
    judge.begin()
    save = "Z_CALIBRATION_SAVE_GCODE_OFFSET"
    printer.run(f"SET_GCODE_OFFSET Z_ADJUST=0.1\n{save}")
    assert sort_of(judge, "both", save) == ""
    judge.begin()
    assert sort_of(judge, "gcode", "CALIBRATE_Z", "", CALIBRATED) == ""


# Words

# With a G-code offset, and without what G92 moves
MOVES = {
    "position": (0.0, 0.0, 10.2),
    "gcode_position": (0.0, 0.0, 10.0),
    "homing_origin": (0.0, 0.0, 0.2),
}


def facts(**fields):
    """Of a homed printer, its probe in the dock."""
    status = {
        "toolhead": {"homed_axes": "xyz"},
        "manual_probe": {"is_active": False},
        "extra_probe membrane": {"waits_for": ""},
        "z_calibration": {"last_result": {"offset": 0.1}, "last_query": True},
        "dockable_probe": {"auto_attach_detach": True},
        "auto_z_offset": {"probe_z_correction": -1.12},
        "gcode_move": MOVES,
    }
    told = {"before": status, "after": status}
    told |= {"probes": frozenset({"docked"}), "membrane": False}
    told["is_asked"] = False
    return Facts(**{**told, "touched": frozenset(), **fields})


NOBODY = {
    "toolhead": {"homed_axes": "xy"},
    "manual_probe": {"is_active": True},
    "extra_probe membrane": {"waits_for": "switch"},
    "z_calibration": {"last_result": {}},
}
NO_TRIPS = {"dockable_probe": {"auto_attach_detach": False}}
NO_OFFSET = {"gcode_move": {**MOVES, "homing_origin": (0.0, 0.0, 0.0)}}
MOVED = {"gcode_move": {**MOVES, "position": (0.0, 0.0, 12.2)}}
HOMED_AGAIN = {"z_calibration": {"reason": "Z was homed again"}}
ASKED = {"is_asked": True}
ON_HEAD = {"probes": frozenset({"attached"})}


@pytest.mark.parametrize(
    ("refusal", "is_so"),
    [
        ("z_calibration: not homed: Z; home all axes (G28) first", NOBODY),
        ("Must home axis first: 1.0", NOBODY),
        ("auto_z_offset: a manual probe is under way; end it", NOBODY),
        ("section 'extra_probe membrane' waits for an answer", ASKED),
        ("z_calibration: not calibrated yet; run it", NOBODY),
        (
            "z_calibration: Z was homed again; run CALIBRATE_Z first, then",
            {"before": HOMED_AGAIN},
        ),
        (
            "z_calibration: Z was homed again; baby steps count from the last",
            {"after": {"z_calibration": {"reason": MOTORS_OFF}}},
        ),
        ("the probe is ATTACHED, and so on", ON_HEAD),
        (
            "auto_z_offset: with the G-code Z offset of -0.3 in force the",
            {
                "before": {
                    "gcode_move": {**MOVES, "homing_origin": (0.0, 0.0, -0.3)}
                }
            },
        ),
        (
            "auto_z_offset: auto_attach_detach is off, and both nozzle",
            {"after": {**NO_TRIPS, "gcode_move": MOVES}},
        ),
        (
            "z_calibration: the G-code offset is 0, not that of CALIBRATE_Z",
            {"after": NO_OFFSET},
        ),
        (
            "auto_z_offset: the G-code Z offset holds no correction, and none"
            " was saved before: nothing",
            {"before": {"auto_z_offset": {"probe_z_correction": 0.0}}},
        ),
        ("auto_z_offset: G92 has moved Z=0 by 2.000 mm", {"after": MOVED}),
        ("z_calibration: the probe is attached already, and", ON_HEAD),
    ],
)
def test_refusal_is_true_or_not(refusal, is_so):
    assert claims.verdict(refusal, facts()) is False
    there = {"before": is_so} if is_so is NOBODY else is_so
    assert claims.verdict(refusal, facts(**there)) is True


def test_our_calibrations_go_nowhere_out_of_reach():
    out = "Move out of range: 356.000 450.000 2.000 [0.000]"
    assert claims.verdict(out, facts()) is True
    assert claims.verdict(f"z_calibration: {out}", facts()) is False


def test_owner_s_own_refusal_is_true():
    refusal = f"z_calibration: start_gcode: {values.NOT_READY}"
    assert claims.verdict(refusal, facts()) is True


def test_levelling_after_g28_is_a_reason():
    refusal = "extra_probe membrane: SAVE=1: the Z motors were levelled since"
    assert claims.verdict(f"{refusal} G28, and what is", facts()) is True


def test_refusal_without_a_reason_is_counted():
    assert claims.verdict("z_calibration: Tuesday; wait", facts()) is None


@pytest.mark.parametrize("lost", ["docked", "lost"])
def test_console_says_where_the_probe_is(lost):
    told = facts(probes=frozenset({lost}))
    for state, count in (("ATTACHED", 1), ("DOCKED", 0), ("UNKNOWN", 0)):
        line = f"Probe Status: {state}"
        found = list(claims.untrue("QUERY_DOCKABLE_PROBE", "", [line], told))
        assert len(found) == count


def test_dock_has_not_done_what_it_says():
    assert not list(claims.untrue("DETACH_PROBE", "", [], facts()))
    assert list(claims.untrue("ATTACH_PROBE", "", [], facts()))
    assert not list(claims.untrue("ATTACH_PROBE", "no way", [], facts()))


def test_status_of_a_run_that_was_refused():
    assert list(claims.untrue("CALIBRATE_Z", "no trigger", [], facts()))
    assert not list(claims.untrue("CALIBRATE_Z", "", [], facts()))


def test_status_of_a_run_in_which_something_broke(judged):
    _, judge = judged(SWITCH)
    broken = Gone("gcode", "CALIBRATE_Z", "", (), (Break("stuck_open"),))
    with pytest.raises(HarmError, match="last_query is False"):
        judge.end(broken)


@pytest.mark.parametrize(
    ("reason", "touched", "is_so"),
    [
        ("Z was homed again", {"nozzle_pin"}, True),
        ("Z was homed again", set(), False),
        ("the Z motors were levelled", set(), False),
        (HOMED_OR_SET, set(), False),
        ("the G-code Z offset is 0.100, that of CALIBRATE_Z is 0", set(), True),
        (
            "the G-code Z offset is 0.200, that of CALIBRATE_Z is 0",
            set(),
            False,
        ),
    ],
)
def test_reason_is_true_or_not(reason, touched, is_so):
    after = {
        "z_calibration": {"reason": reason},
        "gcode_move": {"homing_origin": [0.0, 0.0, 0.1]},
    }
    told = facts(after=after, touched=frozenset(touched))
    found = list(claims.untrue("G28", "", [], told))
    assert found == [] if is_so else found
    assert not list(
        claims.untrue("G28", "", [], facts(before=after, after=after))
    )


# Which it lifts by
def test_safe_z_home_sets_a_z_that_is_not_homed():
    before = {"toolhead": {"homed_axes": "xy"}}
    after = {"z_calibration": {"reason": HOMED_OR_SET}}
    told = facts(before=before, after=after)
    assert not list(claims.untrue("G28", "Must home X", [], told))


def test_far_frame_is_no_floor(judged, monkeypatch):
    printer, judge = judged(MEMBRANE)
    # As after homing beside the bed, without an end
    monkeypatch.setattr(printer.session, "position", lambda: (0.0, 0.0, 340.0))
    printer.machine.truth.lowest = -340.0
    assert sort_of(judge, "gcode", "EXTRA_PROBE PROBE=membrane") == "too low"
