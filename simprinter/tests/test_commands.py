"""simprinter run, world and sample."""

from __future__ import annotations

import re

import pytest

from simprinter.__main__ import main
from simprinter.hosts import hosts
from simprinter.running import SAMPLE

CFG = str(SAMPLE / "printer.cfg")
WORLD = str(SAMPLE / "world.toml")
PLUGIN = """
class Hello:
    def __init__(self, config):
        self.printer = config.get_printer()
        self.name = config.get("name")
        gcode = self.printer.lookup_object("gcode")
        gcode.register_command("HELLO", self.cmd_HELLO)

    def cmd_HELLO(self, gcmd):
        if self.name == "nobody":
            raise gcmd.error("There is nobody")
        gcmd.respond_info("Hello %s" % self.name)


def load_config(config):
    return Hello(config)
"""


@pytest.fixture(autouse=True)
def one_host(monkeypatch):
    """As for somebody whose Klipper is there already.

    What other tests of this process have started still runs.
    """
    monkeypatch.setattr("simprinter.__main__.starting.close", lambda: None)
    monkeypatch.setattr(
        "simprinter.options.choose_host", lambda name: hosts.main_host()
    )


@pytest.fixture
def run(tmp_path, capsys):
    """run(G-code, more of printer.cfg): exit status, output, errors."""

    def run(gcode, more="", *options):
        cfg = tmp_path / "printer.cfg"
        cfg.write_text(f"{(SAMPLE / 'printer.cfg').read_text()}\n{more}")
        plugin, file = tmp_path / "hello.py", tmp_path / "commands.gcode"
        plugin.write_text(PLUGIN)
        file.write_text(gcode)
        words = ["run", str(cfg), str(file), "--extras", str(plugin)]
        status = main([*words, "--world", WORLD, *options])
        told = capsys.readouterr()
        return status, told.out, told.err

    return run


def test_run_shows_console_and_contacts(run):
    status, out, err = run(
        "; first home\nG28\n\nHELLO\nPROBE\n", "[hello]\nname: world\n"
    )
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert [line for line in lines if line[0] == ">"] == [
        "> G28",
        "> HELLO",
        "> PROBE",
    ]
    after = lines[lines.index("> HELLO") + 1 :]
    assert after[0] == "// Hello world"
    touched = [line for line in after if "contact inductive_bed" in line]
    (place,) = touched
    # The probe triggers 1.5 mm above the bed, as the world has it
    assert float(re.search(r"trigger=([\d.]+)", place)[1]) == pytest.approx(
        1.5, abs=0.01
    )


@pytest.mark.parametrize(
    ("gcode", "more", "told"),
    [
        ("G28\nHELLO\nPROBE", "[hello]\nname: nobody", "There is nobody"),
        ("G28", "[hello]", "Option 'name' in section 'hello' must be"),
        ("G28\nG1 Z-1 F300", "", "nozzle_bed"),
        ("G28\nM112", "", "shutdown"),
    ],
)
def test_run_ends_with_1_after_an_error_or_a_crash(run, gcode, more, told):
    status, out, err = run(gcode, more)
    assert status == 1
    assert told in err
    assert "> PROBE" not in out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["run", "/no.cfg", "{gcode}"], "/no.cfg: cannot be read"),
        (["run", CFG, "/no.gcode"], "/no.gcode"),
        (["run", CFG, "{gcode}", "--world", "/no.toml"], "/no.toml"),
        (["run", CFG, "{gcode}", "--extras", "/no.py"], "no file /no.py"),
        (["run", CFG, "{gcode}", "--host", "/no"], "host /no: give the"),
        (["world"], "name a printer.cfg"),
    ],
)
def test_what_is_not_there_is_told(words, told, tmp_path, capsys):
    gcode = tmp_path / "a.gcode"
    gcode.write_text("G28")
    assert main([word.format(gcode=gcode) for word in words]) == 1
    assert told in capsys.readouterr().err


def test_sample_is_written_once(tmp_path, capsys):
    assert main(["sample", str(tmp_path / "new")]) == 0
    names = {path.name for path in (tmp_path / "new").iterdir()}
    assert names == {"printer.cfg", "world.toml"}
    assert main(["sample", str(tmp_path / "new")]) == 1
    assert "is there already" in capsys.readouterr().err


def test_world_prints_a_world_or_the_schema(capsys):
    assert main(["world", CFG]) == 0
    assert "[signals]" in capsys.readouterr().out
    assert main(["world", "--schema"]) == 0
    assert '"$schema"' in capsys.readouterr().out
