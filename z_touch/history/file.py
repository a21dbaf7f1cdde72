# The runs of a printer, one line of JSON each, in a file beside printer.cfg.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# All that may take time runs in a thread of its own, which gives way every few
# lines: klippy's main thread gets the interpreter within a millisecond.  Nothing
# in here raises at whoever measures; what is wrong becomes a warning.
from __future__ import absolute_import, division

import errno
import fcntl
import json
import logging
import math
import os
import threading
import time

from ..core.sampling import summarize
from ..uncertainty.estimate import (
    UNKNOWN,
    Spread,
    pool,
    spread_of,
    without_outliers,
)
from . import trend

SITES = ("nozzle", "switch", "bed")
FILE = "history.jsonl"

# Lines between two pauses, and how long these are (s)
LINES_AT_ONCE = 4
PAUSE = 0.0005

# How long (s) another printer's turn at the same file is waited for
PATIENCE = 5.0

# Runs in the status, and runs that say how much a touch of a site varies
RESULTS = 10
RECENT = 20


# Farther (mm) from the middle of all touches of a site is an accident, no noise
NO_NOISE = 0.05


# Gives way to klippy's main thread
def pause():
    time.sleep(PAUSE)


######################################################################
# Records
######################################################################

# A run is a dict: 'ok', 'time' (s since 1970), 'printer', 'reason', 'sites' by
# name with 'z', 'sd', 'n' and 'samples' (mm), 'temperatures' (C), and, of a good
# one, 'offset', 'uncertainty' and 'switch_offset' (mm).  One of
# CALIBRATE_Z_ACCURACY has 'cycles', too.


# A number that no printer and no clock has is none, either
def is_number(value):
    good = isinstance(value, (int, float)) and not isinstance(value, bool)
    return good and abs(value) < 1e12


def are_numbers(values):
    return isinstance(values, list) and all(map(is_number, values))


# A line as a record, or None: whoever edits the file by hand may write anything
def parse(line):
    try:
        record = json.loads(line.decode("utf-8"))
    except ValueError:
        return None
    return record if is_record(record) else None


def is_record(record):
    if not isinstance(record, dict) or not isinstance(record.get("ok"), bool):
        return False
    sites = record.get("sites")
    if not is_number(record.get("time")) or not isinstance(sites, dict):
        return False
    if not all(name in SITES and is_site(s) for name, s in sites.items()):
        return False
    heat, worth = record.get("temperatures", {}), record.get("uncertainty")
    if not isinstance(heat, dict) or not are_numbers(list(heat.values())):
        return False
    if not (worth is None or is_number(worth)):
        return False
    if not isinstance(record.get("wear", []), list):
        return False
    if not are_cycles(record.get("cycles", [])):
        return False
    if record["ok"]:
        numbers = [record.get("offset"), record.get("switch_offset")]
        return len(sites) == len(SITES) and all(map(is_number, numbers))
    return True


def is_site(site):
    if not isinstance(site, dict) or not is_number(site.get("z")):
        return False
    if not are_numbers(site.get("samples")):
        return False
    if not are_numbers(site.get("touches", [])):
        return False
    return is_number(site.get("sd")) and is_number(site.get("n"))


def are_cycles(cycles):
    return isinstance(cycles, list) and all(
        isinstance(cycle, dict) and all(map(are_numbers, cycle.values()))
        for cycle in cycles
    )


# What a record has of a site: its height (mm), the samples that count, all touches
# where some were rejected, and how these vary, as far as they are noise.
def site_record(samples, z, step, touches=None, earlier=UNKNOWN):
    touches = touches or samples
    middle = summarize(touches, "median")
    near = [z for z in touches if abs(z - middle) <= NO_NOISE]
    kept = without_outliers(near, earlier, step)
    spread = spread_of(kept)
    record = {
        "z": round(z, 6),
        "sd": round(math.sqrt(spread.variance), 6),
        "n": len(kept),
        "samples": [round(sample, 6) for sample in samples],
    }
    if len(touches) > len(samples):
        record["touches"] = [round(touch, 6) for touch in touches]
    return record


# The Spread of one touch at a site in each of the latest runs, refused ones, too:
# without what made them refused the others look better than they are.
def spreads_in(runs, site):
    measured = [run["sites"].get(site) for run in runs[-RECENT:]]
    return [
        Spread(max(s["sd"], 0.0) ** 2, max(int(s["n"]) - 1, 0))
        if s
        else UNKNOWN
        for s in measured
    ]


######################################################################
# The file
######################################################################


# The file; every method may raise IOError or OSError.
class File(object):
    # 'limit': runs that are kept
    def __init__(self, folder, limit):
        self.folder = folder
        self.path = os.path.join(folder, FILE)
        self.limit = limit

    # The records of all printers that write here, the oldest first, and how
    # many lines are none
    def read(self):
        records, damaged = [], 0
        if not os.path.exists(self.path):
            return records, damaged
        with open(self.path, "rb") as f:
            for number, line in enumerate(f):
                if number % LINES_AT_ONCE == 0:
                    pause()
                record = parse(line) if line.strip() else None
                damaged += record is None and bool(line.strip())
                if record is not None:
                    records.append(record)
        return records[-self.limit :], damaged

    def append(self, record):
        line = json.dumps(record, sort_keys=True, allow_nan=False)
        line = line.encode("ascii") + b"\n"
        if not os.path.exists(self.folder):
            os.makedirs(self.folder)
        with Turn(self.folder):
            self._add(line)
            pause()
            self._drop_oldest()

    # What is there stays whole, also where the disk is full half-way
    def _add(self, line):
        fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            size = os.fstat(fd).st_size
            if size:
                os.lseek(fd, size - 1, os.SEEK_SET)
                if os.read(fd, 1) != b"\n":
                    # Cut by a power loss: that one ends here
                    line = b"\n" + line
            try:
                if os.write(fd, line) != len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(fd)
            except OSError:
                os.ftruncate(fd, size)
                raise
        finally:
            os.close(fd)

    def _drop_oldest(self):
        with open(self.path, "rb") as f:
            data = f.read()
        begin, drop = 0, data.count(b"\n") - self.limit
        for _ in range(drop):
            begin = data.index(b"\n", begin) + 1
        if begin:
            replace(self.path, data[begin:])


# Writes a file anew, by another one that takes its place: it has all of the data,
# or stays as it was.
def replace(path, data):
    path = os.path.realpath(path)
    new = path + ".new"
    try:
        with open(new, "wb") as f:
            f.write(data)
            f.flush()
            os.fsync(f.fileno())
        os.rename(new, path)
    except (IOError, OSError):
        if os.path.exists(new):
            os.remove(new)
        raise


# While it lasts no other printer writes into the folder.  Where the file system
# knows no such thing, or another one keeps it, it goes without.
class Turn(object):
    def __init__(self, folder):
        self.folder = folder
        self.fd = None

    def __enter__(self):
        self.fd = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        for _ in range(int(PATIENCE / 0.05)):
            try:
                fcntl.flock(self.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except (IOError, OSError) as e:
                if e.errno not in (errno.EAGAIN, errno.EACCES):
                    return
            time.sleep(0.05)

    def __exit__(self, *unused):
        os.close(self.fd)


######################################################################
# The runs of a printer
######################################################################


# The runs of one printer, on klippy's main thread
class History(object):
    # 'file': None where nothing is kept.  say(text) is called on the main
    # thread, when there is something to warn of.
    def __init__(self, reactor, file, printer, say):
        self.reactor = reactor
        self.file = file
        # The name of printer.cfg, as several printers may have one folder
        self.printer = printer
        self.say = say
        self.runs = []
        self.summary = trend.summarize_runs([])
        self.told = set()
        self.status = {}
        self.lock = threading.Lock()
        self._show()

    # Read what is there; ready some milliseconds later
    def begin(self):
        if self.file is not None:
            self.in_thread(self._read)

    # Calls work(*args) in a thread, which ends with that: klippy's end waits for
    # nobody.
    def in_thread(self, work, *args):
        thread = threading.Thread(target=self._guard, args=(work, args))
        thread.daemon = True
        try:
            thread.start()
        except RuntimeError:
            logging.exception("history: no thread")

    def _guard(self, work, args):
        try:
            with self.lock:
                work(*args)
        except (IOError, OSError) as e:
            logging.warning("history: %s", e)
            text = (
                "the history cannot be kept in %s: %s; 'history: none' ends it"
            )
            self.later(self.warn, text % (self.file.folder, e.strerror))
        except Exception as e:
            # Of a history no calibration may fail, whatever it is
            logging.exception("history")
            self.later(self.warn, "the history cannot be kept: %s" % (repr(e),))

    def later(self, call, *args):
        self.reactor.register_async_callback(lambda eventtime: call(*args))

    # Once for each reason: a disk stays full
    def warn(self, text):
        if text not in self.told:
            self.told.add(text)
            self.say(text)

    def _read(self):
        records, damaged = self.file.read()
        if damaged:
            text = "%d damaged lines of %s are left out"
            self.later(self.warn, text % (damaged, self.file.path))
        runs = self._of_this_printer(records)
        self.later(self._take, runs, trend.summarize_runs(runs, pause), [])

    def _of_this_printer(self, records):
        return [
            r
            for r in records
            if r.get("printer") == self.printer and "cycles" not in r
        ]

    # A run that has ended.  Returns at once.
    def add(self, record):
        record["printer"] = self.printer
        if self.file is None:
            # As long as klippy lives: how touches vary is all that is asked of it
            if "cycles" not in record:
                self.runs = (self.runs + [record])[-RECENT:]
                self._show()
            return
        if "cycles" in record:
            self.in_thread(self.file.append, record)
            return
        runs = (self.runs + [record])[-self.file.limit :]
        # What the next run is compared with; the rest follows
        self.runs = runs
        self._show()
        self.in_thread(self._write, record, runs)

    # What is worn is told with the run that has shown it
    def _write(self, record, runs):
        pause()
        worn = trend.wear(runs, pause)
        record["wear"] = [name for name, text in worn]
        texts = [text for name, text in worn]
        self.later(self._take, None, trend.summarize_runs(runs, pause), texts)
        self.file.append(record)

    # 'runs' None: they are here already
    def _take(self, runs, summary, texts):
        if runs is not None:
            # A run may have ended before all was read
            self.runs = (runs + self.runs)[-self.file.limit :]
        self.summary = summary
        self._show()
        for text in texts:
            self.say(text)

    # Of each site the Spread of one touch in each of the last runs
    def spreads(self):
        return dict((site, spreads_in(self.runs, site)) for site in SITES)

    def _show(self):
        spreads = dict((s, pool(past)) for s, past in self.spreads().items())
        names = ("time", "ok", "offset", "uncertainty", "reason")
        self.status = {
            "runs": len(self.runs),
            "results": [
                dict((name, run.get(name)) for name in names)
                for run in self.runs[-RESULTS:]
            ],
            "spread": dict(
                (site, math.sqrt(spread.variance) if spread.dof else None)
                for site, spread in spreads.items()
            ),
            "switch_nozzle": self.summary.fingerprint.middle,
        }
