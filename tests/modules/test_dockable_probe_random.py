"""[dockable_probe] with a dock anywhere: never a hit, the probe where it is due.

The ways themselves are drawn without a host in
tests/unit/test_dockable_probe_path.py.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, Phase, assume, event, given, settings
from hypothesis import strategies as st

from simprinter.hosts.session import GcodeError
from simprinter.world import DockSpec
from tools.kit.cases import slow
from tools.kit.dockable_probe import GANTRY, QUICK, trips, where
from tools.kit.printer import Printer

# The reach of the axes of the scene
X, Y = (0.0, 300.0), (0.0, 310.0)
# Where X and Y are homed, and the way there
CORNER = (300.0, 310.0)

coordinate = st.integers(0, 300)
point = st.tuples(coordinate, coordinate)
degrees = st.integers(0, 359)


def on_way(x, y, angle, length):
    """The point so far (mm) out of the dock, and the way there."""
    way = (math.cos(math.radians(angle)), math.sin(math.radians(angle)), 0.0)
    return (x + length * way[0], y + length * way[1]), way


@st.composite
def docks(draw):
    """A scene whose dock stands anywhere, at any angle."""
    (x, y), way_in = draw(point), draw(degrees)
    way_off = way_in + draw(st.integers(50, 310))
    radius = draw(st.integers(25, 60))
    approach, taken = on_way(x, y, way_in, radius)
    detach, stripped = on_way(x, y, way_off, radius + draw(st.integers(0, 20)))
    for place in (approach, detach):
        assume(X[0] <= place[0] <= X[1] and Y[0] <= place[1] <= Y[1])
    home = draw(point)
    assume(30 <= home[0] <= 270 and 30 <= home[1] <= 240)
    assume(math.dist(home, (x, y)) > radius + 1.0)
    assume(math.dist(CORNER, (x, y)) > radius + 30.0)
    options = {
        **(GANTRY.sections["dockable_probe"] or {}),
        **QUICK,
        "dock_position": f"{x}, {y}",
        "approach_position": f"{approach[0]:.3f}, {approach[1]:.3f}",
        "detach_position": f"{detach[0]:.3f}, {detach[1]:.3f}",
        "safe_z_position": f"{home[0]}, {home[1]}",
    }
    sections = {**GANTRY.sections, "dockable_probe": options}
    sections.pop("safe_z_home")
    dock = DockSpec(
        x,
        y,
        0.0,
        approach=taken,
        release=stripped,
        cone=20.0,
        lifted=True,
        body=min(20.0, 0.6 * radius),
        lane=3.0,
    )
    # The probe reaches the bed wherever the toolhead gets
    bed = replace(
        GANTRY.world.bed, x_min=-50.0, y_min=-50.0, x_max=400.0, y_max=400.0
    )
    scene = replace(GANTRY, sections=sections)
    return scene.with_world(dock=dock, bed=bed)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("count", [6, slow(60)])
def test_dock_anywhere(host, count):
    @settings(
        max_examples=count,
        # Shrinking takes minutes
        phases=[Phase.explicit, Phase.generate],
        derandomize=True,
        database=None,
        suppress_health_check=[
            HealthCheck.filter_too_much,
            HealthCheck.too_slow,
        ],
    )
    @given(scene=docks(), places=st.lists(point, min_size=3, max_size=3))
    def draw(scene, places):
        fetch_touch_and_dock(host, scene, places)

    draw()


def fetch_touch_and_dock(host, scene, places):
    dock = scene.world.dock
    for place in places:
        # The place itself is reached, so nobody asks for one in the dock's body
        apart = math.dist(place, (dock.x, dock.y))
        assume(apart < 1.0 or apart > dock.body + 1.0)
    # Leaving the printer looks for what was hit
    with Printer(host, scene) as printer:
        try:
            printer.homed()
            run(printer, places)
        except GcodeError as error:
            # The toolhead is in a corner behind the circle, or asked into the dock
            words = ("no way from", "is in the dock; MOVE_TO_DOCK_PROBE")
            if not any(text in str(error) for text in words):
                raise
            event("no way around the dock")
            assert where(printer) in ("docked", "attached")


def run(printer, places):
    """Fetch, touch and dock, each from another place."""
    assert trips(printer) == ["attach", "dock"]
    go = "\nMOVE_AVOIDING_DOCK X=%d Y=%d SPEED=200"
    printer.run("G90\nG1 Z12" + go % places[0] + "\nATTACH_PROBE")
    assert where(printer) == "attached"
    printer.run("PROBE_ACCURACY SAMPLES=2" + go % places[1] + "\nPROBE")
    assert where(printer) == "attached"
    printer.run(go % places[2] + "\nDETACH_PROBE")
    assert where(printer) == "docked"
    # Out of the dock itself, and by a whole trip
    printer.run("MOVE_TO_DOCK_PROBE" + go % places[0] + "\nMOVE_TO_DOCK_PROBE")
    printer.run("MOVE_TO_DETACH_PROBE" + go % places[1] + "\nPROBE")
    assert where(printer) == "docked"
