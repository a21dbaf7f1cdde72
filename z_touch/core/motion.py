# Moves that the host has no method for, or not the same one everywhere.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
import sys

# How every host since 2021-08-17 (1dc2ab048) begins the error of a probing move
# that has reached its end
NO_TRIGGER = "No trigger"
# How the error begins where boards did not hear of each other in time, or one is gone
NOT_HEARD = ("Communication timeout during", "Unable to obtain")


def has_no_trigger(error):
    return NO_TRIGGER in str(error)


def was_not_heard(error):
    return any(words in str(error) for words in NOT_HEARD)


# Axes have letters since 2025-01-21 (4aa550837), numbers before; for eleven days a
# host that can forget a homed axis counted them still.  Those that count ask
# whether theirs is in it, those with letters go through it.
class _AxisZ(str):
    def __contains__(self, axis):
        return axis in (2, "z")


# Down to a toolhead Z (mm) where nothing should be yet, at a speed (mm/s)
Way = collections.namedtuple("Way", "z speed")


# The toolhead as a homing move sees it: it goes a Way first, and on from there as it is
# told.  After an armed move that ends without a trigger hosts wait for the board's
# next report and then begin anew, 0.35 to 0.55 s; within one they begin after 0.15 s.
class _OnItsWay:
    def __init__(self, toolhead, way):
        self._toolhead = toolhead
        self._way = way

    def __getattr__(self, name):
        return getattr(self._toolhead, name)

    def drip_move(self, target, speed, completion):
        way_end = target[:2] + [self._way.z] + target[3:]
        self._toolhead.drip_move(way_end, self._way.speed, completion)
        if not completion.test():
            self._toolhead.drip_move(target, speed, completion)


# The moves of the head in Z: toolhead coordinates (mm), mm/s
class Motion:
    # 'host': host.Host, which is connected later
    def __init__(self, host):
        self.host = host
        self.printer = host.printer

    # Where the head is, or will be when the moves have ended
    def z(self):
        return self.host.toolhead.get_position()[2]

    # A probing move first waits for the moves before it, and hosts may wait for
    # ever for its trigger where the printer was shut down meanwhile; whoever
    # sends FIRMWARE_RESTART then waits with them.  So wait here, and look.
    def require_running(self):
        self.host.toolhead.flush_step_generation()
        if self.printer.is_shutdown():
            raise self.printer.command_error(
                "Touch not begun due to printer shutdown"
            )

    # Down to z or to where the endstop triggers; returns the toolhead Z of the
    # trigger.  The head stops a little lower and stays there.
    def probing_move(self, endstop, z, speed):
        self.require_running()
        target = self.host.toolhead.get_position()
        target[2] = z
        # A method of the host since 2021-03-29 (862d3f963)
        homing = self.printer.lookup_object("homing")
        return homing.probing_move(endstop, target, speed)[2]

    # The host's own kind of homing moves, which takes any toolhead since the same day
    # (37a263c0b); None: somebody has put his own in their place
    def _homing_moves(self):
        homing = self.printer.lookup_object("homing")
        module = sys.modules.get(homing.__class__.__module__)
        return getattr(module, "HomingMove", None)

    # Whether probing_move_after() is to be had
    def can_join(self):
        return self._homing_moves() is not None

    # A probing move after a Way, in one that is armed from its beginning on: the
    # trigger may be on the Way, too.
    def probing_move_after(self, way, endstop, z, speed):
        self.require_running()
        toolhead = _OnItsWay(self.host.toolhead, way)
        target = toolhead.get_position()
        target[2] = z
        endstops = [(endstop, "probe")]
        move = self._homing_moves()(self.printer, endstops, toolhead)
        trigger_z = move.homing_move(target, speed, probe_pos=True)[2]
        if move.check_no_movement() is not None:
            raise self.printer.command_error(
                "Probe triggered prior to movement"
            )
        return trigger_z

    # Z up by a distance (mm) where nobody knows where it is, and still nobody
    # does then.
    def lift_unhomed(self, distance, speed):
        toolhead = self.host.toolhead
        kinematics = toolhead.get_kinematics()
        can_clear = hasattr(kinematics, "clear_homing_state")
        position = toolhead.get_position()
        position[2] = 0.0
        z_axis = _AxisZ("z") if can_clear else (2,)
        toolhead.set_position(position, homing_axes=z_axis)
        try:
            toolhead.manual_move([None, None, distance], speed)
        finally:
            if can_clear:
                kinematics.clear_homing_state(z_axis)
            elif hasattr(kinematics, "note_z_not_homed"):
                kinematics.note_z_not_homed()
