"""CONTRIBUTING.md says what works, and the forms ask for what helps."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
FORMS = sorted((ROOT / ".github").glob("ISSUE_TEMPLATE/*.yml"))


def test_it_is_one_page():
    assert len(TEXT.split()) <= 600


def test_targets_exist():
    targets = {*re.findall(r"\bmake ([a-z-]+)", TEXT)}
    assert {"one", "quick", "test", "test-rest", "test-all"} <= targets
    for target in targets:
        command = ["make", "-n", target, "T=x", "PYTHON=true"]
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True)


def test_named_test_and_mark_exist():
    file, test = re.search(r"make one T=(\S+)::(\w+)", TEXT).groups()
    assert f"\ndef {test}(" in (ROOT / file).read_text(encoding="utf-8")
    mark = re.search(r"@pytest\.mark\.every_host\(\".*?\"\)", TEXT)[0]
    tests = (ROOT / "tests" / "modules").glob("test_*.py")
    assert any(mark in path.read_text(encoding="utf-8") for path in tests)


def test_test_of_a_user_that_is_shown(start):
    code = re.search(r"```python\n(.*?)```", TEXT, re.S)[1]
    names = {"pytest": pytest}
    exec(code, names)
    (test,) = (v for k, v in names.items() if k.startswith("test_"))
    test(start)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_form_asks(form):
    text = form.read_text(encoding="utf-8")
    if form.stem == "config":
        assert text == "blank_issues_enabled: true\n"
        return
    assert text.startswith("name: ") and "\ndescription: " in text
    # What GitHub requires of each field
    _, *fields = text.partition("\nbody:\n")[2].split("  - type: ")
    asked = [field for field in fields if field.startswith("textarea")]
    assert len(fields) - len(asked) <= 1
    ids = [re.search(r"(?m)^    id: (\w+)$", field)[1] for field in asked]
    assert len({*ids}) == len(ids) >= 3
    for field in asked:
        assert re.search(r"(?m)^    attributes:\n      label: \S", field)


def test_problem_comes_with_what_helps():
    text = (ROOT / ".github/ISSUE_TEMPLATE/problem.yml").read_text()
    for part in ("Z_CALIBRATION_REPORT", "printer.cfg", "console"):
        assert re.search(rf"label: .*{part}", text), part
    assert "docs/security.md" in text


def test_workflow_runs_what_everybody_runs():
    text = (ROOT / ".github/workflows/test.yml").read_text(encoding="utf-8")
    assert "      - run: .ci/run\n" in text
    assert (ROOT / ".ci" / "run").stat().st_mode & 0o111
