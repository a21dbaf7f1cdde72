"""How printers and steps are drawn: they deviate from what works.

So what hypothesis makes simpler leads back there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import hypothesis
from hypothesis import HealthCheck, Phase
from hypothesis import strategies as st

T = TypeVar("T")


def check_drawn(
    strategy: st.SearchStrategy[T],
    check: Callable[[T], None],
    seed: int,
    *,
    shrinks: bool,
) -> None:
    """Call check with what a seed draws, and with simpler ones if it raises.

    Hypothesis draws the simplest of all first, whatever the seed.
    """
    phases = [Phase.generate] + [Phase.shrink] * shrinks
    test = hypothesis.given(strategy)(check)
    test = hypothesis.settings(
        max_examples=2,
        database=None,
        deadline=None,
        phases=phases,
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
    )(test)
    hypothesis.seed(seed)(test)()


def around(standard: float, low: float, high: float, digit: float = 0.01):
    """Numbers from low to high in whole digits away from the standard."""
    first = math.ceil((low - standard) / digit)
    last = math.floor((high - standard) / digit)
    return st.integers(first, last).map(
        lambda count: round(standard + count * digit, 6)
    )


def often(standard: Any, others: st.SearchStrategy) -> st.SearchStrategy:
    """The standard in about half of all draws."""
    return st.one_of(st.just(standard), others)


def seldom(usual: Any, others: st.SearchStrategy) -> st.SearchStrategy:
    """The others in about a sixth of all draws."""
    return st.integers(0, 5).flatmap(
        lambda n: others if n == 5 else st.just(usual)
    )
