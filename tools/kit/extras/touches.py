# For tests: acceleration and motor currents as the host has them when a
# homing or probing move begins and when it has ended.


class Touches:
    def __init__(self, config):
        self.printer = config.get_printer()
        self.seen = []
        for end in ("begin", "end"):
            self.printer.register_event_handler(
                "homing:homing_move_" + end,
                getattr(self, "note_" + end),
            )

    def note_begin(self, hmove):
        self.note("begin", hmove)

    def note_end(self, hmove):
        self.note("end", hmove)

    def note(self, moment, hmove):
        eventtime = self.printer.get_reactor().monotonic()
        toolhead = self.printer.lookup_object("toolhead")
        names = [name for endstop, name in hmove.endstops]
        currents = {
            name.split()[-1]: driver.get_status(eventtime)["run_current"]
            for name, driver in self.printer.lookup_objects()
            if name.startswith("tmc2209 ")
        }
        self.seen.append(
            {
                "moment": moment,
                "names": names,
                "max_accel": toolhead.get_status(eventtime)["max_accel"],
                "z": toolhead.get_position()[2],
                "currents": currents,
            }
        )

    def get_status(self, eventtime):
        return {"seen": list(self.seen)}


def load_config(config):
    return Touches(config)
