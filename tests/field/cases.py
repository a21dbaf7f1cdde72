"""The cases of this folder: what their files say."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HERE = Path(__file__).parent
NAMES = sorted(file.parent.name for file in HERE.glob("*/case.toml"))
_OF_CASE = {"about", "source", "machine", "start", "step", "world"}
_OF_START = {"refused", "says"}
_OF_STEP = {
    *("run", "wait", "refused", "refused_without", "says", "says_not"),
    *("status", "gap", "within", "over", "deepest"),
}


def read(name: str) -> dict[str, Any]:
    """What a case says. Raises ValueError for what no test would look at."""
    case = tomllib.loads((HERE / name / "case.toml").read_text("utf-8"))
    unknown = case.keys() - _OF_CASE | case.get("start", {}).keys() - _OF_START
    for step in case.get("step", []):
        unknown |= step.keys() - _OF_STEP
    if unknown:
        told = f"{name}/case.toml: nothing looks at {sorted(unknown)}"
        raise ValueError(told)
    if not all(case.get(key) for key in ("about", "source", "machine")):
        raise ValueError(f"{name}/case.toml: about, source, machine: say them")
    if not (case.get("start") or case.get("step")):
        raise ValueError(f"{name}/case.toml wants nothing")
    return case


def world_of(case: Mapping[str, Any]) -> str:
    """The text of a case's machine, with what its [world] says instead."""
    file = HERE / "machines" / f"{case['machine']}.toml"
    world = tomllib.loads(file.read_text("utf-8"))
    for part, values in case.get("world", {}).items():
        world[part] = {**world.get(part, {}), **values}
    return "\n".join(f"{key} = {_toml(value)}" for key, value in world.items())


def _toml(value: Any) -> str:
    """A value as TOML has it in one line."""
    if isinstance(value, Mapping):
        pairs = (f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items())
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def wanted(case: Mapping[str, Any]) -> str:
    """What a case wants, in one line."""
    start = case.get("start", {})
    found = [f"refused at start: {w}" for w in start.get("refused", [])[:1]]
    found += [f"told at start: {w}" for w in start.get("says", [])[:1]]
    for step in case.get("step", []):
        found += [f"refused: {w}" for w in step.get("refused", [])[:1]]
        found += [f"told: {w}" for w in step.get("says", [])[:1]]
        found += [f"gap {step['gap']:g} mm"] if "gap" in step else []
        for name, fields in step.get("status", {}).items():
            found += [f"{name}.{field} {v}" for field, v in fields.items()]
    return "; ".join(dict.fromkeys(found))
