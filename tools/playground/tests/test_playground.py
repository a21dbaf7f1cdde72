"""A playground as `make printer` starts it: in a terminal, with a browser."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from simplay.tests.browser import browser, programs
from simplay.tests.terminals import LIMIT, Terminal
from simprinter.hosts.hosts import main_host, missing_hosts
from simprinter.hosts.moonraker import free_port
from simprinter.hosts.moonraker_package import find_moonraker
from tools.playground.playground import SHOWN, point_of


@contextmanager
def terminal(*options: str) -> Iterator[Terminal]:
    """A playground that has begun."""
    # What is given twice counts as it is given last
    words = ["-m", "tools.playground", "--speed", "20"]
    words += ["--host", main_host().name, *options]
    with closing(Terminal(words)) as shown:
        shown.until_begun()
        yield shown


@pytest.fixture
def port():
    """One that is free; a visible skip where Moonraker is missing."""
    if find_moonraker() is None:
        pytest.skip(f"NOT TESTED: {missing_hosts()['moonraker']}")
    return str(free_port())


def calibrate_on_the_page(shown):
    """By its button, where there is a browser; see test_page.py."""
    if programs() is None:
        assert shown.run("CALIBRATE_Z").ok
        return
    with browser(shown.page) as page:
        page.until_ready()
        page.press("#shortcuts", "Calibrate")
        page.until(lambda: "mm ±" in page.text("#result"), "a result")
        shown.until(r"true gap: Z=0 is 0\.0\d+ mm above")
        page.until(lambda: page.text("#gap").startswith("0.0"), "the gap")
        assert page.complaints() == []


def heights_on_pin(shown):
    """At which the nozzle has triggered, as they are shown (mm)."""
    shown.read()
    return set(re.findall(r"nozzle on the pin .* tip (\S+) mm", shown.output))


@pytest.mark.slow
@pytest.mark.timeout(4 * LIMIT)
def test_start_home_and_end(port):
    with terminal("--port", port) as shown:
        assert shown.url == f"http://127.0.0.1:{port}"
        header = "Access-Control-Allow-Origin"
        page = "http://localhost:8080"
        info = shown.get("/server/info", Origin=page)
        assert info.json()["result"]["warnings"] == []
        assert info.headers[header] == page
        other = shown.get("/server/info", Origin="http://other.example")
        assert header not in other.headers
        before = len(shown.output)
        assert shown.run("G28").ok
        shown.until("nozzle on the pin", before)
        shown.until(r"true gap: Z=0 is 0\.\d+ mm (?i:in the bed)", before)
        assert re.search(
            r"^Printer .* as at home, seed \d+,", shown.output, re.M
        )
        calibrate_on_the_page(shown)
        assert len(heights_on_pin(shown)) > 1
        shown.type("break probe", "^the wire of probe is broken: always")
        failed = shown.run("CALIBRATE_Z").json()["error"]["message"]
        assert "the probe reads triggered" in failed
        # Itself, klippy, Moonraker, and what that runs at its start
        assert len(shown.processes()) >= 3
        shown.assert_ends(signal.SIGINT)


OWN = {"bed_xy_position": [150.0, 155.0]}
LAID = {"xy_position": [30.0, 20.0], "fixed": False}
MESH = {"zero_reference_position": [120.0, 130.0]}


@pytest.mark.parametrize(
    ("settings", "point"),
    [
        (None, (150.0, 150.0)),
        ({"z_calibration": OWN}, (150.0, 155.0)),
        ({"z_calibration": OWN, "bed_mesh": MESH}, (150.0, 155.0)),
        ({"z_calibration": {}, "bed_mesh": MESH}, (120.0, 130.0)),
        # Nothing says where; and who has not the section does not measure there
        ({"z_calibration": {}}, (150.0, 150.0)),
        ({"bed_mesh": MESH}, (150.0, 150.0)),
        ({"auto_z_offset": OWN, "bed_mesh": MESH}, (150.0, 155.0)),
        ({"auto_z_offset": {}, "bed_mesh": MESH}, (150.0, 150.0)),
        # Where the membrane is laid, or what is probed besides a fixed switch
        ({"extra_probe membrane": LAID}, (30.0, 20.0)),
        (
            {"extra_probe finger": {**LAID, **OWN, "fixed": True}},
            (150.0, 155.0),
        ),
        (
            {"extra_probe finger": {**LAID, "fixed": True}, "bed_mesh": MESH},
            (120.0, 130.0),
        ),
    ],
)
def test_point_of_the_gap(settings, point):
    assert point_of(SHOWN["z_calibration"], settings) == point
