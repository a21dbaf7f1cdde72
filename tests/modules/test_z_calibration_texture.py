"""bed_spread: touches of a textured plate at points around the configured one."""

from __future__ import annotations

import json
import math
import re
import statistics
from dataclasses import replace
from itertools import combinations

import pytest

from simprinter.world import TextureSpec
from tools.kit.dockable_probe import SWITCH
from tools.kit.docks import calibrating
from tools.kit.runs import make_runs
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    calibration,
    kept_runs,
    reported,
    section,
    with_moves,
)

MIDDLE = (152.0, 125.25)


def rough(seed):
    scene = SCENES["voron"]
    bed = replace(scene.world.bed, texture=TextureSpec(seed=seed))
    return scene.with_world(bed=bed)


def points_of(printer, before=0):
    """Where the bed was touched (mm)."""
    touches = printer.machine.truth.touches[before:]
    return [(t.x, t.y) for t in touches if t.site == "probe_bed"]


@pytest.mark.parametrize("is_restarted", [False, True])
def test_each_run_has_other_points(start, is_restarted):
    # So that no dent is met each time; the history has the count
    changes = section(bed_spread="3", samples="4")
    printer = start("voron", changes=changes).homed()
    printer.run("CALIBRATE_Z")
    first = points_of(printer)
    before = len(printer.machine.truth.touches)
    if is_restarted:
        printer.session.restart("RESTART")
    printer.run("G28\nCALIBRATE_Z")
    second = points_of(printer, before)
    assert len(first) == len(second) == 4
    apart = [math.dist(a, b) for a in first for b in second]
    assert min(apart) > 0.3
    assert all(math.dist(point, MIDDLE) <= 3.0 for point in second)


@pytest.mark.parametrize("first_fast", ["false", "true"])
def test_each_touch_is_at_a_point_of_its_own(start, first_fast):
    options = section(
        bed_spread="3", samples="9", probing_first_fast=first_fast
    )
    # A plunger that hangs out of its switch is lifted clear of the plate
    changes = {**options, "probe": {"sample_retract_dist": "0.5"}}
    scene = SCENES["voron"]
    probe = replace(scene.world.mag_probe, pretravel=0.9)
    printer = start(scene.with_world(mag_probe=probe), changes=changes).homed()
    lines = printer.run("CALIBRATE_Z VERBOSE=1")
    told = re.findall(
        r"bed: touched at z=\S+ at (\S+), (\S+)$", "\n".join(lines), re.M
    )
    points = points_of(printer)
    if first_fast == "true":
        # The one that does not count is where the first one does
        assert points[0] == pytest.approx(points[1], abs=0.02)
        points = points[1:]
    # Of the bed, where the plunger is
    beside = [(float(x) + 2.0, float(y) - 24.75) for x, y in told]
    assert [pytest.approx(p, abs=0.06) for p in beside] == points
    assert len(points) == 9
    far = [math.dist(point, MIDDLE) for point in points]
    assert 2.5 < max(far) <= 3.0
    assert min(math.dist(a, b) for a, b in combinations(points, 2)) > 1.0
    assert printer.machine.truth.drag("probe_bed") == 0.0
    assert all(
        t.z - t.trigger_z < 0.1
        for t in printer.machine.truth.touches
        if t.site == "probe_bed"
    )


@pytest.mark.slow
def test_texture_is_no_reason_to_begin_again_and_is_averaged(start):
    options = {"samples": "9", "samples_tolerance": "0.01"}
    options["samples_tolerance_retries"] = "0"
    errors = {"0": [], "3": []}
    for seed in range(3):
        for spread, found in errors.items():
            changes = section(bed_spread=spread, **options)
            printer = start(rough(seed), changes=changes).homed()
            before = len(printer.machine.truth.touches)
            calibration(printer)
            assert len(points_of(printer, before)) == 9
            found.append(printer.gap() - printer.scene.formula_gap())
    single, spread = (
        math.sqrt(statistics.mean(e * e for e in found))
        for found in errors.values()
    )
    assert spread < 0.009 < single


@pytest.mark.slow
def test_more_than_texture_is_refused(start):
    scene = SCENES["voron"].with_world(
        bed=replace(SCENES["voron"].world.bed, texture=TextureSpec(sigma=0.2))
    )
    options = {"bed_spread": "3", "samples": "9", "samples_tolerance": "0.01"}
    printer = start(scene, changes=section(**options)).homed()
    message = printer.fail("CALIBRATE_Z")
    assert "samples_tolerance is 0.1100 mm" in message


@pytest.mark.slow
def test_with_auto_there_are_as_many_as_texture_needs(start):
    changes = section(bed_spread="3", samples="auto")
    printer = start(rough(1), changes=changes).homed()
    _, sites = calibration(printer)
    assert 5 <= sites.count("probe_bed") <= 20
    assert printer.status("z_calibration")["uncertainty"] > 0.008


@pytest.mark.slow
def test_accuracy_asks_for_one_point(start):
    printer = start(rough(1), changes=section(bed_spread="3")).homed()
    printer.run("CALIBRATE_Z_ACCURACY CYCLES=2")
    points = points_of(printer)
    assert len(points) >= 4
    assert points == [pytest.approx(MIDDLE, abs=0.06)] * len(points)


@pytest.mark.slow
def test_history_keeps_where_it_was(start):
    printer = start(changes=section(bed_spread="3", samples="4")).homed()
    printer.run("CALIBRATE_Z")
    (run,) = kept_runs(printer)
    assert run["bed_spread"] == 3.0
    assert "points" not in run["sites"]["switch"]
    # Of the bed, where the plunger is: it hangs beside the nozzle
    points = [(x + 2.0, y - 24.75) for x, y in run["sites"]["bed"]["points"]]
    assert [pytest.approx(p, abs=0.06) for p in points] == points_of(printer)
    reported(printer, "the report is ")
    folder = printer.session.data / "config" / "z_calibration"
    (report,) = folder.glob("report-*.svg")
    assert "Where the bed was touched" in report.read_text()


@pytest.mark.slow
def test_history_of_one_point_says_nothing_of_many(start, tmp_path):
    """Texture would be more than its touches vary, and the +- that of them."""
    changes = section(bed_spread="3", samples="9", history=str(tmp_path))
    worth = {}
    for kind in ("one point", "no bed", "many"):
        spread = 3.0 if kind == "many" else 0.0
        runs = make_runs(
            20, noise=0.001, touches=9, bed_spread=spread, worn={"bed": 0.03}
        )
        for run in runs if kind == "no bed" else ():
            del run["sites"]["bed"]
            run["ok"] = False
        lines = [json.dumps(run) + "\n" for run in runs]
        (tmp_path / "printer.jsonl").write_text("".join(lines))
        printer = start(rough(1), changes=changes).homed()
        printer.run("CALIBRATE_Z")
        worth[kind] = printer.status("z_calibration")["uncertainty"]
    assert worth["one point"] == worth["no bed"]
    assert worth["many"] != pytest.approx(worth["no bed"], rel=0.1)


@pytest.mark.slow
def test_dock_beside_the_points_is_gone_around(start):
    """Where the straight way from one to the next crosses its circle."""
    dock, away, middle = (50.0, 296.0), 38.0, (50.0, 255.0)
    scene = calibrating(SWITCH)
    scene = scene.with_world(dock=replace(scene.world.dock, y=dock[1]))
    changes = {
        "moves": {},
        **section(bed_spread="20", samples="10", bed_xy_position="48, 279.75"),
        "dockable_probe": {
            "dock_position": "50, 296",
            "approach_position": "50, 258",
            "detach_position": "90, 296",
            "safe_dock_distance": "38",
        },
    }
    printer = start(scene, changes, modules=with_moves()).homed()
    before = len(printer.status("moves")["ends"])
    printer.run("CALIBRATE_Z")
    assert len(points_of(printer)) == 10
    ends = [end[:2] for end in printer.status("moves")["ends"][before:]]
    legs = [
        (a, b)
        for a, b in zip(ends, ends[1:])
        if max(math.dist(end, middle) for end in (a, b)) < 25.0
        and min(math.dist(end, dock) for end in (a, b)) > away - 0.01
    ]
    places = [
        [a[i] + (b[i] - a[i]) * part / 50.0 for i in (0, 1)]
        for a, b in legs
        for part in range(51)
    ]
    assert len(places) > 300
    assert min(math.dist(place, dock) for place in places) > away - 0.1


@pytest.mark.slow
def test_a_point_that_comes_with_the_command_is_looked_at_as_well(start):
    printer = start(changes=section(bed_spread="3")).homed()
    message = printer.fail("CALIBRATE_Z BED_POSITION=150,26")
    assert "bed_spread: 3" in message
    assert points_of(printer) == []
