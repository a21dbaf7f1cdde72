"""A playground as `make printer` starts it: in a terminal, with a browser."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Optional

import pytest
import requests

from simprinter.hosts.hosts import main_host, missing_hosts
from simprinter.hosts.moonraker import free_port
from simprinter.hosts.moonraker_package import find_moonraker
from tools.playground import network
from tools.playground.tests.browser import browser, programs

ROOT = Path(__file__).resolve().parents[3]
# Real seconds for whatever is waited for, also on a busy machine
LIMIT = 100.0


class Terminal:
    """A playground in a terminal of its own; every wait has a limit."""

    def __init__(self, *options: str, env: Optional[dict] = None):
        self._popen = subprocess.Popen(
            # What is given twice counts as it is given last
            [sys.executable, "-m", "tools.playground", "--speed", "20"]
            + ["--host", main_host().name, *options],
            cwd=ROOT,
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self.pid = self._popen.pid
        os.set_blocking(self._popen.stdout.fileno(), False)
        self.output = ""

    def until_begun(self) -> None:
        """Wait until it has told where it is."""
        self.url = self.until(r"^Moonraker +(\S+)$")[1]
        self.config = Path(self.until(r"^Config +(\S+)$")[1])
        self.page = self.until(r"^Page +(\S+)$")[1]

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
            if session == self.pid and words:
                found.append(words.replace(b"\0", b" ").decode())
        return found

    def end(self, number: int) -> int:
        """Send a signal to every process of the terminal; the exit code.

        SIGINT: what Ctrl-C does.
        """
        os.killpg(self.pid, number)
        return self.ended()

    def ended(self) -> int:
        """Wait for the end; the exit code."""
        try:
            return self._popen.wait(LIMIT)
        except subprocess.TimeoutExpired:
            self.read()
            raise AssertionError(f"it does not end: {self.output}") from None
        finally:
            self.read()

    def close(self) -> None:
        """Whatever was left is ended, whatever has gone wrong."""
        if self.processes():
            os.killpg(self.pid, signal.SIGKILL)
        self._popen.wait(LIMIT)
        self._popen.stdin.close()
        self._popen.stdout.close()


@contextmanager
def terminal(*options: str) -> Iterator[Terminal]:
    """A Terminal whose playground has begun."""
    with closing(Terminal(*options)) as shown:
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


def assert_ends(shown, number):
    """With it goes all that it has started, and its folder."""
    assert shown.end(number) == 0
    assert shown.output.endswith("ended\n")
    assert shown.processes() == []
    assert not shown.config.exists()


def heights_on_pin(shown):
    """At which the nozzle has triggered, as they are shown (mm)."""
    shown.read()
    return set(re.findall(r"nozzle on the pin .* tip (\S+) mm", shown.output))


@pytest.mark.slow
@pytest.mark.timeout(4 * LIMIT)
def test_perfect_printer(port):
    with terminal("--port", port, "--perfect") as shown:
        assert re.search(r"^Printer .* perfect,", shown.output, re.M)
        assert shown.run("G28").ok
        assert shown.run("CALIBRATE_Z").ok
        assert len(heights_on_pin(shown)) == 1
        assert_ends(shown, signal.SIGINT)


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
        shown.until(r"true gap: Z=0 is 0\.\d+ mm IN THE BED", before)
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
        assert_ends(shown, signal.SIGINT)


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
