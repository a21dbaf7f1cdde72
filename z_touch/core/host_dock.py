# A [dockable_probe] that is not ours, as a carrier, see carrying.py: Kalico has
# one since 2023-08-27 (b3e67e92b), made of a plugin for Klipper that has the same
# methods.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from . import touching

# What get_probe_state() answers; it may be 0.1 s old.
STATES = {1: "ATTACHED", 2: "DOCKED"}
OLD_ANSWER = 0.11


# None: there is none.  The object is looked up at each use, as the section may
# stand behind the one that asks.
def find(host):
    dockable = host.printer.lookup_object("dockable_probe", None)
    if not hasattr(dockable, "get_probe_state"):
        return None
    return HostDock(host, dockable)


# A dockable probe of the host's own, which fetches and docks by itself
class HostDock:
    def __init__(self, host, dockable):
        self.host = host
        self.dockable = dockable

    @property
    def auto(self):
        return bool(self.dockable.auto_attach_detach)

    # A probe that is pressed looks as if it were docked: it is lifted first.
    def state(self):
        host, dockable = self.host, self.dockable
        z = host.motion.z()
        clear_z = dockable.position_endstop + dockable.sample_retract_dist
        touching.raise_to(host, clear_z, dockable.lift_speed)
        host.toolhead.wait_moves()
        reactor = host.printer.get_reactor()
        reactor.pause(reactor.monotonic() + OLD_ANSWER)
        state = STATES.get(dockable.get_probe_state(), "UNKNOWN")
        if state == "DOCKED" and host.motion.z() != z:
            host.toolhead.manual_move([None, None, z], dockable.lift_speed)
        return state

    def reads(self):
        return "QUERY_DOCKABLE_PROBE"

    # Its way to the dock is as high as the head is; back it may stop short of the
    # place, or stay beside the dock.
    def dock_and_come_back(self):
        host, dockable = self.host, self.dockable
        x, y, z = host.toolhead.get_position()[:3]
        host.gcode.run_script_from_command("DETACH_PROBE")
        self.go_to(x, y, dockable.travel_speed)
        if host.motion.z() != z:
            host.toolhead.manual_move([None, None, z], dockable.lift_speed)

    # Nothing tells whether it was fetched to stay.
    def mark(self):
        return None

    def is_put_on(self, unused_mark, was_docked):
        return was_docked and self.state() != "DOCKED"

    def fetch(self):
        if self.state() != "ATTACHED":
            self.host.gcode.run_script_from_command("ATTACH_PROBE")

    # It docks at once, or not at all.
    def dock_pending(self):
        pass

    def go_to(self, x, y, speed):
        self.host.gcode.run_script_from_command(
            "MOVE_AVOIDING_DOCK X=%.6f Y=%.6f SPEED=%.6f" % (x, y, speed)
        )
        touching.move_xy(self.host, x, y, speed)
