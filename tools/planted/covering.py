"""Which tests run which block of the product, measured once for each of its states."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from tools.planted.planting import READ, READER, Fault, faults_of

# What may find a fault: the rest holds documents, tools and the simulator
TESTS = ("tests/unit", "tests/quick", "tests/field", "tests/modules")
BLOCKS = "blocks"
_HITS = Path(__file__).with_name("hits.py")


@dataclass(frozen=True)
class Case:
    """A test that was run, passed, and ran blocks of the product."""

    name: str
    seconds: float
    is_slow: bool
    blocks: int

    @property
    def file(self) -> str:
        """The file that it is in."""
        return self.name.partition("::")[0]


@dataclass(frozen=True)
class Covering:
    """All of them, by block."""

    by_block: dict[str, tuple[Case, ...]]

    def of(self, fault: Fault, source: str) -> list[Case]:
        """The tests that run what a fault changes, in the order to try them."""
        if fault.kind == "option":
            found = {*self.by_block.get(f"option:{fault.before}", ())}
        else:
            block = block_of(source, fault.line)
            names = (
                [f"{fault.file}:{block}"]
                if block
                # A constant or a class: whatever runs the file
                else [
                    b for b in self.by_block if b.startswith(f"{fault.file}:")
                ]
            )
            found = {t for name in names for t in self.by_block.get(name, ())}
        return in_turn(found)


def in_turn(cases: Iterable[Case]) -> list[Case]:
    """The order to try them: of each file one, then of each file the next.

    What is slow comes last, what needs no host first; in a file what runs little besides.
    """
    turns: Counter[tuple[str, bool]] = Counter()
    keys = {}
    for case in sorted(cases, key=lambda case: (case.blocks, case.name)):
        kind = case.file, case.is_slow
        is_unit = case.file.startswith("tests/unit/")
        keys[case] = case.is_slow, not is_unit, turns[kind], case.name
        turns[kind] += 1
    return sorted(keys, key=keys.__getitem__)


def blocks_in(tree: ast.AST) -> Iterator[list[ast.stmt]]:
    """The lists of statements that need not run though what stands around does."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node.body
        elif isinstance(node, (ast.If, ast.For, ast.While)):
            yield node.body
            if node.orelse:
                yield node.orelse
        elif isinstance(node, ast.ExceptHandler):
            yield node.body


def block_of(source: str, line: int) -> Optional[int]:
    """First line of the innermost block that a line is in; None: of none."""
    around = [
        (body[0].lineno, body[-1].end_lineno or 0)
        for body in blocks_in(ast.parse(source))
    ]
    starts = [first for first, last in around if first <= line <= last]
    return max(starts, default=None)


# How a file of the copy finds hits.py, whatever it is imported as
_LOADING = """\
import importlib.util, sys
if "planted_hits" not in sys.modules:
    _spec = importlib.util.spec_from_file_location("planted_hits", {path!r})
    sys.modules["planted_hits"] = importlib.util.module_from_spec(_spec)
    _spec.loader.exec_module(sys.modules["planted_hits"])
_hits = sys.modules["planted_hits"]
"""


def recording(file: str, source: str, blocks: list[str]) -> str:
    """The source of a file of the product that records its blocks.

    blocks: of the files before it; its own, and its options, are added.
    """
    if file == READER:
        option = "_hits.option(row.name, config, name)"
        source = source.replace(READ, f"{option} or {READ}")
    tree: Any = ast.parse(source)
    for body in list(blocks_in(tree)):
        name = f"{file}:{body[0].lineno}"
        body[:0] = ast.parse(f"_hits.hit({len(blocks)})").body
        blocks.append(name)
    # Behind what must come first, the text of the module and __future__
    first = [
        place + 1
        for place, node in enumerate(tree.body)
        if isinstance(node, ast.ImportFrom) and node.module == "__future__"
    ]
    if not first:
        return source
    loading = _LOADING.format(path=str(_HITS))
    tree.body[first[0] : first[0]] = ast.parse(loading).body
    return ast.unparse(ast.fix_missing_locations(tree))


def measured(copy: Path, kept: Path, tests: Sequence[str]) -> Covering:
    """Of a copy of the tree, which is written over; kept: below it stays for next time.

    tests: files and folders, below the root. A test that fails without any fault
    finds none: it is left out.
    """
    sources = {
        path.relative_to(copy).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted((copy / "z_touch").rglob("*.py"))
    }
    state = hashlib.sha256(json.dumps([sources, [*tests]]).encode()).hexdigest()
    hits = kept / state[:16]
    if not (hits / "whole").exists():
        shutil.rmtree(hits, ignore_errors=True)
        hits.mkdir(parents=True)
        blocks = sorted(
            {
                f"option:{fault.before}"
                for name, source in sources.items()
                for fault in faults_of(name, source)
                if fault.kind == "option"
            }
        )
        for name, source in sources.items():
            text = recording(name, source, blocks)
            (copy / name).write_text(text, encoding="utf-8")
        (hits / BLOCKS).write_text("\n".join(blocks), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-n", "2"]
        command += ["--dist", "loadfile", "-p", "tools.planted.recording"]
        # Which may be run by a test itself, in a worker of another pytest
        env = {**os.environ, "PLANTED_HITS": str(hits)}
        env.pop("PYTEST_XDIST_WORKER", None)
        command += ["--cases", "one", *tests]
        done = subprocess.run(command, cwd=copy, env=env)
        # 1: some fail, such as those that read the sources
        if done.returncode not in (0, 1):
            sys.exit(f"pytest ends with {done.returncode}: nothing is recorded")
        for name, source in sources.items():
            (copy / name).write_text(source, encoding="utf-8")
        (hits / "whole").write_text("", encoding="ascii")
    return read(hits)


def read(hits: Path) -> Covering:
    """What the plugin and the blocks have written."""
    by_block: dict[str, list[Case]] = defaultdict(list)
    names = (hits / BLOCKS).read_text(encoding="utf-8").split()
    ended = (hits / "ended").read_text(encoding="utf-8").splitlines()
    for line in ended:
        outcome, seconds, cases, name = line.split("\t", 3)
        number = hashlib.sha256(name.encode("utf-8")).hexdigest()[:16]
        run = hits / number
        if outcome != "passed" or not run.exists():
            continue
        ran = [
            block for block, is_run in zip(names, run.read_bytes()) if is_run
        ]
        case = Case(name, float(seconds), cases == "slow", len(ran))
        for block in ran:
            by_block[block].append(case)
    return Covering({name: tuple(found) for name, found in by_block.items()})
