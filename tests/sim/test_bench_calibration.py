"""The benchmark of calibrations, and the time that one may take."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import math
import re
import shutil
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import bench_calibration
from tests.bench_calibration import (
    SCENE,
    SITES,
    STANDARD,
    Limits,
    Part,
    Plan,
    Run,
    Stop,
    Subject,
    attempt,
    bound_table,
    lower_bound,
    main,
    make_plan,
    measure,
    move_seconds,
    ours,
    reason,
    recorded,
    touches_text,
)
from tests.hostkit.hosts import find_hosts
from tests.hostkit.printer import Printer, module_files

MICROSTEP = 0.0025
ROUNDING = 1e-9
CELL = re.compile(r"(\d+\.\d\d)/(\d+\.\d\d)=(\d+\.\d\d)")

distances = st.floats(0.0, 500.0)
speeds = st.floats(0.1, 500.0)
accels = st.floats(1.0, 20000.0)
factors = st.floats(1.0, 100.0)

# Numbers to calculate with by hand
SIMPLE = Plan(
    stops=(Stop("pin", 30.0, 40.0, 8.0, 2, 2.0, 2.0, 20.0),),
    travel_z=20.0,
    travel_speed=50.0,
    approach_speed=5.0,
    limits=Limits(100.0, 1000.0, 10.0, 100.0),
)


# A move


@pytest.mark.parametrize(
    "distance, speed, accel, stops, seconds",
    [
        # Trapezoids: distance / speed, and half a ramp's time for each ramp
        (50.0, 50.0, 1000.0, True, 1.05),
        (10.0, 10.0, 100.0, True, 1.1),
        (2.0, 2.0, 100.0, False, 1.01),
        # Triangles: half way up, half way down; all the way up
        (1.0, 10.0, 4.0, True, 1.0),
        (2.0, 10.0, 4.0, False, 1.0),
        # Where both are the same
        (2.0, 2.0, 2.0, True, 2.0),
        (1.0, 2.0, 2.0, False, 1.0),
        (0.0, 10.0, 100.0, True, 0.0),
        (0.0, 10.0, 100.0, False, 0.0),
    ],
)
def test_move_is_calculated_right(distance, speed, accel, stops, seconds):
    found = move_seconds(distance, speed, accel, stops)
    assert found == pytest.approx(seconds)


@given(distances, speeds, accels, st.booleans(), factors)
def test_move_is_never_longer_when_something_is_faster(
    distance, speed, accel, stops, factor
):
    seconds = move_seconds(distance, speed, accel, stops) + ROUNDING
    assert move_seconds(distance, speed * factor, accel, stops) <= seconds
    assert move_seconds(distance, speed, accel * factor, stops) <= seconds
    assert move_seconds(distance / factor, speed, accel, stops) <= seconds
    assert move_seconds(distance, speed, accel, False) <= seconds


@given(distances, distances, speeds, accels)
def test_move_is_never_longer_than_in_two_parts(first, second, speed, accel):
    parts = move_seconds(first, speed, accel) + move_seconds(
        second, speed, accel
    )
    assert move_seconds(first + second, speed, accel) <= parts + ROUNDING


@given(distances, speeds, accels, st.booleans())
def test_move_is_never_faster_than_speed_and_acceleration(
    distance, speed, accel, stops
):
    seconds = move_seconds(distance, speed, accel, stops)
    assert seconds >= distance / speed - ROUNDING
    assert seconds >= math.sqrt(2.0 * distance / accel) - ROUNDING


# The lower bound


def by_part(parts):
    return {(part.site, part.what): part.seconds for part in parts}


def seconds_of(parts):
    return math.fsum(part.seconds for part in parts)


def test_bound_of_one_site():
    parts = by_part(lower_bound(SIMPLE, (0.0, 0.0, 10.0)))
    assert parts == pytest.approx(
        {
            ("pin", "lift"): 1.1,  # 10 mm at 10 mm/s, all that Z can
            ("pin", "travel"): 1.05,  # 50 mm at 50 mm/s
            ("pin", "approach"): 2.05,  # 10 mm at 5 mm/s
            ("pin", "samples"): 2.02,  # twice 2 mm at 2 mm/s
            ("pin", "retracts"): 0.3,  # 2 mm at 10 mm/s, between them
            ("end", "lift"): 1.3,  # 12 mm at 10 mm/s
        }
    )


def test_bound_where_the_head_is_there_already():
    parts = by_part(lower_bound(SIMPLE, (30.0, 40.0, 15.0)))
    assert parts["pin", "lift"] == parts["pin", "travel"] == 0.0
    assert parts["pin", "approach"] == pytest.approx(1.05)  # 5 mm


def test_bound_from_above_has_no_lift():
    parts = by_part(lower_bound(SIMPLE, (0.0, 0.0, 60.0)))
    assert parts["pin", "lift"] == 0.0
    assert parts["pin", "approach"] == pytest.approx(2.05)


def test_next_site_begins_at_the_touch_of_the_last():
    other = SIMPLE.stops[0]._replace(name="bed", x=0.0, trigger_z=18.5)
    plan = SIMPLE._replace(stops=(*SIMPLE.stops, other))
    parts = by_part(lower_bound(plan, (0.0, 0.0, 10.0)))
    assert parts["bed", "lift"] == pytest.approx(1.3)  # 8 to 20
    assert parts["bed", "travel"] == pytest.approx(0.65)  # 30 mm
    assert parts["bed", "approach"] == 0.0  # begins above the travel height
    assert parts["end", "lift"] == pytest.approx(0.25)  # 1.5 mm at 10 mm/s


def test_plan_of_the_standard_machine():
    plan = make_plan(SCENE, STANDARD)
    assert plan.limits == Limits(300.0, 3000.0, 15.0, 350.0)
    assert (plan.travel_z, plan.travel_speed) == (15.0, 50.0)
    assert plan.approach_speed == 8.0
    pin, bed = (3, 2.0, 2.0, 10.0), (3, 5.0, 2.0, 10.0)
    assert [stop.name for stop in plan.stops] == ["nozzle", "switch", "bed"]
    assert [stop[1:3] for stop in plan.stops] == [
        (206.0, 306.0),
        (208.0, 281.25),
        (152.0, 125.25),
    ]
    assert [stop[4:] for stop in plan.stops] == [pin, pin, bed]
    heights = [stop.trigger_z for stop in plan.stops]
    assert heights == pytest.approx([1.6, 8.015, 7.0138])


@given(
    st.sampled_from(
        [
            ("z_calibration", "speed"),
            ("z_calibration", "lift_speed"),
            ("z_calibration", "probing_speed"),
            ("z_calibration", "probing_second_speed"),
            ("probe", "speed"),
            ("probe", "lift_speed"),
            ("printer", "max_velocity"),
            ("printer", "max_accel"),
            ("printer", "max_z_velocity"),
            ("printer", "max_z_accel"),
        ]
    ),
    st.floats(0.5, 400.0),
    factors,
    st.tuples(
        st.floats(0.0, 300.0), st.floats(0.0, 300.0), st.floats(0.0, 100.0)
    ),
)
def test_bound_is_never_longer_when_something_is_faster(
    option, value, factor, start
):
    def bound(number):
        section, name = option
        changed = {**STANDARD.get(section, {}), name: f"{number:.6f}"}
        plan = make_plan(SCENE, {**STANDARD, section: changed})
        return seconds_of(lower_bound(plan, start))

    assert bound(value * factor) <= bound(value) + ROUNDING


def test_table_adds_up():
    parts = lower_bound(make_plan(SCENE, STANDARD), (206.0, 306.0, 10.0))
    lines = bound_table(parts, (206.0, 306.0, 10.0))
    assert "X206.0 Y306.0 Z10.0" in lines[0]
    rows = {line.split()[0]: line.split()[1:] for line in lines[2:]}
    assert list(rows) == ["nozzle", "switch", "bed", "end", "all"]
    assert rows["all"][-1] == f"{seconds_of(parts):.2f}"
    assert rows["nozzle"][:2] == ["0.00", "0.00"]
    assert sum(float(rows[name][-1]) for name in list(rows)[:-1]) == (
        pytest.approx(seconds_of(parts), abs=0.02)
    )


# What a run has done


def test_ratio_is_measured_by_bound():
    parts = (Part("a", "lift", 1.5), Part("b", "lift", 2.5))
    run = Run("again", (0.0, 0.0, 0.0), 6.0, parts, 9, {})
    assert (run.bound, run.ratio) == (4.0, 1.5)


def test_recorded_samples():
    own = "// z_calibration: nozzle: touched at z=1.600000"
    host = "// probe at 152.000,125.250 is z=7.013750"
    # Our lines come with those of the host's own probing
    assert recorded([own, own, own, host]) == 3
    assert recorded([host, host]) == 2
    assert recorded(["// something else"]) is None


def test_touches_in_words():
    counts = {"probe_bed": 3, "nozzle_pin": 4, "nozzle_bed": 1}
    assert touches_text(counts) == "4+0+3 nozzle_bed:1"


@functools.cache
def measured(host):
    """The runs on a host; kept, as several tests look at them."""
    return measure(host, ours())


def test_standard_machine_is_calibrated_in_time(host):
    first = measured(host)[0]
    assert first.seconds <= 25.0
    assert first.samples == 9
    assert 9 <= sum(first.touches.values()) <= 10
    assert all(first.touches[site] >= 3 for site in SITES)


def test_no_run_beats_the_lower_bound(host):
    runs = measured(host)
    assert [run.name for run in runs] == [
        "after G28",
        "again",
        "after G28 again",
    ]
    for run in runs:
        assert run.seconds > run.bound
        assert run.samples == 9
    # In the same frame the head comes from the bed
    first, again, _ = runs
    assert first.start[:2] == pytest.approx((206.0, 306.0))
    assert again.start[:2] == pytest.approx((152.0, 125.25))


def test_touches_are_counted(one_host):
    section = {
        **STANDARD["z_calibration"],
        "samples": "2",
        "probing_first_fast": "true",
    }
    for run in measure(
        one_host, ours(), {**STANDARD, "z_calibration": section}
    ):
        # A quick touch at each site, then two on the pin and three on the bed
        counts = [run.touches[site] for site in SITES]
        assert counts == [3, 3, 4]
        assert sum(run.touches.values()) == 10
        assert run.samples == 7


def test_true_heights_are_those_of_the_touches(one_host):
    plan = make_plan(SCENE, STANDARD)
    with Printer(
        one_host, SCENE, changes=STANDARD, modules=module_files()
    ) as printer:
        printer.homed().run("CALIBRATE_Z\nM400")
        touches = printer.machine.truth.touches
    frame = plan.stops[0].trigger_z - SCENE.world.pin.z
    for site, stop in zip(SITES, plan.stops):
        last = [touch for touch in touches if touch.site == site][-1]
        height = last.trigger_z + frame
        assert height == pytest.approx(stop.trigger_z, abs=MICROSTEP)
        assert last.x == pytest.approx(stop.x, abs=0.02)
        assert last.y == pytest.approx(stop.y, abs=0.02)


# The program

MODULES = {
    "same": None,
    "no_python": "this is no module\n",
    "no_start": "def load_config(config):\n    raise config.error('not me')\n",
    # Klippy insists on somebody reading every option
    "no_command": (
        "def load_config(config):\n"
        "    for option in config.get_prefix_options(''):\n"
        "        config.get(option)\n"
    ),
    "dead": "import os\ndef load_config(config):\n    os._exit(3)\n",
}
REASONS = {
    "no_python": "z_calibration",
    "no_start": "not me",
    "dead": "klippy has ended",
    "missing": "there is no file",
}


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """One run of it with many modules: files by name, output, figures."""
    folder = tmp_path_factory.mktemp("bench")
    files = {"missing": folder / "missing.py"}
    for name, text in MODULES.items():
        files[name] = folder / f"{name}.py"
        if text is None:
            shutil.copy(module_files()["z_calibration"], files[name])
        else:
            files[name].write_text(text)
    host = find_hosts()[-1].name
    # The one that works comes last, after all that do not
    order = sorted(files, key=lambda name: name == "same")
    options = [word for name in order for word in ("--module", files[name])]
    written = folder / "figures.json"
    options += ["--builtin", "--host", host, "--json", written]
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        status = main([str(option) for option in options])
    figures = {
        entry["module"]: entry
        for entry in json.loads(written.read_text())
        if entry["host"] == host
    }
    return SimpleNamespace(
        host=host,
        status=status,
        files=files,
        lines=output.getvalue().splitlines(),
        figures=figures,
    )


def line_of(program, name):
    """The line of a module on the program's host."""
    begin = program.lines.index(program.host)
    found = [
        line for line in program.lines[begin:] if line.startswith(f"  {name}  ")
    ]
    return found[0]


def test_only_chosen_hosts_are_measured(program):
    names = {host.name for host in find_hosts()}
    shown = {line for line in program.lines if line in names}
    assert shown == {name for name in names if program.host in name}


def test_module_that_does_not_run_is_reported_with_the_reason(program):
    assert program.status == 0
    for name, words in REASONS.items():
        file = str(program.files[name])
        assert words in program.figures[file]["failure"]
        assert program.figures[file]["runs"] == []
        assert words in line_of(program, file)
        assert not CELL.search(line_of(program, file))


def test_module_without_calibration_is_reported(program):
    entry = program.figures[str(program.files["no_command"])]
    # Klippy says so on the console only
    assert "has not touched nozzle_pin, body_pin, probe_bed" in entry["failure"]


def test_own_module_of_the_host(program):
    entry = program.figures["the host's own"]
    if program.host.startswith("klipper"):
        assert "z_calibration" in entry["failure"]
    else:
        assert len(entry["runs"]) == len(bench_calibration.RUNS)


def test_printed_ratios_are_measured_by_bound(program):
    for name in ("ours", str(program.files["same"])):
        runs = program.figures[name]["runs"]
        cells = CELL.findall(line_of(program, name))
        assert len(cells) == len(runs) == 3
        for (seconds, bound, ratio), run in zip(cells, runs):
            parts = math.fsum(part["seconds"] for part in run["parts"])
            assert float(bound) == pytest.approx(parts, abs=0.006)
            assert float(seconds) == pytest.approx(run["seconds"], abs=0.006)
            wanted = run["seconds"] / parts
            assert run["ratio"] == pytest.approx(wanted)
            assert float(ratio) == pytest.approx(wanted, abs=0.006)
        assert re.search(r" 9  3\+3\+3$", line_of(program, name))


def test_ours_is_compared_with_theirs(program):
    file = str(program.files["same"])
    printed = line_of(program, f"ours / {file}").split()[-3:]
    runs = zip(program.figures["ours"]["runs"], program.figures[file]["runs"])
    for text, (first, other) in zip(printed, runs):
        wanted = first["seconds"] / other["seconds"]
        assert float(text) == pytest.approx(wanted, abs=0.006)
        assert wanted == pytest.approx(1.0, abs=0.1)
    for name in REASONS:
        compared = f"ours / {program.files[name]}"
        assert not any(compared in line for line in program.lines)


def test_every_start_has_its_lower_bound(program):
    tables = [line for line in program.lines if "lower bound from" in line]
    starts = {
        tuple(round(p, 1) for p in run["start"])
        for entry in program.figures.values()
        for run in entry["runs"]
    }
    assert len(tables) == len(starts)


def test_reason_is_one_line():
    assert reason(ValueError("error: no\nlog\nlog")) == "error: no"
    assert reason(ValueError("the machine was hurt:\n  a: 1\n  b: 2")) == (
        "the machine was hurt: a: 1"
    )
    assert reason(ValueError()) == "ValueError()"


def test_unknown_host_is_said(capsys):
    assert main(["--host", "no such host"]) == 1
    assert "no such host" in capsys.readouterr().out


def test_own_failure_is_the_programs(monkeypatch, capsys, one_host, tmp_path):
    missing = Subject("ours", {"z_calibration": tmp_path / "missing.py"})
    assert "there is no file" in attempt(one_host, missing)
    monkeypatch.setattr(bench_calibration, "ours", lambda: missing)
    assert main(["--host", one_host.name]) == 1
    assert "there is no file" in capsys.readouterr().out
