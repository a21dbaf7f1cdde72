"""simplay: a page and Moonraker before somebody's printer."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from contextlib import closing, contextmanager

import psutil
import pytest
import websocket

from simplay import plugins
from simplay.__main__ import main
from simplay.tests.browser import browser, programs
from simplay.tests.terminals import LIMIT, Terminal
from simprinter.hosts.hosts import missing_hosts
from simprinter.hosts.moonraker import free_port
from simprinter.hosts.moonraker_package import find_moonraker
from simprinter.running import SAMPLE

pytestmark = pytest.mark.slow

WORLD = str(SAMPLE / "world.toml")
# One that tells how far it is, as the page shows it of any plugin
PLUGIN = """
class Halfway:
    def __init__(self, config):
        self.printer = config.get_printer()
        gcode = self.printer.lookup_object("gcode")
        gcode.register_command("HALFWAY", self.cmd_HALFWAY, desc="Go down")
        self.phase = "idle"

    def cmd_HALFWAY(self, gcmd):
        toolhead = self.printer.lookup_object("toolhead")
        self.phase = "going_down"
        toolhead.manual_move([None, None, 0.5 * toolhead.get_position()[2]], 5)
        toolhead.wait_moves()
        self.phase = "idle"
        gcmd.respond_info("Halfway down")
        gcmd.respond_raw("// action:prompt_begin Halfway")
        gcmd.respond_raw("// action:prompt_button Again|HALFWAY")
        gcmd.respond_raw("// action:prompt_show")

    def get_status(self, eventtime):
        return {"phase": self.phase, "progress": 0.5}


def load_config(config):
    return Halfway(config)
"""


@pytest.fixture
def files(tmp_path):
    """A user's folder with a printer.cfg and a plugin."""
    if find_moonraker() is None:
        pytest.skip(f"NOT TESTED: {missing_hosts()['moonraker']}")
    text = (SAMPLE / "printer.cfg").read_text()
    (tmp_path / "printer.cfg").write_text(f"{text}\n[halfway]\n")
    (tmp_path / "halfway.py").write_text(PLUGIN)
    return tmp_path


@contextmanager
def played(*options):
    """One that has begun."""
    words = ["-m", "simplay", *map(str, options), "--speed", "20"]
    words += ["--port", str(free_port()), "--page", str(free_port())]
    with closing(Terminal(words)) as shown:
        shown.until_begun()
        yield shown


def with_plugin(files):
    cfg, plugin = files / "printer.cfg", files / "halfway.py"
    return cfg, "--world", WORLD, "--extras", plugin, "--seed", "3"


def hello_of(shown):
    """What its page is told first."""
    url = shown.page.replace("http", "ws") + "/live"
    live = websocket.create_connection(url, timeout=LIMIT, origin=shown.page)
    with closing(live):
        return json.loads(live.recv())


@pytest.mark.timeout(4 * LIMIT)
def test_page_plugin_truth_and_end(files):
    with played(*with_plugin(files)) as shown:
        before = (files / "printer.cfg").read_text()
        assert re.search(
            r"^Printer .*printer\.cfg, seed 3, ", shown.output, re.M
        )
        assert "A printer to play with" in shown.get_page("/").text
        hello = hello_of(shown)
        assert hello["machine"].startswith("printer.cfg, seed 3, ")
        assert hello["moonraker"] == shown.url
        assert hello["program"] == "simplay"
        assert hello["parts"]["inductive"]["x_offset"] == -25.0
        assert hello["wires"] == ["x_endstop", "y_endstop", "probe"]
        assert "break" in hello["commands"] and "lay" not in hello["commands"]
        # Typed into the page's console they are no G-code
        assert {"break", "lay", "help", "quit"} <= set(hello["words"])
        assert hello["spot"] == [110.0, 110.0, 0.0]
        assert hello["watched"] == ["halfway"]
        # Nothing is known of plugins but what they tell themselves
        assert not {"shortcuts", "cards", "scenes", "report"} & set(hello)
        shown.until_ready()
        assert shown.run("G28").ok
        shown.until("X endstop, at X0.0")
        shown.until("probe senses the bed")
        shown.until(r"true gap: Z=0 is 0\.0\d\d mm .* at X110 Y110")
        assert shown.run("G1 Z20 F600\nHALFWAY").ok
        shown.type("break probe", "^the wire of probe is broken: always")
        refused = shown.run("PROBE").json()["error"]["message"]
        assert "prior to movement" in refused
        shown.type("nonsense", "^!! nonsense: unknown")
        # It is a copy that the page changes
        assert (files / "printer.cfg").read_text() == before
        assert "[halfway]" in (shown.config / "printer.cfg").read_text()
        assert len(shown.processes()) >= 3
        shown.assert_ends(signal.SIGINT)
        assert not shown.config.parents[1].exists()


@pytest.mark.timeout(4 * LIMIT)
def test_folder_stays_when_the_printer_cannot_go_on(files):
    """What was tried out in printer.cfg is not lost with klippy."""
    with played(files / "printer.cfg", *with_plugin(files)[1:]) as shown:
        shown.until_ready()
        tried = shown.config / "printer.cfg"
        tried.write_text(f"{tried.read_text()}# tried\n")
        (klippy,) = [
            process
            for process in psutil.Process(shown.pid).children(recursive=True)
            if any(f.path.endswith("/klippy.log") for f in process.open_files())
        ]
        klippy.kill()
        shown.until("^!! the printer cannot go on: ")
        assert shown.ended() == 1
        assert re.search(
            r"^The folder is kept, with .*: (\S+)$", shown.output, re.M
        )
        assert tried.read_text().endswith("# tried\n")
        assert shown.processes() == []


@pytest.mark.timeout(8 * LIMIT)
def test_page_in_a_browser(files):
    """What fits any printer, and nothing of anybody's modules."""
    if programs() is None:
        with browser(""):
            pass
    with played(*with_plugin(files)) as shown, browser(shown.page) as page:
        page.until_ready()
        assert page.buttons("#shortcuts") == [
            "Home",
            "Restart",
            "Emergency stop",
        ]
        assert not page.value(
            "document.querySelector('#choice').checkVisibility()"
        )
        assert page.text("#machine").startswith("printer.cfg, seed 3, ")
        page.press("#shortcuts", "Home")
        page.until(lambda: "mm" in page.text("#gap"), "the gap is known")
        assert abs(float(page.text("#gap").split()[0])) < 0.05
        page.run("G1 Z20 F600", "> G1")
        told = page.watch(
            "document.querySelector('#phase').textContent === 'going down 50 %'"
        )
        page.send("HALFWAY")
        page.until(told, "phase")
        page.until(lambda: "Halfway down" in page.console(), "its line")
        page.press("#dialog", "Again")
        page.until(lambda: page.console().count("> HALFWAY") == 2, "again")
        page.press("#dialog", "✕")
        page.until(lambda: not page.buttons("#dialog"), "it is closed")
        page.do("press probe")
        page.until(lambda: "a hand presses" in page.text("#told"), "told")
        page.find("#config summary").click()
        text = page.find("#config-text")
        page.until(lambda: "[halfway]" in text.get_property("value"), "text")
        text.send_keys("\n[gcode_macro HELLO]\ngcode: HALFWAY\n")
        with page.restarts():
            page.press("#config", "Save and restart")
        page.until(lambda: page.text("#gap") == "–", "nothing is homed")
        page.run("HELLO", "Halfway down")
        page.press("#shortcuts", "Emergency stop")
        page.until(lambda: "shutdown" in page.text("#away"), "shutdown")
        page.press("#shortcuts", "Restart")
        page.until_ready()
        assert page.complaints() == []


@pytest.mark.timeout(4 * LIMIT)
def test_sample_and_what_klippy_refuses(files):
    """Without a file it is the sample; Moonraker comes back; a mistake waits."""
    with played() as shown:
        assert hello_of(shown)["machine"].startswith("printer.cfg, seed 0, ")
        shown.until_ready()
        (moonraker,) = [
            process
            for process in psutil.Process(shown.pid).children()
            if "moonraker" in process.cmdline()
        ]
        moonraker.kill()
        shown.until("^restarted moonraker")
        shown.until_ready()
        shown.type("quit", "")
        assert shown.ended() == 0
        assert shown.processes() == []
    with played(files / "printer.cfg") as shown:
        assert "!! error: Section 'halfway' is not a valid" in shown.output
        assert hello_of(shown)["parts"]["inductive"]
        shown.assert_ends(signal.SIGTERM)


@pytest.mark.timeout(4 * LIMIT)
def test_switch_of_any_name(files):
    """A world may call it anything."""
    world = files / "world.toml"
    text = (SAMPLE / "world.toml").read_text()
    world.write_text(text.replace("x_endstop", "left_stop"))
    with played("--world", world) as shown:
        shown.until_ready()
        assert shown.run("G28").ok
        shown.until("left_stop, at X0.0")
        shown.until("Y endstop, at Y0.0")
        shown.type("press left_stop", "^a hand presses left_stop")
        assert hello_of(shown)["wires"][0] == "left_stop"
        shown.assert_ends(signal.SIGINT)


@pytest.fixture
def refused(capsys, monkeypatch):
    """refused(words): what stands on stderr where it does not begin."""
    monkeypatch.setattr("simplay.__main__.starting.close", lambda: None)

    def refused(*words):
        handlers = {n: signal.getsignal(n) for n in (1, 2, 15)}
        try:
            assert main(words) == 1
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return capsys.readouterr().err

    return refused


def test_missing_moonraker_is_told(refused, monkeypatch):
    monkeypatch.setattr(plugins, "find_moonraker", lambda: None)
    monkeypatch.setattr(
        plugins, "missing_hosts", lambda: {"moonraker": "no way to it"}
    )
    told = "error: simplay needs Moonraker: no way to it\n"
    assert refused() == told


@pytest.mark.parametrize("name", ["tornado", "jsonschema"])
def test_missing_package_is_told(name):
    """As where a checkout is run that was never installed."""
    code = "import runpy, sys; sys.modules[sys.argv.pop()] = None;"
    code += "runpy.run_module('simplay', run_name='__main__')"
    words = [sys.executable, "-c", code, name]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == (
        f"error: simplay needs {name}, which is not installed; run"
        " `pip install ./simplay` in the checkout\n"
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["/no.cfg"], "/no.cfg: cannot be read"),
        (["--world", "/no.toml"], "/no.toml"),
        (["--extras", "/no.py"], "no file /no.py"),
        (["--listen", "203.0.113.5"], "--listen 203.0.113.5: not here"),
    ],
)
def test_what_is_not_there_is_told(words, told, refused, files):
    assert told in refused(*words)
