"""Reads a world file, or says what is wrong with it: file, key, value, remedy."""

from __future__ import annotations

import difflib
import json
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

import jsonschema

from .. import world as records
from ..world import Pose, SpecError, WorldSpec

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SCHEMA = json.loads(
    Path(__file__).with_name("world.schema.json").read_text(encoding="utf-8")
)
Node = Mapping[str, Any]
# What a world file says of one motor, heater or board beside printer.cfg
Extra = Mapping[str, Any]
_KINDS = {
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "string": "a text in quotes",
    "array": "a list in square brackets",
    "object": "a table",
}


class WorldFileError(ValueError):
    """A world file that describes no machine."""


@dataclass(frozen=True)
class WorldFile:
    """A machine's physics, and which pins of its boards they are on.

    start: of the nozzle tip, world frame, mm. signals and outputs: pins by the
    world's names for them. motors, heaters, boards: by their sections, what
    differs from printer.cfg. left_out: sections that klippy is not given.
    """

    name: str
    spec: WorldSpec
    start: Pose
    signals: Mapping[str, str]
    outputs: Mapping[str, str]
    motors: Mapping[str, Extra]
    heaters: Mapping[str, Extra]
    boards: Mapping[str, Extra]
    left_out: frozenset[str]

    def refuse(self, key: str, value: object, told: str) -> WorldFileError:
        """What is wrong with a value, and what to do."""
        return WorldFileError(f"{self.name}: {key} = {_toml(value)}: {told}")


def read(path: Path) -> WorldFile:
    """Read a world file. Raises WorldFileError naming file, key and value."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise WorldFileError(f"{path}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise WorldFileError(
            f"{path}: not TOML: {error}; look there for a missing quote,"
            " bracket or ="
        ) from None
    return _Reader(str(path)).read(data)


class _Reader:
    """Of one file."""

    def __init__(self, name: str):
        self._name = name

    def read(self, data: Mapping[str, Any]) -> WorldFile:
        """The file's content. Raises WorldFileError."""
        errors = jsonschema.Draft202012Validator(SCHEMA).iter_errors(data)
        first = jsonschema.exceptions.best_match(errors)
        if first is not None:
            raise WorldFileError(f"{self._name}: {_told(first)}")
        self._require_finite(data, [])
        start = data["start"]
        return WorldFile(
            self._name,
            self._world(data),
            Pose(*(start[f"{axis}_world_mm"] for axis in "xyz")),
            data.get("signals", {}),
            data.get("outputs", {}),
            data.get("motors", {}),
            self._by_field("heaters", data),
            self._by_field("boards", data),
            frozenset(data.get("leave_out_sections", ())),
        )

    def _require_finite(self, value: Any, path: list[Union[str, int]]) -> None:
        """TOML has nan and inf; a machine has not."""
        if isinstance(value, Mapping):
            pairs: Iterator = iter(value.items())
        elif isinstance(value, list):
            pairs = enumerate(value)
        else:
            if isinstance(value, float) and not math.isfinite(value):
                raise WorldFileError(
                    f"{self._name}: {_key(path)} = {value}: must be a finite"
                    " number; leave the key out where there is no limit"
                )
            return
        for key, part in pairs:
            self._require_finite(part, [*path, key])

    def _by_field(self, table: str, data: Node) -> dict[str, Extra]:
        """What a table says of each of its parts, by the record's fields."""
        node = SCHEMA["properties"][table]["additionalProperties"]
        return {
            name: {node["properties"][key]["field"]: v for key, v in of.items()}
            for name, of in data.get(table, {}).items()
        }

    def _world(self, data: Node) -> WorldSpec:
        top: dict[str, Any] = {}
        fields: dict[str, str] = {}
        for key, node in SCHEMA["properties"].items():
            if node.get("record") == "WorldSpec":
                inner = data.get(key, {})
                top.update(self._fields(node, inner, [key]))
                keys = node["properties"].items()
                fields.update((n["field"], f"[{key}] {k}") for k, n in keys)
            elif "field" in node and key in data:
                top[node["field"]] = self._value(node, data[key], [key])
                fields[node["field"]] = f"[{key}]"
            elif "field" in node:
                fields[node["field"]] = f"[{key}]"
        try:
            return WorldSpec(**top)
        except SpecError as error:
            wanted = _in_keys(error.wanted, fields)
            raise WorldFileError(
                f"{self._name}: {fields[error.name]}: must be {wanted}"
            ) from None

    def _fields(
        self, node: Node, data: Node, path: Sequence[Union[str, int]]
    ) -> dict[str, Any]:
        made = {}
        for key, value in data.items():
            child = node["properties"][key]
            made[child["field"]] = self._value(child, value, [*path, key])
        return made

    def _value(
        self, node: Node, value: Any, path: Sequence[Union[str, int]]
    ) -> Any:
        if "$ref" in node:
            node = SCHEMA["$defs"][node["$ref"].rpartition("/")[2]]
        if "record" in node:
            return self._record(node, value, path)
        if isinstance(value, list):
            items = node.get("items", {})
            return tuple(
                self._value(items, part, [*path, number])
                for number, part in enumerate(value)
            )
        return float(value) if node.get("type") == "number" else value

    def _record(
        self, node: Node, data: Node, path: Sequence[Union[str, int]]
    ) -> Any:
        fields = self._fields(node, data, path)
        try:
            return getattr(records, node["record"])(**fields)
        except SpecError as error:
            keys = {n["field"]: k for k, n in node["properties"].items()}
            key = keys[error.name]
            value = _toml(data[key]) if key in data else "as it is left out"
            wanted = _in_keys(error.wanted, keys)
            raise WorldFileError(
                f"{self._name}: {_key([*path, key])} = {value}: must be"
                f" {wanted}; {_description(node['properties'][key])}"
            ) from None


def _in_keys(text: str, keys: Mapping[str, str]) -> str:
    """A sentence about fields, in the words of the file."""
    return re.sub(r"\w+", lambda found: keys.get(found[0], found[0]), text)


def _description(node: Node) -> str:
    if "$ref" in node:
        node = SCHEMA["$defs"][node["$ref"].rpartition("/")[2]]
    return node.get("description", "")


def _toml(value: object) -> str:
    """A value as the file spells it."""
    return json.dumps(value, default=str)


def _key(path: Sequence[Union[str, int]]) -> str:
    """A place in the file as it is spelled there: [bed.mesh] heights_mm."""
    words: list[str] = []
    for part in path:
        if isinstance(part, int):
            words[-1] += f" (number {part + 1})"
        else:
            words.append(part)
    *tables, last = words
    return f"[{'.'.join(tables)}] {last}" if tables else last


def _told(error: jsonschema.ValidationError) -> str:
    """What jsonschema has found, in the words of who wrote the file."""
    path, node = list(error.absolute_path), error.schema
    if error.validator == "additionalProperties":
        known = list(node["properties"])
        unknown = next(key for key in error.instance if key not in known)
        near = difflib.get_close_matches(unknown, known, 1, 0.5)
        remedy = f"do you mean {near[0]}?" if near else f"have {known}"
        value = error.instance[unknown]
        if isinstance(value, dict):
            return f"[{'.'.join([*map(str, path), unknown])}]: is unknown; {remedy}"
        given = f"{_key([*path, unknown])} = {_toml(value)}"
        return f"{given}: is unknown; {remedy}"
    if error.validator == "required":
        missing = next(k for k in node["required"] if k not in error.instance)
        text = _description(node["properties"][missing])
        return f"{_key([*path, missing])}: is missing; add it: {text}"
    given = f"{_key(path)} = {_toml(error.instance)}"
    return f"{given}: must be {_limit(error)}; {_description(node)}"


def _limit(error: jsonschema.ValidationError) -> str:
    limit = error.validator_value
    words = {
        "minimum": "at least {}",
        "exclusiveMinimum": "above {}",
        "maximum": "at most {}",
        "exclusiveMaximum": "below {}",
        "minItems": "a list of at least {}",
        "maxItems": "a list of at most {}",
        "minLength": "a text that is not empty",
        "enum": "one of {}",
        "pattern": "a pin",
    }
    if error.validator == "type":
        return _KINDS[limit]
    return words[error.validator].format(limit)
