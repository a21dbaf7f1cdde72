"""Draws printers with [auto_z_offset]."""

from __future__ import annotations

import dataclasses

from hypothesis import strategies as st

from tests.campaign.auto_z_offset_mistakes import MISTAKES
from tests.campaign.auto_z_offset_printer import (
    Homing,
    Inductive,
    Options,
    Piezo,
    PiezoPrinter,
)
from tests.campaign.drawing import (
    around,
    drifts,
    gantries,
    mistaken,
    noises,
    often,
    plates,
    samplings,
)
from tests.campaign.drawn_machines import KINEMATICS
from tests.simprinter.world import DriftSpec


def _inductives() -> st.SearchStrategy:
    return st.builds(
        Inductive,
        x=around(17.6, -30.0, 30.0, 0.5),
        y=around(4.4, -30.0, 30.0, 0.5),
        distance=around(1.2713, 0.6, 3.0, 0.0001),
        configured=around(0.0, 0.0, 3.0, 0.1),
        noise=noises(0.0, 0.002),
    )


def _piezos() -> st.SearchStrategy:
    return st.builds(
        Piezo,
        press=around(0.04, 0.0, 0.3, 0.001),
        noise=noises(0.002, 0.005),
        is_switched=st.sampled_from((True, False)),
    )


def _homings() -> st.SearchStrategy:
    return st.builds(
        Homing,
        speed=around(8.0, 2.0, 12.0, 0.1),
        second_speed=around(5.0, 1.0, 8.0, 0.1),
        retract=around(5.0, 4.0, 6.0, 0.1),
        at=often(None, st.tuples(*[around(120.0, 80.0, 170.0, 1.0)] * 2)),
    )


def _options() -> st.SearchStrategy:
    return st.builds(
        Options,
        z_offset=around(0.2, -0.1, 0.5),
        probe_hop=around(5.0, 4.0, 8.0, 0.1),
        probe_accel=st.sampled_from((50.0, 0.0, 20.0, 200.0, 500.0)),
        cycles=around(3, 1, 3, 1).map(int),
        current_factor=st.sampled_from((None, 1.0, 0.5, 0.1)),
        has_drivers=st.sampled_from((True, False)),
        shakes=st.sampled_from((True, False)),
        saved=often(None, around(0.0, -0.8, 0.8)),
    )


def printers(kinematics: tuple[str, ...] = KINEMATICS) -> st.SearchStrategy:
    """kinematics: those that a host knows."""
    standard = PiezoPrinter()
    drawn = st.builds(
        PiezoPrinter,
        # First, as hypothesis never draws its simplest first value twice
        seed=st.integers(0, 999),
        gantry=gantries(2, kinematics),
        plate=plates(standard.plate.z),
        bed=st.tuples(
            around(120.0, 80.0, 170.0, 1.0), around(127.0, 80.0, 170.0, 1.0)
        ),
        inductive=_inductives(),
        piezo=_piezos(),
        homing=_homings(),
        sampling=samplings(standard.sampling, 3, 10.0),
        options=_options(),
        drift=often(DriftSpec(), drifts()),
        other_board=st.sampled_from(("", "bed_sensor", "probe")),
        board_latency=st.sampled_from((0.002, 0.001, 0.004, 0.005)),
        offset=often(0.0, around(0.0, -0.1, 0.1)),
        mistake=mistaken(tuple(MISTAKES)),
    )
    return drawn.map(_possible)


def _possible(printer: PiezoPrinter) -> PiezoPrinter:
    """The same without what contradicts itself.

    The head stops 4 mm above Z=0 in prepare_gcode, so the bed has to be
    lower; and within reach of position_min.
    """
    probe = printer.inductive
    highest = min(probe.configured, round(probe.distance + 1.0, 1))
    probe = dataclasses.replace(probe, configured=highest)
    mistake = printer.mistake
    if mistake == "sensor off" and not printer.piezo.is_switched:
        mistake = ""
    return dataclasses.replace(printer, inductive=probe, mistake=mistake)
