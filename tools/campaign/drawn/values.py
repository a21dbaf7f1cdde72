"""Values of options: of the tables of the sections, and of real printers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Optional

from tools.kit import corpus
from tools.kit.product import GCODE, OPTIONS, options
from tools.kit.scenes import Scene

# Section, option, and what may be written there
Choice = tuple[str, str, Sequence[Optional[str]]]

TABLES = {
    "z_calibration": OPTIONS["z_calibration"],
    "auto_z_offset": OPTIONS["auto_z_offset"],
    "dockable_probe": OPTIONS["dockable_probe"],
    "extra_probe membrane": OPTIONS["extra_probe"],
}
# What an owner says of a probe that comes and goes; None: nothing
HOOKS = (
    None,
    "ATTACH_PROBE",
    "DETACH_PROBE",
    "M117 x",
    "SET_GCODE_OFFSET Z=0.05",
    # A macro around it, and one that fails between its modes where the probe does
    "FETCH",
    "G91\n  G1 Z2 F600\n  ATTACH_PROBE\n  G90",
)
# A macro asks whether all is ready, and says no
NOT_READY = "the bed is cold"
ASKS = "G91\n  G1 Z2 F600\n  READY\n  G90"
# Some park the toolhead when all is done
PARKS = ("DETACH_PROBE\n  G1 X150 Y150 F9000", "M117 x\n  G1 X150 Y150 F9000")
# G-code that the tables know nothing of
OWN: dict[str, dict[str, Sequence[Optional[str]]]] = {
    "z_calibration": {
        "start_gcode": (*HOOKS, ASKS),
        "before_switch_gcode": (*HOOKS, ASKS),
        "end_gcode": (*HOOKS, *PARKS),
        "clean_gcode": ("M117 x", "G91"),
        "error_gcode": ("M117 x", "G28 X"),
        "bed_spread": ("3",),
        # As wide and as narrow as real ones are, tests/corpus; none that refuses
        # what a healthy printer finds
        "offset_margins": (
            "-5, 5",
            "-4, 4",
            "-10, 10",
            "-4, 6",
            "-3, 1",
            "-1.5, 1",
            "-1, 1",
        ),
    },
    "auto_z_offset": {
        # Down to where the nozzle is free, whatever hangs on the toolhead
        "prepare_gcode": ("G90\n  G0 Z3\n  M400", "G91\n  G0 Z-1\n  G90"),
    },
    "dockable_probe": {
        "z_hop": ("0", "15"),
        # Out of reach
        "safe_z_position": ("150, 350",),
        "detach_dockable_before_z_home": ("True", "False"),
        "allow_delayed_detach": ("True", "False"),
        "activate_gcode": ("M117 x", "G91"),
        "deactivate_gcode": ("M117 x", "M83"),
    },
    "extra_probe membrane": {
        "activate_gcode": ("M117 x", "M83"),
        "deactivate_gcode": ("M117 x", "M83"),
    },
}
# What is so of the machine, and what was measured of it: not for its owner to choose
OF_MACHINE = (
    "pin",
    "position",
    "offset",
    "offsets",
    "correction",
    "position_min",
    "probe_z_min",
    "saved_homing_z",
    "max_temperature",
    "nozzle_growth",
    "dock_fixed_z",
    "check_open_attach",
    "safe_dock_distance",
    # Other names, and what follows from the machine
    "history",
    "history_runs",
    "max_deviation",
    "save_button",
    "fixed",
    "z_current_factor",
)
# Numbers of which some are another way to go on, and words that only say how
# touches are taken together
SWITCHES = ("z_hop", "bed_spread")
OF_TOUCHES = ("sample", "result")
BEFORE_Z = "detach_dockable_before_z_home"
# False leaves the toolhead beside the dock
STAYS = ("restore_toolhead", "return_to_last_probe_position_after_detach")
# Sections of which there are real ones, see tests/corpus
OF_CORPUS = ("z_calibration", "auto_z_offset", "dockable_probe")


# Of Klipper's own sections, by what real printers have in them; OF_Z is the one with
# the endstop of Z, whatever its name is
OF_Z = "z"
OF_KLIPPER = {
    "probe": (
        "speed",
        "lift_speed",
        "samples",
        "samples_result",
        "sample_retract_dist",
        "samples_tolerance",
    ),
    OF_Z: ("homing_speed", "second_homing_speed", "homing_retract_dist"),
}
# How fast something is touched, and what no owner who says nothing goes beyond (mm/s)
TOUCH_SPEEDS = ("speed", "probing_speed", "homing_speed", "second_homing_speed")
USUAL_SPEED = 10.0


def kind_of(choice: Choice) -> str:
    """Hooks, switches and numbers: of each some are chosen.

    What a number is changes how long a way is; where the probe hangs, who moves
    and where to follows from the others.
    """
    section, option, found = choice
    if section in OF_KLIPPER:
        return "speed"
    if option.endswith("_gcode"):
        return "hook"
    if any(word in option for word in OF_TOUCHES):
        return "number"
    is_word = not any(_is_number(value) for value in found)
    return "switch" if is_word or option in SWITCHES else "number"


def _is_number(value: Optional[str]) -> bool:
    return bool(value) and value.replace(".", "", 1).isdigit()


def _is_left_of_dock(scene: Scene) -> bool:
    """Whether homing, to the right, goes across the dock from where it is left."""
    dock = scene.sections.get("dockable_probe") or {}
    places = [dock.get(f"{name}_position") for name in ("detach", "dock")]
    detach, middle = (float((at or "0").split(",")[0]) for at in places)
    return detach < middle


def choices(scene: Scene) -> list[Choice]:
    """All that a machine's owner may write into the sections that it has."""
    found = [
        (section, option, values)
        for section in TABLES
        if section in scene.sections
        for option, values in _of_section(section).items()
    ]
    found += [
        (section, option, real)
        for section, names in OF_KLIPPER.items()
        if section in ("probe", OF_Z) and _has(scene, section)
        for option in names
        for real in [_of_context(section, option)]
    ]
    pin, bed = scene.world.pin, scene.world.bed
    if pin is not None and pin.y < bed.y_min:
        # There the probe would be over the bed when Z is homed
        found = [row for row in found if row[1] != BEFORE_Z]
    if _is_left_of_dock(scene):
        # What Klipper's start tells of it its owner heeds
        found = [row for row in found if row[1] not in STAYS]
    if scene.world.dock is not None:
        return found
    # Whatever brings that probe is not for its owner to choose
    kept = [row for row in found if not row[1].endswith("_gcode")]
    others = [hook for hook in HOOKS if hook and "PROBE" not in hook]
    given = scene.sections.get("z_calibration") or {}
    if given and "end_gcode" not in given:
        kept.append(("z_calibration", "end_gcode", others))
    return kept


@lru_cache(maxsize=None)
def _of_section(section: str) -> dict[str, Sequence[Optional[str]]]:
    found: dict[str, Sequence[Optional[str]]] = dict(OWN.get(section, {}))
    for row in TABLES[section]:
        values = of_row(row)
        if values and row.name not in found and not is_of_machine(row.name):
            found[row.name] = values
    for name, values in _of_corpus(section).items():
        found[name] = tuple(dict.fromkeys((*found.get(name, ()), *values)))
    return found


def is_of_machine(name: str) -> bool:
    """Whether an owner cannot choose it."""
    return name in OF_MACHINE or name.split("_")[-1] in OF_MACHINE[:5]


def of_row(row: Any) -> Sequence[str]:
    """Some that its table allows."""
    if row.kind is options.SAMPLES:
        return ("1", "3", "auto")
    if row.kind.words:
        return tuple(row.kind.words)
    if row.kind is options.COUNT:
        low = row.limits.get("minval", 0)
        return tuple(
            f"{low + more:d}" for more in (0, 1, 2) if _may_be(row, low + more)
        )
    if row.kind is options.NUMBER:
        return tuple(
            f"{value:g}" for value in _around(row) if _may_be(row, value)
        )
    return ()


def _may_be(row: Any, value: float) -> bool:
    """Whether a row's limits allow it."""
    limits = row.limits
    return (
        value >= limits.get("minval", value)
        and value <= limits.get("maxval", value)
        and value > limits.get("above", value - 1.0)
        and value < limits.get("below", value + 1.0)
    )


def _around(row: Any) -> Iterator[float]:
    """Half and twice the default; of 0 a tenth of what the limits leave."""
    default = row.default
    if isinstance(default, options.Given):
        default = default.else_
    if not isinstance(default, (int, float)):
        return
    if default:
        yield from (0.5 * default, 2.0 * default)
        return
    ends = [row.limits.get(name) for name in ("maxval", "below")]
    yield 0.1 * next((end for end in ends if end is not None), 10.0)


def _has(scene: Scene, section: str) -> bool:
    return section == OF_Z or section in scene.sections


@lru_cache(maxsize=None)
def _of_context(section: str, option: str) -> Sequence[Optional[str]]:
    """What real printers have there beside one of our sections."""
    name = "stepper_z" if section == OF_Z else section
    found = {
        entry.section(name).get(option, "").strip()
        for module in OF_CORPUS
        for entry in corpus.load(module)
    }
    return sorted(text for text in found if _is_value(text))


def _is_value(text: str) -> bool:
    """Whether it is a number or a word, and no mistake of its owner's."""
    return bool(text) and not set(text) & set(", \n#{")


@lru_cache(maxsize=None)
def _of_corpus(section: str) -> dict[str, tuple[str, ...]]:
    """What real printers have there."""
    if section not in OF_CORPUS:
        return {}
    rows = {row.name: row for row in TABLES[section]}
    old = {name: row for row in rows.values() for name in row.old}
    found: dict[str, dict[str, None]] = {}
    for entry in corpus.load(section):
        for name, text in entry.options.items():
            row = rows.get(name) or old.get(name)
            if row is None or row.kind is GCODE or is_of_machine(name):
                continue
            # Some files say in words what they leave to the default
            if text and not set(text) & set(", \n"):
                found.setdefault(name, {})[text] = None
    return {name: tuple(values) for name, values in found.items()}
