"""A printer to play with, in a browser.

    python -m tools.playground [--scene NAME] [--perfect] [--seed N]
                               [--host NAME] [--speed N] [--page N]
                               [--listen ADDRESS] [--port N] [--origin URL]

Starts a simulated printer with real klippy and real Moonraker and keeps it
running until Ctrl-C. Shows each touch as it happens, and the true gap between
nozzle and bed, on its own page and in the terminal. What can be typed
meanwhile: help.
"""

from __future__ import annotations

import argparse
import os
import select
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Optional

from simprinter.hosts.hosts import find_hosts
from simprinter.hosts.moonraker_package import find_moonraker
from tools.kit.printer import NO_PRINTER, choose_host, firmware_of
from tools.playground import network
from tools.playground.commands import COMMANDS, speed_of
from tools.playground.playground import KNOWN, SHOWN, Choice, Door, Playground

# Real seconds between two looks at what systemd would have to do
_LOOK_EVERY = 0.2
# Ctrl-C, kill, a terminal that is closed
_ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def say(text: str) -> None:
    """Show a line now."""
    print(text, flush=True)


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


def play(playground: Playground) -> int:
    """Keep it running until it is told to end; the exit code."""
    typed = Typed()
    while True:
        for line in filter(None, typed.lines()):
            if line in ("quit", "exit"):
                return 0
            playground.do(line)
        failure = playground.has_ended()
        if failure is not None:
            say(f"!! the printer cannot go on: {failure}")
            return 1
        playground.obey_page()
        for name in playground.restart_ended() + playground.restart_asked():
            say(f"restarted {name}")


def welcome(playground: Playground, page: str) -> None:
    """Where it is, and what can be done with it."""
    host, choice = playground.host, playground.choice
    say(
        f"\nPrinter    {choice.name}, {choice.kind()}, {firmware_of(host)}"
        f" {host.version}\n"
        f"Page       {page}\n"
        f"Moonraker  {playground.moonraker_url}\n"
        f"Config     {playground.config_file.parent}\n"
        "Open the page in a browser on this computer, then home. Mainsail,"
        " Fluidd and\n"
        "KlipperScreen work beside it: enter Moonraker's address there.\n"
        f"Type {', '.join(COMMANDS)} or quit here. Ctrl-C ends all.\n"
    )


def _arguments(words: Optional[Sequence[str]]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tools.playground",
        description="a simulated printer to play with, in a browser",
    )
    parser.add_argument(
        "--scene",
        metavar="NAME",
        choices=list(KNOWN),
        default="z_calibration",
        help=f"{', '.join(SHOWN)} (a printer for each module), or another"
        f" machine: {', '.join(sorted(set(KNOWN) - set(SHOWN)))}",
    )
    parser.add_argument(
        "--perfect",
        action="store_true",
        help="without the noise, texture and slow drift of real printers",
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=int,
        default=time.time_ns() // 10**9,
        help="of all that is random, to have the same again",
    )
    parser.add_argument("--host", metavar="NAME", help="klippy to run")
    parser.add_argument(
        "--speed",
        metavar="N",
        type=speed_of,
        default=4.0,
        help="so many times as fast as a real printer, 1 to 20 (4)",
    )
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        default=network.LOOPBACK,
        help="address of this machine on which Moonraker listens, 0.0.0.0: on"
        f" all; others of its network need no password then"
        f" ({network.LOOPBACK})",
    )
    parser.add_argument(
        "--port",
        metavar="N",
        type=int,
        default=7125,
        help="of Moonraker; the next one where it is taken (7125)",
    )
    parser.add_argument(
        "--page",
        metavar="N",
        type=int,
        default=8125,
        help="port of its own page, which is for browsers of this computer"
        " only; the next one where it is taken (8125)",
    )
    parser.add_argument(
        "--origin",
        metavar="URL",
        action="append",
        default=[],
        help="a web page that may talk to it though it is from elsewhere, such"
        " as http://my.mainsail.xyz; may be repeated",
    )
    parser.add_argument("--list", action="store_true", help="show hosts only")
    return parser.parse_args(words)


def run(arguments: argparse.Namespace) -> int:
    """Build it, play, take it down; the exit code."""
    host = choose_host(arguments.host)
    python = find_moonraker()
    if python is None:
        say("error: there is no Moonraker")
        return 1
    choice = Choice(arguments.scene, arguments.seed, arguments.perfect)
    directory = Path(tempfile.mkdtemp(prefix="playground-"))
    try:
        playground = Playground(
            host,
            python,
            directory,
            choice,
            arguments.speed,
            Door(arguments.listen, arguments.port, arguments.origin),
            say,
        )
        say("Starting klippy and Moonraker ...")
        with playground:
            try:
                playground.set_up()
                page = playground.open_page(arguments.page)
                welcome(playground, page)
                return play(playground)
            finally:
                # Once is enough; what follows takes a second
                for number in _ENDS:
                    signal.signal(number, signal.SIG_IGN)
    finally:
        end_all_of(directory)
        shutil.rmtree(directory, ignore_errors=True)


def end_all_of(directory: Path) -> None:
    """End what an early Ctrl-C has left: all that was given this folder."""
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.fsencode(directory) in (folder / "environ").read_bytes():
                os.kill(int(folder.name), signal.SIGKILL)


def _stop(*_unused: object) -> None:
    raise KeyboardInterrupt


def main(words: Optional[Sequence[str]] = None) -> int:
    """Run a playground; the exit code."""
    arguments = _arguments(words)
    # A shell that starts it in the background has it ignore Ctrl-C
    for number in _ENDS:
        signal.signal(number, _stop)
    try:
        say("Preparing (the first time takes a minute) ...")
        if arguments.list:
            os.environ.setdefault("ALLOW_MISSING_HOSTS", "1")
            for host in find_hosts():
                say(f"host   {host.name}: {firmware_of(host)} {host.version}")
            return 0
        return run(arguments)
    except KeyboardInterrupt:
        say("ended")
        return 0
    except (*NO_PRINTER, ValueError, network.AddressError) as error:
        print(f"error: {error}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
