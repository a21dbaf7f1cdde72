"""Z_CALIBRATION_WAIT: the nozzle touches the pin each minute until both stand still.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional

from .. import command, warming
from ..warming import Warming

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand
    from .module import ZCalibration
    from .run import CalibrationRun
    from .settings import Settings


def settings_of(settings: Settings) -> Settings:
    """Return the settings of touches that show how the pin moves.

    Touches that differ must not end the wait.
    """
    sampling = warming.sampling_of(settings.on_pin, float("inf"))
    return settings.replace(samples=None, on_pin=sampling)


class WaitForWarming:
    """The command that waits, and what it saw last."""

    def __init__(self, calibration: ZCalibration):
        self.calibration = calibration
        self.host = calibration.host
        self.progress = calibration.progress
        # By how much the pin has moved last (mm a minute, up is positive), None: not known
        self.movement: Optional[float] = None
        command.register_commands(self.host, self)

    cmd_Z_CALIBRATION_WAIT_help = (
        "Touch the pin with the nozzle each minute until it stands still"
    )

    def cmd_Z_CALIBRATION_WAIT(self, gcmd: GCodeCommand) -> None:
        """Touch the pin with the nozzle each minute until it stands still.

        Where it does not within MAX, that is shown, and a print goes on.
        """
        calibration = self.calibration
        calibration.refuse_during_a_print(gcmd, own=True)
        wanted = warming.wanted_of(gcmd)
        settings = settings_of(calibration.settings)
        touches = wanted.touches(settings.on_pin)
        with calibration.running(
            gcmd, "nozzle", touches, has_error_gcode=False
        ), calibration.nozzle_run(gcmd, settings) as run:
            calibration.note_oozing(run)
            seen = self.until_still(run, wanted)
        calibration.run_log.append_wait(seen.heights, seen.is_still)
        gcmd.respond_info(f"Z_CALIBRATION_WAIT: {seen.result()}")

    def until_still(
        self, run: CalibrationRun, wanted: warming.Wanted
    ) -> Warming:
        """Touch the pin each minute until it stands still, or has been watched long enough.

        Between two touches the toolhead is lifted.  May pause.
        """
        self.movement = None
        seen = Warming(self.host, self.progress, wanted)
        while not seen.is_over():
            seen.wait()
            seen.add(run.touch_nozzle(self.calibration.user_gcode))
            self.movement = seen.movement
            run.lift()
        return seen
