"""The simulated machine's physics: mm and seconds, nothing of any host.

Not simulated: the sideways push of a pin or probe, elasticity of the frame,
the plunger or the body resting on a membrane switch or on the pin's housing,
lost steps, a bed that moves in XY, what lies outside the plate.
"""

from .bed import Bed
from .kinematics import Delta, Kinematics, Pose, make_kinematics
from .spec import (
    AxisSwitchSpec,
    BedSensorSpec,
    BedSpec,
    CarriageSpec,
    DockSpec,
    DriftSpec,
    HotendSpec,
    InductiveSpec,
    MagProbeSpec,
    MembraneSpec,
    MeshSpec,
    NoiseSpec,
    OozeSpec,
    PinSpec,
    SpecError,
    TextureSpec,
    TowerSpec,
    WorldSpec,
)
from .truth import Crash, CrashError, ProbeEvent, Touch, Truth
from .world import World

__all__ = [
    "AxisSwitchSpec",
    "Bed",
    "BedSensorSpec",
    "BedSpec",
    "CarriageSpec",
    "Crash",
    "CrashError",
    "Delta",
    "DockSpec",
    "DriftSpec",
    "HotendSpec",
    "InductiveSpec",
    "Kinematics",
    "MagProbeSpec",
    "MembraneSpec",
    "MeshSpec",
    "NoiseSpec",
    "OozeSpec",
    "PinSpec",
    "Pose",
    "ProbeEvent",
    "SpecError",
    "TextureSpec",
    "Touch",
    "TowerSpec",
    "Truth",
    "World",
    "WorldSpec",
    "make_kinematics",
]
