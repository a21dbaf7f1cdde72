# For tests: a [tool NAME] as klipper-toolchanger has them, as far as others ask it.
# FETCH_TOOL makes the last one the active tool.


class Tool:
    def __init__(self, config):
        self.gcode_z_offset = config.getfloat("gcode_z_offset")
        self.active = config.getboolean("active")
        # Of another plugin, which has no such status
        if config.getboolean("is_other", False):
            self.get_status = lambda eventtime: {"active": True}
        gcode = config.get_printer().lookup_object("gcode")
        gcode.register_command("FETCH_TOOL", None)
        gcode.register_command("FETCH_TOOL", self.fetch)

    def fetch(self, gcmd):
        self.active = True

    def get_status(self, eventtime):
        return {"gcode_z_offset": self.gcode_z_offset, "active": self.active}


def load_config_prefix(config):
    return Tool(config)
