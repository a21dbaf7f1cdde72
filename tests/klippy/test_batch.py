"""Klipper's own kind of regression test, run on every host.

The files are in the format of Klipper's test suite: CONFIG names a
configuration (several give several runs), DICTIONARY the dictionary (always
the simulated board's), SHOULD_FAIL that klippy must end with an error, every
other line is G-code. A comment `EXPECT: text` is what the log must contain.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest

from simprinter import Machine, RealClock
from simprinter.hosts.session import run_file_output
from tools.kit.printer import dialect_of, module_files
from tools.kit.scenes import SCENES

_HERE = Path(__file__).parent
_DICTIONARY = "simulated.dict"


@dataclass
class BatchTest:
    """What one .test file asks for."""

    configs: list[Path] = field(default_factory=list)
    dictionaries: list[str] = field(default_factory=list)
    gcode: list[str] = field(default_factory=list)
    should_fail: bool = False
    expected: list[str] = field(default_factory=list)


def read_test(path: Path) -> BatchTest:
    """Parse a .test file."""
    test = BatchTest()
    for line in path.read_text().splitlines():
        code, _, comment = line.partition("#")
        if comment.strip().startswith("EXPECT:"):
            test.expected.append(comment.split(":", 1)[1].strip())
        words = code.split()
        if not words:
            continue
        if words[0] == "CONFIG":
            test.configs.append(path.parent / words[1])
        elif words[0] == "DICTIONARY":
            test.dictionaries += words[1:]
        elif words[0] == "SHOULD_FAIL":
            test.should_fail = True
        else:
            test.gcode.append(code.strip())
    return test


CASES = [
    pytest.param(read_test(path), config, id=f"{path.stem}-{config.stem}")
    for path in sorted(_HERE.glob("*.test"))
    for config in read_test(path).configs
]


def test_there_are_cases_and_all_configurations_are_used():
    used = {case.values[1] for case in CASES}
    assert used == set(_HERE.glob("*.cfg"))


@pytest.mark.parametrize(("test", "config"), CASES)
def test_batch(host, test, config):
    assert test.dictionaries == [_DICTIONARY]
    with Machine(
        SCENES["voron"], clock=RealClock(), dialect=dialect_of(host)
    ) as machine:
        dictionary = machine.board.dictionary.json
    result = run_file_output(
        host,
        module_files(),
        dictionary,
        config.read_text(),
        "\n".join([*test.gcode, ""]),
    )
    assert bool(result.status) == test.should_fail, result.tail()
    assert "Internal error" not in result.log, result.tail()
    for text in test.expected:
        assert text in result.log, result.tail()
