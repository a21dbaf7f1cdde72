"""What is told at the start of klippy reaches those who come a little later.

Moonraker listens to the console some 0.8 s after klippy is ready.
"""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from simprinter.hosts.api import ApiClient
from tools.kit.auto_z_offset import section as auto_z_section
from tools.kit.dockable_probe import SWITCH
from tools.kit.docks import calibrating
from tools.kit.setup_user import EMPTY
from tools.kit.z_calibration import section

# Scene, changes, whose note it is, what it says, and how many more there are
NOTED = {
    "z_calibration": ("cartesian", section(**EMPTY), "no place for the switch"),
    "auto_z_offset": (
        "qidi",
        auto_z_section(z_offset="-0.1"),
        "inside the bed",
    ),
    "dockable_probe": (
        calibrating(SWITCH),
        {"dockable_probe": {"return_to_last_probe_position_after_detach": "1"}},
        "is now called",
    ),
}
every_module = pytest.mark.parametrize("module", list(NOTED))


def told(lines, module, words):
    """How often it was said there."""
    start = f"// {module}: "
    return sum(line.startswith(start) and words in line for line in lines)


@pytest.fixture
def listening():
    """listening(printer): somebody else, who listens to the console from now on."""
    with ExitStack() as stack:

        def begin(printer):
            client = ApiClient(printer.session.socket)
            printer.machine.simulation.peers.append(client)
            stack.callback(client.close)
            return client

        yield begin


@pytest.mark.every_host(
    "until 2024-03 there are no warnings, and Kalico drops earlier ones"
)
@every_module
def test_note_reaches_a_client_that_comes_later(host, start, listening, module):
    scene, changes, words = NOTED[module]
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    assert told(printer.session.console, module, words) == 1
    printer.session.wait(0.8)
    client = listening(printer)
    printer.session.wait(5.0)
    assert told(client.console, module, words) == 1
    # Once: whoever comes next has the status
    printer.session.wait(5.0)
    late = listening(printer)
    printer.session.wait(5.0)
    assert told(late.console, module, words) == 0
    assert told(printer.session.console, module, words) == 2
    (note,) = [n for n in printer.status(module)["notes"] if words in n]
    warnings = [
        warning["message"]
        for warning in printer.status("configfile")["warnings"]
        if words in warning["message"]
    ]
    # Hosts of before 2024 have no such warnings
    expected = [f"{module}: {note}"] if has_warnings(host) else []
    assert warnings == expected


def has_warnings(host):
    """Whether the host has warnings that a module may add to."""
    extras = host.directory / "base" / host.layout.module_dir
    text = (extras.parent / "configfile.py").read_text(encoding="utf-8")
    return "def runtime_warning" in text or "def warn(" in text


def test_client_that_comes_long_after_the_start(start, listening):
    scene, changes, words = NOTED["z_calibration"]
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    printer.session.wait(300.0)
    client = listening(printer)
    printer.session.wait(5.0)
    assert told(client.console, "z_calibration", words) == 1


@every_module
def test_nothing_is_repeated_without_a_reason(start, listening, module):
    scene, changes, words = NOTED[module]
    noted = start(scene, changes=changes)
    noted.session.require_ready()
    noted.session.wait(20.0)
    assert told(noted.session.console, module, words) == 1
    # Of each start anew
    noted.session.restart("RESTART")
    noted.session.wait(20.0)
    assert told(noted.session.console, module, words) == 2
    # Without a correction the depth of a first touch would be told
    calm = auto_z_section(probe_z_min="-4") if scene == "qidi" else {}
    quiet = start(scene, changes=calm)
    quiet.session.require_ready()
    client = listening(quiet)
    quiet.session.wait(5.0)
    assert told(client.console, module, "") == 0
    assert quiet.status(module)["notes"] == []
