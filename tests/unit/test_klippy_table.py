"""docs/klippy.csv has all of klippy that z_touch touches."""

from __future__ import annotations

from tests.docs.klippy import (
    DOCUMENT,
    EVENT,
    asked,
    generated,
    heard,
    looked_up,
    rows,
    typed,
)

# Of ours, or of Python
OWN = {
    "z_calibration",
    "probe:z_virtual_endstop",
    "__self__",
    "__defaults__",
    "get_status",
}


def test_files_are_those_that_use_it():
    assert DOCUMENT.read_text(encoding="utf-8") == generated()
    assert [row for row in rows() if not row.used_in] == []


def test_no_name_is_there_twice():
    names = [(row.object, row.name) for row in rows()]
    assert len(names) == len(set(names))


def test_each_object_that_is_looked_up_is_there():
    known = {row.object for row in rows()}
    found = set(looked_up()) - OWN
    assert len(found) > 15
    assert found - known == set()


def test_each_event_is_there():
    known = {row.name for row in rows() if row.object == EVENT}
    assert set(heard()) - OWN == known


def test_each_attribute_that_is_asked_for_is_there():
    known = {part for row in rows() for part in row.name.split(".")}
    assert len(set(asked())) > 20
    assert set(asked()) - OWN - known == set()
    assert set(typed()) - OWN - known == set()
