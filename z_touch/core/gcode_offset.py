# The G-code Z offset: what the sections set in the end.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3


# The offset (mm) that SET_GCODE_OFFSET and baby steps change; where it is larger,
# the nozzle is higher.
class GcodeOffset:
    # 'host': host.Host
    def __init__(self, host):
        self.host = host

    def _gcode_move(self):
        return self.host.printer.lookup_object("gcode_move")

    # The one in force
    def z(self):
        status = self._gcode_move().get_status(self.host.eventtime())
        return status["homing_origin"][2]

    # Absolute, so that it replaces any earlier offset.  The command's own
    # method: a macro of that name may add to it, store it or move.
    def set(self, z_offset):
        params = {"Z": "%.6f" % (z_offset,), "MOVE": "0"}
        name = "SET_GCODE_OFFSET"
        line = "%s Z=%s MOVE=0" % (name, params["Z"])
        gcmd = self.host.gcode.create_gcode_command(name, line, params)
        self._gcode_move().cmd_SET_GCODE_OFFSET(gcmd)

    # Sets it, unless it is that already
    def replace(self, z_offset):
        if self.z() != z_offset:
            self.set(z_offset)
