"""Tables and chart of the benchmark, from figures made by hand."""

from __future__ import annotations

import copy

import pytest

from tests.bench import chart, performance_tables, text

RUN = {
    "seconds": 22.75,
    "bound": 17.618,
    "ratio": 1.291,
    "touches": {"nozzle_pin": 3, "probe_bed": 4},
    "cpu": 0.2,
    "idle_cpu": 0.05,
}
AGAIN = {**RUN, "seconds": 26.01, "ratio": 1.18, "cpu": 0.3}
ERROR = {
    "host": "h1",
    "module": "ours",
    "command": "CALIBRATE_Z",
    "noise": "0 um",
    "seeds": 50,
    "mean": -0.62,
    "sigma": 1.54,
    "worst": -2.97,
    "refused": 0,
    "failed": 0,
    "reasons": {},
}
OTHER = {**ERROR, "module": "theirs.py", "sigma": 3.08}
NOISY = {**ERROR, "noise": "10 um", "mean": 4.0, "refused": 12, "failed": 1}
TIMING = {
    "host": "h1",
    "module": "ours",
    "command": "CALIBRATE_Z",
    "failure": None,
    "runs": [RUN, AGAIN, RUN],
}
COST = {
    "host": "h1",
    "module": "z_calibration",
    "import_ms": 3.59,
    "memory_kib": 471.2,
    "other": False,
}
FIGURES = {
    "about": {"revision": "abc1234", "python": "3.11.7", "processor": "CPU"},
    "timings": [
        TIMING,
        {**TIMING, "module": "theirs.py"},
        {**TIMING, "host": "h2", "runs": [], "failure": "does not start"},
    ],
    "costs": [COST, {**COST, "module": "theirs.py", "other": True}],
    "errors": [ERROR, NOISY, OTHER],
}


def test_time_table():
    heads, _, row = performance_tables.time_table(FIGURES)
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[:7] == [
        "CALIBRATE_Z",
        "h1",
        "22.8",
        "17.6",
        "1.29",
        "26.0",
        "1.18",
    ]
    # CPU: the middle one of three
    assert cells[7:] == ["nozzle_pin 3, probe_bed 4", "0.20", "0.05"]
    assert heads.count("|") == row.count("|")


def test_error_table():
    heads, _, row = performance_tables.error_table(FIGURES)
    assert heads == "| command | host | 0 um | 10 um |"
    assert row == (
        "| CALIBRATE_Z | h1 | -0.6 (1.5) -3.0 |"
        " +4.0 (1.5) -3.0 12 refused 1 FAILED |"
    )


def test_cost_table():
    assert performance_tables.cost_table(FIGURES)[2:] == [
        "| z_calibration | h1 | 3.6 | 471 |"
    ]


def test_document_is_changed_between_the_markers_only(tmp_path):
    file = tmp_path / "document.md"
    around = "before\n{}old{}\nafter\n"
    file.write_text(
        around.format(performance_tables.BEGIN, performance_tables.END)
    )
    for _ in range(2):
        performance_tables.update(file, FIGURES)
        written = file.read_text()
        middle = f"\n\n{performance_tables.render(FIGURES)}\n\n"
        assert written == around.replace("old", middle).format(
            performance_tables.BEGIN, performance_tables.END
        )


def test_document_without_markers_is_refused(tmp_path):
    file = tmp_path / "document.md"
    file.write_text(performance_tables.BEGIN)
    with pytest.raises(ValueError, match="markers"):
        performance_tables.update(file, FIGURES)
    assert file.read_text() == performance_tables.BEGIN


def test_missing_numbers_are_a_dash():
    empty = {**ERROR, "mean": None, "sigma": None, "worst": None, "refused": 50}
    assert text.summary_text(empty) == "- (-) - 50 refused"


def test_errors_beside_those_of_another_module():
    lines = text.error_lines(FIGURES["errors"])
    assert "error over 50 seeds" in lines[0]
    assert "    sigma, ours / theirs.py: 0.50" in lines


def test_costs_beside_those_of_another_module():
    line = text.cost_lines(FIGURES["costs"])[-1]
    assert line.split() == ["ours", "/", "theirs.py", "1.00", "1.00"]


def test_reasons_are_counted_over_all():
    errors = [
        {**ERROR, "reasons": {"a": 1, "b": 2}},
        {**ERROR, "reasons": {"a": 3}},
    ]
    assert text.reason_lines(errors) == ["  4 x ours: a", "  2 x ours: b"]


def test_chart_shows_what_is_ours():
    content = chart.content(FIGURES)
    assert content["bars"] == [
        {
            "command": "CALIBRATE_Z",
            "host": "h1",
            "seconds": 22.75,
            "bound": 17.618,
            "label": "22.8 s, 1.29x",
        }
    ]
    shown = [(p["noise"], p["mean"], p["worst"]) for p in content["points"]]
    assert shown == [("0 um", -0.62, -2.97), ("10 um", 4.0, -2.97)]
    assert content["seeds"] == 50


def test_digest_of_the_chart_follows_what_it_shows():
    other = copy.deepcopy(FIGURES)
    other["about"]["processor"] = "another"
    assert chart.content(other)["digest"] == chart.content(FIGURES)["digest"]
    other["errors"][0]["worst"] = 9.0
    assert chart.content(other)["digest"] != chart.content(FIGURES)["digest"]
