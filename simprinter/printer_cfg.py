"""Reads a printer.cfg as klippy does, and what it says of the machine.

Included files and what SAVE_CONFIG has added are part of it. A pin is spelled
as there, but never by an alias of [board_pins].
"""

from __future__ import annotations

import configparser
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Optional

from .mcu.pins import PINS, numbered
from .wiring import MAIN, Motor
from .world.spec import SECOND, TOWERS, TowerSpec

# Where SAVE_CONFIG begins, and what stands before each of its lines
_SAVED = "#*# <---------------------- SAVE_CONFIG ---------------------->"
_SAVED_LINE = "#*# "
_PIN = re.compile(r"([\^~!]*)(?:([^:]+):)?([^\^~!:#\"<>]*)")
# How klippy reaches a board
_OF_THE_LINE = (
    "serial",
    "baud",
    "canbus_uuid",
    "canbus_interface",
    "restart_method",
)
# Turns of a motor's shaft are counted in so many full steps, unless told
_FULL_STEPS = 200
_GEARS = re.compile(r"([\d.]+)\s*:\s*([\d.]+)")
# Degrees of the towers a, b and c, unless told
_ANGLES = (210.0, 330.0, 90.0)
# Kinematics with three towers
DELTA = "delta"
# Kinematics whose motors say themselves what they move
GENERIC = "generic_cartesian"
# What the motors x, y and z of a machine move, in klippy's words
_MOVED = {
    "cartesian": ("x", "y", "z"),
    "corexy": ("x+y", "x-y", "z"),
    "corexz": ("x+z", "y", "x-z"),
    "hybrid_corexy": ("x-y", "y", "z"),
    "hybrid_corexz": ("x-z", "y", "z"),
}


class PrinterCfgError(ValueError):
    """A printer.cfg that no klippy would take, or no machine can be made of."""


class PrinterCfg:
    """What one printer.cfg says; see `read`."""

    def __init__(self, name: str, sections: Mapping[str, Mapping[str, str]]):
        """name: for messages. sections: options by section."""
        self.name = name
        self.sections = sections
        self._aliases = dict(self._find_aliases())

    def _find_aliases(self) -> Iterator[tuple[tuple[str, str], str]]:
        for section, options in self.sections.items():
            if section.split()[0] != "board_pins":
                continue
            texts = [v for k, v in options.items() if k.startswith("aliases")]
            for board in options.get("mcu", MAIN).split(","):
                for text in ",".join(texts).split(","):
                    alias, is_pair, pin = map(str.strip, text.partition("="))
                    if is_pair and not pin.startswith("<"):
                        yield (board.strip(), alias), pin

    def error(self, section: str, option: str, told: str) -> PrinterCfgError:
        """What is wrong with an option, and what to do."""
        value = self.sections.get(section, {}).get(option)
        given = "is missing" if value is None else f"is {value!r}"
        return PrinterCfgError(
            f"{self.name}: [{section}] {option} {given}: {told}"
        )

    def get(self, section: str, option: str) -> Optional[str]:
        """An option as it is written; None where it is not."""
        return self.sections.get(section, {}).get(option)

    def number(
        self, section: str, option: str, default: Optional[float] = None
    ) -> float:
        """An option that is a number. Raises PrinterCfgError."""
        text = self.get(section, option)
        if text is None and default is not None:
            return default
        try:
            return float(text or "")
        except ValueError:
            told = "give it a number, as klippy needs one, too"
            raise self.error(section, option, told) from None

    def pin(self, section: str, option: str) -> Optional[str]:
        """A pin of a board; None where there is none, or a virtual one.

        The diag pin of a TMC driver stands for its virtual endstop. Raises
        PrinterCfgError for a pin that no simulated board has.
        """
        text = self.get(section, option)
        found = _PIN.fullmatch(re.sub(r"\s", "", text or ""))
        if found is None or not found[3]:
            return None
        modifiers, board, name = found[1], found[2] or MAIN, found[3]
        driver = self._driver_of(text or "")
        if driver:
            options = self.sections.get(driver, {})
            diag = next((o for o in options if re.match(r"diag\d?_pin", o)), "")
            return self.pin(driver, diag) if diag else None
        if board != MAIN and f"mcu {board}" not in self.sections:
            return None
        name = self._aliases.get((board, name), name)
        try:
            numbered(name)
        except ValueError:
            told = f"the simulated boards have {PINS}"
            raise self.error(section, option, told) from None
        return f"{modifiers}{'' if board == MAIN else board + ':'}{name}"

    def boards(self) -> list[str]:
        """The names of all boards beside the main one."""
        return [s[4:].strip() for s in self.sections if s.startswith("mcu ")]

    @property
    def kinematics(self) -> str:
        """As [printer] has it. Raises PrinterCfgError without."""
        name = self.get("printer", "kinematics")
        if name is None:
            raise self.error("printer", "kinematics", "klippy needs it")
        return name

    @property
    def second_carriage(self) -> Optional[str]:
        """The section of a second carriage on X, None where there is none.

        Raises PrinterCfgError for one that is on another axis.
        """
        for section in self.sections:
            if section.split()[0] != "dual_carriage":
                continue
            option = "axis"
            axis = self.get(section, option) or "x"
            if self.kinematics == GENERIC:
                option = "primary_carriage"
                first = self.axis_section("x").partition(" ")[2]
                axis = "x" if self.get(section, option) == first else ""
            if axis != "x":
                told = "only a second carriage on the axis x is simulated"
                raise self.error(section, option, told)
            return section
        return None

    def steppers(self) -> dict[str, str]:
        """The sections of the motors x, y, z, z1 ..., by these names.

        That of a second carriage is SECOND.
        """
        if self.kinematics == GENERIC:
            return self._steppers_of_carriages()
        if self.kinematics == DELTA:
            return {tower: f"stepper_{tower}" for tower in TOWERS}
        found = {
            section[len("stepper_") :]: section
            for section in self.sections
            if re.fullmatch(r"stepper_([xy]1?|z\d?)", section)
        }
        for axis in "xyz":
            if axis not in found:
                told = "the machine needs a motor for each axis"
                raise self.error(f"stepper_{axis}", "step_pin", told)
        second = self.second_carriage
        return found if second is None else {**found, SECOND: second}

    def towers(self) -> tuple[TowerSpec, ...]:
        """Those of a DELTA, in whose middle x and y are zero, none of another."""
        if self.kinematics != DELTA:
            return ()
        radius = self.number("printer", "delta_radius")
        arm = self.number("stepper_a", "arm_length")
        made = []
        for name, usual in zip(TOWERS, _ANGLES):
            section = f"stepper_{name}"
            angle = math.radians(self.number(section, "angle", usual))
            x, y = radius * math.cos(angle), radius * math.sin(angle)
            length = self.number(section, "arm_length", arm)
            if length <= radius:
                told = "klippy wants arms longer than delta_radius"
                raise self.error(section, "arm_length", told)
            made.append(TowerSpec(name, x, y, length))
        return tuple(made)

    def _steppers_of_carriages(self) -> dict[str, str]:
        moved = _MOVED[self.moved_like()]
        found: dict[str, str] = {}
        for section, carriages in self._carried().items():
            if carriages == SECOND:
                found[SECOND] = section
                continue
            axis = "xyz"[moved.index(carriages)]
            others = sum(name[0] == axis for name in found)
            found[f"{axis}{others or ''}"] = section
        return found

    def moved_like(self) -> str:
        """The kinematics whose motors move what those of a GENERIC one do.

        Raises PrinterCfgError where no simulated machine has such motors.
        """
        carried = self._carried()
        for name, moved in _MOVED.items():
            if {*carried.values()} - {SECOND} == {*moved}:
                return name
        told = (
            "no simulated machine has motors that move all of this; one has"
            " them for x, y and z, another for x+y, x-y and z"
        )
        section = next(iter(carried), "stepper")
        raise self.error(section, "carriages", told)

    def _carried(self) -> dict[str, str]:
        """What each stepper of a GENERIC machine moves, such as x+y."""
        axes = {self.axis_section(a).partition(" ")[2]: a for a in "xyz"}
        second = self.second_carriage
        if second is not None:
            axes[second.partition(" ")[2]] = SECOND
        return {
            section: re.sub(
                r"\w+",
                lambda found: axes.get(found[0], found[0]),
                re.sub(r"\s", "", options.get("carriages", "")),
            )
            for section, options in self.sections.items()
            if section.startswith("stepper ")
        }

    def axis_section(self, axis: str) -> str:
        """The section with the endstop and the ends of an axis.

        Raises PrinterCfgError where a GENERIC machine has no such carriage.
        """
        if self.kinematics != GENERIC:
            return f"stepper_{axis}"
        for section, options in self.sections.items():
            kind, _, name = section.partition(" ")
            if kind == "carriage" and options.get("axis", name) == axis:
                return section
        told = "the machine needs a carriage for each axis"
        raise self.error(f"carriage {axis}", "axis", told)

    def motors(self) -> dict[str, Motor]:
        """The pins and the step of each that moves something by itself.

        A second motor of X or Y does what the first does.
        """
        return {
            name: self._motor(section)
            for name, section in self.steppers().items()
            if name not in ("x1", "y1")
        }

    def _motor(self, section: str) -> Motor:
        pins = {}
        for option in ("step_pin", "dir_pin"):
            pin = self.pin(section, option)
            if pin is None:
                raise self.error(section, option, "give it a pin of a board")
            pins[option] = pin
        driver = next(
            (
                name
                for name in (f"tmc2209 {section}", f"tmc2208 {section}")
                if name in self.sections
            ),
            "",
        )
        return Motor(
            **pins,
            step_dist=self._step_dist(section),
            uart=self.pin(driver, "uart_pin") or "",
            address=int(self.number(driver, "uart_address", 0.0)),
            enable_pin=self.pin(section, "enable_pin") or "",
        )

    def _step_dist(self, section: str) -> float:
        """mm of one microstep."""
        turn = self.number(section, "rotation_distance")
        steps = self.number(section, "full_steps_per_rotation", _FULL_STEPS)
        microsteps = self._microsteps(section)
        ratio = 1.0
        for driving, driven in _GEARS.findall(
            self.get(section, "gear_ratio") or ""
        ):
            ratio *= float(driving) / float(driven)
        return turn / (steps * microsteps * ratio)

    def _microsteps(self, section: str) -> float:
        drivers = [s for s in self.sections if s.endswith(f" {section}")]
        for name in (section, *drivers):
            if self.get(name, "microsteps") is not None:
                return self.number(name, "microsteps")
        raise self.error(section, "microsteps", "klippy needs it")

    def for_klippy(
        self, left_out: frozenset[str]
    ) -> dict[str, Optional[Mapping[str, Optional[str]]]]:
        """All sections but these, with values that may have several lines.

        What says how a board is reached is left to whoever has its line. Where
        a driver is left out, its diag pin takes the place of its endstop.
        """
        kept: dict[str, Optional[Mapping[str, Optional[str]]]] = {}
        for section, options in self.sections.items():
            if section in left_out:
                continue
            is_board = section.split()[0] == "mcu"
            kept[section] = {
                option: value.replace("\n", "\n  ")
                for option, value in options.items()
                if not (is_board and option in _OF_THE_LINE)
            }
            driver = self._driver_of(options.get("endstop_pin", ""))
            if driver in left_out:
                diag = self.pin(section, "endstop_pin")
                kept[section] = {**kept[section], "endstop_pin": diag}
        return kept

    def _driver_of(self, pin: str) -> str:
        """The section of the TMC driver whose endstop a pin is, or ""."""
        found = re.search(r"(tmc\d+)_(\w+):virtual_endstop", pin)
        if found is None:
            return ""
        for section in self.sections:
            words = section.split()
            # [tmc2209 stepper my_x] is tmc2209_my_x, too
            if (words[0], words[-1]) == found.groups():
                return section
        return f"{found[1]} {found[2]}"


def read(path: Path) -> PrinterCfg:
    """Read a printer.cfg. Raises PrinterCfgError naming the file."""
    parser = _parser()
    saved: list[str] = []
    text = "\n".join(_lines(path, saved, ()))
    _feed(parser, text, path)
    if saved:
        later = _parser()
        _feed(later, "\n".join(saved), path)
        # What stands in the file itself comes first
        for section in later.sections():
            if not parser.has_section(section):
                parser.add_section(section)
            for option, value in later.items(section):
                if not parser.has_option(section, option):
                    parser.set(section, option, value)
    sections = {name: dict(parser.items(name)) for name in parser.sections()}
    return PrinterCfg(str(path), sections)


def _parser() -> configparser.RawConfigParser:
    return configparser.RawConfigParser(
        strict=False, inline_comment_prefixes=(";", "#")
    )


def _feed(parser: configparser.RawConfigParser, text: str, path: Path) -> None:
    try:
        parser.read_string(text, str(path))
    except configparser.Error as error:
        raise PrinterCfgError(
            f"{path}: klippy cannot read this either: {error}"
        ) from None


def _lines(
    path: Path, saved: list[str], parents: tuple[Path, ...]
) -> Iterator[str]:
    """The lines of a file and of those it includes, without comments."""
    if path.resolve() in parents:
        raise PrinterCfgError(f"{path}: includes itself")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise PrinterCfgError(f"{path}: cannot be read: {error}") from None
    text, _, after = text.partition(_SAVED)
    for line in after.splitlines():
        # Before its first section it says not to edit it
        if saved or line.startswith(f"{_SAVED_LINE}["):
            saved.append(line[len(_SAVED_LINE) :])
    for line in text.splitlines():
        found = re.match(r"\[include (.+)\]", line.strip())
        if found is None:
            yield line.partition("#")[0]
            continue
        pattern = found[1].strip()
        names = sorted(path.parent.glob(pattern))
        if not names and not set(pattern) & set("*?["):
            raise PrinterCfgError(f"{path}: there is no {pattern} to include")
        for name in names:
            yield from _lines(name, saved, (*parents, path.resolve()))
