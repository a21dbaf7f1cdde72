"""Tables, lines and chart of the benchmark, from figures made by hand."""

from __future__ import annotations

import pytest

from tools.bench import chart, performance_tables, text

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
    "reasons": {"a": 1, "b": 2},
}
OTHER = {**ERROR, "module": "theirs.py", "sigma": 3.08, "reasons": {}}
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


def test_tables_have_the_figures_of_ours_that_did_not_fail():
    lines = performance_tables.render(FIGURES).splitlines()
    rows = [line for line in lines if " | h1 | " in line]
    assert rows == [
        # CPU: the middle one of three
        "| CALIBRATE_Z | h1 | 22.8 | 17.6 | 1.29 | 26.0 | 1.18"
        " | nozzle_pin 3, probe_bed 4 | 0.20 | 0.05 |",
        "| CALIBRATE_Z | h1 | -0.6 (1.5) -3.0"
        " | +4.0 (1.5) -3.0 12 refused 1 FAILED |",
        "| z_calibration | h1 | 3.6 | 471 |",
    ]


def test_document_is_changed_between_the_markers_only(tmp_path):
    file = tmp_path / "document.md"
    begin, end = performance_tables.BEGIN, performance_tables.END
    file.write_text(f"before\n{begin}old{end}\nafter\n")
    middle = performance_tables.render(FIGURES)
    for _ in range(2):
        performance_tables.update(file, FIGURES)
        assert file.read_text() == (
            f"before\n{begin}\n\n{middle}\n\n{end}\nafter\n"
        )
    file.write_text(begin)
    with pytest.raises(ValueError, match="markers"):
        performance_tables.update(file, FIGURES)
    assert file.read_text() == begin


def test_lines_compare_ours_with_theirs():
    lines = text.error_lines(FIGURES["errors"])
    assert "    sigma, ours / theirs.py: 0.50" in lines
    line = text.cost_lines(FIGURES["costs"])[-1]
    assert line.split() == ["ours", "/", "theirs.py", "1.00", "1.00"]
    lines = text.reason_lines(FIGURES["errors"])
    assert lines == ["  4 x ours: b", "  2 x ours: a"]
    none = {**ERROR, "mean": None, "sigma": None, "worst": None, "refused": 50}
    assert text.summary_text(none) == "- (-) - 50 refused"


def test_chart_shows_what_is_ours():
    content = chart.content(FIGURES)
    (bar,) = content["bars"]
    assert (bar["host"], bar["label"]) == ("h1", "22.8 s, 1.29x")
    shown = [(p["noise"], p["mean"], p["worst"]) for p in content["points"]]
    assert shown == [("0 um", -0.62, -2.97), ("10 um", 4.0, -2.97)]
    # By its digest a test finds a chart of other figures
    other = {**FIGURES, "errors": [{**ERROR, "worst": 9.0}, NOISY]}
    assert chart.content(other)["digest"] != content["digest"]
