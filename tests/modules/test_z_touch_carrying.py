"""A dockable probe on the toolhead, and whoever lowers the nozzle."""

from __future__ import annotations

import re

import pytest

from simprinter import Fault
from tools.kit.auto_z_offset import with_extras
from tools.kit.carrying import (
    OVER,
    POINT,
    SWITCH,
    pressed,
    with_membrane,
    without_our_dock,
)
from tools.kit.cases import all_slow_but, slow
from tools.kit.dialogs import dialogs_of
from tools.kit.dockable_probe import QUICK, section, trips, where
from tools.kit.scenes import SCENES

MEMBRANE = "PROBE=membrane"
TWIST = "AXIS_TWIST_COMPENSATION_CALIBRATE"
# What lowers the nozzle
TOUCHES = {
    "EXTRA_PROBE": f"EXTRA_PROBE {MEMBRANE}",
    "EXTRA_PROBE_ACCURACY": f"EXTRA_PROBE_ACCURACY {MEMBRANE} SAMPLES=2",
    "AUTO_Z_PROBE": "AUTO_Z_PROBE",
    "AUTO_Z_HOME_Z": "AUTO_Z_HOME_Z",
    "AUTO_Z_MEASURE_OFFSET": "AUTO_Z_MEASURE_OFFSET",
    "AUTO_Z_CALIBRATE": "AUTO_Z_CALIBRATE",
    "AUTO_Z_TWIST": "AUTO_Z_TWIST SAMPLE_COUNT=2",
    "AUTO_Z_WAIT": "AUTO_Z_WAIT MAX=2",
    "PROBE_Z_ACCURACY": "PROBE_Z_ACCURACY SAMPLES=2",
    "Z_CALIBRATION_WAIT": "Z_CALIBRATION_WAIT MAX=2",
}
# With the nozzle and with the probe
BOTH = ["AUTO_Z_MEASURE_OFFSET", "AUTO_Z_CALIBRATE", "AUTO_Z_TWIST"]
USUAL = ("EXTRA_PROBE", "AUTO_Z_CALIBRATE")
# How the probe comes to be on the toolhead, and options for it
REASONS = {
    "held": ({}, "ATTACH_PROBE"),
    "delayed": ({"allow_delayed_detach": "True"}, "PROBE"),
}
# Down to where the nozzle is free, as those that shake the bed do
GOES_DOWN = {"auto_z_offset": {"prepare_gcode": "\n  G90\n  G0 Z3\n  M400"}}


def ready(start, options=None, changes=None, **more):
    """A homed printer."""
    changes = {**section(**QUICK, **(options or {})), **(changes or {})}
    return start(SWITCH, changes, **more).homed()


def untouched(printer):
    """Whether the probe has met the bed, but in its own touches."""
    return pressed(printer) < 0.2 and printer.machine.truth.crashes() == []


@pytest.mark.parametrize("each", ["True", "False"])
def test_probe_that_activate_gcode_fetches_is_refused(start, each):
    """The toolhead is back, so that it has not moved; the probe is on it by then."""
    own = {
        "activate_gcode": "\n  ATTACH_PROBE",
        "deactivate_on_each_sample": each,
    }
    printer = ready(start, changes={"extra_probe membrane": own})
    printer.machine.lay_membrane()
    printer.run("G1 Z20 F900\nG1 X60 Y60 F6000")
    text = printer.fail(f"EXTRA_PROBE {MEMBRANE}")
    assert "after activate_gcode the probe is ATTACHED" in text
    assert "take what fetches it out of activate_gcode" in text
    assert untouched(printer)


def test_switch_of_the_dock_that_breaks_between_two_touches(start):
    """It looks as if activate_gcode had fetched the probe, which it has not."""
    printer = ready(start)
    printer.machine.lay_membrane()
    command = f"{OVER}EXTRA_PROBE {MEMBRANE} SAMPLES=3\nM400"
    printer.run(command)
    began = printer.now()
    printer.run(command)
    at = began + 1.7 * (printer.now() - began)
    printer.machine.break_down(Fault("stuck_open", signal="probe", t=at))
    text = printer.fail(command)
    assert "the probe is ATTACHED (pin reads open)" in text
    assert text.endswith("or look at its switch and wire where nothing does")
    assert untouched(printer)


@pytest.mark.parametrize("touch", all_slow_but(USUAL, TOUCHES))
@pytest.mark.parametrize("reason", ["held", slow("delayed")])
def test_probe_is_docked_before_the_nozzle_goes_down(start, reason, touch):
    options, fetch = REASONS[reason]
    printer = ready(start, options, GOES_DOWN)
    printer.run(f"{OVER}{fetch}")
    printer.machine.lay_membrane(touch.startswith("EXTRA"))
    printer.run(TOUCHES[touch])
    assert untouched(printer)
    assert trips(printer)[:2] == ["attach", "dock"]


# It was seen in its dock, and is there until those moves are gone
def test_probe_that_queued_moves_fetch_is_seen(start):
    printer = ready(start)
    printer.run(f"{OVER}PROBE\nG1 Z20 F900\nM400")
    assert where(printer) == "docked"
    printer.run(
        "MOVE_TO_DOCK_PROBE\nMOVE_AVOIDING_DOCK X=150 Y=150 SPEED=100\n"
        "AUTO_Z_MEASURE_OFFSET"
    )
    assert untouched(printer)
    assert trips(printer)[2:4] == ["attach", "dock"]


# A first layer may come next
@pytest.mark.parametrize("touch", BOTH)
def test_docking_is_not_delayed_where_the_nozzle_goes_down_next(start, touch):
    printer = ready(start, {"allow_delayed_detach": "True"})
    printer.run(TOUCHES[touch])
    touches = printer.machine.truth.touches
    assert "nozzle_bed" in [touch.site for touch in touches]
    printer.run("G90\nG1 X150 Y150 F9000\nG1 Z0.5 F900\nM400")
    assert untouched(printer)
    assert where(printer) == "docked"


@pytest.mark.parametrize("touch", ["EXTRA_PROBE", "AUTO_Z_PROBE"])
def test_touch_is_refused_where_no_trips_are_wanted(start, touch):
    printer = ready(start, {"auto_attach_detach": "False"}, GOES_DOWN)
    printer.run(f"{OVER}ATTACH_PROBE\nM400")
    height = printer.session.position()[2]
    text = printer.fail(TOUCHES[touch])
    assert "the probe is ATTACHED (pin reads open), and would meet" in text
    assert text.endswith("run DETACH_PROBE")
    assert printer.session.position()[2] >= height
    assert (pressed(printer), trips(printer)) == (0.0, ["attach"])


# Nozzle and probe take turns there
@pytest.mark.slow
@pytest.mark.parametrize("touch", BOTH)
@pytest.mark.parametrize("before", ["ATTACH_PROBE", "DETACH_PROBE"])
def test_both_touch_only_with_trips(start, before, touch):
    printer = ready(start, {"auto_attach_detach": "False"}, GOES_DOWN)
    printer.run(f"{OVER}{before}\nG92 Z10\nM400")
    was = printer.session.position(), printer.status("gcode_move")
    text = printer.fail(TOUCHES[touch])
    assert "auto_attach_detach is off, and both nozzle and probe" in text
    assert untouched(printer)
    # Refused before anything has moved, or was undone
    assert (printer.session.position(), printer.status("gcode_move")) == was
    printer.run(f"SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=1\n{TOUCHES[touch]}")


# In the dock there is no bed to touch, and no way back into it
def test_head_that_does_not_come_back(start):
    printer = ready(start)
    printer.run(f"{OVER}ATTACH_PROBE\nMOVE_TO_DOCK_PROBE\nM400")
    text = printer.fail("AUTO_Z_PROBE")
    assert (
        "the probe was docked, and the toolhead did not come back from" in text
    )
    assert pressed(printer) == 0.0
    assert printer.machine.truth.touch_count("nozzle_bed") == 0


# Its wire breaks while it hangs there: it reads as if it were docked
@pytest.mark.parametrize(
    "touch",
    all_slow_but(["EXTRA_PROBE", "AUTO_Z_PROBE", "G28 Z"], [*TOUCHES, "G28 Z"]),
)
def test_probe_that_reads_docked_and_was_not_docked(start, touch):
    printer = ready(start)
    printer.run(f"{OVER}ATTACH_PROBE")
    printer.machine.break_down(Fault("stuck_closed", signal="probe", t=0.0))
    printer.machine.lay_membrane(touch.startswith("EXTRA"))
    text = printer.fail(TOUCHES.get(touch, touch))
    assert "the probe was not fetched, it is DOCKED" in text
    assert "SET_PROBE_STATUS STATE=DOCKED" in text
    assert pressed(printer) == 0.0
    assert printer.machine.truth.touch_count("nozzle_bed") == 0
    # The next one as well, until somebody has looked
    assert "was not fetched" in printer.fail(
        f"{'G28 X Y' if touch == 'G28 Z' else OVER}\nDETACH_PROBE"
    )


# The same where its owner has said that it hangs there, or that nobody knows
@pytest.mark.parametrize("state", ["ATTACHED", "UNKNOWN"])
def test_probe_that_reads_docked_and_was_told_to_hang(start, state):
    printer = ready(start)
    printer.run(f"{OVER}ATTACH_PROBE\nSET_PROBE_STATUS STATE={state}")
    printer.machine.break_down(Fault("stuck_closed", signal="probe", t=0.0))
    text = printer.fail(TOUCHES["AUTO_Z_CALIBRATE"])
    assert "the probe was not fetched, it is DOCKED" in text
    assert pressed(printer) == 0.0


def test_probe_that_was_put_into_the_dock_by_hand(start):
    printer = ready(start)
    for says_so in (False, True):
        printer.run(f"{OVER}ATTACH_PROBE")
        begun = len(trips(printer))
        take_off(printer)
        if says_so:
            printer.run("SET_PROBE_STATUS STATE=DOCKED")
        printer.run(f"{OVER}AUTO_Z_PROBE")
        wanted = [] if says_so else ["attach", "dock"]
        assert trips(printer, begun)[1:] == wanted
        assert untouched(printer)


def take_off(printer):
    """By hand, and into its dock."""
    machine = printer.machine
    machine.world.lose_probe(printer.now())
    printer.session.wait(0.5)
    machine.world.bring_probe_back(printer.now())
    printer.session.wait(0.5)


def test_dead_probe_where_the_nozzle_has_met_the_bed(start):
    printer = ready(start)
    printer.machine.tolerate("probe_bed", 6.0)
    printer.machine.tolerate("body_bed", 6.0)
    printer.run(f"{OVER}AUTO_Z_PROBE\nATTACH_PROBE\nDETACH_PROBE")
    command = "AUTO_Z_MEASURE_OFFSET"
    fault = Fault("trigger_never", site="probe_bed", command=command)
    printer.machine.break_down(fault)
    text = printer.fail(command)
    where = r"\(stopped at z=1\.\d+\) 5 mm below where the probe should trigger"
    assert re.search(where, text)
    assert 4.0 < pressed(printer) < 5.1


def test_head_is_where_it_was_after_docking(start):
    printer = ready(start, {"restore_toolhead": "False"})
    printer.machine.lay_membrane()
    printer.run(f"{OVER}EXTRA_PROBE {MEMBRANE}")
    (height,) = [t.z for t in printer.machine.truth.touches[-1:]]
    printer.run(f"G1 Z20 F900\nATTACH_PROBE\n{OVER}EXTRA_PROBE {MEMBRANE}")
    last = printer.machine.truth.touches[-1]
    assert last.site == "nozzle_membrane"
    assert (last.x, last.y) == pytest.approx(POINT, abs=0.02)
    assert last.z == pytest.approx(height, abs=0.01)


# Of the host, and what follows by hand
BY_HAND = {
    "MANUAL_PROBE": "MANUAL_PROBE",
    "Z_ENDSTOP_CALIBRATE": "Z_ENDSTOP_CALIBRATE",
    "PROBE_CALIBRATE": "PROBE_CALIBRATE",
    "mesh": "BED_MESH_CALIBRATE METHOD=manual PROBE_COUNT=3,3",
}


@pytest.mark.parametrize("command", BY_HAND)
@pytest.mark.parametrize("reason", [slow("held"), "delayed"])
def test_probe_is_docked_before_testz(start, reason, command):
    options, fetch = REASONS[reason]
    printer = ready(start, options)
    printer.run(f"{OVER}{fetch}\n{BY_HAND[command]}")
    assert where(printer) == "docked"
    z = printer.status("toolhead")["position"][2]
    printer.run(f"TESTZ Z={1.0 - z}\nM400")
    printer.session.wait(3.0)
    # The nozzle hangs free, and nothing drives off meanwhile
    assert printer.machine.truth.min_gap < 2.0
    assert untouched(printer)
    printer.run("ABORT")


# By itself the probe would not be docked then
def test_paper_where_no_trips_are_wanted(start):
    printer = ready(start, {"auto_attach_detach": "False"})
    printer.run(f"{OVER}ATTACH_PROBE")
    assert printer.fail("MANUAL_PROBE").endswith("run DETACH_PROBE")
    printer.run("PROBE_CALIBRATE")
    assert where(printer) == "docked"
    printer.run("ABORT\nATTACH_PROBE\nPROBE")
    assert where(printer) == "attached"


SCREWS = {
    "bed_screws": {
        "screw1": "60, 60",
        "screw2": "240, 60",
        "screw3": "150, 240",
        "probe_height": "2",
        "speed": "100",
    }
}


# It lowers the nozzle at once, and its section comes after ours
def test_bed_screws(start):
    printer = ready(start, changes=SCREWS)
    printer.run(f"{OVER}ATTACH_PROBE\nBED_SCREWS_ADJUST\nM400")
    assert trips(printer) == ["attach", "dock"]
    printer.run("ABORT")
    assert 1.0 < printer.machine.truth.min_gap < 3.0
    assert untouched(printer)


# The toolhead goes on to the next screw as low as it is, and down to Z=0
def test_probe_is_not_fetched_between_screws(start):
    printer = ready(start, changes=SCREWS)
    printer.run(f"{OVER}BED_SCREWS_ADJUST")
    text = printer.fail("ATTACH_PROBE")
    told = "dockable_probe: BED_SCREWS_ADJUST is under way; end it with ACCEPT"
    assert told in text
    printer.run("ACCEPT\nM400")
    assert untouched(printer)
    assert trips(printer) == []
    printer.run("ABORT\nATTACH_PROBE")
    assert trips(printer) == ["attach"]


# What macros have put on the toolhead hangs lower than the nozzle
@pytest.mark.parametrize("is_on", [True, False])
def test_probe_of_macros_is_told_before_the_nozzle_goes_down(start, is_on):
    printer = start(with_membrane(SCENES["cartesian"])).homed()
    printer.run(OVER + ("ATTACH_PROBE" if is_on else "DOCK_PROBE"))
    (dialog,) = dialogs_of(printer.run(f"EXTRA_PROBE_CALIBRATE {MEMBRANE}"))
    told = "The probe reads open, as on the toolhead; put it away first."
    assert (told in dialog.text) is is_on


# Older hosts stay active when the way to the next screw has failed
@pytest.mark.slow
@pytest.mark.every_host(
    "older hosts stay active when the way to the next screw has failed"
)
def test_screws_that_cannot_go_on_are_no_dialog(start):
    printer = ready(start, changes=SCREWS)
    printer.run(f"{OVER}BED_SCREWS_ADJUST\nM84")
    printer.fail("ACCEPT")
    printer.run(f"G28\n{OVER}ATTACH_PROBE")
    assert trips(printer) == ["attach"]


# How it is wired nobody knows without [z_calibration]
def test_probe_that_is_always_on_needs_no_word(start):
    printer = start("membrane_and_probe").homed()
    (dialog,) = dialogs_of(printer.run(f"EXTRA_PROBE_CALIBRATE {MEMBRANE}"))
    assert "reads open, as on the toolhead" not in dialog.text


def test_probe_that_docks_itself_needs_no_word(start):
    printer = ready(start)
    printer.run(f"{OVER}ATTACH_PROBE")
    (dialog,) = dialogs_of(printer.run(f"EXTRA_PROBE_CALIBRATE {MEMBRANE}"))
    assert "reads open, as on the toolhead" not in dialog.text
    assert where(printer) == "docked"


def test_twist_without_trips_does_not_begin(start):
    printer = ready(start)
    printer.run(f"{OVER}SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0\nATTACH_PROBE")
    assert "and the probe has to be fetched and" in printer.fail(TWIST)
    assert where(printer) == "attached"
    assert not printer.status("manual_probe")["is_active"]


@pytest.mark.every_host(
    "Kalico and Klipper calibrate a twist with commands of their own"
)
def test_probe_is_docked_before_each_paper_of_a_twist(start):
    printer = ready(start, {"allow_delayed_detach": "True"})
    printer.run("ATTACH_PROBE\nAXIS_TWIST_COMPENSATION_CALIBRATE")
    for _ in range(2):
        assert where(printer) == "docked"
        printer.run("TESTZ Z=-4\nACCEPT")
    assert where(printer) == "docked"
    printer.run("ABORT")


# It took the docking before each paper with it: the probe was 2.5 mm in the bed
def test_refused_command_in_the_middle_of_a_twist(start):
    printer = ready(start, {"allow_delayed_detach": "True"})
    printer.run(TWIST)
    printer.fail("PROBE_CALIBRATE")
    printer.run("TESTZ Z=-9\nACCEPT")
    assert where(printer) == "docked"
    printer.run("TESTZ Z=-9\nM400")
    assert untouched(printer)
    printer.run("ABORT")


# G-code of the owner's between two points is none of another command
def test_homing_on_the_way_to_the_dock_of_a_twist(start):
    homing = {"pre_attach_gcode": "\n  G28 X"}
    printer = ready(start, {"allow_delayed_detach": "True", **homing})
    printer.run(TWIST)
    printer.run("TESTZ Z=-9\nACCEPT")
    assert where(printer) == "docked"
    printer.run("ABORT")


# How a twist comes to its end, and whether without an error
ENDED = {
    "aborted": (f"{TWIST}\nABORT", True),
    "accepted": (f"{TWIST} SAMPLE_COUNT=2\nACCEPT\nACCEPT", True),
    "refused": (f"{TWIST} SAMPLE_COUNT=1", False),
}


@pytest.mark.slow
@pytest.mark.parametrize("end", ENDED)
def test_probe_that_is_held_stays_on_after_a_twist(start, end):
    script, is_done = ENDED[end]
    printer = ready(start)
    (printer.run if is_done else printer.fail)(script)
    begun = len(trips(printer))
    printer.run(
        f"ATTACH_PROBE\n{OVER}PROBE\nBED_MESH_CALIBRATE PROBE_COUNT=3,3"
    )
    assert trips(printer, begun) == ["attach"]
    assert where(printer) == "attached"


# The owner wants the toolhead to stay there
@pytest.mark.parametrize("command", ["PROBE", "PROBE_ACCURACY SAMPLES=2"])
def test_docking_as_the_owner_wants_it_after_a_twist(start, command):
    printer = ready(start, {"restore_toolhead": "False"})
    printer.run(f"{TWIST}\nABORT\n{OVER}{command}\nM400")
    assert printer.session.position()[:2] == pytest.approx((90.0, 308.0))


# Delayed docking


@pytest.mark.parametrize(
    "end",
    ["SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0", "RESTART"],
)
def test_nothing_is_pending_after(start, end):
    printer = ready(start, {"allow_delayed_detach": "True"})
    printer.run(f"{OVER}PROBE\nM400")
    if end == "RESTART":
        printer.session.begin(end)
        printer.session.wait(8.0)
    else:
        printer.run(end)
        assert not printer.status("dockable_probe")["auto_attach_detach"]
        printer.session.wait(3.0)
    assert trips(printer) == ["attach"]
    assert [line for line in printer.session.console if "!!" in line] == []


ASKS = [f"EXTRA_PROBE_CALIBRATE {MEMBRANE}", "Z_CALIBRATION_SETUP"]


@pytest.mark.parametrize("ask", [*ASKS, "MANUAL_PROBE"])
def test_nothing_drives_off_while_a_person_is_asked(start, ask):
    printer = ready(start, {"allow_delayed_detach": "True"})
    printer.run(f"{OVER}PROBE\n{ask}\nM400")
    # It was docked before, not by now
    assert trips(printer) == ["attach", "dock"]
    place = printer.session.position()
    printer.session.wait(5.0)
    assert printer.session.position() == pytest.approx(place)
    assert trips(printer) == ["attach", "dock"]


def test_delayed_docking_waits_until_a_person_has_answered(start):
    printer = start(
        SWITCH,
        {"by_hand": {}, **section(allow_delayed_detach="True", **QUICK)},
        modules=with_extras("by_hand"),
    ).homed()
    printer.run(f"{OVER}PROBE\nBY_HAND")
    printer.session.wait(10.0)
    assert trips(printer) == ["attach"]
    printer.run("ABORT")
    printer.session.wait(10.0)
    assert trips(printer) == ["attach", "dock"]


@pytest.mark.parametrize("ask", ASKS)
def test_docking_is_not_delayed_while_a_question_is_open(start, ask):
    printer = ready(start, {"allow_delayed_detach": "True"})
    printer.run(f"{OVER}{ask}\nPROBE\nM400")
    assert trips(printer) == ["attach", "dock"]


def test_print_that_begins_ends_the_question(start, tmp_path):
    (tmp_path / "print.gcode").write_text("AUTO_Z_PROBE\nG4 P100\n")
    changes = {"virtual_sdcard": {"path": str(tmp_path)}}
    printer = ready(start, changes=changes)
    printer.run(f"EXTRA_PROBE_CALIBRATE {MEMBRANE}")
    printer.run("SDCARD_PRINT_FILE FILENAME=print.gcode")
    printer.session.wait(60.0)
    assert printer.machine.truth.touch_count("nozzle_bed") == 1


def test_probe_that_was_fetched_while_the_dialog_was_open(start):
    printer = ready(start)
    printer.run(f"EXTRA_PROBE_CALIBRATE {MEMBRANE} FLOOR=-1")
    printer.machine.lay_membrane()
    printer.run(f"ATTACH_PROBE\nEXTRA_PROBE_CONTINUE {MEMBRANE}")
    assert trips(printer) == ["attach", "dock"]
    assert printer.machine.truth.touch_count("nozzle_membrane") > 0
    assert untouched(printer)


# G28 Z on a switch


# Kalico's own dockable_probe, which only Kalico has


@pytest.mark.every_host("only Kalico has a dockable_probe of its own")
@pytest.mark.parametrize("touch", TOUCHES)
def test_probe_of_the_hosts_own_section(start, host, touch):
    if not host.layout.module_dir.endswith("plugins"):
        pytest.skip("only Kalico has a dockable_probe of its own")
    # It goes to the dock as high as the toolhead is
    options = {"z_hop": "12"}
    printer = ready(start, options, modules=without_our_dock())
    printer.run(f"{OVER}ATTACH_PROBE")
    printer.machine.lay_membrane(touch.startswith("EXTRA"))
    printer.run(TOUCHES[touch])
    assert untouched(printer)
    assert trips(printer)[:2] == ["attach", "dock"]


# Commands of the host that are guarded, and ours, keep the words that they had
@pytest.mark.every_host(
    "Kalico takes the words about a partial for the help of a command"
)
def test_help_of_guarded_commands(start):
    text = "\n".join(ready(start).run("HELP"))
    assert "partial(" not in text
    assert re.search(r"SET_PROBE_STATUS\s*: Tell where", text)
