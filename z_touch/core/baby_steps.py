# What is taken for a baby step of the G-code Z offset.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

# A change of more than this (mm) is another offset, or a typing error.
LARGEST_STEP = 0.5

# Offsets that differ by less (mm) are the same: the rest is rounding.
NO_STEP = 0.0000005
