"""How random printers are drawn, bounded and counted, without a host."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from simprinter.world import NoiseSpec, Touch
from tools.campaign import drawn_printers
from tools.campaign.drawing import deviations
from tools.campaign.drawn_machines import KINEMATICS, Gantry, Sampling, inverted
from tools.campaign.drawn_printers import MODULES, Report, run
from tools.campaign.gap_bounds import (
    Interval,
    frame_bound,
    has_outlier,
    hidden_outlier,
    may_differ,
)
from tools.campaign.judge import Verdict, WrongError

MODULE = "z_calibration"
RIGHT = Verdict(error=-0.002, bound=0.004, penetration=0.1)


@pytest.fixture
def any_host(tmp_path):
    """What draws of printers ask of a host, with all kinematics."""
    folder = tmp_path / "base" / "kinematics"
    folder.mkdir(parents=True)
    for name in KINEMATICS:
        (folder / f"{name}.py").touch()
    layout = SimpleNamespace(module_dir="extras")
    return SimpleNamespace(name="any", layout=layout, directory=tmp_path)


@pytest.fixture
def judged(monkeypatch):
    """judged(judge): printers are judged by that; all that were."""
    seen = []

    def install(judge):
        def try_out(drawn, host, modules):
            seen.append(drawn)
            return judge(drawn)

        monkeypatch.setattr(drawn_printers, "try_out", try_out)
        return seen

    return install


def no_mistake(drawn):
    """A judge whom only a mistake annoys."""
    if drawn.mistake:
        raise WrongError("a mistake")
    return RIGHT


@pytest.mark.parametrize("module", MODULES)
def test_same_seed_draws_the_same_printers(any_host, judged, module):
    seen = judged(lambda drawn: RIGHT)
    run(module, any_host, 5, seed=7)
    run(module, any_host, 5, seed=7)
    assert seen[:5] == seen[5:]
    assert len(set(seen)) == 5


@pytest.mark.slow
@pytest.mark.parametrize("module", MODULES)
def test_draws_are_of_all_kinds(any_host, judged, module):
    seen = judged(lambda drawn: drawn.scene and RIGHT)
    assert not run(module, any_host, 60, seed=1).failures
    kinematics = {printer.gantry.kinematics for printer in seen}
    assert kinematics == set(KINEMATICS)
    assert {len(printer.gantry.names) for printer in seen} == {1, 2, 3, 4}
    mistaken = [printer for printer in seen if printer.mistake]
    assert 10 < len(mistaken) < 30


@pytest.mark.parametrize("board", ["", "probe"])
@pytest.mark.parametrize("module", MODULES)
def test_every_mistake_changes_the_scene(module, board):
    standard = MODULES[module]()
    assert list(deviations(standard)) == []
    standard = replace(standard, other_board=board)
    for mistake in standard.mistakes:
        assert replace(standard, mistake=mistake).scene != standard.scene


def test_failure_is_made_simpler_and_drawn_again_by_its_seed(any_host, judged):
    seen = judged(no_mistake)
    report = run(MODULE, any_host, 30, seed=1, most_failures=1)
    (failure,) = report.failures
    simplest = re.search(r"simplest: (.*)", failure).group(1)
    assert simplest.startswith("mistake=")
    number = re.search(r"--seed (\d+) --count 1", failure).group(1)
    first = next(printer for printer in seen if printer.mistake)
    seen.clear()
    run(MODULE, any_host, 1, seed=int(number), simpler=0)
    assert seen == [first]


def test_campaign_that_refuses_healthy_printers_fails(any_host, judged):
    refused = Verdict(refused="not today at z=1.5 (2 mm)\nRestart")
    judged(lambda drawn: RIGHT if drawn.mistake else refused)
    report = run(MODULE, any_host, 40, seed=1)
    assert not report.failures
    assert report.healthy == report.healthy_refused > 20
    assert "100% of the healthy printers were refused" in report.text()
    assert set(report.refused) == {"not today at z=# (# mm)"}


def test_reports_are_added(any_host, judged):
    judged(lambda drawn: RIGHT)
    both = Report()
    for seed in (1, 5):
        both.add(run(MODULE, any_host, 4, seed=seed))
    assert both == run(MODULE, any_host, 8, seed=1)
    assert (both.runs, both.right) == (8, 8)
    assert (both.worst_um, both.worst) == (2.0, 0.5)


def test_error_counts_from_the_nearest_right_gap():
    errors = [Interval(0.1, 0.2, 0.0).error(gap) for gap in (0.0, 0.15, 0.25)]
    assert errors == pytest.approx([-0.1, 0.0, 0.05])


def test_frame_moves_with_every_way_that_is_no_whole_step():
    gantry, retracts = Gantry(), {"a": 2.001, "b": 2.0}
    for sites, steps, more in (
        ("ab", 2.0, 0.0),
        ("aab", 2.0, 0.001),
        ("abb", 2.0, 0.0),
        ("aba", 2.5, 0.0),
    ):
        touches = [Touch(0.0, site, 0.0, 0.0, 0.0, 0.0) for site in sites]
        wanted = steps * gantry.step + more
        assert frame_bound(gantry, touches, retracts) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("samples", "tolerance", "hidden"),
    [(1, 0.01, 0.1), (2, 0.01, 0.1), (3, 0.01, 0.0), (3, 0.2, 0.1)],
)
def test_outlier_hides_where_samples_cannot_tell_it(samples, tolerance, hidden):
    noise = NoiseSpec(outlier_chance=0.02, outlier_size=-0.1)
    sampling = Sampling(tolerance=tolerance)
    assert hidden_outlier(noise, sampling, samples, 0.0025) == hidden


@pytest.mark.parametrize(
    ("chance", "far", "found"),
    [(0.02, 0.06, True), (0.02, 0.04, False), (0.0, 0.06, False)],
)
def test_outlier_is_known_by_its_height(chance, far, found):
    noise = NoiseSpec(outlier_chance=chance, outlier_size=0.1)
    touches = [Touch(0.0, "a", 0.0, 0.0, 0.0, 0.0)]
    assert has_outlier(touches, noise, lambda touch: far) is found


def test_samples_may_differ_by_their_noise():
    sampling = Sampling(tolerance=0.02)
    assert not may_differ(NoiseSpec(sigma=0.001), sampling, 0.0025)
    assert may_differ(NoiseSpec(sigma=0.002), sampling, 0.0025)


@pytest.mark.parametrize(
    ("pin", "other"),
    [("^PC2", "^!PC2"), ("^!PC2", "^PC2"), ("PC1", "!PC1"), ("!PC1", "PC1")],
)
def test_inverted_pin(pin, other):
    assert inverted(pin) == other
