"""The runs of a printer: what a line of their file has, and what they tell the next run.

Records and pure functions, for klippy (run_log.py) and for the program z_touch/report.
Heights are toolhead Z in mm.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import errno
import json
import math
import os
from dataclasses import asdict, dataclass, field
from statistics import fmean, median, stdev
from typing import (
    Any,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ..texture import TEXTURE
from .statistics import (
    MAD_FACTOR,
    UNKNOWN,
    USUAL_NOISE,
    Spread,
    spread_of,
    t_factor,
    without_outliers,
)

# Of a line; one with another number is left out
FORMAT = 4

SITES = ("nozzle", "switch", "bed")

# What a warning may be about besides one site: the height of the probe's body
BODY = "switch - nozzle"

# What a warning is about: a probe that was left on the toolhead
PROBE = "probe"

# A longer line (bytes) is damaged: 200 cycles of 30 touches at each site are shorter
LONGEST = 262144

# Digits of a whole number; Python takes long for more of them
DIGITS = 20

# No printer and no clock has a number as large
LARGEST = 1e12

# Runs that tell how much a touch of a site varies
RECENT = 20

# Farther (mm) from the middle of all touches of a site is an accident, no noise
NO_NOISE = 0.05

# Runs that say how high switch - nozzle is: at least, and the latest that count
LEAST_RUNS = 5
LATEST_RUNS = 50

# Only runs are compared that were as hot (K)
AS_HOT = 10.0

# A run departs from those that were as hot from both on: standard deviations, and mm.
# 38 um of residue on the nozzle are seen where switch - nozzle varies by 6
FAR_SIGMA = 4.25
FAR = 0.02

# So far (mm) from the last runs is another nozzle or probe, if two in a row are
EXCHANGED = 0.05

Point = Tuple[float, float]


class Warned(NamedTuple):
    """Something odd: the site, BODY, PROBE or the feature of Klipper's that it is about."""

    about: str
    text: str


@dataclass(frozen=True)
class SiteRun:
    """The touches of one site in one run.

    z: the height that counts. sd: standard deviation of one touch, of n touches without
    outliers. samples: the
    touches that z is of. touches: all of them, where some were rejected. points: X and
    Y of each, where they were not at one point.
    """

    z: float
    sd: float
    n: int
    samples: Tuple[float, ...]
    touches: Tuple[float, ...] = ()
    points: Tuple[Point, ...] = ()

    def spread(self) -> Spread:
        """Return how a touch varies, and how well that is known."""
        return Spread(max(self.sd, 0.0) ** 2, max(self.n - 1, 0))


@dataclass(frozen=True)
class Cycle:
    """One cycle of CALIBRATE_Z_ACCURACY.

    time: seconds since the command began, at its end. The heights of each site's
    touches.
    """

    time: float
    nozzle: Tuple[float, ...]
    switch: Tuple[float, ...]
    bed: Tuple[float, ...]

    def touches(self, site: str) -> Tuple[float, ...]:
        """Return the heights of the touches of a site."""
        return {
            "nozzle": self.nozzle,
            "switch": self.switch,
            "bed": self.bed,
        }[site]


@dataclass(frozen=True)
class Run:
    """A run, as a line of the file has it.

    ok: it has ended well; otherwise 'reason' says why, and offset, uncertainty and
    switch_offset mean nothing. time: seconds since 1970. extruder: whose nozzle it was.
    bed_spread: of the section, mm; turn: counts the runs with one. revision: of the modules. duration: s. cleaned: why
    the nozzle was cleaned in it; empty: it was not. dirty: its first touches pressed
    something flat. temperatures: C, by "extruder" (the active one) and "heater_bed".
    offset, switch_offset, z_adjust: mm. uncertainty: mm at 95 %; None: unknown.
    nozzle_at: X and Y where the nozzle has touched the pin while the probe was attached;
    None: it was elsewhere. cycles, step (of the Z motors, mm): of CALIBRATE_Z_ACCURACY.
    waited: of Z_CALIBRATION_WAIT, pairs of the minutes since it began and the height (mm)
    at which the nozzle touched the pin then.
    """

    ok: bool
    time: float
    sites: Mapping[str, SiteRun]
    reason: str = ""
    extruder: str = ""
    bed_spread: float = 0.0
    turn: int = 0
    revision: str = ""
    duration: float = 0.0
    retries: int = 0
    cleaned: str = ""
    dirty: bool = False
    temperatures: Mapping[str, float] = field(default_factory=dict)
    offset: float = 0.0
    uncertainty: Optional[float] = None
    switch_offset: float = 0.0
    z_adjust: float = 0.0
    warnings: Tuple[Warned, ...] = ()
    nozzle_at: Optional[Point] = None
    cycles: Tuple[Cycle, ...] = ()
    step: float = 0.0
    waited: Tuple[Point, ...] = ()

    @property
    def is_calibration(self) -> bool:
        """Tell whether it was a CALIBRATE_Z: other runs are kept for the report only."""
        return not self.cycles and not self.waited

    def z(self, site: str) -> float:
        """Return the height of a site."""
        return self.sites[site].z

    def body(self) -> float:
        """Return switch - nozzle: how far the probe's body is below the nozzle."""
        return self.z("switch") - self.z("nozzle")

    def is_of(self, extruder: str) -> bool:
        """Tell whether it was the nozzle of that extruder; "" is of each."""
        return self.extruder in ("", extruder)


def site_run(
    samples: Sequence[float],
    z: float,
    *,
    touches: Sequence[float] = (),
    usual: float = USUAL_NOISE,
    points: Sequence[Point] = (),
) -> SiteRun:
    """Make the record of a site.

    samples: the touches that z is of; touches: all of them. usual: the standard
    deviation of a touch, mm; points: X and Y of each touch, where
    these differ.
    """
    touches = touches or samples
    middle = median(touches)
    far = NO_NOISE + (TEXTURE / 2.0 if points else 0.0)
    near = [z for z in touches if abs(z - middle) <= far]
    kept = without_outliers(near, usual)
    spread = spread_of(kept)
    has_rejected = len(touches) > len(samples)
    return SiteRun(
        z=round(z, 6),
        sd=round(math.sqrt(spread.variance), 6),
        n=len(kept),
        samples=tuple(round(sample, 6) for sample in samples),
        touches=tuple(round(t, 6) for t in touches) if has_rejected else (),
        points=tuple((round(x, 2), round(y, 2)) for x, y in points),
    )


######################################################################
# Lines
######################################################################


class OtherFormat(ValueError):
    """A line of another version of the modules."""


def check_file(path: str) -> None:
    """Raise OSError where something else than a file is there.

    Opening a pipe, or reading a device, may never end.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        raise OSError(errno.EINVAL, "it is no file")


def line_of(run: Run) -> bytes:
    """Return a run as a line of the file, with its end.

    Raises ValueError where a number of it is none.
    """
    fields = {"format": FORMAT, **asdict(run)}
    fields["sites"] = {
        site: {key: v for key, v in kept.items() if v not in (None, ())}
        for site, kept in fields["sites"].items()
    }
    fields["warnings"] = [warned._asdict() for warned in run.warnings]
    if not run.cycles:
        del fields["cycles"], fields["step"]
    if not run.waited:
        del fields["waited"]
    text = json.dumps(fields, sort_keys=True, allow_nan=False)
    return text.encode("ascii") + b"\n"


def parse(line: bytes) -> Run:
    """Return the run that a line is.

    Raises ValueError where it is none: the file may be edited by hand, and a power loss
    cuts a line. Raises OtherFormat where another version has written it.
    """
    if len(line) > LONGEST:
        raise ValueError(len(line))
    try:
        record = _dict(json.loads(line.decode("utf-8"), parse_int=_whole))
    except RecursionError as e:
        raise ValueError(len(line)) from e
    if record.get("format") != FORMAT:
        raise OtherFormat()
    sites = {
        _site(name): _site_run(_dict(kept))
        for name, kept in _dict(record["sites"]).items()
    }
    worth, place = record.get("uncertainty"), record.get("nozzle_at")
    run = Run(
        ok=_flag(record["ok"]),
        time=_number(record["time"]),
        sites=sites,
        reason=_text(record.get("reason", "")),
        extruder=_text(record.get("extruder", "")),
        bed_spread=_number(record.get("bed_spread", 0.0)),
        turn=int(_number(record.get("turn", 0))),
        revision=_text(record.get("revision", "")),
        duration=_number(record.get("duration", 0.0)),
        retries=int(_number(record.get("retries", 0))),
        cleaned=_text(record.get("cleaned", "")),
        dirty=_flag(record.get("dirty", False)),
        temperatures={
            name: _number(value)
            for name, value in _dict(record.get("temperatures", {})).items()
        },
        offset=_number(record.get("offset", 0.0)),
        uncertainty=None if worth is None else _number(worth),
        switch_offset=_number(record.get("switch_offset", 0.0)),
        z_adjust=_number(record.get("z_adjust", 0.0)),
        warnings=tuple(map(_warned, _list(record.get("warnings", [])))),
        nozzle_at=None if place is None else _point(place),
        cycles=tuple(map(_cycle, _list(record.get("cycles", [])))),
        step=_number(record.get("step", 0.0)),
        waited=tuple(map(_point, _list(record.get("waited", [])))),
    )
    if run.ok and run.is_calibration and len(sites) < len(SITES):
        raise ValueError(sites)
    return run


class Parsed(NamedTuple):
    """The runs of lines, and how many lines are damaged, or of another version."""

    runs: List[Run]
    damaged: int
    other: int


def parse_all(lines: Iterable[bytes]) -> Parsed:
    """Return the runs that lines are, in their order; empty ones count as nothing."""
    runs, damaged, other = [], 0, 0
    for line in lines:
        if not line.strip():
            continue
        try:
            runs.append(parse(line))
        except OtherFormat:
            other += 1
        except (ValueError, KeyError):
            damaged += 1
    return Parsed(runs, damaged, other)


# What a line has; each raises ValueError with what is something else


def _whole(digits: str) -> float:
    return int(digits) if len(digits) <= DIGITS else math.inf


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(value)
    if not abs(value) < LARGEST:
        raise ValueError(value)
    return float(value)


def _numbers(values: object) -> Tuple[float, ...]:
    return tuple(map(_number, _list(values)))


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError(value)
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(value)
    return value


def _list(value: object) -> List[Any]:
    if not isinstance(value, list):
        raise ValueError(value)
    return value


def _dict(value: object) -> Dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(value)
    return value


def _point(value: object) -> Point:
    x, y = _numbers(value)
    return x, y


def _site(name: str) -> str:
    if name not in SITES:
        raise ValueError(name)
    return name


def _warned(value: object) -> Warned:
    fields = _dict(value)
    return Warned(_text(fields["about"]), _text(fields["text"]))


def _cycle(value: object) -> Cycle:
    fields = _dict(value)
    touches = [_numbers(fields[site]) for site in SITES]
    if not all(touches):
        raise ValueError(fields)
    return Cycle(_number(fields["time"]), *touches)


def _site_run(fields: Dict[str, Any]) -> SiteRun:
    return SiteRun(
        z=_number(fields["z"]),
        sd=_number(fields["sd"]),
        n=int(_number(fields["n"])),
        samples=_numbers(fields["samples"]),
        touches=_numbers(fields.get("touches", [])),
        points=tuple(map(_point, _list(fields.get("points", [])))),
    )


######################################################################
# What earlier runs tell
######################################################################


def spreads(
    runs: Sequence[Run], site: str, bed_spread: float = 0.0
) -> List[Spread]:
    """Return how a touch of a site varied in each of the last runs.

    Refused ones, too: without what made them refused the others look better than they
    are. UNKNOWN is the bed in a run with another bed_spread (mm), and the nozzle where
    it was dirty: what stuck to it is no noise of a clean one.
    """
    found = []
    for run in runs[-RECENT:]:
        is_other = site == "bed" and run.bed_spread != bed_spread
        is_dirty = site == "nozzle" and bool(run.cleaned or run.dirty)
        kept = None if is_other or is_dirty else run.sites.get(site)
        found.append(UNKNOWN if kept is None else kept.spread())
    return found


def is_as_hot(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    """Tell whether nozzle and bed are as hot, within AS_HOT, as far as is known."""
    return all(
        abs(one[name] - other[name]) <= AS_HOT
        for name in ("extruder", "heater_bed")
        if name in one and name in other
    )


def first_of_now(bodies: Sequence[float]) -> int:
    """Return from which of the heights on nozzle and probe are those of now.

    bodies: switch - nozzle of runs, the oldest first. Two in a row that are far from
    the last ones are of another nozzle or probe; a single one is an accident.
    """
    if not bodies:
        return 0
    now = median(bodies[-3:])
    for first in range(len(bodies) - 2, -1, -1):
        if all(abs(z - now) > EXCHANGED for z in bodies[first : first + 2]):
            return first + 2
    return 0


def bodies_as_hot(
    runs: Sequence[Run], temperatures: Mapping[str, float]
) -> List[float]:
    """Return switch - nozzle of the last good runs that were as hot.

    runs: with one nozzle; of before nozzle or probe were exchanged none counts.
    """
    good = [run for run in runs if run.ok]
    begin = first_of_now([run.body() for run in good])
    return [
        run.body()
        for run in good[begin:][-LATEST_RUNS:]
        if is_as_hot(run.temperatures, temperatures)
    ]


class Usual(NamedTuple):
    """A usual height, and how far a run may be off it by chance (mm)."""

    middle: float
    limit: float


def usual(values: Sequence[float]) -> Optional[Usual]:
    """Return what is usual among heights; None: there are too few.

    By median and median absolute deviation, which half of the values may be off without
    moving (Rousseeuw and Croux, Journal of the American Statistical Association 88,
    1993).
    """
    if len(values) < LEAST_RUNS:
        return None
    middle = median(values)
    sigma = MAD_FACTOR * median(abs(value - middle) for value in values)
    return Usual(middle, max(FAR_SIGMA * sigma, FAR))


def departure(body: float, bodies: Sequence[float]) -> float:
    """Return by how much (mm) switch - nozzle departs from what is usual.

    bodies: bodies_as_hot(). 0: not by more than chance, or as the last run did, which
    has told it.
    """
    known = usual(bodies)
    if known is None or abs(body - bodies[-1]) <= FAR:
        return 0.0
    apart = body - known.middle
    return apart if abs(apart) > known.limit else 0.0


######################################################################
# Cycles of CALIBRATE_Z_ACCURACY
######################################################################


def offsets(cycles: Sequence[Cycle], switch_offset: float = 0.0) -> List[float]:
    """Return the offset of each cycle (mm)."""
    return [
        fmean(cycle.bed)
        - (fmean(cycle.switch) - fmean(cycle.nozzle) + switch_offset)
        for cycle in cycles
    ]


def uncertainty(values: Sequence[float], step: float) -> float:
    """Return what a single calibration may be off by (mm at 95 %).

    values: the offsets of its cycles; step: of the Z motors, of which half is unknown.
    """
    u = math.hypot(stdev(values), step / 2.0)
    return t_factor(len(values) - 1) * u
