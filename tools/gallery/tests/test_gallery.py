"""The histories of the documents, as far as a test has time for days."""

from __future__ import annotations

import json

import pytest

from tools.gallery import __main__ as gallery


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_days_of_a_printer(host):
    lines = gallery.tell("plate", host, 2)
    first, second = map(json.loads, lines)
    assert first["ok"] and second["ok"]
    assert first["printer"] == second["printer"] == gallery.OWNER
    assert 0.8 < (second["time"] - first["time"]) / 86400.0 < 3.2
    assert 145.0 < first["temperatures"]["extruder"] < 155.0
    assert first["sites"] != second["sites"]
    assert "2 runs, 2026-01-0" in gallery.draw(lines)


def test_what_happens_happens_to_the_machine():
    """The one of each story that is not as the others."""
    scene = gallery.SCENES["cartesian"]
    days = {
        name: [story(number, scene) for number in range(count)]
        for name, (count, story) in gallery.STORIES.items()
    }
    assert [bool(day.faults) for day in days["good"]].count(True) == 1
    assert [day.scene.world.ooze is None for day in days["dirt"]] == (
        [True] * 23 + [False]
    )
    probes = [day.scene.world.mag_probe for day in days["wear"]]
    first, last = probes[0], probes[-1]
    assert first.switch_offset - last.switch_offset == pytest.approx(0.0396)
    assert last.noise.sigma > 3.0 * first.noise.sigma
    beds = [day.scene.world.bed.z0 for day in days["plate"]]
    assert beds[20] - beds[19] == pytest.approx(0.12)
    assert days["accuracy"][0].scene.world.mag_probe.reseat == 0.04
