"""Strategies that random printers of all modules have in common.

They deviate from defaults that work, so that shrinking leads back to these.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

import hypothesis
from hypothesis import HealthCheck, Phase
from hypothesis import strategies as st

from simprinter.world import DriftSpec, NoiseSpec
from tools.campaign.drawn_machines import HOLDERS, Gantry, Plate, Sampling

if TYPE_CHECKING:
    from tools.campaign.drawn import Drawn

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


def gantries(z_motors: int, kinematics: tuple[str, ...]) -> st.SearchStrategy:
    """z_motors: of the standard; kinematics: the standard's first."""
    counts = sorted(HOLDERS, key=lambda count: abs(count - z_motors))
    heights = st.tuples(*[around(0.0, -0.15, 0.15)] * 3)
    return st.builds(
        Gantry,
        kinematics=st.sampled_from(kinematics),
        z_motors=st.sampled_from(counts),
        # With the last one no distance is a whole number of steps
        screw=st.sampled_from((8.0, 4.0, 7.77)),
        microsteps=st.sampled_from((16, 32, 8)),
        skew=often((), heights),
    )


def plates(z: float) -> st.SearchStrategy:
    """z: the standard's height, mm."""
    slopes = often(0.0, around(0.0, -2e-3, 2e-3, 1e-4))
    return st.builds(
        Plate,
        z=around(z, z - 1.0, z + 1.0, 0.0001),
        slope_x=slopes,
        slope_y=slopes,
        bow=often(0.0, around(0.0, -0.2, 0.2)),
    )


def noises(latency: float, longest: float) -> st.SearchStrategy:
    """Noise of a sensor; latency and the longest one in s."""
    return st.builds(
        NoiseSpec,
        sigma=often(0.0, around(0.0, 0.0, 0.004, 0.0001)),
        outlier_chance=often(0.0, st.just(0.02)),
        outlier_size=st.sampled_from((0.0, 0.1, -0.1, 0.03)),
        hysteresis=often(0.0, around(0.0, 0.0, 0.3)),
        latency=often(latency, around(0.0, 0.0, longest, 0.0001)),
    )


def drifts() -> st.SearchStrategy:
    """Thermal growth, up to a third of a millimetre in an hour."""
    rates = often(0.0, around(0.0, -1e-4, 1e-4, 1e-5))
    return st.builds(DriftSpec, nozzle=rates, pin=rates, bed=rates, body=rates)


def samplings(
    standard: Sampling, most: int, fastest: float
) -> st.SearchStrategy:
    """Around the standard; most: samples; fastest in mm/s."""
    return st.builds(
        Sampling,
        samples=around(standard.samples, 1, most, 1).map(int),
        result=st.sampled_from((standard.result, "median", "average")),
        tolerance=around(standard.tolerance, 0.005, 0.05, 0.001),
        retries=around(standard.retries, 0, 5, 1).map(int),
        speed=around(standard.speed, 2.0, fastest, 0.1),
        retract=around(standard.retract, 0.5, 5.0, 0.1),
    )


def drawn_like(
    standard: Drawn,
    kinematics: tuple[str, ...],
    most: tuple[int, float],
    own: dict[str, st.SearchStrategy],
    options: st.SearchStrategy,
    boards: tuple[str, ...],
) -> st.SearchStrategy:
    """Printers of a module.

    most: samples, and mm/s. own, options: the module's fields. boards: inputs
    that may be on another one. A third of all has a mistake.
    """
    mistakes = tuple(standard.mistakes)
    return st.builds(
        type(standard),
        # First, as hypothesis never draws its simplest first value twice
        seed=st.integers(0, 999),
        gantry=gantries(standard.gantry.z_motors, kinematics),
        plate=plates(standard.plate.z),
        **own,
        sampling=samplings(standard.sampling, *most),
        options=options,
        drift=often(DriftSpec(), drifts()),
        other_board=st.sampled_from(("", *boards)),
        board_latency=st.sampled_from((0.002, 0.001, 0.004, 0.005)),
        offset=often(0.0, around(0.0, -0.1, 0.1)),
        mistake=st.sampled_from(("",) * (2 * len(mistakes)) + mistakes),
    )


# Reading what was drawn


def _deviations(drawn: Any, standard: Any) -> Iterator[tuple[str, Any]]:
    """Names and values of what differs from the standard."""
    for field in dataclasses.fields(drawn):
        ours, theirs = getattr(drawn, field.name), getattr(standard, field.name)
        if ours == theirs:
            continue
        if dataclasses.is_dataclass(ours):
            for name, value in _deviations(ours, theirs):
                yield f"{field.name}.{name}", value
        else:
            yield field.name, ours


def deviations(drawn: Any) -> Iterator[str]:
    """What differs from the standard, words with their value."""
    for name, value in _deviations(drawn, type(drawn)()):
        yield f"{name}={value}" if isinstance(value, str) else name


def differences(drawn: Any) -> str:
    """The same with all values."""
    found = _deviations(drawn, type(drawn)())
    return ", ".join(f"{name}={value!r}" for name, value in found)
