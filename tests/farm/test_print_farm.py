"""docs/print_farm.md with real parts: printers, Moonrakers, an MQTT broker."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from simprinter import SCENES, Fault
from simprinter.hosts.hosts import main_host, missing_hosts
from simprinter.hosts.moonraker import MoonrakerError
from simprinter.hosts.moonraker_package import find_moonraker
from simprinter.world import NoiseSpec
from tests.docs.documents import rows, spans
from tests.farm.broker import LIMIT, Broker, find_program
from tests.unit.loading import load
from tests.unit.runs import make_runs
from tools.kit.lab import Lab

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "print_farm"
DOCUMENT = ROOT / "docs" / "print_farm.md"
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


def keys_of_status(module):
    """The names that a module's status has, by the sources of its room."""
    methods = [
        node
        for path in (ROOT / "z_touch" / module).glob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef)
        and node.name in ("get_status", "status")
    ]
    nodes = [node for method in methods for node in ast.walk(method)]
    names = [
        k for node in nodes if isinstance(node, ast.Dict) for k in node.keys
    ]
    # What is put in afterwards
    names += [
        node.slice
        for node in nodes
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store)
    ]
    return [ast.literal_eval(name) for name in names]


def real_status():
    """What the modules publish after some runs, by their own code."""
    module = load("z_touch.history.file")
    history = module.History(None, module.File("", 50), "printer.cfg", None)
    refused = {"ok": False, "time": 1.8e9, "reason": "odd", "sites": {}}
    runs = [*make_runs(8), {**make_runs(1)[0], **refused}]
    summary = load("z_touch.history.trend").summarize_runs(runs)
    history._take(runs, summary, [])  # noqa: SLF001
    known = {
        "z_calibration": {
            "last_z_offset": 0.16,
            "last_result": result_of("z_calibration"),
            "warnings": ["a", "b"],
            "uncertainty": 0.006,
            "history": history.status,
        },
        "auto_z_offset": {"probe_z_correction": 0.1, "spread": 0.02},
    }
    return {
        module: {name: known[module].get(name) for name in names}
        for module, names in (
            (module, keys_of_status(module)) for module in known
        )
    }


def result_of(module):
    fields = load(f"z_touch.{module}.heights").Result._fields
    return {name: number / 10 for number, name in enumerate(fields)}


def test_every_field_and_series_is_one_of_the_code():
    status = real_status()
    for name in asked_for():
        module, field = name.split(".")
        assert field in status[module], f"{name} is not published"
    found = series()
    for name, path in found.items():
        _, module, field, *_ = path.split(".")
        assert name.startswith(f"{module}_")
        assert f"{module}.{field}" in asked_for(), path
        value = value_at(path, {"status": status})
        assert isinstance(value, (bool, int, float)), f"{name}: {path}"
    values = {n: value_at(p, {"status": status}) for n, p in found.items()}
    assert values["z_calibration_run_ok"] is False
    assert values["z_calibration_run_time"] == 1.8e9
    assert values["z_calibration_runs"] == 9
    assert values["z_calibration_warnings"] == 2


def test_document_names_what_there_is():
    text = DOCUMENT.read_text(encoding="utf-8")
    described, fields = set(), set()
    files, names, alerts, *_ = (
        [row for row in rows(part)]
        for part in re.split(r"\n\n(?!\|)", text)
        if "\n|---" in part
    )
    for row in names:
        first, *more = spans(row[0])
        module = re.match("z_calibration|auto_z_offset", first)[0]
        stem = first.rpartition("_")[0]
        described |= {first, *(stem + name for name in more)}
        fields |= {f"{module}.{f.split('.')[0]}" for f in spans(row[1])}
    assert described == set(series())
    assert fields == {
        ".".join(path.split(".")[1:3]) for path in series().values()
    }
    assert {spans(row[0])[0] for row in alerts} == set(
        re.findall(r"alert: (\w+)", example("alerts.yml"))
    )
    listed = {name for row in files for name in spans(row[0])}
    assert listed == {path.name for path in EXAMPLES.iterdir()}


def test_a_message_may_lack_whatever_has_not_changed():
    status = {"uncertainty": None, "history": {"results": []}}
    message = {"status": {"z_calibration": status}}
    assert not any(
        value_at(path, message) is not None for path in series().values()
    )


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
def farm():
    """(broker, printers by name), all homed."""
    program = find_program()
    if program is None:
        pytest.skip("NOT TESTED: neither mosquitto nor amqtt is to be had")
    python = find_moonraker()
    if python is None:
        pytest.skip(f"NOT TESTED: {missing_hosts()['moonraker']}")
    with ExitStack() as stack:
        # pytest's are too long for the name of a socket
        folder = stack.enter_context(TemporaryDirectory(prefix="farm-"))
        broker = stack.enter_context(Broker(program, Path(folder), python))
        printers = {}
        for name, scene in scenes().items():
            home = Path(folder, name)
            home.mkdir()
            lab = FarmPrinter(name, broker, main_host(), python, home, scene)
            printers[name] = stack.enter_context(lab)
            lab.copy_by_hand("z_calibration")
            lab.start_klipper()
            lab.moonraker.wait_until_ready()
            # On a busy machine hours pass between two runs
            lab.moonraker.run("SET_IDLE_TIMEOUT TIMEOUT=86400\nG28")
        yield broker, printers


def newest(broker, printer):
    """The last number of each of its series."""
    found = {}
    for message in broker.messages():
        if message.printer == printer:
            content = {"status": message.status}
            values = {n: value_at(p, content) for n, p in series().items()}
            found.update({n: v for n, v in values.items() if v is not None})
    return found


def arrived(broker, printer):
    return [result["offset"] for result in broker.results(printer)]


def kept(broker):
    """The offsets in the history that the good printer published last."""
    histories = [
        message.status["z_calibration"]["history"]["results"]
        for message in broker.messages()
        if message.printer == "good"
        and "history" in message.status.get("z_calibration", {})
    ]
    return [run["offset"] for run in histories[-1]]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_each_run_of_each_printer_arrives_once(farm):
    broker, printers = farm
    good, lost = printers["good"], printers["lost"]
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
        broker.until(lambda n=name: len(arrived(broker, n)) >= 2, name)
        broker.until(
            lambda n=name: newest(broker, n).get("z_calibration_runs") == 2,
            f"the history of {name}",
        )
        assert arrived(broker, name) == pytest.approx(results)
        assert newest(broker, name)["z_calibration_run_ok"] is True
    assert wanted["good"][0] - wanted["good"][1] == pytest.approx(0.01)
    varies = "z_calibration_spread_switch"
    assert newest(broker, "worn")[varies] > newest(broker, "good")[varies]
    broker.until(
        lambda: newest(broker, "lost").get("z_calibration_run_ok") is False,
        "the refusal",
    )
    assert arrived(broker, "lost") == []

    # Away in the middle of a run: that goes on, and the printer knows it
    _, usual = good.calibrated(0.46)
    timer = threading.Timer(0.5, broker.stop)
    timer.start()
    missed, seconds = good.calibrated(0.47)
    timer.join()
    assert missed == pytest.approx(wanted["good"][0] - 0.03)
    assert seconds < usual + SLACK
    # Back again: what comes next arrives, once, with what was missed
    broker.start()
    for name in ("worn", "good"):
        known, end = len(arrived(broker, name)), time.monotonic() + LIMIT
        offset = 0.48
        while len(arrived(broker, name)) == known:
            assert time.monotonic() < end, f"nothing arrives from {name}"
            last = printers[name].calibrated(offset)[0]
            offset += 0.001
        broker.until(
            lambda n=name, z=last: arrived(broker, n)[-1] == pytest.approx(z),
            f"the last result of {name}",
        )
        results = arrived(broker, name)
        assert len(set(results)) == len(results)
    broker.until(
        lambda: any(offset == pytest.approx(missed) for offset in kept(broker)),
        "the missed run in the history",
    )
