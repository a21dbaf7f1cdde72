"""What is done on a walk, one step after the other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import lru_cache
from typing import Any

from hypothesis import strategies as st

from tools.campaign.breaking import BEGIN, SENSOR_FAULTS, TRIP_FAULTS, Break
from tools.campaign.drawn import card
from tools.campaign.drawn.covering import Row
from tools.campaign.drawn.printers import POINT, Owned, printers
from tools.kit.carrying import POINT as MEMBRANE

# A step is its kind and what with: JSON, and readable
Step = tuple[str, Any]
# Two commands, of two clients at once, or straight after each other as in a macro
MANY = ("both", "macro")

AWAY = "SAVE_GCODE_STATE NAME=away\nG90\nG1 Z%g F1200\nG1 X%g Y%g F9000\nM400\n"
AWAY += "RESTORE_GCODE_STATE NAME=away"
# What a print does: the first layer, 0.3 mm above the bed
PRINT = "G90\nG1 Z15 F1200\nG1 X%g Y%g F9000\nG1 Z0.3 F600\nG1 X%g F3000\nG1 Z20 F1200"

SHIFTED = "G92 Z10"
# Of Klipper, on each printer
HOST = (
    "G28",
    "G28 X",
    "G28 X Y",
    "G28 Z",
    "M84",
    "G90",
    "G91",
    "M83",
    SHIFTED,
    "SET_GCODE_OFFSET Z=0.1",
    "SET_GCODE_OFFSET Z=0",
    "SET_GCODE_OFFSET Z_ADJUST=-0.05 MOVE=0",
    "SAVE_GCODE_STATE NAME=mine",
    "RESTORE_GCODE_STATE NAME=mine",
    "ABORT",
    "ACCEPT",
    "TESTZ Z=0.1",
    "STATUS",
    "M220 S150",
    "GET_POSITION",
    "SET_VELOCITY_LIMIT ACCEL=1500",
)
# An owner probes over the bed
OVER_BED = AWAY % (20, *POINT)
PAPER = f"{OVER_BED}\nPROBE_CALIBRATE"
PAPER_MESH = "BED_MESH_CALIBRATE METHOD=manual"
PROBE = (
    "QUERY_PROBE",
    *(f"{OVER_BED}\n{name}" for name in ("PROBE", "PROBE_ACCURACY SAMPLES=3")),
    PAPER,
    f"{OVER_BED}\nMANUAL_PROBE",
    "Z_OFFSET_APPLY_PROBE",
)
# Whoever tries a dock out does not home in it, nor from behind it
OUT = "MOVE_AVOIDING_DOCK X=150 Y=150 SPEED=100"
OVER_MEMBRANE = AWAY % (20, *MEMBRANE)
TWIST = "AXIS_TWIST_COMPENSATION_CALIBRATE"
# What a slicer says of an object
PART = "EXCLUDE_OBJECT_DEFINE NAME=part CENTER=150,120 POLYGON="
PART += "[[120,100],[180,100],[180,140],[120,140]]"
# By the section that has them
OF_SECTION = {
    "z_calibration": (
        "CALIBRATE_Z",
        "CALIBRATE_Z",
        "CALIBRATE_Z BED_POSITION=100,120",
        "CALIBRATE_Z Z_ADJUST=0.03",
        "CALIBRATE_Z SAMPLES=2 PROBE_SPEED=2 SAMPLE_RETRACT_DIST=4",
        "CALIBRATE_Z SAMPLES_TOLERANCE=0.05 SAMPLES_RESULT=median",
        "CALIBRATE_Z_ACCURACY CYCLES=2",
        "CALIBRATE_Z_ACCURACY CYCLES=2 ATTACH=0",
        "CALIBRATE_Z_ACCURACY CYCLES=2 HOME=1",
        "PROBE_Z_ACCURACY SAMPLES=3",
        "Z_CALIBRATION_WAIT MAX=2",
        "Z_CALIBRATION_NOZZLE_GROWTH TEMPS=50,70,90",
        "CALCULATE_SWITCH_OFFSET",
        "Z_CALIBRATION_SAVE_GCODE_OFFSET",
        "Z_CALIBRATION_SAVE_GCODE_OFFSET SAVE=0 FORCE=1",
        "Z_CALIBRATION_SETUP",
        "Z_CALIBRATION_SETUP STEP=HOME",
        "Z_CALIBRATION_SETUP STEP=LOOK ANSWER=AGAIN",
        "Z_CALIBRATION_SETUP X=5 Y=-5",
        "Z_CALIBRATION_REPORT",
    ),
    "auto_z_offset": (
        "AUTO_Z_CALIBRATE",
        "AUTO_Z_CALIBRATE",
        "AUTO_Z_CALIBRATE ACCEPT_CHANGE=1",
        # At the place where the toolhead is, so not over the pin of Z
        f"{OVER_BED}\nAUTO_Z_PROBE",
        "AUTO_Z_HOME_Z",
        "AUTO_Z_MEASURE_OFFSET",
        "AUTO_Z_TWIST SAMPLE_COUNT=2",
        "AUTO_Z_WAIT MAX=2",
        "AUTO_Z_LOAD_OFFSET",
        "AUTO_Z_SAVE_GCODE_OFFSET",
    ),
    "dockable_probe": (
        *(f"MOVE_TO_{name}_PROBE\n{OUT}" for name in ("APPROACH", "DOCK")),
        *(f"MOVE_TO_{name}_PROBE\n{OUT}" for name in ("EXTRACT", "INSERT")),
        f"MOVE_TO_DETACH_PROBE\n{OUT}",
        "ATTACH_PROBE",
        "DETACH_PROBE",
        "MOVE_AVOIDING_DOCK X=150 Y=150 SPEED=200",
        f"MOVE_AVOIDING_DOCK X=20 Y=300 SPEED=200\n{OUT}",
        "MOVE_AVOIDING_DOCK X=999 Y=150",
        "QUERY_DOCKABLE_PROBE",
        "GET_PROBE_STATUS",
        "SET_PROBE_STATUS STATE=DOCKED",
        "DOCKABLE_PROBE_SETUP",
        "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0",
        "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=1",
    ),
    "extra_probe membrane": (
        f"{OVER_MEMBRANE}\nEXTRA_PROBE PROBE=membrane",
        f"{OVER_MEMBRANE}\nEXTRA_PROBE_ACCURACY PROBE=membrane SAMPLES=3",
        f"{OVER_MEMBRANE}\nEXTRA_PROBE PROBE=membrane SAMPLES=3 PROBE_SPEED=2",
        "EXTRA_PROBE_CALIBRATE PROBE=membrane",
        "EXTRA_PROBE_CALIBRATE PROBE=membrane SAVE=1",
        "EXTRA_PROBE_CALIBRATE PROBE=membrane FLOOR=-0.5",
        "EXTRA_PROBE_CONTINUE PROBE=membrane QUESTION=removal",
        "EXTRA_PROBE_CONTINUE PROBE=membrane",
        "EXTRA_PROBE_ABORT PROBE=membrane",
        "QUERY_EXTRA_PROBE PROBE=membrane",
    ),
    "quad_gantry_level": ("QUAD_GANTRY_LEVEL",),
    "z_tilt": ("Z_TILT_ADJUST",),
    "screws_tilt_adjust": ("SCREWS_TILT_CALCULATE",),
    "bed_mesh": (
        "BED_MESH_CALIBRATE",
        PAPER_MESH,
        "BED_MESH_CLEAR",
        "BED_MESH_PROFILE LOAD=default",
        "BED_MESH_PROFILE SAVE=default",
    ),
    "axis_twist_compensation": (TWIST,),
    "pause_resume": ("PAUSE", "RESUME", "CANCEL_PRINT"),
}
WITH_PROBE = (
    "quad_gantry_level",
    "z_tilt",
    "screws_tilt_adjust",
    "bed_mesh",
    "axis_twist_compensation",
)
OF_PROBE = ("mesh", "mesh_zero", "screws", "twist", "exclude", "wrapped_probe")
OF_FEATURE = {
    "mesh": OF_SECTION["bed_mesh"],
    "mesh_zero": OF_SECTION["bed_mesh"],
    "screws": OF_SECTION["screws_tilt_adjust"],
    "pause": OF_SECTION["pause_resume"],
    "twist": OF_SECTION["axis_twist_compensation"],
    # Older Klippers know nothing of ADAPTIVE, and mesh the whole bed
    "exclude": (f"{PART}\nBED_MESH_CALIBRATE ADAPTIVE=1", "EXCLUDE_OBJECT"),
    "retraction": ("G10", "G11"),
    "variables": ("SAVE_VARIABLE VARIABLE=z VALUE=1",),
    "idle": ("SET_IDLE_TIMEOUT TIMEOUT=20",),
    "skew": ("SET_SKEW XY=100.5,99.5,70.7", "SET_SKEW CLEAR=1"),
    "heat": ("SET_Z_THERMAL_ADJUST ENABLE=0", "SET_Z_THERMAL_ADJUST ENABLE=1"),
    "shaper": ("SET_INPUT_SHAPER SHAPER_FREQ_X=60",),
    "hot": ("M104 S150", "M140 S50", "M104 S0\nM140 S0"),
    "wrapped_probe": (f"{OVER_BED}\nPROBE",),
}
# What is calibrated with before a first layer
PRINTED = {"z_calibration": "CALIBRATE_Z", "auto_z_offset": "AUTO_Z_CALIBRATE"}
HANDS_OF_DOCK = ("put_probe_on", "lose_probe", "take_probe_off")
HANDS_OF_DOCK += ("bring_probe_back",)
HANDS_OF_MEMBRANE = ("lay_membrane", "take_membrane", "press_membrane")
# What a calibration leaves, what may shift Z in between, and what uses it
MEASURES = ("CALIBRATE_Z", "AUTO_Z_CALIBRATE")
SHIFTS = (
    "G28",
    SHIFTED,
    "AUTO_Z_HOME_Z",
    "BED_MESH_CALIBRATE",
    "BED_MESH_CLEAR",
    "BED_MESH_PROFILE LOAD=default",
    "QUAD_GANTRY_LEVEL",
    "RESTORE_GCODE_STATE NAME=mine",
    "SET_GCODE_OFFSET Z=0.1",
    "SET_SKEW XY=100.5,99.5,70.7",
    "Z_TILT_ADJUST",
)
USES = (
    "AUTO_Z_LOAD_OFFSET",
    "AUTO_Z_SAVE_GCODE_OFFSET",
    "Z_CALIBRATION_SAVE_GCODE_OFFSET",
)
# Commands of ours that touch, fetch or dock; none of these homes with a switch, where
# no floor of ours is
BREAKABLE = frozenset(
    (
        "CALIBRATE_Z",
        "CALIBRATE_Z_ACCURACY",
        "PROBE_Z_ACCURACY",
        "Z_CALIBRATION_WAIT",
        "Z_CALIBRATION_NOZZLE_GROWTH",
        "AUTO_Z_CALIBRATE",
        "AUTO_Z_PROBE",
        "AUTO_Z_HOME_Z",
        "AUTO_Z_MEASURE_OFFSET",
        "AUTO_Z_TWIST",
        "AUTO_Z_WAIT",
        "EXTRA_PROBE",
        "EXTRA_PROBE_ACCURACY",
        "ATTACH_PROBE",
        "DETACH_PROBE",
    )
)
# Of these without a section of Klipper's nothing moves
NEEDS = {"Z_CALIBRATION_NOZZLE_GROWTH": "hot", "AUTO_Z_TWIST": "twist"}
# What a finger presses, of what a machine has
PRESSED = ("probe", "z_endstop", "nozzle_endstop", "bed_sensor")
# What a print takes, whoever sends it
WHILE_PRINTING = (
    "STATUS",
    "M117 x",
    "SET_GCODE_OFFSET Z_ADJUST=0.02 MOVE=1",
    "PAUSE",
    "CANCEL_PRINT",
)
# Ours that do not want the toolhead, or have to say that somebody prints
OURS_WHILE_PRINTING = {
    "z_calibration": ("Z_CALIBRATION_SETUP", "CALIBRATE_Z"),
    "auto_z_offset": ("AUTO_Z_CALIBRATE", "AUTO_Z_SAVE_GCODE_OFFSET"),
    "dockable_probe": ("DETACH_PROBE", "DOCKABLE_PROBE_SETUP"),
    "extra_probe membrane": ("QUERY_EXTRA_PROBE PROBE=membrane",),
}


def gcode_of(printer: Owned) -> list[str]:
    """All that its console takes."""
    found = list(HOST)
    if printer.is_overridden:
        # Hosts that home with the probe keep it, and the macro's own ways go by it
        found.remove(SHIFTED)
    probe = printer.scene.world.mag_probe
    # Klipper does not know of a probe that macros bring, and takes the nozzle
    probes = probe is None or probe.mode != "output"
    sections = set(printer.scene.sections)
    if sections & {"probe", "dockable_probe"} and probes:
        found += PROBE
    over = over_membrane(printer)
    for section, commands in OF_SECTION.items():
        if section in sections and (probes or section not in WITH_PROBE):
            found += [text.replace(OVER_MEMBRANE, over) for text in commands]
    for name in sorted(printer.names):
        if probes or name not in OF_PROBE:
            found += OF_FEATURE.get(name, ())
    return found


def over_membrane(printer: Owned) -> str:
    """The way to where it lies, or to the switch that is fixed."""
    world = printer.scene.world
    # Where there is no membrane, the pin is what [extra_probe] touches
    spec = world.membrane or (
        world.pin if printer.has("extra_probe membrane") else None
    )
    return AWAY % (20, spec.x, spec.y) if spec else OVER_MEMBRANE


def _hands_of(printer: Owned) -> list[str]:
    world = printer.scene.world
    found: list[str] = []
    if world.dock is not None:
        found += HANDS_OF_DOCK
    if world.membrane is not None:
        found += HANDS_OF_MEMBRANE
    signals = set(printer.scene.wiring.inputs)
    return [*found, *(f"press_{name}" for name in PRESSED if name in signals)]


@lru_cache(maxsize=None)
def _one(kind: str, *values: Any) -> st.SearchStrategy:
    """A step of that kind, in a row that goes on."""
    step = st.tuples(st.just(kind), st.sampled_from(values))
    return step.map(lambda found: (found,))


def _row(*parts: st.SearchStrategy) -> st.SearchStrategy:
    """One after the other."""
    return st.tuples(*parts).map(lambda found: sum(found, ()))


def _singles(printer: Owned) -> list[st.SearchStrategy]:
    """What may be done at any time."""
    commands = gcode_of(printer)
    own = [text for text in commands if text not in HOST]
    home = _one("gcode", "G28")
    kinds = [
        # Ours more often than what every printer has
        *[_one("gcode", *own)] * 10,
        *[_one("gcode", *commands)] * 3,
        *[home] * 2,
        _one("wait", 1, 5, 40, 200),
        _one("away", (20, 70, 60), (40, 200, 220)),
        _one("lower", 0.5, 3.0),
        _one("answer", 0, 1, 2, 3),
        _one("late", 0, 1),
        # Whoever goes on homes, mostly
        _row(_one("restart", "RESTART", "FIRMWARE_RESTART"), home),
        _one("restart", "RESTART", "FIRMWARE_RESTART"),
        _row(_one("save", "SAVE_CONFIG"), home),
    ]
    pairs = st.tuples(st.sampled_from(own), st.sampled_from(commands))
    for kind in MANY:
        kinds.append(st.tuples(st.just(kind), pairs).map(lambda step: (step,)))
    if "heat" in printer.names:
        kinds.append(_one("heat", 75, 25))
    hands = _hands_of(printer)
    if hands:
        kinds.append(_one("hand", *hands))
    return kinds


def _prints(printer: Owned) -> list[st.SearchStrategy]:
    found = []
    # A probe that nobody ever takes off is in the way of every print
    probe = printer.scene.world.mag_probe
    printed = [v for k, v in PRINTED.items() if printer.has(k)]
    if printer.scene.world.pin is not None:
        # A correction of the probe's heights is no offset of the pin's
        printed = [text for text in printed if text != "AUTO_Z_CALIBRATE"]
    if probe is not None and probe.mode == "fixed":
        printed = []
    if printed:
        # Heating may take a while before the first layer
        starts = [(text, pause) for text in printed for pause in (0, 10)]
        found.append(_one("print", *starts))
    if card.can_print(printer):
        ours = [
            text
            for section, texts in OURS_WHILE_PRINTING.items()
            if printer.has(section)
            for text in texts
        ]
        meanwhile = [text for text in WHILE_PRINTING if _has(printer, text)]
        cards = st.tuples(
            st.sampled_from((1, 20, 60, 150)),
            st.sampled_from(("", *meanwhile, *ours)),
            st.sampled_from(("RESUME", "CANCEL_PRINT")),
        )
        kinds = st.tuples(st.just("card"), cards)
        found.append(kinds.map(lambda step: (step,)))
    return found


def _has(printer: Owned, command: str) -> bool:
    """Whether it can be paused."""
    return command not in ("PAUSE", "CANCEL_PRINT") or "pause" in printer.names


def _uses_of_results(commands: Sequence[str]) -> list[st.SearchStrategy]:
    """Something between a calibration and what counts on its result."""
    measures, shifts, uses = (
        [text for text in commands if text in names]
        for names in (MEASURES, SHIFTS, USES)
    )
    if not measures or not uses:
        return []
    between = st.one_of(_one("gcode", *shifts), _one("gcode", *commands))
    return [_row(_one("gcode", *measures), between, _one("gcode", *uses))]


def _courses(printer: Owned) -> list[st.SearchStrategy]:
    """What belongs together: single steps hardly ever come in that order."""
    commands = gcode_of(printer)
    lower = st.lists(_one("lower", 0.5, 3.0), max_size=2)
    ends = _one("gcode", "ACCEPT", "ABORT", "TESTZ Z=0.1", "G28")
    # Whoever looks for the paper lets time pass
    looks = st.sampled_from(((), (("wait", 40),)))
    paper = _row(looks, lower.map(lambda found: sum(found, ())), ends)
    attaches = st.just(())
    if "ATTACH_PROBE" in commands:
        attaches = st.sampled_from(((), (("gcode", "ATTACH_PROBE"),)))
    meshes = st.just(())
    if "BED_MESH_CALIBRATE" in commands:
        meshes = st.sampled_from(((), (("gcode", "BED_MESH_CALIBRATE"),)))
    answers = st.lists(
        st.one_of(
            _one("answer", 0, 0, 1, 2), _one("twice", 0), _one("late", 0)
        ),
        min_size=1,
        max_size=8,
    ).map(lambda found: sum(found, ()))
    # Mostly what it asks for, once
    answered = st.sampled_from(range(8)).flatmap(
        lambda n: answers if n == 7 else _one("answer", 0)
    )
    saves = st.sampled_from(((), (("save", "SAVE_CONFIG"),)))
    # Nobody has to stand still while he is asked
    meanwhile = [(("away", (40, 200, 220)),)]
    if printer.scene.world.dock is not None:
        meanwhile.append((("hand", HANDS_OF_DOCK[0]),))
    away = st.sampled_from([*meanwhile, *[()] * 7])
    # Mostly what was under way is ended first
    fresh = st.sampled_from(range(4)).map(
        lambda n: () if n == 3 else (("gcode", "ABORT"), ("gcode", "G28"))
    )
    found = _uses_of_results(commands)
    if "ATTACH_PROBE" in commands:
        # On the toolhead, whatever comes next
        own = [text for text in commands if text not in HOST]
        nexts = _one("gcode", "G28", "G28 Z", *own)
        found.append(_row(_one("gcode", "ATTACH_PROBE"), nexts))
    papers = [text for text in (PAPER, PAPER_MESH) if text in commands]
    if papers:
        found.append(_row(attaches, _one("gcode", *papers), paper, saves))
    if TWIST in commands:
        found.append(_row(_one("gcode", TWIST), *[paper] * 3))
    for begins in ("Z_CALIBRATION_SETUP", "DOCKABLE_PROBE_SETUP"):
        if begins in commands:
            found.append(_row(_one("gcode", begins), answers, saves))
    if printer.has("extra_probe membrane"):
        found.append(
            _row(
                fresh,
                meshes,
                _one(
                    "gcode",
                    "EXTRA_PROBE_CALIBRATE PROBE=membrane SAVE=1",
                    "EXTRA_PROBE_CALIBRATE PROBE=membrane",
                ),
                _one("hand", *["lay_membrane"] * 3, "take_membrane"),
                _one("hand", "press_membrane"),
                away,
                answered,
                _one("hand", "take_membrane"),
                answered,
                saves,
            )
        )
    return found


def _breaks(printer: Owned) -> list[st.SearchStrategy]:
    """A fault in a command, and the same command when it is mended."""
    signals = sorted({"membrane", *PRESSED} & set(printer.scene.wiring.inputs))
    touches = [(kind, of) for kind in ("touch", "query") for of in signals]
    places = st.tuples(
        st.sampled_from([(BEGIN, ""), ("move", "xy"), ("move", "z"), *touches]),
        st.sampled_from((1, 2, 3, 5, 8)),
    ).map(lambda found: (*found[0], found[1]))
    sensors = st.tuples(
        st.sampled_from((*SENSOR_FAULTS, "trigger_never")),
        st.sampled_from(signals),
        places,
    )
    faults = [sensors]
    probe = printer.scene.world.mag_probe
    if probe is not None and probe.mode != "fixed":
        faults.append(st.tuples(st.just("probe_falls"), st.just(""), places))
    if printer.has("dockable_probe"):
        trips = st.sampled_from(sorted(TRIP_FAULTS.values()))
        faults.append(st.tuples(trips, st.just(""), st.just(("", "", 1))))
    names = printer.names
    ours = [text for text in gcode_of(printer) if is_breakable(text, names)]
    if not ours:
        return []

    def around(found: tuple[Any, str]) -> tuple[Step, ...]:
        (fault, subject, place), text = found
        what = Break(fault, subject, *place)
        broken = (("break", what), ("gcode", text), ("mend", fault))
        return (*broken, ("gcode", "G28"), ("gcode", text))

    both = st.tuples(st.one_of(faults), st.sampled_from(ours))
    return [both.map(around)]


def is_breakable(script: str, names: Collection[str]) -> bool:
    """Whether a switch may be dead meanwhile; names: sections that it may need."""
    words = script.splitlines()[-1].split()
    needs = NEEDS.get(words[0], "")
    is_there = not needs or needs in names
    return words[0] in BREAKABLE and "HOME=1" not in words and is_there


@lru_cache(maxsize=16)
def steps(printer: Owned) -> st.SearchStrategy:
    """What may be done on a printer, in any order: rows of one step or more."""
    courses = [*_courses(printer), *_prints(printer), *_breaks(printer) * 3]
    # One that is there more than once is more likely, other than with one_of()
    return st.sampled_from([*_singles(printer), *courses]).flatmap(
        lambda kind: kind
    )


def walks(row: Row) -> st.SearchStrategy:
    """A printer and 5 to 30 steps, the first of them a G28."""

    def with_steps(printer: Owned) -> st.SearchStrategy:
        later = st.lists(steps(printer), min_size=4, max_size=29)
        begins = later.map(
            lambda found: (("gcode", "G28"), *sum(found, ())[:29])
        )
        return st.tuples(st.just(printer), begins)

    return printers(row).flatmap(with_steps)


def first_layer() -> str:
    """Over the point that was measured."""
    x, y = POINT
    return PRINT % (x, y, x + 10.0)
