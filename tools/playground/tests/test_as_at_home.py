"""The printers of the playground as they are at home, on real klippy."""

from __future__ import annotations

import pytest

from simprinter.real import as_real
from tools.kit.cases import all_slow_but
from tools.playground.playground import SHOWN, point_of

MEMBRANE = "G90\nG1 X30 Y20 Z5 F6000\nEXTRA_PROBE PROBE=membrane FLOOR=-1"
# What is done with each, and how far its gap (mm) may then be off what a perfect one
# has: by texture, where it is told at another place than is touched, and by what grows
DONE = {
    "z_calibration": ("CALIBRATE_Z", 0.015),
    "auto_z_offset": ("AUTO_Z_CALIBRATE", 0.06),
    "dockable_probe": ("CALIBRATE_Z", 0.015),
    "extra_probe": (MEMBRANE, 0.1),
}


def gap_after(printer, script):
    if printer.scene.world.membrane is not None:
        printer.machine.lay_membrane()
    printer.run(script)
    if printer.scene.world.membrane is not None:
        printer.machine.lay_membrane(False)
    return printer.gap(point_of(printer.scene))


@pytest.mark.parametrize("name", all_slow_but(["z_calibration"], DONE))
def test_they_do_as_well_as_perfect_ones(start, name):
    script, allowed = DONE[name]
    perfect = gap_after(start(SHOWN[name]).homed(), script)
    for seed in (1, 2):
        printer = start(as_real(SHOWN[name], seed), seed=seed).homed()
        gap = gap_after(printer, script)
        assert gap != pytest.approx(perfect, abs=1e-9)
        assert gap == pytest.approx(perfect, abs=allowed)
