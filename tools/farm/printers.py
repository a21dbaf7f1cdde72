"""Printers as a broker sees them: their messages, without the printers."""

from __future__ import annotations

import json
import random
import selectors
import time
from typing import Any, Optional

import paho.mqtt.client as mqtt

# Runs that a history has, and how many of them a message brings
RUNS, RESULTS = 300, 10


class Printer:
    """One connection to the broker, as Moonraker's: last will, QoS 1."""

    def __init__(self, name: str, port: int, draw: random.Random):
        self.name = name
        self._draw = draw
        self._results: list[dict[str, Any]] = []
        self.sent = self.bytes = 0
        self.client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, name)
        offline = json.dumps({"server": "offline"})
        self.client.will_set(f"{name}/moonraker/status", offline, 1, True)
        self.client.connect("127.0.0.1", port, keepalive=600)

    def online(self) -> None:
        """What Moonraker says of itself when it has connected."""
        online = json.dumps({"server": "online"})
        self.client.publish(f"{self.name}/moonraker/status", online, 1, True)

    def calibrated(self, is_ok: bool = True) -> None:
        """The three messages of a run: homed again, measured, written."""
        draw = self._draw
        offset = round(0.16 + draw.gauss(0.0, 0.004), 6)
        parts = {
            "probe": round(7.315 + draw.gauss(0.0, 0.004), 6),
            "switch": round(8.315 + draw.gauss(0.0, 0.004), 6),
            "nozzle": round(1.9 + draw.gauss(0.0, 0.004), 6),
            "switch_offset": 0.44,
            "offset": offset,
        }
        self._say(valid=False, reason="Z was homed again")
        if is_ok:
            self._say(
                last_z_offset=offset,
                last_result=parts,
                valid=True,
                reason="",
                warnings=[],
                uncertainty=0.0062,
            )
        run = {
            "time": round(time.time(), 1),
            "offset": offset if is_ok else None,
            "uncertainty": 0.0062 if is_ok else None,
            "ok": is_ok,
        }
        self._results = [*self._results, run][-RESULTS:]
        sites = ("nozzle", "switch", "bed")
        self._say(
            history={
                "runs": RUNS,
                "refused": 0 if is_ok else 1,
                "results": self._results,
                "spread": {site: draw.uniform(0.002, 0.003) for site in sites},
                "switch_nozzle": round(parts["switch"] - parts["nozzle"], 6),
            }
        )

    def _say(self, **fields: Any) -> None:
        status = {"z_calibration": fields}
        text = json.dumps({"eventtime": time.monotonic(), "status": status})
        self.client.publish(f"{self.name}/klipper/status", text, 1)
        self.sent += 1
        self.bytes += len(text)


class Hall:
    """Many printers in one thread; each calibrates every `interval` s."""

    def __init__(self, count: int, port: int, interval: float, seed: int):
        draw = random.Random(seed)
        self._selector = selectors.DefaultSelector()
        self.printers = [
            Printer(f"printer-{number:04}", port, random.Random(seed + number))
            for number in range(count)
        ]
        self._due = []
        begin = time.monotonic()
        for printer in self.printers:
            self._selector.register(
                printer.client.socket(), selectors.EVENT_READ, printer
            )
            printer.online()
            self._due.append(begin + draw.uniform(0.0, interval))
        self._interval = interval
        self._draw = draw
        self.runs = 0

    def live(
        self, until: float, refused: float, watched: Optional[Printer] = None
    ) -> None:
        """Go on until then; a share of the runs is refused.

        watched: calibrates only when it is told to.
        """
        misc = 0.0
        while time.monotonic() < until:
            for key, _ in self._selector.select(0.02):
                key.data.client.loop_read()
            moment = time.monotonic()
            for number, due in enumerate(self._due):
                printer = self.printers[number]
                if due <= moment:
                    self._due[number] += self._interval
                    if printer is not watched:
                        printer.calibrated(self._draw.random() > refused)
                        self.runs += 1
                if printer.client.want_write():
                    printer.client.loop_write()
            if moment > misc:
                misc = moment + 5.0
                for printer in self.printers:
                    printer.client.loop_misc()

    def close(self) -> None:
        """All of them go."""
        for printer in self.printers:
            printer.client.disconnect()
