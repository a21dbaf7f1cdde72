"""[z_calibration] on real klippy in front of the simulated machine."""

from __future__ import annotations

import pytest

MICROSTEP = 0.0025


@pytest.mark.parametrize("scene", ["voron", "cartesian"])
def test_gap_is_what_the_formula_predicts(start, scene):
    printer = start(scene).homed()
    printer.run("CALIBRATE_Z")
    predicted = printer.scene.formula_gap()
    assert printer.gap() == pytest.approx(predicted, abs=2 * MICROSTEP)
