"""The printer as the sections want it: its parts, clocks, console and commands.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterator, List

from ..errors import CalibrationError
from .endstops import Endstops
from .gcode_state import GcodeState
from .probe import Probing
from .toolhead import Axes, Motion
from .tools import Tools
from .transforms import Transforms
from .twist import Twist

if TYPE_CHECKING:
    from .klippy import Config, GCode, GCodeCommand, Handler, Status, ToolHead


# A sensor of bed or chamber that says less or more (degrees C) is broken
COLDEST, HOTTEST = -50.0, 400.0

# How often (s) a command that waits looks whether the printer was shut down
WAIT_STEP = 1.0


class Host:
    """The host, klippy, as one section sees it."""

    def __init__(self, config: Config):
        self.printer = config.get_printer()
        # In front of every line the user is shown
        self.section = config.get_name()
        self.gcode: GCode = self.printer.lookup_object("gcode")
        # It exists from klippy:connect on, and to our parts a little earlier
        self.toolhead: ToolHead
        self.axes = Axes(config, self)
        self.motion = Motion(self)
        self.gcode_state = GcodeState(self)
        self.endstops = Endstops(config, self)
        self.probing = Probing(config, self)
        self.transforms = Transforms(self)
        self.tools = Tools(self)
        self.twist = Twist(self)

    def connect(self) -> None:
        """Look up what exists at klippy:connect."""
        self.find_toolhead()
        self.probing.connect()

    def find_toolhead(self) -> None:
        """Look the toolhead up."""
        self.toolhead = self.printer.lookup_object("toolhead")

    ##################################################################
    # Waiting
    ##################################################################

    def wait_until(self, time: float) -> None:
        """Wait until an eventtime (s) while all others go on.  May pause.

        Raises the host's error where the printer is shut down, and on Kalico where
        HEATER_INTERRUPT ends it.
        """
        wait_while = getattr(self.printer, "wait_while", None)
        if wait_while is not None:
            # Kalico, which would call a shutdown an interruption, too
            wait_while(
                lambda now: now < time and not self.printer.is_shutdown()
            )
        reactor = self.printer.get_reactor()
        while self.eventtime() < time and not self.printer.is_shutdown():
            reactor.pause(min(time, self.eventtime() + WAIT_STEP))
        if self.printer.is_shutdown():
            cause, _ = self.printer.get_state_message()
            raise self.error(
                f"the printer is shut down: {cause.splitlines()[0]}"
            )

    ##################################################################
    # State
    ##################################################################

    def eventtime(self) -> float:
        """Return the reactor's time of now (s)."""
        return self.printer.get_reactor().monotonic()

    def after_moves(self) -> float:
        """Return the print time (s) of the end of the last queued move.  May pause."""
        queued, passed, is_empty = self.toolhead.check_busy(self.eventtime())
        if is_empty and queued <= passed:
            return passed
        return self.toolhead.get_last_move_time()

    def print_time(self) -> float:
        """Return the print time (s) that is passing.

        Right after a touch, when nothing moves, this spares the wait of after_moves().
        """
        mcu = self.printer.lookup_object("mcu")
        time: float = mcu.estimated_print_time(self.eventtime())
        return time

    def print_state(self) -> str:
        """Return "printing" or "paused" where a print has begun and not ended, else ""."""
        state: str = self._print_stats().get("state", "")
        return state if state in ("printing", "paused") else ""

    def runs_file(self) -> bool:
        """Return whether the command under way is of the file of a print."""
        card = self.printer.lookup_object("virtual_sdcard", None)
        return bool(card and card.is_cmd_from_sd())

    def begins_print(self) -> bool:
        """Return whether a print is under way that has not extruded anything yet."""
        status = self._print_stats()
        is_printing = status.get("state") == "printing"
        return is_printing and not status.get("print_duration")

    def print_began(self) -> float:
        """Return when the print has begun that is under way (eventtime), 0: none is."""
        status, now = self._print_stats(), self.eventtime()
        if not self.print_state():
            return 0.0
        seconds: float = status.get("total_duration", 0.0)
        return now - seconds

    def _print_stats(self) -> Status:
        stats = self.printer.lookup_object("print_stats", None)
        return stats.get_status(self.eventtime()) if stats else {}

    def is_file_output(self) -> bool:
        """Return whether klippy writes what it would send into a file, as in its tests.

        No switch answers then, and nothing moves.
        """
        mcu = self.printer.lookup_object("mcu")
        return bool(mcu.is_fileoutput())

    def toolhead_status(self) -> Status:
        """Return the status of the toolhead."""
        return self.toolhead.get_status(self.eventtime())

    def is_homed(self, axes: str = "xyz") -> bool:
        """Return whether all of these axes are homed."""
        homed = self.toolhead_status()["homed_axes"]
        return all(axis in homed for axis in axes)

    def extruder(self) -> str:
        """Return the section of the active extruder; empty: the printer has none."""
        return self.toolhead_status().get("extruder") or ""

    def nozzle_temperature(self) -> float:
        """Return what the nozzle has or is to have, whichever is more (degrees C)."""
        status = self._extruder_status()
        degrees: float = status.get("temperature", 0.0)
        return max(degrees, self.nozzle_target())

    def nozzle_target(self) -> float:
        """Return what the nozzle is to have (degrees C), 0: its heater is off."""
        degrees: float = self._extruder_status().get("target", 0.0)
        return degrees

    def nozzle_celsius(self) -> float:
        """Return how hot the nozzle is (degrees C)."""
        degrees: float = self._extruder_status().get("temperature", 0.0)
        return degrees

    def heat(self, extruder: str, target: float) -> None:
        """Have the heater of an extruder's section have a target (degrees C), 0: off."""
        self.gcode.run_script_from_command(
            f"SET_HEATER_TEMPERATURE HEATER={extruder} TARGET={target:g}"
        )

    def wanted_temperatures(self) -> Dict[str, float]:
        """Return how hot (degrees C) bed and chamber are, or are to be.

        Those that the printer has: [heater_bed], and a heater or a sensor whose name is
        chamber.  What a broken sensor says is left out.
        """
        found: Dict[str, float] = {}
        for name, heater in self.printer.lookup_objects():
            part = {"heater_bed": "bed", "chamber": "chamber"}.get(
                name.split()[-1]
            )
            if part is None or not name.startswith(("heater_", "temperature_")):
                continue
            status = heater.get_status(self.eventtime())
            degrees = status.get("temperature")
            if name.startswith("heater_"):
                # That of a fan is what it cools down to
                degrees = status.get("target") or degrees
            is_number = isinstance(degrees, (int, float))
            if is_number and COLDEST <= degrees <= HOTTEST:
                found[part] = round(degrees, 1)
        return found

    def _extruder_status(self) -> Status:
        name = self.extruder()
        extruder = self.printer.lookup_object(name, None) if name else None
        return extruder.get_status(self.eventtime()) if extruder else {}

    ##################################################################
    # Words for the user, on the console and as the error of a command
    ##################################################################

    def say(self, text: str) -> None:
        """Show a line on the console, with the section in front."""
        self.gcode.respond_info(f"{self.section}: {text}")

    def error(self, text: object) -> Exception:
        """Return the error of a command, with the section in front."""
        return self.printer.command_error(f"{self.section}: {text}")

    @contextlib.contextmanager
    def as_command_error(self, gcmd: GCodeCommand) -> Iterator[None]:
        """Have a CalibrationError become the error of a command."""
        try:
            yield
        except CalibrationError as e:
            raise gcmd.error(f"{self.section}: {e}")

    def save(self, option: str, text: str) -> None:
        """Hand a value of the section to SAVE_CONFIG, and say so."""
        configfile = self.printer.lookup_object("configfile")
        configfile.set(self.section, option, text)
        self.gcode.respond_info(
            f"{self.section}: {option}: {text}\n"
            "The SAVE_CONFIG command will update the printer config file\nwith the"
            " above and restart the printer."
        )

    def wrap_command(
        self, name: str, around: Callable[[Handler, GCodeCommand], None]
    ) -> None:
        """Put around(command, gcmd) in the place of a command of the host.

        command(gcmd) runs the host's own, as a macro with rename_existing does.  A host
        without that command stays so.
        """
        command = self.gcode.register_command(name, None)
        if command is None:
            return

        # Kalico would show a docstring, or that of a partial, as the command's help
        def _wrapped(gcmd: GCodeCommand) -> None:
            around(command, gcmd)

        text = self.gcode.gcode_help.get(name)
        self.gcode.register_command(name, _wrapped, desc=text)

    def listeners(self) -> List[Any]:
        """Return the clients of the API that listen to the console.

        No host says so; each keeps them where its output goes to.
        """
        outputs = [
            getattr(callback, "__self__", None)
            for callback in getattr(self.gcode, "output_callbacks", ())
        ]
        return [c for out in outputs for c in getattr(out, "clients", ())]

    def warn(self, text: str) -> None:
        """Add a warning of the configuration: web interfaces show it until a restart."""
        configfile = self.printer.lookup_object("configfile")
        text = f"{self.section}: {text}"
        if hasattr(configfile, "warn"):
            # Kalico, whose runtime_warning() drops what others have told before
            configfile.warn("runtime_warning", text)
        elif hasattr(configfile, "runtime_warning"):
            # Since 2024-03-13 (0291a1554)
            configfile.runtime_warning(text)
