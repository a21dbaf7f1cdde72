"""Options of a command that starts a printer to play with."""

from __future__ import annotations

import argparse

from simplay import network

SLOWEST, FASTEST = 1.0, 20.0


def speed_of(text: str) -> float:
    """A speed as it is typed, times real time. Raises ValueError."""
    speed = float(text)
    if not SLOWEST <= speed <= FASTEST:
        raise ValueError(f"{text} is not from {SLOWEST:g} to {FASTEST:g}")
    return speed


def add_options(parser: argparse.ArgumentParser) -> None:
    """How fast it lives, and where it is found."""
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


def door_of(options: argparse.Namespace) -> network.Door:
    """Where Moonraker is to listen."""
    return network.Door(options.listen, options.port, options.origin)
