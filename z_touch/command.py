"""Around every command: one at a time, what it changes put back, its errors told once.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import logging
from typing import TYPE_CHECKING, Any, Callable, Iterator, Optional

from .errors import CalibrationError
from .progress import Progress

if TYPE_CHECKING:
    from .host.klippy import GCodeCommand
    from .host.printer import Host


@contextlib.contextmanager
def always(host: Host, action: Callable[[], Any], what: str) -> Iterator[None]:
    """Run 'action' when the block is left, on every path but a shutdown.

    Its own error counts only if there is no earlier one; otherwise it goes into klippy.log.
    """
    try:
        yield
    except Exception as e:
        # Not of GreenletExit, which ends a command where klippy ends
        is_clean = _clean_up(host, action, what)
        if isinstance(e, CalibrationError) and not is_clean:
            e.not_cleaned_up()
        raise
    if not host.printer.is_shutdown():
        action()


def _clean_up(host: Host, action: Callable[[], Any], what: str) -> bool:
    """Run 'action' after an error, which its own must not hide; return whether that went well."""
    if host.printer.is_shutdown():
        return False
    try:
        action()
        return not host.printer.is_shutdown()
    except (host.printer.command_error, CalibrationError):
        logging.exception("%s: %s failed, too", host.section, what)
    except Exception as e:
        # Of the host, such as moving after a board was lost: the printer has to end
        logging.exception("%s: %s failed, too", host.section, what)
        host.printer.invoke_shutdown(
            f"{host.section}: {what} failed after another error: {e}"
        )
    return False


def register_commands(
    host: Host, module: object, probe: Optional[str] = None
) -> None:
    """Register each cmd_NAME of an object as the command NAME.

    cmd_NAME_help is its description.  'probe': of several modules the one that PROBE=...
    means.
    """
    attributes = dir(module)
    for attribute in attributes:
        help_attribute = attribute + "_help"
        if not attribute.startswith("cmd_") or help_attribute not in attributes:
            continue
        name, handler = attribute[4:], getattr(module, attribute)
        text = getattr(module, help_attribute)
        if probe is None:
            host.gcode.register_command(name, handler, desc=text)
            continue
        register = host.gcode.register_mux_command
        register(name, "PROBE", probe, handler, desc=text)


def check_homed(host: Host, after: str = "") -> None:
    """Raise CalibrationError unless all axes are homed.

    'after': the option whose G-code has just run, when they were homed before it.
    """
    homed = host.toolhead_status()["homed_axes"]
    missing = [axis.upper() for axis in "xyz" if axis not in homed]
    if missing and after:
        raise CalibrationError(
            f"not homed any more after {after}: {', '.join(missing)}; take M84, or"
            f" what else ends homing, out of {after}"
        )
    if missing:
        raise CalibrationError(
            f"not homed: {', '.join(missing)}; home all axes (G28) first"
        )


def check_carriage_is_kept(host: Host) -> None:
    """Raise CalibrationError for a carriage of an IDEX whose place is lost at each touch."""
    lost = host.tools.lost_by_probing()
    if lost is not None:
        raise CalibrationError(
            f"{lost} is active, and this Klipper loses its place at each touch;"
            " update Klipper (2024-02-07 or newer), or use the first carriage"
        )


def check_no_print(host: Host) -> None:
    """Raise CalibrationError while a print stands where we would go.

    A print that is paused, or one that has extruded while the command under way is none of
    its file: it would go on from where that leaves the toolhead.
    """
    state = host.print_state()
    if state == "printing" and (host.runs_file() or host.begins_print()):
        return
    if state:
        raise CalibrationError(
            f"a print is {'paused' if state == 'paused' else 'under way'}, and the"
            " toolhead would go across it; end it first (CANCEL_PRINT)"
        )


def check_no_manual_probe(host: Host) -> None:
    """Raise CalibrationError while the host waits for a person's ACCEPT."""
    helper = host.probing.manual_helper()
    if helper:
        raise CalibrationError(
            f"{helper} is under way; end it with ACCEPT or ABORT first"
        )


class Runner:
    """The commands of a module, of which one runs at a time."""

    def __init__(self, host: Host):
        self.host = host
        self.watch = Progress(host.section, host.gcode.respond_info)

    @contextlib.contextmanager
    def running(
        self,
        gcmd: GCodeCommand,
        phase: str,
        wanted: int,
        failed: Optional[Callable[[Exception], None]] = None,
    ) -> Iterator[None]:
        """Show the progress of a command, and put back what a failure leaves.

        After any error the G-code offset is as it was, and failed(error) is called; what a
        CalibrationError says becomes the command's error.  'wanted' is the number of touches.
        """
        self.check_idle(gcmd)
        before = self.host.gcode_state.z_offset()
        self.watch.begin(gcmd.respond_info, phase, wanted)
        try:
            yield
        except CalibrationError as e:
            self._undo(before, e, failed)
            raise gcmd.error(f"{self.host.section}: {e}")
        except self.host.printer.command_error as e:
            self._undo(before, e, failed)
            raise
        finally:
            self.watch.begin(self.host.gcode.respond_info, "idle", 0)

    def check_idle(self, gcmd: GCodeCommand) -> None:
        """Raise the command's error while one is under way: its template would never end."""
        if self.watch.phase != "idle":
            raise gcmd.error(
                f"{self.host.section}: a measurement is under way ({self.watch.phase});"
                " start another one when it has ended"
            )

    def _undo(
        self,
        offset: float,
        error: Exception,
        failed: Optional[Callable[[Exception], None]],
    ) -> None:
        # Whatever the user's G-code has done to it, the offset is as before.
        if self.host.printer.is_shutdown():
            return
        self.host.gcode_state.set_z_offset(offset)
        if failed is not None:
            failed(error)
