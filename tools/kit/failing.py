"""What to read when a test with a printer has failed.

Each printer is remembered until the next test begins; of one that is left by
then, what was in its files is.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Protocol

from simprinter.hosts.environment import build_dir
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import LiveSession

_CONSOLE_LINES = 40
_LOG_LINES = 20
# The world of a test and its faults are in no file
_ELSEWHERE = "The same on a machine made from printer.cfg, without faults:"


class HasSession(Protocol):
    """A printer as far as it is read here."""

    host: Host
    session: LiveSession
    extras: tuple[Path, ...]


class Files(NamedTuple):
    """What a printer leaves: files by name, and what they hold."""

    host: str
    texts: dict[str, str]
    extras: tuple[Path, ...]


_open: list[HasSession] = []
_left: list[Files] = []


def forget() -> None:
    """A test begins."""
    _open.clear()
    _left.clear()


def watch(printer: HasSession) -> None:
    """A printer was made."""
    _open.append(printer)


def leave(printer: HasSession) -> None:
    """It is about to go, and its files with it."""
    if printer in _open:
        _open.remove(printer)
        _left.append(_files_of(printer))


def sections(nodeid: str, whole: bool) -> Iterator[tuple[str, str]]:
    """Titles and texts for a report; the files go into the build directory.

    whole: with all of printer.cfg.
    """
    for printer in [*_open]:
        leave(printer)
    name = re.sub(r"[^\w.@-]+", "-", nodeid.rpartition("/")[2]).strip("-")
    for number, (host, texts, extras) in enumerate(_left, 1):
        folder = build_dir() / "failed" / name / str(number)
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8")
        printer = f"printer {number} on {host}"
        if whole:
            yield f"{printer}: printer.cfg", texts["printer.cfg"]
        for file, count in (
            ("klippy.log", _LOG_LINES),
            ("console.txt", _CONSOLE_LINES),
        ):
            lines = texts[file].splitlines()
            told = [line for line in lines if not line.startswith("Stats ")]
            yield f"{printer}: the end of {file}", "\n".join(told[-count:])
        yield f"{printer}: its files", f"{folder}: {', '.join(texts)}"
        line = _run_line(folder, extras)
        yield f"{printer}: by hand", f"{_ELSEWHERE}\n{line}"
    if _left:
        yield "again", f"make one T={shlex.quote(nodeid)}"


def _run_line(folder: Path, extras: Iterable[Path]) -> str:
    files = [folder / "printer.cfg", folder / "commands.gcode"]
    words = [
        sys.executable,
        "-m",
        "simprinter",
        "run",
        *files,
        "--extras",
        *extras,
    ]
    return shlex.join(map(str, words))


def _files_of(printer: HasSession) -> Files:
    session = printer.session
    texts = dict.fromkeys(("printer.cfg", "klippy.log"), "")
    # Klippy may have been ended, and its files removed
    with suppress(OSError):
        texts["printer.cfg"] = session.config_text()
        texts["klippy.log"] = session.log()
    texts["console.txt"] = "\n".join(session.console)
    texts["commands.gcode"] = "\n".join(session.scripts)
    return Files(printer.host.name, texts, printer.extras)
