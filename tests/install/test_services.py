"""install.sh: which services are restarted, and when."""

from __future__ import annotations

import json
import os
import pty
import shutil
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from tests.install.box import REPO

NAMES = ("printer_1", "printer_2")
STANDBY = '{"result": {"status": {"print_stats": {"state": "standby"}}}}'


def test_what_changed_is_restarted(machine):
    out = machine.installed()
    assert machine.restarted() == ["klipper", "moonraker"]
    assert "Restarting klipper... [OK]" in out
    assert "Restarting moonraker... [OK]" in out
    # There is no terminal, so sudo must not ask
    assert "sudo -n systemctl restart klipper" in machine.calls()


def test_only_what_changed(machine):
    machine.installed()
    (machine.home / "klipper/klippy/extras/z_calibration.py").unlink()
    machine.forget_calls()
    machine.installed()
    assert machine.restarted() == ["klipper"]
    machine.conf()
    machine.forget_calls()
    machine.installed()
    assert machine.restarted() == ["moonraker"]


UNITS = [
    *("klipper", "klipper-1", "klipper-big", "klipper-mcu", "klipper_mcu"),
    *("klipper-obico", "klipper-a_b", "klipperscreen", "KlipperScreen"),
    *("moonraker", "moonraker-1", "moonraker-big", "moonraker-obico"),
    "moonraker-telegram-bot",
]


def several(box, count):
    """As many printers with a Moonraker each."""
    for n in range(2, count + 1):
        box.conf(f"printer_{n}_data/config")


def test_every_instance(machine):
    machine.systemd(UNITS)
    several(machine, 3)
    machine.installed()
    assert machine.restarted() == [
        *("klipper", "klipper-1", "klipper-big"),
        *("moonraker", "moonraker-1", "moonraker-big"),
    ]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["-s", "klipper-1"], ["klipper-1", "moonraker-1"]),
        (
            ["-s", "klipper-big.service", "--service=klipper"],
            ["klipper-big", "klipper", "moonraker-big", "moonraker"],
        ),
        (["-s", "klipper-a_b"], ["klipper-a_b"]),
        (["-n", "1"], ["klipper-1", "moonraker-1"]),
    ],
)
def test_chosen_services(machine, options, expected):
    machine.systemd(UNITS)
    several(machine, 4)
    out = machine.installed(*options)
    assert machine.restarted() == expected
    without = "moonraker" not in " ".join(expected)
    assert ("No moonraker service found" in out) is without


def test_numbered_services(machine):
    machine.systemd(["klipper-1", "klipper-2", "klipper-3"])
    several(machine, 3)
    machine.installed("-n", "2")
    assert machine.restarted() == ["klipper-1", "klipper-2"]


@pytest.mark.parametrize("options", [["-s", "klipper-9"], ["-n", "2"]])
def test_unknown_service(machine, options):
    machine.systemd(["klipper", "klipper-1", "moonraker"])
    assert "there is no service klipper-" in machine.refused(3, *options)


def test_no_restart(machine):
    out = machine.installed("--no-restart")
    assert machine.restarted() == []
    assert "Services not restarted. Restart Klipper and Moonraker yourself" in (
        out
    )


def test_no_restart_needs_no_service(machine):
    machine.installed("--no-restart", "-s", "klipper-9")


@pytest.mark.parametrize("state", ["offline", "unknown", ""])
def test_systemd_that_does_not_run(machine, state):
    machine.systemd(state=state)
    out = machine.installed()
    assert machine.restarted() == []
    assert "Services not restarted. Restart Klipper and Moonraker" in out


@pytest.mark.parametrize("state", ["degraded", "starting"])
def test_systemd_that_runs(machine, state):
    machine.systemd(state=state)
    machine.installed()
    assert machine.restarted() == ["klipper", "moonraker"]


def test_no_service_of_that_kind(machine):
    machine.systemd(["octoprint"])
    out = machine.installed()
    assert machine.restarted() == []
    assert "No klipper service found. Restart Klipper yourself" in out
    assert "No moonraker service found. Restart Moonraker yourself" in out


# Prints


@pytest.mark.parametrize(
    "answer",
    [
        '{"print_stats": {"state": "printing"}}',
        '{"print_stats":{"state":"paused"}}',
        '{"idle_timeout": {"state": "Printing"}, "print_stats": {}}',
        '{"print_stats": {\n  "state": "printing"\n}}',
    ],
)
@pytest.mark.parametrize("option", [[], ["-u"]])
def test_nothing_is_restarted_during_a_print(machine, answer, option):
    if option:
        machine.installed()
        machine.forget_calls()
    machine.systemd(answer=answer)
    out = machine.installed(*option)
    assert machine.restarted() == []
    assert "a print is running: nothing restarted. Afterwards: sudo" in out
    assert "systemctl restart klipper moonraker\n" in out


def test_one_of_two_printers_prints(machine):
    machine.conf("printer_2_data/config", "[server]\nport: 7126\n")
    script = (
        '#!/usr/bin/env bash\nif [[ "$*" == *7126* ]]; then state=printing;'
        ' else state=standby; fi\necho "{\\"print_stats\\": {\\"state\\":'
        ' \\"$state\\"}}"\n'
    )
    machine.fake("curl", script)
    assert "a print is running" in machine.installed()
    assert machine.restarted() == []


def test_klippy_that_is_down_prints_nothing(machine):
    machine.systemd(answer='{"result": {"klippy_connected": false}}')
    machine.installed()
    assert machine.restarted() == ["klipper", "moonraker"]


@pytest.mark.parametrize("answer", [None, '{"error": {"code": 401}}'])
@pytest.mark.parametrize("options", [[], ["-s", "klipper"]])
@pytest.mark.parametrize("stopped", [["klipper"], []])
def test_moonraker_that_does_not_tell(machine, answer, options, stopped):
    machine.systemd(answer=answer, stopped=stopped)
    out = machine.installed(*options)
    text = "klipper not restarted: no Moonraker tells whether a print is"
    assert (text in out) is not stopped
    # A service that was named is started
    klipper = ["klipper"] if stopped and options else []
    assert machine.restarted() == [*klipper, "moonraker"]


@pytest.mark.parametrize("first", ["printing", "silent"])
@pytest.mark.parametrize("options", [[], ["-m", "CONF"], ["--no-moonraker"]])
def test_every_moonraker_is_asked(machine, first, options):
    """Also one that is not to be changed, and after one that is silent."""
    conf = machine.conf("printer_2_data/config", "[server]\nport: 7126\n")
    states = {"printing": ("printing", "standby"), "silent": ("", "printing")}
    one, two = states[first]
    machine.systemd(["klipper-1", "klipper-2", "moonraker-1", "moonraker-2"])
    machine.fake(
        "curl",
        '#!/usr/bin/env bash\ncase "$*" in\n'
        f'*7125*) echo "{{\\"print_stats\\":{{\\"state\\":\\"{one}\\"}}}}" ;;\n'
        f'*7126*) echo "{{\\"print_stats\\":{{\\"state\\":\\"{two}\\"}}}}" ;;\n'
        "esac\n",
    )
    options = [word.replace("CONF", str(conf)) for word in options]
    assert "a print is running" in machine.installed(*options)
    assert machine.restarted() == []


def test_more_printers_than_moonrakers_that_answer(machine):
    machine.systemd(["klipper-1", "klipper-2", "klipper-mcu", "moonraker-1"])
    out = machine.installed()
    assert "klipper-1 not restarted: no Moonraker tells" in out
    assert "klipper-2 not restarted: no Moonraker tells" in out
    assert machine.restarted() == ["moonraker-1"]


def test_stopped_service_needs_no_moonraker(machine):
    machine.systemd(
        ["klipper", "klipper-2", "moonraker"], stopped=["klipper-2"]
    )
    out = machine.installed()
    assert "klipper-2 not restarted: it does not run" in out
    assert machine.restarted() == ["klipper", "moonraker"]


def test_no_moonraker_to_ask(box):
    box.klipper()
    box.systemd()
    out = box.installed()
    assert "When it is not: sudo systemctl restart klipper" in out
    assert box.restarted() == []


@pytest.mark.parametrize(
    ("server", "address"),
    [
        ("", "127.0.0.1:7125"),
        ("port: 7999  # mine", "127.0.0.1:7999"),
        ("host: 0.0.0.0\nport = 80", "127.0.0.1:80"),
        ("host: 192.168.1.5", "192.168.1.5:7125"),
        ("\n[other]\nport: 1\n", "127.0.0.1:7125"),
        ("port: 1\n[include more.conf]", "127.0.0.1:7130"),
    ],
)
def test_where_moonraker_is_asked(machine, server, address):
    conf = machine.conf(text=f"[server]\n{server}\n[mqtt]\nport: 1883\n")
    conf.with_name("more.conf").write_text("[server]\nport: 7130\n")
    machine.installed()
    asked = [call for call in machine.calls() if call.startswith("curl ")]
    assert len(asked) == 2
    assert f"http://{address}/server/info" in asked[0]
    assert f"http://{address}/printer/objects/query?print_stats" in asked[1]
    assert all("-m 3" in call for call in asked)


@pytest.mark.parametrize("program", ["curl", "wget", "python3"])
def test_first_of_these_that_is_there_asks(machine, program):
    script = (machine.bin / "curl").read_text()
    (machine.bin / "curl").unlink()
    machine.fake(program, script)
    machine.installed()
    assert machine.restarted() == ["klipper", "moonraker"]
    assert any(call.startswith(f"{program} ") for call in machine.calls())


def test_none_of_these(machine):
    (machine.bin / "curl").unlink()
    assert "klipper not restarted" in machine.installed()


class Answer(BaseHTTPRequestHandler):
    """A Moonraker whose klippy prints, or is not connected."""

    def do_GET(self):
        asks_server = self.path == "/server/info"
        connected = self.server.is_busy
        if asks_server:
            answer = {"klippy_connected": connected}
        else:
            answer = {"status": {"print_stats": {"state": "printing"}}}
        self.send_response(200 if asks_server or connected else 404)
        self.end_headers()
        self.wfile.write(json.dumps({"result": answer}, indent=1).encode())

    def log_message(self, *_words):
        """Say nothing."""


@pytest.mark.parametrize("is_busy", [True, False])
@pytest.mark.parametrize("program", ["curl", "wget", "python3"])
def test_real_programs_get_the_answer(tmp_path, program, is_busy):
    found = shutil.which(program)
    if program == "python3":
        # Not one that needs the PATH of the tests to find itself
        found = os.path.realpath(sys.executable)
    if found is None:
        pytest.skip(f"there is no {program} on this machine")
    tools = tmp_path / "bin"
    tools.mkdir()
    (tools / program).symlink_to(found)
    for tool in ("bash", "awk", "sed", "dirname", "cat", "tr"):
        (tools / tool).symlink_to(shutil.which(tool))
    server = HTTPServer(("127.0.0.1", 0), Answer)
    server.is_busy = is_busy
    conf = tmp_path / "moonraker.conf"
    conf.write_text(f"[server]\nport: {server.server_port}\n")
    functions = f". {REPO / 'install.sh'}; every_conf='{conf}'\n"
    functions += "is_active() { true; }\nprint_state klipper"
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    done = subprocess.run(
        ["bash", "-c", functions],
        env={"PATH": str(tools), "http_proxy": "http://127.0.0.1:1"},
        capture_output=True,
        text=True,
        timeout=20,
    )
    server.shutdown()
    thread.join(timeout=20)
    server.server_close()
    assert done.stdout == ("busy\n" if is_busy else "idle\n"), done.stderr


# Failures


@pytest.mark.parametrize("broken", ["klipper", "moonraker"])
def test_restart_that_fails(machine, broken):
    (machine.directory / "broken").write_text(f"{broken}\n")
    outcome = machine.run()
    assert outcome.code == 6
    assert f"Restarting {broken}... [FAILED]" in outcome.out
    assert f"run: sudo systemctl restart {broken}" in outcome.err
    # The other one is tried all the same
    assert machine.restarted() == ["klipper", "moonraker"]
    assert (machine.home / "klipper/klippy/extras/z_calibration.py").exists()


def test_sudo_that_wants_a_password(machine):
    machine.fake("sudo", "#!/usr/bin/env bash\nexit 1\n")
    outcome = machine.run()
    assert outcome.code == 6
    assert "run: sudo systemctl restart klipper" in outcome.err


def test_no_sudo_at_all(machine):
    (machine.bin / "sudo").unlink()
    assert machine.run().code == 6


@pytest.mark.parametrize(
    "unit", ["z_calibration.service", "klipper_z_calibration.service"]
)
def test_hint_at_units_of_old_releases(machine, unit):
    machine.systemd(["klipper", "moonraker", unit.partition(".")[0]])
    out = machine.installed()
    assert f"Note: {unit} is not needed any more" in out
    assert f"sudo systemctl disable --now {unit}; sudo rm" in out
    assert machine.restarted() == ["klipper", "moonraker"]


def test_sudo_may_ask_where_there_is_a_terminal(machine):
    master, terminal = pty.openpty()
    try:
        script = str(machine.checkout / "install.sh")
        outcome = machine.command([script], stdin=terminal)
    finally:
        os.close(master)
        os.close(terminal)
    assert outcome.code == 0, outcome
    assert "sudo systemctl restart klipper" in machine.calls()
    assert machine.restarted() == ["klipper", "moonraker"]
