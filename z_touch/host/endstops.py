"""Endstops: the pins that stop a move, made, found and checked.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Iterator, Mapping, Optional, Tuple

if TYPE_CHECKING:
    from .klippy import Config, Endstop
    from .printer import Host

# What probing_move() and a state query need of an endstop object
ENDSTOP_METHODS = ("get_steppers", "home_start", "home_wait", "query_endstop")

# Sections that make the object 'probe', and their option for the pin
PROBE_PINS = (
    ("probe", "pin"),
    ("dockable_probe", "pin"),
    ("smart_effector", "pin"),
    ("bltouch", "sensor_pin"),
)


def find_probe_section(config: Config) -> Optional[str]:
    """Return the section that makes the object 'probe'.

    None: there is none, or one that is not known here.
    """
    for name, _option in PROBE_PINS:
        if config.has_section(name):
            return name
    return None


def is_endstop(candidate: Any) -> bool:
    """Return whether an object can end a move, and stops at least one motor."""
    methods = [getattr(candidate, name, None) for name in ENDSTOP_METHODS]
    return all(callable(m) for m in methods) and bool(candidate.get_steppers())


def bare_pin(pin: str) -> str:
    """Return a pin without pull-up, polarity, and the name of the main board."""
    pin = pin.replace(" ", "").lstrip("^~!")
    return pin[len("mcu:") :] if pin.startswith("mcu:") else pin


def chip_of(pin: str) -> str:
    """Return the chip of a pin, as 'probe' of probe:z_virtual_endstop."""
    return pin.strip("^~! ").split(":")[0].strip() if ":" in pin else "mcu"


def is_virtual(endstop: Any) -> bool:
    """Return whether an endstop is the probe; hosts themselves tell it by this method."""
    return hasattr(endstop, "get_position_endstop")


def _options_of_pin(config: Config, pin: str) -> Iterator[Tuple[str, str]]:
    """Yield section and option of each other section that names a pin.

    Not where [duplicate_pin_override] has it: they may share it then.
    """
    may_share = "duplicate_pin_override"
    if config.has_section(may_share):
        shared = config.getsection(may_share).get("pins", "", note_valid=False)
        if bare_pin(pin) in map(bare_pin, "".join(shared.split()).split(",")):
            return
    for section in config.get_prefix_sections(""):
        if section.get_name() == config.get_name():
            continue
        for option in section.get_prefix_options(""):
            # The pin of a driver's diagnosis is claimed by an endstop of it only
            if option.endswith("pin") and not option.startswith("diag"):
                text = section.get(option, "", note_valid=False)
                if bare_pin(text) == bare_pin(pin):
                    yield section.get_name(), option


def _two_have_it(section: str, option: str) -> str:
    """Return why a pin cannot be used that another section has, and what to do."""
    return (
        f"is the pin of option '{option}' in section '{section}', too, and two options"
        " cannot have one pin; remove it where it is not needed"
    )


class Endstops:
    """The endstops of a printer, as far as a section needs them."""

    def __init__(self, config: Config, host: Host):
        self.host = host
        self.printer = host.printer
        self.query_endstops = self.printer.load_object(config, "query_endstops")

    def make(
        self,
        config: Config,
        option: str,
        remedy: str,
        of_sections: Optional[Mapping[str, str]] = None,
    ) -> Endstop:
        """Make an endstop that stops the Z motors, of the pin that an option names.

        Raises the error of a configuration for a pin that is none, that another section has,
        or that the host refuses.  'remedy' says which pin is wanted; 'of_sections' what to do
        where that of a section was given.
        """
        pin: str = config.get(option)
        why = self._why_unusable(config, option, remedy, of_sections or {})
        endstop: Any = None
        pins = self.printer.lookup_object("pins")
        try:
            if not why:
                endstop = pins.setup_pin("endstop", pin)
        except pins.error as e:
            why = self._why_refused(config, pin, str(e), remedy)
        if why:
            raise config.error(
                f"Option '{option}: {pin}' in section '{self.host.section}' {why}"
            )
        self.query_endstops.register_endstop(endstop, self.host.section)
        self.stops_z(endstop)
        result: Endstop = endstop
        return result

    def _why_unusable(
        self,
        config: Config,
        option: str,
        remedy: str,
        of_sections: Mapping[str, str],
    ) -> str:
        """Return why a pin cannot be an endstop of our own, and what to do; empty: it may."""
        own, pin = self.host.section, config.get(option)
        for name, other in PROBE_PINS:
            if config.has_section(name) and name != own:
                used = config.getsection(name).get(other, "", note_valid=False)
                if used and bare_pin(used) == bare_pin(pin):
                    what = of_sections.get(name, remedy)
                    return f"is the pin of section '{name}'; {what}"
        if not pin.strip("^~! ") or chip_of(pin) in ("probe", own):
            return f"is no pin; {remedy}"
        for name, other in _options_of_pin(config, pin):
            # The host makes these after us, and would not say which is the other one
            is_axis = name.startswith(("stepper", "carriage"))
            if is_axis and other == "endstop_pin":
                return _two_have_it(name, other)
        return ""

    def _why_refused(
        self, config: Config, pin: str, error: str, remedy: str
    ) -> str:
        """Return why the host refuses a pin, and what to do."""
        if "multiple times" in error:
            for name, other in _options_of_pin(config, pin):
                return _two_have_it(name, other)
        if "Unknown pin chip" in error:
            chips = ", ".join(sorted(self._chips()))
            return (
                f"names a board that there is no section [mcu ...] of; the boards are"
                f" {chips}, and a pin without one is of mcu"
            )
        if "not supported" in error:
            return (
                f"cannot be an endstop ({error}); wire the signal to a pin of a board"
                " with an MCU"
            )
        return f"cannot be used: {error}; {remedy}"

    def _chips(self) -> Iterator[str]:
        """Yield the names of the boards."""
        for name, _ in self.printer.lookup_objects("mcu"):
            yield name.split()[-1]

    def make_plain(self, config: Config, option: str) -> Endstop:
        """Make an endstop that is only looked at, or ends a probing move of a probe."""
        pins = self.printer.lookup_object("pins")
        try:
            endstop: Endstop = pins.setup_pin("endstop", config.get(option))
        except pins.error as e:
            raise config.error(
                f"Option '{option}' in section '{config.get_name()}' cannot be used: {e};"
                " give the pin that the switch is wired to, such as ^PA1"
            )
        return endstop

    def stops_z(self, endstop: Endstop) -> None:
        """Have the Z motors stop with an endstop."""

        def add_z_steppers() -> None:
            """Add them: they exist since the toolhead was loaded, just before the event."""
            self.host.find_toolhead()
            for stepper in self.host.axes.z_steppers():
                endstop.add_stepper(stepper)

        register = self.printer.register_event_handler
        register("klippy:mcu_identify", add_z_steppers)

    def find_z(self) -> Optional[Endstop]:
        """Return the endstop of the Z axis, None where the host has none.

        It was registered as "z" until 2025-05-06 (cc6736c3e) and on Kalico, since then
        under the name of the section.
        """
        assert self.host.axes.z_axis is not None
        section = self.host.axes.z_axis.section
        names = (section, section.split()[-1].replace("stepper_", ""))
        for endstop, name in self.query_endstops.endstops:
            if name in names:
                found: Endstop = endstop
                return found
        return None

    def check_stops_z(self, endstop: Endstop, where: str) -> None:
        """Raise the error of a configuration unless an endstop stops all motors of Z.

        An endstop stops only its own motors.  With none at all, hosts since 2025-05-06
        (cc6736c3e) make the whole move without any endstop.  'where' names the option.
        """
        stopped = [s.get_name() for s in endstop.get_steppers()]
        moving = [s.get_name() for s in self.host.axes.z_steppers()]
        missing = [name for name in moving if name not in stopped]
        if missing:
            raise self.printer.config_error(
                f"{where} does not stop these Z motors: {', '.join(missing)}; remove the"
                " endstop_pin of their own"
            )
