"""The simulated printer stands alone."""

from __future__ import annotations

import ast
import importlib.util
import sysconfig

import pytest

from simprinter.places import PACKAGE

# What pyproject.toml says it needs, and what runs inside pytest
OTHERS = {
    "jsonschema",
    "pytest",
    "requests",
    "tomli",
    # Of Python itself since 3.11, of which tomli is the copy for those before
    "tomllib",
    "websocket",
}
# What its tests need besides
OF_TESTS = {"hypothesis"}
SOURCES = sorted(PACKAGE.rglob("*.py"))


def imported(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module


def is_standard(name):
    """Whether it comes with Python, of 3.9 on: sys does not tell before 3.10."""
    spec = importlib.util.find_spec(name)
    origin = (spec and spec.origin) or ""
    is_below = origin.startswith(sysconfig.get_path("stdlib"))
    is_below = is_below and "site-packages" not in origin
    return is_below or origin in ("built-in", "frozen")


@pytest.mark.parametrize(
    "path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE))
)
def test_nothing_of_the_repository_is_imported(path):
    """Neither its modules nor its tools: it is installed without them."""
    roots = {name.partition(".")[0] for name in imported(path)}
    others = OTHERS | OF_TESTS if "tests" in path.parts else OTHERS
    assert {n for n in roots - {"simprinter"} if not is_standard(n)} <= others


def test_there_are_sources():
    assert len(SOURCES) > 40
