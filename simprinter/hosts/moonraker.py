"""A real Moonraker: its process, and how to talk to it."""

from __future__ import annotations

import json
import socket
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Optional

import requests
import websocket

_HOST = "127.0.0.1"
# Real seconds; much longer than anything takes on a busy machine
_START_LIMIT = 30.0
_ANSWER_LIMIT = 60.0
_STOP_LIMIT = 10.0
_LOOK_EVERY = 0.05

# Announcements are read from files, not from the internet
_CONF = """\
[server]
host: {listen}
port: {port}
klippy_uds_address: {data}/comms/klippy.sock

[authorization]
trusted_clients:{trusted}
{cors}
[announcements]
dev_mode: True

{more}"""
# More of it, for one that is to start, stop or update nothing
ALONE = """\
[machine]
provider: none
validate_service: False
"""


class MoonrakerError(Exception):
    """Moonraker refused a request; the text is its own."""

    def __init__(self, status: int, text: str):
        super().__init__(f"HTTP {status}: {text}")
        self.status = status
        self.text = text


def free_port() -> int:
    """A port that nobody uses now."""
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        return probe.getsockname()[1]


def write_conf(
    data: Path,
    port: int,
    listen: str = _HOST,
    trusted: Sequence[str] = (_HOST,),
    origins: Sequence[str] = (),
    more: str = ALONE,
) -> None:
    """Write config/moonraker.conf of a data directory.

    trusted: addresses and networks that need no password. origins: of the web
    pages that may ask. more: further sections.
    """
    conf = _CONF.format(
        listen=listen,
        port=port,
        data=data,
        trusted=_listed(trusted),
        cors=f"cors_domains:{_listed(origins)}\n" if origins else "",
        more=more,
    )
    (data / "config" / "moonraker.conf").write_text(conf)


def _listed(words: Sequence[str]) -> str:
    return "".join(f"\n    {word}" for word in words)


class Moonraker:
    """One Moonraker on its data directory, and HTTP requests to it."""

    def __init__(
        self,
        python: Path,
        data: Path,
        port: int,
        env: Mapping[str, str],
        address: str = _HOST,
    ):
        """data: has config/moonraker.conf with this port and address."""
        self.port = port
        self._address = address
        self._command = [str(python), "-m", "moonraker", "-d", str(data)]
        self._output = data / "logs" / "moonraker-output.txt"
        self._log = data / "logs" / "moonraker.log"
        self._env = env
        self._popen: Optional[subprocess.Popen] = None
        self._client = requests.Session()
        self._client.trust_env = False  # no proxy

    def start(self) -> None:
        """Start it and wait until it answers."""
        self._output.parent.mkdir(exist_ok=True)
        with open(self._output, "ab") as output:
            self._popen = subprocess.Popen(
                self._command,
                env=self._env,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
            )
        try:
            self.wait_until(
                lambda: self.get("/server/info"), "Moonraker answers"
            )
        except BaseException:  # Ctrl-C, too
            self.stop()
            raise

    def has_ended(self) -> bool:
        """Whether it was started and has ended by itself."""
        return self._popen is not None and self._popen.poll() is not None

    def stop(self) -> None:
        """End it if it runs."""
        self._client.close()
        if self._popen is None:
            return
        self._popen.terminate()
        try:
            self._popen.wait(_STOP_LIMIT)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.wait()
        self._popen = None

    def get(self, path: str, **params: Any) -> Any:
        """The result of a GET request. Raises MoonrakerError."""
        return self._request("GET", path, params)

    def post(self, path: str, **params: Any) -> Any:
        """The result of a POST request. Raises MoonrakerError."""
        return self._request("POST", path, params)

    def run(self, script: str) -> Any:
        """Run G-code to its end. Raises MoonrakerError."""
        return self.post("/printer/gcode/script", script=script)

    def status(self, name: str) -> dict[str, Any]:
        """Status fields of a printer object."""
        return self.get(f"/printer/objects/query?{name}")["status"][name]

    def wait_until(self, done: Callable[[], Any], what: str) -> None:
        """Ask again and again; refused or unanswered is not yet done."""
        end = time.monotonic() + _START_LIMIT
        failure: Optional[Exception] = None
        while time.monotonic() < end:
            try:
                if done():
                    return
            except (requests.ConnectionError, MoonrakerError) as error:
                failure = error
            time.sleep(_LOOK_EVERY)
        raise TimeoutError(f"{what}: not yet ({failure})\n{self.tail()}")

    def wait_until_ready(self) -> None:
        """Wait until it is connected to a klippy that is ready."""
        self.wait_until(
            lambda: self.get("/server/info")["klippy_state"] == "ready",
            "klippy is ready",
        )

    def listen(self) -> Listener:
        """A websocket connection; to be closed."""
        return Listener(f"ws://{self._address}:{self.port}/websocket")

    def tail(self, lines: int = 40) -> str:
        """The end of its log and of what it printed."""
        texts = [
            path.read_text(encoding="utf-8", errors="replace").splitlines()
            for path in (self._log, self._output)
            if path.exists()
        ]
        return "\n".join(line for text in texts for line in text[-lines:])

    def _request(self, kind: str, path: str, params: dict[str, Any]) -> Any:
        answer = self._client.request(
            kind,
            f"http://{self._address}:{self.port}{path}",
            params=params,
            timeout=_ANSWER_LIMIT,
        )
        content = answer.json()
        if "error" in content:
            raise MoonrakerError(
                answer.status_code, content["error"]["message"]
            )
        return content["result"]


class Listener:
    """A websocket connection: requests, and what comes unasked."""

    def __init__(self, url: str):
        self._socket = websocket.create_connection(url, timeout=_ANSWER_LIMIT)
        self._next_id = 0

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *unused: object) -> None:
        self._socket.close()

    def call(self, method: str, **params: Any) -> Any:
        """The result of a request; what comes before it is dropped."""
        self._next_id += 1
        message = {"jsonrpc": "2.0", "id": self._next_id, "method": method}
        self._socket.send(json.dumps({**message, "params": params}))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == self._next_id:
                return answer["result"]

    def collect(
        self, method: str, is_last: Callable[[list], bool]
    ) -> list[list]:
        """The parameters of notifications up to the last one wanted."""
        found = []
        end = time.monotonic() + _START_LIMIT
        while time.monotonic() < end:
            message = json.loads(self._socket.recv())
            if message.get("method") == method:
                found.append(message.get("params", []))
                if is_last(found[-1]):
                    return found
        raise TimeoutError(f"{method}: the last one is not in {found}")
