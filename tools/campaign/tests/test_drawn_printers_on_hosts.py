"""A few random printers, and faults in the modules that they have to find.

`make faults` tries many more of them.
"""

from __future__ import annotations

import pytest

from tools.campaign.drawn_printers import MODULES, run
from tools.campaign.jobs import JOBS
from tools.campaign.tests.planting import planted
from tools.kit.cases import all_slow_but

# On each host, always the same ones
PRINTERS = 3
# A fault has to show in so many
ENOUGH = 60


# Lines around a command, and words of what the judge says of it
PLANTED = {
    "gap": (
        "CALIBRATE_Z",
        {"done": 'run("SET_GCODE_OFFSET Z_ADJUST=0.3 MOVE=0")'},
        "the true gap is",
    ),
    "not lifted": (
        "CALIBRATE_Z",
        {"failed": 'run("G90\\nG1 Z3 F600")'},
        "not lifted",
    ),
    "acceleration": (
        "AUTO_Z_CALIBRATE",
        {"done": 'run("SET_VELOCITY_LIMIT ACCEL=77")'},
        "max_accel is",
    ),
    "one sample": (
        "AUTO_Z_CALIBRATE",
        {
            "before": """
for option in ("samples", "offset_samples"):
    config.fileconfig.set("auto_z_offset", option, "1")"""
        },
        "times, not",
    ),
}


@pytest.mark.timeout(600)
@pytest.mark.parametrize("module", all_slow_but(["auto_z_offset"], MODULES))
def test_random_printers_are_right_or_refused(host, module):
    problems = run(module, host, PRINTERS, seed=1).problems()
    assert not problems, "\n".join(problems)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", PLANTED)
def test_planted_fault_is_found(host, tmp_path, name):
    command, around, words = PLANTED[name]
    module = JOBS[command].module
    modules = planted(tmp_path, module, command, **around)
    report = run(
        module,
        host,
        ENOUGH,
        seed=1,
        modules=modules,
        simpler=0,
        most_failures=1,
    )
    assert len(report.failures) == 1, report.text()
    assert words in report.failures[0]
