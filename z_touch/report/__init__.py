"""The report of a history: a program of its own, which klippy starts and people may.

    python3 .../z_touch/report HISTORY

HISTORY is the file that [z_calibration] keeps its runs in, z_calibration/printer.jsonl
beside printer.cfg.  It writes a picture beside it, says what it has written, and the
verdict of a CALIBRATE_Z_ACCURACY that was the last thing.

    program      arguments, files, what is said
    picture      what is drawn, of the parts in svg and days
    verdict      what to do, in words
    trend        drifts, changes, spreads that grow; steps, noise: the maths of these
    cycles       what varies in a CALIBRATE_Z_ACCURACY
    attachment   the text to attach where somebody is asked

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""
