# For tests: a command BY_HAND that lets a person lower the nozzle with TESTZ, of
# a module that z_touch does not know.

import sys


class ByHand:
    def __init__(self, config):
        self.printer = config.get_printer()
        manual_probe = self.printer.load_object(config, "manual_probe")
        self.module = sys.modules[type(manual_probe).__module__]
        gcode = self.printer.lookup_object("gcode")
        gcode.register_command("BY_HAND", self.cmd_BY_HAND)

    def cmd_BY_HAND(self, gcmd):
        self.module.ManualProbeHelper(self.printer, gcmd, lambda result: None)


def load_config(config):
    return ByHand(config)
