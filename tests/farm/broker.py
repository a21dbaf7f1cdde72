"""A real MQTT broker, and somebody who listens to all that it gets."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Optional

from simprinter.hosts.environment import UnavailableError, cached_environment
from simprinter.hosts.moonraker import free_port

LIMIT = 60.0
_MOSQUITTO = """\
listener {port} 127.0.0.1
allow_anonymous true
persistence true
# Root would become somebody who may not write there
user root
persistence_location {folder}/
"""
_AMQTT = """\
listeners:
  default:
    type: tcp
    bind: 127.0.0.1:{port}
plugins:
  amqtt.plugins.authentication.AnonymousAuthPlugin:
    allow_anonymous: true
"""
# In Moonraker's environment, which has paho. A line for each message; the
# session is kept, so that none is lost while the broker is away
_LISTENER = """\
import json, sys, time
import paho.mqtt.client as mqtt
def show(client, data, message):
    print(json.dumps([message.topic, json.loads(message.payload)]), flush=True)
def begin(client, *unused):
    client.subscribe("+/klipper/status", 1)
    print("[]", flush=True)
client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION1, "listener", False)
client.on_message, client.on_connect = show, begin
client.reconnect_delay_set(1, 1)
client.connect("127.0.0.1", int(sys.argv[1]))
client.loop_forever()
"""


class Message(NamedTuple):
    """What a printer has published."""

    printer: str
    status: dict[str, Any]


class Program(NamedTuple):
    """A broker's program, and what its configuration is."""

    path: str
    conf: str


def find_program() -> Optional[Program]:
    """Mosquitto where it is installed, else amqtt; None: no package index."""
    found = shutil.which("mosquitto") or shutil.which(
        "mosquitto", path="/usr/sbin"
    )
    if found is not None:
        return Program(found, _MOSQUITTO)
    try:
        python = cached_environment("amqtt")
    except UnavailableError:
        return None
    return Program(str(python.with_name("amqtt")), _AMQTT)


class Broker:
    """Use as a context manager. It may go away and come back."""

    def __init__(self, program: Program, folder: Path, python: Path):
        """python: one that has paho."""
        self.port = free_port()
        self._output = folder / "messages.txt"
        self._conf = folder / "broker.conf"
        self._conf.write_text(
            program.conf.format(port=self.port, folder=folder)
        )
        self._program, self._python = program.path, python

    def __enter__(self) -> Broker:
        self.start()
        script = [str(self._python), "-c", _LISTENER, str(self.port)]
        with open(self._output, "wb") as output:
            self._listener = subprocess.Popen(
                script, stdout=output, stderr=subprocess.DEVNULL
            )
        self.until(self._output.read_bytes, "the listener")
        return self

    def __exit__(self, *unused: object) -> None:
        self._listener.kill()
        self._listener.wait(LIMIT)
        self.stop()

    def start(self) -> None:
        """Be there."""
        command = [self._program, "-c", str(self._conf)]
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self.until(self._listens, "the broker")

    def _listens(self) -> bool:
        assert self._process.poll() is None
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def stop(self) -> None:
        """Be gone."""
        self._process.terminate()
        self._process.wait(LIMIT)

    def messages(self) -> list[Message]:
        """All that have arrived."""
        found = []
        if not self._output.exists():
            return found
        for line in self._output.read_text().splitlines():
            if line != "[]":
                topic, payload = json.loads(line)
                name = topic.partition("/")[0]
                found.append(Message(name, payload["status"]))
        return found

    def results(self, printer: str) -> list[dict[str, float]]:
        """The results of a printer's runs, as they have arrived."""
        return [
            message.status["z_calibration"]["last_result"]
            for message in self.messages()
            if message.printer == printer
            and message.status.get("z_calibration", {}).get("last_result")
        ]

    def until(self, done: Callable[[], Any], what: str) -> None:
        """Wait for it."""
        end = time.monotonic() + LIMIT
        while not done():
            assert time.monotonic() < end, f"{what}: {self.messages()}"
            time.sleep(0.1)
