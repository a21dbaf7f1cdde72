"""What tools/bench/warm.py shows, in its order of magnitude."""

from __future__ import annotations

import pytest

from tools.bench import warm

# um by which the nozzle comes lower in all (simprinter/real.py), and what the switches
# vary by in one run
WHOLE = 47.0
NOISE = 8.0


@pytest.mark.slow
def test_twenty_runs_in_a_row_drift_and_each_gap_is_right(host):
    """48 um in the plot that the printer is made of; homing takes most of it."""
    alone, homed = warm.row(host), warm.row(host, "G28 Z")
    assert 35.0 <= alone.range <= 60.0
    assert homed.range <= 0.5 * alone.range
    for found in (alone, homed):
        assert max(map(abs, found.errors)) <= NOISE


@pytest.mark.slow
def test_calibration_right_before_the_print_takes_what_has_grown(host):
    early = "CALIBRATE_Z"
    stale = warm.printed(host, 15, "", early)
    rehomed = warm.printed(host, 15, "G28 Z", early)
    fresh = warm.printed(host, 15, "G28 Z\nCALIBRATE_Z")
    assert stale.first_layer == pytest.approx(-WHOLE, abs=NOISE + 2.0)
    assert abs(rehomed.first_layer) < 0.5 * WHOLE
    assert abs(fresh.first_layer) <= NOISE
    # Nothing grows any more
    assert abs(fresh.later) <= NOISE + 2.0
    # What grows later no calibration knows of
    cold = warm.printed(host, 0, "G28 Z\nCALIBRATE_Z")
    assert abs(cold.first_layer) <= NOISE
    assert cold.later < -0.7 * WHOLE
