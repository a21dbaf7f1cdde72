"""What the sources of a module say: its messages and its numbers.

Those of z_touch count for each module that imports them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Optional

from tests.docs.documents import normal

ROOT = Path(__file__).resolve().parents[2]
VALUE = "<...>"
# A file that says so: what it says is drawn, written into a file, or a question
# that explains itself
NO_MESSAGES = re.compile("(?m)^# Its texts are no messages: .")
# What declares an option as a field
FIELDS = ("number", "speed", "other", "declare", "as_in_probe")
OPTIONS = {f"options.{name}" for name in FIELDS} | {
    "flag",
    "gcode",
    "position",
}


def trees(name: str) -> list[ast.Module]:
    """The module, and all of z_touch that it needs."""
    return list(files(name).values())


@lru_cache(maxsize=None)
def files(name: str) -> dict[Path, ast.Module]:
    """The same by their paths."""
    found: dict[Path, ast.Module] = {}
    pending = [ROOT / f"{name}.py"]
    if name == "z_calibration":
        # What it starts, and passes on the words of
        report = ROOT / "z_touch" / "report"
        pending += [report / "program.py", report / "trend.py"]
    while pending:
        path = pending.pop()
        if path in found or not path.exists():
            continue
        text = path.read_text(encoding="utf-8")
        if NO_MESSAGES.search(text):
            continue
        found[path] = ast.parse(text)
        for node in ast.walk(found[path]):
            if isinstance(node, ast.ImportFrom) and node.level:
                pending += imported(path, node)
    joined(list(found.values()))
    return found


class Joining(ast.NodeTransformer):
    """Makes one text of those that are added: advice that has a name."""

    def __init__(self, named: dict[str, str]) -> None:
        self.named = named
        self.used: set[str] = set()

    def text_of(self, node: ast.expr) -> Optional[str]:
        """The text that an expression is; None: it is something else."""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return node.value
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            parts = [self.text_of(node.left), self.text_of(node.right)]
            return None if None in parts else "".join(map(str, parts))
        name = ast.unparse(node).rpartition(".")[2]
        if name in self.named:
            self.used.add(name)
        return self.named.get(name)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        """Replace advice, which stands after '; ', by its text."""
        for before, part in zip(node.values, node.values[1:]):
            if not isinstance(part, ast.FormattedValue):
                continue
            is_advice = ast.unparse(before).rstrip("'\"").endswith("; ")
            text = self.text_of(part.value) if is_advice else None
            if text is not None:
                node.values[node.values.index(part)] = ast.Constant(text)
        return self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        text = self.text_of(node)
        if isinstance(node.op, ast.Add) and text is not None:
            return ast.Constant(text)
        return self.generic_visit(node)


def joined(found: list[ast.Module]) -> None:
    """Give the sources whole texts where these are put together of advice."""
    named = {
        ast.unparse(node.targets[0]): node.value.value
        for tree in found
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        # No prefix of lines for another program
        and not node.value.value.startswith("//")
    }
    joining = Joining(named)
    for tree in found:
        joining.visit(tree)
    # Advice is told with what it is for
    for tree in found:
        tree.body = [
            node
            for node in tree.body
            if not isinstance(node, ast.Assign)
            or ast.unparse(node.targets[0]) not in joining.used
        ]


def imported(path: Path, node: ast.ImportFrom) -> list[Path]:
    """The files below z_touch that a relative import may mean."""
    folder = path.parents[node.level - 1]
    if node.module is not None:
        folder = folder.joinpath(*node.module.split("."))
    files = [folder / f"{alias.name}.py" for alias in node.names]
    return [folder.with_suffix(".py"), folder / "__init__.py", *files]


def is_silent(node: ast.AST) -> bool:
    """Whether nobody is shown the texts inside, at least not as a message."""
    if isinstance(node, ast.Call):
        called = ast.unparse(node.func)
        # What an option is for is told in the documents
        if called in OPTIONS:
            return True
        declared = ("namedtuple", "option", "Kind", "record")
        # And the arguments of a program
        declared += ("add_argument", "ArgumentParser")
        # What is looked for is said by somebody else
        looks = (".startswith", ".endswith")
        return called.endswith(declared + looks) or called.startswith(
            "logging."
        )
    if isinstance(node, ast.Assign):
        return ast.unparse(node.targets[0]).endswith("_help")
    # A docstring
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def texts(node: ast.AST) -> Iterator[str]:
    """All texts below it that may be shown."""
    if is_silent(node):
        return
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    if isinstance(node, ast.JoinedStr):
        parts = (
            p.value if isinstance(p, ast.Constant) else VALUE
            for p in node.values
        )
        yield "".join(map(str, parts))
        return
    for inner in ast.iter_child_nodes(node):
        yield from texts(inner)


def messages_of(tree: ast.Module) -> set[str]:
    """Every text of more than one word that a user may see, in pieces."""
    found = {
        normal(re.sub(r"%(?:\(\w+\))?(?:\.\d+)?[sdfg]", VALUE, text))
        for text in texts(tree)
        if " " in text.strip()
    }
    # Of words, and no line of G-code
    gcode = re.compile(rf"(?:[A-Z_]+|{VALUE})(?: \S+=\S+)+")
    return {
        text
        for text in found
        if re.search("[a-zA-Z]{2}", text.replace(VALUE, ""))
        and not gcode.fullmatch(text)
    }


def constants(name: str) -> dict[str, tuple[float, ...]]:
    """The numbers by their names; of two files with one name any of the two."""
    return dict(all_constants(name))


@lru_cache
def all_constants(name: str) -> set[tuple[str, tuple[float, ...]]]:
    """The numbers with names, at the top of the sources."""
    found: set[tuple[str, tuple[float, ...]]] = set()
    for tree in trees(name):
        for node in tree.body:
            if not isinstance(node, ast.Assign):
                continue
            target = ast.unparse(node.targets[0])
            value = _value(node.value)
            if re.fullmatch("[A-Z][A-Z_]+", target) and value:
                found.add((target, value))
    return found


def _value(node: ast.expr) -> tuple[float, ...]:
    """Numbers; empty: something else."""
    try:
        value: Any = ast.literal_eval(node)
    except ValueError:
        return ()
    value = value if isinstance(value, tuple) else (value,)
    return value if all(type(item) in (int, float) for item in value) else ()
