"""Draws walks, goes them, makes those that fail simpler, and keeps count.

Hypothesis draws a walk from its seed, and makes one that fails shorter; its
RuleBasedStateMachine does not go it. Such a machine draws a step when the one
before has been done, so a walk is nothing but what a running klippy has seen: it
cannot be written down and gone again on another host, on the modules of another
checkout, or after the steps to choose from have changed, and what shrinking tries
twice is gone twice. Drawn as a value first, each walk is JSON that --replay reads.
Which printer comes with which seed is a covering array's, see covering.py. It is
one of its own: forked from a klippy that has imported, it starts in a tenth of
the time of its walk.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, NamedTuple, Optional

from simprinter.hosts.hosts import Host
from tools.campaign.walks import covering, machines, walker
from tools.campaign.walks import steps as stepping
from tools.campaign.walks.covering import Row
from tools.campaign.walks.drawing import check_drawn
from tools.campaign.walks.printers import Owned
from tools.campaign.walks.steps import Step
from tools.campaign.walks.walker import Outcome, shape
from tools.kit.printer import FOLDER, MODULES, knows_kinematics

# So many walks are tried to find the simplest one that fails alike
SIMPLER = 60
Walk = tuple[Owned, tuple[Step, ...]]


class Done(NamedTuple):
    """A walk that was gone; where it failed, the simplest that does.

    alone: the step that only this product refuses, see compared().
    """

    seed: int
    host: str
    walk: Walk
    outcome: Outcome
    alone: str = ""


class _HarmedError(Exception):
    """Tells hypothesis of a walk that fails."""


@dataclass
class _Attempts:
    """Goes walks of one seed, each of them once."""

    go: Callable[[Walk], Outcome]
    simpler: int
    first: Optional[tuple[Walk, Outcome]] = None
    worst: Optional[tuple[Walk, Outcome]] = None
    known: dict[str, Outcome] = field(default_factory=dict)
    draws: int = 0

    def check(self, walk: Walk) -> None:
        """The body of hypothesis' test."""
        self.draws += 1
        # Its first draw is always the simplest one, whatever the seed
        if self.draws == 1:
            return
        key = repr(walk)
        if key not in self.known:
            if self.worst is not None:
                self.simpler -= 1
            if self.simpler < 0:
                return
            self.known[key] = self.go(walk)
            self.first = self.first or (walk, self.known[key])
        outcome = self.known[key]
        # What fails otherwise is another walk's
        if outcome.harm and self.worst in (None, (walk, outcome)):
            self.worst = walk, outcome
        elif not outcome.harm or outcome.kind != self.worst[1].kind:
            return
        self.worst = walk, outcome
        raise _HarmedError


def walk_of(
    seed: int,
    host: Host,
    bases: Sequence[str] = (),
    modules: Optional[Mapping[str, Path]] = None,
    simpler: int = SIMPLER,
    against: Optional[Mapping[str, Path]] = None,
) -> Done:
    """Draw the walk of a seed and go it on a host.

    against: another product's modules; a walk with refusals is gone on them, too.
    """
    attempts = _Attempts(lambda walk: walker.go(*walk, host, modules), simpler)
    walks = stepping.walks(row_of(seed, host, bases))
    try:
        check_drawn(walks, attempts.check, seed, shrinks=bool(simpler))
    except Exception as error:
        # Hypothesis wonders at one that fails only now and then
        if attempts.worst is None:
            raise error
    assert attempts.first is not None, f"seed {seed} draws nothing"
    done = Done(seed, host.name, *(attempts.worst or attempts.first))
    return done if against is None else compared(done, host, against)


def compared(done: Done, host: Host, against: Mapping[str, Path]) -> Done:
    """With what another product's modules do not refuse.

    From the first step that ends otherwise on the two printers are not in the
    same state.
    """
    if not done.outcome.refusals:
        return done
    there = walker.go(*done.walk, host, against)
    ends = zip(done.walk[1], done.outcome.ends, there.ends)
    for (kind, what), own, other in ends:
        if bool(own) != bool(other):
            alone = f"{kind} {what!r}: {own}" if own else ""
            return done._replace(alone=alone)
    return done


def row_of(seed: int, host: Host, bases: Sequence[str] = ()) -> Row:
    """The seed's printer: each round through all is on the hosts in other turns."""
    rows = covering.rows(tuple(bases), knows_kinematics(host, machines.GENERIC))
    return rows[(seed + seed // len(rows)) % len(rows)]


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
    file = folder / f"{done.seed}.json"
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
    return Owned.from_data(data["printer"]), steps


def replay(
    file: Path,
    host: Host,
    modules: Optional[Mapping[str, Path]],
    say: Callable[[str], None],
) -> Outcome:
    """Go a walk again, and say each step and what the console shows."""
    return walker.go(*read(file), host, modules, say)


@dataclass
class Report:
    """Of many walks.

    harmed: by kind. refused: by the shape of the reason; healthy: those for
    which the world knows no reason; alone: those of this product only.
    """

    walks: int = 0
    steps: int = 0
    harmed: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    healthy: Counter[str] = field(default_factory=Counter)
    refused_at_start: Counter[str] = field(default_factory=Counter)
    alone: Counter[str] = field(default_factory=Counter)
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
        if done.alone:
            self.alone[shape(done.alone)] += 1
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
            ("refused by this product only", self.alone),
            ("done", self.done),
        )
        for what, counts in groups:
            lines += [
                f"  {n:5} {what}: {name}" for name, n in counts.most_common()
            ]
        return "\n".join(lines)
