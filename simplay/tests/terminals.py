"""A printer that is played with, as somebody has it in a terminal."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Optional

import requests

ROOT = Path(__file__).resolve().parents[2]
# Real seconds for whatever is waited for, also on a busy machine
LIMIT = 100.0


class Terminal:
    """A printer that is played with in a terminal of its own.

    Every wait has a limit.
    """

    def __init__(
        self, words: Sequence[str], python: str = sys.executable, **options: Any
    ):
        """words: for Python. options: of subprocess.Popen."""
        self._popen = subprocess.Popen(
            [python, *words],
            **{"cwd": ROOT, **options},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self.pid = self._popen.pid
        # Of all that it has started, as far as that was looked at
        self._sessions = {self.pid}
        os.set_blocking(self._popen.stdout.fileno(), False)
        self.output = ""
        self.config: Optional[Path] = None

    def until_begun(self) -> None:
        """Wait until it has told where it is."""
        self.url = self.until(r"^Moonraker +(\S+)$")[1]
        self.config = Path(self.until(r"^Config +(\S+)$")[1])
        self.page = self.until(r"^Page +(\S+)$")[1]

    def until_ready(self) -> None:
        """Wait until Moonraker has found klippy ready."""
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            state = self.get("/server/info").json()["result"]["klippy_state"]
            if state == "ready":
                return
            time.sleep(0.1)
        raise AssertionError(f"klippy is {state}: {self.output}")

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

    def get_page(self, path: str) -> requests.Response:
        return requests.get(self.page + path, timeout=LIMIT)

    def get(self, path: str, **headers: str) -> requests.Response:
        return requests.get(self.url + path, headers=headers, timeout=LIMIT)

    def post(self, path: str, **params: str) -> requests.Response:
        return requests.post(self.url + path, params=params, timeout=LIMIT)

    def processes(self) -> list[str]:
        """The command lines of all that it has started and that lives."""
        living: dict[int, tuple[int, int, str]] = {}
        for folder in Path("/proc").glob("[0-9]*"):
            pid = int(folder.name)
            try:
                words = (folder / "cmdline").read_bytes()
                status = (folder / "status").read_text()
                session = os.getsid(pid)
            except OSError:
                continue
            parent = int(re.search(r"^PPid:\s*(\d+)", status, re.M)[1])
            if words:
                told = words.replace(b"\0", b" ").decode()
                living[pid] = (parent, session, told)
        # Klippy leads a session of its own, and outlives its parent if it is let
        begun = len(self._sessions) - 1
        while begun < len(self._sessions):
            begun = len(self._sessions)
            self._sessions |= {
                session
                for parent, session, _ in living.values()
                if parent in living and living[parent][1] in self._sessions
            }
        return [
            told
            for _, session, told in living.values()
            if session in self._sessions
        ]

    def end(self, number: int) -> int:
        """Send a signal to every process of the terminal; the exit code.

        SIGINT: what Ctrl-C does.
        """
        os.killpg(self.pid, number)
        return self.ended()

    def assert_ends(self, number: int) -> None:
        """With it goes all that it has started, and its folder."""
        assert self.processes() != []
        assert self.end(number) == 0
        assert self.output.endswith("ended\n")
        assert self.processes() == []
        assert not self.config.exists()

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
        # What is killed takes nothing away
        for folder in self.config.parents if self.config else ():
            if folder.name.startswith("playground-"):
                shutil.rmtree(folder, ignore_errors=True)
