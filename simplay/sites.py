"""What meets what at each site of a machine, in words and for pictures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from simprinter.world import WorldSpec


class Met(NamedTuple):
    """Of one site: what comes from above, what it meets, and the signal.

    upper, lower: in words. presser: nozzle, body, plunger or coil; whose: the
    number of its carriage, or of its probe. on: pin, membrane or bed; which: its
    number. signal: empty where nothing is told.
    """

    upper: str
    lower: str
    presser: str
    whose: int
    on: str
    which: int
    signal: str


def sites_of(world: WorldSpec) -> dict[str, Met]:
    """All sites of a machine but the switches of its axes, by their names."""
    return dict(_sites_of(world))


def _sites_of(world: WorldSpec) -> Iterator[tuple[str, Met]]:
    nozzles = ["nozzle"]
    if world.second_carriage is not None:
        nozzles.append("second nozzle")
    pressed = "" if world.bed_sensor is None else "bed_sensor"
    for i, nozzle in enumerate(nozzles):
        name = nozzle.replace(" ", "_")
        met = Met(nozzle, "bed", "nozzle", i, "bed", 0, pressed)
        yield f"{name}_bed", met
        for j, pin in enumerate(world.pins()):
            what, lower = _named("pin", pin.signal, pin is world.pin)
            yield (
                f"{name}_{what}",
                Met(nozzle, lower, "nozzle", i, "pin", j, pin.signal),
            )
        for j, part in enumerate(world.membranes()):
            is_first = part is world.membrane
            what, lower = _named("membrane", part.signal, is_first)
            yield (
                f"{name}_{what}",
                Met(nozzle, lower, "nozzle", i, "membrane", j, part.signal),
            )
    yield from _sites_of_probes(world)
    if world.inductive is not None:
        met = Met("sensing range", "bed", "coil", 0, "bed", 0, "")
        yield "inductive_bed", met._replace(signal=world.inductive.signal)


def _sites_of_probes(world: WorldSpec) -> Iterator[tuple[str, Met]]:
    for i, probe in enumerate(world.probes()):
        is_first = probe is world.mag_probe
        start = "" if is_first else f"{probe.signal}_"
        of = "" if is_first else f" of {probe.signal}"
        body, plunger = f"probe's body{of}", f"plunger{of}"
        yield (
            "probe_bed" if is_first else f"{probe.signal}_bed",
            Met(plunger, "bed", "plunger", i, "bed", 0, probe.signal),
        )
        yield f"{start}body_bed", Met(body, "bed", "body", i, "bed", 0, "")
        for j, pin in enumerate(world.pins()):
            what, lower = _named("pin", pin.signal, pin is world.pin)
            met = Met(body, lower, "body", i, "pin", j, pin.signal)
            yield f"{start}body_{what}", met
            if probe.plunger_on_pin:
                met = met._replace(upper=plunger, lower=f"{lower}'s housing")
                met = met._replace(presser="plunger", signal=probe.signal)
                yield f"{start}plunger_{what}", met


def _named(what: str, signal: str, is_first: bool) -> tuple[str, str]:
    """In the site's name, and in words."""
    return (what, what) if is_first else (signal, f"{what} {signal}")


def told(site: str, world: WorldSpec) -> str:
    """A site in words, such as "nozzle on the pin"."""
    met = sites_of(world).get(site)
    if met is not None:
        if met.presser == "coil":
            return "probe senses the bed"
        upper = met.upper.replace("probe's body", "probe body")
        if met.on == "bed":
            # Nothing stops a body there, and nothing tells
            upper = upper.replace("body", "BODY").replace("plunger", "probe")
        return f"{upper} on the {met.lower}"
    if site == "carriages":
        return "carriage in the other"
    if site == "dock" or site.endswith("_dock"):
        return "head in the dock"
    for switch in world.switches:
        if switch.signal == site and site == f"{switch.axis}_endstop":
            return f"{switch.axis.upper()} endstop"
    return site
