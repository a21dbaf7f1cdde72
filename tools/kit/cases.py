"""Which cases make test runs, and the host that each runs on."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import pytest

T = TypeVar("T")


def drawn(case: str, seed: str, hosts: Sequence[T]) -> T:
    """The host of a case: the same wherever and whenever it is drawn.

    With another seed it is another one, so that in time all hosts see all cases.
    """
    return random.Random(f"{seed} {case}").choice(hosts)


def slow(*values: Any) -> Any:
    """A case that make test leaves to make test-rest."""
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
