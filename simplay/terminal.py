"""A printer that is played with in a terminal, until Ctrl-C or `quit`."""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from simplay.commands import COMMANDS, ENDS
from simplay.played import Played
from simprinter.hosts.printer import firmware_of
from simprinter.running import show

# Real seconds between two looks at what systemd would have to do
_LOOK_EVERY = 0.2
# Ctrl-C, kill, a terminal that is closed
_ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Typed:
    """Lines typed at the terminal; none where there is no terminal."""

    def __init__(self) -> None:
        self._rest = b""
        self._is_open = True

    def lines(self) -> list[str]:
        """What was typed within a while."""
        inputs = [sys.stdin] if self._is_open else []
        if not select.select(inputs, [], [], _LOOK_EVERY)[0]:
            return []
        data = os.read(sys.stdin.fileno(), 4096)
        self._is_open = bool(data)
        *whole, self._rest = (self._rest + data).split(b"\n")
        return [line.decode(errors="replace").strip() for line in whole]


def play(played: Played) -> int:
    """Keep it running until it is told to end; the exit code."""
    typed = Typed()
    while True:
        for line in filter(None, typed.lines()):
            if line in ENDS:
                return 0
            played.do(line)
        failure = played.has_ended()
        if failure is not None:
            show(f"!! the printer cannot go on: {failure}")
            return 1
        for name in played.look_after():
            show(f"restarted {name}")


def welcome(played: Played, page: str) -> None:
    """Where it is, and what can be done with it."""
    host = played.host
    show(
        f"\nPrinter    {played.title()}, {firmware_of(host)} {host.version}\n"
        f"Page       {page}\n"
        f"Moonraker  {played.moonraker_url}\n"
        f"Config     {played.config_file.parent}\n"
        "Open the page in a browser on this computer, then home. Mainsail,"
        " Fluidd and\n"
        "KlipperScreen work beside it: enter Moonraker's address there.\n"
        f"Type {', '.join(COMMANDS)} or quit here. Ctrl-C ends all.\n"
    )


def run(make: Callable[[Path], Played], page: int) -> int:
    """Make one in a folder of its own, play, take both away; the exit code.

    Where it could not go on, the folder stays.

    page: the port of its page, or the next that is free.
    """
    directory = Path(tempfile.mkdtemp(prefix="playground-"))
    code = None
    try:
        played = make(directory)
        show("Starting klippy and Moonraker ...")
        with played:
            try:
                played.set_up()
                welcome(played, played.open_page(page))
                code = play(played)
                return code
            finally:
                # Once is enough; what follows takes a second
                for number in _ENDS:
                    signal.signal(number, signal.SIG_IGN)
    finally:
        _end_all_of(directory)
        if code:
            # Nobody asked for the end: printer.cfg has what was tried out
            show(f"The folder is kept, with printer.cfg and logs: {directory}")
        else:
            shutil.rmtree(directory, ignore_errors=True)


def _end_all_of(directory: Path) -> None:
    """End what an early Ctrl-C has left: all that was given this folder."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.fsencode(directory) in (folder / "environ").read_bytes():
                os.kill(int(folder.name), signal.SIGKILL)


def until_told(run: Callable[[], int]) -> int:
    """Run something that Ctrl-C, kill, or a closed terminal end; the exit code."""
    # A shell that starts it in the background has it ignore Ctrl-C
    for number in _ENDS:
        signal.signal(number, _stop)
    try:
        return run()
    except KeyboardInterrupt:
        show("ended")
        return 0


def _stop(*_unused: object) -> None:
    raise KeyboardInterrupt
