"""Draws printers with [z_calibration]."""

from __future__ import annotations

import dataclasses

from hypothesis import strategies as st

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
from tests.campaign.drawn_machines import KINEMATICS, Sampling
from tests.campaign.z_calibration_mistakes import MISTAKES
from tests.campaign.z_calibration_printer import (
    Homing,
    Options,
    Pin,
    Probe,
    ZPrinter,
)
from tests.simprinter.world import DriftSpec

# With the probe as endstop these are about something that is not there
_ABOUT_ENDSTOP = ("endstop is the probe", "endstop far off")


def _pins() -> st.SearchStrategy:
    return st.builds(
        Pin,
        x=around(206.0, 50.0, 250.0, 1.0),
        height=around(1.5012, 0.3, 5.0, 0.0001),
        believed=around(0.0988, -0.5, 0.5, 0.0001),
        pretravel=often(0.0, around(0.0, 0.0, 0.5)),
        noise=noises(0.0, 0.002),
        is_own=st.sampled_from((False, False, False, True)),
    )


def _probes() -> st.SearchStrategy:
    return st.builds(
        Probe,
        x=around(-2.0, -40.0, 40.0, 0.5),
        y=around(24.75, 12.0, 35.0, 0.5),
        body=around(6.415, 2.5, 8.5, 0.001),
        switch_offset=around(0.5, 0.3, 1.0),
        configured=around(0.06, -0.1, 0.3),
        pretravel=around(0.3, 0.05, 0.6),
        # It does not matter, says the documentation
        z_offset=often(None, around(0.0, -1.0, 15.0, 0.1)),
        attached=st.sampled_from(("always", "start", "before_switch")),
        noise=noises(0.0, 0.002),
    )


def _homings() -> st.SearchStrategy:
    return st.builds(
        Homing,
        speed=around(8.0, 2.0, 12.0, 0.1),
        second_speed=around(3.0, 1.0, 6.0, 0.1),
        retract=around(3.0, 1.0, 5.0, 0.1),
    )


def _options() -> st.SearchStrategy:
    return st.builds(
        Options,
        samples=often(None, st.integers(1, 3)),
        probing_speed=often(None, around(5.0, 1.0, 12.0, 0.5)),
        first_fast=st.booleans(),
        safe_z_height=often(None, around(10.0, 3.0, 40.0, 0.5)),
        travel_margin=often(None, around(1.0, 0.5, 3.0, 0.1)),
        speed=often(None, around(50.0, 30.0, 200.0, 1.0)),
    )


def printers(kinematics: tuple[str, ...] = KINEMATICS) -> st.SearchStrategy:
    """kinematics: those that a host knows."""
    drawn = st.builds(
        ZPrinter,
        # First, as hypothesis never draws its simplest first value twice
        seed=st.integers(0, 999),
        gantry=gantries(4, kinematics),
        plate=plates(0.4),
        bed=st.tuples(*[around(150.0, 70.0, 230.0, 1.0)] * 2),
        pin=_pins(),
        probe=_probes(),
        homing=_homings(),
        sampling=samplings(Sampling(), 4, 10.0),
        options=_options(),
        drift=often(DriftSpec(), drifts()),
        other_board=st.sampled_from(("", "z_endstop", "probe")),
        board_latency=st.sampled_from((0.002, 0.001, 0.004, 0.005)),
        offset=often(0.0, around(0.0, -0.1, 0.1)),
        mistake=mistaken(tuple(MISTAKES)),
    )
    return drawn.map(_possible)


def _possible(printer: ZPrinter) -> ZPrinter:
    """The same without what contradicts itself."""
    pin, probe, mistake = printer.pin, printer.probe, printer.mistake
    if pin.is_own:
        # Z is homed with it, so it is there, and its length was measured
        probe = dataclasses.replace(probe, attached="always", z_offset=None)
        if mistake in (*_ABOUT_ENDSTOP, "no probe"):
            mistake = ""
    return dataclasses.replace(printer, probe=probe, mistake=mistake)
