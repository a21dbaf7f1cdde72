"""Without noise nothing is off by more than two microsteps."""

from __future__ import annotations

import pytest

from tools.bench import errors
from tools.bench.errors import PROCEDURES, Condition, Trial, run_trial

MICROSTEP_UM = 2.5


@pytest.mark.parametrize("name", PROCEDURES)
def test_error_without_noise_is_below_two_microsteps(host, name, monkeypatch):
    monkeypatch.setattr(errors, "OUTLIER_CHANCE", 0.0)
    procedure = PROCEDURES[name]
    found = run_trial(Trial(host, name, Condition(0.0), 3))
    assert list(found) == [n for m in procedure.measurements for n in m.names]
    for error in found.values():
        assert abs(error) < 2.0 * MICROSTEP_UM
