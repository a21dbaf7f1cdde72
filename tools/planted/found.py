"""What became of faults: a table of it, and the file that a run goes on with."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Optional

from simprinter.hosts.hosts import main_host
from tools.kit.tables import markdown, plain
from tools.planted.planting import Fault


class Found(NamedTuple):
    """What became of a fault: the test that fails, "" for none, of how many.

    second: another test that fails, "" when all that are left pass; None: not asked.
    """

    fault: Fault
    test: str
    is_slow: bool
    tried: int
    there: int
    second: Optional[str] = None


def kept(file: Optional[Path], faults: Sequence[Fault]) -> list[Found]:
    """What an earlier run has made of these faults."""
    if file is None or not file.exists():
        return []
    by_name = {str(fault): fault for fault in faults}
    return [
        Found(**{**row, "fault": by_name[row["fault"]]})
        for row in json.loads(file.read_text(encoding="utf-8"))["rows"]
        if row["fault"] in by_name
    ]


def write(file: Path, seed: int, found: Sequence[Found]) -> None:
    """For a run that goes on, and for a document."""
    rows = [row._asdict() | {"fault": str(row.fault)} for row in found]
    about = {"host": main_host().name, "seed": seed, "rows": rows}
    file.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")


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
    missed = [row for row in found if not row.test]
    hits = len(found) - len(missed)
    slow = sum(row.is_slow for row in found)
    lines = [
        plain(["found by", *kinds], rows),
        f"{hits} of {len(found)} found ({100.0 * hits / max(len(found), 1):.0f} %),"
        f" {hits - slow} of them by make test",
        *(
            f"not found by {row.tried} of {row.there} tests: {row.fault}"
            for row in missed
        ),
    ]
    return "\n".join(lines)


def render(file: str) -> str:
    """For a document: of each kind, how many were found by which tests."""
    about = json.loads(Path(file).read_text(encoding="utf-8"))
    kinds: dict[str, Counter[str]] = defaultdict(Counter)
    for row in about["rows"]:
        kind = row["fault"].split(" ")[1].rstrip(":")
        kinds[kind].update(["tried", _finder(row["test"], row["is_slow"])])
    kinds["all"] = sum(kinds.values(), Counter())
    heads = ["kind", "tried", *_FINDERS]
    rows = [
        [kind, *(str(counts[head]) for head in heads[1:])]
        for kind, counts in kinds.items()
    ]
    text = f"\nSeed {about['seed']}, on {about['host']}.\n\n{markdown(heads, rows)}\n"
    seconds = [row.get("second") for row in about["rows"]]
    asked = [second for second in seconds if second is not None]
    if not asked:
        return text
    return (
        f"{text}\nOf {len(asked)} that are found another test was looked for, among all"
        f" that run the block:\n{asked.count('')} are found by one test alone.\n"
    )


_FINDERS = ("tests/unit", "make test", "make test-rest", "none tried")


def _finder(test: str, is_slow: bool) -> str:
    """Which of these has found a fault."""
    if test.startswith(_FINDERS[0]):
        return _FINDERS[0]
    return _FINDERS[3] if not test else _FINDERS[1 + is_slow]
