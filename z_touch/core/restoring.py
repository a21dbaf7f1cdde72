# Saved states of G-code that bring another G-code Z offset back.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .baby_steps import LARGEST_STEP, NO_STEP

# RESUME sends it, too
COMMAND = "RESTORE_GCODE_STATE"


# The states that are saved now, by their names; saved anew each is another one.
def saved(host):
    return dict(host.printer.lookup_object("gcode_move").saved_states)


# Tells when an offset that was applied has gone so.  While klippy starts.
#
#   source    the command that applies one
#   applied() the offset (mm) that it has left, None: there is none
#   restored(name, z_offset) is called for each that has come back (mm), or None
#
# A baby step that is taken back so is none that has gone: Klipper's RESUME does that.
def watch(host, source, applied, restored=None):
    def around(command, gcmd):
        before, ours = host.gcode_offset.z(), applied()
        command(gcmd)
        after, name = host.gcode_offset.z(), gcmd.get("NAME", "default")
        if abs(after - before) < NO_STEP:
            return
        if restored is not None:
            restored(name, after)
        is_gone = ours is not None and abs(after - ours) >= NO_STEP
        if is_gone and abs(before - ours) <= LARGEST_STEP:
            host.say(
                "G-code state %s has brought back the G-code Z offset %.3f; it"
                " was %.3f, from %s; set that again, and save such a state"
                " after it" % (name, after, before, source)
            )

    host.wrap_command(COMMAND, around)
