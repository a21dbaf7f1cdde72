"""Tables of cases of which make test runs those that find something new."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def slow(*values: Any) -> Any:
    """A case that make test leaves to make test-all."""
    return pytest.param(*values, marks=pytest.mark.slow)


def all_slow_but(usual: Iterable[Any], cases: Iterable[Any]) -> list[Any]:
    """A long table of which make test runs the usual cases only.

    Raises ValueError for a usual case that is none of the table.
    """
    table, kept = list(cases), list(usual)
    for case in kept:
        table.index(case)
    return [
        case
        if case in kept
        else slow(*(case if isinstance(case, tuple) else (case,)))
        for case in table
    ]
