"""z_touch/dockable_probe/settings.py: how low a touch in homing may go."""

from __future__ import annotations

import pytest

from z_touch.dockable_probe.settings import lowest_touch


@pytest.mark.parametrize(
    ("z_offset", "with_probe", "pin_z", "lowest"),
    [
        # Clear of the bed, and never more than 5 mm below it
        (2.0, True, None, 1.0),
        (6.0, True, None, 1.0),
        (20.0, True, None, 15.0),
        # Clear of a pin that the nozzle is homed on, if it is near the bed
        (20.0, False, 0.0, 1.0),
        (6.9, False, 1.6, 2.6),
        (6.9, False, -0.5, 1.0),
        (6.9, False, 250.0, 1.0),
        # Never measured
        (0.0, True, None, -1.0),
        (0.0, False, 1.6, 1.0),
        (-0.9, True, None, -1.9),
    ],
)
def test_lowest_touch(z_offset, with_probe, pin_z, lowest):
    z = lowest_touch(z_offset, with_probe, pin_z)
    assert z == pytest.approx(lowest)
