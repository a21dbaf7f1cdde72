# Rows of [z_calibration] that say whether Z is homed on the pin below the nozzle: its
# room has them in its table, and other sections look at them by z_pin.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from . import options, touching

NOZZLE_POSITION = touching.site_option(
    "nozzle_xy_position",
    "X, Y of the head, in mm, when the nozzle is above the middle of the metal pin."
    " The default is home_xy_position of [safe_z_home]; there is none with"
    " endstop_pin.",
)
ENDSTOP_PIN = options.option(
    "endstop_pin",
    options.PIN,
    None,
    "",
    "The MCU pin of another switch that nozzle and body press, such as ^PG10. By"
    " default they press the Z endstop.",
    old=("calibration_endstop_pin",),
)
