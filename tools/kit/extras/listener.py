# For tests: what the module NAME asks its section and its commands for, the
# numbers it keeps, its phases, and where each of its probing moves may end.
# The first section of printer.cfg: [listener] with "module: NAME".

import collections
import inspect

# By section or command; klippy restarts without loading this anew
asked = collections.defaultdict(set)


def listen(cls, who):
    for method in [name for name in dir(cls) if name.startswith("get")]:
        inner = getattr(cls, method)
        parameters = list(inspect.signature(inner).parameters)
        if parameters[1:2] in (["option"], ["name"]):
            setattr(cls, method, listening(inner, who))


def listening(inner, who):
    def get(self, name, *args, **options):
        asked[who(self)].add(name)
        return inner(self, name, *args, **options)

    return get


# {place: number, word or None}, also inside what the module and z_touch made
def kept(value, place, module, seen):
    if isinstance(value, (int, float, str, type(None))):
        return {place: value}
    if id(value) in seen:
        return {}
    if hasattr(value, "_asdict"):
        items = value._asdict().items()
    elif isinstance(value, (list, tuple)):
        items = enumerate(value)
    elif isinstance(value, dict):
        items = value.items()
    elif {module, "z_touch"} & set(value.__class__.__module__.split(".")):
        items = vars(value).items()
    else:
        return {}
    found = {}
    for name, inner in items:
        inside = "%s.%s" % (place, name)
        found.update(kept(inner, inside, module, seen | {id(value)}))
    return found


class Listener:
    def __init__(self, config):
        self.printer = config.get_printer()
        self.name = config.get("module")
        self.phases, self.floors = [], []
        self.gcode = self.printer.lookup_object("gcode")
        if not asked:
            listen(config.__class__, lambda config: config.get_name())
            gcmd = self.gcode.create_gcode_command("", "", {})
            listen(gcmd.__class__, lambda gcmd: gcmd.get_command())
        asked.clear()
        asked[self.name] = set()
        self.run_script = self.gcode.run_script_from_command
        self.gcode.run_script_from_command = self.note_script
        homing = self.printer.load_object(config, "homing")
        self.probing_move = homing.probing_move
        homing.probing_move = self.note_move

    def note_phase(self):
        module = self.printer.lookup_object(self.name, None)
        status = module.get_status(0.0) if module is not None else {}
        self.phases.append(status.get("phase"))

    def note_script(self, script):
        self.note_phase()
        return self.run_script(script)

    def note_move(self, endstop, target, *args, **options):
        self.note_phase()
        self.floors.append([self.phases[-1], target[2]])
        return self.probing_move(endstop, target, *args, **options)

    def get_status(self, eventtime):
        module = self.printer.lookup_object(self.name, None)
        return {
            "asked": {who: sorted(names) for who, names in asked.items()},
            "phases": self.phases,
            "floors": self.floors,
            "kept": kept(module, self.name, self.name.split()[0], frozenset()),
        }


def load_config(config):
    return Listener(config)
