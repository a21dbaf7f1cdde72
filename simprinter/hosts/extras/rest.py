# For tests in file-output mode: REST lets klippy sleep for a second.
#
# In that mode klippy never sleeps by itself and ends without waiting for the
# threads that write, so that its log may lack the last lines.


class Rest:
    def __init__(self, config):
        self.reactor = config.get_printer().get_reactor()
        gcode = config.get_printer().lookup_object("gcode")
        gcode.register_command("REST", self.cmd_REST)

    def cmd_REST(self, gcmd):
        self.reactor.pause(self.reactor.monotonic() + 1.0)


def load_config(config):
    return Rest(config)
