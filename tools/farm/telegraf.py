"""What Telegraf makes of MQTT messages, by the rules of its documents.

Telegraf itself is in no package index that tests reach.  This stand-in reads
the same telegraf.conf and knows as much of Telegraf as that file uses: topics
and their tags (mqtt_consumer), paths and types of json_v2, the enum processor,
and which values prometheus_client shows.
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple, Optional

import paho.mqtt.client as mqtt

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# By name and labels, as Prometheus has them
Series = dict[tuple[str, tuple[tuple[str, str], ...]], float]


class Metric(NamedTuple):
    """What one json_v2 block makes of one message."""

    measurement: str
    tags: Mapping[str, str]
    fields: Mapping[str, Any]


class ConversionError(Exception):
    """Telegraf would log this and drop the message."""


def matches(pattern: str, topic: str) -> bool:
    """Whether a topic is one of those that a pattern means."""
    wanted, given = pattern.split("/"), topic.split("/")
    return len(wanted) == len(given) and all(
        w in ("+", g) for w, g in zip(wanted, given)
    )


def value_at(path: str, content: Any) -> Any:
    """The value at a path of gjson: names, numbers, # and @reverse.

    None where there is none, or null.
    """
    for word in path.split("."):
        if content is None:
            return None
        if word == "#":
            content = len(content)
        elif word == "@reverse":
            content = content[::-1]
        elif isinstance(content, list):
            number = int(word)
            content = content[number] if number < len(content) else None
        else:
            content = content.get(word)
    return content


def converted(value: Any, kind: Optional[str], name: str) -> Any:
    """A value of the type that a field wants; README of json_v2, "Types"."""
    if kind is None:
        return value
    if isinstance(value, bool):
        return int(value) if kind in ("int", "uint") else value
    try:
        return {"int": int, "uint": int, "float": float}[kind](value)
    except (KeyError, ValueError) as error:
        raise ConversionError(f"{name}: {value!r} is no {kind}") from error


class Telegraf:
    """One that has read a telegraf.conf."""

    def __init__(self, conf: str):
        self._conf = tomllib.loads(conf)
        self.inputs = self._conf["inputs"]["mqtt_consumer"]
        (self.output,) = self._conf["outputs"]["prometheus_client"]
        self.series: Series = {}
        self._lock = threading.Lock()

    def topics(self) -> list[str]:
        """All that it subscribes to."""
        return [topic for each in self.inputs for topic in each["topics"]]

    def take(self, topic: str, payload: str) -> None:
        """A message arrives. Raises ConversionError."""
        content = json.loads(payload)
        with self._lock:
            for metric in self.metrics(topic, content):
                for field, value in metric.fields.items():
                    if self._is_shown(value):
                        name = f"{metric.measurement}_{field}"
                        labels = tuple(sorted(metric.tags.items()))
                        self.series[name, labels] = float(value)

    def _is_shown(self, value: Any) -> bool:
        if isinstance(value, bool):
            # As numbers since metric_version 2
            return self.output.get("metric_version", 1) == 2
        return isinstance(value, (int, float))

    def metrics(self, topic: str, content: Any) -> Iterator[Metric]:
        """What becomes of a message. Raises ConversionError."""
        for each in self.inputs:
            if not any(matches(pattern, topic) for pattern in each["topics"]):
                continue
            tags = self._tags(each, topic)
            for block in each["json_v2"]:
                fields = {}
                for field in block["field"]:
                    value = value_at(field["path"], content)
                    if value is None:
                        assert field.get("optional"), field["path"]
                        continue
                    name = field["rename"]
                    fields[name] = converted(value, field.get("type"), name)
                metric = Metric(block["measurement_name"], tags, fields)
                yield self._processed(metric)

    @staticmethod
    def _tags(conf: Mapping[str, Any], topic: str) -> dict[str, str]:
        tags = {}
        for parsing in conf["topic_parsing"]:
            if matches(parsing["topic"], topic):
                names = parsing["tags"].split("/")
                for name, value in zip(names, topic.split("/")):
                    if name != "_":
                        tags[name] = value
        return tags

    def _processed(self, metric: Metric) -> Metric:
        fields = dict(metric.fields)
        for enum in self._conf.get("processors", {}).get("enum", ()):
            if metric.measurement not in enum["namepass"]:
                continue
            for mapping in enum["mapping"]:
                values = mapping["value_mappings"]
                for name in set(mapping["fields"]) & set(fields):
                    fields[name] = values.get(fields[name], mapping["default"])
        return metric._replace(fields=fields)

    def exposition(self) -> str:
        """What Prometheus collects."""
        with self._lock:
            lines = [
                "%s{%s} %r"
                % (name, ",".join(f'{k}="{v}"' for k, v in labels), value)
                for (name, labels), value in sorted(self.series.items())
            ]
        return "\n".join([*lines, ""])


class Running:
    """A Telegraf between a broker and a port of this machine."""

    def __init__(self, conf: str, broker_port: int, port: int):
        self.telegraf = Telegraf(conf)
        self.errors: list[str] = []
        self._client = mqtt.Client(
            mqtt.CallbackAPIVersion.VERSION2, "telegraf", False
        )
        self._client.on_message = self._on_message
        self._client.on_connect = self._on_connect
        self._client.connect("127.0.0.1", broker_port)
        self._client.loop_start()
        exposition = self.telegraf.exposition

        class Answer(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.end_headers()
                self.wfile.write(exposition().encode())

            def log_message(self, *unused: object) -> None:
                """Say nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Answer)
        threading.Thread(target=self._server.serve_forever).start()

    def _on_connect(self, client: mqtt.Client, *unused: Any) -> None:
        client.subscribe([(topic, 1) for topic in self.telegraf.topics()])

    def _on_message(
        self, _client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage
    ) -> None:
        try:
            self.telegraf.take(message.topic, message.payload.decode())
        except (ConversionError, ValueError) as error:
            self.errors.append(f"{message.topic}: {error}")

    def close(self) -> None:
        """Be gone."""
        self._client.disconnect()
        self._client.loop_stop()
        self._server.shutdown()
        self._server.server_close()


def main() -> None:
    """python -m tools.farm.telegraf CONF BROKER_PORT PORT"""
    file, broker_port, port = sys.argv[1:]
    with open(file, encoding="utf-8") as conf:
        Running(conf.read(), int(broker_port), int(port))


if __name__ == "__main__":
    main()
