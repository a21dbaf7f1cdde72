"""Running many cases, on all cores."""

from __future__ import annotations

import random
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from typing import Any, NamedTuple, Union

from simprinter.hosts.hosts import Host
from tools.campaign import fault_cases
from tools.campaign.fault_cases import PLUS, Case, Outcome, Pair, Setting
from tools.campaign.jobs import ALL_JOBS


class Plan(NamedTuple):
    """What a command is given on a host."""

    host: Host
    job: str
    setting: Setting
    good: fault_cases.GoodRun
    cases: tuple[Union[Case, Pair], ...]


class Done(NamedTuple):
    """A case that was run."""

    host: str
    seed: int
    outcome: Outcome

    def text(self) -> str:
        """What was wrong, and the command that shows it again."""
        outcome = self.outcome
        case, ended = outcome.case, outcome.ended
        repeat = (
            f"python -m tools.campaign --host '{self.host}'"
            f" --every-host --seed {self.seed} --job '{case.job}'"
            f" --case '{case}'"
        )
        lines = [
            f"{case} on {self.host}: {ended}",
            outcome.message,
            *outcome.problems,
        ]
        return "\n    ".join([*lines, repeat])


def plan(
    setting: Setting, text: str, name: str, host: Host, share: tuple[int, int]
) -> Plan:
    """The cases of a command with the text that are a host's turn.

    share: which of how many parts of all.
    """
    job = setting.job(name)
    good = fault_cases.good_run(host, job, setting)
    part, parts = share
    if PLUS in text:
        found = {str(case): case for case in fault_cases.cases(job, good)}
        both = [found[one] for one in text.split(PLUS) if one in found]
        return Plan(
            host, name, setting, good, (Pair(*both),) if both[1:] else ()
        )
    chosen = [
        case
        for case in fault_cases.cases(job, good)
        if text in str(case) and zlib.crc32(str(case).encode()) % parts == part
    ]
    return Plan(host, name, setting, good, tuple(chosen))


def draw_pairs(plans: Sequence[Plan], count: int, seed: int) -> list[Plan]:
    """Any two of a plan's cases, count pairs in all, each another one."""
    generator = random.Random(seed)
    weights = [len(one.cases) for one in plans]
    count = min(count, sum(n * (n - 1) // 2 for n in weights))
    pairs: list[dict[Pair, None]] = [{} for _ in plans]
    while sum(map(len, pairs)) < count:
        (at,) = generator.choices(range(len(plans)), weights)
        chosen = generator.sample(range(weights[at]), 2)
        first, second = (plans[at].cases[one] for one in sorted(chosen))
        pairs[at][Pair(first, second)] = None
    return [one._replace(cases=tuple(p)) for one, p in zip(plans, pairs)]


def attempt(task: tuple[Plan, Union[Case, Pair]]) -> Done:
    """Run one case."""
    whole, case = task
    setting = whole.setting
    outcome = fault_cases.attempt(whole.host, case, whole.good, setting)
    return Done(whole.host.name, setting.seed, outcome)


def attempt_all(pool: Executor, plans: Iterable[Plan]) -> list[Done]:
    """Run all cases of some plans."""
    # The cases travel with what they need, not with each other
    tasks = [
        (one._replace(cases=()), case) for one in plans for case in one.cases
    ]
    return list(pool.map(attempt, tasks, chunksize=4))


def figures(job: str, done: Sequence[Done]) -> dict[str, Any]:
    """What came of a command's cases."""
    outcomes = [one.outcome for one in done]
    sites = ALL_JOBS[job].margins
    return {
        "job": job,
        "hosts": sorted({one.host for one in done}),
        "runs": len(outcomes),
        "survived": sum(not o.problems for o in outcomes),
        "missed": sum(not o.struck for o in outcomes),
        "faults": Counter(p.fault for o in outcomes for p in o.case.parts),
        "ended": Counter(o.ended for o in outcomes),
        "blind": [
            {
                "case": str(one.outcome.case),
                "host": one.host,
                "ended": one.outcome.ended,
                "reason": one.outcome.message,
                "depths": one.outcome.depths,
            }
            for one in done
            if one.outcome.is_blind()
        ],
        # Wrong by what no touch can tell
        "agreed": [
            str(o.case)
            for o in outcomes
            if o.error >= fault_cases.GAP_ERROR and not o.problems
        ],
        "worst": {
            site: max((o.depths.get(site, 0.0) for o in outcomes), default=0.0)
            for site in sites
        },
    }
