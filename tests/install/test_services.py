"""install.sh: which services are restarted, and when."""

from __future__ import annotations

import json
import os
import pty
import shutil
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

BOTH = ["klipper", "moonraker"]

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("klipper")]


def test_what_changed_is_restarted(machine, klipper):
    out = machine.installed()
    # There is no terminal, so sudo must not ask
    assert "sudo -n systemctl restart klipper" in machine.calls()
    assert machine.restarted() == BOTH
    assert "Restarting klipper... [OK]" in out
    assert "Restarting moonraker... [OK]" in out
    klipper.place().unlink()
    machine.installed()
    assert machine.restarted() == ["klipper"]
    machine.conf()
    machine.installed()
    assert machine.restarted() == ["moonraker"]


UNITS = [
    *("klipper", "klipper-1", "klipper-big", "klipper-mcu", "klipper_mcu"),
    *("klipper-obico", "klipperscreen", "KlipperScreen"),
    *("moonraker", "moonraker-1", "moonraker-big", "moonraker-obico"),
    "moonraker-telegram-bot",
]


def test_every_instance(machine):
    machine.systemd(UNITS)
    machine.answers(7125, "klipper moonraker idle")
    for port, name in ((7126, "1"), (7127, "big")):
        machine.conf(f"printer_{port}_data/config", f"[server]\nport: {port}\n")
        machine.answers(port, f"klipper-{name} moonraker-{name} idle")
    machine.installed()
    assert machine.restarted() == [
        *("klipper", "klipper-1", "klipper-big"),
        *("moonraker", "moonraker-1", "moonraker-big"),
    ]


def test_stopped_service_stays_stopped(machine):
    machine.systemd([*BOTH, "klipper-2"], stopped=["klipper-2"])
    out = machine.installed()
    assert "klipper-2 not restarted: it does not run" in out
    assert machine.restarted() == BOTH


@pytest.mark.parametrize(
    ("state", "is_restarted"), [("offline", False), ("degraded", True)]
)
def test_nothing_is_restarted_without_systemd(machine, state, is_restarted):
    machine.systemd(state=state)
    out = machine.installed()
    assert machine.restarted() == (BOTH if is_restarted else [])
    text = (
        "Services not restarted: this machine has no systemd that answers."
        " Restart Klipper and Moonraker yourself. Where there is systemd: sudo"
        " systemctl restart klipper moonraker\n"
    )
    assert (text in out) is not is_restarted


@pytest.mark.parametrize(
    ("units", "stopped", "names"),
    [
        (
            ["klipper-1", "klipper-2", "klipper-3", "moonraker-1"],
            ["klipper-3"],
            "klipper-1 klipper-2 moonraker-1",
        ),
        ([], [], "klipper moonraker"),
    ],
)
def test_command_that_restarts_is_told(machine, units, stopped, names):
    machine.systemd(units, stopped=stopped)
    command = "Services not restarted. When nothing prints: sudo systemctl"
    out = machine.installed("--no-restart")
    console = "RESTART in the console does not load a changed module\n"
    assert f"{command} restart {names}\n{console}Installed: " in out
    assert "Next: restart Klipper as the lines above say, then" in out
    assert machine.restarted() == []
    out = machine.installed("-u", "--no-restart")
    moonrakers = " ".join(n for n in names.split() if n.startswith("moon"))
    *_, told, last = out.splitlines()
    assert told == f"{command} restart {moonrakers}"
    assert last.startswith("Uninstalled: ")
    assert "console" not in out


def test_no_service_of_that_kind(machine):
    machine.systemd(["octoprint"])
    out = machine.installed()
    assert machine.restarted() == []
    assert "No klipper service found. Restart it yourself" in out
    assert "No moonraker service found. Restart it yourself" in out


# Prints


TWO = ["klipper-1", "klipper-2", "moonraker-1", "moonraker-2"]
WAIT = "a print is running. When it has ended: sudo systemctl restart"
ASK = "no Moonraker tells whether a print is running. When it is not: sudo"


@pytest.mark.parametrize(
    ("options", "first", "second", "restarted", "said"),
    [
        (
            # All are asked, also where only one is to be changed
            ["-m", "CONF"],
            "klipper-1 moonraker-1 idle",
            "klipper-2 moonraker-2 busy",
            "1",
            {"2": WAIT},
        ),
        # One that does not see its Klipper, which may print for somebody else
        (
            ["--no-moonraker"],
            "klipper-1 moonraker-1 unknown",
            "klipper-2 moonraker-2 idle",
            "2",
            {"1": ASK},
        ),
        # One that does not answer: another one's answer says nothing of it
        ([], "", "klipper-2 moonraker-2 idle", "2", {"1": ASK}),
        # Nobody knows whose it is
        ([], "", "idle", "", {"1": ASK, "2": ASK}),
        # Two that speak of the same one
        (
            [],
            "klipper-1 moonraker-1 idle",
            "klipper-1 moonraker-1 busy",
            "",
            {"1": WAIT, "2": ASK},
        ),
    ],
)
def test_each_printer_is_restarted_by_what_its_own_moonraker_says(
    machine, options, first, second, restarted, said
):
    machine.conf("printer_2_data/config", "[server]\nport: 7126\n")
    words = [word.replace("CONF", str(machine.conf())) for word in options]
    machine.systemd(TWO)
    machine.answers(7125, first)
    machine.answers(7126, second)
    out = machine.installed(*words)
    kinds = ["klipper"] + ["moonraker"] * (options != ["--no-moonraker"])
    names = [f"{kind}-{number}" for kind in kinds for number in "12"]
    assert machine.restarted() == [n for n in names if n[-1] in restarted]
    for name in names:
        if name[-1] in said:
            assert f"{name} not restarted: {said[name[-1]]}" in out


def test_printer_that_does_not_run_prints_nothing(machine):
    """Two printers, of which one is off: its answer is no other's."""
    machine.conf("printer_2_data/config", "[server]\nport: 7126\n")
    machine.systemd(TWO, stopped=["klipper-2"])
    machine.answers(7125, "")
    machine.answers(7126, "klipper-2 moonraker-2 unknown")
    out = machine.installed()
    assert machine.restarted() == []
    assert f"klipper-1 not restarted: {ASK}" in out
    assert "klipper-2 not restarted: it does not run" in out


@pytest.mark.parametrize("is_install", [True, False])
def test_nothing_is_restarted_while_a_printer_prints(machine, is_install):
    if not is_install:
        machine.installed("--no-restart")
    machine.systemd(answer="busy")
    out = machine.installed(*([] if is_install else ["-u"]))
    assert machine.restarted() == []
    assert f"moonraker not restarted: {WAIT} moonraker" in out
    assert (f"klipper not restarted: {WAIT} klipper" in out) is is_install


@pytest.mark.parametrize(
    ("answer", "stopped", "restarted"),
    [
        ("", [], []),
        # With no Klipper that runs nobody prints
        ("", ["klipper"], ["moonraker"]),
        # but one of another name, of which its Moonraker sees a print
        ("busy", ["klipper"], []),
    ],
)
def test_moonraker_that_does_not_tell(machine, answer, stopped, restarted):
    machine.systemd(answer=answer, stopped=stopped)
    out = machine.installed()
    assert (f"klipper not restarted: {ASK}" in out) is not stopped
    assert machine.restarted() == restarted


@pytest.mark.parametrize(
    ("server", "address"),
    [
        ("host: 0.0.0.0\nport = 80  # mine", "127.0.0.1:80"),
        ("port: 1\nhost: 192.168.1.5\n[include more.conf]", "192.168.1.5:7130"),
    ],
)
def test_where_moonraker_is_asked(machine, server, address):
    conf = machine.conf(text=f"[server]\n{server}\n[mqtt]\nport: 1883\n")
    conf.with_name("more.conf").write_text("[server]\nport: 7130\n")
    machine.installed()
    assert machine.calls("python3") == [f"python3 http://{address}"]


@contextmanager
def moonraker(code, **answers):
    """A server with an answer for each path's last word; its port."""

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self):
            name = self.path.partition("?")[0].rpartition("/")[2]
            self.send_response(code)
            self.end_headers()
            text = json.dumps({"result": answers.get(name)}, indent=1)
            self.wfile.write(text.encode())

        def log_message(self, *_words):
            """Say nothing."""

    server = HTTPServer(("127.0.0.1", 0), Answer)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        thread.join(timeout=20)
        server.server_close()


def objects(print_stats, idle_timeout="Idle"):
    """What a klippy that is ready says of itself."""
    states = {"print_stats": print_stats, "idle_timeout": idle_timeout}
    status = {k: {"state": v} for k, v in states.items() if v}
    return {"klippy_state": "ready"}, {"status": status}


RESTARTED = "Restarting klipper... [OK]"
BUSY = "klipper not restarted: a print is running"
UNKNOWN = "no Moonraker tells"


@pytest.mark.parametrize(
    ("code", "info", "query", "said"),
    [
        (200, *objects("standby"), RESTARTED),
        (200, *objects("printing"), BUSY),
        (200, *objects("paused"), BUSY),
        # A script, such as a calibration
        (200, *objects("standby", "Printing"), BUSY),
        # With no [virtual_sdcard] something else sends the print
        (200, *objects(None), UNKNOWN),
        # It may print for somebody else, or from another socket
        (200, {"klippy_state": "disconnected"}, None, UNKNOWN),
        # As after an update that has removed the links
        (200, {"klippy_state": "error"}, None, RESTARTED),
        (401, *objects("standby"), UNKNOWN),
    ],
)
def test_what_a_moonraker_answers(machine, code, info, query, said):
    """With the real program, which notices no proxy."""
    # One that an unprivileged user can reach
    real = shutil.which("python3", path=f"/usr/local/bin:{os.defpath}")
    if real is None:
        pytest.skip("no python3 outside of a home directory")
    (machine.bin / "python3").unlink()
    (machine.bin / "python3").symlink_to(real)
    with moonraker(code, info=info, query=query) as port:
        machine.conf(text=f"[server]\nport: {port}\n")
        out = machine.installed(http_proxy="http://127.0.0.1:1")
    assert {word for word in (RESTARTED, BUSY, UNKNOWN) if word in out} == {
        said
    }


# Failures


def test_restart_that_fails(machine, klipper):
    (machine.directory / "broken").write_text("klipper\n")
    outcome = machine.run()
    assert outcome.code == 6
    assert "run: sudo systemctl restart klipper" in outcome.err
    # The other one is tried all the same
    assert machine.restarted() == BOTH
    assert klipper.place().exists()


def test_sudo_may_ask_where_there_is_a_terminal(machine):
    master, terminal = pty.openpty()
    try:
        script = str(machine.checkout / "install.sh")
        outcome = machine.command([script], stdin=terminal)
    finally:
        os.close(master)
        os.close(terminal)
    assert outcome.code == 0, outcome
    calls = machine.calls()
    assert "sudo systemctl restart klipper" in calls
    # The password may take as long as a print takes to begin
    (asked,) = [n for n, call in enumerate(calls) if "python3 http" in call]
    assert calls.index("sudo -v") < asked
    assert machine.restarted() == BOTH
