"""CONTRIBUTING.md says what works."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_targets_exist():
    targets = {*re.findall(r"\bmake ([a-z-]+)", TEXT)}
    assert {"one", "quick", "test", "test-rest", "test-all"} <= targets
    for target in targets:
        command = ["make", "-n", target, "T=x", "PYTHON=true"]
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True)


def test_named_test_exists():
    file, test = re.search(r"make one T=(\S+)::(\w+)", TEXT).groups()
    assert f"\ndef {test}(" in (ROOT / file).read_text(encoding="utf-8")


def test_test_of_a_user_that_is_shown(start):
    code = re.search(r"```python\n(.*?)```", TEXT, re.S)[1]
    names = {"pytest": pytest}
    exec(code, names)
    (test,) = (v for k, v in names.items() if k.startswith("test_"))
    test(start)
