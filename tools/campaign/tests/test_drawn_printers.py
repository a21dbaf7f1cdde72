"""What is drawn wrong is wrong, and what is right may not be refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tools.campaign import drawn_printers
from tools.campaign.drawing import deviations
from tools.campaign.drawn_printers import MODULES, run
from tools.campaign.judge import Verdict

RIGHT = Verdict(error=-0.002, bound=0.004, penetration=0.1)
REFUSED = Verdict(refused="not today at z=1.5 (2 mm)\nRestart")


@pytest.mark.parametrize("board", ["", "probe"])
@pytest.mark.parametrize("module", MODULES)
def test_every_mistake_changes_the_scene(module, board):
    standard = MODULES[module]()
    assert list(deviations(standard)) == []
    standard = replace(standard, other_board=board)
    for mistake in standard.mistakes:
        assert replace(standard, mistake=mistake).scene != standard.scene


def test_campaign_that_refuses_healthy_printers_fails(host, monkeypatch):
    def judge(drawn, on, modules):
        return RIGHT if drawn.mistake else REFUSED

    monkeypatch.setattr(drawn_printers, "try_out", judge)
    report = run("z_calibration", host, 40, seed=1)
    assert not report.failures
    assert report.healthy == report.healthy_refused > 20
    assert "100% of the healthy printers were refused" in report.text()
    assert set(report.refused) == {"not today at z=# (# mm)"}
