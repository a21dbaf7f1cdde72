"""Random printers: each calibration leaves the right gap, or is refused.

    python -m tools.campaign.drawn_printers --module z_calibration \\
        --host klippy-l --seed 1 --count 300

Hypothesis draws the printers, one for each seed from the given one on. So a
printer that fails is drawn again by its own seed and a count of 1.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Optional

from hypothesis import strategies as st

from simprinter.hosts.hosts import Host, find_hosts
from tools.campaign.drawing import check_drawn, deviations, differences
from tools.campaign.drawn import Drawn
from tools.campaign.drawn_auto_z_offset import AutoZOffset
from tools.campaign.drawn_machines import KINEMATICS
from tools.campaign.drawn_z_calibration import ZCalibration
from tools.campaign.judge import Verdict, shape, try_out

MODULES: dict[str, type[Drawn]] = {
    kind.module: kind for kind in (ZCalibration, AutoZOffset)
}

# So many printers are tried to find the simplest one that fails
SIMPLER = 60
# If more of the healthy printers are refused, a right gap proves little
MOST_REFUSED = 0.5
# Fewer than that are no share
_SHARE = 20
MOST_FAILURES = 5


@dataclass
class Report:
    """How a campaign went.

    right, refused: runs, the latter by the shape of its reason. healthy:
    printers without a mistake, and refused ones of them. worst_um, worst:
    largest error of a gap in um, and as a share of its bound. penetration: of
    the nozzle into the bed at most, mm. drawn: how often what was not
    standard. failures: what was wrong, and how to see it again.
    """

    runs: int = 0
    right: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    healthy: int = 0
    healthy_refused: int = 0
    worst_um: float = 0.0
    worst: float = 0.0
    penetration: float = 0.0
    drawn: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)

    def count(self, drawn: Drawn, verdict: Optional[Verdict]) -> None:
        """One run; verdict: None if it was wrong."""
        self.runs += 1
        self.healthy += not drawn.mistake
        self.drawn.update(deviations(drawn))
        if verdict is None:
            return
        self.penetration = max(self.penetration, verdict.penetration)
        if verdict.refused:
            self.refused[shape(verdict.refused)] += 1
            self.healthy_refused += not drawn.mistake
            return
        self.right += 1
        self.worst_um = max(self.worst_um, 1000.0 * abs(verdict.error))
        self.worst = max(self.worst, abs(verdict.error) / verdict.bound)

    def add(self, other: Report) -> None:
        """Take over the runs of another one."""
        for name, theirs in vars(other).items():
            ours = getattr(self, name)
            worst = isinstance(theirs, float)
            setattr(self, name, max(ours, theirs) if worst else ours + theirs)

    def problems(self) -> list[str]:
        """Failures, and a campaign that says nothing; empty: all is well."""
        share = self.healthy_refused / max(1, self.healthy)
        if self.healthy >= _SHARE and share > MOST_REFUSED:
            text = f"{share:.0%} of the healthy printers were refused"
            return [*self.failures, text]
        return self.failures

    def text(self) -> str:
        """For people."""
        lines = [
            f"{self.runs} printers: {self.right} right,"
            f" {sum(self.refused.values())} refused,"
            f" {len(self.failures)} wrong",
            f"healthy: {self.healthy}, refused of them: {self.healthy_refused}",
            f"worst gap: {self.worst_um:.1f} um off,"
            f" and {self.worst:.0%} of its bound",
            f"deepest in the bed: {self.penetration:.3f} mm",
        ]
        for what, counts in ("refused", self.refused), ("drawn", self.drawn):
            most = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
            lines += [f"  {count:4} {what}: {name}" for name, count in most]
        lines += [f"WRONG: {problem}" for problem in self.problems()]
        return "\n".join(lines)


def printers_for(module: str, host: Host) -> st.SearchStrategy:
    """Printers that a host can drive."""
    klippy = (host.directory / "base" / host.layout.module_dir).parent
    known = tuple(
        name
        for name in KINEMATICS
        if (klippy / "kinematics" / f"{name}.py").is_file()
    )
    return MODULES[module].printers(known)


@dataclass
class _Attempts:
    """Tries printers of one seed, each of them once.

    simpler: how many more after one has failed.
    """

    module: str
    host: Host
    modules: Optional[Mapping[str, Path]]
    simpler: int
    found: dict[Drawn, Optional[Exception]] = field(default_factory=dict)
    first: Optional[tuple[Drawn, Optional[Verdict]]] = None
    last_failed: Optional[Drawn] = None

    def check(self, drawn: Drawn) -> None:
        """The body of hypothesis' test."""
        # Its first draw is always the simplest one, whatever the seed
        if drawn == MODULES[self.module]():
            return
        if drawn not in self.found:
            if self.last_failed is not None:
                self.simpler -= 1
            if self.simpler < 0:
                return
            self._try(drawn)
        error = self.found[drawn]
        if error is not None:
            self.last_failed = drawn
            raise error

    def _try(self, drawn: Drawn) -> None:
        verdict = None
        try:
            verdict = try_out(drawn, self.host, self.modules)
            self.found[drawn] = None
        except Exception as error:  # noqa: BLE001 - whatever it is, it is shown
            self.found[drawn] = error
        if self.first is None:
            self.first = drawn, verdict

    def failure(self, seed: int) -> str:
        """What was wrong with the simplest, and how to see it again."""
        assert self.last_failed is not None and self.first is not None
        error = self.found[self.last_failed]
        assert error is not None
        return (
            f"{type(error).__name__}: {error}\n"
            f"  simplest: {differences(self.last_failed)}\n"
            f"  drawn:    {differences(self.first[0])}\n"
            f"  again:    python -m tools.campaign.drawn_printers"
            f" --module {self.module} --host {self.host.name} --seed {seed}"
            " --count 1"
        )


def _attempt(attempts: _Attempts, seed: int) -> bool:
    """Draw and try the printer of a seed; whether it was right or refused."""
    printers = printers_for(attempts.module, attempts.host)
    shrinks = bool(attempts.simpler)
    try:
        check_drawn(printers, attempts.check, seed, shrinks=shrinks)
    except Exception:  # noqa: BLE001 - kept with the printer that it is of
        return False
    return True


def run(
    module: str,
    host: Host,
    count: int,
    seed: int,
    modules: Optional[Mapping[str, Path]] = None,
    simpler: int = SIMPLER,
    most_failures: int = MOST_FAILURES,
) -> Report:
    """Try the printers of count seeds from seed on, or until too many fail.

    modules: by their name (default: the repository's). simpler: how many
    printers may be tried to make a failing one simpler.
    """
    report = Report()
    for number in range(seed, seed + count):
        attempts = _Attempts(module, host, modules, simpler)
        is_well = _attempt(attempts, number)
        assert attempts.first is not None, f"seed {number} draws nothing"
        report.count(*attempts.first)
        if not is_well:
            report.failures.append(attempts.failure(number))
            if len(report.failures) >= most_failures:
                break
    return report


def main() -> int:
    """From the command line; 1 if something was wrong."""
    hosts = {host.name: host for host in find_hosts()}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--module", choices=MODULES, required=True)
    parser.add_argument("--host", choices=hosts, required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--simpler", type=int, default=SIMPLER)
    wanted = parser.parse_args()
    report = run(
        wanted.module,
        hosts[wanted.host],
        wanted.count,
        wanted.seed,
        simpler=wanted.simpler,
    )
    print(report.text())
    return 1 if report.problems() else 0


if __name__ == "__main__":
    sys.exit(main())
