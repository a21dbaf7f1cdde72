"""The tables of options of [auto_z_offset] and [extra_probe]."""

from __future__ import annotations

import pytest

from tests.unit.loading import load
from tests.unit.room_settings import default_settings, fields_of
from z_touch.options import PROBE_OPTIONS

ROOMS = {
    name: load(f"z_touch.{name}.settings")
    for name in ("auto_z_offset", "extra_probe")
}
SAMPLING = {row.name for row in PROBE_OPTIONS}


@pytest.mark.parametrize("name", ROOMS)
def test_every_option_has_one_row_and_one_sentence(name):
    rows = ROOMS[name].OPTIONS
    assert len({row.name for row in rows}) == len(rows)
    assert [row.name for row in rows if not row.text.endswith((".", "?"))] == []


@pytest.mark.parametrize("name", ROOMS)
def test_every_option_is_in_a_record(name):
    """Those of sampling are Sampling, too."""
    room = ROOMS[name]
    fields = set(fields_of(room.Settings))
    if name == "extra_probe":
        fields |= set(fields_of(room.SwitchSettings))
    names = {row.name for row in room.OPTIONS}
    assert names - fields <= SAMPLING
    assert "sampling" in fields
    default_settings(room)
