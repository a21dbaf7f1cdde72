"""A playground as `make printer` starts it: in a terminal, with a browser."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import requests

from tests.hostkit.hosts import all_hosts, missing_hosts
from tests.hostkit.moonraker import free_port
from tests.hostkit.moonraker_package import find_moonraker
from tests.hostkit.printer import Printer
from tests.playground import network
from tests.playground.playground import SHOWN, dressed

ROOT = Path(__file__).resolve().parents[3]
LIMIT = 120.0


class Terminal:
    """A playground in a terminal of its own."""

    def __init__(self, *options: str):
        self._popen = subprocess.Popen(
            [sys.executable, "-m", "tests.playground", "--speed", "20"]
            + ["--host", all_hosts()[-1].name, *options],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        os.set_blocking(self._popen.stdout.fileno(), False)
        self.output = ""
        self.url = self.until(r"^Moonraker +(\S+)$")[1]
        self.config = Path(self.until(r"^Config +(\S+)$")[1])

    def read(self) -> None:
        self.output += (self._popen.stdout.read() or b"").decode()

    def until(self, pattern: str, after: int = 0) -> re.Match:
        """Wait until it shows a line."""
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            self.read()
            found = re.compile(pattern, re.M).search(self.output, after)
            if found:
                return found
            assert self._popen.poll() is None, self.output
            time.sleep(0.1)
        raise AssertionError(f"{pattern} is not in {self.output}")

    def type(self, line: str, answer: str) -> None:
        """Type a line and wait for what it shows."""
        self.read()
        before = len(self.output)
        self._popen.stdin.write(f"{line}\n".encode())
        self._popen.stdin.flush()
        self.until(answer, before)

    def run(self, script: str) -> requests.Response:
        """Run G-code as a web interface does."""
        return self.post("/printer/gcode/script", script=script)

    def get(self, path: str, **headers: str) -> requests.Response:
        return requests.get(self.url + path, headers=headers, timeout=LIMIT)

    def post(self, path: str, **params: str) -> requests.Response:
        return requests.post(self.url + path, params=params, timeout=LIMIT)

    def processes(self) -> list[str]:
        """The command lines of all that it has started and that lives."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                words = (folder / "cmdline").read_bytes()
                session = os.getsid(int(folder.name))
            except OSError:
                continue
            if session == self._popen.pid and words:
                found.append(words.replace(b"\0", b" ").decode())
        return found

    def interrupt(self) -> int:
        """Ctrl-C: every process of the terminal gets it; the exit code."""
        os.killpg(self._popen.pid, signal.SIGINT)
        code = self._popen.wait(LIMIT)
        self.read()
        self._popen.stdin.close()
        self._popen.stdout.close()
        return code


@contextmanager
def terminal(*options):
    shown = Terminal(*options)
    try:
        yield shown
    finally:
        if shown.processes():
            shown.interrupt()


@pytest.fixture(scope="module")
def first():
    """The playground of most tests."""
    if find_moonraker() is None:
        pytest.skip(f"NOT TESTED: {missing_hosts()['moonraker']}")
    with terminal("--port", str(free_port())) as shown:
        yield shown


def test_calibration_is_seen_touch_by_touch(first):
    assert first.run("G28").ok
    homed = first.until(r"true gap: Z=0 is ([\d.]+) mm (IN|above)")
    # Where the owner believes the pin is
    assert (float(homed[1]), homed[2]) == (pytest.approx(0.1, abs=2e-3), "IN")
    before = len(first.output)
    assert first.run("CALIBRATE_Z").ok
    gap = first.until(r"true gap: Z=0 is ([\d.]+) mm above", before)
    scene = SHOWN["z_calibration"]
    assert float(gap[1]) == pytest.approx(scene.formula_gap(), abs=3e-3)
    shown = first.output[before:]
    for place in ("nozzle on the pin", "probe body on the pin"):
        touches = re.findall(
            rf"{place} +X20\S+ Y\S+, tip (\S+) mm .* (\S+) mm deep", shown
        )
        assert len(touches) == 3
        drop = scene.world.mag_probe.body_drop if "body" in place else 0.0
        pin, bed = scene.world.pin, scene.world.bed
        for tip, deep in touches:
            height = pin.z + drop - bed.z0
            assert float(tip) == pytest.approx(height, abs=1e-3)
            assert 0.0 <= float(deep) < 0.02
    assert len(re.findall("probe on the bed +X152.0 Y125.", shown)) == 3


def test_wire_breaks_by_command_and_is_repaired(first):
    assert first.run("G28").ok
    first.type("break probe", "^the wire of probe is broken: always triggered")
    failed = first.run("CALIBRATE_Z")
    assert failed.status_code == 400
    assert "the probe reads triggered" in failed.json()["error"]["message"]
    first.type("break nothing", "^!! no wire nothing, only x_endstop")
    first.type("break", "^!! usage: break WIRE")
    first.type("repair", "^all is as good as new")
    assert first.run("CALIBRATE_Z").ok
    # A wire that touches ground never triggers; the floor ends the touch
    first.type("short z_endstop", "^the wire of z_endstop .*: never triggered")
    assert "No trigger" in first.run("CALIBRATE_Z").text
    first.type("repair", "^all is as good as new")
    first.type("late z_endstop 0.3", "^z_endstop triggers 0.3 mm too deep")
    before = len(first.output)
    assert first.run("G28").ok
    deep = first.until(r"nozzle on the pin .* (\S+) mm deep", before)
    assert float(deep[1]) == pytest.approx(0.3, abs=0.02), first.output
    first.type("repair", "^all is as good as new")


def test_probe_falls_by_command_and_comes_back(first):
    assert first.run("G28").ok
    first.type("drop", "^the probe has fallen off")
    first.until("s  probe: lost")
    assert first.run("CALIBRATE_Z").status_code == 400
    first.type("drop", "^!! the head does not carry the probe")
    first.type("repair", "^all is as good as new")
    assert first.run("CALIBRATE_Z").ok
    first.type("lay", "^!! this printer has no membrane")


def test_speed_and_gap_by_command(first):
    first.type("speed 21", "^!! speed: 21 is not from 1 to 20")
    assert first.run("G28").ok
    first.type("speed 2", "^2 times as fast")
    begin = time.monotonic()
    assert first.run("G4 P4000\nM400").ok
    assert time.monotonic() - begin > 1.5
    first.type("speed 20", "^20 times as fast")
    first.type("gap", r"true gap: Z=0 is 0\.\d+ mm")
    assert first.run("M84").ok
    first.type("gap", "true gap: not known before Z is homed")


def test_config_is_as_its_owner_left_it_after_a_restart(first):
    printer = first.config / "printer.cfg"
    macro = "\n[gcode_macro HELLO]\ngcode:\n    M118 hello\n"
    printer.write_text(printer.read_text() + macro)
    assert first.post("/machine/services/restart", service="klipper").ok
    first.until("^restarted klipper")
    end = time.monotonic() + LIMIT
    while time.monotonic() < end:
        if (
            first.get("/server/info").json()["result"]["klippy_state"]
            == "ready"
        ):
            break
        time.sleep(0.2)
    assert first.run("HELLO\nG28").ok


def test_nobody_else_is_let_in(first):
    info = first.get("/server/info", Origin="http://localhost:8080")
    assert info.json()["result"]["warnings"] == []
    header = "Access-Control-Allow-Origin"
    assert info.headers[header] == "http://localhost:8080"
    other = first.get("/server/info", Origin="http://other.example")
    assert header not in other.headers
    assert first.url.startswith("http://127.0.0.1:")


def test_second_start_beside_the_first_ends_with_all_it_has(first):
    port = first.url.rpartition(":")[2]
    page = "http://page.example"
    options = ("--scene", "extra_probe", "--port", port, "--origin", page)
    with terminal(*options) as second:
        assert second.url != first.url
        allowed = second.get("/server/info", Origin=page).headers
        assert allowed["Access-Control-Allow-Origin"] == page
        assert second.run("G28\nEXTRA_PROBE_CALIBRATE PROBE=membrane").ok
        second.type("lay", "^the membrane lies on the bed")
        assert second.run("EXTRA_PROBE_CONTINUE PROBE=membrane").ok
        second.until("nozzle on the membrane")
        second.type("take", "^the bed is free")
        assert second.run("EXTRA_PROBE_CONTINUE PROBE=membrane").ok
        second.until(r"true gap: Z=0 is 0\.00\d mm")
        # Itself, klippy, Moonraker, and what that runs at its start
        assert len(second.processes()) >= 3
        assert second.interrupt() == 0
        assert second.output.endswith("ended\n")
        assert second.processes() == []
        assert not second.config.exists()
    assert first.run("G28").ok


@pytest.mark.spread
@pytest.mark.parametrize("name", SHOWN)
def test_module_is_configured_in_a_scene_of_its_own(host, name, tmp_path):
    files = {"virtual_sdcard": {"path": str(tmp_path)}, "pause_resume": {}}
    with Printer(host, dressed(SHOWN[name]), files) as printer:
        printer.homed()
        objects = printer.session.call("objects/list", {})["objects"]
    assert any(text.split()[0] == name for text in objects)


def test_listening_address_decides_who_needs_no_password(monkeypatch):
    networks = {"127.0.0.1": "127.0.0.0/8", "10.1.2.3": "10.1.0.0/16"}
    networks = {
        address: network.ipaddress.IPv4Network(text)
        for address, text in networks.items()
    }
    monkeypatch.setattr(network, "own_networks", lambda: networks)
    assert network.trusted("127.0.0.1") == ["127.0.0.1"]
    assert network.trusted("10.1.2.3") == ["10.1.2.3", "10.1.0.0/16"]
    assert network.trusted("0.0.0.0") == ["127.0.0.1", "10.1.0.0/16"]
    with pytest.raises(network.AddressError, match=r"10\.1\.2\.3, 0\.0\.0\.0"):
        network.trusted("10.9.9.9")
    assert not [o for o in network.origins("127.0.0.1", []) if "10.1" in o]
    assert "*://10.1.2.3:*" in network.origins("10.1.2.3", [])
    assert "*://10.1.2.3" in network.origins("0.0.0.0", [])


def test_own_networks_have_loopback():
    found = network.own_networks()
    assert str(found["127.0.0.1"]) == "127.0.0.0/8"
