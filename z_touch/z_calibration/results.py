# The last calibration that was applied, and whether it still holds.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import collections

# The last run that was applied: its heights.Result, the mark of the frame that it
# was measured in, and what was odd; what it is worth (mm at 95 %, None: nobody
# knows); what Z_ADJUST added, and the G-code offset that came of it (mm).
Last = collections.namedtuple(
    "Last", "result mark warnings uncertainty z_adjust applied"
)
NOTHING = Last(None, None, (), None, 0.0, 0.0)


# What macros read of results, and what the next run knows of the last one.
class Results(object):
    # 'frame': frame.Frame of the heights
    def __init__(self, frame):
        self.frame = frame
        self.last = NOTHING
        # The heights.Result of the run that is under way, as soon as there is
        # one: end_gcode may read it.
        self.measured = None
        # The last run has ended well
        self.is_good = False

    # A run begins
    def begin(self):
        self.is_good = False

    # The heights.Result of the run that is under way, None: there is none
    def note(self, measured):
        self.measured = measured

    # A run has ended well
    def keep(self, last):
        self.last = last
        self.is_good = True

    # Why the last result does not hold (any more); empty: it does.  'besides'
    # is of the frame's words, and counts as nothing.
    def why_not(self, besides=None):
        if self.last.result is None:
            return "not calibrated yet"
        return self.frame.moved_since(self.last.mark, besides)

    # 'last_query' and 'last_z_offset' as upstream has them; for end_gcode the
    # heights are of the run that is under way.
    def status(self):
        result = self.measured or self.last.result
        adjust = 0.0 if self.measured else self.last.z_adjust
        reason = "not applied yet" if self.measured else self.why_not()
        return {
            "last_query": self.is_good,
            "last_z_offset": 0.0 if result is None else result.offset + adjust,
            "last_result": {} if result is None else dict(result._asdict()),
            "valid": not reason,
            "reason": reason,
            "warnings": list(self.last.warnings),
            "uncertainty": self.last.uncertainty,
            "z_adjust": self.last.z_adjust,
        }
