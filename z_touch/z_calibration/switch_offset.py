"""How switch_offset is corrected: by baby steps, or by where the nozzle was moved to.

A larger switch_offset moves the nozzle closer to the bed, a larger G-code offset moves it
away:

  new switch_offset = old - change of the G-code offset

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional, Tuple

from .. import command, options
from ..datum import MOTORS_OFF
from ..errors import CalibrationError
from ..in_force import LARGEST_STEP, NO_STEP
from .result import G92, OFFSET, TOOL, LastRun
from .settings import param_switch_offset

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand, Handler
    from .module import ZCalibration

# What the web interfaces send when their user saves the Z offset
BUTTONS = ("Z_OFFSET_APPLY_ENDSTOP", "Z_OFFSET_APPLY_PROBE")


######################################################################
# Maths
######################################################################


def corrected_switch_offset(
    switch_offset: float, z: float, z_offset: float
) -> float:
    """Return the switch_offset (mm) with which Z=0 is where the user has moved it to.

    The height z (toolhead Z, mm) is the offset that is right; what it differs by from z_offset
    belongs to switch_offset.
    """
    return switch_offset - (z - z_offset)


def check_steps(
    offset: float, switch_offset: float, z_offset: float, force: bool
) -> Tuple[float, str]:
    """Return the new switch_offset (mm), and how it was calculated.

    'offset' is the G-code offset that CALIBRATE_Z, or a correction since, has left, and
    'switch_offset' belongs to it; 'z_offset' has the baby steps; 'force': an unlikely one is
    right.  Raises CalibrationError.
    """
    new = corrected_switch_offset(switch_offset, z_offset, offset)
    text = (
        f"switch_offset={switch_offset:.3f} - (G-code offset={z_offset:.3f} -"
        f" {offset:.3f} of CALIBRATE_Z) --> new switch_offset={new:.3f}"
    )
    if new < 0.0:
        raise CalibrationError(
            f"{text}, which cannot be negative: the pin does not press the switch"
            " body, or the G-code offset is none of CALIBRATE_Z; check"
            " switch_xy_position, then run CALIBRATE_Z again"
        )
    if force:
        return new, text
    if not z_offset:
        raise CalibrationError(
            "the G-code offset is 0, not that of CALIBRATE_Z with baby steps:"
            " something has reset it; set it again with SET_GCODE_OFFSET, or"
            " run Z_CALIBRATION_SAVE_GCODE_OFFSET FORCE=1 if 0 is right"
        )
    if abs(z_offset - offset) > LARGEST_STEP:
        raise CalibrationError(
            f"{text}: a change of more than {LARGEST_STEP:g} mm is none of baby steps;"
            " check the probe, or run Z_CALIBRATION_SAVE_GCODE_OFFSET FORCE=1"
        )
    return new, text


######################################################################
# Commands and buttons
######################################################################


class SwitchOffset:
    """The commands that correct switch_offset, and the buttons that may do so.

    The buttons' commands are the host's own and are wrapped, as nothing else tells that the
    user wants to keep the baby steps.
    """

    def __init__(self, calibration: ZCalibration):
        self.calibration = calibration
        self.host = calibration.host
        self.results = calibration.results
        self.hinted = False
        # A switch_offset that counts, and was not handed to SAVE_CONFIG
        self.unsaved: Optional[float] = None
        register = self.host.printer.register_event_handler
        register("klippy:connect", self._take_buttons)
        command.register_commands(self.host, self)

    def _take_buttons(self) -> None:
        for name in BUTTONS:
            self.host.wrap_command(name, self._press)
        # Nothing else tells an offset that is set from a baby step
        self.host.wrap_command("SET_GCODE_OFFSET", self._set_offset)

    def _set_offset(self, handler: Handler, gcmd: GCodeCommand) -> None:
        """Note where a command sets an offset in place of ours."""
        before = self.host.gcode_state.z_offset()
        handler(gcmd)
        is_absolute = gcmd.get("Z", None) is not None
        if self.results.note_offset(before, is_absolute):
            self.calibration.in_force.begin()

    def _press(self, handler: Handler, gcmd: GCodeCommand) -> None:
        """Save baby steps into switch_offset where the user wants that, or hint at it."""
        reason = self._why_no_steps()
        keeps = self.calibration.settings.save_button
        if keeps and not reason:
            self.calibration.check_idle(gcmd)
            with self.host.as_command_error(gcmd):
                self._save_steps(gcmd, is_saved=True, force=False)
            return
        last = self.results.current()
        change = self.host.gcode_state.z_offset()
        change -= last.steps.base if last else 0.0
        handler(gcmd)
        name, section = gcmd.get_command(), self.host.section
        if keeps:
            gcmd.respond_info(
                f"{section}: {reason}: {name} saves as ever, and nothing goes into"
                " switch_offset; next time save as long as the result of CALIBRATE_Z"
                " holds"
            )
        elif (
            self.hinted
            or reason
            or last is None
            or self.results.other_tool(last)
        ):
            return
        elif abs(change) > NO_STEP:
            self.hinted = True
            gcmd.respond_info(
                f"{section}: CALIBRATE_Z measures anew what {name} saves: the baby step"
                f" of {change:.3f} is gone then; keep it with"
                " Z_CALIBRATION_SAVE_GCODE_OFFSET, or with this button and"
                f" 'save_button: switch_offset' in section '{section}'"
            )

    def _why_no_steps(self) -> str:
        """Return why there is nothing that baby steps could be counted from; empty: there is.

        After a print the motors may be off.
        """
        return self.results.invalid_reason(
            (TOOL, OFFSET), datum_besides=MOTORS_OFF
        )

    def _check_tool(self, last: LastRun) -> None:
        """Raise where another nozzle is active: that has an offset of its own."""
        reason = self.results.other_tool(last)
        if reason:
            raise CalibrationError(
                f"{reason}: what the offset differs by is no baby step; activate"
                f" {last.extruder} first"
            )

    ##################################################################
    # Z_CALIBRATION_SAVE_GCODE_OFFSET
    ##################################################################

    cmd_Z_CALIBRATION_SAVE_GCODE_OFFSET_help = (
        "Take baby steps over into switch_offset"
    )

    def cmd_Z_CALIBRATION_SAVE_GCODE_OFFSET(self, gcmd: GCodeCommand) -> None:
        """Take the change of the G-code offset since CALIBRATE_Z over into switch_offset."""
        is_saved = bool(options.param_int(gcmd, "SAVE", 1))
        force = bool(options.param_int(gcmd, "FORCE", 0))
        self.calibration.check_idle(gcmd)
        with self.host.as_command_error(gcmd):
            self._save_steps(gcmd, is_saved, force)

    def _save_steps(
        self, gcmd: GCodeCommand, is_saved: bool, force: bool
    ) -> None:
        reason, last = self._why_no_steps(), self.results.current()
        if reason or last is None:
            raise CalibrationError(
                f"{reason}; baby steps count from the last CALIBRATE_Z; run it, then"
                " correct the first layer"
            )
        self._check_tool(last)
        z_offset = self.host.gcode_state.z_offset()
        if abs(z_offset - last.steps.base) < NO_STEP:
            gcmd.respond_info(
                f"{self.host.section}: nothing was changed with baby steps since"
                " CALIBRATE_Z"
            )
            self._keep(is_saved)
            return
        if z_offset and not force:
            self._check_stepped(last)
        new, text = check_steps(
            last.steps.base, last.result.switch_offset, z_offset, force
        )
        new = round(new, 3)
        self.calibration.use_switch_offset(new)
        self.results.correct(new)
        gcmd.respond_info(f"{self.host.section}: {text}")
        self.unsaved = new
        self._keep(is_saved)

    def _check_stepped(self, last: LastRun) -> None:
        """Raise CalibrationError where baby steps have not led to the offset in force."""
        z_offset = self.host.gcode_state.z_offset()
        if self.results.is_replaced():
            raise CalibrationError(
                f"the G-code offset {z_offset:.3f} was set by SET_GCODE_OFFSET Z=... in"
                " place of that of CALIBRATE_Z, which is no baby step; run CALIBRATE_Z"
                " again and use Z_ADJUST, or run Z_CALIBRATION_SAVE_GCODE_OFFSET FORCE=1 if"
                " what is set is right"
            )
        if not last.steps.has(z_offset):
            raise CalibrationError(
                f"the G-code offset {z_offset:.3f} is none of baby steps since"
                " CALIBRATE_Z: a saved state has brought it back, such as with RESUME;"
                " run CALIBRATE_Z again, or Z_CALIBRATION_SAVE_GCODE_OFFSET FORCE=1 if it is"
                " right"
            )

    def _keep(self, is_saved: bool) -> None:
        """Hand it to SAVE_CONFIG, if that is wanted."""
        if is_saved and self.unsaved is not None:
            self.host.save("switch_offset", f"{self.unsaved:.3f}")
            self.unsaved = None

    ##################################################################
    # CALCULATE_SWITCH_OFFSET
    ##################################################################

    cmd_CALCULATE_SWITCH_OFFSET_help = (
        "Calculate switch_offset with the nozzle moved to where Z=0 should be"
    )

    def cmd_CALCULATE_SWITCH_OFFSET(self, gcmd: GCodeCommand) -> None:
        """Calculate switch_offset where the nozzle stands at what Z=0 should be.

        By G-code Z, without what other features add there.
        """
        self.calibration.check_idle(gcmd)
        with self.host.as_command_error(gcmd):
            self._calculate(gcmd)

    def _calculate(self, gcmd: GCodeCommand) -> None:
        last = self.results.current()
        reason = self.results.invalid_reason((TOOL, G92, OFFSET))
        if reason or last is None:
            raise CalibrationError(
                f"{reason}; run CALIBRATE_Z first, then move the nozzle to where Z=0"
                " should be"
            )
        self._check_tool(last)
        self._check_mesh_here()
        old = param_switch_offset(gcmd, last.result.switch_offset)
        z = self.host.gcode_state.z()
        # The nozzle may be colder now than it will print
        z_offset = last.applied_at(self.host.nozzle_celsius())
        new = corrected_switch_offset(old, z, z_offset)
        text = (
            f"switch_offset={old:.3f} - (current_z={z:.3f} -"
            f" z_offset={z_offset:.3f}) --> new switch_offset={new:.3f}"
        )
        if new < 0.0:
            raise CalibrationError(
                f"{text}, which cannot be negative: the nozzle is still too far from"
                " the bed, or the pin does not press the switch body; lower the"
                " nozzle, or correct switch_xy_position"
            )
        gcmd.respond_info(f"{self.host.section}: {text}")
        if options.param_int(gcmd, "SAVE", 0):
            # What counted before is none of it any more, wherever the user writes it
            self.unsaved = None
            self.host.save("switch_offset", f"{new:.3f}")

    def _check_mesh_here(self) -> None:
        """Raise where the mesh ends before the nozzle: G-code Z holds its rim's height."""
        x, y = self.host.toolhead.get_position()[:2]
        if self.host.transforms.is_beyond_mesh(x, y):
            raise CalibrationError(
                f"the bed mesh ends before X{x:.1f} Y{y:.1f}, and what it takes off Z"
                " there was never measured; move over the mesh, or BED_MESH_CLEAR and"
                " CALIBRATE_Z again"
            )
