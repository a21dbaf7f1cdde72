"""The files of docs/print_farm.md: what they read is there, the alerts fire."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from simprinter import Fault
from tests.docs.documents import rows, spans
from tools.kit.runs import make_runs

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "print_farm"
DOCUMENT = ROOT / "docs" / "print_farm.md"


def example(name):
    return (EXAMPLES / name).read_text(encoding="utf-8")


def asked_for():
    """The fields that Moonraker publishes, as module.field."""
    objects = example("moonraker.conf").partition("status_objects:")[2]
    found = set()
    for line in objects.split():
        module, fields = line.split("=")
        found |= {f"{module}.{field}" for field in fields.split(",")}
    return found


def paths():
    """What telegraf.conf makes: the path in a message by the series."""
    conf = tomllib.loads(example("telegraf.conf"))
    return {
        f"{block['measurement_name']}_{field['rename']}": field["path"]
        for each in conf["inputs"]["mqtt_consumer"]
        for block in each["json_v2"]
        for field in block["field"]
    }


def value_at(path, content):
    """The value at a path of Telegraf: names, numbers, # and @reverse."""
    for word in path.split("."):
        if word == "#":
            content = len(content)
        elif word == "@reverse":
            content = content[::-1]
        elif isinstance(content, list):
            content = content[int(word)]
        else:
            content = content[word]
    return content


@pytest.fixture
def real_status(start, tmp_path):
    """What the modules publish after some runs, the last of them refused."""
    lines = [json.dumps(run) + "\n" for run in make_runs(8)]
    (tmp_path / "printer.jsonl").write_text("".join(lines))
    own = {"z_calibration": {"history": str(tmp_path)}}
    printer = start("voron", own).homed()
    printer.run("CALIBRATE_Z")
    machine = printer.machine
    now = machine.rig.seconds(machine.simulation.clock.now())
    machine.break_down(Fault("stuck_closed", signal="probe", t=now))
    printer.fail("CALIBRATE_Z")
    other = start("qidi").homed()
    other.run("AUTO_Z_CALIBRATE")
    return {
        "z_calibration": printer.status("z_calibration"),
        "auto_z_offset": other.status("auto_z_offset"),
    }


def test_every_field_and_series_is_one_of_the_modules(real_status):
    for name in asked_for():
        module, field = name.split(".")
        assert field in real_status[module], f"{name} is not published"
    values = {}
    for name, path in paths().items():
        if name == "printer_online":  # Moonraker's own
            continue
        _, module, field, *_ = path.split(".")
        assert name.startswith(f"{module}_")
        assert f"{module}.{field}" in asked_for(), path
        values[name] = value_at(path, {"status": real_status})
        # Prometheus is shown no other
        assert isinstance(values[name], (bool, int, float)), name
    own = real_status["z_calibration"]
    last = own["history"]["results"][-1]
    assert values["z_calibration_run_ok"] is False
    assert values["z_calibration_run_time"] == last["time"]
    assert values["z_calibration_runs"] == 10
    assert values["z_calibration_warnings"] == len(own["warnings"])


def test_numbers_are_shown_to_this_computer_only():
    conf = tomllib.loads(example("telegraf.conf"))
    (output,) = conf["outputs"]["prometheus_client"]
    assert output["listen"].startswith("127.0.0.1:")
    # The first one drops what is true or false
    assert output["metric_version"] == 2


def test_document_names_what_there_is():
    text = DOCUMENT.read_text(encoding="utf-8")
    described, named = set(), set()
    files, names, alerts, *_ = (
        [row for row in rows(part)]
        for part in re.split(r"\n\n(?!\|)", text)
        if "\n|---" in part
    )
    for row in names:
        first, *more = spans(row[0])
        if first.startswith("printer_"):
            described.add(first)
            continue
        module = re.match("z_calibration|auto_z_offset", first)[0]
        stem = first.rpartition("_")[0]
        described |= {first, *(stem + name for name in more)}
        named |= {f"{module}.{f.split('.')[0]}" for f in spans(row[1])}
    assert described == set(paths())
    assert named == {
        ".".join(path.split(".")[1:3])
        for path in paths().values()
        if path.startswith("status.")
    }
    assert {spans(row[0])[0] for row in alerts} == set(
        re.findall(r"alert: (\w+)", example("alerts.yml"))
    )
    listed = {name for row in files for name in spans(row[0])}
    assert listed == {path.name for path in EXAMPLES.iterdir()}


def test_dashboard_and_alerts_use_series_that_exist():
    dashboard = json.loads(example("dashboard.json"))
    panels = dashboard["panels"]
    expressions = [t["expr"] for panel in panels for t in panel["targets"]]
    assert expressions
    assert all('printer=~"$printer"' in text for text in expressions)
    (variable,) = dashboard["templating"]["list"]
    text = " ".join([*expressions, variable["query"]["query"]])
    text += example("alerts.yml")
    used = set(
        re.findall(r"\b(?:z_calibration|auto_z_offset|printer)_\w+", text)
    )
    assert used and used <= set(paths())
    (source,) = dashboard["__inputs"]
    for panel in panels:
        assert panel["datasource"]["uid"] == f"${{{source['name']}}}"


@pytest.mark.parametrize("words", ["check config", "test rules"])
def test_alerts_fire_as_the_document_says(words):
    """Of a printer that is well none fires."""
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("NOT TESTED: there is no promtool (Debian: prometheus)")
    files = [EXAMPLES / "prometheus.yml"]
    if words == "test rules":
        files = sorted(Path(__file__).parent.glob("*.yml"))
        assert files
    run = subprocess.run(
        [promtool, *words.split(), *files], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr
