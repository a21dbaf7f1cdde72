"""The command simplay: anybody's printer.cfg and plugins, to play with."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Optional

try:
    from simplay import plugins, terminal
    from simplay.network import AddressError
    from simplay.options import add_options, door_of
    from simprinter.hosts import starting
    from simprinter.options import EXPECTED, add_printer, host_of
    from simprinter.running import SAMPLE, show
except ModuleNotFoundError as missing:
    # Of a checkout that was never installed
    sys.exit(
        f"error: simplay needs {missing.name}, which is not installed;"
        " run `pip install ./simplay` in the checkout"
    )


def main(words: Optional[Sequence[str]] = None) -> int:
    """Keep a printer running until it is told to end; the exit status."""
    options = _parser().parse_args(words)
    try:
        return terminal.until_told(lambda: _play(options))
    except (*EXPECTED, AddressError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    finally:
        starting.close()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "simplay",
        description="keep a printer running behind Moonraker, with a page that"
        " shows what really happens, until Ctrl-C",
    )
    parser.add_argument(
        "printer_cfg",
        type=Path,
        nargs="?",
        metavar="printer.cfg",
        help="default: that of `simprinter sample`",
    )
    add_printer(parser)
    add_options(parser)
    return parser


def _play(options: argparse.Namespace) -> int:
    show("Preparing (the first time takes a minute) ...")
    host = host_of(options)
    cfg, world = options.printer_cfg, options.world
    if cfg is None:
        cfg, world = SAMPLE / "printer.cfg", world or SAMPLE / "world.toml"
    files = plugins.Files(cfg, world, options.extras, options.seed)
    python = plugins.moonraker()
    speed, door = options.speed, door_of(options)
    return terminal.run(
        lambda folder: plugins.PluginPlay(
            host, python, folder, files, speed, door, show
        ),
        options.page,
    )


if __name__ == "__main__":
    sys.exit(main())
