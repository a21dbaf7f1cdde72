"""The clock all parts of a simulation share.

`VirtualClock` stands still while klippy computes and jumps to the next thing
anybody waits for when all of klippy is asleep (how this is known is told in
vclock.c). `RealClock` is the same interface on the machine's own clock. Times
are integer nanoseconds of the host's CLOCK_MONOTONIC.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import hashlib
import mmap
import os
import subprocess
import tempfile
import time
from pathlib import Path

NEVER = (1 << 63) - 1
# Any date will do; a fixed one keeps logs the same from run to run
WALL_START_NS = 1_767_225_600 * 10**9
MONOTONIC_START_NS = 1_000 * 10**9
_SOURCE = Path(__file__).with_name("vclock.c")


class ClockError(Exception):
    """The clock library cannot be built or used on this machine."""


def build_library(directory: Path, source: Path = _SOURCE) -> Path:
    """Compile a library into directory unless that was done before.

    Raises ClockError with the compiler's words.
    """
    key = hashlib.sha256(source.read_bytes()).hexdigest()[:16]
    target = directory / f"{source.stem}-{key}.so"
    if target.exists():
        return target
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=directory) as scratch:
        made = Path(scratch) / "library.so"
        command = ["gcc", "-O2", "-Wall", "-Wextra", "-shared", "-fPIC"]
        command += ["-o", str(made), str(source), "-ldl", "-lpthread"]
        try:
            run = subprocess.run(command, capture_output=True, text=True)
        except FileNotFoundError as error:
            raise ClockError("gcc is needed: install it") from error
        if run.returncode:
            raise ClockError(f"{source.name} does not compile:\n{run.stderr}")
        made.rename(target)  # atomic: several test workers may build at once
    return target


def _load(library: Path) -> ctypes.CDLL:
    lib = ctypes.CDLL(str(library))
    page, number, whole = ctypes.c_void_p, ctypes.c_int64, ctypes.c_int
    numbers, wholes = map(ctypes.POINTER, (number, ctypes.c_int32))
    # What they return, and take after the page
    functions = {
        "init": (None, number, number, whole, wholes),
        "add_tty": (whole, ctypes.c_int32, ctypes.c_int32),
        "awake": (whole,),
        "joined_field": (wholes,),
        "wakes": (number,),
        "started_field": (wholes,),
        "children": (None, numbers),
        "look_again": (None,),
        "next_deadline": (number,),
        "now_field": (numbers,),
        "written_field": (numbers, whole),
        "tty_settled": (whole, whole, number, number),
        "tty_is_open": (whole, whole),
        "advance": (whole, number, number),
    }
    for name, (result, *arguments) in functions.items():
        function = getattr(lib, f"vclock_{name}")
        function.restype, function.argtypes = result, [page, *arguments]
    lib.vclock_page_size.restype = ctypes.c_size_t
    lib.vclock_max_children.restype = whole
    return lib


class VirtualClock:
    """A clock that moves only when told, for one preloaded process."""

    virtual = True

    def __init__(self, directory: Path, wall_ns: int = WALL_START_NS):
        """Make a clock; its library is built or found in directory.

        wall_ns: the date at first, since 1970.
        """
        self.library = build_library(directory)
        self._lib = _load(self.library)
        eventfd = ctypes.CDLL(None, use_errno=True).eventfd
        count = self._lib.vclock_max_threads()
        flags = os.O_NONBLOCK | os.O_CLOEXEC
        self._fds = [eventfd(0, flags) for _ in range(count + 1)]
        self.doorbell = self._fds[-1]
        size = self._lib.vclock_page_size()
        fd, self.page = tempfile.mkstemp(prefix="vclock-")
        os.ftruncate(fd, size)
        self._map = mmap.mmap(fd, size)
        os.close(fd)
        self._view = ctypes.c_char.from_buffer(self._map)
        self._page = ctypes.addressof(self._view)
        wake_fds = (ctypes.c_int32 * count)(*self._fds[:-1])
        self._lib.vclock_init(
            self._page,
            MONOTONIC_START_NS,
            wall_ns,
            self.doorbell,
            wake_fds,
        )
        # The clock is read more often than anything else
        self._now = self._lib.vclock_now_field(self._page).contents
        self._joined = self._lib.vclock_joined_field(self._page).contents
        self._started = self._lib.vclock_started_field(self._page).contents
        self._children = (ctypes.c_int64 * self._lib.vclock_max_children())()
        self._written: list[ctypes.c_int64] = []

    def environment(self) -> dict[str, str]:
        """What the process needs in its environment to live on this clock."""
        return {"LD_PRELOAD": str(self.library), "VCLOCK_PAGE": self.page}

    def inherited_fds(self) -> list[int]:
        """Descriptors the process must inherit under the same numbers."""
        return list(self._fds)

    def add_tty(self, path: str) -> int:
        """Count the bytes the process moves over the tty at path."""
        device = os.stat(path).st_rdev
        index = self._lib.vclock_add_tty(
            self._page, os.major(device), os.minor(device)
        )
        if index < 0:
            raise ClockError("too many serial lines")
        field = self._lib.vclock_written_field(self._page, index)
        self._written.append(field.contents)
        return index

    def joined(self) -> bool:
        """Whether the process lives on this clock: preloading may fail."""
        return bool(self._joined.value)

    def now(self) -> int:
        """Current time, ns."""
        return self._now.value

    def everybody_sleeps(self) -> bool:
        """Whether no thread of the process is doing anything."""
        return self._lib.vclock_awake(self._page) == 0

    def may_have_written(self, index: int, received: int) -> bool:
        """Whether the process has written more to a line than was received.

        One that does not live on this clock may have at any time.
        """
        return self._written[index].value != received or not self._joined.value

    def tty_settled(self, index: int, sent: int, received: int) -> bool:
        """Whether all bytes of a line have arrived, counted at both ends.

        sent and received are the simulator's totals.
        """
        settled = self._lib.vclock_tty_settled
        return bool(settled(self._page, index, sent, received))

    def tty_is_open(self, index: int) -> bool:
        """Whether the process listens at a line."""
        return bool(self._lib.vclock_tty_is_open(self._page, index))

    def next_deadline(self) -> int:
        """When the first sleeping thread wants to be woken, ns."""
        return self._lib.vclock_next_deadline(self._page)

    def wakes(self) -> int:
        """How often threads have woken: changes whenever one does."""
        return self._lib.vclock_wakes(self._page)

    def started(self) -> int:
        """How many child processes the process has started, ever."""
        return self._started.value

    def children(self) -> list[tuple[int, int]]:
        """(number of its start, process number) of those it has started.

        Some may have ended.
        """
        self._lib.vclock_children(self._page, self._children)
        return [(it >> 32, it & 0xFFFF_FFFF) for it in self._children if it]

    def look_again(self) -> None:
        """Have all threads that wait for descriptors look at them again."""
        self._lib.vclock_look_again(self._page)

    def advance(self, now: int, wakes: int) -> bool:
        """Jump to now (ns, never backwards) and wake whoever is due.

        Does nothing and returns False if a thread has been awake since wakes
        was read: what was seen of the process is then out of date.
        """
        if now < self.now():
            raise ValueError("time runs forwards only")
        return bool(self._lib.vclock_advance(self._page, now, wakes))

    def answer_doorbell(self) -> None:
        """Silence the doorbell that the last sleeper rang."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.doorbell, 8)

    def close(self) -> None:
        """Give everything back."""
        for fd in self._fds:
            os.close(fd)
        self._fds = []
        # The time it showed last stays readable
        self._now = ctypes.c_int64(self._now.value)
        self._joined = ctypes.c_int32(self._joined.value)
        self._started = ctypes.c_int32(self._started.value)
        self._written = []
        self._view = None
        self._map.close()
        os.unlink(self.page)


class RealClock:
    """The machine's own clock behind the same interface."""

    virtual = False

    def environment(self) -> dict[str, str]:
        """Nothing special is needed."""
        return {}

    def inherited_fds(self) -> list[int]:
        """None."""
        return []

    def add_tty(self, path: str) -> int:
        """Nothing to count."""
        return 0

    def now(self) -> int:
        """Current time, ns."""
        return time.monotonic_ns()

    def close(self) -> None:
        """Nothing to give back."""


def set_nonblocking(fd: int) -> None:
    """Make reads and writes of fd return instead of waiting."""
    flags = fcntl.fcntl(fd, fcntl.F_GETFL)
    fcntl.fcntl(fd, fcntl.F_SETFL, flags | os.O_NONBLOCK)
