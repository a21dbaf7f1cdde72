"""What klippy says of configurations, many of them quickly.

A klippy that is told to restart reads a configuration in a tenth of a second,
starting one takes ten times as long.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Optional, Union

from simprinter import Scene
from simprinter.hosts.hosts import Host
from tools.kit.docks import DOCK_SCENES
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES, Sections

# Scenes of which a printer may stay
_KNOWN = {**SCENES, **DOCK_SCENES}
# As many printers stay, with klippy idle, for the next configuration
_KEPT = 3

_printers: OrderedDict[tuple[str, str], Printer] = OrderedDict()


def load(
    host: Host,
    changes: Optional[Sections] = None,
    scene: Union[str, Scene] = "voron",
) -> tuple[str, str]:
    """(state, message) of klippy with a scene's configuration, changed.

    Raises AssertionError if the machine touches anything.
    """
    scene = SCENES[scene] if isinstance(scene, str) else scene
    if _KNOWN.get(scene.name) is not scene:
        with Printer(host, scene, changes) as printer:
            return _judged(printer, printer.session.start())
    key = (host.name, scene.name)
    printer = _printers.pop(key, None) or Printer(host, scene)
    try:
        config = printer.scene.config(printer.machine.serials, changes)
        found = _judged(printer, printer.session.reload(config))
    except BaseException:
        printer.session.close()
        printer.machine.close()
        raise
    _printers[key] = printer
    if len(_printers) > _KEPT:
        _close(_printers.popitem(last=False)[1])
    return found


def close() -> None:
    """End all that has been kept."""
    while _printers:
        _close(_printers.popitem()[1])


def _judged(printer: Printer, found: tuple[str, str]) -> tuple[str, str]:
    assert printer.machine.truth.touches == []
    return found


def _close(printer: Printer) -> None:
    with printer:
        pass
