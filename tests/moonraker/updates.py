"""Moonraker's view of the checkouts in a lab."""

from __future__ import annotations

from typing import Any

from tests.hostkit.lab import Lab


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
