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
import sys
import time
from collections.abc import Sequence
from typing import Optional

from simplay import terminal
from simplay.network import AddressError
from simplay.options import add_options, door_of
from simprinter.hosts.moonraker_package import find_moonraker
from simprinter.running import show
from tools.kit.printer import NO_PRINTER, choose_host
from tools.playground.playground import KNOWN, SHOWN, Choice, Playground


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
    add_options(parser)
    return parser.parse_args(words)


def run(options: argparse.Namespace) -> int:
    """Build it, play, take it down; the exit code."""
    show("Preparing (the first time takes a minute) ...")
    host = choose_host(options.host)
    python = find_moonraker()
    if python is None:
        show("error: there is no Moonraker")
        return 1
    choice = Choice(options.scene, options.seed, options.perfect)
    speed, door = options.speed, door_of(options)
    return terminal.run(
        lambda folder: Playground(
            host, python, folder, choice, speed, door, show
        ),
        options.page,
    )


def main(words: Optional[Sequence[str]] = None) -> int:
    """Run a playground; the exit code."""
    options = _arguments(words)
    try:
        return terminal.until_told(lambda: run(options))
    except (*NO_PRINTER, ValueError, AddressError) as error:
        print(f"error: {error}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
