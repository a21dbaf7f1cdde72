"""Broker, Prometheus and the stand-in for Telegraf, as one farm has them."""

from __future__ import annotations

import json
import re
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any, Optional

from simprinter.hosts.moonraker import free_port

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "print_farm"
LIMIT = 60.0
_MOSQUITTO = """\
listener {port} 127.0.0.1
allow_anonymous true
persistence true
max_queued_messages 100000
# Root would become somebody who may not write there
user root
persistence_location {folder}/
"""


def program(name: str) -> Optional[str]:
    """Where one of Debian's programs is; None: nowhere."""
    return shutil.which(name) or shutil.which(name, path="/usr/sbin")


def until(done: Callable[[], Any], what: str, limit: float = LIMIT) -> Any:
    """Wait for it, and return it."""
    end = time.monotonic() + limit
    while True:
        value = done()
        if value:
            return value
        assert time.monotonic() < end, f"{what}: not within {limit} s"
        time.sleep(0.1)


def listens(port: int) -> bool:
    """Whether somebody does at that port."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class Server:
    """A process below a folder; use as a context manager."""

    def __init__(self, name: str, command: list[str], port: int):
        self.name, self.port = name, port
        self._command = command
        self.process: Optional[subprocess.Popen[bytes]] = None

    def __enter__(self) -> Server:
        self.start()
        return self

    def __exit__(self, *unused: object) -> None:
        self.stop()

    def start(self) -> None:
        """Be there."""
        self.process = subprocess.Popen(
            self._command,
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until(lambda: listens(self.port), self.name)

    def stop(self) -> None:
        """Be gone."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait(LIMIT)
            self.process = None


def mosquitto(folder: Path) -> Server:
    """A broker that keeps what it must in the folder."""
    port, found = free_port(), program("mosquitto")
    assert found is not None
    conf = folder / "broker.conf"
    conf.write_text(_MOSQUITTO.format(port=port, folder=folder))
    return Server("mosquitto", [found, "-c", str(conf)], port)


def telegraf(broker_port: int) -> Server:
    """The stand-in with our telegraf.conf."""
    port = free_port()
    words = [str(EXAMPLES / "telegraf.conf"), str(broker_port), str(port)]
    command = [sys.executable, "-m", "tools.farm.telegraf", *words]
    return Server("the stand-in for Telegraf", command, port)


def prometheus(folder: Path, telegraf_port: int, interval: float) -> Server:
    """One with our rules; interval (s) of collecting and of looking."""
    port, found = free_port(), program("prometheus")
    assert found is not None
    text = (EXAMPLES / "prometheus.yml").read_text(encoding="utf-8")
    text = re.sub(
        r"(?m)^  scrape_interval: .*",
        f"  scrape_interval: {interval:g}s\n  evaluation_interval:"
        f" {interval:g}s",
        text,
    )
    text = text.replace("alerts.yml", str(EXAMPLES / "alerts.yml"))
    text = text.replace("localhost:9273", f"127.0.0.1:{telegraf_port}")
    conf = folder / "prometheus.yml"
    conf.write_text(text, encoding="utf-8")
    command = [
        found,
        f"--config.file={conf}",
        f"--storage.tsdb.path={folder / 'tsdb'}",
        f"--web.listen-address=127.0.0.1:{port}",
    ]
    return Server("Prometheus", command, port)


def ask(port: int, path: str) -> Any:
    """What Prometheus answers."""
    url = f"http://127.0.0.1:{port}/api/v1/{path}"
    with urllib.request.urlopen(url, timeout=10) as answer:
        return json.load(answer)["data"]


def metric(port: int, name: str) -> float:
    """What Prometheus says of itself; the sum over all labels."""
    url = f"http://127.0.0.1:{port}/metrics"
    with urllib.request.urlopen(url, timeout=10) as answer:
        text = answer.read().decode()
    found = re.findall(rf"(?m)^{name}(?:{{[^}}]*}})? (\S+)$", text)
    assert found, name
    return sum(map(float, found))


def firing(port: int) -> set[tuple[str, str]]:
    """(alert, printer) of all that fire."""
    return {
        (alert["labels"]["alertname"], alert["labels"].get("printer", ""))
        for alert in ask(port, "alerts")["alerts"]
        if alert["state"] == "firing"
    }
