"""Where a site comes from, in the words that tell its owner what to check."""

from __future__ import annotations

from types import SimpleNamespace

from tests.unit.calibrated import make_settings
from z_touch.touch import Site
from z_touch.z_calibration.sites import SiteFinder

NOZZLE = Site("nozzle", 206.0, 306.0, "The place of the nozzle")


def finder(**changes):
    """On a printer whose mesh has a zero, with a probe 2 mm beside the nozzle."""
    host = SimpleNamespace(
        transforms=SimpleNamespace(mesh_zero=lambda: (150.0, 140.0)),
        probing=SimpleNamespace(offsets=lambda: (0.0, 2.0, 5.0)),
    )
    return SiteFinder(host, make_settings(**changes))


def test_a_place_that_nobody_has_written_is_told_by_its_name():
    assert NOZZLE.place() == "the place of the nozzle"


def test_a_parameter_is_told_as_it_was_given():
    gcmd = SimpleNamespace(get=lambda name, default: "206,306")
    site = finder().given(gcmd, "nozzle")
    assert site[:3] == NOZZLE[:3]
    assert site.place() == "NOZZLE_POSITION"


def test_offsets_of_the_switch_are_told_by_their_option():
    site = finder(switch_xy_offsets=(5.5, -24.75)).switch_site(NOZZLE, None)
    assert site[:3] == ("switch", 211.5, 281.25)
    assert site.place() == "switch_xy_offsets"


def test_the_zero_of_the_mesh_is_told_by_its_section():
    site = finder().bed_site(None)
    assert site[:3] == ("bed", 150.0, 138.0)
    assert site.place() == "zero_reference_position of section 'bed_mesh'"
