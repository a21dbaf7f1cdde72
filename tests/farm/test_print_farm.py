"""docs/print_farm.md with real parts: printers, Moonrakers, an MQTT broker."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from tests.farm.broker import Broker
from tests.hostkit.hosts import all_hosts, missing_hosts
from tests.hostkit.lab import Lab
from tests.hostkit.moonraker import MoonrakerError
from tests.hostkit.moonraker_package import find_moonraker
from tests.simprinter import SCENES, Fault
from tests.simprinter.world import NoiseSpec

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "print_farm"
# Seconds of a run that the machine may lose by itself
SLACK = 20.0
AT_ONCE = """\
rule_files: [{rules}]
evaluation_interval: 1m
tests:
  - interval: 1m
    input_series:
      - series: 'z_calibration_run_ok{{printer="good"}}'
        values: '1x20'
      - series: 'z_calibration_run_ok{{printer="lost"}}'
        values: '1x5 0x15'
      - series: 'z_calibration_uncertainty{{printer="good"}}'
        values: '0.004x20'
      - series: 'z_calibration_uncertainty{{printer="worn"}}'
        values: '0.031x20'
      - series: 'z_calibration_warnings{{printer="worn"}}'
        values: '1x20'
    promql_expr_test:
      - expr: sort_desc(ALERTS{{alertstate="firing"}})
        eval_time: 15m
        exp_samples:
          - labels: 'ALERTS{{alertname="CalibrationRefused",
              alertstate="firing", printer="lost", severity="page"}}'
            value: 1
          - labels: 'ALERTS{{alertname="CalibrationWarns",
              alertstate="firing", printer="worn", severity="ticket"}}'
            value: 1
          - labels: 'ALERTS{{alertname="OffsetUncertain",
              alertstate="firing", printer="worn", severity="ticket"}}'
            value: 1
"""
LATER = """\
rule_files: [{rules}]
evaluation_interval: 1h
tests:
  - interval: 1h
    input_series:
      - series: 'z_calibration_switch{{printer="good"}}'
        values: '8.315x200'
      - series: 'z_calibration_nozzle{{printer="good"}}'
        values: '1.9x200'
      - series: 'z_calibration_switch{{printer="moved"}}'
        values: '8.315x170 8.415x30'
      - series: 'z_calibration_nozzle{{printer="moved"}}'
        values: '1.9x200'
      - series: 'z_calibration_spread_switch{{printer="good"}}'
        values: '0.002x800'
      - series: 'z_calibration_spread_switch{{printer="worn"}}'
        values: '0.004+0.00001x800'
    promql_expr_test:
      - expr: ALERTS{{alertname="ProbeOrNozzleMoved"}}
        eval_time: 175h
        exp_samples:
          - labels: 'ALERTS{{alertname="ProbeOrNozzleMoved",
              alertstate="firing", printer="moved", severity="ticket"}}'
            value: 1
      - expr: ALERTS{{alertname="SwitchWears", alertstate="firing"}}
        eval_time: 790h
        exp_samples:
          - labels: 'ALERTS{{alertname="SwitchWears",
              alertstate="firing", printer="worn", severity="ticket"}}'
            value: 1
"""


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


def series():
    """What telegraf.conf makes: (measurement_name, path) by the series."""
    found, measurement = {}, None
    for block in example("telegraf.conf").split("[[")[1:]:
        options = dict(re.findall(r'^ *(\w+) = "(.*)"$', block, re.M))
        if "measurement_name" in options:
            measurement = options["measurement_name"]
        elif "path" in options:
            assert "optional = true" in block
            found[f"{measurement}_{options['rename']}"] = options["path"]
    return found


def value_at(path, message):
    """What Telegraf finds at a path of a message; None: nothing."""
    value = message
    for word in path.split("."):
        if word == "#":
            value = len(value)
        elif word == "@reverse":
            value = value[::-1]
        elif isinstance(value, list):
            value = value[int(word)] if int(word) < len(value) else None
        else:
            value = value.get(word)
        if value is None:
            return None
    return value


def test_each_series_is_of_a_field_that_is_published():
    for name, path in series().items():
        _, module, field, *_ = path.split(".")
        assert name.startswith(f"{module}_")
        assert f"{module}.{field}" in asked_for(), path


def test_series_survive_nested_and_missing_values():
    run = {"time": 5.5, "ok": False, "offset": None}
    status = {
        "last_z_offset": 0.16,
        "uncertainty": None,
        "warnings": ["a", "b"],
        "last_result": {"nozzle": 1.6, "switch": 8.0},
        "history": {
            "runs": 2,
            "results": [{"time": 1.0, "ok": True}, run],
            "spread": {"nozzle": 0.001, "switch": None, "bed": 0.002},
            "switch_nozzle": 6.4,
        },
    }
    message = {"status": {"z_calibration": status}}
    found = {name: value_at(path, message) for name, path in series().items()}
    assert {k: v for k, v in found.items() if v is not None} == {
        "z_calibration_run_time": 5.5,
        "z_calibration_run_ok": False,
        "z_calibration_offset": 0.16,
        "z_calibration_nozzle": 1.6,
        "z_calibration_switch": 8.0,
        "z_calibration_switch_nozzle": 6.4,
        "z_calibration_spread_nozzle": 0.001,
        "z_calibration_spread_bed": 0.002,
        "z_calibration_runs": 2,
        "z_calibration_warnings": 2,
    }


def test_dashboard_and_alerts_use_series_that_exist():
    dashboard = json.loads(example("dashboard.json"))
    panels = dashboard["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels) > 0
    expressions = [t["expr"] for panel in panels for t in panel["targets"]]
    assert all('printer=~"$printer"' in text for text in expressions)
    (variable,) = dashboard["templating"]["list"]
    text = " ".join([*expressions, variable["query"]["query"]])
    text += example("alerts.yml")
    used = set(re.findall(r"\b(?:z_calibration|auto_z_offset)_\w+", text))
    assert used and used <= set(series())
    (source,) = dashboard["__inputs"]
    for panel in panels:
        assert panel["datasource"]["uid"] == f"${{{source['name']}}}"
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= 24


def test_alerts_fire_for_worn_and_refused_only(tmp_path):
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("NOT TESTED: there is no promtool (Debian: prometheus)")
    config = [promtool, "check", "config", EXAMPLES / "prometheus.yml"]
    subprocess.run(config, check=True, capture_output=True)
    files = [tmp_path / "at_once.yml", tmp_path / "later.yml"]
    for file, text in zip(files, (AT_ONCE, LATER)):
        file.write_text(text.format(rules=EXAMPLES / "alerts.yml"))
    run = subprocess.run(
        [promtool, "test", "rules", *files], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr


class FarmPrinter(Lab):
    """A printer whose owner has added the example to moonraker.conf."""

    def __init__(self, name, broker, *arguments):
        self._name, self._broker = name, broker
        super().__init__(*arguments, 10.0)

    def _make_moonraker(self, python):
        moonraker = super()._make_moonraker(python)
        text = example("moonraker.conf")
        for old, new in (
            ("broker.example", "127.0.0.1"),
            ("port: 1883", f"port: {self._broker.port}"),
            ("printer-01", self._name),
        ):
            assert old in text
            text = text.replace(old, new)
        with (self.data / "config" / "moonraker.conf").open("a") as file:
            file.write(text)
        return moonraker

    def calibrated(self, switch_offset):
        """A run's offset, and how many seconds it has taken."""
        begin = time.monotonic()
        self.moonraker.run(f"CALIBRATE_Z SWITCH_OFFSET={switch_offset}")
        seconds = time.monotonic() - begin
        status = self.moonraker.status("z_calibration")
        return status["last_result"]["offset"], seconds


def scenes():
    """By name; the worn one's pin varies by some hundredths."""
    voron = SCENES["voron"]
    worn = replace(voron.world.pin, noise=NoiseSpec(sigma=0.01))
    sections = dict(voron.sections)
    sections["z_calibration"] = {
        **voron.sections["z_calibration"],
        "samples_tolerance": "0.1",
    }
    return {
        "good": voron,
        "worn": replace(voron, sections=sections).with_world(pin=worn),
        "lost": voron,
    }


@pytest.fixture
def farm(tmp_path):
    """(broker, printers by name), all homed."""
    program = shutil.which("mosquitto") or shutil.which(
        "mosquitto", path="/usr/sbin"
    )
    if program is None:
        pytest.skip("NOT TESTED: there is no mosquitto (Debian: mosquitto)")
    python = find_moonraker()
    if python is None:
        pytest.skip(f"NOT TESTED: {missing_hosts()['moonraker']}")
    with ExitStack() as stack:
        broker = stack.enter_context(Broker(program, tmp_path, python))
        printers = {}
        for name, scene in scenes().items():
            folder = tmp_path / name
            folder.mkdir()
            lab = FarmPrinter(
                name, broker, all_hosts()[-1], python, folder, scene
            )
            printers[name] = stack.enter_context(lab)
            lab.copy_by_hand("z_calibration")
            lab.start_klipper()
            lab.moonraker.wait_until_ready()
            lab.moonraker.run("G28")
        yield broker, printers


@pytest.mark.skipif(
    not os.environ.get("EVERY_HOST"), reason="a minute or more: EVERY_HOST=1"
)
@pytest.mark.timeout(280)
def test_each_run_of_each_printer_arrives_once(farm):
    broker, printers = farm
    good, worn, lost = printers["good"], printers["worn"], printers["lost"]
    with lost.standing() as printer:
        machine = printer.machine
        now = machine.rig.seconds(machine.simulation.clock.now())
        machine.break_down(Fault("stuck_closed", signal="probe", t=now))
    # Each run with another switch_offset, so that no two results are alike
    offsets = [0.44, 0.45]
    wanted = {
        name: [printers[name].calibrated(offset)[0] for offset in offsets]
        for name in ("good", "worn")
    }
    with pytest.raises(MoonrakerError, match="the probe reads triggered"):
        lost.moonraker.run("CALIBRATE_Z")
    for name, results in wanted.items():
        broker.until(lambda name=name: len(broker.results(name)) >= 2, name)
        arrived = [result["offset"] for result in broker.results(name)]
        assert arrived == pytest.approx(results)
    assert wanted["good"][0] - wanted["good"][1] == pytest.approx(0.01)
    assert broker.results("lost") == []

    # Away in the middle of a run: that goes on, and the printer knows it
    _, usual = good.calibrated(0.46)
    timer = threading.Timer(0.5, broker.stop)
    timer.start()
    offset, seconds = good.calibrated(0.47)
    timer.join()
    assert offset == pytest.approx(wanted["good"][0] - 0.03)
    assert seconds < usual + SLACK
    # Back again: what comes next arrives, once
    broker.start()
    last = worn.calibrated(0.48)[0]
    known = len(broker.results("good"))
    end = time.monotonic() + 60
    while len(broker.results("worn")) < 3 and time.monotonic() < end:
        last = worn.calibrated(0.48 + time.monotonic() % 1 / 100)[0]
    arrived = [result["offset"] for result in broker.results("worn")]
    assert arrived[-1] == pytest.approx(last)
    assert len(broker.results("good")) == known
