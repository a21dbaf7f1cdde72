"""Where a single fault can be planted in a file, and what stands there then."""

from __future__ import annotations

import ast
import random
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_ORDERS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
# The other sign, and the other way from one unit to the other
_OTHER = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
# Where options are read, and what reads one
READER = "z_touch/options.py"
READ = "row.kind.read(config, name, row)"
_SUMS = {ast.Add: "sign", ast.Sub: "sign", ast.Mult: "unit", ast.Div: "unit"}


@dataclass(frozen=True)
class Fault:
    """One fault: in which file, on which line, what was there and what is now.

    start, end: of `before` in the file, in bytes as the parser counts them. An
    option is ignored where all options are read, in the section that its room has.
    """

    file: str
    line: int
    kind: str
    start: int
    end: int
    before: str
    after: str

    @property
    def changed(self) -> str:
        """The file that has it."""
        return READER if self.kind == "option" else self.file

    def planted(self, source: str) -> str:
        """The source of the file that has it, with it."""
        if self.kind == "option":
            assert source.count(READ) == 1, f"{READER} reads options otherwise"
            section = self.file.split("/")[1]
            its = f'(row.name, config.get_name().split()[0]) == ("{self.before}", "{section}")'
            ignored = f"row.default if {its} else {READ}"
            return source.replace(READ, ignored)
        text = source.encode("utf-8")
        changed = text[: self.start] + self.after.encode() + text[self.end :]
        return changed.decode("utf-8")

    def __str__(self) -> str:
        """One line for people."""
        texts = self.before, self.after or "ignored"
        was, now = (" ".join(text.split())[:60] for text in texts)
        return f"{self.file}:{self.line} {self.kind}: {was} -> {now}"


def faults_of(file: str, source: str) -> list[Fault]:
    """All that can be planted in a file."""
    return list(_Places(file, source).all())


def drawn(root: Path, folder: str, count: int, seed: int) -> list[Fault]:
    """So many of a folder's files below root, each kind as often as the others."""
    by_kind: dict[str, list[Fault]] = defaultdict(list)
    for path in sorted((root / folder).rglob("*.py")):
        name = path.relative_to(root).as_posix()
        for fault in faults_of(name, path.read_text(encoding="utf-8")):
            by_kind[fault.kind].append(fault)
    draw = random.Random(seed)
    kinds = [
        draw.sample(found, len(found))
        for found in [by_kind[k] for k in sorted(by_kind)]
    ]
    turns: Sequence[Fault] = [
        found[turn]
        for turn in range(max(map(len, kinds), default=0))
        for found in kinds
        if turn < len(found)
    ]
    return list(turns[:count])


class _Places:
    """Of one file."""

    def __init__(self, file: str, source: str) -> None:
        self._file = file
        self._text = source.encode("utf-8")
        self._tree = ast.parse(source)
        self._lines = [0]
        for line in self._text.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))

    def all(self) -> Iterator[Fault]:
        for node in ast.walk(self._tree):
            if isinstance(node, ast.If) and not _is_typing(node.test):
                if all(isinstance(line, ast.Raise) for line in node.body):
                    yield self._fault("guard", node.test, "False")
                else:
                    text = f"not ({self._of(node.test)})"
                    yield self._fault("condition", node.test, text)
            elif isinstance(node, ast.Compare) and len(node.ops) == 1:
                yield from self._of_limit(node)
            elif isinstance(node, ast.BinOp) and type(node.op) in _SUMS:
                yield from self._of_sum(node)
            elif isinstance(node, ast.ClassDef):
                yield from self._of_options(node)

    def _of_limit(self, node: ast.Compare) -> Iterator[Fault]:
        """The number on the right half as large again, and 1 for 0."""
        number = node.comparators[0]
        is_order = isinstance(node.ops[0], _ORDERS)
        if is_order and _is_number(number):
            value = ast.literal_eval(number)
            shifted = 1.5 * value if value else 1.0
            yield self._fault("limit", number, repr(shifted))

    def _of_sum(self, node: ast.BinOp) -> Iterator[Fault]:
        """The other sign, or the other way round; words are no sum."""
        if any(map(_is_text, (node.left, node.right))):
            return
        now = _OTHER[type(node.op)]
        left, right = self._of(node.left), self._of(node.right)
        kind = _SUMS[type(node.op)]
        yield self._fault(kind, node, f"(({left}) {now} ({right}))")

    def _of_options(self, node: ast.ClassDef) -> Iterator[Fault]:
        """An option that is declared and read, and is its default all the same."""
        for field in node.body:
            if isinstance(field, ast.AnnAssign) and _is_option(field):
                yield self._fault("option", field.target, "")

    def _fault(self, kind: str, node: Any, after: str) -> Fault:
        start, end = self._place(node)
        before = self._text[start:end].decode("utf-8")
        return Fault(self._file, node.lineno, kind, start, end, before, after)

    def _of(self, node: Any) -> str:
        start, end = self._place(node)
        return self._text[start:end].decode("utf-8")

    def _place(self, node: Any) -> tuple[int, int]:
        start = self._lines[node.lineno - 1] + node.col_offset
        return start, self._lines[node.end_lineno - 1] + node.end_col_offset


def _is_typing(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and node.id == "TYPE_CHECKING"


def _is_number(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, (int, float))
        and not isinstance(node.value, bool)
    )


def _is_text(node: ast.AST) -> bool:
    is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return is_text or isinstance(node, (ast.JoinedStr, ast.List, ast.Tuple))


def _is_option(field: ast.AnnAssign) -> bool:
    call = field.value
    return (
        isinstance(call, ast.Call)
        and isinstance(call.func, ast.Attribute)
        and isinstance(call.func.value, ast.Name)
        and call.func.value.id == "options"
    )
