"""Which tests find which single fault of the product: make planted.

    python -m tools.planted [--count N] [--seed N] [--folder z_touch/...]
        [--stages unit,quick,near] [--minutes N] [--json FILE]

Draws faults over all files (a condition turned, a guard removed, a sign, a unit,
an option ignored, a limit shifted), plants one at a time in a copy of the tree,
and runs tests on it until one fails: first what needs no host, then what is quick,
then all of the module. The seed says which faults these are. What nothing has found is either no
fault (what it does is the same) or wants a test.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Optional

from tools.kit.printer import MODULES, ROOT
from tools.kit.tables import plain
from tools.planted.planting import Fault, drawn

SEED = 59
STAGES = ("unit", "quick", "near")
# Real seconds that a stage may take: what hangs has been found, too
_LIMIT = 1800.0
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)
_TIMED_OUT = "(nothing ends)"


class Found(NamedTuple):
    """What became of a fault: the test that fails, and of which stage; or none."""

    fault: Fault
    stage: str
    test: str


def say(text: str) -> None:
    """A line for people, at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def files_for(file: str, stage: str) -> list[str]:
    """The tests that look at a file of the product, below the root."""
    folder = file.split("/")[1]
    names = [name for name in MODULES if name == folder] or list(MODULES)
    if stage == "unit":
        own = (ROOT / "tests/unit").glob(f"test_{folder}_*.py")
        found = sorted(path.relative_to(ROOT).as_posix() for path in own)
        return found or ["tests/unit"]
    if stage == "quick":
        return [f"tests/quick/test_{name}_quick.py" for name in names]
    if folder == "report":
        return ["tests/modules/test_z_calibration_report.py", "tests/field"]
    found = [
        path.relative_to(ROOT).as_posix()
        for name in names
        for path in sorted((ROOT / "tests/modules").glob(f"test_{name}_*.py"))
    ]
    shared = sorted((ROOT / "tests/modules").glob("test_z_touch_*.py"))
    return ["tests/field", *found, *(str(p.relative_to(ROOT)) for p in shared)]


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

    def first_failure(
        self, fault: Optional[Fault], tests: Sequence[str]
    ) -> str:
        """The first test that fails with the fault in the tree; "": none does."""
        if fault is None:
            return self._run(tests)
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
        command += ["--cases", "one", *tests]
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
    copy: Copy, faults: Sequence[Fault], stages: Sequence[str], until: float
) -> Iterator[Found]:
    """What finds each fault, as long as there is time."""
    for fault in faults:
        if time.monotonic() > until:
            return
        for stage in stages:
            test = copy.first_failure(fault, files_for(fault.file, stage))
            if test:
                break
        yield Found(fault, stage if test else "", test)


def table(found: Sequence[Found]) -> str:
    """By test file and kind; then what nothing has found."""
    kinds = sorted({row.fault.kind for row in found})
    files = Counter(
        (row.test.split("::")[0], row.fault.kind) for row in found if row.test
    )
    names = sorted({name for name, _ in files})
    rows = [
        [name, *(str(files[name, kind] or "") for kind in kinds)]
        for name in names
    ]
    counts = Counter(row.fault.kind for row in found)
    rows.append(["all", *(str(counts[kind]) for kind in kinds)])
    missed = [row.fault for row in found if not row.test]
    share = 100.0 * (len(found) - len(missed)) / max(len(found), 1)
    lines = [
        plain(["found by", *kinds], rows),
        f"{len(found) - len(missed)} of {len(found)} found ({share:.0f} %)",
        *(f"not found: {fault}" for fault in missed),
    ]
    return "\n".join(lines)


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
        "--stages", default=",".join(STAGES), help="some of them"
    )
    parser.add_argument("--minutes", type=float, default=1e9, help="at most")
    parser.add_argument("--json", type=Path, help="write what was found there")
    return parser.parse_args(arguments)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """The exit code is 0 if each fault was found."""
    options = parse(arguments)
    until = time.monotonic() + 60.0 * options.minutes
    stages = options.stages.split(",")
    build = Path(os.environ.get("BUILD_DIR", "build"))
    copy = Copy((ROOT / build).resolve() / f"planted-{os.getpid()}")
    found: list[Found] = []
    try:
        faults = drawn(ROOT, options.folder, options.count, options.seed)
        files = sorted({fault.file for fault in faults})
        # A test that fails by itself would find everything
        tests = {t for f in files for s in stages for t in files_for(f, s)}
        failed = copy.first_failure(None, sorted(tests))
        if failed:
            sys.exit(f"{failed} fails without any fault: mend it first")
        for row in looked_for(copy, faults, stages, until):
            found.append(row)
            say(f"{row.fault}\n    {row.test or 'no test of these stages'}")
    finally:
        shutil.rmtree(copy.folder, ignore_errors=True)
    say(table(found))
    say(f"seed {options.seed}, {len(found)} of {len(faults)} tried")
    if options.json:
        lines = [
            {"fault": str(row.fault), "stage": row.stage, "test": row.test}
            for row in found
        ]
        options.json.write_text(json.dumps(lines, indent=1) + "\n")
    return 0 if all(row.test for row in found) else 1


if __name__ == "__main__":
    sys.exit(main())
