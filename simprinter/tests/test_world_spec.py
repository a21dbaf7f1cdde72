"""Wrong machines are refused, with the field named."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from simprinter.faults import Fault, Faults
from simprinter.tests.world_machines import (
    DOCK,
    MAG,
    MEMBRANE,
    PIEZO,
    PIN,
    PROBE,
)
from simprinter.world import (
    AxisSwitchSpec,
    BedSpec,
    DriftSpec,
    InductiveSpec,
    MeshSpec,
    NoiseSpec,
    World,
    WorldSpec,
)

FLAT = MeshSpec(0, 0, 1, 1, ((0, 0), (0, 0)))
WRONG = [
    (NoiseSpec(), "sigma", -0.1),
    (NoiseSpec(), "latency", math.nan),
    (BedSpec(), "slope_x", math.inf),
    (FLAT, "heights", ((0, 0), (0,))),
    (PIN, "radius", 0.0),
    (PROBE, "initial", "docked"),
    (AxisSwitchSpec("x_endstop", "x", 1.0), "direction", 0),
    (DOCK.dock, "release", (0, -1, 0)),
    (MEMBRANE.membrane, "press", 0.31),
    (MEMBRANE.membrane, "radius", None),
    (DriftSpec(), "stop", -1.0),
    (MAG, "inductive", InductiveSpec(0, 0, 1)),
    (DOCK, "dock", None),
    (PIEZO, "probe_sense", True),
]


@pytest.mark.parametrize(("good", "field", "value"), WRONG)
def test_wrong_value_is_refused_by_name(good, field, value):
    with pytest.raises(ValueError, match=rf"{type(good).__name__}\.{field}"):
        replace(good, **{field: value})


def test_one_signal_cannot_have_two_sources():
    switch = AxisSwitchSpec("z_endstop", "z", 0.0, -1)
    with pytest.raises(ValueError, match="unique signals"):
        replace(MAG, switches=(switch,))
    separate = replace(PIN, signal="z_pin")
    both = replace(MAG, pin=separate, switches=(switch,))
    assert set(both.signals()) == {"z_endstop", "z_pin", "probe"}


@pytest.mark.parametrize("spec", [MAG, DOCK, PIEZO, MEMBRANE, WorldSpec()])
def test_spec_and_world_agree_on_signals(spec):
    assert sorted(World(spec, 1).signals) == sorted(spec.signals())


def test_names_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="no such signal"):
        World(MAG, 1, Faults([Fault("trigger_never", signal="bed_sensor")]))
    with pytest.raises(KeyError):
        World(MAG, 1).set_output("probe_attach", 0.0, 1.0)
