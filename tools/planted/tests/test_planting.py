"""make planted plants what it says, everywhere, and tells what was not found."""

from __future__ import annotations

import ast

import pytest

from tools.kit.printer import ROOT
from tools.planted.__main__ import Copy, is_wanted, looked_for, parse
from tools.planted.covering import Case, block_of, in_turn, measured
from tools.planted.found import Found, kept, render, table, write
from tools.planted.planting import READER, Fault, drawn, faults_of

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
    assert '== ("clearance", "z_calibration") else' in fault.planted(source)


@pytest.mark.parametrize(
    "line, block", [(1, None), (2, 2), (3, 3), (4, 2), (5, 5), (6, 2)]
)
def test_a_line_is_of_the_innermost_block(line, block):
    assert block_of(SOURCE, line) == block


def test_each_file_has_its_turn():
    def case(name, blocks, is_slow=False):
        return Case(name, 1.0, is_slow, blocks)

    cases = [
        case("tests/modules/b.py::1", 9),
        case("tests/modules/b.py::2", 3),
        case("tests/modules/b.py::3", 1, is_slow=True),
        case("tests/modules/c.py::4", 7),
        case("tests/unit/d.py::5", 8),
        case("tests/modules/b.py::6", 5),
    ]
    names = [case.name[-1] for case in in_turn(cases)]
    assert names == ["5", "2", "4", "6", "1", "3"]


def test_faults_are_found_by_the_tests_that_run_them(tmp_path):
    """A formula without a host, an option that klippy reads; then all is as it was."""
    name = "z_touch/extra_probe/heights.py"
    source = (ROOT / name).read_text("utf-8")
    copy = Copy(tmp_path / "copy")
    tests = [
        "tests/unit/test_extra_probe_heights.py",
        "tests/quick/test_extra_probe_quick.py",
    ]
    covering = measured(copy.folder, tmp_path, tests)
    signs = [f for f in faults_of(name, source) if f.kind == "sign"]
    found = [looked_for(copy, fault, covering, 30) for fault in signs[:2]]
    assert any(row.test.startswith(tests[0]) for row in found)
    assert all(bool(row.there) is bool(row.tried) for row in found)
    # Another one: the first is not tried again, in none of its cases
    row = next(row for row in found if row.test)
    other = looked_for(copy, row.fault, covering, 30, row.test)
    assert other.test.partition("[")[0] != row.test.partition("[")[0]
    assert other.there < row.there
    assert (copy.folder / name).read_text("utf-8") == source
    for option, is_given in (("z_offset", True), ("clearance", False)):
        fault = Fault(name, 1, "option", 0, 0, option, "")
        cases = covering.of(fault, source)
        assert bool(cases) is is_given
        assert all(case.name.startswith(tests[1]) for case in cases)
    # What was recorded stays for the same state of the product
    assert measured(copy.folder, tmp_path, tests) == covering


def test_what_nothing_finds_is_told(tmp_path):
    faults = faults_of("f.py", SOURCE)
    rows = [
        Found(f, "tests/a.py::test_b", n > 2, 8, 9)
        for n, f in enumerate(faults)
    ]
    rows[0] = rows[0]._replace(test="")
    text = table(rows)
    assert f"not found by 8 of 9 tests: {faults[0]}" in text
    assert "4 of 5 found (80 %), 2 of them by make test" in text
    # A run that goes on tries what nothing has found, and what is new
    file = tmp_path / "found.json"
    assert kept(file, faults) == []
    write(file, 7, rows)
    assert kept(file, faults[:3]) == rows[:3]
    _, seed, _, _, _, *cells, _ = render(str(file)).split("\n")
    assert seed.startswith("Seed 7, on ")
    assert [*map(str.strip, cells[-1].split("|")[1:-1])] == [
        *("all", "5", "0", "2", "2", "1")
    ]
    # Another test is looked for where one is known, and was not looked for before
    rows[1] = rows[1]._replace(second="")
    rows[2] = rows[2]._replace(second="tests/c.py::test_d")
    for given, wanted in ((["--second"], rows[3:]), ([], rows[:1])):
        assert [row for row in rows if is_wanted(row, parse(given))] == wanted
    write(file, 7, rows)
    assert "Of 2 that are found" in render(str(file))
    assert "1 are found by one test alone" in render(str(file))
