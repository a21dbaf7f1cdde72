# Endstops: the pins that stop a move, made, found and checked.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from . import options

# What probing_move() and a state query need from an endstop object
ENDSTOP_METHODS = ("get_steppers", "home_start", "home_wait", "query_endstop")

# Sections that make the object 'probe', and their option for the pin
PROBE_PINS = (
    ("probe", "pin"),
    ("dockable_probe", "pin"),
    ("smart_effector", "pin"),
    ("bltouch", "sensor_pin"),
)


# The name of the section that makes the object 'probe'; None: one that we do
# not know, or none.
def find_probe_section(config):
    for name, _option in PROBE_PINS:
        if config.has_section(name):
            return name
    return None


def is_endstop(candidate):
    methods = [getattr(candidate, name, None) for name in ENDSTOP_METHODS]
    return all(callable(m) for m in methods) and bool(candidate.get_steppers())


def bare_pin(pin):
    pin = pin.replace(" ", "").lstrip("^~!")
    return pin[len("mcu:") :] if pin.startswith("mcu:") else pin


# 'probe' of probe:z_virtual_endstop
def chip_of(pin):
    return pin.strip("^~! ").split(":")[0].strip() if ":" in pin else "mcu"


# Hosts themselves tell a virtual endstop by this method
def is_virtual(endstop):
    return hasattr(endstop, "get_position_endstop")


# The endstops of a printer, as far as a section needs them.
class Endstops:
    # 'host': host.Host, which is connected later
    def __init__(self, config, host):
        self.host = host
        self.printer = host.printer
        self.query_endstops = self.printer.load_object(config, "query_endstops")

    # An endstop of our own that stops the Z motors.  A pin that something
    # else uses, too, is an error of the host.
    def make(self, config, option, remedy):
        pin, what = config.get(option), ""
        if not pin.strip("^~! ") or chip_of(pin) in (
            "probe",
            self.host.section,
        ):
            what = "is no pin"
        for name, other in PROBE_PINS:
            if config.has_section(name) and name != self.host.section:
                section = config.getsection(name)
                used = section.get(other, "", note_valid=False)
                if used and bare_pin(used) == bare_pin(pin):
                    what = "is the pin of section '%s'" % (name,)
        pins = self.printer.lookup_object("pins")
        try:
            endstop = None if what else pins.setup_pin("endstop", pin)
        except pins.error as e:
            what = "cannot be used: %s" % (e,)
        if what:
            raise config.error(
                "Option '%s: %s' in section '%s' %s; %s"
                % (option, pin, self.host.section, what, remedy)
            )
        self.query_endstops.register_endstop(endstop, self.host.section)

        self.stops_z(endstop)
        return endstop

    # A pin that is only looked at, or that ends a probing move of a probe
    def make_plain(self, config, option):
        pin = config.get(option)
        pins = self.printer.lookup_object("pins")
        try:
            return pins.setup_pin("endstop", pin)
        except pins.error as e:
            raise options.config_error(
                config,
                option,
                "cannot be used: %s; give the pin that the switch is wired to,"
                " such as ^PA1" % (e,),
            )

    # What an endstop reads now, for whoever is no command; None: a command is running.
    # That may ask the same pin, and hosts lose one of two answers then.
    def read_between_commands(self, endstop):
        mutex = self.host.gcode.get_mutex()
        if mutex.test():
            return None
        with mutex:
            return bool(endstop.query_endstop(self.host.print_time()))

    # The Z motors are to stop with this endstop
    def stops_z(self, endstop):
        def add_z_steppers():
            # They exist since the toolhead was loaded, just before this event
            self.host.find_toolhead()
            for stepper in self.host.axes.z_steppers():
                endstop.add_stepper(stepper)

        register = self.printer.register_event_handler
        register("klippy:mcu_identify", add_z_steppers)

    # Registered as "z" until 2025-05-06 (cc6736c3e) and on Kalico, since then
    # under the name of the section.  None: there is none
    def find_z(self):
        section = self.host.axes.z_axis.section
        names = (section, section.split()[-1].replace("stepper_", ""))
        for endstop, name in self.query_endstops.endstops:
            if name in names:
                return endstop
        return None

    # An endstop stops only its own motors.  With none at all, hosts since
    # 2025-05-06 (cc6736c3e) make the whole move without any endstop.
    def check_stops_z(self, endstop, where):
        stopped = [s.get_name() for s in endstop.get_steppers()]
        moving = [s.get_name() for s in self.host.axes.z_steppers()]
        missing = [name for name in moving if name not in stopped]
        if missing:
            raise self.printer.config_error(
                "%s does not stop these Z motors: %s; remove the endstop_pin"
                " of their own" % (where, ", ".join(missing))
            )
