"""What is told of the world to who plays with it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from simplay import watcher
from simplay.sites import sites_of, told
from simplay.tests.everything import EVERYTHING
from simplay.watcher import WORTH_TELLING, Spot, crash_line
from simprinter.world import Crash, Pose, World


def test_crashes_read_like_touches():
    where = Pose(150.0, 149.96, -0.5)
    deep = Crash("nozzle_bed", "depth", 0.5, 0.1, 12.5, where)
    assert crash_line(deep, EVERYTHING) == (
        "CRASH: nozzle on the bed X150.0 Y150.0, 0.500 mm deep,"
        " 0.100 mm allowed"
    )
    dragged = Crash("dock", "drag", 3.0, 0.25, 12.5, where)
    assert crash_line(dragged, EVERYTHING) == (
        "CRASH: head in the dock  X150.0 Y150.0, 3.000 mm dragged,"
        " 0.250 mm allowed"
    )
    stopped = deep._replace(past_stop=0.3)
    assert crash_line(stopped, EVERYTHING) == (
        f"{crash_line(deep, EVERYTHING)}, 0.300 mm past its hard stop"
    )


def test_every_site_of_a_world_is_known():
    made = World(EVERYTHING, 0)
    made.observe(0.0, Pose(0, 0, 50), Pose(200, 0, 50))
    names = set()
    # Nothing is known but what a nozzle or a probe is above
    for x, y in ((5, 6), (5, 26), (30, 20), (60, 20), (100, 100)):
        here = made.near(0.1, Pose(x, y, 20), Pose(x, y, 20))
        there = made.near(0.1, Pose(x, y - 20, 20), Pose(x, y - 20, 20))
        names.update(near.site for near in (*here, *there))
    known = sites_of(EVERYTHING)
    assert names == set(known)
    # What the pictures go by
    assert known["long_plunger_pin"][2:] == ("plunger", 1, "pin", 0, "long")
    assert known["body_other"][2:] == ("body", 0, "pin", 1, "other")
    assert known["second_nozzle_thick"][2:5] == ("nozzle", 1, "membrane")


@pytest.mark.parametrize(
    ("site", "words"),
    [
        ("nozzle_pin", "nozzle on the pin"),
        ("second_nozzle_other", "second nozzle on the pin other"),
        ("nozzle_thick", "nozzle on the membrane thick"),
        ("plunger_pin", "plunger on the pin's housing"),
        ("probe_bed", "probe on the bed"),
        ("body_bed", "probe BODY on the bed"),
        ("long_body_pin", "probe body of long on the pin"),
        ("inductive_bed", "probe senses the bed"),
        ("dock", "head in the dock"),
        ("carriages", "carriage in the other"),
        ("x_endstop", "X endstop"),
        ("my_switch", "my_switch"),
    ],
)
def test_sites_are_told_in_words(site, words):
    assert told(site, EVERYTHING) == words


class Klippy:
    """Answers each question at once, as API clients see it."""

    def __init__(self):
        self.connections = 0
        self.settings = {}
        self.state = "ready"
        self.asked = []

    def connected(self):
        return True

    def request(self, method, params):
        self.asked.append(params["objects"])
        return len(self.asked)

    def answered(self, number):
        return True

    def answer(self, number):
        status = {
            "webhooks": {"state": self.state},
            "gcode_move": {"gcode_position": [0.0, 0.0, 5.0, 0.0]},
            "toolhead": {
                "homed_axes": "xyz",
                "print_time": 1.0,
                "estimated_print_time": 2.0,
            },
        }
        if "configfile" in self.asked[number - 1]:
            status["configfile"] = {"settings": self.settings}
        return {"status": status}


class Standing:
    """A machine whose head stands, and one who tells its gap."""

    def __init__(self, monkeypatch):
        self.gap, self.at, self.told = 0.06, None, []
        self.now = 0.0
        monkeypatch.setattr(watcher.time, "monotonic", lambda: self.now)
        clock = SimpleNamespace(now=lambda: round(self.now * 1e9))
        machine = SimpleNamespace(
            simulation=SimpleNamespace(clock=clock),
            tip=lambda: Pose(1.0, 2.0, 5.0),
            gap_at_zero=self.gap_at_zero,
        )
        self.klippy = Klippy()
        self.teller = watcher.GapTeller(
            machine,
            self.klippy,
            lambda settings: Spot(*settings.get("place", (150.0, 150.0))),
            self.told.append,
        )
        # It has to stand before
        for _ in range(2):
            self.look()

    def gap_at_zero(self, z, xy):
        self.at = xy
        return self.gap

    def look(self, gap=None):
        """Some seconds later: the question, and its answer."""
        self.gap = self.gap if gap is None else gap
        self.now += 8.0
        for _ in range(3):
            self.teller.look()


@pytest.fixture
def standing(monkeypatch):
    return Standing(monkeypatch)


def test_gap_of_a_printer_that_warms_up_is_told_now_and_then(standing):
    standing.look()
    assert len(standing.told) == 1
    # As much as the nozzle grows, in ten minutes
    for step in range(75):
        standing.look(0.06 - 0.034 * (step + 1) / 75)
    assert len(standing.told) == 1 + int(0.034 / WORTH_TELLING)
    # The large figure follows anyway
    assert standing.teller.height == pytest.approx(0.026)
    before = len(standing.told)
    standing.look(0.026 + 2 * WORTH_TELLING)
    assert len(standing.told) == before + 1
    standing.teller.is_wanted = True
    standing.look()
    assert len(standing.told) == before + 2


def test_gap_is_told_where_the_running_klippy_has_it(standing):
    standing.klippy.settings = {"place": (150.0, 155.0)}
    standing.look()
    # Asked for once: it is long, and does not change
    assert ["configfile" in asked for asked in standing.klippy.asked] == [
        True,
        False,
    ] + [False] * (len(standing.klippy.asked) - 2)
    assert standing.teller.spot[:2] == standing.at == (150.0, 150.0)
    standing.klippy.connections += 1
    standing.look(0.08)
    assert standing.teller.spot[:2] == standing.at == (150.0, 155.0)
    assert standing.told[-1].endswith(
        "Z=0 is 0.080 mm above the bed at X150 Y155"
    )


@pytest.mark.parametrize(
    ("gap", "words"),
    [
        (0.001, "0.001 mm above the bed"),
        (-0.099, "0.099 mm in the bed"),
        (-0.101, "0.101 mm IN THE BED"),
    ],
)
def test_what_is_not_far_off_is_no_alarm(standing, gap, words):
    standing.look(gap)
    assert f"Z=0 is {words} at" in standing.told[-1]


def test_gap_of_a_klippy_that_has_stopped_is_not_known(standing):
    standing.look()
    assert standing.teller.height == 0.06
    standing.klippy.state = "shutdown"
    standing.look()
    assert standing.teller.height is None
    assert len(standing.told) == 1
    standing.teller.is_wanted = True
    standing.look()
    assert standing.told[-1] == "true gap: not known, klippy has stopped"
