"""Printers as they are at home: noise, texture and slow drift.

What is not marked was measured by owners, most of it with a Klicky on a Voron:

- A switch varies by 1.0 to 1.6 um (1 sigma) from touch to touch, and with one bad
  touch among ten by 27.5 um: logs of Klicky, pastebin PSCi2P9r, yJreuDda,
  kcW7GBzq. Such a touch was one of forty in logs that owners had reasons to
  post; here it is one of two hundred [estimate].
- A nozzle that presses something by itself varies by 1.8 um, and so the piezo
  bed: README of jniebuhr/adxl345-probe.
- An inductive probe varies from touch to touch as a switch does [estimate].
- Neighbours on a grid of 1 mm on textured PEI are up to 0.1 mm apart: RatOS's page
  on Beacon's true zero.
- In twenty CALIBRATE_Z in a row after switching on, the height of the nozzle rose
  by 34 um, of the bed by 23, of the probe's body on the pin by 10, and stood from
  the thirteenth on, some ten minutes later: the plot in pull request 9 of
  protoloft/klipper_z_calibration, 2021. How the parts share that [estimate]: pin
  and body 5 each, the plate 18, the nozzle 29.
- A nozzle is longer by 0.0465 mm per 100 C: regression of touches with a load cell,
  pull request 6855 of Klipper, 2025. Others have 0.094 (Marlin, issue 17092) and
  some 0.033 (OrcaSlicer, pull request 14030). How far it is behind its
  thermistor is said nowhere: 20 s [estimate].
- A probe that is attached again hangs within 2 um of where it was: that plot has
  2 um for its body on the pin, everything included.
"""

from __future__ import annotations

import random
from dataclasses import replace

from .scene import S
from .world import (
    BedSpec,
    DriftSpec,
    HotendSpec,
    MeshSpec,
    NoiseSpec,
)

# mm, of one touch
SWITCH = 0.0014
NOZZLE_SENSOR = 0.0018
# mm, of one attaching
RESEAT = 0.002
# Positive triggers too high
OUTLIER = 0.0275
OUTLIER_CHANCE = 0.005
# mm by which neighbours may differ, and how far apart they are
TEXTURE = 0.1
GRID = 1.0
# mm by which parts have grown in the end, and seconds in which most of that is done
GROWN = {"nozzle": 0.029, "pin": 0.005, "bed": 0.018, "body": 0.005}
WARM_UP = 240.0
# mm per 100 C by which the nozzle is longer, and seconds behind its thermistor
LONGER = 0.0465
BEHIND = 20.0


def noisy(noise: NoiseSpec, sigma: float, with_outliers: bool) -> NoiseSpec:
    """The same with what differs from touch to touch."""
    if not with_outliers:
        return replace(noise, sigma=sigma)
    chance, size = OUTLIER_CHANCE, OUTLIER
    return replace(noise, sigma=sigma, outlier_chance=chance, outlier_size=size)


def textured(bed: BedSpec, seed: int) -> BedSpec:
    """The same with a rough plate, unless it has a shape already."""
    if bed.mesh is not None:
        return bed
    draw = random.Random(f"{seed}/texture")
    columns = round((bed.x_max - bed.x_min) / GRID) + 1
    rows = round((bed.y_max - bed.y_min) / GRID) + 1
    half = TEXTURE / 2
    heights = tuple(
        tuple(draw.uniform(-half, half) for _ in range(columns))
        for _ in range(rows)
    )
    mesh = MeshSpec(bed.x_min, bed.y_min, bed.x_max, bed.y_max, heights)
    return replace(bed, mesh=mesh)


def warming_up() -> DriftSpec:
    """All that grows after switching on."""
    rates = {part: mm / WARM_UP for part, mm in GROWN.items()}
    return DriftSpec(**rates, tau=WARM_UP)


def hotend() -> HotendSpec:
    """A nozzle that is longer when it is hot; no part of as_real()."""
    return HotendSpec(LONGER, BEHIND)


def as_real(scene: S, seed: int = 0) -> S:
    """The same machine as it is at home. seed: of its plate."""
    world = scene.world
    changes: dict[str, object] = {
        "bed": textured(world.bed, seed),
        "drift": warming_up(),
    }
    switches = {"pin": True, "mag_probe": True, "inductive": False}
    for name, with_outliers in switches.items():
        part = getattr(world, name)
        if part is not None:
            noise = noisy(part.noise, SWITCH, with_outliers)
            changes[name] = replace(part, noise=noise)
    for name in ("bed_sensor", "membrane"):
        part = getattr(world, name)
        if part is not None:
            noise = noisy(part.noise, NOZZLE_SENSOR, False)
            changes[name] = replace(part, noise=noise)
    changes["more_pins"] = tuple(
        replace(pin, noise=noisy(pin.noise, SWITCH, True))
        for pin in world.more_pins
    )
    changes["more_membranes"] = tuple(
        replace(part, noise=noisy(part.noise, NOZZLE_SENSOR, False))
        for part in world.more_membranes
    )
    probe = world.mag_probe
    if probe is not None and probe.mode != "fixed":
        changed = changes["mag_probe"]
        changes["mag_probe"] = replace(changed, reseat=RESEAT)
    return scene.with_world(**changes)
