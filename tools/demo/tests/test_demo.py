"""The demo, run as make demo does."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from simprinter.hosts.environment import build_dir
from tools.demo.__main__ import demonstrate
from tools.kit.scenes import SCENES

ROOT = Path(__file__).resolve().parents[3]
PICTURE = ROOT / "docs" / "demo.svg"
MINUS = "\N{MINUS SIGN}"
MICROSTEP = 0.0025
RESULT = re.compile(
    r"Z-CALIBRATION: probe=(\S+) - \(switch=(\S+) - nozzle=(\S+)"
    r" \+ switch_offset=(\S+)\) --> new offset=(\S+)"
)
UNCERTAINTY = re.compile(r"Z-CALIBRATION: offset \S+ \+-(\S+) mm")


def demo(*options: str) -> subprocess.CompletedProcess:
    """Run it as `make demo` does, with a relative BUILD_DIR."""
    relative = os.path.relpath(build_dir(), ROOT)
    return subprocess.run(
        [sys.executable, "-m", "tools.demo", *options],
        cwd=ROOT,
        env={**os.environ, "BUILD_DIR": relative},
        timeout=100,
        capture_output=True,
        text=True,
    )


def gap(output: str, name: str) -> float:
    found = re.search(rf"^  {name} +([-+]\d+\.\d+) mm", output, re.MULTILINE)
    assert found, output
    return float(found[1])


# Others differ in what the demo does not show, and not all run on every host
@pytest.mark.parametrize("name", ["cartesian", "voron"])
def test_demo_shows_the_run(host, name):
    run = demo("--host", host.name, "--scene", name)
    assert run.returncode == 0, run.stdout + run.stderr
    output = run.stdout
    assert f"{host.name}: " in output
    assert host.version in output
    lines = output.splitlines()
    result = RESULT.search(output)
    assert result, output
    where = [
        lines.index("> G28"),
        lines.index("> CALIBRATE_Z"),
        next(i for i, line in enumerate(lines) if RESULT.search(line)),
    ]
    assert where == sorted(where)

    scene = SCENES[name]
    after, predicted = gap(output, "after"), gap(output, "predicted")
    assert predicted == pytest.approx(scene.formula_gap(), abs=1e-4)
    assert after == pytest.approx(predicted, abs=2 * MICROSTEP)
    moved = float(result[5])
    assert after - gap(output, "before") == pytest.approx(moved, abs=MICROSTEP)

    shown = [*map(float, result.groups()), after, predicted]
    if name == "voron":
        # What README shows is the same run
        drawn = "".join(ET.parse(PICTURE).getroot().itertext())
        assert all(f"{v:.3f}".replace("-", MINUS) in drawn for v in shown)
        assert f"±{UNCERTAINTY.search(output)[1]}" in drawn


def test_wrong_gap_is_told_and_ends_in_1(host, capsys):
    # The owner is 40 mm wrong about the probe, on a bed that is not level: it
    # measures where the bed is lower
    changes = {"probe": {"x_offset": "12"}}
    scene = SCENES["cartesian"]
    assert demonstrate(host, scene, changes) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("FAILED: the true gap is ")
    assert "too small, 0.0050 mm are allowed" in last
