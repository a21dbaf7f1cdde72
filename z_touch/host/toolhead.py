"""The toolhead: its axes and motors, where Z gets its zero, and how it is moved.

Every Z is a toolhead Z: mm, in the frame that the last homing defined, up is positive.
G-code offset, bed mesh and skew play no part in it.  Speeds are in mm/s.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from .endstops import chip_of, is_virtual

if TYPE_CHECKING:
    from .klippy import Config, Endstop, Stepper
    from .printer import Host

# Of an axis that is homed on a switch: where that triggers
ENDSTOP_OPTION = "position_endstop"

# How every host since 2021-08-17 (1dc2ab048) begins the error of a probing move that has
# reached its end
NO_TRIGGER = "No trigger"

# How the error begins where boards did not hear of each other in time, or one is gone
NOT_HEARD = ("Communication timeout during", "Unable to obtain")


def has_no_trigger(error: Exception) -> bool:
    """Return whether a probing move has ended without a trigger."""
    return NO_TRIGGER in str(error)


def was_not_heard(error: Exception) -> bool:
    """Return whether a probing move has failed as a board was not heard."""
    return any(words in str(error) for words in NOT_HEARD)


class ZAxis(NamedTuple):
    """The section of the Z axis, and its options that matter (mm, mm/s, mm/s^2).

    position_endstop is where its switch triggers, None without; where the probe homes Z it
    may be left over from a switch, see Axes.probe_homes_to().  max_speed None: the user has
    not given it.
    """

    section: str
    endstop_pin: str
    position_endstop: Optional[float]
    position_min: float
    homing_speed: float
    second_homing_speed: float
    homing_retract_dist: float
    max_speed: Optional[float]
    max_accel: float


class ZZero(NamedTuple):
    """Where Z gets its zero: section, option, and the value in force (mm)."""

    section: str
    option: str
    z: float


def find_z_section(config: Config) -> Optional[Config]:
    """Return the section of the Z axis, or None where there is none, as on a delta.

    That is [stepper_z], or with "kinematics: generic_cartesian" (since 2025-05-06,
    cc6736c3e) the [carriage ...] whose axis is z.
    """
    if config.has_section("stepper_z"):
        return config.getsection("stepper_z")
    for carriage in config.get_prefix_sections("carriage "):
        name = carriage.get_name().split()[-1]
        if carriage.get("axis", name, note_valid=False) == "z":
            return carriage
    return None


def read_z_axis(config: Config) -> Optional[ZAxis]:
    """Read the Z axis with the defaults that every host documents.

    note_valid=False leaves it to the host to claim these options.
    """
    section = find_z_section(config)
    if section is None:
        return None

    def number(of: Config, name: str, default: Optional[float]) -> Any:
        """Return an option as a number (mm, mm/s), or the default."""
        return of.getfloat(name, default, note_valid=False)

    homing_speed = number(section, "homing_speed", 5.0)
    printer = config.getsection("printer")
    return ZAxis(
        section=section.get_name(),
        endstop_pin=section.get("endstop_pin", "", note_valid=False),
        position_endstop=number(section, ENDSTOP_OPTION, None),
        position_min=number(section, "position_min", 0.0),
        homing_speed=homing_speed,
        second_homing_speed=number(
            section, "second_homing_speed", homing_speed / 2.0
        ),
        homing_retract_dist=number(section, "homing_retract_dist", 5.0),
        max_speed=number(printer, "max_z_velocity", None),
        max_accel=number(printer, "max_z_accel", float("inf")),
    )


def check_z_axis(config: Config, z_axis: Optional[ZAxis]) -> ZAxis:
    """Return the Z axis, or raise the error of a configuration that has none."""
    if z_axis is not None:
        return z_axis
    kinematics = config.getsection("printer").get(
        "kinematics", "none", note_valid=False
    )
    name = config.get_name()
    raise config.error(
        f"Option 'kinematics: {kinematics}' in section 'printer' has no Z axis with an"
        f" endstop of its own, and {name} cannot be used on this machine; remove"
        f" section '{name}'"
    )


class Axes:
    """The axes as the kinematics of the host drive them.

    All but z_axis (None: there is none of its own) can be asked from klippy:connect on.
    """

    def __init__(self, config: Config, host: Host):
        self.host = host
        self.z_axis = read_z_axis(config)

    def _kinematics(self) -> Any:
        return self.host.toolhead.get_kinematics()

    def limits(self) -> List[Tuple[float, float]]:
        """Return (low, high) of X, Y and Z in mm."""
        status = self.host.toolhead_status()
        return list(zip(status["axis_minimum"], status["axis_maximum"]))[:3]

    ##################################################################
    # X and Y
    ##################################################################

    def _rails_of_axes(self) -> List[Tuple[Any, int]]:
        """Return each rail with the axis (0: X, 1: Y) that it moves."""
        kinematics = self._kinematics()
        all_rails = getattr(kinematics, "rails", [])
        rails = list(zip(all_rails, (0, 1))) if len(all_rails) >= 3 else []
        # generic_cartesian, since 2025-05-06 (cc6736c3e)
        for carriage in getattr(kinematics, "carriages", {}).values():
            rails.append((carriage.get_rail(), carriage.get_axis()))
        return rails

    def homed_axis(self, rails: Sequence[Any]) -> Optional[int]:
        """Return the axis (0: X, 1: Y) that a homing move of these rails goes along.

        None: another axis, or a machine that moves in another way, such as a delta.
        """
        if len(rails) != 1 or not self.z_datum():
            return None
        for rail, axis in self._rails_of_axes():
            if rail is rails[0] and axis in (0, 1):
                return axis
        return None

    def xy_ends(self) -> Dict[int, float]:
        """Return where homing X (0) and Y (1) ends (mm), by the axis.

        Empty on machines that home in another way, and where there are two toolheads.
        """
        found: Dict[int, float] = {}
        if self.has_two_heads():
            return found
        kinematics = self._kinematics()
        rails = list(getattr(kinematics, "rails", []))
        for carriage in getattr(kinematics, "carriages", {}).values():
            rails.append(carriage.get_rail())
        for rail in rails:
            axis = self.homed_axis([rail])
            if axis is not None:
                found[axis] = rail.get_homing_info().position_endstop
        return found

    def has_two_heads(self) -> bool:
        """Return whether there are two toolheads: which one homing leaves is not told."""
        lookup = self.host.printer.lookup_object
        return lookup("dual_carriage", None) is not None

    ##################################################################
    # Z
    ##################################################################

    def z_steppers(self) -> List[Stepper]:
        """Return the motors that move Z."""
        steppers = self._kinematics().get_steppers()
        return [s for s in steppers if s.is_active_axis("z")]

    def watch_z_enabling(self, switched: Callable[[float, bool], None]) -> None:
        """Have switched(print_time, is_on) called when a motor of Z is turned on or off."""
        enabling = self.host.printer.lookup_object("stepper_enable")
        for stepper in self.z_steppers():
            line = enabling.lookup_enable(stepper.get_name())
            line.register_state_callback(switched)

    def z_step(self) -> float:
        """Return the largest step (mm) of the motors of Z."""
        return max(s.get_step_dist() for s in self.z_steppers())

    def z_datum(self) -> List[float]:
        """Return where each motor of Z stands, less where the host believes Z is (mm).

        The differences change only when Z is homed, set or levelled.  Empty where X or Y
        share these motors.
        """
        steppers = self.z_steppers()
        if any(s.is_active_axis(axis) for s in steppers for axis in "xy"):
            return []
        return [
            s.get_mcu_position() * s.get_step_dist()
            - s.get_commanded_position()
            for s in steppers
        ]

    def z_limits(self) -> Tuple[Optional[float], float]:
        """Return the speed and acceleration that Z can do (mm/s, mm/s^2).

        None: the user has not said, and the host would take what X and Y can do.
        """
        axis, status = self.z_axis, self.host.toolhead_status()
        assert axis is not None
        speed = axis.max_speed
        return (
            None if speed is None else min(speed, status["max_velocity"]),
            min(axis.max_accel, status["max_accel"]),
        )

    def z_pace(self, lift_speed: float) -> Tuple[float, float]:
        """Return the speed (mm/s) at which the user moves Z elsewhere, and its acceleration.

        That is the larger of the probe's lift_speed and homing_speed.
        """
        limit, accel = self.z_limits()
        assert self.z_axis is not None
        speed = max(lift_speed, self.z_axis.homing_speed)
        return (speed if limit is None else min(speed, limit)), accel

    def homes_with_probe(self) -> bool:
        """Return whether G28 homes Z with the probe: after it the bed is where that says."""
        axis = self.z_axis
        return axis is not None and chip_of(axis.endstop_pin) == "probe"

    def probe_homes_to(self) -> Optional[float]:
        """Return the Z that G28 sets where the probe triggers, None: it is its z_offset.

        Hosts take position_endstop where the endstop of a probe says no height, as that of
        a smart_effector until 2024-07-04 (34732f857) and on Kalico.  Otherwise they pass
        over it, also where SAVE_CONFIG had written one for a switch.
        """
        if not self.homes_with_probe():
            return None
        assert self.z_axis is not None
        endstop = self.host.endstops.find_z()
        is_told = endstop is None or is_virtual(endstop)
        return None if is_told else self.z_axis.position_endstop

    def z_zero(self) -> Optional[ZZero]:
        """Return where Z gets its zero, None where no section says so."""
        axis, probing = self.z_axis, self.host.probing
        assert axis is not None
        if self.homes_with_probe() and self.probe_homes_to() is None:
            if probing.section is None:
                return None
            return ZZero(probing.section, "z_offset", probing.z_offset())
        if axis.position_endstop is None:
            return None
        return ZZero(axis.section, ENDSTOP_OPTION, axis.position_endstop)


class Motion:
    """Moves of the toolhead that hosts have no method for, or not the same one."""

    def __init__(self, host: Host):
        self.host = host
        self.printer = host.printer

    def z(self) -> float:
        """Return where the toolhead is in Z, or will be when its moves have ended."""
        return self.host.toolhead.get_position()[2]

    def require_running(self) -> None:
        """Wait until the queued moves are made, and raise where the printer was shut down.

        A probing move first waits for the moves before it, and hosts may wait for ever for
        its trigger where the printer was shut down meanwhile.  May pause.
        """
        self.host.toolhead.flush_step_generation()
        if self.printer.is_shutdown():
            raise self.printer.command_error(
                "Touch not begun due to printer shutdown"
            )

    def probing_move(self, endstop: Endstop, z: float, speed: float) -> float:
        """Move down to z, or to where the endstop triggers; return the Z of the trigger.

        The toolhead halts a little lower and stays there.  Raises the host's command_error
        where nothing triggered.  May pause.
        """
        self.require_running()
        target = self.host.toolhead.get_position()
        target[2] = z
        # A method of the host since 2021-03-29 (862d3f963)
        homing = self.printer.lookup_object("homing")
        trigger: Sequence[float] = homing.probing_move(endstop, target, speed)
        return trigger[2]

    def lift_unhomed(self, distance: float, speed: float) -> None:
        """Lift by a distance (mm) where Z is not homed, and leave it so."""
        toolhead = self.host.toolhead
        kinematics = toolhead.get_kinematics()
        position = toolhead.get_position()
        position[2] = 0.0
        # Axes have letters since 2025-01-21 (4aa550837), numbers before: the default of
        # this parameter says which
        defaults = getattr(toolhead.set_position, "__defaults__", None) or ((),)
        z_axis: Any = "z" if defaults[-1] == "" else (2,)
        toolhead.set_position(position, homing_axes=z_axis)
        try:
            toolhead.manual_move([None, None, distance], speed)
        finally:
            if hasattr(kinematics, "clear_homing_state"):
                # Since 2025-01-10 (708387970)
                kinematics.clear_homing_state(z_axis)
            elif hasattr(kinematics, "note_z_not_homed"):
                kinematics.note_z_not_homed()
