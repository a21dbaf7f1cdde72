# For tests: a [tool NAME] as klipper-toolchanger has them, as far as others ask it.
# FETCH_TOOL TOOL=NAME makes one the active tool.


class Changer:
    """All of them: what the active one adds to Z, below the G-code offset."""

    def __init__(self, printer):
        self.printer = printer
        self.tools = []
        printer.register_event_handler("klippy:connect", self.connect)
        gcode = printer.lookup_object("gcode")
        gcode.register_command("FETCH_TOOL", self.fetch)
        gcode.register_command("SHIFT_TOOL", self.shift_tool)

    def connect(self):
        gcode_move = self.printer.lookup_object("gcode_move")
        self.next = gcode_move.set_move_transform(self, force=True)
        if not any(tool.is_older for tool in self.tools):
            self.gcode_transform = self

    def shift(self):
        active = [t for t in self.tools if t.active and not t.is_older]
        return sum(tool.gcode_z_offset for tool in active)

    def move(self, position, speed):
        x, y, z = position[:3]
        self.next.move([x, y, z + self.shift(), *position[3:]], speed)

    def get_position(self):
        x, y, z, *rest = self.next.get_position()
        return [x, y, z - self.shift(), *rest]

    def fetch(self, gcmd):
        wanted = gcmd.get("TOOL")
        for tool in self.tools:
            tool.active = tool.name == wanted
        self.printer.lookup_object("gcode_move").reset_last_position()

    def shift_tool(self, gcmd):
        for tool in self.tools:
            if tool.name == gcmd.get("TOOL"):
                tool.gcode_z_offset = gcmd.get_float("Z")
        self.printer.lookup_object("gcode_move").reset_last_position()


class Tool:
    def __init__(self, config, changer):
        self.name = config.get_name().split()[-1]
        self.gcode_z_offset = config.getfloat("gcode_z_offset")
        self.active = config.getboolean("active", False)
        # It is a part of the G-code offset there
        self.is_older = config.getboolean("is_older", False)
        # Of another plugin, which has no such status
        if config.getboolean("is_other", False):
            self.get_status = lambda eventtime: {"active": True}
            return
        changer.tools.append(self)

    def get_status(self, eventtime):
        return {"gcode_z_offset": self.gcode_z_offset, "active": self.active}


def load_config_prefix(config):
    printer = config.get_printer()
    changer = printer.lookup_object("toolchanger", None)
    if changer is None:
        changer = Changer(printer)
        printer.add_object("toolchanger", changer)
    return Tool(config, changer)
