# For tests: where every move of an extra ends, in the order of the moves.


class Moves:
    def __init__(self, config):
        self.printer = config.get_printer()
        self.ends = []
        self.printer.register_event_handler("toolhead:manual_move", self.note)

    def note(self):
        toolhead = self.printer.lookup_object("toolhead")
        self.ends.append([round(v, 4) for v in toolhead.get_position()[:3]])

    def get_status(self, eventtime):
        return {"ends": list(self.ends)}


def load_config(config):
    return Moves(config)
