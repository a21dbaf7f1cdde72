"""Draws the walk of a seed, and makes one that fails simpler.

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

from dataclasses import dataclass, field
from typing import Callable, Optional, TypeVar

import hypothesis
from hypothesis import HealthCheck, Phase
from hypothesis import strategies as st

from simprinter.hosts.hosts import Host
from tools.campaign.drawn import covering, machines
from tools.campaign.drawn import steps as stepping
from tools.campaign.drawn.covering import Row
from tools.campaign.drawn.printers import Owned
from tools.campaign.drawn.steps import Step
from tools.campaign.walker import Outcome
from tools.kit.printer import knows_kinematics

T = TypeVar("T")

# So many walks are tried to find the simplest one that fails alike
SIMPLER = 60
Walk = tuple[Owned, tuple[Step, ...]]


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


def worst_of(
    seed: int, row: Row, go: Callable[[Walk], Outcome], simpler: int
) -> tuple[Walk, Outcome]:
    """Draw the walk of a seed and go it; where it fails, the simplest that does."""
    attempts = _Attempts(go, simpler)
    try:
        check_drawn(
            stepping.walks(row), attempts.check, seed, shrinks=bool(simpler)
        )
    except Exception as error:
        # Hypothesis wonders at one that fails only now and then
        if attempts.worst is None:
            raise error
    found = attempts.worst or attempts.first
    assert found is not None, f"seed {seed} draws nothing"
    return found


def row_of(seed: int, host: Host) -> Row:
    """The seed's printer: each round through all is on the hosts in other turns."""
    rows = covering.rows(knows_kinematics(host, machines.GENERIC))
    return rows[(seed + seed // len(rows)) % len(rows)]


def check_drawn(
    strategy: st.SearchStrategy[T],
    check: Callable[[T], None],
    seed: int,
    *,
    shrinks: bool,
) -> None:
    """Call check with what a seed draws, and with simpler ones if it raises.

    Hypothesis draws the simplest of all first, whatever the seed.
    """
    phases = [Phase.generate] + [Phase.shrink] * shrinks
    test = hypothesis.given(strategy)(check)
    test = hypothesis.settings(
        max_examples=2,
        database=None,
        deadline=None,
        phases=phases,
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
    )(test)
    hypothesis.seed(seed)(test)()
