"""Starting klippy: as its owner does, or quickly, forked from one that waits.

A klippy that runs on a virtual clock may be forked from a process that has
imported its modules already (forkserver.py), which is two to three times as
fast; it is a process of its own from its program's first line on.
"""

from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import subprocess
from collections import OrderedDict
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Optional, Union

from simprinter.clock import RealClock, VirtualClock
from simprinter.hosts.hosts import HostError, Installed

_SERVER = Path(__file__).with_name("forkserver.py")
# As many servers stay; each is as large as an idle klippy
_KEPT = 6
_SECTION = re.compile(r"^\[(\w+)", re.MULTILINE)
_KINEMATICS = re.compile(r"^kinematics *[:=] *(\w+)", re.MULTILINE)
# A server that imports klippy takes a second
_ANSWER_LIMIT = 60.0


class Klippy:
    """A klippy that was started."""

    def __init__(
        self, pid: int, pidfd: int, popen: Optional[subprocess.Popen] = None
    ):
        """pidfd: becomes this object's; popen: where it is our own child."""
        self.pid = pid
        self.pidfd = pidfd
        self._popen = popen

    def end(self) -> Optional[int]:
        """End it if it still runs; its exit status where it is known.

        As systemd does, with all that it has started.
        """
        if not self._has_ended():
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self.pidfd, signal.SIGKILL)
            self._ends().poll()
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        return None if self._popen is None else self._popen.wait()

    def close(self) -> None:
        """Forget it; it must have ended."""
        os.close(self.pidfd)

    def _has_ended(self) -> bool:
        return bool(self._ends().poll(0))

    def _ends(self) -> select.poll:
        # select() takes no number above 1023: many tests that fail leave some open
        waiting = select.poll()
        waiting.register(self.pidfd, select.POLLIN)
        return waiting


def start(
    installed: Installed,
    options: Sequence[str],
    clock: Union[VirtualClock, RealClock],
    output: Path,
) -> Klippy:
    """Start klippy as a service would; output: for what it prints."""
    environment = installed.environment()
    environment.update(clock.environment())
    with open(output, "wb") as file:
        popen = subprocess.Popen(
            [*installed.argv, *options],
            cwd=installed.cwd,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=file,
            pass_fds=clock.inherited_fds(),
            start_new_session=True,
        )
    return Klippy(popen.pid, os.pidfd_open(popen.pid), popen)


def fork(
    installed: Installed,
    options: Sequence[str],
    clock: VirtualClock,
    output: Path,
    config: str,
) -> Klippy:
    """The same, quickly; config: its printer.cfg."""
    request = {
        "argv": list(options),
        "env": installed.environment(),
        "fds": clock.inherited_fds(),
        "output": str(output),
        "wanted": _wanted(config),
        "clock": clock.page,
    }
    return _server(installed, clock).fork(request)


def close() -> None:
    """End all servers; their klippies must have ended."""
    while _servers:
        _servers.popitem()[1].close()
    while _ending:
        _ending.pop().wait()


def _server(installed: Installed, clock: VirtualClock) -> _Server:
    """The one for these modules; it may have to be made."""
    server = _servers.pop(installed.cwd, None)
    if server is not None and server.has_ended():
        server.close()
        server = None
    server = server or _Server(installed, clock)
    _servers[installed.cwd] = server
    if len(_servers) > _KEPT:
        _servers.popitem(last=False)[1].close()
    return server


def _wanted(config: str) -> list[str]:
    sections = dict.fromkeys(_SECTION.findall(config))
    kinematics = _KINEMATICS.findall(config)
    return [f"extras.{name}" for name in sections] + [
        f"kinematics.{name}" for name in (*kinematics, "extruder")
    ]


class _Server:
    """One host with its modules, imported and waiting."""

    def __init__(self, installed: Installed, clock: VirtualClock):
        """clock: any that lives on the same library."""
        layout = installed.host.layout
        own, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        script = installed.cwd / layout.script if layout.script else ""
        is_package = bool(layout.prefix)
        folder = installed.cwd if is_package else Path(script).parent
        arguments = [folder, layout.imports, layout.prefix, script]
        environment = installed.environment()
        environment["LD_PRELOAD"] = str(clock.library)
        self._output = os.memfd_create("output")
        with theirs:
            self._popen = subprocess.Popen(
                [installed.host.python, _SERVER, str(theirs.fileno())]
                + list(map(str, arguments)),
                cwd=installed.cwd,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=self._output,
                stderr=self._output,
                pass_fds=[theirs.fileno()],
            )
        self._channel = own
        self._channel.settimeout(_ANSWER_LIMIT)

    def fork(self, request: dict) -> Klippy:
        """Let it fork. Raises HostError with what it has printed."""
        fds = request["fds"]
        try:
            socket.send_fds(self._channel, [json.dumps(request).encode()], fds)
            data, rights, _flags, _ = socket.recv_fds(self._channel, 64, 1)
        except OSError as error:
            raise HostError(f"klippy cannot fork: {self._told()}") from error
        if not rights:
            raise HostError(f"klippy cannot fork: {self._told()}")
        return Klippy(int(data), rights[0])

    def has_ended(self) -> bool:
        """Whether it is gone; the thread that made it may have ended."""
        return self._popen.poll() is not None

    def close(self) -> None:
        """Let it end, when its klippies have; some may go on for long."""
        self._channel.close()
        os.close(self._output)
        _ending[:] = [popen for popen in _ending if popen.poll() is None]
        _ending.append(self._popen)

    def _told(self) -> str:
        size = os.fstat(self._output).st_size
        text = os.pread(self._output, size, 0).decode(errors="replace")
        return text.strip()


_servers: OrderedDict[Path, _Server] = OrderedDict()
# Servers that have been told to end
_ending: list[subprocess.Popen] = []
