"""Wrong machines are refused, with the field named."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, replace

import pytest

from tests.simprinter.faults import Fault, Faults
from tests.simprinter.tests.world_machines import (
    DOCK,
    MAG,
    MEMBRANE,
    PIEZO,
    PIN,
    PROBE,
)
from tests.simprinter.world import (
    AxisSwitchSpec,
    BedSpec,
    DriftSpec,
    InductiveSpec,
    MeshSpec,
    NoiseSpec,
    World,
    WorldSpec,
)

WRONG = [
    (NoiseSpec(), "sigma", -0.1),
    (NoiseSpec(), "outlier_chance", 1.1),
    (NoiseSpec(), "latency", math.nan),
    (NoiseSpec(), "hysteresis", -1),
    (BedSpec(), "x_max", -1.0),
    (BedSpec(), "y_max", 0.0),
    (BedSpec(), "slope_x", math.inf),
    (MeshSpec(0, 0, 1, 1, ((0, 0), (0, 0))), "heights", ((0, 0), (0,))),
    (MeshSpec(0, 0, 1, 1, ((0, 0), (0, 0))), "x_max", 0),
    (PIN, "radius", 0.0),
    (PIN, "pin_travel", -0.1),
    (PIN, "signal", ""),
    (PROBE, "body_drop", 0.0),
    (PROBE, "switch_offset", -0.1),
    (PROBE, "mode", "magic"),
    (PROBE, "initial", "gone"),
    (PROBE, "initial", "docked"),
    (PROBE, "attach_time", 0.1),
    (AxisSwitchSpec("x_endstop", "x", 1.0), "axis", "w"),
    (AxisSwitchSpec("x_endstop", "x", 1.0), "direction", 0),
    (DOCK.dock, "reach", 0.0),
    (DOCK.dock, "approach", (0, 0, 0)),
    (DOCK.dock, "release", (0, -1, 0)),
    (PIEZO.inductive, "sense_distance", 0.0),
    (PIEZO.bed_sensor, "press_depth", -0.1),
    (MEMBRANE.membrane, "press", 0.31),
    (MEMBRANE.membrane, "half_x", 3.0),
    (MEMBRANE.membrane, "thickness", 0.0),
    (DriftSpec(), "stop", -1.0),
    (MAG, "overtravel", -0.1),
    (MAG, "inductive", InductiveSpec(0, 0, 1)),
    (DOCK, "dock", None),
    (MAG, "dock", DOCK.dock),
    (PIEZO, "probe_sense", True),
]


@pytest.mark.parametrize(("good", "field", "value"), WRONG)
def test_wrong_value_is_refused_by_name(good, field, value):
    # half_x clashes with radius, which is the field that is named
    named = "radius" if field == "half_x" else field
    with pytest.raises(ValueError, match=rf"{type(good).__name__}\.{named}"):
        replace(good, **{field: value})


def test_one_signal_cannot_have_two_sources():
    switch = AxisSwitchSpec("z_endstop", "z", 0.0, -1)
    with pytest.raises(ValueError, match="unique signals"):
        replace(MAG, switches=(switch,))
    separate = replace(PIN, signal="z_pin")
    both = replace(MAG, pin=separate, switches=(switch,))
    assert set(both.signals()) == {"z_endstop", "z_pin", "probe"}


def test_a_typo_raises():
    with pytest.raises(FrozenInstanceError):
        MAG.overtavel = 1.0
    world = World(MAG, 1)
    with pytest.raises(AttributeError):
        world.sped = MAG


@pytest.mark.parametrize("spec", [MAG, DOCK, PIEZO, MEMBRANE, WorldSpec()])
def test_spec_and_world_agree_on_signals(spec):
    assert sorted(World(spec, 1).signals) == sorted(spec.signals())


def test_fault_on_a_signal_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="no such signal"):
        World(MAG, 1, Faults([Fault("trigger_never", signal="bed_sensor")]))


def test_unknown_output_raises():
    with pytest.raises(KeyError):
        World(MAG, 1).set_output("probe_attach", 0.0, 1.0)
