"""What stands between G-code and the motors of Z, and what it adds at a point.

A transform is a bed mesh or a bed tilt, next to the motors, and around it what asks to be
called first: z_thermal_adjust, skew_correction, modules of others.  A touch is a move of
the toolhead and passes all of them by, so what is measured holds no shift, and what is
applied meets one.

Heights are toolhead Z - G-code Z in mm, the G-code offset left out.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
)

if TYPE_CHECKING:
    from .printer import Host

# Transforms that ask nothing but the toolhead; a printer has one of them at most.
INNERMOST = ("bed_mesh", "bed_tilt")

# What follows a temperature: the section, the key of what it adds in its status, and
# its function of a position.  On Kalico there may be several z_thermal_adjust, with names
# of their own; klipper_frame_expansion_comp (a6e0fe0, 2022-09-25) is what it was made of.
HEAT = (
    ("z_thermal_adjust", "current_z_adjust", "calc_adjust"),
    ("frame_expansion_compensation", "current_z_comp", "calc_offset"),
)

# Within this distance (mm) of its zero a bed mesh is as good as zero.
MESH_ZERO_NEAR = 1.0


class Part(NamedTuple):
    """A feature by the name of its section, and what it adds to Z (mm)."""

    name: str
    height: float


class Transforms:
    """The features of the host that shift Z."""

    def __init__(self, host: Host):
        self.host = host
        self.printer = host.printer

    ##################################################################
    # What is added at a point
    ##################################################################

    def parts(
        self, x: float, y: float, z: float, bed_z: Optional[float] = None
    ) -> List[Part]:
        """Return what each known feature adds with the nozzle at x, y, z (mm), 0 included.

        Of a mesh that ends before the point it is what it would be there; 'bed_z' is where
        the probe sees the bed there, its z_offset off (toolhead Z, mm), None: not known.
        """
        parts = [
            Part(name, self.height(x, y, bed_z))
            for name in INNERMOST
            if self.printer.lookup_object(name, None) is not None
        ]
        parts += self._heat(x, y, z)
        parts += self._tools()
        # What follows a temperature has taken it from the sensor anew
        self._refresh()
        return parts

    def height(
        self, x: float, y: float, bed_z: Optional[float] = None
    ) -> float:
        """Return what mesh or tilt adds at x, y: what only a command changes (mm)."""
        mesh = self._mesh()
        tilt = self.printer.lookup_object("bed_tilt", None)
        if self.is_beyond_mesh(x, y):
            return self._beyond_mesh(x, y, bed_z)
        height: float = 0.0
        if mesh is not None:
            height = mesh.calc_z(x, y)
        elif tilt is not None:
            height = x * tilt.x_adjust + y * tilt.y_adjust + tilt.z_adjust
        return height

    def follows_heat(self, part: Part) -> bool:
        """Return whether a part is another one when it is not as hot any more."""
        return any(part.name.split()[0] == section for section, *_ in HEAT)

    def unknown_here(self) -> float:
        """Return what is added where the toolhead stands by what is not known here (mm).

        It may be gone with the next move: exclude_object, a retraction with a lift.
        """
        self._refresh()
        here = self.host.toolhead.get_position()
        known = sum(part.height for part in self._heat_now())
        known += sum(part.height for part in self._tools())
        for name in INNERMOST:
            transform = self.printer.lookup_object(name, None)
            if transform is not None:
                # With its fade, at the height of now
                known += here[2] - transform.get_position()[2]
        return here[2] - self.host.gcode_state.z() - known

    def _refresh(self) -> None:
        """Have the host ask all transforms again where the toolhead is.

        The first time what follows a temperature only takes that from the sensor.
        """
        gcode_move = self.host.gcode_state.gcode_move()
        gcode_move.reset_last_position()
        gcode_move.reset_last_position()

    def _heaters(self) -> Iterator[Tuple[str, Any, str, str]]:
        for section, key, function in HEAT:
            for name, adjuster in self.printer.lookup_objects(section):
                yield name, adjuster, key, function

    def _heat(self, x: float, y: float, z: float) -> Iterator[Part]:
        for name, adjuster, _key, function in self._heaters():
            moved = getattr(adjuster, function)([x, y, z, 0.0])
            yield Part(name, moved[2] - z)

    def _tools(self) -> Iterator[Part]:
        for name, shift in self.host.tools.of_changer():
            yield Part(name, shift)

    def _heat_now(self) -> Iterator[Part]:
        for name, adjuster, key, _function in self._heaters():
            yield Part(name, adjuster.get_status(self.host.eventtime())[key])

    def heat_settings(self) -> Dict[str, Tuple[Any, ...]]:
        """Return what commands set of what follows a temperature, by section.

        Whether it is on, the temperature (degrees C) that it counts from, and mm for each.
        """
        found, eventtime = {}, self.host.eventtime()
        for name, adjuster, _key, _function in self._heaters():
            status = adjuster.get_status(eventtime)
            found[name] = (
                status.get("enabled", getattr(adjuster, "comp_enable", True)),
                status.get(
                    "z_adjust_ref_temperature", status.get("frame_ref_temp")
                ),
                getattr(adjuster, "temp_coeff", None),
            )
        return found

    def heat_moved(self, before: Mapping[str, Tuple[Any, ...]]) -> float:
        """Return by how much (mm) other settings than these have moved Z=0.

        'before' as heat_settings() has returned it.  With both the shift is coefficient *
        (reference - temperature); one that is off stays as it was when it was turned off.
        """
        moved, eventtime = 0.0, self.host.eventtime()
        settings = self.heat_settings()
        for name, adjuster, _key, _function in self._heaters():
            is_on, reference, coefficient = settings[name]
            _, old_reference, old_coefficient = before.get(name, settings[name])
            heat = adjuster.get_status(eventtime).get("temperature")
            if is_on and None not in (heat, reference, coefficient):
                moved += coefficient * (reference - heat)
                moved -= old_coefficient * (old_reference - heat)
        return moved

    ##################################################################
    # The mesh in force
    ##################################################################

    def mesh_name(self) -> str:
        """Return the section that height() is of; a host takes one of them."""
        tilt = self.printer.lookup_object("bed_tilt", None)
        return "bed_mesh" if tilt is None else "bed_tilt"

    def _mesh(self) -> Any:
        """Return the mesh in force, or None."""
        owner = self.printer.lookup_object("bed_mesh", None)
        get_mesh = getattr(owner, "get_mesh", None)
        return get_mesh() if get_mesh else None

    def mesh_heights(self) -> Any:
        """Return what was probed for the mesh in force (mm), rounded; None: there is none."""
        mesh = self._mesh()
        return None if mesh is None else mesh.get_probed_matrix()

    def is_beyond_mesh(self, x: float, y: float) -> bool:
        """Return whether the mesh in force ends before x, y, as an adaptive one may."""
        mesh = self._mesh()
        if mesh is None:
            return False
        owner = self.printer.lookup_object("bed_mesh")
        status = owner.get_status(self.host.eventtime())
        # BED_MESH_OFFSET, and the last point may be rounded off
        moved = getattr(mesh, "mesh_offsets", (0.0, 0.0))
        place = (x + moved[0], y + moved[1])
        ends = zip(status["mesh_min"], place, status["mesh_max"])
        near = MESH_ZERO_NEAR
        return not all(
            low - near <= at <= high + near for low, at, high in ends
        )

    def is_mesh_guessed(self, x: float, y: float) -> bool:
        """Return whether it is not known what the mesh would be there.

        It ends before that point, and its zero is elsewhere.
        """
        has_zero = self.mesh_zero() is not None
        is_there = self.is_mesh_zero(x, y)
        return has_zero and not is_there and self.is_beyond_mesh(x, y)

    def _beyond_mesh(self, x: float, y: float, bed_z: Optional[float]) -> float:
        """Return what a mesh is beyond its rim, where the host goes on with the rim's height.

        But its zero may be there, which was probed besides the mesh; and without a zero its
        heights are what the probe has seen.
        """
        if self.mesh_zero() is None and bed_z is not None:
            return bed_z
        height: float = 0.0
        if not self.is_mesh_zero(x, y):
            height = self._mesh().calc_z(x, y)
        return height

    ##################################################################
    # The zero of the bed mesh
    ##################################################################

    def has_mesh_section(self) -> bool:
        """Return whether a mesh may be probed, or loaded."""
        return self._mesh_calibrate() is not None

    def mesh_zero_option(self) -> str:
        """Return the option of section 'bed_mesh' that says where its zero is."""
        calibrate = self._mesh_calibrate()
        owners = calibrate, getattr(calibrate, "probe_mgr", None)
        is_reference = any(hasattr(owner, "zero_ref_pos") for owner in owners)
        if calibrate is None or is_reference:
            return "zero_reference_position"
        # Until 2023-06-20 (1ad4c0fd6)
        return "relative_reference_index"

    def mesh_zero(self) -> Optional[Tuple[float, float]]:
        """Return the point of the bed (mm) where a mesh is zero, or None."""
        calibrate = self._mesh_calibrate()
        # A part of its own since 2024-06-19 (f2df011c6)
        for owner in (getattr(calibrate, "probe_mgr", None), calibrate):
            zero = getattr(owner, "zero_ref_pos", None)
            if zero is not None:
                return zero[0], zero[1]
        index = getattr(calibrate, "relative_reference_index", None)
        points = getattr(calibrate, "points", ())
        if index is None or not 0 <= index < len(points):
            return None
        return points[index][0], points[index][1]

    def is_mesh_zero(self, x: float, y: float) -> bool:
        """Return whether x, y is where a mesh is zero."""
        zero = self.mesh_zero()
        if zero is None:
            return False
        return math.hypot(x - zero[0], y - zero[1]) <= MESH_ZERO_NEAR

    def _mesh_calibrate(self) -> Any:
        mesh = self.printer.lookup_object("bed_mesh", None)
        return getattr(mesh, "bmc", None)
