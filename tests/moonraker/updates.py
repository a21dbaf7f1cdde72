"""What Moonraker is asked for in a lab."""

from __future__ import annotations

import time
from typing import Any

from tools.kit.lab import Lab


def refreshed(lab: Lab, name: str = "z_calibration") -> dict[str, Any]:
    """The status of a checkout, after a look at its origin."""
    lab.moonraker.wait_until(
        # Refused while it still looks for the first time
        lambda: lab.moonraker.post("/machine/update/refresh", name=name),
        f"{name} is refreshed",
    )
    return status_of(lab, name)


def status_of(lab: Lab, name: str = "z_calibration") -> dict[str, Any]:
    """The status of a checkout, as Moonraker knows it."""
    return lab.moonraker.get("/machine/update/status")["version_info"][name]


def restarted(lab: Lab, command: str) -> float:
    """Have klippy begin anew in the same process; when it had gone (Unix, s)."""
    with lab.moonraker.listen() as listener:
        lab.moonraker.run(command)
        listener.collect("notify_klippy_disconnected", lambda _: True)
        gone = time.time()
        listener.collect("notify_klippy_ready", lambda _: True)
    return gone


def calibrated(lab: Lab) -> dict[str, Any]:
    """The module's status after a calibration."""
    assert lab.moonraker.run("G28\nCALIBRATE_Z") == "ok"
    status = lab.moonraker.status("z_calibration")
    assert status["valid"]
    return status
