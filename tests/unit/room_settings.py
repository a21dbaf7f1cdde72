"""The settings of a room whose section leaves everything out, by its table."""

from __future__ import annotations

import dataclasses
from types import ModuleType
from typing import Any

from tests.unit.loading import load

options = load("z_touch.options")


def values_of(rows: tuple) -> dict[str, Any]:
    """Option -> its default; None for what must be given."""
    values: dict[str, Any] = {}
    for row in rows:
        value = None if row.default is options.REQUIRED else row.default
        values[row.name] = options.settled(value, values)
    return values


def fields_of(record: Any) -> list[str]:
    """The names of the fields of a dataclass, or of a named tuple."""
    if dataclasses.is_dataclass(record):
        return [field.name for field in dataclasses.fields(record)]
    return list(record._fields)


def default_settings(room: ModuleType, **given: Any) -> Any:
    """The record of a room's settings.py: its defaults, but for these."""
    values = values_of(room.OPTIONS)
    values["sampling"] = options.sampling_of(values)
    fields = {name: values.get(name) for name in fields_of(room.Settings)}
    return room.Settings(**{**fields, **given})
