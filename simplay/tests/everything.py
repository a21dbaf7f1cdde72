"""A world with two of all that a world may have two of."""

from __future__ import annotations

from simprinter.world import (
    AxisSwitchSpec,
    BedSensorSpec,
    BedSpec,
    CarriageSpec,
    DockSpec,
    InductiveSpec,
    MagProbeSpec,
    MembraneSpec,
    PinSpec,
    WorldSpec,
)

_DOCK = {"mode": "dock", "plunger_on_pin": True}

EVERYTHING = WorldSpec(
    bed=BedSpec(x_max=220.0, y_max=220.0),
    pin=PinSpec(x=5.0, y=6.0, z=1.5),
    more_pins=(PinSpec(x=5.0, y=26.0, z=1.0, signal="other"),),
    switches=(
        AxisSwitchSpec("x_endstop", "x", -5.0, -1),
        AxisSwitchSpec("my_switch", "second", 250.0),
    ),
    second_carriage=CarriageSpec(240.0, z_offset=-0.2),
    mag_probe=MagProbeSpec(0.0, 20.0, 5.0, 0.5, **_DOCK),
    dock=DockSpec(30.0, 215.0, 20.0, approach=(0.0, -1.0, 0.0)),
    more_probes=(
        MagProbeSpec(
            0.0,
            20.0,
            6.0,
            0.5,
            **_DOCK,
            signal="long",
            on_second=True,
            dock=DockSpec(200.0, 215.0, 20.0, approach=(0.0, -1.0, 0.0)),
        ),
    ),
    inductive=InductiveSpec(20.0, 0.0, 2.0, signal="coil"),
    bed_sensor=BedSensorSpec(),
    membrane=MembraneSpec(30.0, 20.0, 0.3, radius=9.0),
    more_membranes=(MembraneSpec(60.0, 20.0, 0.4, radius=9.0, signal="thick"),),
)
