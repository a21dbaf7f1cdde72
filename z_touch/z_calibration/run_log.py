"""The runs of this printer, which [z_calibration] keeps in a file beside printer.cfg.

It is read once, when klippy connects and nothing moves yet: 1000 runs take 25 ms of a
desktop's time. Each run appends one line, in plain file I/O on klippy's main thread and
without waiting for the disk: what a power loss takes is the last lines, at most. What
is wrong with the file is reported once, and fails no run.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import errno
import logging
import math
import os
import time
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    List,
    Mapping,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from . import runs
from .runs import SITES, Run
from .statistics import pool

if TYPE_CHECKING:
    from ..host.printer import Host
    from .statistics import RunStatistics, Spread

# Of the file only so many bytes are read, the last ones: klippy waits for it
MOST_BYTES = 8_000_000

# Lines beyond history_runs, as a part of it, with which the file is written anew
TOO_MANY = 0.1

# Runs in the status
RESULTS = 10


class RunLog:
    """The runs of before, and the one file that the next ones are appended to.

    runs: the calibrations, the oldest first. status: what
    get_status() has of them. notes: what was wrong with the file when klippy connected,
    for the notes of the start.
    """

    def __init__(self, host: Host, settings: Any, version: str) -> None:
        """Find the file: of the options 'history' and 'history_runs'.

        version: of the modules, which each line has.
        """
        self.host = host
        self.version = version
        self.limit: int = settings.history_runs
        self.path = path_of(config_path(host), settings.history)
        self.runs: List[Run] = []
        self.status = status_of([])
        self.notes: List[str] = []
        self._reported: Set[str] = set()
        host.printer.register_event_handler("klippy:connect", self._read)

    ##################################################################
    # What the next run wants to know
    ##################################################################

    def last_good(self, extruder: str) -> Optional[Run]:
        """Return the last good run with the nozzle of that extruder."""
        for run in reversed(self.runs):
            if run.ok and run.is_of(extruder):
                return run
        return None

    def spreads(self, bed_spread: float = 0.0) -> Dict[str, List[Spread]]:
        """Return how a touch varied in each of the last runs, by site.

        bed_spread: that of the run that asks, mm.
        """
        return {
            site: runs.spreads(self.runs, site, bed_spread) for site in SITES
        }

    def departure(
        self, body: float, extruder: str, temperatures: Mapping[str, float]
    ) -> float:
        """Return by how much (mm) switch - nozzle departs from runs that were as hot.

        0: not by more than chance, or nothing is known.
        """
        own = [run for run in self.runs if run.is_of(extruder)]
        return runs.departure(body, runs.bodies_as_hot(own, temperatures))

    def nozzle_at(self) -> Optional[runs.Point]:
        """Return where a nozzle has last touched the pin with the probe attached."""
        for run in reversed(self.runs):
            if run.ok and run.nozzle_at:
                return run.nozzle_at
        return None

    def next_turn(self) -> int:
        """Return by how many turns the points of the next run with bed_spread are turned."""
        turns = [run.turn for run in self.runs if run.bed_spread]
        return turns[-1] + 1 if turns else 0

    ##################################################################
    # A run has ended
    ##################################################################

    def measured(
        self, plan: RunStatistics, began: float, bed_spread: float = 0.0
    ) -> Run:
        """Return what a run that has ended has measured, as one that was refused.

        plan: its touches; began: eventtime. dataclasses.replace() makes a good one of
        it.
        """
        eventtime = self.host.eventtime()
        sites = site_runs(plan)
        retries = sum(
            len(plan.touches[site]) - len(kept.samples)
            for site, kept in sites.items()
        )
        return Run(
            ok=False,
            time=round(time.time(), 1),
            sites=sites,
            extruder=self.host.tools.active(),
            bed_spread=bed_spread,
            turn=plan.turn,
            revision=self.version,
            duration=round(eventtime - began, 2),
            retries=retries,
            dirty=bool(plan.flattened("nozzle")),
            temperatures=temperatures(self.host, eventtime),
        )

    def append_wait(self, waited: Sequence[runs.Point], is_still: bool) -> None:
        """Keep what Z_CALIBRATION_WAIT has seen: minutes, and the height of the pin (mm)."""
        self.append(
            Run(
                ok=is_still,
                time=round(time.time(), 1),
                sites={},
                extruder=self.host.tools.active(),
                revision=self.version,
                temperatures=temperatures(self.host, self.host.eventtime()),
                waited=tuple((round(m, 2), round(z, 6)) for m, z in waited),
            )
        )

    def append(self, run: Run) -> None:
        """Keep a run; what cannot be written is reported, and fails nothing."""
        if run.is_calibration:
            # Without a file the last ones, as long as klippy lives
            limit = runs.RECENT if self.path is None else self.limit
            self.runs = [*self.runs, run][-limit:]
            self.status = status_of(self.runs)
        if self.path is None:
            return
        try:
            add_line(self.path, runs.line_of(run))
        except (OSError, ValueError) as e:
            self._report(cannot_be_kept(self.path, e))

    def _report(self, text: str) -> None:
        """Say it on the console, but not again: a disk stays full."""
        logging.warning("%s: %s", self.host.section, text)
        if text not in self._reported:
            self._reported.add(text)
            self.host.say(text)

    ##################################################################
    # The runs of before
    ##################################################################

    def _read(self) -> None:
        if self.path is None:
            return
        try:
            lines, is_whole = last_lines(self.path)
            if not is_whole or len(lines) > self.limit * (1.0 + TOO_MANY):
                write_anew(self.path, lines[-self.limit :])
        except OSError as e:
            self.notes = [cannot_be_kept(self.path, e)]
            self._reported.update(self.notes)
            return
        parsed = runs.parse_all(lines[-self.limit :])
        self.runs = [run for run in parsed.runs if run.is_calibration]
        for text, count in (
            ("%d damaged lines of %s are left out", parsed.damaged),
            (
                "%d lines of %s are of another version, and left out",
                parsed.other,
            ),
        ):
            if count:
                self.notes.append(text % (count, self.path))
        self.status = status_of(self.runs)


######################################################################
# The runs in the status, and a run in records
######################################################################


def status_of(known: Sequence[Run]) -> Dict[str, object]:
    """Return what get_status() has of runs, the oldest first."""
    last = known[-1] if known else None
    bed_spread = last.bed_spread if last else 0.0
    spreads = {
        site: pool(runs.spreads(known, site, bed_spread)) for site in SITES
    }
    return {
        "runs": len(known),
        "results": [
            {
                "time": run.time,
                "ok": run.ok,
                "offset": run.offset if run.ok else None,
                "uncertainty": run.uncertainty,
                "reason": run.reason,
            }
            for run in known[-RESULTS:]
        ],
        "spread": {
            site: math.sqrt(spread.variance) if spread.dof else None
            for site, spread in spreads.items()
        },
        "switch_nozzle": switch_nozzle(known),
    }


def switch_nozzle(known: Sequence[Run]) -> Optional[float]:
    """Return the usual switch - nozzle (mm) with the nozzle of the last run.

    None: there are too few runs.
    """
    own = [run for run in known if run.is_of(known[-1].extruder)]
    usual = runs.usual(runs.bodies_as_hot(own, {}))
    return None if usual is None else usual.middle


def temperatures(host: Host, eventtime: float) -> Dict[str, float]:
    """Return how hot (C) nozzle and bed are: of the extruder that is active."""
    found = {}
    for name, section in (
        ("extruder", host.extruder() or "extruder"),
        ("heater_bed", "heater_bed"),
    ):
        heater = host.printer.lookup_object(section, None)
        if heater is not None:
            status = heater.get_status(eventtime)
            found[name] = round(status.get("temperature", 0.0), 1)
    return found


def site_runs(plan: RunStatistics) -> Dict[str, runs.SiteRun]:
    """Return the touches of a run by site; where they did not agree, all of them."""
    found = {}
    for site in SITES:
        touches = plan.touches.get(site)
        if not touches:
            continue
        samples, z = touches, math.fsum(touches) / len(touches)
        if site in plan.estimates:
            samples, z = plan.samples[site], plan.estimates[site].z
        found[site] = runs.site_run(
            samples,
            z,
            touches=touches,
            usual=plan.usual_noise(site),
            points=plan.points if site == "bed" else (),
        )
    return found


######################################################################
# The file; each may raise OSError
######################################################################


def config_path(host: Host) -> str:
    """Return the whole path of printer.cfg."""
    path: str = host.printer.get_start_args().get("config_file", "")
    return os.path.abspath(os.path.expanduser(path))


def path_of(config: str, folder: Optional[str]) -> Optional[str]:
    """Return the file in a folder beside a printer.cfg, which has the name of that.

    config: its whole path. None: nothing is kept, as the folder is None.
    """
    if folder is None:
        return None
    beside, name = os.path.split(config)
    name = os.path.splitext(name)[0] + ".jsonl"
    return os.path.join(beside, os.path.expanduser(folder), name)


def cannot_be_kept(path: str, error: Exception) -> str:
    """Return what is reported of an error."""
    words = error.strerror if isinstance(error, OSError) else str(error)
    return (
        f"the history cannot be kept in {path}: {words}; mend that, or set"
        " 'history: none'"
    )


def last_lines(path: str) -> Tuple[List[bytes], bool]:
    """Return the last lines of a file, and whether these are all.

    There are none where there is no file yet.
    """
    runs.check_file(path)
    try:
        with open(path, "rb") as f:
            begin = f.seek(0, os.SEEK_END) - MOST_BYTES
            f.seek(max(begin, 0))
            lines = f.read(MOST_BYTES).split(b"\n")
    except FileNotFoundError:
        return [], True
    if begin > 0:
        # Of the first one the beginning is missing
        del lines[0]
    return [line for line in lines if line.strip()], begin <= 0


def write_anew(path: str, lines: List[bytes]) -> None:
    """Replace a file by one with these lines; it stays as it was where that fails."""
    new = f"{path}.new"
    try:
        with open(new, "wb") as f:
            f.writelines(line + b"\n" for line in lines)
        os.replace(new, path)
    except OSError:
        if os.path.isfile(new):
            os.remove(new)
        raise


def add_line(path: str, line: bytes) -> None:
    """Append a line; what is there stays whole, also where the disk gets full."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    runs.check_file(path)
    with open(path, "ab+", buffering=0) as f:
        end = f.seek(0, os.SEEK_END)
        if end:
            f.seek(end - 1)
            if f.read(1) != b"\n":
                # Cut by a power loss: that one ends here
                line = b"\n" + line
        try:
            if f.write(line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            f.truncate(end)
            raise
