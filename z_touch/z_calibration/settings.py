# The options of [z_calibration], and the record of settings that comes of them.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import collections
import functools

from ..core import options, sampling, templates, touching
from ..core.errors import CalibrationError
from . import heights

# Results outside these limits (mm) are refused: the homing is outdated or
# something was touched that should not have been.
OFFSET_MARGINS = (-1.0, 1.0)

# How far (mm) below the expected height a touch may still look.
TRAVEL_MARGIN = 1.0

# So high (mm) a pin of its own may stand that nobody has measured; the probe
# passes it before the nozzle touches it.
UNMEASURED_PIN = 10.0

# Lift (mm) between two touches where homing_retract_dist is 0, which is
# right for homing only: without a lift the next touch starts on a pressed
# switch.  2 mm is more than the hysteresis of any common micro switch.
FALLBACK_RETRACT = 2.0

# XY speed (mm/s) between the sites.
TRAVEL_SPEED = 50.0

# What the offset may be off by (mm, 95 %) with samples: auto
TARGET_UNCERTAINTY = 0.008

# Whether the buttons that save the Z offset save into switch_offset
SAVE_BUTTON = {"off": False, "switch_offset": True}

# What the user configured: mm and mm/s.  None stands for "as the probe has
# it" until complete() has filled it in, and for a place or a switch_offset
# that is to come with the command; position_endstop is None where the pin is
# not what Z is homed on.
Settings = collections.namedtuple(
    "Settings",
    "nozzle switch switch_xy_offsets bed wiggle switch_offset"
    " attach_after_nozzle first_fast"
    " offset_margins travel_margin position_endstop position_min position_max"
    " safe_z_height speed probing_speed z_offset pin probe target save_button"
    " unmeasured_pin",
)


# Let the probe and the axis decide what the user left open.
def complete(settings, probe, z_offset, position_max):
    settings = settings._replace(
        pin=filled(settings.pin, probe),
        probe=filled(settings.probe, probe),
        z_offset=z_offset,
        position_max=position_max,
    )
    if settings.safe_z_height is not None:
        return settings._replace(unmeasured_pin=0.0)
    # A probe that comes after the nozzle finds the pin measured
    is_passed = settings.position_endstop is None
    is_passed = is_passed and not settings.attach_after_nozzle
    return settings._replace(
        safe_z_height=heights.default_safe_z(z_offset),
        unmeasured_pin=UNMEASURED_PIN if is_passed else 0.0,
    )


# A record with the values of another one where it has none
def filled(record, other):
    pairs = zip(record, other)
    return record._make(b if a is None else a for a, b in pairs)


# SWITCH_OFFSET of a command (mm), or else 'default', or else the user is asked
def param_switch_offset(gcmd, default):
    value = options.param_number(gcmd, "SWITCH_OFFSET", default, minval=0.0)
    if value is None:
        raise CalibrationError(
            "no switch_offset: run Z_CALIBRATION_SETUP, set it in section"
            " 'z_calibration', or add SWITCH_OFFSET=mm"
        )
    return value


######################################################################
# Options
######################################################################


# A Site or None: under its option, or as probe_<name>_x and _y of old
def read_site(config, name, old_names):
    option = name + "_xy_position"
    olds = ["probe_%s_%s" % (name, axis) for axis in "xy"]
    pair = options.pair(config, option)
    old = [options.number(config, axis) for axis in olds]
    if None in old and old != [None, None]:
        raise config.error(
            "Option '%s' in section '%s': only one of '%s' and '%s' is given;"
            " write both, better as '%s: X,Y'"
            % ((option, config.get_name()) + tuple(olds) + (option,))
        )
    if None not in old:
        text, values = "options '%s' and '%s' are ignored, '%s' is given", []
        if pair is None:
            text, values = "options '%s' and '%s' are now '%s: %g,%g'", old
        old_names.notes.append(text % tuple(olds + [option] + values))
    if pair is None and None not in old:
        return touching.option_site(config, name, " and ".join(olds), old)
    return pair and touching.option_site(config, name, option, pair)


# Where Z is homed on the pin itself, [safe_z_home] has its place.
def read_nozzle_site(config, own_pin, old_names):
    site = read_site(config, "nozzle", old_names)
    if site is not None or own_pin or not config.has_section("safe_z_home"):
        return site
    home = config.getsection("safe_z_home")
    pair = home.getfloatlist(
        "home_xy_position", None, count=2, note_valid=False
    )
    return pair and touching.option_site(
        home, "nozzle", "home_xy_position", pair
    )


# Of the pin; for the bed only what is given, the rest is as the probe has it.
def read_samplings(config, z_axis, old_names):
    number = functools.partial(options.number, config)
    speed = old_names.name_of("probing_second_speed", "second_homing_speed")
    retract = old_names.name_of("probing_retract_dist", "homing_retract_dist")
    default_retract = z_axis.homing_retract_dist or FALLBACK_RETRACT
    pin = sampling.Sampling(
        samples=options.samples(config),
        tolerance=number("samples_tolerance", minval=0.0),
        retries=config.getint("samples_tolerance_retries", None, minval=0),
        result=config.getchoice("samples_result", options.RESULTS, None),
        speed=number(speed, z_axis.second_homing_speed, above=0.0),
        retract_dist=number(retract, default_retract, above=0.0),
        lift_speed=number("lift_speed", above=0.0),
    )
    bed = pin._replace(
        speed=pin.speed if old_names.is_given(speed) else None,
        retract_dist=pin.retract_dist if old_names.is_given(retract) else None,
    )
    return pin, bed


def read_position_min(config, z_axis, homed_z, old_names):
    own = options.number(config, "position_min")
    if own is None:
        return z_axis.position_min
    if homed_z is not None and own > homed_z:
        raise config.error(
            "Option 'position_min' in section 'z_calibration': %.3f is above"
            " position_endstop (%.3f) of section '%s', no touch could reach"
            " the pin; remove it or write a smaller value"
            % (own, homed_z, z_axis.section)
        )
    if own < z_axis.position_min:
        old_names.notes.append(
            "option 'position_min: %g' is ignored, section '%s' ends at %g"
            % (own, z_axis.section, z_axis.position_min)
        )
    return max(own, z_axis.position_min)


# mm at 95 %, for samples: auto
def read_target(config, pin, old_names):
    target = options.number(
        config, "target_uncertainty", TARGET_UNCERTAINTY, above=0.0
    )
    is_auto = pin.samples == sampling.AUTO
    idle = (
        ("samples_tolerance", "samples_tolerance_retries", "samples_result")
        if is_auto
        else ("target_uncertainty",)
    )
    for name in idle:
        if old_names.is_given(name):
            text = "option '%s' is ignored %s 'samples: auto'"
            how = "with" if is_auto else "without"
            old_names.notes.append(text % (name, how))
    return target


def read_wiggle(config):
    pair = options.pair(config, "wiggle_xy_offsets")
    return pair if pair and any(pair) else None


# 'own_pin' where the nozzle presses another switch than the Z endstop
def read_settings(config, z_axis, own_pin, old_names):
    number = functools.partial(options.number, config)
    # None where it is the probe that Z is homed with; that is refused later
    homed_z = None if own_pin else z_axis.position_endstop
    speed = old_names.name_of("probing_speed", "homing_speed")
    margins = old_names.name_of("offset_margins", "max_deviation")
    safe_z = old_names.name_of("safe_z_height", "clearance")
    # 0 was "as the probe has it" under the old name
    lowest = {"minval": 0.0} if safe_z == "clearance" else {"above": 0.0}
    pin, bed = read_samplings(config, z_axis, old_names)
    return Settings(
        nozzle=read_nozzle_site(config, own_pin, old_names),
        switch=read_site(config, "switch", old_names),
        switch_xy_offsets=options.pair(config, "switch_xy_offsets"),
        bed=read_site(config, "bed", old_names),
        wiggle=read_wiggle(config),
        switch_offset=number("switch_offset", minval=0.0),
        attach_after_nozzle=templates.attaches_probe(
            config.get("before_switch_gcode", ""),
            config.get("start_gcode", ""),
            templates.read_macros(config),
        ),
        first_fast=config.getboolean("probing_first_fast", False),
        offset_margins=options.margins(config, margins, OFFSET_MARGINS),
        travel_margin=number("travel_margin", TRAVEL_MARGIN, above=0.0),
        position_endstop=homed_z,
        position_min=read_position_min(config, z_axis, homed_z, old_names),
        safe_z_height=number(safe_z, **lowest) or None,
        speed=number("speed", TRAVEL_SPEED, above=0.0),
        probing_speed=number(speed, z_axis.homing_speed, above=0.0),
        pin=pin,
        probe=bed,
        target=read_target(config, pin, old_names),
        save_button=config.getchoice("save_button", SAVE_BUTTON, "off"),
        # From the probe and the axes, when klippy connects
        position_max=None,
        z_offset=None,
        unmeasured_pin=None,
    )
