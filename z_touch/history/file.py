# The runs of a printer, one line of JSON each, in a file beside printer.cfg.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# All that may take time runs in a thread of its own, which gives way every few
# lines: klippy's main thread gets the interpreter within a millisecond.  Nothing
# in here raises at whoever measures; what is wrong becomes a warning.

import collections
import errno
import fcntl
import functools
import json
import logging
import math
import os
import threading
import time

from ..core.sampling import summarize
from ..core.spread import ROUGH, TEXTURE
from ..uncertainty.estimate import (
    UNKNOWN,
    USUAL_NOISE,
    pool,
    spread_of,
    without_outliers,
)
from . import trend
from .formats import FORMAT, modernize

SITES = ("nozzle", "switch", "bed")
FILE = "history.jsonl"

# A longer line (bytes) is damaged: 200 cycles of 30 touches at each site are shorter
LONGEST = 262144

# Digits of a whole number; Python takes long for more of them
DIGITS = 20

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

# A run is a dict: 'format', 'ok', 'printer' (the path of its printer.cfg), 'plate'
# (as in the command, ""), 'extruder' (whose nozzle it was), 'bed_spread' (mm),
# 'reason', 'sites' by name with 'z', 'sd', 'n', 'samples' (mm) and, of the bed with
# bed_spread, 'points' (X and Y of each touch, mm), 'temperatures' (C), 'wear' and
# 'changed', see trend.py, 'time' (s since 1970; in the file it may be missing, read()
# makes 0 of that), and, of a good one, 'nozzle_at' (X and Y, mm, or None, see
# places.py), 'offset', 'uncertainty' and 'switch_offset' (mm), and 'warnings', each
# with 'about', see formats.py, and 'text'.  One of CALIBRATE_Z_ACCURACY has 'cycles',
# too, and 'cause' and 'verdict', see uncertainty/cycles.py.


# Names of files may come as bytes
def as_text(value):
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(value)


# A number that no printer and no clock has is none, either
def is_number(value):
    good = isinstance(value, (int, float)) and not isinstance(value, bool)
    return good and abs(value) < 1e12


def are_numbers(values):
    return isinstance(values, list) and all(map(is_number, values))


def whole_number(digits):
    return int(digits) if len(digits) <= DIGITS else float("inf")


# A line as a dict of this format, or an earlier one: whoever edits the file by hand
# may write anything.  None: it is none; {}: it is of a later format.
def load(line):
    try:
        record = json.loads(line.decode("utf-8"), parse_int=whole_number)
    except (ValueError, RuntimeError, MemoryError):
        # The second one is of nesting without end
        return None
    if not isinstance(record, dict):
        return None
    number = record.get("format", 0)
    number = number if is_number(number) else 0
    if number > FORMAT:
        return {}
    modernize(record, number)
    return record


# A line as a record, or None
def parse(line):
    record = load(line)
    return record if record and is_record(record) else None


def is_record(record):
    sites = record.get("sites")
    if not isinstance(record.get("ok"), bool) or not isinstance(sites, dict):
        return False
    if not all(name in SITES and is_site(s) for name, s in sites.items()):
        return False
    if not (has_names(record) and has_marks(record)):
        return False
    heat, worth = record.get("temperatures", {}), record.get("uncertainty")
    if not isinstance(heat, dict) or not are_numbers(list(heat.values())):
        return False
    if not (worth is None or is_number(worth)):
        return False
    if not are_cycles(record.get("cycles", [])):
        return False
    if record["ok"]:
        numbers = [record.get("offset"), record.get("switch_offset")]
        return len(sites) == len(SITES) and all(map(is_number, numbers))
    return True


# Its printer, plate and places, and when it was
def has_names(record):
    if not is_number(record.setdefault("time", 0.0)):
        return False
    names = [
        name for name in ("printer", "plate", "extruder") if name in record
    ]
    is_text = all(isinstance(record[name], str) for name in names)
    place = record.get("nozzle_at")
    is_place = place is None or is_point(place)
    return is_text and is_place and is_number(record.get("bed_spread", 0.0))


# What was told with the run
def has_marks(record):
    worn, changed = record.get("wear", []), record.get("changed", [])
    return (
        isinstance(worn, list)
        and isinstance(changed, list)
        and all(isinstance(c, dict) and is_change(c) for c in changed)
        and has_warnings(record)
    )


def has_warnings(record):
    warnings = record.get("warnings", [])
    return isinstance(warnings, list) and all(
        isinstance(warning, dict)
        and isinstance(warning.get("about"), str)
        and isinstance(warning.get("text"), str)
        for warning in warnings
    )


def is_change(change):
    count = change.get("runs")
    return is_number(change.get("by")) and is_number(count) and count >= 1


def is_site(site):
    if not isinstance(site, dict) or not is_number(site.get("z")):
        return False
    if not are_numbers(site.get("samples")):
        return False
    if not are_numbers(site.get("touches", [])):
        return False
    points = site.get("points", [])
    if not isinstance(points, list) or not all(map(is_point, points)):
        return False
    numbers = (site.get("sd"), site.get("n"), site.get("absolute", 0.0))
    return all(map(is_number, numbers))


def is_point(point):
    return are_numbers(point) and len(point) == 2


def are_cycles(cycles):
    return isinstance(cycles, list) and all(
        isinstance(cycle, dict) and all(map(are_numbers, cycle.values()))
        for cycle in cycles
    )


# What a record has of a site: its height (mm), the samples that count, all touches
# where some were rejected, how these vary, as far as they are noise, and where they
# were (X and Y, mm) where that was not one point.
def site_record(samples, z, step, touches=None, earlier=UNKNOWN, points=()):
    touches = touches or samples
    middle = summarize(touches, "median")
    far = NO_NOISE + (TEXTURE / 2.0 if points else 0.0)
    near = [z for z in touches if abs(z - middle) <= far]
    unknown = ROUGH if points else USUAL_NOISE
    kept = without_outliers(near, earlier, step, unknown)
    spread = spread_of(kept)
    record = {
        "z": round(z, 6),
        "sd": round(math.sqrt(spread.variance), 6),
        "n": len(kept),
        "samples": [round(sample, 6) for sample in samples],
    }
    if spread.absolute is not None:
        record["absolute"] = round(spread.absolute, 6)
    if len(touches) > len(samples):
        record["touches"] = [round(touch, 6) for touch in touches]
    if points:
        record["points"] = [[round(xy, 2) for xy in point] for point in points]
    return record


# Whether the nozzle was told to be dirty, or was cleaned
def is_dirty(run):
    return bool(run.get("cleaned") or run.get("dirty"))


# The Spread of one touch at a site in each of the latest runs, refused ones, too:
# without what made them refused the others look better than they are.  The bed's is
# UNKNOWN in those with another bed_spread (mm), the nozzle's where it was dirty.
def spreads_in(runs, site, bed_spread=0.0):
    def spread(run):
        record = run["sites"].get(site)
        is_other = site == "bed" and trend.bed_spread(run) != bed_spread
        # What stuck to the nozzle is no noise of a clean one
        is_other |= site == "nozzle" and is_dirty(run)
        return UNKNOWN if is_other or not record else trend.spread_in(record)

    return [spread(run) for run in runs[-RECENT:]]


######################################################################
# The file
######################################################################


# The lines of a file, one that is longer than LONGEST in pieces: pairs of whether a
# line begins there, and bytes.  Gives way every few of them.
def pieces_of(f):
    begins = True
    read = iter(functools.partial(f.readline, LONGEST), b"")
    for number, piece in enumerate(read):
        if number % LINES_AT_ONCE == 0:
            pause()
        yield begins, piece
        begins = piece.endswith(b"\n")


# The file; every method may raise IOError or OSError.
class File:
    # 'limit': runs that are kept of each printer; 'printer': the path of its
    # printer.cfg, None: it has no runs of the first format
    def __init__(self, folder, limit, printer=None):
        self.folder = folder
        self.path = os.path.join(folder, FILE)
        self.limit = limit
        self.printer = printer
        # Lines of a later format
        self.later = 0

    # What the first format has of the printer; nobody has None
    def _old_name(self):
        return self.printer and os.path.basename(self.printer)

    # The records of all printers that write here, the oldest first, and how
    # many lines are none
    def read(self):
        kept, damaged, self.later = {}, 0, 0
        if not os.path.exists(self.path):
            return [], damaged
        with open(self.path, "rb") as f:
            for number, (begins, piece) in enumerate(pieces_of(f)):
                if not (begins and piece.strip()):
                    continue
                record = load(piece) if len(piece) < LONGEST else None
                if record == {}:
                    self.later += 1
                elif record is None or not is_record(record):
                    damaged += 1
                else:
                    self._adopt(record)
                    few = collections.deque(maxlen=self.limit)
                    few = kept.setdefault(record.get("printer"), few)
                    few.append((number, record))
        pairs = sum(map(list, kept.values()), [])
        pairs.sort(key=lambda pair: pair[0])
        return [record for _, record in pairs], damaged

    # A run of the first format gets the name of now
    def _adopt(self, record):
        is_old = "format" not in record and self.printer is not None
        if is_old and record.get("printer") == self._old_name():
            record["printer"] = self.printer

    def append(self, record):
        record["format"] = FORMAT
        # Without a time that nobody wants to be kept
        fields = dict((k, v) for k, v in record.items() if k != "time" or v)
        line = json.dumps(fields, sort_keys=True, allow_nan=False)
        line = line.encode("ascii") + b"\n"
        if not os.path.exists(self.folder):
            os.makedirs(self.folder)
        with Turn(self.folder):
            self._add(line)
            pause()
            self._drop_oldest(record.get("printer"))

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

    # Of one printer; what others have written stays, and what nobody can read
    def _drop_oldest(self, printer):
        marks = [
            ('"printer": ' + json.dumps(name)).encode("ascii")
            for name in (printer, self._old_name())
            if name is not None
        ]

        def is_of_printer(begins, piece):
            return begins and any(mark in piece for mark in marks)

        with open(self.path, "rb") as f:
            count = sum(is_of_printer(*piece) for piece in pieces_of(f))
            if count <= self.limit:
                return
            f.seek(0)
            kept = self._without_first(f, count - self.limit, is_of_printer)
            replace_by(self.path, kept)

    def _without_first(self, f, drop, is_of_printer):
        drops = False
        for begins, piece in pieces_of(f):
            if begins:
                drops = drop > 0 and is_of_printer(begins, piece)
                drop -= drops
            if not drops:
                yield piece


# Writes a file anew, by another one that takes its place: it has all of the data,
# or stays as it was.
def replace(path, data):
    replace_by(path, [data])


# Writes a file anew from data in pieces, by another one that takes its place.
def replace_by(path, pieces):
    path = os.path.realpath(path)
    new = path + ".new"
    try:
        with open(new, "wb") as f:
            for piece in pieces:
                f.write(piece)
            f.flush()
            os.fsync(f.fileno())
        os.rename(new, path)
    except OSError:
        if os.path.exists(new):
            os.remove(new)
        raise


# While it lasts no other printer writes into the folder.  Where the file system
# knows no such thing, or another one keeps it, it goes without.
class Turn:
    def __init__(self, folder):
        self.folder = folder
        self.fd = None

    def __enter__(self):
        self.fd = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        for _ in range(int(PATIENCE / 0.05)):
            try:
                fcntl.flock(self.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except OSError as e:
                if e.errno not in (errno.EAGAIN, errno.EACCES):
                    return
            time.sleep(0.05)

    def __exit__(self, *unused):
        os.close(self.fd)


######################################################################
# The runs of a printer
######################################################################


# The runs of one printer, on klippy's main thread
class History:
    # 'file': None where nothing is kept.  say(text) is called on the main
    # thread, when there is something to warn of, begun() when the runs of before are
    # here.
    def __init__(self, reactor, file, printer, say, begun=None):
        self.reactor = reactor
        self.file = file
        # The path of printer.cfg, as several printers may have one folder
        self.printer = printer
        self.say = say
        self.begun = begun
        self.runs = []
        # Of the runs with each extruder, by its name
        self.summaries = {}
        self.told = set()
        self.status = {}
        self.lock = threading.Lock()
        self._show()

    # Read what is there; ready some milliseconds later
    def begin(self):
        if self.file is not None:
            self.in_thread(self._read)
        elif self.begun is not None:
            self.later(self.begun)

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
        except OSError as e:
            logging.warning("history: %s", e)
            text = (
                "the history cannot be kept in %s: %s; mend that, or set"
                " 'history: none'"
            )
            self.later(self.warn, text % (self.file.folder, e.strerror))
        except Exception as e:
            # Of a history no calibration may fail, whatever it is
            logging.exception("history")
            self.later(self.warn, "the history cannot be kept: %s" % (repr(e),))

    # On klippy's main thread
    def later(self, call, *args):
        try:
            self.reactor.register_async_callback(lambda eventtime: call(*args))
        except Exception:
            # klippy has ended meanwhile, and its reactor with it: nobody is there
            # to be told
            logging.exception("history: %s", args)

    # Once for each reason: a disk stays full
    def warn(self, text):
        if text not in self.told:
            self.told.add(text)
            self.say(text)

    def _read(self):
        try:
            records, damaged = self.file.read()
        except OSError:
            # Then nothing is known of runs before
            if self.begun is not None:
                self.later(self.begun)
            raise
        for text, count in (
            ("%d damaged lines of %s are left out", damaged),
            (
                "%d lines of %s are of a later version, and left out; update"
                " the module",
                self.file.later,
            ),
        ):
            if count:
                self.later(self.warn, text % (count, self.file.path))
        runs = self._of_this_printer(records)
        self.later(self._take, runs, trend.summarize_tools(runs, pause), [])

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

    # What is worn, or has changed, is told with the run that has shown it
    def _write(self, record, runs):
        pause()
        own = trend.of_tool(runs, trend.tool(record), pause)
        told = trend.find(own, pause)
        record.update(wear=told.wear, changed=told.changed)
        summaries = trend.summarize_tools(runs, pause)
        try:
            self.file.append(record)
        finally:
            self.later(self._take, None, summaries, told.texts)

    # 'runs' None: they are here already
    def _take(self, runs, summaries, texts):
        if runs is not None:
            # A run may have ended before all was read
            self.runs = (runs + self.runs)[-self.file.limit :]
            if self.begun is not None:
                self.begun()
        self.summaries = summaries
        self._show()
        for text in texts:
            self.say(text)

    # The trend.Summary of the runs with the nozzle of an extruder.  Of a first one only
    # runs of before there was such a name are known.
    def summary(self, name):
        summary = self.summaries.get(name, self.summaries.get(""))
        return summary or trend.summarize_runs([])

    # Of each site the Spread of one touch in each of the last runs; 'bed_spread' (mm)
    # is that of the run that asks
    def spreads(self, bed_spread=0.0):
        return dict(
            (site, spreads_in(self.runs, site, bed_spread)) for site in SITES
        )

    def _show(self):
        last = self.runs[-1] if self.runs else {}
        radius = trend.bed_spread(last)
        fingerprint = self.summary(trend.tool(last)).fingerprint
        spreads = dict(
            (site, pool(runs)) for site, runs in self.spreads(radius).items()
        )
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
            "switch_nozzle": fingerprint.middle,
        }
