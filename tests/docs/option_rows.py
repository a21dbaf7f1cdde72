"""What a document has to say of an option, by its row in settings.py."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from tests.docs.documents import normal, part
from z_touch.core import options

WHOLE = "The whole section"
_SIGNS = (("above", ">"), ("minval", "≥"), ("maxval", "≤"))


def value_of(row: Any) -> str:
    """The default as an owner writes it; empty: it comes from elsewhere."""
    default = row.default
    if default is options.REQUIRED or default is None:
        return ""
    if isinstance(default, options.Given):
        default = default.else_
    if isinstance(default, options.Same):
        return ""
    if isinstance(default, tuple):
        return ", ".join(f"{value:g}" for value in default)
    if isinstance(default, float):
        return f"{default:g}"
    return str(default)


def same_value(text: str, row: Any) -> bool:
    """Whether an owner's text is the default, however a number is written."""
    wanted = value_of(row)
    try:
        written, real = text.split(","), wanted.split(",")
        return list(map(float, written)) == list(map(float, real))
    except ValueError:
        return text.lower() == wanted.lower()


def default_of(row: Any) -> str:
    """The default as the table of options has it."""
    if row.default is options.REQUIRED:
        return "required"
    if isinstance(row.default, options.Same):
        return f"`{row.default.name}`"
    return f"`{value_of(row)}`" if value_of(row) else "-"


def range_of(row: Any) -> str:
    """Unit and range as the table of options has them."""
    if row.kind is options.FLAG:
        return "`True` or `False`"
    if row.kind not in (options.NUMBER, options.COUNT):
        return f"{row.kind.word} {row.unit}".strip()
    unit = "count" if row.kind is options.COUNT else row.unit
    limits = [
        f", {sign} {row.limits[name]:g}"
        for name, sign in _SIGNS
        if name in row.limits
    ]
    return unit + "".join(limits)


def problems_of_lines(text: str, table: tuple[Any, ...]) -> Iterator[str]:
    """Where the whole section of a document differs from the rows."""
    pattern = r"(#?)([a-z_]+):(.*)\n((?:#   .*\n)*)"
    (block,) = re.findall(r"```ini\n(.*?)```", part(text, WHOLE), re.S)
    lines = re.findall(pattern, block)
    told = {name for _, name, _, _ in lines}
    for name in sorted(told ^ {row.name for row in table}):
        yield f"{name}: only in the section or only in the source"
    by_name = {row.name: row for row in table}
    for mark, name, value, comment in lines:
        if name not in by_name:
            continue
        row = by_name[name]
        if normal(comment.replace("#", "")) != normal(row.text):
            yield f"{name}: {comment!r}, it is {row.text!r}"
        if mark and not same_value(value.strip(), row):
            yield f"{name}: {value!r}, it is {value_of(row)!r}"
        if not mark and not value.strip():
            yield f"{name}: an empty value"
        if mark and row.default is options.REQUIRED:
            yield f"{name}: it is required"
