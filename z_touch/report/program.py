"""The program: its arguments, the files that it reads and writes, what it says.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from typing import Any, Dict, List, Optional, Sequence

from ..z_calibration.runs import Parsed, check_file, parse_all
from . import attachment, cycles
from .picture import svg

# The newest reports of a history are kept, each a picture and a text
KEPT = 10

# What klippy hands over
FACTS = {"section", "versions", "settings", "status"}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the arguments."""
    made = argparse.ArgumentParser(
        prog="report", description="Draw the history of the Z calibration."
    )
    made.add_argument("history", help="z_calibration/printer.jsonl")
    made.add_argument(
        "--facts",
        metavar="FILE",
        help="what klippy knows, JSON: a text to attach is written, too; -: stdin",
    )
    made.add_argument(
        "--picture",
        metavar="FILE",
        help="where to draw; default: report-<name>-<date>-<time>.svg beside HISTORY",
    )
    return made


def main(words: Sequence[str]) -> int:
    """Draw a history; returns the exit status."""
    given = parser().parse_args(words)
    try:
        for line in report(given.history, given.facts, given.picture):
            sys.stdout.write(f"{line}\n")
    except (OSError, ValueError) as e:
        sys.stderr.write(f"{e}\n")
        return 1
    return 0


def report(
    history: str, facts: Optional[str], picture: Optional[str]
) -> List[str]:
    """Write the files; returns what is said of them.

    The arguments are those of the program. Raises OSError, and ValueError where the
    facts are none.
    """
    known = None if facts is None else read_facts(facts)
    said = []
    try:
        parsed = read(history)
    except OSError as e:
        # The text to attach is wanted all the more
        parsed = Parsed([], 0, 0)
        said.append(
            f"{history} cannot be read, so no runs are in the report: {e.strerror}"
        )
    path = picture or new_path(history)
    write(path, svg(parsed.runs, name=history))
    said.append(f"the report is {path}")
    if parsed.damaged:
        said.append(f"{parsed.damaged} damaged lines of {history} are left out")
    if parsed.other:
        said.append(
            f"{parsed.other} lines of {history} are of another version, and left out"
        )
    if known is not None:
        runs = [run for run in parsed.runs if run.is_calibration]
        text = os.path.splitext(path)[0] + ".txt"
        write(text, attachment.compose(known, runs))
        said.append(
            f"attach {text} when you ask somebody: it has your options and the last"
            " runs, and names no person, computer or folder"
        )
    if picture is None:
        drop_old(history, os.path.basename(path))
    if parsed.runs and parsed.runs[-1].cycles:
        judged = cycles.judge_run(parsed.runs[-1])
        said.append(f"verdict of CALIBRATE_Z_ACCURACY: {judged.text}")
    return said


def read(history: str) -> Parsed:
    """Return the runs of a file; none yet is none."""
    check_file(history)
    try:
        with open(history, "rb") as f:
            return parse_all(f.read().split(b"\n"))
    except FileNotFoundError:
        return Parsed([], 0, 0)


def read_facts(path: str) -> Dict[str, Any]:
    """Return what klippy knows, of a file or "-"."""
    if path == "-":
        text = sys.stdin.read()
    else:
        with open(path, encoding="utf-8") as f:
            text = f.read()
    facts = json.loads(text)
    if not isinstance(facts, dict) or not facts.keys() >= FACTS:
        raise ValueError(f"no facts of klippy in {path}")
    return facts


######################################################################
# Files beside the history
######################################################################


def stem(history: str) -> str:
    """Return what the names of its reports begin with."""
    name = os.path.splitext(os.path.basename(history))[0]
    return f"report-{name}-"


def new_path(history: str) -> str:
    """Return the path of a picture of now; the folder is made where there is none."""
    folder = os.path.dirname(os.path.abspath(history))
    os.makedirs(folder, exist_ok=True)
    now = time.strftime("%Y%m%d-%H%M%S", time.localtime())
    return os.path.join(folder, f"{stem(history)}{now}.svg")


def write(path: str, text: str) -> None:
    """Write a file, which has all of the text, or stays as it was."""
    new = f"{path}.new"
    try:
        with open(new, "w", encoding="utf-8") as f:
            f.write(text)
            f.flush()
            os.fsync(f.fileno())
        os.replace(new, path)
    except OSError:
        if os.path.isfile(new):
            os.remove(new)
        raise


def drop_old(history: str, new: str) -> None:
    """Remove all reports of a history but the latest.

    new: the picture that was just written, and stays with its text whatever the clock
    said before.
    """
    folder = os.path.dirname(os.path.abspath(history))
    for ending in ("svg", "txt"):
        old = re.compile(
            rf"{re.escape(stem(history))}\d{{8}}-\d{{6}}\.{ending}$"
        )
        kept = os.path.splitext(new)[0] + f".{ending}"
        others = sorted(
            name
            for name in os.listdir(folder)
            if old.match(name) and name != kept
        )
        for name in others[: max(0, len(others) + 1 - KEPT)]:
            os.remove(os.path.join(folder, name))
