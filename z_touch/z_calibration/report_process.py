"""Z_CALIBRATION_REPORT: z_touch/report as a process of its own.

It draws the history while klippy goes on. A timer looks whether it has ended, reports
what it says, and ends it where it takes too long.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
from typing import IO, TYPE_CHECKING, Any, Dict, List, Optional

from .. import FOLDER

if TYPE_CHECKING:
    from ..host.printer import Host
    from .run_log import RunLog

# How often (s) it is looked whether the report is done, and when it is ended
POLL_INTERVAL = 0.25
REPORT_TIME = 60.0

# Sections whose options are of no use to those who are asked for help, and long
LEFT_OUT = ("gcode_macro ", "delayed_gcode ", "bed_mesh ", "display_")


class ReportProcess:
    """The report that is under way, if any, and the command that starts one."""

    def __init__(self, host: Host, run_log: RunLog) -> None:
        """Get ready to report of the runs of a RunLog."""
        self.host = host
        self.run_log = run_log
        self._process: Optional[subprocess.Popen[bytes]] = None
        # What it writes: a pipe would fill up, as it is not read meanwhile
        self._files: List[IO[bytes]] = []
        self._end = 0.0
        self._is_too_long = False
        reactor = host.printer.get_reactor()
        self._timer = reactor.register_timer(self._look)
        for event in ("klippy:disconnect", "klippy:shutdown"):
            host.printer.register_event_handler(event, self.kill)

    cmd_Z_CALIBRATION_REPORT_help = (
        "Draw the history of the Z calibration, and write what to attach"
    )

    def cmd_Z_CALIBRATION_REPORT(self, gcmd: Any) -> None:
        """Start the report, with the text to attach; the console has the rest later."""
        if self.run_log.path is None:
            raise gcmd.error(
                f"{self.host.section}: there is no history to report of: 'history' is"
                " none; name a folder there"
            )
        if self._process is not None:
            # An error would end a print whose macro draws it
            self.host.say("a report is under way; wait until it is done")
            return
        try:
            self._start(self.run_log.path, self._facts())
        except OSError as e:
            raise gcmd.error(
                f"{self.host.section}: the report cannot be started: {e}"
            ) from e

    def judge_cycles(self) -> None:
        """Start the report after CALIBRATE_Z_ACCURACY: its verdict is in there."""
        if self.run_log.path is None:
            self.host.say("there is no verdict, as 'history' is none")
        elif self._process is not None:
            self.host.say(
                "a report is under way; Z_CALIBRATION_REPORT tells the verdict when it"
                " is done"
            )
        else:
            try:
                self._start(self.run_log.path, {})
            except OSError as e:
                self.host.say(f"the report cannot be started: {e}")

    def _facts(self) -> Dict[str, object]:
        """Return what klippy alone knows, for the text to attach."""
        host, eventtime = self.host, self.host.eventtime()
        configfile = host.printer.lookup_object("configfile")
        section = host.printer.lookup_object(host.section)
        version = host.printer.get_start_args().get("software_version", "?")
        settings = configfile.get_status(eventtime)["settings"]
        return {
            "section": host.section,
            "versions": {
                "z_calibration": self.run_log.version,
                "Klipper": version,
            },
            "settings": {
                name: options
                for name, options in settings.items()
                if not name.startswith(LEFT_OUT)
            },
            "status": section.get_status(eventtime),
        }

    def _start(self, path: str, facts: Dict[str, object]) -> None:
        """Start it; raises OSError.

        With a whole path and close_fds=False Popen uses posix_spawn(), which holds
        klippy for 1 ms; fork(), which Python 3.9 uses otherwise, copies the page tables
        of a klippy of 60 MB in 6 to 11. What Python opens is not inherited anyway
        (PEP 446). The child runs nothing of ours before it is another program.
        """
        # Nothing that klippy does may wait for a picture
        command = [shutil.which("nice") or "nice", "-n", "19"]
        command += [sys.executable, os.path.join(FOLDER, "report"), path]
        # What it says, and what is wrong: open until it has ended
        self._files = [
            tempfile.TemporaryFile(),  # noqa: SIM115
            tempfile.TemporaryFile(),  # noqa: SIM115
        ]
        with tempfile.TemporaryFile() as given:
            if facts:
                command += ["--facts", "-"]
                given.write(json.dumps(facts, default=str).encode("ascii"))
                given.seek(0)
            try:
                self._process = subprocess.Popen(
                    command,
                    stdin=given,
                    stdout=self._files[0],
                    stderr=self._files[1],
                    close_fds=False,
                )
            except OSError:
                self._read()
                raise
        reactor = self.host.printer.get_reactor()
        now = reactor.monotonic()
        self._end, self._is_too_long = now + REPORT_TIME, False
        reactor.update_timer(self._timer, now + POLL_INTERVAL)

    def kill(self) -> None:
        """End a report that is under way, without a word."""
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        try:
            process.wait(1.0)
        except subprocess.TimeoutExpired:
            logging.warning("%s: the report does not end", self.host.section)
        self._read()

    def _look(self, eventtime: float) -> float:
        """Report what it has said, if it has ended.  A timer: never pauses."""
        if self._process is None:
            return self.host.printer.get_reactor().NEVER
        status = self._process.poll()
        if status is None:
            if eventtime > self._end:
                self._is_too_long = True
                self._process.kill()
            return eventtime + POLL_INTERVAL
        self._process = None
        said, wrong = self._read()
        if self._is_too_long:
            self.host.say(
                f"the report took more than {REPORT_TIME:.0f} s; ended"
            )
        elif status:
            logging.error("%s: report: %s", self.host.section, wrong)
            last = wrong.strip().rpartition("\n")[2]
            self.host.say(f"the report has failed: {last or status}")
        for line in said.splitlines():
            self.host.say(line)
        return self.host.printer.get_reactor().NEVER

    def _read(self) -> List[str]:
        """Return what it has said, and what was wrong; the files are gone then."""
        texts = []
        for file in self._files:
            with file:
                file.seek(0)
                texts.append(file.read(100_000).decode("utf-8", "replace"))
        self._files = []
        return texts
