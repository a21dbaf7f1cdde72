"""make planted plants what it says, everywhere, and tells what was not found."""

from __future__ import annotations

import ast

import pytest

from tools.kit.printer import ROOT
from tools.planted.__main__ import STAGES, Copy, Found, files_for, table
from tools.planted.planting import READER, drawn, faults_of

SOURCE = """\
def f(a, b):
    if a < 2.0:
        raise ValueError("ä" + "b")
    if b:
        return a - b
    return 60.0 * a
"""
PLANTED = {
    "guard": "if False:",
    "limit": "if a < 3.0:",
    "condition": "if not (b):",
    "sign": "return ((a) + (b))",
    "unit": "return ((60.0) / (a))",
}


def test_each_kind_stands_where_it_says():
    faults = faults_of("f.py", SOURCE)
    assert sorted(fault.kind for fault in faults) == sorted(PLANTED)
    for fault in faults:
        changed = fault.planted(SOURCE).splitlines()
        lines = zip(SOURCE.splitlines(), changed)
        (line,) = [now for was, now in lines if now != was]
        assert line.strip() == PLANTED[fault.kind]
        assert changed[fault.line - 1] == line


def test_every_fault_of_the_product_is_python():
    faults = drawn(ROOT, "z_touch", 10**6, 1)
    assert {fault.kind for fault in faults} == {*PLANTED, "option"}
    sources = {
        fault.changed: (ROOT / fault.changed).read_text("utf-8")
        for fault in faults
    }
    for fault in faults:
        source = sources[fault.changed]
        planted = fault.planted(source)
        assert planted != source
        ast.parse(planted)


def test_the_seed_says_which():
    first = drawn(ROOT, "z_touch", 30, 59)
    assert first == drawn(ROOT, "z_touch", 30, 59)
    assert first != drawn(ROOT, "z_touch", 30, 60)
    assert len({fault.kind for fault in first[:6]}) == 6


def test_an_option_is_ignored_where_all_are_read():
    faults = drawn(ROOT, "z_touch/z_calibration", 10**6, 1)
    (fault,) = [
        f for f in faults if f.kind == "option" and f.before == "clearance"
    ]
    assert fault.changed == READER
    source = (ROOT / READER).read_text("utf-8")
    assert 'row.default if row.name == "clearance" else' in (
        fault.planted(source)
    )


@pytest.mark.parametrize("stage", STAGES)
def test_there_are_tests_for_every_file(stage):
    for path in (ROOT / "z_touch").rglob("*.py"):
        for name in files_for(path.relative_to(ROOT).as_posix(), stage):
            assert (ROOT / name).exists()


def test_a_fault_is_found_and_gone_after_it(tmp_path):
    """By the tests of a formula, without a host."""
    tests = ["tests/unit/test_extra_probe_heights.py"]
    copy = Copy(tmp_path / "copy")
    assert copy.first_failure(None, tests) == ""
    name = "z_touch/extra_probe/heights.py"
    source = (ROOT / name).read_text("utf-8")
    signs = [f for f in faults_of(name, source) if f.kind == "sign"]
    found = [copy.first_failure(fault, tests) for fault in signs[:2]]
    assert any(test.startswith(tests[0]) for test in found)
    assert (copy.folder / name).read_text("utf-8") == source


def test_what_nothing_finds_is_told():
    faults = faults_of("f.py", SOURCE)
    rows = [Found(fault, "quick", "tests/a.py::test_b") for fault in faults]
    rows[0] = rows[0]._replace(test="")
    text = table(rows)
    assert f"not found: {faults[0]}" in text
    assert "4 of 5 found (80 %)" in text
