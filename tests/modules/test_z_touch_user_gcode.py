"""The user's G-code of every section: when it runs, what it may leave, what it may not begin."""

from __future__ import annotations

import pytest

from simprinter import Fault
from simprinter.world import OozeSpec
from tools.kit.auto_z_offset import SENSOR
from tools.kit.carrying import ATTACH, AUTO, EXTRA, OVER, SECTION, SWITCH, Z
from tools.kit.extra_probe import CALIBRATE, CONTINUE, as_probe, lay
from tools.kit.product import GCODE, OPTIONS

MEMBRANE = "extra_probe membrane"
DETACH = ("DETACH_PROBE",)
# Section and option of all G-code of the user's
TEMPLATES = [
    (MEMBRANE if section == "extra_probe" else section, row.name)
    for section, rows in OPTIONS.items()
    for row in rows
    if row.kind == GCODE
]
# Each says how G-code is read there, and does what it was told to do
CODE = """
  {{% set move, user = printer.gcode_move, printer['gcode_macro USER'] %}}
  {{% set absolute = move.absolute_coordinates, move.absolute_extrude %}}
  {{% set modes = '%s %s' % absolute ~ ' %d' % (move.speed + 0.5) %}}
  {{% set z = '%s|%s' % (move.homing_origin.z, printer.toolhead.position.z) %}}
  RESPOND MSG='{0} {1}|{{modes}}|{{z}}'
  {{% if user.at in ('{0} {1}', 'all') %}}{{user.code}}{{% endif %}}"""
OFFSET = 0.123
# Twice the length of the probe (mm), where it may be attached or put away
TOP = 13.8
HIGH = ("clean_gcode", "before_switch_gcode", "end_gcode", "offset_gcode")
# Modes of before a command, as the status has them, and what its G-code sets instead
MODES = {
    "absolute": (
        "G90\nM82\nG1 F4000\nM220 S50",
        "True True 4000",
        "G91\nM83\nG1 F1234",
    ),
    "relative": (
        "G91\nM83\nG1 F4000\nM220 S50",
        "False False 4000",
        "G90\nM82\nG1 F1234",
    ),
}
# Who runs them
RUNS = [
    *(
        (("z_calibration", option), Z[:2])
        for option in ("start_gcode", "before_switch_gcode", "end_gcode")
    ),
    (("z_calibration", "clean_gcode"), Z[:1]),
    (("z_calibration", "offset_gcode"), Z[:1]),
    (("z_calibration", "error_gcode"), ("CALIBRATE_Z BED_POSITION=1",)),
    (("auto_z_offset", "prepare_gcode"), AUTO),
    ((MEMBRANE, "activate_gcode"), (*EXTRA, CONTINUE)),
    ((MEMBRANE, "deactivate_gcode"), (*EXTRA, CONTINUE)),
    *(
        (("dockable_probe", option), ("PROBE",))
        for option in (
            *("activate_gcode", "deactivate_gcode"),
            *("pre_attach_gcode", "attach_gcode", "post_attach_gcode"),
            *("pre_detach_gcode", "detach_gcode", "post_detach_gcode"),
        )
    ),
]
ROWS = [pytest.param(*row, id=" ".join(row[0])) for row in RUNS]


def test_each_option_has_a_row():
    assert {template for template, _ in RUNS} == {*TEMPLATES}


def ready(start, template=("", "")):
    """A homed printer, which runs that template if any."""
    changes = {
        "respond": {},
        "gcode_macro FAIL": {"gcode": "{action_raise_error('jammed')}"},
        "gcode_macro USER": {
            "variable_at": "''",
            "variable_code": "''",
            "gcode": "",
        },
    }
    for section, option in TEMPLATES:
        options = changes.setdefault(section, {})
        options[option] = CODE.format(section, option)
    changes["z_calibration"]["offset_gcode"] += (
        "\n  SET_GCODE_OFFSET Z={params.Z}"
    )
    changes["dockable_probe"]["samples"] = "1"
    scene = SWITCH
    if template[1] == "clean_gcode":
        # Each touch leaves less of it, and it comes out again
        scene = scene.with_world(ooze=OozeSpec(0.1, kept=0.7, rate=0.01))
        changes["z_calibration"]["samples"] = "6"
    return start(scene, changes).homed()


def tell(printer, at="", code=""):
    """Have the G-code of that option do this; all: each of them."""
    for variable, text in (("at", at), ("code", code.replace("\n", "\\n"))):
        printer.run(
            f"SET_GCODE_VARIABLE MACRO=USER VARIABLE={variable}"
            f" VALUE=\"'{text}'\""
        )


def begin(printer, command, modes="G90"):
    """The toolhead is over the point, a hand has done its part, and the modes are set."""
    # As low as that no probe is on it
    low = "G1 Z5\n" if command.startswith("CALIBRATE_Z") else ""
    printer.run(f"{OVER}{low}M400\nSET_GCODE_OFFSET Z={OFFSET} MOVE=0")
    printer.session.wait(10.0)
    if command == CONTINUE:
        printer.run(CALIBRATE)
        lay(printer)
    printer.machine.lay_membrane("EXTRA" in command)
    printer.run(f"SAVE_GCODE_STATE NAME=old\n{modes}")


def state(printer):
    """What a command leaves as it was."""
    move, head, config, membrane = printer.statuses(
        "gcode_move", "toolhead", "configfile", MEMBRANE
    ).values()
    modes = ("absolute_coordinates", "absolute_extrude", "speed")
    factors = ("speed_factor", "extrude_factor")
    return {
        **{name: round(move[name], 3) for name in (*modes, *factors)},
        "offset": list(move["homing_origin"]),
        "homed": head["homed_axes"],
        "limits": [head["max_accel"], head["max_velocity"]],
        "pending": dict(config["save_config_pending_items"]),
        "asks": membrane["waits_for"],
    }


def seen(lines):
    """By option, how its G-code found modes, G-code Z offset and toolhead Z, each time."""
    found = {}
    for line in lines:
        if line.startswith("echo: "):
            name, *told = line[len("echo: ") :].split("|")
            found.setdefault(tuple(name.rsplit(" ", 1)), []).append(told)
    return found


def assert_found(lines, modes):
    """Each began with the modes of before, whatever the last one has left, and high up."""
    for (section, option), times in seen(lines).items():
        for told, _, z in times:
            if section == "z_calibration" and option in HIGH:
                assert float(z) >= TOP - 0.01, option
            if section == "dockable_probe":
                # A trip may begin in the middle of any G-code
                assert told.split()[0] == "True"
                continue
            assert told == modes, (section, option)


def assert_lifted(printer):
    """The toolhead is up again."""
    printer.session.wait(2.0)
    tip = printer.machine.tip()
    assert printer.machine.truth.true_gap(tip.x, tip.y, tip.z) > 3.6


# What is left of a good run: what it has applied
APPLIES = (Z[0], "AUTO_Z_CALIBRATE", "AUTO_Z_TWIST SAMPLE_COUNT=2", CONTINUE)
WALK = (
    *(*Z, *ATTACH, *DETACH, "PROBE", *EXTRA, CONTINUE),
    *(*(c for c in AUTO if c != "AUTO_Z_HOME_Z"), "AUTO_Z_HOME_Z"),
)


@pytest.mark.parametrize("modes", MODES)
def test_modes_are_as_before_around_every_template(start, modes):
    before, status, others = MODES[modes]
    printer = ready(start)
    ran = set()
    tell(printer, "all", others)
    for command in WALK:
        begin(printer, command, before)
        was = {**state(printer), "asks": ""}
        lines = printer.run(command)
        if command == CONTINUE:
            printer.machine.lay_membrane(False)
            lines += printer.run(CONTINUE)
        now = state(printer)
        ran |= seen(lines).keys()
        assert_found(lines, status)
        if command in Z:
            # Heights in it are those of the nozzle
            offsets = [o for times in seen(lines).values() for _, o, _ in times]
            assert [float(offset) for offset in offsets] == pytest.approx(
                [0.0] * len(offsets), abs=1e-6
            )
        if command in APPLIES:
            for name in ("offset", "pending"):
                was[name] = now[name]
        assert now == was, command
    others = {"clean_gcode", "error_gcode"}
    assert {t for t in TEMPLATES if t[1] not in others} == ran


@pytest.mark.parametrize(("template", "commands"), ROWS)
def test_template_that_fails(start, template, commands):
    """After G91 and before G90: what comes next would drive anywhere."""
    printer = ready(start, template)
    section, option = template
    code = "{}\nFAIL"
    if section != "dockable_probe" and option != "error_gcode":
        code = "{}\nSET_GCODE_OFFSET Z=0.9 MOVE=0\nFAIL"
    for command in commands:
        for before, status, others in MODES.values():
            begin(printer, command, before)
            tell(printer, " ".join(template), code.format(others))
            was, lines = state(printer), len(printer.session.console)
            text = printer.fail(command)
            lines = printer.session.console[lines:]
            if option == "error_gcode":
                # The first error stays it
                assert "jammed" not in text
                text = "\n".join(lines)
                assert "after the error: error_gcode: " in text
            assert "jammed" in text
            assert f"{option}: " in text
            assert template in seen(lines)
            assert_found(lines, status)
            if section == "z_calibration":
                # What undoes start_gcode, and what tells somebody
                ran = [name for _, name in seen(lines)]
                assert ran[-1] == "error_gcode"
                assert "end_gcode" in ran or option == "error_gcode"
                assert not printer.status("z_calibration")["last_query"]
            assert state(printer) == {**was, "asks": ""}
            assert_lifted(printer)
            # A state that was saved is as it was, and the next run goes well
            printer.run("SET_GCODE_OFFSET Z=0\nRESTORE_GCODE_STATE NAME=old")
            assert printer.offset() == pytest.approx(OFFSET)
            tell(printer)
            if option not in ("clean_gcode", "error_gcode"):
                begin(printer, command)
                printer.run(command)
        if command == "AUTO_Z_HOME_Z":
            printer.run("G28")


# By scene: changes, what is run first, and where the toolhead is between places (mm)
ALONG = {
    "calibrate_start_x": "20",
    "calibrate_end_x": "225",
    "calibrate_y": "126.75",
}
STOW = "\n  RESPOND MSG='{} at {{printer.toolhead.position.z|round(2)}}'"
PROBE = {
    "deactivate_gcode": STOW.format("stow"),
    "deactivate_on_each_sample": "False",
}
END = {"respond": {}, "z_calibration": {"end_gcode": STOW.format("end")}}
_MEMBRANE = as_probe()
_MEMBRANE["probe"].update(PROBE)
HOSTS = {
    "voron": ({**END, "probe": PROBE}, "", TOP),
    "qidi": (
        {"respond": {}, "probe": PROBE, "axis_twist_compensation": ALONG},
        *("", SENSOR + 5.0),
    ),
    "membrane": (
        {"respond": {}, **_MEMBRANE},
        *("EXTRA_PROBE_CALIBRATE PROBE=probe", 10.0),
    ),
}
SESSIONS = [
    ("voron", "CALIBRATE_Z", ("nozzle_pin", "body_pin", "probe_bed")),
    ("voron", "CALIBRATE_Z_ACCURACY CYCLES=2", ("probe_bed",)),
    ("qidi", "AUTO_Z_MEASURE_OFFSET", ("inductive_bed",)),
    ("qidi", "AUTO_Z_CALIBRATE", ("inductive_bed",)),
    ("qidi", "AUTO_Z_TWIST SAMPLE_COUNT=2", ("inductive_bed",)),
    ("membrane", "EXTRA_PROBE_CONTINUE PROBE=probe", ("nozzle_membrane",)),
]


@pytest.mark.parametrize(
    ("scene", "command", "site"),
    [
        (scene, command, site)
        for scene, command, sites in SESSIONS
        for site in ("", *sites)
    ],
)
def test_toolhead_is_up_where_a_session_ends(start, scene, command, site):
    """deactivate_gcode of [probe] may stow or dock it, and end_gcode may."""
    changes, before, top = HOSTS[scene]
    touch = 1 if command == "AUTO_Z_MEASURE_OFFSET" else 2
    about = {"site": site, "touch": touch, "command": command.split()[0]}
    faults = [Fault("trigger_never", **about)] if site else []
    printer = start(scene, changes, faults).homed()
    for touched in (site, "body_bed", "nozzle_bed"):
        printer.machine.tolerate(touched, 2.0)
    printer.run(before)
    if before:
        lay(printer)
    begun = len(printer.session.console)
    (printer.fail if site else printer.run)(command)
    lines = [
        line[len("echo: ") :].split(" at ")
        for line in printer.session.console[begun:]
        if line.startswith("echo: ")
    ]
    names = [name for name, _ in lines]
    # The probe was not used before it has met the pin
    touched = [] if site in ("nozzle_pin", "body_pin") else ["stow"]
    ends = ["end"] if scene == "voron" else []
    assert list(dict.fromkeys(names)) == touched + ends
    assert names[-1:] == (ends or touched)
    assert min(float(z) for _, z in lines) >= top - 0.02


UNDER_WAY = (
    "{}: a measurement is under way ({}); start another one when it has ended"
)
PART = (
    "a command in {} needs the probe fetched or docked, which that is a part of"
)
OF_SECTION = {
    **{section: [] for section, _ in TEMPLATES},
    "dockable_probe": [*ATTACH, *DETACH, "PROBE"],
}
for _command in (*Z, "Z_CALIBRATION_SETUP", *AUTO, *EXTRA, CALIBRATE):
    OF_SECTION[SECTION[_command]].append(_command)


@pytest.mark.parametrize(("template", "commands"), ROWS)
def test_measurement_inside_a_measurement(start, template, commands):
    section, option = template
    printer = ready(start, template)
    if section == "dockable_probe":
        words = PART.format(option)
    else:
        phases = {MEMBRANE: "touch", "offset_gcode": "end_gcode"}
        phase = phases.get(section, phases.get(option, option))
        words = UNDER_WAY.format(section, phase)
    for command in OF_SECTION[section]:
        begin(printer, commands[0])
        tell(printer, " ".join(template), command)
        was, lines = state(printer), len(printer.session.console)
        text = printer.fail(commands[0])
        if option == "error_gcode":
            text = "\n".join(printer.session.console[lines:])
        assert words in text, command
        assert state(printer) == was
        assert_lifted(printer)
    if section in ("z_calibration", "auto_z_offset"):
        assert printer.status(section)["phase"] == "idle"
    tell(printer)
    if option not in ("clean_gcode", "error_gcode"):
        begin(printer, commands[0])
        printer.run(commands[0])
