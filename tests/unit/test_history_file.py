"""z_touch/history/file.py: the file, whatever happens to it, and its threads."""

from __future__ import annotations

import json
import math
import os
import random
import resource
import threading
import time

import pytest

from tests.unit.stretches import AT_A_STRETCH, Stretches
from tools.kit.runs import make_run, make_runs
from z_touch.history import file as history


@pytest.fixture
def file(tmp_path):
    return history.File(str(tmp_path / "z_calibration"), 10)


def add(file, count, **changes):
    for run in make_runs(count, **changes):
        file.append(run)


def whole(file):
    with open(file.path, "rb") as f:
        data = f.read()
    assert data.endswith(b"\n")
    return [json.loads(line) for line in data.splitlines()]


# The file


def test_runs_are_read_as_they_were_written(file):
    runs = make_runs(3)
    for run in runs:
        file.append(run)
    assert file.read() == (runs, 0)


def test_no_file_is_no_run(file):
    assert file.read() == ([], 0)


def test_oldest_runs_go(file):
    for number in range(13):
        file.append(make_run(random.Random(1), time=number))
    assert [run["time"] for run in whole(file)] == list(range(3, 13))
    assert [run["time"] for run in file.read()[0]] == list(range(3, 13))


def test_line_cut_by_a_power_loss_costs_itself_only(file):
    add(file, 3)
    with open(file.path, "r+b") as f:
        f.truncate(len(f.read()) - 40)
    file.append(make_run(random.Random(1), time=99.0))
    runs, damaged = file.read()
    assert (len(runs), damaged) == (3, 1)
    assert runs[-1]["time"] == 99.0


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"hello",
        b"[]",
        b"\xff\xfe\x00",
        b'{"ok": 1}',
        b'{"ok": true, "time": 1, "sites": {}}',
        b'{"ok": false, "time": "now", "sites": {}}',
        b'{"ok": false, "time": NaN, "sites": {}}',
        b'{"ok": false, "time": 1e300, "sites": {}}',
        b'{"ok": false, "time": 1, "sites": {"nozzle": 1.6}}',
        b'{"ok": false, "time": 1, "sites": {"pin": {}}}',
        b'{"ok": false, "time": 1, "sites": {"nozzle": {"z": 1, "sd": 0,'
        b' "n": 2, "samples": ["a"]}}}',
        b'{"ok": false, "time": 1, "sites": {"bed": {"z": 1, "sd": 0, "n": 2,'
        b' "samples": [1], "points": [[1]]}}}',
        b'{"ok": false, "time": 1, "sites": {"bed": {"z": 1, "sd": 0, "n": 2,'
        b' "samples": [1], "points": 1}}}',
        b'{"ok": false, "time": 1, "sites": {}, "bed_spread": "wide"}',
        b'{"ok": false, "time": 1, "sites": {"nozzle": {"z": 1, "sd": 0,'
        b' "n": 2, "samples": [], "absolute": "a"}}}',
        b'{"ok": false, "time": 1, "sites": []}',
        b'{"ok": false, "time": 1, "sites": {}, "temperatures": [1]}',
        b'{"ok": false, "time": 1, "sites": {}, "temperatures": {"a": "b"}}',
        b'{"ok": false, "time": 1, "sites": {}, "uncertainty": "much"}',
        b'{"ok": false, "time": 1, "sites": {}, "wear": 5}',
        b'{"ok": false, "time": 1, "sites": {}, "cycles": "none"}',
        b'{"ok": false, "time": 1, "sites": {}, "cycles": [{"bed": ["a"]}]}',
        b'{"ok": false, "time": 1, "sites": {}, "printer": ["a"]}',
        b'{"ok": false, "time": 1, "sites": {}, "plate": 5}',
        b'{"ok": false, "time": 1, "sites": {}, "extruder": 5}',
        b'{"ok": false, "time": 1, "sites": {}, "nozzle_at": [1]}',
        b'{"ok": false, "time": 1, "sites": {}, "changed": 5}',
        b'{"ok": false, "time": 1, "sites": {}, "format": 3, "warnings": 5}',
        b'{"ok": false, "time": 1, "sites": {}, "format": 3,'
        b' "warnings": ["bed: a"]}',
        b'{"ok": false, "time": 1, "sites": {}, "format": 3,'
        b' "warnings": [{"text": "bed: a"}]}',
        b'{"ok": false, "time": 1, "sites": {}, "format": 3,'
        b' "warnings": [{"about": "bed"}]}',
        b'{"ok": false, "time": 1, "sites": {}, "changed": [5]}',
        b'{"ok": false, "time": 1, "sites": {}, "changed": [{"what": "a"}]}',
        b'{"ok": false, "time": 1, "sites": {}, "changed": [{"by": 1,'
        b' "runs": 0}]}',
    ],
)
def test_line_edited_by_hand_is_left_out_and_stays(file, line):
    add(file, 2)
    with open(file.path, "ab") as f:
        f.write(line + b"\r\n")
    file.append(make_run(random.Random(1)))
    runs, damaged = file.read()
    assert (len(runs), damaged) == (3, 1 if line else 0)
    with open(file.path, "rb") as f:
        assert line in f.read()


def test_refused_run_may_lack_sites(file):
    run = {"ok": False, "time": 1, "sites": {}, "reason": "nothing"}
    file.append(run)
    assert file.read() == ([run], 0)


def test_full_disk_leaves_every_line_whole(file):
    add(file, 3)
    with open(file.path, "rb") as f:
        before = f.read()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 50, limits[1]))
    try:
        with pytest.raises(OSError):
            add(file, 1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with open(file.path, "rb") as f:
        assert f.read() == before
    add(file, 1)
    assert len(whole(file)) == 4


def test_oldest_stay_where_they_cannot_go(file):
    add(file, 10)
    os.mkdir(file.path + ".new")
    with pytest.raises(OSError):
        add(file, 1)
    assert len(whole(file)) == 11
    os.rmdir(file.path + ".new")
    add(file, 1)
    assert len(whole(file)) == 10


@pytest.mark.slow
def test_two_printers_write_into_one_folder(tmp_path):
    files = [history.File(str(tmp_path), 1000) for _ in range(4)]

    def write(file):
        add(file, 25)

    threads = [threading.Thread(target=write, args=(f,)) for f in files]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(whole(files[0])) == 100
    # And with the oldest going all the time
    for file in files:
        file.limit = 5
    threads = [threading.Thread(target=write, args=(f,)) for f in files]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(whole(files[0])) == 5


PRINTERS = ("/home/pi/printer_1_data/config/printer.cfg", "/b/printer.cfg")


def test_each_printer_drops_its_own_lines_only(tmp_path):
    """They are told apart by the whole path, and what nobody can read stays."""
    first, second = (history.File(str(tmp_path), 5, p) for p in PRINTERS)
    add(first, 3, printer=PRINTERS[0])
    with open(first.path, "ab") as f:
        f.write(b"mine\n")
    add(second, 9, printer=PRINTERS[1])
    records, damaged = second.read()
    assert damaged == 1
    assert [r["printer"] for r in records] == [PRINTERS[0]] * 3 + [
        PRINTERS[1]
    ] * 5
    add(first, 4, printer=PRINTERS[0])
    records, damaged = first.read()
    assert (len(records), damaged) == (10, 1)
    assert [r["printer"] for r in records].count(PRINTERS[0]) == 5


def test_each_printer_reads_as_many_runs_as_it_keeps(tmp_path):
    """However many another one has written, with a limit of its own."""
    add(history.File(str(tmp_path), 3), 3, printer=PRINTERS[0])
    add(history.File(str(tmp_path), 50), 20, printer=PRINTERS[1])
    records, _ = history.File(str(tmp_path), 3).read()
    assert [r["printer"] for r in records].count(PRINTERS[0]) == 3
    assert len(records) == 6


def test_lines_of_the_first_format_are_those_of_the_printer(tmp_path):
    """They had the name of printer.cfg only, and no number."""
    path = tmp_path / history.FILE
    old = make_runs(4)
    path.write_text("".join(json.dumps(run) + "\n" for run in old))
    file = history.File(str(tmp_path), 5, PRINTERS[0])
    owner = Owner(file, PRINTERS[0]).begin()
    assert owner.history.status["runs"] == 4
    owner.add(*make_runs(3))
    records, _ = file.read()
    assert [r["printer"] for r in records] == [PRINTERS[0]] * 5
    assert [r.get("format") for r in records] == [None] * 2 + [3] * 3
    # That of another name is none of it
    other = history.File(str(tmp_path), 5, "/c/voron.cfg")
    assert Owner(other, "/c/voron.cfg").begin().history.status["runs"] == 0


@pytest.mark.parametrize("number", [{}, {"format": 2}])
def test_warnings_of_earlier_formats_are_about_what_they_begin_with(number):
    texts = {
        "nozzle: z=1.600 is far": "nozzle",
        "switch: the pin presses": "switch",
        "switch - nozzle is 6.415 mm and was": "switch - nozzle",
        "bed: it moves": "bed",
        "bed_mesh is 0.030 mm at 150, 150": "",
        "z_tilt shifts Z by 0.030 mm": "",
        "5": "",
    }
    run = make_run(random.Random(1), warnings=[*list(texts)[:-1], 5])
    found = history.parse(json.dumps({**run, **number}).encode())
    told = {w["text"]: w["about"] for w in found["warnings"]}
    assert told == texts


@pytest.mark.parametrize("number", [{}, {"format": 2}])
@pytest.mark.parametrize(
    ("words", "cause"),
    [
        ("nothing stands out, the bed varies most; nothing to do", "none"),
        ("only the nozzle's touches vary; clean the nozzle", ""),
        (None, ""),
    ],
)
def test_accuracy_runs_of_earlier_formats_are_good_by_their_words(
    number, words, cause
):
    run = make_run(random.Random(1), cycles=[], verdict=words, **number)
    found = history.parse(json.dumps(run).encode())
    assert (found["cause"], found["verdict"]) == (cause, words)


def test_words_of_this_format_are_no_matter():
    told = {"about": "z_tilt", "text": "nozzle: nothing to do"}
    run = make_run(random.Random(1), cycles=[], warnings=[told], format=3)
    run.update(cause="tip", verdict="nothing to do")
    assert history.parse(json.dumps(run).encode()) == run


def test_lines_of_a_later_format_are_told_and_stay(file):
    add(file, 2)
    with open(file.path, "ab") as f:
        f.write(b'{"format": 4, "ok": "perhaps"}\n')
    owner = Owner(file).begin()
    assert owner.history.status["runs"] == 2
    (text,) = owner.told
    assert "1 lines" in text and "of a later version" in text
    owner.add(*make_runs(1))
    assert [run["format"] for run in whole(file)] == [3, 3, 4, 3]


@pytest.mark.parametrize(
    "line",
    [
        b"[" * 100_000,
        b'{"ok": false, "time": 1, "sites": {}, "a": '
        + b'{"a":' * 20_000
        + b"1"
        + b"}" * 20_000
        + b"}",
        b'{"ok": false, "sites": {}, "time": ' + b"9" * 200_000 + b"}",
        b'{"ok": false, "sites": {}, "time": 1, "reason": "%s"}'
        % (b"a" * 50_000_000),
        b"\0" * 50_000_000,
    ],
    ids=["nested", "nested in a run", "digits", "50 MB", "50 MB of zeros"],
)
def test_no_line_holds_klippy_or_costs_the_others(file, line, monkeypatch):
    """
    Between two pauses no more is read than a few of the longest lines, and a line
    that has no end is not parsed: counted, as time depends on the machine.
    """
    add(file, 3)
    with open(file.path, "ab") as f:
        f.write(line + b"\n")
    stretches, parsed = [0], []
    pieces_of, load = history.pieces_of, history.load

    def counted(f):
        for begins, piece in pieces_of(f):
            stretches[-1] += len(piece)
            yield begins, piece

    def load_counted(piece):
        parsed.append(len(piece))
        return load(piece)

    monkeypatch.setattr(history, "pause", lambda: stretches.append(0))
    monkeypatch.setattr(history, "pieces_of", counted)
    monkeypatch.setattr(history, "load", load_counted)
    at_once = history.LINES_AT_ONCE * history.LONGEST
    file.append(make_run(random.Random(1), time=99.0))
    runs, damaged = file.read()
    assert (len(runs), damaged) == (4, 1)
    assert len(line) < sum(stretches)
    assert max(stretches) <= at_once
    # Nor where the oldest go
    file.limit = 2
    file.append(make_run(random.Random(1), time=99.0))
    assert max(stretches) <= at_once
    assert len(file.read()[0]) == 2
    assert os.path.getsize(file.path) > len(line)
    assert max(parsed) < history.LONGEST


def test_line_that_is_too_long_is_damaged_whatever_it_begins_with(file):
    add(file, 1)
    with open(file.path, "rb") as f:
        line = f.read().rstrip()
    with open(file.path, "ab") as f:
        f.write(line + b" " * history.LONGEST + b"\n")
    runs, damaged = file.read()
    assert (len(runs), damaged) == (1, 1)


def test_digits_without_end_are_no_number():
    """Python would take its time for them."""
    found = history.load(b'{"a": ' + b"9" * 5000 + b"}")
    assert found == {"a": float("inf")}


def test_times_may_be_missing(file):
    """Where the owner does not want them, or has removed them."""
    owner = Owner(file).begin()
    owner.add(*[make_run(random.Random(n), time=0.0) for n in range(3)])
    assert all("time" not in run for run in whole(file))
    runs, damaged = file.read()
    assert ([run["time"] for run in runs], damaged) == ([0.0] * 3, 0)
    assert Owner(file).begin().history.status == owner.history.status


def test_line_is_written_when_the_reactor_has_gone(file):
    """As klippy's own after its end, which has closed its pipe."""
    owner = Owner(file).begin()

    def gone(callback):
        raise TypeError("'NoneType' object is not subscriptable")

    owner.reactor.register_async_callback = gone
    owner.history.add(make_run(random.Random(1)))
    owner.reactor.run()
    assert len(whole(file)) == 1


def test_records_of_a_site():
    found = history.site_record([1.0, 1.001, 1.05, 1.002], 1.0012, 0.0025)
    assert found == {
        "z": 1.0012,
        "sd": 0.001,
        "n": 3,
        "absolute": pytest.approx(0.001 * math.sqrt(math.pi / 3.0), abs=1e-6),
        "samples": [1.0, 1.001, 1.05, 1.002],
    }
    single = history.site_record([1.0], 1.0, 0.0025)
    assert "absolute" not in single
    # At points of a textured plate that is no outlier
    points = [(150.0, 120.0 + i) for i in range(4)]
    rough = history.site_record(found["samples"], 1.0, 0.0025, points=points)
    assert rough["n"] == 4


def test_absolute_deviations_of_earlier_runs_are_known():
    run = make_run(random.Random(1))
    (found,) = history.spreads_in([run], "bed")
    assert found.absolute == run["sites"]["bed"]["absolute"] > 0.0
    del run["sites"]["bed"]["absolute"]
    assert history.spreads_in([run], "bed")[0].absolute is None


def test_spread_is_that_of_all_touches():
    """Rejected ones, too; but neither outliers nor what is no noise at all."""
    rejected = [1.0, 1.009, 1.004, 0.998, 1.006, 1.3]
    found = history.site_record([1.004, 1.006], 1.005, 0.0025, rejected)
    assert found["samples"] == [1.004, 1.006] and found["touches"] == rejected
    assert (found["n"], found["sd"]) == (5, pytest.approx(0.00445, abs=1e-5))


def test_spreads_are_those_of_the_last_twenty_runs():
    """Of refused ones, too."""
    runs = make_runs(5, touches=5) + make_runs(19, 2, touches=3)
    refused = make_run(random.Random(3), ok=False, touches=4)
    del refused["sites"]["switch"]
    spreads = history.spreads_in([*runs, refused], "bed")
    assert [spread.dof for spread in spreads] == [2] * 19 + [3]
    missing = history.spreads_in([*runs, refused], "switch")
    assert [spread.dof for spread in missing] == [2] * 19 + [0]
    assert history.spreads_in([], "bed") == []


# On klippy's main thread


class Reactor:
    """Keeps what a thread hands over."""

    def __init__(self):
        self.calls = []
        # Of whatever else has run in this process
        self.others = set(threading.enumerate())

    def register_async_callback(self, callback):
        self.calls.append(callback)

    def run(self, deadline=5.0):
        """What is handed over until all threads have ended."""
        end = time.monotonic() + deadline
        while set(threading.enumerate()) - self.others:
            assert time.monotonic() < end, "a thread goes on"
            time.sleep(0.005)
        for callback in self.calls:
            callback(0.0)
        self.calls = []


class Owner:
    """A printer's history, and what its owner is told."""

    def __init__(self, file, printer="printer.cfg"):
        self.told, self.reactor = [], Reactor()
        self.history = history.History(
            self.reactor, file, printer, self.told.append
        )

    def begin(self):
        self.history.begin()
        self.reactor.run()
        return self

    def add(self, *runs):
        for run in runs:
            self.history.add(dict(run))
            self.reactor.run()


def test_runs_survive_a_restart(file):
    owner = Owner(file).begin()
    owner.add(*make_runs(6))
    assert owner.told == []
    status = owner.history.status
    again = Owner(file).begin().history.status
    assert again == status
    assert status["runs"] == 6
    assert status["results"][-1] == {
        "time": 1.7e9 + 9e4 * 5,
        "ok": True,
        "offset": 0.16,
        "uncertainty": 0.006,
        "reason": "",
    }
    assert status["switch_nozzle"] == pytest.approx(6.415, abs=0.01)
    assert status["spread"]["bed"] == pytest.approx(0.003, rel=0.8)


def test_run_that_ends_before_all_was_read_is_kept(file):
    add(file, 3)
    owner = Owner(file)
    owner.history.begin()
    while not owner.reactor.calls:
        time.sleep(0.001)
    owner.add(make_run(random.Random(1), time=99.0))
    assert owner.history.status["runs"] == 4
    assert owner.history.status["results"][-1]["time"] == 99.0


def test_end_of_klippy_waits_for_no_thread(file):
    owner, seen = Owner(file), []
    owner.history.in_thread(
        lambda: seen.append(threading.current_thread().daemon)
    )
    owner.reactor.run()
    assert seen == [True]


def test_nothing_is_known_at_first(file):
    assert Owner(file).begin().history.status == {
        "runs": 0,
        "results": [],
        "spread": {"nozzle": None, "switch": None, "bed": None},
        "switch_nozzle": None,
    }


def test_order_is_that_of_the_file_whatever_the_clock_says(file):
    owner = Owner(file).begin()
    times = [5e8, 4e8, 0.0, 3e8]
    owner.add(*[make_run(random.Random(1), time=time) for time in times])
    again = Owner(file).begin().history
    assert [run["time"] for run in again.runs] == times
    assert again.status == owner.history.status


def test_only_the_last_ten_results_are_shown(tmp_path):
    owner = Owner(history.File(str(tmp_path), 100)).begin()
    owner.add(*make_runs(12))
    assert len(owner.history.status["results"]) == 10
    assert owner.history.status["runs"] == 12


def test_printers_of_one_folder_know_their_own_runs_only(file):
    Owner(file, "a.cfg").add(*make_runs(2))
    Owner(file, "b.cfg").add(*make_runs(3))
    assert len(whole(file)) == 5
    assert Owner(file, "a.cfg").begin().history.status["runs"] == 2
    assert Owner(file, "b.cfg").begin().history.status["runs"] == 3


def test_accuracy_runs_are_kept_and_do_not_count(file):
    owner = Owner(file).begin()
    owner.add(make_run(random.Random(1), cycles=[]))
    assert len(whole(file)) == 1
    assert owner.history.status["runs"] == 0
    assert Owner(file).begin().history.status["runs"] == 0


def test_wear_is_told_and_written_with_the_run_that_shows_it(tmp_path):
    file = history.File(str(tmp_path), 1000)
    draw = random.Random(6)
    runs = [make_run(draw, moved={"switch": 1e-4 * n}) for n in range(100)]
    for run in runs[:-1]:
        run["wear"] = []
    with open(file.path, "w") as f:
        f.writelines(json.dumps(run) + "\n" for run in runs[:-1])
    owner = Owner(file).begin()
    owner.add(runs[-1])
    assert any("switch - nozzle has drifted" in text for text in owner.told)
    assert "switch - nozzle" in whole(file)[-1]["wear"]
    owner.told.clear()
    owner.add(make_run(draw, moved={"switch": 0.01}))
    assert owner.told == []


@pytest.mark.parametrize("is_file", [False, True])
def test_no_folder_to_write_to_is_told_once(tmp_path, is_file):
    folder = tmp_path / "z_calibration"
    if is_file:
        folder.write_text("mine")
    else:
        (folder / history.FILE).mkdir(parents=True)
    owner = Owner(history.File(str(folder), 10)).begin()
    owner.add(*make_runs(3))
    assert len(owner.told) == 1
    assert "the history cannot be kept" in owner.told[0]
    assert "history: none" in owner.told[0]
    # What was measured counts nevertheless
    assert owner.history.status["runs"] == 3


def test_bed_of_another_bed_spread_says_nothing():
    """Of its touches; those of nozzle and switch are the same."""
    runs = make_runs(3) + make_runs(4, bed_spread=3.0)
    known = {
        (site, spread): sum(
            s.dof > 0 for s in history.spreads_in(runs, site, spread)
        )
        for site in history.SITES
        for spread in (0.0, 3.0, 5.0)
    }
    assert [known["bed", spread] for spread in (0.0, 3.0, 5.0)] == [3, 4, 0]
    assert {known["nozzle", 5.0], known["switch", 0.0]} == {7}


def test_status_has_the_spread_of_the_bed_spread_of_now(file):
    owner = Owner(file).begin()
    owner.add(*make_runs(5, touches=9))
    owner.add(*make_runs(5, touches=9, bed_spread=3.0, worn={"bed": 0.02}))
    spread = owner.history.status["spread"]
    assert spread["bed"] > 3 * spread["nozzle"]
    owner.add(*make_runs(1, touches=9))
    assert owner.history.status["spread"]["bed"] < 2 * spread["nozzle"]


def test_damaged_lines_are_told(file):
    add(file, 2)
    with open(file.path, "ab") as f:
        f.write(b"oops\n")
    owner = Owner(file).begin()
    assert owner.told == [f"1 damaged lines of {file.path} are left out"]
    assert owner.history.status["runs"] == 2


def test_what_cannot_be_written_is_told_and_no_error(file):
    owner = Owner(file).begin()
    owner.add(make_run(random.Random(1), duration=float("nan")))
    assert (
        len(owner.told) == 1 and "the history cannot be kept" in owner.told[0]
    )
    owner.add(*make_runs(1))
    assert len(whole(file)) == 1


def test_history_that_is_off_lasts_as_long_as_klippy(tmp_path):
    owner = Owner(None).begin()
    owner.add(*make_runs(3), make_run(random.Random(1), cycles=[]))
    assert owner.history.status["runs"] == 3
    assert [len(past) for past in owner.history.spreads().values()] == [3] * 3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_main_thread_waits_for_a_few_lines_at_most(tmp_path, monkeypatch):
    file = history.File(str(tmp_path), 1000)
    with open(file.path, "w") as f:
        runs = make_runs(1000, touches=3)
        f.writelines(json.dumps(run) + "\n" for run in runs)
    owner, stretches = Owner(file), Stretches()
    monkeypatch.setattr(history, "pause", stretches.pause)
    monkeypatch.setattr(owner.history, "in_thread", stretches.count)

    def all_of(work, *args):
        stretches.lines.clear()
        work(*args)
        calls, owner.reactor.calls = owner.reactor.calls, []
        for callback in calls:
            stretches.count(callback, 0.0)
        return stretches.lines

    assert max(all_of(owner.history.begin)) < AT_A_STRETCH
    assert owner.history.status["runs"] == 1000
    lines = all_of(owner.history.add, make_run(random.Random(1)))
    assert max(lines) < AT_A_STRETCH
    # It was counted
    assert sum(lines) > AT_A_STRETCH
    assert len(whole(file)) == 1000
