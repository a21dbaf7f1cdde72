"""docs/print_farm.md with real parts: printers, Moonrakers, an MQTT broker."""

from __future__ import annotations

import json
import random
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

from simprinter import Fault
from simprinter.hosts.hosts import main_host, missing_hosts
from simprinter.hosts.moonraker import MoonrakerError
from simprinter.hosts.moonraker_package import find_moonraker
from simprinter.world import NoiseSpec
from tests.docs.documents import rows, spans
from tests.farm.broker import LIMIT, Broker, find_program
from tools.farm import __main__ as farm_tool
from tools.farm import servers
from tools.farm.printers import Printer
from tools.farm.telegraf import Telegraf, value_at
from tools.kit.lab import Lab
from tools.kit.runs import make_runs
from tools.kit.scenes import SCENES

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
      - series: 'printer_online{{printer="good"}}'
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
# Who is away, and of whom nothing is known: "mute" is connected, "gone" was
AWAY = """\
rule_files: [{rules}]
evaluation_interval: 1h
tests:
  - interval: 1h
    input_series:
      - series: 'up{{job="printers"}}'
        values: '0x30'
      - series: 'printer_online{{printer="good"}}'
        values: '1x30'
      - series: 'z_calibration_run_ok{{printer="good"}}'
        values: '1x30'
      - series: 'printer_online{{printer="mute"}}'
        values: '1x30'
      - series: 'printer_online{{printer="gone"}}'
        values: '0x30'
      - series: 'z_calibration_run_time{{printer="old"}}'
        values: '-1123200x30'
      - series: 'z_calibration_run_time{{printer="good"}}'
        values: '0x30'
    promql_expr_test:
      - expr: sort_desc(ALERTS{{alertstate="firing"}})
        eval_time: 28h
        exp_samples:
          - labels: 'ALERTS{{alertname="NoNumbers",
              alertstate="firing", printer="mute", severity="ticket"}}'
            value: 1
          - labels: 'ALERTS{{alertname="NotCalibrated",
              alertstate="firing", printer="old", severity="ticket"}}'
            value: 1
          - labels: 'ALERTS{{alertname="PrinterAway",
              alertstate="firing", printer="gone", severity="ticket"}}'
            value: 1
          - labels: 'ALERTS{{alertname="TelegrafAway",
              alertstate="firing", job="printers", severity="page"}}'
            value: 1
  - interval: 1h
    input_series:
      - series: 'printer_online{{printer="gone"}}'
        values: '0x5'
    promql_expr_test:
      - expr: ALERTS{{alertstate="firing"}}
        eval_time: 3h
        exp_samples:
          - labels: 'ALERTS{{alertname="NoPrinters",
              alertstate="firing", severity="page"}}'
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


def telegraf():
    """The stand-in, with our telegraf.conf."""
    return Telegraf(example("telegraf.conf"))


def fields():
    """What telegraf.conf makes: the options of a field by its series."""
    return {
        f"{block['measurement_name']}_{field['rename']}": field
        for each in telegraf().inputs
        for block in each["json_v2"]
        for field in block["field"]
    }


def series():
    """Of the modules: the path of each series in a message."""
    return {
        name: field["path"]
        for name, field in fields().items()
        if field["path"].startswith("status.")
    }


def published(status, name="a", part="klipper"):
    """What Prometheus is shown of a message, by the series."""
    conf = telegraf()
    conf.take(f"{name}/{part}/status", json.dumps(status))
    return conf.series


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


def test_every_field_and_series_is_one_of_the_code(real_status):
    status = real_status
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
    shown = published({"status": status})
    # Every one of them is a number
    assert {name for name, _ in shown} == set(found)
    values = {name: value for (name, _), value in shown.items()}
    own = status["z_calibration"]
    assert values["z_calibration_run_ok"] == 0.0
    assert (
        values["z_calibration_run_time"]
        == (own["history"]["results"][-1]["time"])
    )
    assert values["z_calibration_runs"] == 10
    assert values["z_calibration_warnings"] == len(own["warnings"])


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("printer-01", {"printer": "printer-01"}),
        ("hall-2/printer-01", {"hall": "hall-2", "printer": "printer-01"}),
        ("a/b/c", None),
    ],
)
def test_printer_is_named_by_its_topic(name, labels):
    status = {"status": {"z_calibration": {"uncertainty": 0.01}}}
    shown = [dict(tags) for _, tags in published(status, name)]
    assert shown == ([] if labels is None else [labels])
    online = published({"server": "online"}, name, "moonraker")
    gone = published({"server": "offline"}, name, "moonraker")
    wanted = [] if labels is None else [1.0]
    assert list(online.values()) == wanted
    assert list(gone.values()) == [0.0] * len(wanted)


def test_numbers_are_shown_to_this_computer_only():
    output = telegraf().output
    assert output["listen"].startswith("127.0.0.1:")
    assert output["metric_version"] == 2


def test_first_metric_version_drops_what_is_no_number():
    """So a field of ours with a boolean has to say that it is a number."""
    conf = telegraf()
    conf.output["metric_version"] = 1
    run = {"ok": False, "time": 1.0}
    history = {"history": {"results": [run]}}
    message = {"status": {"z_calibration": history}}
    conf.take("a/klipper/status", json.dumps(message))
    assert {name for name, _ in conf.series} >= {
        "z_calibration_run_ok",
        "z_calibration_run_time",
    }


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
    assert described == set(fields())
    assert named == {
        ".".join(path.split(".")[1:3]) for path in series().values()
    }
    assert {spans(row[0])[0] for row in alerts} == set(
        re.findall(r"alert: (\w+)", example("alerts.yml"))
    )
    listed = {name for row in files for name in spans(row[0])}
    assert listed == {path.name for path in EXAMPLES.iterdir()}


def test_a_message_may_lack_whatever_has_not_changed():
    status = {"uncertainty": None, "history": {"results": []}}
    assert published({"status": {"z_calibration": status}}) == {}


def test_dashboard_and_alerts_use_series_that_exist():
    dashboard = json.loads(example("dashboard.json"))
    panels = dashboard["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels) > 0
    expressions = [t["expr"] for panel in panels for t in panel["targets"]]
    assert all('printer=~"$printer"' in text for text in expressions)
    (variable,) = dashboard["templating"]["list"]
    text = " ".join([*expressions, variable["query"]["query"]])
    text += example("alerts.yml")
    used = set(
        re.findall(r"\b(?:z_calibration|auto_z_offset|printer)_\w+", text)
    )
    assert used and used <= set(fields())
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
    files = [tmp_path / f"{name}.yml" for name in ("at_once", "away", "later")]
    for file, text in zip(files, (AT_ONCE, AWAY, LATER)):
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
    conf = telegraf()
    for message in broker.messages():
        if message.printer == printer:
            content = json.dumps({"status": message.status})
            conf.take(f"{printer}/klipper/status", content)
    return {name: value for (name, _), value in conf.series.items()}


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
        assert newest(broker, name)["z_calibration_run_ok"] == 1.0
    assert wanted["good"][0] - wanted["good"][1] == pytest.approx(0.01)
    varies = "z_calibration_spread_switch"
    assert newest(broker, "worn")[varies] > newest(broker, "good")[varies]
    broker.until(
        lambda: newest(broker, "lost").get("z_calibration_run_ok") == 0.0,
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


@pytest.fixture
def alerting(tmp_path):
    """(broker, Telegraf's stand-in, Prometheus), which looks each second."""
    missing = [n for n in ("mosquitto", "prometheus") if not servers.program(n)]
    if missing:
        pytest.skip(f"NOT TESTED: no {', '.join(missing)} (Debian has them)")
    with ExitStack() as stack:
        # Mosquitto becomes somebody else, who may not look into pytest's
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="farm-")))
        broker = stack.enter_context(servers.mosquitto(folder))
        relay = stack.enter_context(servers.telegraf(broker.port))
        yield (
            broker,
            relay,
            stack.enter_context(servers.prometheus(folder, relay.port, 1.0)),
        )


def state_of(prometheus, alert, printer):
    """Of an alert: "", "pending" or "firing"."""
    for each in servers.ask(prometheus.port, "alerts")["alerts"]:
        labels = each["labels"]
        if (labels["alertname"], labels.get("printer")) == (alert, printer):
            return each["state"]
    return ""


@pytest.mark.slow
def test_refusal_becomes_an_alert(alerting):
    broker, relay, prometheus = alerting
    printer = Printer("hall-1/lost", broker.port, random.Random(0))
    printer.client.loop_start()

    def becomes(alert, state):
        def done():
            return state_of(prometheus, alert, "lost") == state

        servers.until(done, f"{alert} {state!r}")

    try:
        printer.online()
        # Nothing is known of it yet
        becomes("NoNumbers", "pending")
        printer.calibrated()
        becomes("NoNumbers", "")
        assert state_of(prometheus, "CalibrationRefused", "lost") == ""
        printer.calibrated(False)
        becomes("CalibrationRefused", "firing")
        printer.calibrated()
        becomes("CalibrationRefused", "")
        # Its numbers are gone, and that is told
        relay.stop()
        servers.until(
            lambda: state_of(prometheus, "TelegrafAway", None), "TelegrafAway"
        )
        relay.start()
        becomes("NoNumbers", "pending")
        printer.calibrated(False)
        becomes("CalibrationRefused", "firing")
        becomes("NoNumbers", "")
    finally:
        printer.client.disconnect()
        printer.client.loop_stop()


def test_many_printers_at_once():
    """The tool behind the table of the document, in short."""
    missing = [n for n in ("mosquitto", "prometheus") if not servers.program(n)]
    if missing:
        pytest.skip(f"NOT TESTED: no {', '.join(missing)} (Debian has them)")
    with TemporaryDirectory(prefix="farm-") as folder:
        crowd = farm_tool.row(5, 0.1, Path(folder), 0, interval=4.0, every=1.0)
    cells = dict(zip(farm_tool.HEADERS, crowd))
    # Three messages for each run, and the refusals were told
    assert float(cells["messages/s"]) == pytest.approx(3 * 4 / 4.0, rel=0.5)
    assert 0.0 <= float(cells["worst"]) < 30.0
