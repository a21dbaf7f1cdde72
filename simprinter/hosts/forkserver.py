"""A klippy that has imported everything and forks for each start.

    python forkserver.py CHANNEL FOLDER MODULE PREFIX [SCRIPT]

runs in the Python of a host, which imports this file alone. Importing takes
klippy most of a second, forking a process that has done so some milliseconds;
what is forked then runs klippy's program from its first line. CHANNEL is a
socket; each message is one request, JSON, with the descriptors to inherit:

argv      of klippy, its program left out
env       its whole environment
fds       numbers under which it has the descriptors
output    file for what it prints
wanted    modules that its configuration will want, as klippy names them
clock     page of the virtual clock it lives on

The answer is the number of the new process, with a pidfd.
"""

from __future__ import annotations

import array
import contextlib
import ctypes
import fcntl
import gc
import importlib
import json
import os
import random
import runpy
import signal
import socket
import sys
from collections.abc import Sequence
from typing import Any

_MESSAGE_MAX = 1 << 16
_FDS_MAX = 253
_PR_SET_PDEATHSIG = 1
# Python itself sets it where there is no locale
_COERCED = "LC_CTYPE"


class Program:
    """Klippy's program: where it is and what it imports."""

    def __init__(self, folder: str, module: str, prefix: str, script: str):
        """folder: first on the path; module: what to import before it runs.

        prefix: of klippy's other modules. script: the program, empty if it is
        the module.
        """
        sys.path[0] = folder
        self._module = module
        self._prefix = prefix
        self._script = script

    def import_itself(self) -> None:
        """Import what every klippy needs, without running it."""
        importlib.import_module(self._module)
        importlib.import_module(f"{self._prefix}chelper").get_ffi()

    def import_wanted(self, names: Sequence[str]) -> None:
        """Import these modules where they are."""
        for name in names:
            # Klippy itself will say what is wrong with one
            with contextlib.suppress(Exception):
                importlib.import_module(f"{self._prefix}{name}")

    def import_found(self, names: Sequence[str]) -> None:
        """Import what an earlier klippy did, where that works."""
        for name in names:
            with contextlib.suppress(Exception):
                importlib.import_module(name)

    def run(self, arguments: Sequence[str]) -> None:
        """Be klippy."""
        sys.argv = [self._script or self._module, *arguments]
        # Its program is __main__, which nobody has imported
        if not hasattr(sys.modules[self._module], "__path__"):
            del sys.modules[self._module]
        if self._script:
            runpy.run_path(self._script, run_name="__main__")
        else:
            runpy.run_module(self._module, run_name="__main__", alter_sys=True)


class Found:
    """What klippies import by themselves, so that the next ones need not.

    Hosts differ in it, and a third of a start is spent with it.
    """

    def __init__(self) -> None:
        self._reading, self._writing = os.pipe2(os.O_NONBLOCK)
        self._known: set[str] = set()

    def watch(self, free: int) -> None:
        """In a klippy: tell of each import from now on.

        Descriptors from `free` on are nobody's.
        """
        os.close(self._reading)
        writing = self._writing
        self._writing = fcntl.fcntl(writing, fcntl.F_DUPFD_CLOEXEC, free)
        os.close(writing)
        # Asked before all other finders, and finds nothing
        sys.meta_path.insert(0, self)  # type: ignore[arg-type]

    def find_spec(self, name: str, *_unused: Any) -> None:
        """Tell of a module that somebody is about to import."""
        with contextlib.suppress(OSError):
            os.write(self._writing, f"{name}\n".encode())

    def names(self) -> list[str]:
        """New ones since the last call."""
        told = b""
        with contextlib.suppress(BlockingIOError):
            while True:
                told += os.read(self._reading, 1 << 16)
        names = dict.fromkeys(told.decode().split())
        new = [name for name in names if name not in self._known]
        self._known.update(new)
        # A program is to be run, not imported
        return [name for name in new if not name.endswith("__main__")]


def receive(channel: socket.socket) -> tuple[dict[str, Any], list[int]]:
    """The next request with its descriptors; nothing at the end."""
    data, fds, _flags, _ = socket.recv_fds(channel, _MESSAGE_MAX, _FDS_MAX)
    return json.loads(data) if data else {}, fds


def put(fds: Sequence[int], numbers: Sequence[int], free: int) -> None:
    """Give descriptors other numbers, by way of some from `free` on."""
    aside = []
    for fd in fds:
        aside.append(fcntl.fcntl(fd, fcntl.F_DUPFD, free))
        os.close(fd)
    for fd, number in zip(aside, numbers):
        os.dup2(fd, number)
        os.close(fd)


def become(
    program: Program,
    found: Found,
    request: dict[str, Any],
    fds: Sequence[int],
) -> None:
    """Be the klippy that was asked for."""
    # Where many printers live the numbers wanted are as high as those taken
    free = 1 + max(*fds, *request["fds"])
    found.watch(free)
    output = os.open(request["output"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for standard in (1, 2):
        os.dup2(output, standard)
    os.close(output)
    put(fds, request["fds"], free)
    # What it starts can be ended with it
    os.setsid()
    environment = request["env"]
    if _COERCED in os.environ:
        environment.setdefault(_COERCED, os.environ[_COERCED])
    os.environ.clear()
    os.environ.update(environment)
    random.seed()
    ctypes.CDLL(None).vclock_join(request["clock"].encode())
    program.run(request["argv"])


def reap() -> None:
    """Let those go that have ended."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def main() -> None:
    """Fork until nobody asks any more."""
    # Whoever is killed takes the server with it, and that its klippies
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    channel = socket.socket(fileno=int(sys.argv[1]))
    program, found = Program(*sys.argv[2:]), Found()
    program.import_itself()
    while True:
        request, fds = receive(channel)
        if not request:
            break
        program.import_wanted(request["wanted"])
        program.import_found(found.names())
        gc.freeze()
        pid = os.fork()
        if not pid:
            channel.close()
            become(program, found, request, fds)
            return
        for fd in fds:
            os.close(fd)
        pidfd = os.pidfd_open(pid)
        rights = array.array("i", [pidfd])
        channel.sendmsg(
            [b"%d" % pid], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, rights)]
        )
        os.close(pidfd)
        reap()
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()


if __name__ == "__main__":
    main()
