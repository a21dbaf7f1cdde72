"""What both set-ups by dialogs have in common: their steps, how they end, saving."""

from __future__ import annotations

import re

import pytest

from simprinter import heated
from simprinter.hosts.session import GcodeError
from tools.kit import dock_owner, setup_user
from tools.kit.cases import all_slow_but
from tools.kit.dockable_probe import SWITCH, where
from tools.kit.product import ORDER
from tools.kit.scenes import SCENES
from tools.kit.setup_user import EMPTY, SAVE_THAT_FAILS, User
from tools.kit.z_calibration import section

Z, DOCK = setup_user.SETUP, dock_owner.SETUP
SECTION = {Z: "z_calibration", DOCK: "dockable_probe"}
# A step with jog buttons, the probe on the toolhead
JOG = {Z: "SWITCH", DOCK: "DOCK"}
SETUPS = pytest.mark.parametrize("setup", [Z, DOCK])
# Where the nozzle and the probe are led to, in the section after Save
FOUND = {
    Z: {"switch_xy_position": (254.0, 18.0), "switch_offset": 0.7},
    DOCK: {
        "dock_position": (50.0, 308.0),
        "approach_position": (50.0, 270.0),
        "detach_position": (90.0, 308.0),
    },
}


def user_of(start, setup, scenes=lambda scene: scene, **more):
    """Somebody before the first step, who knows no place yet."""
    if setup == DOCK:
        return dock_owner.dock_owner(start, scenes(SWITCH), more=more)
    changes = {**section(**EMPTY), **more}
    printer = start(scenes(SCENES["cartesian"]), changes=changes)
    printer.session.require_ready()
    return User(printer)


def begin_again(user, setup):
    """The probe is where a set-up begins with it."""
    if setup == DOCK:
        user.go("Y262", "X150 Y150 Z20")
        user.put_on()


def assert_saved(printer, setup):
    """What was found is in the section."""
    own = printer.status("configfile")["settings"][SECTION[setup]]
    for option, value in FOUND[setup].items():
        assert own[option] == pytest.approx(value, abs=0.06), option
    assert printer.status("configfile")["save_config_pending_items"] == {}


# What each step but the first goes back to
BACK = {
    Z: {
        "OFF": "PIN",
        "PROBE": "OFF",
        "HOME": "PROBE",
        "NOZZLE": "HOME",
        "ATTACH": "NOZZLE",
        "SWITCH": "NOZZLE",
        "BED": "SWITCH",
        "LOOK": "BED",
        "TOUCH_NOZZLE": "NOZZLE",
        "TOUCH_SWITCH": "SWITCH",
        "TOUCH_BED": "BED",
        "GAP": "TOUCH_NOZZLE",
        "PAPER": "GAP",
        "SAVE": "GAP",
    },
    DOCK: {
        "DOCK": "ON",
        "OUT": "DOCK",
        "APPROACH": "OUT",
        "INSERT": "APPROACH",
        "FETCH": "APPROACH",
        "STORE": "INSERT",
        "SAVE": "FETCH",
    },
}
STEPS = {
    Z: [name.upper() for name in ORDER],
    DOCK: ["ON", *BACK[DOCK]],
}


# Of the buttons that move the toolhead, and of those that change the page
JOGS = re.compile("STEP=[A-Z]+ (X|Y|Z|WIDTH|JOG)=")


def told(lines):
    """What of the console is none of the dialogs, nor an error."""
    return [
        line
        for line in lines
        if line.startswith("// ") and "// action:" not in line
    ]


@SETUPS
def test_each_step_on_the_console_and_back(start, setup):
    """Without dialogs one types what the console says, with the same words."""
    user = user_of(start, setup)
    printer, touches = user.printer, user.machine.truth.touches
    for number, step in enumerate(STEPS[setup]):
        answer = f"{setup} STEP={step}"
        if number:
            user.go_to(step)
            earlier = f"{setup} STEP={STEPS[setup][number - 1]}"
            before = user.position(), len(touches)
            # Pressed twice, or on a page that is behind
            for typed in (earlier, f"{earlier} WIDTH=10", f"{earlier} JOG=0"):
                text = printer.fail(typed)
                assert "is not what is asked now" in text
                assert f"which is STEP={step.lower()}; {setup} shows" in text
            assert (user.position(), len(touches)) == before
        else:
            user.begin()
        label, gcode = user.first()
        assert gcode == answer
        next_line = told(printer.session.console)[-1]
        assert next_line.startswith(f"// {SECTION[setup]}: Step ")
        assert next_line.endswith(
            f"; {label}: {answer}; all that it asks: {setup}"
        )
        text = printer.fail(f"{answer} ANSWER=NO")
        assert f"ANSWER=NO is none of STEP={step.lower()}: none" in text
        lines = told(printer.run(setup))
        assert lines[0] == next_line.partition(";")[0]
        user.first()
        shown = user.dialog()
        buttons = [*sum(shown.groups, []), *shown.footer_buttons]
        jogs = [b for b in buttons if b[0] == "Move" or "WIDTH=" in b[1]]
        if jogs:
            moved = f"// move the toolhead: {answer} "
            assert any(line.startswith(moved) for line in lines)
            buttons = [b for b in buttons if not JOGS.search(b[1])]
        else:
            assert {f"// {sentence}" for sentence in shown.texts} <= {*lines}
        assert {f"// {label}: {gcode}" for label, gcode, _ in buttons} <= {
            *lines
        }
        if not number:
            assert not user.has("Back")
            continue
        printer.run(f"{answer} ANSWER=BACK")
        assert user.step() == BACK[setup][step]
    user.go_to("SAVE")
    printer.session.restart(f"{setup} STEP=SAVE")
    assert user.dialog() is None
    assert_saved(printer, setup)


@SETUPS
def test_toolhead_is_moved_from_the_console(start, setup):
    user = user_of(start, setup)
    user.come_to(JOG[setup])
    printer, step = user.printer, f"{setup} STEP={JOG[setup]}"
    x, *others = user.position()
    # The place where it is now, and nothing else
    (line,) = told(printer.run(f"{step} X=+1"))
    assert line.startswith(f"// X={x + 1.0:.3f} Y=")
    for typed in ("JOG=0", "JOG=1", "WIDTH=0.1"):
        assert told(printer.run(f"{step} {typed}")) == []
    for typed, words in (
        ("X=10.1", "X=10.1: the toolhead is moved by 10 mm at most"),
        ("X=nan", "X"),
        ("X=much", "X"),
        ("WIDTH=0.01", "WIDTH=0.01 is none of 10, 1, 0.1"),
        ("JOG=2", "JOG"),
    ):
        assert words in printer.fail(f"{step} {typed}")
    assert list(user.position()) == [x + 1.0, *others]
    printer.run("M84")
    assert "not homed" in printer.fail(f"{step} X=-1")


# Where a print stands, and how it is ended; OctoPrint's has nothing but PAUSE
PRINTS = {
    "printing": ("SDCARD_PRINT_FILE FILENAME=a.gcode", "during a print"),
    "paused": ("PAUSE", "a print is paused (PAUSE), and goes on from here"),
}


@SETUPS
@pytest.mark.parametrize("state", PRINTS)
def test_print_that_begins_meanwhile(start, tmp_path, setup, state):
    (tmp_path / "a.gcode").write_text("G4 P500\n" * 99)
    card = {"virtual_sdcard": {"path": str(tmp_path)}, "pause_resume": {}}
    user = user_of(start, setup, **card)
    user.come_to(JOG[setup])
    printer = user.printer
    at, probe = user.position(), where(printer)
    script, words = PRINTS[state]
    printer.run(script)
    step = f"{setup} STEP={JOG[setup]}"
    for refused in (setup, step, f"{step} X=1"):
        text = printer.fail(refused)
        assert text.startswith(f"{SECTION[setup]}: ") and words in text
    # What moves nothing may be done; the print goes on at this height
    printer.run(f"{step} WIDTH=1")
    assert user.has("X-1 mm")
    said = "\n".join(user.press("Abort"))
    if setup == Z:
        # It lifts the toolhead otherwise
        assert "nothing was moved, as a print may be on" in said
    assert user.position() == at
    assert (user.dialog(), where(printer)) == (None, probe)


# OctoPrint says nothing of its prints, and a nozzle that is hot is no print
@SETUPS
def test_heated_printer_is_set_up_without_a_question(start, setup):
    user = user_of(start, setup, heated)
    user.printer.run("M140 S60\nM104 S150")
    user.come_to(JOG[setup])
    at = user.position()
    user.press("X+1 mm")
    assert user.position()[0] == at[0] + 1.0
    console = "\n".join(user.printer.session.console)
    assert "print paused" not in console


USUAL = [
    *((Z, step) for step in ("OFF", "ATTACH", "TOUCH_SWITCH", "SAVE")),
    *((DOCK, step) for step in ("DOCK", "INSERT", "FETCH", "STORE", "SAVE")),
]
# What the owner's G-code adds is taken back, too
UNDOCK = {
    "gcode_macro DOCK_PROBE": {
        "gcode": "\n  SET_GCODE_OFFSET Z_ADJUST=0.3"
        "\n  SET_PIN PIN=probe_magnet VALUE=0\n  G4 P500"
    }
}


def assert_ended(user, setup, step):
    """Nothing is left of it."""
    printer = user.printer
    text = printer.fail(f"{setup} STEP={step}")
    assert "no set-up is under way, as a restart ends it, too" in text
    assert user.dialog() is None
    assert printer.status("configfile")["save_config_pending_items"] == {}


@pytest.mark.parametrize(
    ("setup", "step"),
    all_slow_but(USUAL, [(s, step) for s in STEPS for step in STEPS[s]]),
)
def test_aborted_or_restarted_at_a_step(start, setup, step):
    user = user_of(start, setup, **(UNDOCK if setup == Z else {}))
    printer = user.printer
    homed = printer.status("toolhead")["homed_axes"]
    user.come_to(step)
    assert user.step() == step
    is_homed = printer.status("toolhead")["homed_axes"] == "xyz"
    printer.run("SET_GCODE_OFFSET Z=0.1")
    said = "\n".join(user.press("Abort"))
    assert "the set-up has ended, nothing was saved" in said
    assert_ended(user, setup, step)
    assert printer.offset() == pytest.approx(0.1)
    printer.session.wait(1.0)
    if is_homed:
        # As high as the probe needs it
        assert user.position()[2] > 11.4
    else:
        assert printer.status("toolhead")["homed_axes"] == homed
    if setup == Z:
        assert where(printer) == "docked"
    begin_again(user, setup)
    user.come_to(step)
    printer.session.restart("RESTART")
    assert_ended(user, setup, step)


# What is being done when the button is pressed; None: a question
@pytest.mark.parametrize(
    ("setup", "step", "site"),
    [
        (Z, "SWITCH", None),
        (Z, "PIN", "by hand"),
        (Z, "TOUCH_NOZZLE", "nozzle_pin"),
        (DOCK, "DOCK", None),
        (DOCK, "FETCH", "by dock"),
    ],
)
def test_emergency_stop_in_the_middle(start, setup, step, site):
    user = user_of(start, setup)
    user.come_to(step)
    printer, gcode = user.printer, user.first()[1]
    printer.run("SET_GCODE_OFFSET Z=0.1")
    if site == "nozzle_pin":
        assert "shutdown" in printer.stopped(gcode, site, 0.2).lower()
    else:
        command = printer.session.begin(gcode) if site else None
        printer.session.wait(1.0)
        printer.session.stop()
        if command:
            with pytest.raises(GcodeError):
                printer.session.finish(command)
    printer.session.wait(1.0)
    if site in ("nozzle_pin", "by dock"):
        # Nothing is asked of somebody who has pressed the button
        assert user.dialog() is None
    assert "Internal error" not in "\n".join(printer.session.console)
    printer.session.restart("FIRMWARE_RESTART")
    assert printer.offset() == 0.0
    assert_ended(user, setup, step)
    user.begin()
    assert user.step() == STEPS[setup][0]


def by_hand(setup):
    """What is to be done where SAVE_CONFIG has refused."""
    return (
        "SAVE_CONFIG has written nothing; write the lines into section"
        f" [{SECTION[setup]}], in the file that has it, then RESTART."
    )


@SETUPS
def test_save_that_fails_loses_nothing(start, setup):
    user = user_of(start, setup, **SAVE_THAT_FAILS)
    printer = user.printer
    user.come_to("SAVE")
    values = [text for text in user.dialog().texts if "_position: " in text]
    assert len(values) >= 2
    assert "disk full" in user.refused("Save")
    assert user.step() == "SAVE"
    texts = user.dialog().texts
    assert texts[0].startswith("Not done: ") and "disk full" in texts[0]
    assert by_hand(setup) in texts
    assert [text for text in texts if "_position: " in text] == values
    lines = "\n".join(user.press("Abort"))
    assert "earlier values still wait for SAVE_CONFIG" in lines
    begin_again(user, setup)
    user.come_to("SAVE")
    assert by_hand(setup) not in user.dialog().texts
    printer.run(
        "SET_GCODE_VARIABLE MACRO=SAVE_CONFIG VARIABLE=fails VALUE=False"
    )
    printer.session.restart(user.dialog().gcode("Save"))
    assert user.dialog() is None
    assert_saved(printer, setup)


INCLUDED = {
    Z: {"switch_offset": "0.1"},
    DOCK: {
        "dock_position": "50, 300",
        "approach_position": "50, 262",
        "detach_position": "90, 300",
    },
}


@pytest.mark.every_host("SAVE_CONFIG is each host's own")
@SETUPS
def test_section_in_an_included_file(start, tmp_path, setup):
    """Which SAVE_CONFIG does not reach; the lines of the console are pasted."""
    path = tmp_path / "own.cfg"
    lines = [f"{name}: {value}" for name, value in INCLUDED[setup].items()]
    path.write_text("\n".join([f"[{SECTION[setup]}]", *lines, ""]))
    user = user_of(start, setup, **{f"include {path}": {}})
    printer = user.printer
    user.come_to("SAVE")
    # That of others waits, too
    printer.run("SET_GCODE_OFFSET Z=0.1\nZ_OFFSET_APPLY_ENDSTOP")
    text = user.refused("Save")
    # Kalico's own words have both values
    assert re.match(
        f"SAVE_CONFIG section '{SECTION[setup]}' option '{[*INCLUDED[setup]][0]}'.*"
        " conflicts with included value",
        text,
    )
    assert user.step() == "SAVE"
    texts = user.dialog().texts
    assert texts[0].startswith("Not done: SAVE_CONFIG section ")
    assert by_hand(setup) in texts
    assert "RESTART forgets what waits for sections stepper_z." in texts
    # To be copied as it stands
    console = "\n".join(printer.session.console)
    _, head, pasted = console.partition(f"\n// [{SECTION[setup]}]\n")
    pasted = (head + pasted).partition("\n// action")[0]
    path.write_text(pasted.replace("// ", "") + "\n")
    printer.session.restart("RESTART")
    assert_saved(printer, setup)
