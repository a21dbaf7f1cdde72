"""The user's G-code around the touches of a calibration, and who attaches the probe.

  start_gcode -> nozzle -> before_switch_gcode -> switch -> bed -> end_gcode
                   |                                                   |
               clean_gcode, once                                  offset_gcode

end_gcode runs after every failure, too, then error_gcode.  None of them can begin a
measurement.  What they do to the probe is seen, never read from their words:

  start_gcode           has attached it: it stays attached at the nozzle;
                        otherwise a dockable_probe is docked for the nozzle
  before_switch_gcode   has not attached it: a dockable_probe fetches it
  end_gcode             has not docked it: a dockable_probe docks it

Of a [probe] that macros attach only its switch tells, where that is wired as normally closed.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import logging
from typing import TYPE_CHECKING, Iterator, Optional

from .. import attached, command, templates
from ..errors import CalibrationError
from ..host.gcode_state import NO_SHIFT, Modes

if TYPE_CHECKING:
    from ..attached import Carrier
    from ..datum import Datum, Mark
    from ..host.printer import Host
    from ..progress import Progress
    from .settings import Settings

BEFORE = "do it before CALIBRATE_Z"

# With these G28 is what the user has made of it
OWN_HOMING = ("gcode_macro G28", "homing_override")


class UserGcode:
    """What the user wants to be done around the touches.

    Each part says in its errors which option it is.  All methods that run something may pause.
    """

    def __init__(
        self, host: Host, settings: Settings, datum: Datum, watch: Progress
    ):
        self.host = host
        self.settings = settings
        self.datum = datum
        self.watch = watch
        # How G-code reads coordinates where each of them begins; None: as it does by then
        self.modes: Optional[Modes] = None
        # Where the probe was when start_gcode began
        self.mark: object = None
        self.was_docked = self.was_attached = False
        # Whether before_switch_gcode was seen to attach a probe that macros fetch
        self.is_late = False
        # offset_gcode is under way, and has said that it keeps the offset
        self.is_applying = self.is_kept = False

    @contextlib.contextmanager
    def keeping_modes(self) -> Iterator[None]:
        """Have G-code read coordinates as now wherever a template begins, and at the end.

        So one that fails between its G91 and G90 makes no other one drive off.
        """
        self.modes = self.host.gcode_state.modes()
        with command.always(
            self.host, self._set_modes_back, "setting the modes back"
        ):
            yield

    def _set_modes_back(self) -> None:
        modes, self.modes = self.modes, None
        if modes is not None:
            self.host.gcode_state.set_modes(modes)

    def run(self, option: str, **params: object) -> None:
        """Run the template of an option, with parameters as a macro gets them."""
        if self.modes is not None:
            self.host.gcode_state.set_modes(self.modes)
        template = getattr(self.settings, option)
        templates.run_template(self.host, option, template, **params)

    ##################################################################
    # In the order of a run
    ##################################################################

    def check_before_start(self) -> None:
        """Raise CalibrationError unless the printer is homed, or start_gcode homes it."""
        if not self.settings.start_homes:
            command.check_homed(self.host)

    def start(self) -> None:
        """Run start_gcode, then have nothing below the nozzle but what that has attached.

        It may home, move, or turn the motors off.
        """
        self.before_attaching()
        self.run("start_gcode")
        is_homed = not self.settings.start_homes
        command.check_homed(self.host, "start_gcode" if is_homed else "")
        self.free_nozzle()

    def attach_again(self) -> None:
        """Run start_gcode once more where Klipper may have put the probe away after the bed."""
        if self.host.probing.has_deactivate_gcode():
            self.run("start_gcode")
            command.check_homed(self.host, "start_gcode")

    def before_attaching(self) -> None:
        """Note where the probe is, for free_nozzle()."""
        carrier = self.carrier()
        self.was_docked = False
        self.was_attached = self.reads_attached()
        if carrier is not None:
            self.was_docked = carrier.state() == attached.DOCKED
            self.mark = carrier.mark()

    def free_nozzle(self) -> None:
        """Have a dockable_probe docked unless the user has attached it since.

        Raises CalibrationError where a probe is attached that macros attach after the nozzle.
        """
        carrier = self.carrier()
        if carrier is None:
            if self.is_late and self.was_attached and self.reads_attached():
                raise CalibrationError(
                    "the probe is attached already, and before_switch_gcode has"
                    " attached it in an earlier run: it may be in the way of the"
                    " nozzle; detach it in start_gcode and check it with QUERY_PROBE"
                )
        elif not carrier.is_put_on(self.mark, self.was_docked):
            everything = attached.of(self.host.printer)
            everything.free_nozzle(self.host, regardless=True, goes_on=True)

    def check_g92(self, remedy: str) -> None:
        """Raise CalibrationError where G92 has moved Z=0: the offset would not be right."""
        moved = self.host.gcode_state.moved_by_g92()
        if abs(moved) >= NO_SHIFT:
            raise CalibrationError(
                f"G92 has moved Z=0 by {moved:.3f} mm, which is no part of the G-code"
                f" offset; {remedy}"
            )

    def before_switch(self, mark: Optional[Mark]) -> None:
        """Run before_switch_gcode; a dockable_probe is attached afterwards.

        Z=0 must be where it was at 'mark', None: nothing was measured yet.
        """
        carrier = self.carrier()
        # A look waits until the toolhead stands still: not for what is known already
        looks = (
            carrier is None
            and self.settings.may_attach_late
            and not self.is_late
        )
        was_attached = looks and self.reads_attached()
        self.run("before_switch_gcode")
        if carrier is not None:
            carrier.fetch()
        elif looks and not was_attached:
            self.is_late = self.reads_attached()
        if mark is not None:
            self._check_datum(
                mark,
                "before_switch_gcode: nozzle and switch cannot be compared then",
            )
        command.check_homed(self.host, "before_switch_gcode")

    @property
    def can_clean(self) -> bool:
        """Whether there is a clean_gcode."""
        return self.settings.clean_gcode is not None

    def clean(self) -> None:
        """Run clean_gcode, which leaves Z=0 where it is."""
        self.watch.enter("clean_gcode")
        mark = self.datum.mark()
        self.run("clean_gcode")
        self._check_datum(mark, "clean_gcode")

    def _check_datum(self, mark: Mark, where: str) -> None:
        moved = self.datum.moved_since(mark)
        if moved:
            raise CalibrationError(f"{moved} in {where}; {BEFORE}")

    def end(self) -> None:
        """Run end_gcode after the last touch, or a failure; the probe is docked then.

        Where the user wants no automatic docking, a dockable_probe is where it was before.
        """
        self.watch.enter("end_gcode")
        with command.always(self.host, self._dock, "docking the probe"):
            self.run("end_gcode")

    def _dock(self) -> None:
        carrier = self.carrier()
        if carrier is None or not (carrier.auto or self.was_docked):
            return
        if carrier.state() != attached.DOCKED:
            self.host.gcode.run_script_from_command("DETACH_PROBE")

    def probe_left(self, was_seen: bool) -> str:
        """Return why the probe should not be where it is after end_gcode; empty: it may.

        'was_seen': the run has seen it attached.  One that was attached before start_gcode
        may stay on purpose, and a dockable_probe is where it was before.
        """
        if not was_seen or self.was_attached or self.carrier() is not None:
            return ""
        if self.host.printer.is_shutdown() or not self.reads_attached():
            return ""
        return (
            "the probe is still attached after end_gcode, and would meet the bed before"
            " the nozzle does; detach it in end_gcode, and check that with QUERY_PROBE"
        )

    def apply(self, z_offset: float) -> bool:
        """Set the G-code Z offset (mm), or have offset_gcode do so.

        Returns whether that has said that it keeps the offset, or makes another one of it.
        """
        if self.settings.offset_gcode is None:
            self.host.gcode_state.set_z_offset(z_offset)
            return False
        self.is_applying, self.is_kept = True, False
        try:
            self.run("offset_gcode", Z=f"{z_offset:.6f}")
        finally:
            self.is_applying = False
        return self.is_kept

    def keep_offset(self) -> bool:
        """Note that the offset is kept; return whether offset_gcode is under way."""
        self.is_kept = self.is_applying
        return self.is_applying

    def failed(self, error: Exception) -> None:
        """Run error_gcode, last of all; an error of its own must not hide the first."""
        if self.settings.error_gcode is None:
            return
        self.watch.enter("error_gcode")
        try:
            self.run("error_gcode", ERROR=error)
        except (self.host.printer.command_error, CalibrationError) as e:
            logging.exception("z_calibration: error_gcode failed, too")
            self.watch.say(f"after the error: {e}")

    ##################################################################
    # The probe
    ##################################################################

    def carrier(self) -> Optional[Carrier]:
        """Return the dockable probe, None: macros attach it, if anything."""
        return attached.of(self.host.printer).carrier(self.host)

    def reads_attached(self) -> bool:
        """Return whether the probe's switch reads open.

        It reads triggered where it is not attached, or pressed.
        """
        print_time = self.host.after_moves()
        return not self.host.probing.reads_triggered(print_time)

    def check_homing(self) -> None:
        """Raise CalibrationError where Z would be homed on the pin with the probe attached.

        A G28 of the user's own may dock it, and a probe that is always attached is never in
        the way: only one that before_switch_gcode has attached is.
        """
        lookup = self.host.printer.lookup_object
        is_own = any(lookup(name, None) for name in OWN_HOMING)
        if is_own or not self.is_late or self.host.axes.homes_with_probe():
            return
        if self.reads_attached():
            raise CalibrationError(
                "the probe is on the toolhead, and would meet the bed before the"
                " nozzle meets the pin; put it away before Z is homed: in"
                " end_gcode, or by hand"
            )

    @contextlib.contextmanager
    def holding_probe(self) -> Iterator[None]:
        """Have a dockable_probe attach and dock nothing by itself while this lasts.

        It would do so around each session of the host's probing.
        """
        if not self.host.probing.attaches_by_itself():
            yield
            return
        with command.always(
            self.host, self._release_probe, "auto_attach_detach"
        ):
            self._set_auto_attach(False)
            yield

    def _release_probe(self) -> None:
        self._set_auto_attach(True)

    def _set_auto_attach(self, is_on: bool) -> None:
        self.host.gcode.run_script_from_command(
            f"SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH={is_on:d}"
        )
