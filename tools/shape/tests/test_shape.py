"""make shape counts right, and forgets no command."""

from __future__ import annotations

import pytest

from simprinter.hosts.hosts import main_host
from tools.kit.printer import MODULES, module_files
from tools.shape import __main__ as shape
from tools.shape.__main__ import CASES, Case, started

pytestmark = pytest.mark.one_host

# 5 functions that have a name, of which TINY runs 3 in 2 files
TINY = """
from . import tiny_touch

class Tiny:
    def __init__(self, config):
        self.gcode = config.get_printer().lookup_object("gcode")
        self.gcode.register_command("TINY", self.cmd_TINY)
        self.gcode.register_command("TINY_HOME", self.cmd_TINY_HOME)

    def cmd_TINY(self, gcmd):
        for name in [word.upper() for word in ("a", "b")]:
            self.touch(lambda: name)

    def touch(self, name):
        name()
        tiny_touch.touch(self.gcode)

    def cmd_TINY_HOME(self, gcmd):
        self.gcode.run_script_from_command("G28 X")

    def nobody(self):
        pass

def load_config(config):
    return Tiny(config)
"""
TOUCH = """
def touch(gcode):
    gcode.run_script_from_command("G1 Z10 F900")
    gcode.run_script_from_command("PROBE")
"""


def test_it_counts_right(host, tmp_path):
    sources = {"tiny": TINY, "tiny_touch": TOUCH}
    for name, source in sources.items():
        (tmp_path / f"{name}.py").write_text(source)
    files = {name: tmp_path / f"{name}.py" for name in sources}
    case = Case("qidi", {"tiny": {}}, ())
    with started(
        host, case, {**module_files(), **files}, [*sources]
    ) as printer:
        printer.run("SHAPE RUN=TINY\nTINY\nSHAPE RUN=TINY_HOME\nSHAPE RUN=M400")
        found = shape.shapes(printer)
    none = {"functions": 0, "files": 0, "calls": 0, "frames": 0}
    assert found == {
        "TINY": {"functions": 3, "files": 2, "calls": 5, "frames": 3},
        "TINY_HOME": {"functions": 1, "files": 1, "calls": 1, "frames": 0},
        "M400": none,
    }


# Of each module, in whose good runs something is touched
PROBING = {
    "z_calibration": {
        "CALIBRATE_Z",
        "CALIBRATE_Z_ACCURACY",
        "PROBE_Z_ACCURACY",
        "Z_CALIBRATION_NOZZLE_GROWTH",
        "Z_CALIBRATION_WAIT",
    },
    "auto_z_offset": {
        "AUTO_Z_CALIBRATE",
        "AUTO_Z_HOME_Z",
        "AUTO_Z_MEASURE_OFFSET",
        "AUTO_Z_PROBE",
        "AUTO_Z_TWIST",
        "AUTO_Z_WAIT",
    },
    "dockable_probe": {"PROBE"},
    "extra_probe": {
        "EXTRA_PROBE",
        "EXTRA_PROBE_ACCURACY",
        "EXTRA_PROBE_CONTINUE",
    },
}


@pytest.mark.slow
def test_every_command_has_a_row(capsys, tmp_path):
    file = tmp_path / "shape.json"
    # Beside ours, as another module, the same
    same = [f"{name}={module_files()[name]}" for name in MODULES]
    shape.main(["--json", str(file), *same])
    name, table = capsys.readouterr().out.split("\n", 1)
    assert name == main_host().name
    # All of it, as another module has each command
    assert shape.render(str(file)) == f"\nOn {name}.\n\n{table}"
    _, _, *lines = table.splitlines()
    probing = {module: set() for module in MODULES}
    for line in lines:
        module, command, *counts, other = map(str.strip, line.split("|")[1:-1])
        theirs = other.split()
        functions, files, calls = map(int, counts[:3])
        # A command that waits looks at the clock once more, or not
        assert int(theirs[2]) == pytest.approx(calls, rel=0.01), command
        assert [theirs[0], theirs[1], theirs[3]] == [*counts[:2], counts[3]]
        assert calls >= functions >= files >= 2, command
        if counts[3] != "-":
            assert 1 < int(counts[3]) < functions, command
            probing[module].add(command)
    assert probing == PROBING


def test_command_without_a_run_is_an_error(host, monkeypatch):
    (case,) = CASES["extra_probe"]
    query = [run for run in case.runs if "QUERY" in run.script]
    fewer = [run for run in case.runs if run not in query]
    monkeypatch.setitem(CASES, "extra_probe", [case._replace(runs=fewer)])
    with pytest.raises(LookupError, match=r"\['QUERY_EXTRA_PROBE'\]"):
        shape.ours(host, "extra_probe")
