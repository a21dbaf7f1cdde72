"""Printers and settings that unit tests of z_calibration have in common."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from hypothesis import strategies as st

from z_touch.errors import CalibrationError
from z_touch.options import read
from z_touch.sampling import Sampling
from z_touch.touch import Site
from z_touch.z_calibration import heights as formula
from z_touch.z_calibration.settings import OPTIONS, Settings

STEP = 1 / 64


def exact(low, high):
    """Multiples of 1/64: their sums are exact, equality really is equality."""
    return st.integers(int(low / STEP), int(high / STEP)).map(
        lambda steps: steps * STEP
    )


heights = exact(-50, 400)
shifts = exact(-10, 10)
distances = exact(STEP, 10)
travels = exact(0, 3)
margin_pairs = st.tuples(exact(-3, 3), exact(-3, 3)).filter(
    lambda pair: pair[0] < pair[1]
)
# Margins and an offset that they admit
offsets_within_margins = margin_pairs.flatmap(
    lambda margins: st.tuples(st.just(margins), exact(*margins))
)
results = st.builds(formula.Result, heights, heights, heights, travels, shifts)
expected_heights = st.none() | heights


class Machine(NamedTuple):
    """What only the test knows; heights are toolhead Z."""

    pin: float  # where the nozzle presses the pin
    body: float  # how far the switch body hangs below the nozzle
    travel: float  # from the body down to the plunger when it triggers
    bed: float  # where the nozzle would meet the bed

    @property
    def switch_trigger(self):
        return self.pin + self.body

    @property
    def bed_trigger(self):
        return self.bed + self.body + self.travel

    def shifted(self, shift):
        """After homing at a pin that is taken to stand elsewhere."""
        return self._replace(pin=self.pin + shift, bed=self.bed + shift)

    def result(self):
        """What a run finds."""
        parts = (self.bed_trigger, self.switch_trigger, self.pin, self.travel)
        return formula.Result(*parts, formula.offset(*parts))


# Bodies that the module admits, beds inside the default margins
machines = st.builds(
    Machine,
    pin=exact(-2, 5),
    body=exact(1 + STEP, 12),
    travel=travels,
    bed=exact(-1 + STEP, 1 - STEP),
)


def make_sampling(**changes):
    """How the pin is sampled; nothing is left to the probe."""
    values = {
        "samples": 3,
        "tolerance": 0.01,
        "retries": 0,
        "result": "median",
        "speed": 2.0,
        "retract_dist": 4.0,
        "lift_speed": 6.0,
    }
    return Sampling(**dict(values, **changes))


class Nothing:
    """A section that leaves every option out: what is asked for is the default."""

    def get_prefix_options(self, _prefix):
        return []

    def get(self, _name, default=None, **_limits):
        return default

    getfloat = getint = getboolean = getfloatlist = get

    def getchoice(self, _name, choices, default):
        return choices[default]

    # G-code is a template of the printer's

    def get_name(self):
        return "z_calibration"

    def lookup_object(self, _name, _default=None):
        return self

    def add(self, *_script):
        pass

    def get_printer(self):
        return self

    def load_object(self, _config, _name):
        return self

    def load_template(self, _config, _name, default):
        return default


# As the table has them
DEFAULTS = {name: value for name, value in read(Nothing(), OPTIONS).items()}


def make_settings(**changes):
    """Settings of a plausible machine, as complete() leaves them."""
    values = {
        "nozzle_xy_position": Site("nozzle", 100.0, 290.0, "the nozzle"),
        "switch_xy_position": Site("switch", 110.0, 290.0, "the switch"),
        "bed_xy_position": Site("bed", 150.0, 150.0, "the bed"),
        "switch_offset": 0.5,
        "safe_z_height": 13.0,
        "probing_speed": 5.0,
        "on_pin": make_sampling(),
        "on_bed": make_sampling(),
        "may_attach_late": False,
        "start_homes": False,
        "position_endstop": 0.0,
        "position_min": -100.0,
        "position_max": 500.0,
        "z_offset": 6.5,
        "unmeasured_pin": 0.0,
        "mesh_area": None,
        "given": frozenset(),
        "z_speed": None,
    }
    return Settings(**{**DEFAULTS, **values, **changes})


def settings_of(machine, **changes):
    """Settings of someone who has measured the machine."""
    return make_settings(
        position_endstop=machine.pin, switch_offset=machine.travel
    ).replace(**changes)


def complaint(function, *args):
    """The message that a call ends with."""
    with pytest.raises(CalibrationError) as caught:
        function(*args)
    return str(caught.value)
