"""Walks in numbers: on all cores, counted, written down and gone again."""

from __future__ import annotations

import json
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Optional

from simprinter.hosts.hosts import Host
from tools.campaign import faults, walker
from tools.campaign.breaking import Break
from tools.campaign.drawn import walking
from tools.campaign.drawn.printers import Owned
from tools.campaign.drawn.walking import SIMPLER, Walk
from tools.campaign.faults import Case, GoodRun, Modules
from tools.campaign.jobs import ALL_JOBS, OfJob
from tools.campaign.judging import GAP_ERROR, is_blind
from tools.campaign.walker import Broken, Outcome
from tools.kit.printer import FOLDER, MODULES


class Done(NamedTuple):
    """A walk that was gone; where a drawn one failed, the simplest that does.

    name: its seed, or the case's.
    """

    name: str
    host: str
    walk: Walk
    outcome: Outcome

    @property
    def breaks(self) -> list[Break]:
        """What was to break."""
        return [Break(*what) for kind, what in self.walk[1] if kind == "break"]

    @property
    def together(self) -> list[Break]:
        """What was to break in the first command in which anything was."""
        kinds = [kind for kind, _ in self.walk[1]]
        end = kinds.index("mend") if "mend" in kinds else len(kinds)
        return self.breaks[: kinds[:end].count("break")]

    @property
    def broken(self) -> Broken:
        """How the command went in which it was to break."""
        return self.outcome.broken or Broken()


def go_drawn(
    seed: int, host: Host, modules: Modules = None, simpler: int = SIMPLER
) -> Done:
    """Draw the walk of a seed and go it on a host."""
    found = walking.worst_of(
        seed,
        walking.row_of(seed, host),
        lambda walk: walker.go(*walk, host, modules),
        simpler,
    )
    return Done(str(seed), host.name, *found)


class Share(NamedTuple):
    """A part of all cases whose name has that text in it: which one of how many."""

    number: int = 0
    parts: int = 1
    text: str = ""

    def has(self, case: Case) -> bool:
        """Whether it is one of them."""
        name = str(case)
        is_turn = zlib.crc32(name.encode()) % self.parts == self.number
        return is_turn and self.text in name


class Plan(NamedTuple):
    """What of a command is broken on a host."""

    host: Host
    good: GoodRun
    cases: Sequence[Case]
    seed: int = 0
    modules: Modules = None


def plan(
    job: str,
    host: Host,
    share: Share,
    seed: int,
    modules: Modules,
) -> Plan:
    """The cases of a command that are a host's share."""
    good = faults.good_run(host, ALL_JOBS[job], seed, modules)
    chosen = [case for case in faults.cases(good) if share.has(case)]
    return Plan(host, good, chosen, seed, modules)


def go_faults(pool: Executor, plans: Iterable[Plan]) -> list[Done]:
    """Go all cases of some plans."""
    tasks = [
        (case, one.host, one.good, one.seed, one.modules)
        for one in plans
        for case in one.cases
    ]
    return list(pool.map(go_case, *zip(*tasks), chunksize=4)) if tasks else []


def go_case(
    case: Case,
    host: Host,
    good: GoodRun,
    seed: int = 0,
    modules: Modules = None,
) -> Done:
    """Break that in its command on a host."""
    walk = OfJob(job=case.job, seed=seed), faults.walk(case)
    outcome = walker.go(*walk, host, modules, expected=good.expected)
    return Done(str(case), host.name, walk, outcome)


def modules_of(product: Optional[Path]) -> Optional[dict[str, Path]]:
    """What another checkout puts beside klippy's own; None: this one's."""
    if product is None:
        return None
    files = {name: product / f"{name}.py" for name in MODULES}
    files[FOLDER] = product / FOLDER
    return {name: file for name, file in files.items() if file.exists()}


# Kept and gone again


def write(done: Done, folder: Path) -> Path:
    """Its file: what --replay reads, and for people its printer.cfg."""
    folder.mkdir(parents=True, exist_ok=True)
    owned, walk = done.walk
    file = folder / f"{re.sub(r'[^a-zA-Z0-9_]+', '-', done.name)}.json"
    data = {
        "harm": done.outcome.harm,
        "printer": owned.as_data(),
        "steps": walk,
        "printer.cfg": owned.scene.config(
            "SERIAL", owned.changes()
        ).splitlines(),
    }
    file.write_text(json.dumps(data, indent=1) + "\n")
    return file


def read(file: Path) -> Walk:
    """What write() has written."""
    data = json.loads(file.read_text())
    steps = tuple((kind, what) for kind, what in data["steps"])
    kind = OfJob if "job" in data["printer"] else Owned
    return kind.from_data(data["printer"]), steps


def replay(
    file: Path, host: Host, modules: Modules, say: Callable[[str], None]
) -> Outcome:
    """Go a walk again, and say each step and what the console shows."""
    owned, steps = read(file)
    expected = None
    if isinstance(owned, OfJob):
        job = ALL_JOBS[owned.job]
        expected = faults.good_run(host, job, owned.seed, modules).expected
    return walker.go(owned, steps, host, modules, say, expected)


# Counted


@dataclass
class Report:
    """Of many walks.

    harmed: by kind. refused: by the shape of the reason; healthy: those for
    which the world knows no reason.
    """

    walks: int = 0
    steps: int = 0
    harmed: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    healthy: Counter[str] = field(default_factory=Counter)
    refused_at_start: Counter[str] = field(default_factory=Counter)
    done: Counter[str] = field(default_factory=Counter)

    def add(self, done: Done) -> None:
        """One more."""
        outcome = done.outcome
        self.walks += 1
        self.steps += len(done.walk[1])
        if outcome.harm:
            self.harmed[outcome.kind] += 1
        if outcome.refused_at_start:
            self.refused_at_start[outcome.refused_at_start.splitlines()[0]] += 1
        self.refused.update(outcome.refusals)
        self.healthy.update(outcome.healthy)
        self.done.update(outcome.done)

    def figures(self) -> dict[str, Any]:
        """For JSON."""
        return vars(self)

    def text(self) -> str:
        """For people."""
        lines = [
            f"{self.walks} walks, {self.steps} steps:"
            f" {sum(self.harmed.values())} harmed {dict(self.harmed)}",
        ]
        groups = (
            ("not started", self.refused_at_start),
            ("refused", self.refused),
            ("refused without a reason", self.healthy),
            ("done", self.done),
        )
        for what, counts in groups:
            lines += [
                f"  {n:5} {what}: {name}" for name, n in counts.most_common()
            ]
        return "\n".join(lines)


def figures(job: str, done: Sequence[Done]) -> dict[str, Any]:
    """What came of a command's cases."""
    broken = [one.broken for one in done]
    return {
        "job": job,
        "hosts": sorted({one.host for one in done}),
        "runs": len(done),
        "survived": sum(not one.outcome.harm for one in done),
        "missed": sum(not one.struck for one in broken),
        "faults": Counter(what.fault for one in done for what in one.breaks),
        "ended": Counter(one.ended for one in broken),
        "blind": [
            {
                "case": one.name,
                "host": one.host,
                "ended": one.broken.ended,
                "reason": one.broken.message,
                "depths": one.broken.depths,
            }
            for one in done
            if one.broken.struck and is_blind(one.together)
        ],
        # Wrong by what no touch can tell
        "agreed": [
            one.name
            for one in done
            if one.broken.ended == walker.RIGHT
            and one.broken.error >= GAP_ERROR
            and not one.outcome.harm
        ],
        "worst": {
            site: max(
                (one.depths.get(site, 0.0) for one in broken), default=0.0
            )
            for site in ALL_JOBS[job].margins
        },
    }
