"""What the console of the page completes: parameters, as the documents have them."""

from __future__ import annotations

import re
from pathlib import Path

from tools.playground.parameters import all_parameters, parameters_of

ROOT = Path(__file__).resolve().parents[3]
DOCUMENT = """
### MOVE_THERE

| parameter | default | meaning |
|---|---|---|
| `FAR` | 0 | 1: as [far](#away) as `this` |
| `NEAR` | 1 | see above |

## What else?

| `OTHER` | nothing |
| `GO`, `COME` | nothing |
| `TURN ROUND=<0 or 1> SPEED=<mm/s>` | about |
"""


def test_tables_and_rows():
    assert parameters_of(DOCUMENT) == {
        "MOVE_THERE": {"FAR": "1: as far as this", "NEAR": ""},
        "TURN": {"ROUND": "0 or 1", "SPEED": "mm/s"},
    }


def test_all_are_of_commands_and_are_read_there():
    sources = [*ROOT.glob("*.py"), *ROOT.glob("z_touch/**/*.py")]
    code = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    found = all_parameters()
    assert {"CALIBRATE_Z", "AUTO_Z_CALIBRATE", "EXTRA_PROBE"} <= set(found)
    assert {"SET_PROBE_STATUS", "MOVE_AVOIDING_DOCK"} <= set(found)
    for command, parameters in found.items():
        assert f"def cmd_{command}(" in code, command
        for name in parameters:
            # Those of an axis are read one by one
            assert re.search(rf'"{name}"|"XYZ"', code), (command, name)
