"""Which tests find which single fault of the product: make planted.

    python -m tools.planted [--count N] [--seed N] [--folder z_touch/...]
        [--tests N] [--workers N] [--minutes N] [--json FILE [--second]]

First every test is run once on a copy of the tree that records which test runs which
block of the product. Then faults are drawn over all files (a condition turned, a guard
removed, a sign, a unit, an option ignored, a limit shifted), and one at a time is
planted in a copy. The tests that run its block are tried until one fails: those of
tests/unit first, then of each file one, and so on. The seed says which faults these
are. What nothing has found is either no fault (what it does is the same) or wants a test.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import SimpleQueue
from typing import Optional

from tools.kit.printer import ROOT
from tools.planted.covering import TESTS, Covering, measured
from tools.planted.found import Found, kept, table, write
from tools.planted.planting import Fault, drawn

SEED = 59
# So many tests at once: what one finds is found by the first few
_BATCHES = (8, 24, 60)
# Of so many the whole tables; of those without a host all: they cost nothing
_TABLES = 20
# Real seconds that a batch may take: what hangs has been found, too
_LIMIT = 900.0
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", re.MULTILINE)
_TIMED_OUT = "(nothing ends)"


def say(text: str) -> None:
    """A line for people, at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


class Copy:
    """A copy of the tree, in which one fault after the other is planted."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.rmtree(folder, ignore_errors=True)
        listed = subprocess.run(
            ["git", "ls-files", "-z"],
            cwd=ROOT,
            check=True,
            capture_output=True,
            text=True,
        )
        for name in filter(None, listed.stdout.split("\0")):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            if (ROOT / name).is_file():
                shutil.copy2(ROOT / name, folder / name)

    def first_failure(self, fault: Fault, tests: Sequence[str]) -> str:
        """The first test that fails with the fault in the tree; "": none does."""
        file = self.folder / fault.changed
        source = file.read_text(encoding="utf-8")
        file.write_text(fault.planted(source), encoding="utf-8")
        try:
            return self._run(tests)
        finally:
            file.write_text(source, encoding="utf-8")

    def _run(self, tests: Sequence[str]) -> str:
        build = os.environ.get("BUILD_DIR", "build")
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no"]
        names = self.folder / "tests-to-run"
        names.write_text("\n".join(tests), encoding="utf-8")
        command += ["--cases", "one", f"@{names}"]
        try:
            done = subprocess.run(
                command,
                cwd=self.folder,
                env={**os.environ, "BUILD_DIR": str((ROOT / build).resolve())},
                capture_output=True,
                text=True,
                timeout=_LIMIT,
            )
        except subprocess.TimeoutExpired:
            return _TIMED_OUT
        failed = _FAILED.search(done.stdout)
        if failed is None and done.returncode:
            return f"(pytest ends with {done.returncode})"
        return failed[1] if failed else ""


def looked_for(
    copy: Copy, fault: Fault, covering: Covering, most: int, but: str = ""
) -> Found:
    """Try the tests that run what a fault changes, most of them at most.

    but: the name of a test that is not tried, in none of its cases.
    """
    source = (copy.folder / fault.file).read_text(encoding="utf-8")
    left_out = but.partition("[")[0]
    cases = [
        case
        for case in covering.of(fault, source)
        if case.name.partition("[")[0] != left_out
    ]
    names = [case.name for case in cases[:most]]
    # In the end whole tables, of which three cases were recorded
    tables = dict.fromkeys(
        name.partition("[")[0]
        for place, name in enumerate(names)
        if place < _TABLES or name.startswith("tests/unit/")
    )
    batches, tried = [], 0
    for size in (*_BATCHES, most):
        batches.append(names[tried : tried + size])
        tried += size
    slow = {case.name.partition("[")[0] for case in cases if case.is_slow}
    tried = 0
    for batch in filter(None, [*batches, [*tables]]):
        test = copy.first_failure(fault, batch)
        tried = min(tried + len(batch), len(names))
        if test:
            is_slow = test.partition("[")[0] in slow
            return Found(fault, test, is_slow, tried, len(cases))
    return Found(fault, "", False, tried, len(cases))


def all_found(
    copies: Sequence[Copy],
    faults: Sequence[Fault],
    covering: Covering,
    options: argparse.Namespace,
    known: Mapping[Fault, Found],
) -> Iterator[Found]:
    """What finds each fault, as long as there is time; one after the other in a copy.

    known: where a test has found it, another one is looked for.
    """
    until = time.monotonic() + 60.0 * options.minutes
    free = SimpleQueue[Copy]()
    for copy in copies:
        free.put(copy)

    def one(fault: Fault) -> Optional[Found]:
        if time.monotonic() > until:
            return None
        copy = free.get()
        first = known.get(fault)
        but = first.test if first else ""
        try:
            found = looked_for(copy, fault, covering, options.tests, but)
        finally:
            free.put(copy)
        return first._replace(second=found.test) if but else found

    with ThreadPoolExecutor(len(copies)) as pool:
        for done in as_completed([pool.submit(one, fault) for fault in faults]):
            found = done.result()
            if found is not None:
                yield found


def is_wanted(row: Optional[Found], options: argparse.Namespace) -> bool:
    """Whether a fault is to be tried now: what is known of it, from an earlier run."""
    if options.second:
        return row is not None and bool(row.test) and row.second is None
    return row is None or not row.test


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.planted",
        description="Single faults of the product, and which tests find them.",
    )
    parser.add_argument("--count", type=int, default=20, help="of faults")
    parser.add_argument("--seed", type=int, default=SEED, help="of the draw")
    parser.add_argument("--folder", default="z_touch", help="of the product")
    parser.add_argument(
        "--tests", type=int, default=120, help="tried on a fault, at most"
    )
    parser.add_argument("--workers", type=int, default=2, help="at a time")
    parser.add_argument("--minutes", type=float, default=1e9, help="at most")
    parser.add_argument(
        "--second",
        action="store_true",
        help="look for another test of what one has found, as --json says",
    )
    parser.add_argument("--json", type=Path, help="write what was found there")
    return parser.parse_args(arguments)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """The exit code is 0 if each fault was found."""
    options = parse(arguments)
    build = (ROOT / os.environ.get("BUILD_DIR", "build")).resolve()
    folder = build / f"planted-{os.getpid()}"
    copies = [Copy(folder / str(n)) for n in range(options.workers)]
    faults = drawn(ROOT, options.folder, options.count, options.seed)
    found = {row.fault: row for row in kept(options.json, faults)}
    wanted = [fault for fault in faults if is_wanted(found.get(fault), options)]
    try:
        covering = measured(copies[0].folder, build / "planted", TESTS)
        for row in all_found(copies, wanted, covering, options, found):
            found[row.fault] = row
            say(f"{row.fault}\n    {row.second or row.test or 'found by none'}")
            if options.json:
                write(options.json, options.seed, [*found.values()])
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    say(table([*found.values()]))
    say(f"seed {options.seed}, {len(found)} of {len(faults)} tried")
    return 0 if all(row.test for row in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
