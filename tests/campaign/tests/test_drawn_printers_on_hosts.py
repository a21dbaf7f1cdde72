"""A few random printers, and faults in the modules that they have to find.

`make faults` tries many more of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

from tests.campaign.drawn_printers import MODULES, run
from tests.hostkit.printer import module_files

# On each host, always the same ones
PRINTERS = 5
# A fault has to show in so many
ENOUGH = 60


class Planted(NamedTuple):
    """A fault in a module, and words of what the judge says of it.

    seed: from which printer on it is looked for; from 1 on it takes long.
    """

    module: str
    right: str
    wrong: str
    words: str
    seed: int = 1


PLANTED = {
    "z-sign": Planted(
        "z_calibration",
        "return probe - (switch - nozzle + switch_offset)",
        "return probe - (switch - nozzle - switch_offset)",
        "",
        3,
    ),
    "z-halt": Planted(
        "z_calibration",
        "        self._check_travel(start_z, self.z())\n",
        "        return self.z()\n",
        "the true gap is",
        7,
    ),
    "z-one-sample": Planted(
        "z_calibration",
        "while len(samples) < sampling.samples:",
        "while not samples:",
        "times, not",
    ),
    "z-not-lifted": Planted(
        "z_calibration",
        'with dock, host.always(run.lift, "lifting"):',
        "with dock:",
        "not lifted",
        18,
    ),
    "auto-sign": Planted(
        "auto_z_offset",
        "return sensor - (probe - probe_z_offset) + z_offset",
        "return sensor - (probe - probe_z_offset) - z_offset",
        "the true gap is",
        2,
    ),
    "auto-halt": Planted(
        "auto_z_offset",
        "        self._check_travel(start_z, self.z())\n",
        "        return self.z()\n",
        "the true gap is",
        24,
    ),
    "auto-one-sample": Planted(
        "auto_z_offset",
        "while len(samples) < sampling.samples:",
        "while not samples:",
        "times, not",
    ),
    "auto-slow-ever-after": Planted(
        "auto_z_offset",
        "restore = functools.partial(self._set_accel, found)",
        "restore = functools.partial(self._set_accel, accel)",
        "max_accel is",
        2,
    ),
}


@pytest.mark.spread
@pytest.mark.timeout(600)
@pytest.mark.parametrize("module", MODULES)
def test_random_printers_are_right_or_refused(host, module):
    problems = run(module, host, PRINTERS, seed=1).problems()
    assert not problems, "\n".join(problems)


@pytest.mark.half
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", PLANTED)
def test_planted_fault_is_found(some_host, tmp_path: Path, name: str):
    planted = PLANTED[name]
    text = module_files()[planted.module].read_text(encoding="utf-8")
    assert text.count(planted.right) == 1
    path = tmp_path / f"{planted.module}.py"
    path.write_text(text.replace(planted.right, planted.wrong))
    report = run(
        planted.module,
        some_host,
        ENOUGH,
        seed=planted.seed,
        modules={planted.module: path},
        simpler=0,
        most_failures=1,
    )
    assert len(report.failures) == 1, report.text()
    assert planted.words in report.failures[0]
