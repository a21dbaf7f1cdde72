"""Builds the parts of a world from its specification."""

from __future__ import annotations

import math
import random
from typing import Callable, NamedTuple, Optional, Sequence

from .bed import Bed
from .dock import Keeper
from .lines import Line, Output, PoseLevel
from .ooze import Ooze
from .sensors import TouchState
from .sites import (
    AxisSwitch,
    ContactSensor,
    Growth,
    Poses,
    Site,
    Tracked,
    body_on_pin,
    hanging_on_bed,
    nozzle_on_bed,
    nozzle_on_membrane,
    nozzle_on_pin,
    sensed_bed,
    with_ooze,
)
from .spec import (
    SECOND,
    TOWERS,
    MagProbeSpec,
    MembraneSpec,
    NoiseSpec,
    PinSpec,
    WorldSpec,
)
from .thermal import Drift


class Parts(NamedTuple):
    """The moving parts; `sensors` includes contacts that drive no signal."""

    lines: dict[str, Line]
    outputs: dict[str, Output]
    sensors: tuple[ContactSensor, ...]
    switches: tuple[AxisSwitch, ...]


class _Nozzle(NamedTuple):
    """name: what its sites begin with; growth: mm that it hangs lower."""

    name: str
    carriage: int
    growth: Growth
    ooze: Ooze


class Builder:
    """Collects parts while going through a WorldSpec."""

    def __init__(
        self,
        spec: WorldSpec,
        seed: int,
        bed: Bed,
        drift: Drift,
        ooze: Ooze,
        keepers: Sequence[Keeper],
    ) -> None:
        """keepers: of the detachable probes."""
        self._spec = spec
        self._seed = seed
        self._bed = bed
        self._drift = drift
        self._ooze = ooze
        self._keepers = keepers
        self._lines: dict[str, Line] = {}
        self._outputs: dict[str, Output] = {}
        self._sensors: list[ContactSensor] = []
        self._switches: list[AxisSwitch] = []
        self._nozzles = [_Nozzle("nozzle", 0, drift.nozzle, ooze)]
        if spec.second_carriage is not None:
            # Always cold and clean
            self._nozzles.append(
                _Nozzle("second_nozzle", 1, lambda t: 0.0, Ooze(None))
            )
        # Whether each membrane switch lies there, by its signal
        self.laid = {part.signal: part.laid for part in spec.membranes()}

    def build(self) -> Parts:
        """All parts."""
        spec = self._spec
        self._axis_switches()
        self._plate()
        for pin in spec.pins():
            self._pin(pin)
        for keeper in self._keepers:
            self._mag_probe(keeper.spec, keeper)
        self._inductive()
        for membrane in spec.membranes():
            self._membrane(membrane)
        return Parts(
            self._lines,
            self._outputs,
            tuple(self._sensors),
            tuple(self._switches),
        )

    def _state(
        self, signal: str, noise: NoiseSpec, play: float = 0.0
    ) -> TouchState:
        # A sequence of its own for each signal: more touches on one do not
        # move the numbers of another.  A text seeds alike in every process.
        generators = (
            random.Random(f"{self._seed}/{signal}"),
            random.Random(f"{self._seed}/{signal}/play"),
        )
        return TouchState(noise, *generators, play)

    def _sensor(
        self, signal: str, noise: NoiseSpec, *sites: Site
    ) -> ContactSensor:
        state = self._state(signal, noise, self._spec.z_play)
        sensor = ContactSensor(sites, state, self._drift)
        self._sensors.append(sensor)
        return sensor

    def _switch(self, signal: str, noise: NoiseSpec, *sites: Site) -> None:
        """What these sites press, and the signal that it drives."""
        sensor = self._sensor(signal, noise, *sites)
        self._line(signal, sensor.level, sensor.state, noise, sensor.sites)

    def _line(
        self,
        signal: str,
        level: PoseLevel,
        state: Optional[TouchState] = None,
        noise: Optional[NoiseSpec] = None,
        sites: Sequence[Tracked] = (),
    ) -> None:
        latency = 0.0 if noise is None else noise.latency
        self._lines[signal] = Line(signal, level, state, latency, sites)

    def _axis_switches(self) -> None:
        for spec in self._spec.switches:
            play = self._spec.z_play if spec.axis == "z" else 0.0
            state = self._state(spec.signal, spec.noise, play)
            carriage = int(spec.axis == SECOND)
            switch = AxisSwitch(
                spec, state, self._place_on(spec.axis), carriage
            )
            self._switches.append(switch)
            self._line(
                spec.signal,
                lambda t, poses, switch=switch: switch.level(poses),
                switch.state,
                spec.noise,
                [switch.site],
            )

    def _place_on(self, axis: str) -> Callable[[Poses], float]:
        """From poses to the place on an axis, or on a tower of a delta."""
        if axis == SECOND:
            return lambda poses: poses[1][0]
        if axis not in TOWERS:
            index = "xyz".index(axis)
            return lambda poses: poses[0][index]
        for tower in self._spec.towers:
            if tower.name == axis:
                return lambda poses: tower.place(poses[0])
        raise ValueError(f"switches: no tower {axis} in this world")

    def _plate(self) -> None:
        """The nozzles on the plate, with or without a sensor below."""
        spec, bed = self._spec, self._bed
        sensor_spec = spec.bed_sensor
        sites = []
        for name, carriage, growth, ooze in self._nozzles:
            met = nozzle_on_bed(bed, self._drift, growth)
            top, depth, allowed = bed.highest, 0.0, spec.bed.allowed_press
            if sensor_spec is not None:
                met, top = with_ooze(met, ooze), top + ooze.highest
                depth, allowed = sensor_spec.press_depth, spec.overtravel
            sites.append(
                Site(f"{name}_bed", met, top, depth, carriage=carriage)
            )
            sites[-1].limit(allowed, spec.allowed_drag)
        if sensor_spec is None:
            self._sensor("", NoiseSpec(), *sites)
            return
        noise = sensor_spec.noise
        sensor = self._sensor("bed_sensor", noise, *sites)
        level: PoseLevel = sensor.level
        if sensor_spec.enable_output:
            enable = self._outputs["bed_sensor_enable"] = Output()
            level = _while_on(enable, level)
        self._line("bed_sensor", level, sensor.state, noise, sensor.sites)

    def _pin(self, pin: PinSpec) -> None:
        """Pressed by a tip or by the probe's body."""
        top, name = pin.z + pin.pretravel, self._name_of(pin)
        sites = [
            Site(
                f"{nozzle.name}_{name}",
                nozzle_on_pin(pin, self._drift, nozzle.growth, nozzle.ooze),
                top + nozzle.ooze.highest,
                pin.pretravel,
                carriage=nozzle.carriage,
            )
            for nozzle in self._nozzles
        ]
        for keeper in self._keepers:
            probe = keeper.spec
            sites.append(
                Site(
                    f"{self._prefix(probe)}body_{name}",
                    body_on_pin(pin, probe, self._drift, keeper.seat),
                    top + probe.body_drop + keeper.lowest,
                    pin.pretravel,
                    keeper.held,
                    int(probe.on_second),
                )
            )
        for site in sites:
            site.limit(
                self._spec.overtravel, self._spec.allowed_drag, pin.pin_travel
            )
        self._switch(pin.signal, pin.noise, *sites)

    def _name_of(self, pin: PinSpec) -> str:
        """What its sites are called by: the first is the pin."""
        return "pin" if pin is self._spec.pin else pin.signal

    def _prefix(self, probe: MagProbeSpec) -> str:
        """What sites of its body are called by: those of the first have none."""
        return "" if probe is self._spec.mag_probe else f"{probe.signal}_"

    def _mag_probe(self, probe: MagProbeSpec, keeper: Keeper) -> None:
        """Plunger and body on the plate, senses, attaching output."""
        bed, drag = self._bed, self._spec.allowed_drag
        carriage, prefix = int(probe.on_second), self._prefix(probe)
        is_first = not prefix
        plunger = probe.switch_offset + probe.pretravel
        body_top = bed.highest + probe.body_drop + keeper.lowest
        seat = keeper.seat
        contact = hanging_on_bed(bed, self._drift, probe, plunger, seat)
        tip = Site(
            "probe_bed" if is_first else f"{probe.signal}_bed",
            contact,
            body_top + plunger,
            probe.pretravel,
            keeper.held,
            carriage,
        )
        # How deep the plunger may go is what the body on the bed is about
        tip.limit(math.inf, drag)
        sites = [tip]
        for pin in self._spec.pins() if probe.plunger_on_pin else ():
            pressed = body_on_pin(pin, probe, self._drift, seat)
            top = pin.z + pin.pretravel + probe.body_drop + keeper.lowest
            name = f"{prefix}plunger_{self._name_of(pin)}"
            sites.append(Site(name, pressed, top, 0.0, keeper.held, carriage))
            sites[-1].limit(math.inf, drag)
        sensor = self._sensor(probe.signal, probe.noise, *sites)
        contact = hanging_on_bed(bed, self._drift, probe, 0.0, seat)
        body = Site(
            f"{prefix}body_bed",
            contact,
            body_top,
            held=keeper.held,
            carriage=carriage,
        )
        body.limit(0.0, drag)
        self._sensor("", NoiseSpec(), body)

        def is_there(t: float, poses: Poses) -> bool:
            return keeper.connected(t, poses[carriage])

        def level(t: float, poses: Poses) -> bool:
            if probe.normally_open:
                return is_there(t, poses) and sensor.level(t, poses)
            # Normally closed: asserted as well when it is not there
            return not is_there(t, poses) or sensor.level(t, poses)

        self._line(probe.signal, level, sensor.state, probe.noise, sensor.sites)
        if probe.mode == "output":
            self._outputs[attach_output(probe)] = Output()
        if keeper.swing is not None:
            name = "dock_swing" if is_first else f"{probe.signal}_dock_swing"
            self._outputs[name] = keeper.swing
        if not is_first:
            return
        if self._spec.probe_sense:
            self._line("probe_sense", is_there)
        if self._spec.dock_sense:
            self._line(
                "dock_sense",
                lambda t, poses: keeper.in_dock(t, poses[carriage]),
            )

    def _inductive(self) -> None:
        spec, bed = self._spec.inductive, self._bed
        if spec is None:
            return
        sensed = sensed_bed(bed, self._drift, spec)
        # Nothing is touched: no limits
        plate = self._spec.bed
        reach_x = max(abs(plate.x_min), abs(plate.x_max)) + abs(spec.x_offset)
        reach_y = max(abs(plate.y_min), abs(plate.y_max)) + abs(spec.y_offset)
        roll = (abs(spec.twist) + abs(spec.bend) * reach_x) * reach_x
        roll += abs(spec.twist_y) * reach_y
        top = bed.highest + spec.sense_distance + roll
        site = Site("inductive_bed", sensed, top)
        self._switch(spec.signal, spec.noise, site)

    def _membrane(self, spec: MembraneSpec) -> None:
        bed, signal = self._bed, spec.signal
        what = "membrane" if spec is self._spec.membrane else signal
        sites = []
        for name, carriage, growth, ooze in self._nozzles:
            met = nozzle_on_membrane(
                bed, self._drift, growth, spec, lambda: self.laid[signal]
            )
            top = bed.highest + spec.thickness + ooze.highest
            sites.append(
                Site(
                    f"{name}_{what}",
                    with_ooze(met, ooze),
                    top,
                    spec.press,
                    carriage=carriage,
                )
            )
            sites[-1].limit(self._spec.overtravel, self._spec.allowed_drag)
        self._switch(signal, spec.noise, *sites)


def attach_output(probe: MagProbeSpec) -> str:
    """The output that attaches it, of mode "output"."""
    return f"{probe.signal}_attach"


def _while_on(enable: Output, level: PoseLevel) -> PoseLevel:
    """A sensor that answers only while its output is on."""
    return lambda t, poses: enable.on(t) and level(t, poses)
