"""Real [dockable_probe] sections: they start, home, mesh and dock."""

from __future__ import annotations

import pytest

from tools.kit.cases import all_slow_but
from tools.kit.dockable_probe import GANTRY, refusal, trips, where
from tools.kit.dockable_probe_corpus import (
    ADVISED,
    BROKEN,
    ENTRIES,
    scene_of,
    section_of,
)

GOOD = [i for i in range(len(ENTRIES)) if i not in BROKEN]


def test_all_of_them():
    assert len(ENTRIES) == 33
    assert len(GOOD) == 23


# Old names and angles
@pytest.mark.parametrize("index", all_slow_but((5,), GOOD))
def test_home_and_mesh(start, index):
    goes_well(start(scene_of(index)).homed())


@pytest.mark.parametrize("index", all_slow_but((30,), ADVISED))
def test_advice_leads_to_a_printer_that_works(start, index):
    goes_well(start(scene_of(index, **ADVISED[index])).homed())


def goes_well(printer):
    assert where(printer) in ("docked", "attached")
    printer.run("G1 X120 Y120 Z30 F6000\nBED_MESH_CALIBRATE")
    assert "Mesh Bed Leveling Complete" in "\n".join(printer.session.console)
    printer.run("DETACH_PROBE")
    assert where(printer) == "docked"
    assert trips(printer)[-1] == "dock"
    assert "lost" not in trips(printer)
    assert printer.machine.truth.min_gap > 0.5


@pytest.mark.parametrize("index", sorted(BROKEN))
def test_broken_one_says_why(host, index):
    if index in ADVISED:
        assert BROKEN[index] in refusal(host, {}, scene_of(index))
        return
    options = section_of(ENTRIES[index], index)
    changes = {
        "dockable_probe": {
            **{k: None for k in GANTRY.sections["dockable_probe"]},
            **options,
        },
        "gcode_macro _PROBE_SAFE_Y": {"gcode": "\n  G4 P1"},
    }
    if "probe" in (ENTRIES[index].get("context") or {}):
        changes["probe"] = {"pin": "PF0", "z_offset": "1"}
    assert BROKEN[index] in refusal(host, changes)
