"""What klippy offers, and the only place where it is known how hosts differ.

printer      Host: clocks, console, commands, and the parts below
toolhead     Axes and Motion: limits, homed axes, motors of Z, moves, the probing move
endstops     Endstops: make, find and check the switch that stops a move
probe        Probing: the printer's probe, its session, where its touches end
transforms   Transforms: what mesh, tilt, heat and tools add to Z at a point
twist        Twist: what axis_twist_compensation adds to heights of the probe
gcode_state  GcodeState: the G-code offset, G92, G90 and G91
own_probe    Installed: a probe of ours as the printer's
gcode_moves  GcodeMoves: what moves of G-code pass
dock         HostDock: a [dockable_probe] of the host's own
klippy       the types of klippy's objects

A difference is asked of the object (hasattr), never of a version number, and a comment
names the change of the host with date and commit.  Nothing of the host is replaced or
written to, but for what this folder says and gives the reason for.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""
