"""What is told of the world to who plays with it."""

from __future__ import annotations

import re
import sys

from simprinter.play.watcher import SITES, crash_line
from simprinter.world import Crash, Pose


def test_crashes_read_like_touches():
    where = Pose(150.0, 149.96, -0.5)
    deep = Crash("nozzle_bed", "depth", 0.5, 0.1, 12.5, where)
    assert crash_line(deep) == (
        "CRASH: nozzle on the bed X150.0 Y150.0, 0.500 mm deep,"
        " 0.100 mm allowed"
    )
    dragged = Crash("dock", "drag", 3.0, 0.25, 12.5, where)
    assert crash_line(dragged) == (
        "CRASH: head in the dock  X150.0 Y150.0, 3.000 mm dragged,"
        " 0.250 mm allowed"
    )
    stopped = deep._replace(past_stop=0.3)
    assert crash_line(stopped) == (
        f"{crash_line(deep)}, 0.300 mm past its hard stop"
    )


def test_every_site_has_words():
    document = sys.modules[Crash.__module__].__doc__
    sites = re.findall(r"\b[a-z]+_(?:pin|bed|membrane)\b", document)
    assert len(sites) == 7
    for site in (*sites, "dock", "x_endstop", "y_endstop", "z_endstop"):
        assert SITES[site] != site
