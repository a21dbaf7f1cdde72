# What stands between G-code and the motors of Z: what shifts it at a point, and
# what G-code has set for a while.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#   G1 Z -> + G-code offset, + what G92 has moved -> transforms -> toolhead Z
#
# A transform is a bed mesh or a bed tilt, next to the motors, and around it what
# asks to be called first: z_thermal_adjust, skew_correction, modules of others.
# A touch is a move of the toolhead and passes all of them by, so that what is
# measured holds no shift, and what is applied meets one.

import collections
import contextlib
import math

# A feature by the name of its section, and what it adds to Z (mm)
Part = collections.namedtuple("Part", "name height")

# Whether G1 has absolute coordinates, and an absolute extruder, and how fast it is
# where it has no F (mm/min)
Modes = collections.namedtuple("Modes", "absolute absolute_extrude speed")

# Transforms that ask nobody but the toolhead; a printer has one of them at most.
INNERMOST = ("bed_mesh", "bed_tilt")
# On Kalico there may be several, with names of their own
HEAT = "z_thermal_adjust"

# Within this distance (mm) of its zero a bed mesh is as good as zero.
MESH_ZERO_NEAR = 1.0

# Of a saved state of G-code, what holds the G-code offset
POSITIONS = ("homing_position", "base_position")


# The features of the host, as far as they shift Z
class Features:
    # 'host': host.Host
    def __init__(self, host):
        self.host = host
        self.printer = host.printer

    def _gcode_move(self):
        return self.printer.lookup_object("gcode_move")

    def _status(self):
        return self._gcode_move().get_status(self.host.eventtime())

    ##################################################################
    # What shifts Z at a point
    ##################################################################

    # toolhead Z - G-code Z (mm), the G-code offset left out, with the head at x, y, z
    # (toolhead, mm).  parts() and rest() are for a command that moves nothing
    # meanwhile; get_status() has height().  Of a mesh that ends before the point it is
    # what it would be there, see _beyond_mesh(); 'bed_z': where the probe sees the bed
    # there, its z_offset off (toolhead Z, mm), None: nobody knows.

    # What each feature that is known shifts there, 0 included
    def parts(self, x, y, z, bed_z=None):
        parts = self._look(x, y, z)[1]
        if not self.is_beyond_mesh(x, y):
            return parts
        return [
            part._replace(height=self._beyond_mesh(x, y, bed_z))
            if part.name in INNERMOST
            else part
            for part in parts
        ]

    # What is shifted there besides, by whatever it may be (mm).  It may be gone
    # with the next move: exclude_object, a retraction with a lift.
    def rest(self, x, y, z):
        gcode_z, parts = self._look(x, y, z)
        return z - gcode_z - sum(part.height for part in parts)

    # Of the mesh and the tilt (mm): what nothing but a command changes
    def height(self, x, y, bed_z=None):
        mesh = self._mesh()
        tilt = self.printer.lookup_object("bed_tilt", None)
        if self.is_beyond_mesh(x, y):
            return self._beyond_mesh(x, y, bed_z)
        if mesh is not None:
            return mesh.calc_z(x, y)
        if tilt is not None:
            return x * tilt.x_adjust + y * tilt.y_adjust + tilt.z_adjust
        return 0.0

    # The section that it is of; a host takes one of them
    def mesh_name(self):
        tilt = self.printer.lookup_object("bed_tilt", None)
        return "bed_mesh" if tilt is None else "bed_tilt"

    # The mesh in force, or None
    def _mesh(self):
        owner = self.printer.lookup_object("bed_mesh", None)
        get_mesh = getattr(owner, "get_mesh", None)
        return get_mesh() if get_mesh else None

    # What was probed for the mesh in force (mm), rounded; None: there is none
    def mesh_heights(self):
        mesh = self._mesh()
        return None if mesh is None else mesh.get_probed_matrix()

    # Whether the mesh ends before that point, as an adaptive one may
    def is_beyond_mesh(self, x, y):
        if self._mesh() is None:
            return False
        owner = self.printer.lookup_object("bed_mesh")
        status = owner.get_status(self.host.eventtime())
        # BED_MESH_OFFSET, and the last point may be rounded off
        moved = getattr(self._mesh(), "mesh_offsets", (0.0, 0.0))
        place = (x + moved[0], y + moved[1])
        ends = zip(status["mesh_min"], place, status["mesh_max"])
        near = MESH_ZERO_NEAR
        return not all(
            low - near <= at <= high + near for low, at, high in ends
        )

    # Whether nobody knows what it would be there: its zero is elsewhere
    def is_mesh_guessed(self, x, y):
        has_zero = self.mesh_zero() is not None
        is_there = self.is_mesh_zero(x, y)
        return has_zero and not is_there and self.is_beyond_mesh(x, y)

    # There the host goes on with the height of its rim.  But its zero may be there,
    # which was probed then besides the mesh; and without a zero its heights are what
    # the probe has seen.
    def _beyond_mesh(self, x, y, bed_z):
        zero = self.mesh_zero()
        if zero is None and bed_z is not None:
            return bed_z
        return 0.0 if self.is_mesh_zero(x, y) else self._mesh().calc_z(x, y)

    # G-code Z (mm) there, and the parts of its shift
    def _look(self, x, y, z):
        gcode_move = self._gcode_move()
        if gcode_move.move_transform is None:
            return z, []
        with self._as_if_at(x, y, z):
            # The first time heat is only taken from the sensor
            gcode_move.position_with_transform()
            position = gcode_move.position_with_transform()
            parts = list(self._innermost(z)) + list(self._heat())
        # A gradient of Kalico's mixing_extruder has no position
        return position[2] if position else z - sum(
            p.height for p in parts
        ), parts

    def _innermost(self, z):
        for name in INNERMOST:
            transform = self.printer.lookup_object(name, None)
            if transform is not None:
                yield Part(name, z - transform.get_position()[2])

    def _heat(self):
        for name, adjuster in self.printer.lookup_objects(HEAT):
            status = adjuster.get_status(self.host.eventtime())
            yield Part(name, status["current_z_adjust"])

    # What commands set of it, by the names of its sections: whether it is on, the
    # temperature (degrees C) that it counts from, and mm for each
    def heat_settings(self):
        found, eventtime = {}, self.host.eventtime()
        for name, adjuster in self.printer.lookup_objects(HEAT):
            status = adjuster.get_status(eventtime)
            found[name] = (
                status.get("enabled", True),
                status.get("z_adjust_ref_temperature"),
                getattr(adjuster, "temp_coeff", None),
            )
        return found

    # No host says what a transform does elsewhere.  But each asks the toolhead where
    # it is, or the next one, so the answer is another one for a moment in which
    # nothing else runs.  After it everybody looks again at where the head is.
    @contextlib.contextmanager
    def _as_if_at(self, x, y, z):
        toolhead, name = self.host.toolhead, "get_position"
        position = [x, y, z] + list(toolhead.get_position())[3:]
        replaced = vars(toolhead).get(name)
        setattr(toolhead, name, lambda: list(position))
        try:
            yield
        finally:
            delattr(toolhead, name)
            if replaced is not None:
                setattr(toolhead, name, replaced)
            self._gcode_move().reset_last_position()

    ##################################################################
    # The zero of the bed mesh
    ##################################################################

    # Whether a mesh may be probed, or loaded
    def has_mesh_section(self):
        return self._mesh_calibrate() is not None

    # The option of section 'bed_mesh' that says where it is
    def mesh_zero_option(self):
        calibrate = self._mesh_calibrate()
        if calibrate is None or self._has_zero_reference(calibrate):
            return "zero_reference_position"
        # Until 2023-06-20 (1ad4c0fd6)
        return "relative_reference_index"

    # That point of the bed (mm), or None
    def mesh_zero(self):
        calibrate = self._mesh_calibrate()
        # A part of its own since 2024-06-19 (f2df011c6)
        for owner in (getattr(calibrate, "probe_mgr", None), calibrate):
            if getattr(owner, "zero_ref_pos", None) is not None:
                return tuple(owner.zero_ref_pos)[:2]
        index = getattr(calibrate, "relative_reference_index", None)
        points = getattr(calibrate, "points", ())
        if index is None or not 0 <= index < len(points):
            return None
        return tuple(points[index])[:2]

    def is_mesh_zero(self, x, y):
        zero = self.mesh_zero()
        if zero is None:
            return False
        return math.hypot(x - zero[0], y - zero[1]) <= MESH_ZERO_NEAR

    def _mesh_calibrate(self):
        mesh = self.printer.lookup_object("bed_mesh", None)
        return getattr(mesh, "bmc", None)

    def _has_zero_reference(self, calibrate):
        owners = calibrate, getattr(calibrate, "probe_mgr", None)
        return any(hasattr(owner, "zero_ref_pos") for owner in owners)

    ##################################################################
    # What G-code has set
    ##################################################################

    # The Z of G-code as it is (mm), the G-code offset included and transforms
    # taken off: where the nozzle would be without any.
    def z(self):
        return self._status()["position"][2]

    # How far G92 has moved Z=0 up (mm), which is no part of the G-code offset
    def moved_by_g92(self):
        status = self._status()
        moved = status["position"][2] - status["gcode_position"][2]
        return moved - status["homing_origin"][2]

    # As homing does, from 'least' (mm) on.  Returns what the user is told of it;
    # empty: there was none.
    def undo_g92(self, least):
        moved = self.moved_by_g92()
        if abs(moved) < least:
            return ""
        status = self._status()
        z = status["position"][2] - status["homing_origin"][2]
        self._call("G92", Z="%.6f" % (z,))
        return "G92 had moved Z=0 by %.3f mm: undone, as G28 does" % (moved,)

    def modes(self):
        status = self._status()
        return Modes(
            status["absolute_coordinates"],
            status["absolute_extrude"],
            status["speed"],
        )

    def set_modes(self, modes):
        current = self.modes()
        if current.absolute != modes.absolute:
            self._call("G90" if modes.absolute else "G91")
        if current.absolute_extrude != modes.absolute_extrude:
            self._call("M82" if modes.absolute_extrude else "M83")
        if current.speed != modes.speed:
            self._call("G1", F="%.6f" % (modes.speed,))

    # The command's own method: a macro of that name may do anything.
    def _call(self, name, **params):
        line = " ".join([name] + ["%s%s" % item for item in params.items()])
        gcmd = self.host.gcode.create_gcode_command(name, line, params)
        getattr(self._gcode_move(), "cmd_" + name)(gcmd)

    # While this lasts the G-code Z offset is 0, that of each saved state, too: what
    # is restored meanwhile brings no offset with it.  Afterwards it is as before,
    # and so are those that nobody has saved anew.
    @contextlib.contextmanager
    def without_offset(self):
        before = self.host.gcode_offset.z()
        kept = [
            (state, {name: list(state[name]) for name in POSITIONS})
            for state in self._gcode_move().saved_states.values()
        ]
        for state, positions in kept:
            state.update(lowered(positions))
        self.host.gcode_offset.replace(0.0)
        try:
            yield
        finally:
            for state, positions in kept:
                state.update(positions)
            if not self.printer.is_shutdown():
                self.host.gcode_offset.replace(before)


# Without the G-code Z offset that they hold
def lowered(positions):
    z_offset = positions["homing_position"][2]
    return {
        name: list(p[:2]) + [p[2] - z_offset] + list(p[3:])
        for name, p in positions.items()
    }
