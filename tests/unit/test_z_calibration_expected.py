"""What earlier runs say of switch - nozzle, and which heights follow from them."""

from __future__ import annotations

import pytest

from z_touch.z_calibration import expected, heights

# switch - nozzle is 7.0
LAST = heights.Result(8.5, 8.0, 1.0, 0.5, 1.0)


def geometry(body, last=LAST, departure=None):
    compared = expected.Geometry(expected.Earlier(last, True, departure, None))
    compared.compare(body)
    return compared


def test_first_run_and_one_like_the_last_are_not_odd():
    for compared in (
        geometry(9.0, last=None),
        geometry(7.4),
        geometry(7.0, departure=lambda body: 0.0),
    ):
        assert (compared.departure, compared.problem()) == (0.0, "")


def test_another_nozzle_or_probe_is_told_and_is_no_dirt():
    compared = geometry(7.6, departure=lambda body: 0.04)
    assert compared.departure == 0.0
    assert "is 7.600 mm and was 7.000 mm in the last good" in compared.problem()


def test_what_departs_from_many_runs_is_dirt():
    compared = geometry(6.96, departure=lambda body: body - 7.0)
    assert compared.departure == pytest.approx(-0.04)
    assert "is 6.960 mm and was 7.000 mm in earlier" in compared.problem()
    assert "is -0.040 mm off earlier runs" in compared.dirt()
    # It is measured again
    compared.compare(7.6)
    assert compared.departure == 0.0


def test_body_of_before_holds_as_long_as_the_frame():
    for holds, body in ((True, 7.0), (False, None)):
        earlier = expected.Earlier(LAST, holds, None, None)
        assert expected.Expectations(None, earlier).body() == body
