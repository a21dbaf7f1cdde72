"""A micro-controller program of the user's as a board of the machine.

Klipper also builds its micro-controller code as an ordinary Linux process.
Here such a process takes the place of a board: firmware.c, preloaded into it,
hands over its clock, its console and its GPIO lines. Line n of the first chip
is what pin number n of our own board is: `gpio0` stands for `PA0`.
"""

from __future__ import annotations

import array
import bisect
import functools
import json
import os
import re
import socket
import struct
import subprocess
import tempfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Optional

from .clock import MONOTONIC_START_NS, NEVER, build_library
from .rig import COMMIT_NS, Port, Rig
from .wire.framing import Deframer, encode_block
from .wire.messages import Message, decode_int, parse
from .wiring import MAIN, pin_number

_SOURCE = Path(__file__).with_name("firmware.c")
# What firmware.c says and is told
_REPORT = struct.Struct("4i2q")
_ANSWER = struct.Struct("2q2i")
_STARTED, _ASLEEP, _LOOKS, _FULL = range(4)
# A program may compute this long (s, real) without a rest
_STALL_LIMIT = 60.0
_SECOND = 10**9
_PIN = re.compile(r"\bP[A-I](?:1[0-5]|\d)\b")


class FirmwareError(Exception):
    """The program does not do what a micro-controller does."""


def gpio_names(config: str) -> str:
    """The same printer.cfg for a program that calls PA0 gpio0."""
    return _PIN.sub(lambda found: f"gpio{pin_number(found[0])}", config)


class Process:
    """The program, asleep wherever nobody lets it live.

    now: how far it has lived; alarm: when it wants to wake (both ns).
    began: since when it runs, or has run anew after a reset.
    """

    def __init__(
        self,
        program: Path,
        library: Path,
        look: Callable[[int, int], bool],
        take: Callable[[array.array], None],
    ):
        """look: the level of an input (pin, ns).

        take: told of outputs, each as ns << 13 | pin << 1 | level.
        """
        self._look, self._take = look, take
        self._directory = tempfile.TemporaryDirectory(prefix="firmware-")
        self._output = Path(self._directory.name) / "output.txt"
        self._channel, theirs = socket.socketpair()
        self._channel.settimeout(_STALL_LIMIT)
        environment = {
            **os.environ,
            "LD_PRELOAD": str(library),
            "FIRMWARE_FD": str(theirs.fileno()),
        }
        console = str(Path(self._directory.name) / "console")
        with theirs, open(self._output, "wb") as file:
            self._popen = subprocess.Popen(
                [str(program), "-I", console],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                pass_fds=[theirs.fileno()],
            )
        self.pid = self._popen.pid
        self.alarm, self.now, self.began = 0, 0, 0
        self._is_new = True
        self._receive()

    def live(self, now: int, until: int, heard: bytes = b"") -> bytes:
        """Live from now until then, or until it speaks; what it says.

        heard: bytes on its console. Raises FirmwareError.
        """
        said, level = b"", False
        while True:
            # One that has spoken goes no further than it must
            until = min(until, self.now) if said else until
            self._send(max(now, self.now), until, level, heard)
            heard, level = b"", False
            kind, pin, words = self._receive()
            said += words
            if kind == _LOOKS:
                level = self._look(pin, self.now)
            elif kind == _ASLEEP and (said or self.alarm > until):
                return said

    def _send(self, now: int, until: int, level: bool, heard: bytes) -> None:
        if self._is_new:
            self.began, self._is_new = now, False
        answer = _ANSWER.pack(now, until, level, len(heard))
        try:
            self._channel.sendall(answer + heard)
        except OSError as error:
            raise FirmwareError(self._why("has ended")) from error

    def _receive(self) -> tuple[int, int, bytes]:
        """(kind, pin, bytes on its console) of what it reports."""
        head = self._read(_REPORT.size)
        kind, pin, count, size, self.now, self.alarm = _REPORT.unpack(head)
        self._is_new = kind == _STARTED
        if count:
            events = array.array("q")
            events.frombytes(self._read(count * events.itemsize))
            self._take(events)
        return kind, pin, self._read(size)

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            try:
                more = self._channel.recv(size - len(data))
            except OSError as error:
                raise FirmwareError(self._why("is busy")) from error
            if not more:
                raise FirmwareError(self._why("has ended"))
            data += more
        return data

    def _why(self, state: str) -> str:
        printed = self._output.read_text(errors="replace").strip()
        return f"the firmware {state}: {printed or 'it has said nothing'}"

    def close(self) -> None:
        """End it."""
        self._popen.kill()
        self._popen.wait()
        self._channel.close()
        self._directory.cleanup()


class DataDictionary(NamedTuple):
    """What a program says of itself."""

    app: str
    version: str
    commands: Mapping[int, Message]
    responses: Mapping[int, Message]
    constants: Mapping[str, Any]

    def parse(self, content: bytes) -> list[tuple[str, list]]:
        """Commands in a block as (name, values)."""
        return parse(self.commands, content)


@functools.cache
def data_dictionary(program: Path, directory: Path) -> DataDictionary:
    """Ask a program for its data dictionary. Raises FirmwareError.

    directory: for what has to be compiled.
    """
    library = build_library(directory, _SOURCE)
    try:
        process = Process(program, library, lambda *_: False, lambda _: None)
    except OSError as error:
        raise FirmwareError(f"{program}: {error.strerror}") from error
    try:
        found = json.loads(zlib.decompress(_identify(process)))
    finally:
        process.close()

    def messages(part: str) -> dict[int, Message]:
        texts = found[part].items()
        return {ident: Message(ident, text) for text, ident in texts}

    return DataDictionary(
        found.get("app", "Klipper"),
        found["version"],
        messages("commands"),
        messages("responses"),
        found["config"],
    )


def _identify(process: Process) -> bytes:
    ask = Message(1, "identify offset=%u count=%c")
    answer = Message(0, "identify_response offset=%u data=%.*s")
    now, data, deframer = MONOTONIC_START_NS, b"", Deframer()
    for seq in range(1000):
        content = ask.encode({"offset": len(data), "count": 40})
        block = encode_block(seq & 0x0F, content)
        now = max(now, process.now) + 1_000_000
        said = process.live(now, now + 1_000_000, block)
        blocks = [found[1] for found in deframer.feed(said) if found]
        for content in blocks:
            ident, start = decode_int(content, 0) if content else (-1, 0)
            if ident == answer.ident:
                (_, piece), _end = answer.decode(content, start)
                if not piece:
                    return data
                data += piece
    raise FirmwareError("the program does not tell what it is")


class StepLog:
    """The steps that a motor has made, as StepTrack but by their times, ns."""

    def __init__(self) -> None:
        self._times: list[int] = []
        self._positions: list[int] = []
        self._rest = 0
        self.last_clock = 0
        self.position = 0
        self.sign = -1
        self.is_high = False

    def set_step(self, level: bool, ns: int) -> None:
        """The step pin is set: a driver steps when it rises."""
        if level and not self.is_high:
            self.position += self.sign
            self._times.append(ns)
            self._positions.append(self.position)
            self.last_clock = ns
        self.is_high = level

    def at(self, ns: int) -> int:
        """Position (steps) at a time."""
        i = bisect.bisect_right(self._times, ns)
        return self._positions[i - 1] if i else self._rest

    def begins_by(self, ns: int) -> bool:
        """Whether any step that is known was made by a time."""
        return bool(self._times) and ns >= self._times[0]

    def forget(self, ns: int) -> None:
        """Drop what nobody will ask for: positions before a time."""
        keep = bisect.bisect_right(self._times, ns) - 1
        if keep > 0:
            self._rest = self._positions[keep - 1]
            del self._times[:keep], self._positions[:keep]


class FirmwareBoard:
    """A program as a board; its clock counts ns for the mechanics."""

    def __init__(
        self,
        now_ns: Callable[[], int],
        program: Path,
        directory: Path,
        rig: Rig,
        name: str = MAIN,
    ):
        """directory: for what has to be compiled. name: the board's."""
        self.dictionary = data_dictionary(program, directory)
        self.send: Callable[[bytes], None] = lambda data: None
        self.hang_up: Callable[[], None] = lambda: None
        self._now_ns = now_ns
        self._port = Port(rig, name)
        self._port.board = self
        self._logs: dict[int, StepLog] = {}
        self._turns: dict[int, StepLog] = {}
        wiring = rig.wiring.on_board(name)
        for motor, pins in wiring.motors.items():
            log = StepLog()
            rig.connect(motor, self)
            rig.axes[motor].track = log
            self._logs[pin_number(pins.step_pin)] = log
            self._turns[pin_number(pins.dir_pin)] = log
        self._outputs = {pin_number(pin) for pin in wiring.outputs.values()}
        self._levels: dict[int, bool] = {}
        self._settled = now_ns()
        self._endstops: dict[int, int] = {}
        self._heard, self._said = b"", b""
        self._deframer = Deframer()
        self._stopped_until = 0
        self.has_ended = False
        library = build_library(directory, _SOURCE)
        self._process = Process(program, library, self._look, self._take)

    # What the mechanics ask

    def clock(self) -> int:
        """Until when the world has to live before a pin is looked at."""
        return self._settled

    def ns(self, clock: int) -> int:
        """The same."""
        return clock

    def clock_at(self, ns: int) -> int:
        """The same."""
        return ns

    # What the program does

    def _take(self, events: array.array) -> None:
        for event in events:
            pin, level, ns = event >> 1 & 0xFFF, bool(event & 1), event >> 13
            if pin in self._logs:
                self._logs[pin].set_step(level, ns)
            elif pin in self._turns:
                self._turns[pin].sign = 1 if level else -1
            elif pin in self._outputs:
                self._port.set_output(pin, ns, float(level))

    def _look(self, pin: int, ns: int) -> bool:
        if ns >= self._settled + COMMIT_NS:
            self._settled = ns
        level = self._port.level(pin, ns)
        if level != self._levels.get(pin):
            # A touch begins or ends: the world has to know of that very moment
            self._levels[pin] = level
            self._settled = max(self._settled, ns)
            level = self._port.level(pin, ns)
        return level

    # What the host does

    def receive(self, data: bytes) -> None:
        """Bytes for the program; looks for touches among them."""
        self._heard += data
        self._settled = max(self._settled, self._now_ns())
        for block in self._deframer.feed(data):
            for name, values in self.dictionary.parse(
                block[1] if block else b""
            ):
                self._note(name, values)

    def _note(self, name: str, values: list) -> None:
        if name == "config_endstop":
            self._endstops[values[0]] = values[1]
        elif name == "endstop_query_state":
            self._port.queried(self._endstops[values[0]], self._now_ns())
        elif name == "endstop_home" and values[3]:
            start = self._ns_of(values[1])
            self._port.armed(self._endstops[values[0]], start)
        elif name == "endstop_home":
            self._port.disarmed(self._endstops[values[0]])

    def _ns_of(self, clock: int) -> int:
        """When the program's clock shows this value, near to now."""
        ticks_per_second = self.dictionary.constants["CLOCK_FREQ"]
        tick_ns = _SECOND // ticks_per_second
        # It counts from the second that follows its start
        zero = (self._process.began // _SECOND + 1) * _SECOND
        now = self._now_ns()
        ahead = (clock - (now - zero) // tick_ns) & 0xFFFFFFFF
        ahead -= (ahead & 0x80000000) << 1
        return now + ahead * tick_ns

    # What the simulation does

    def deadline(self) -> int:
        """When the program wants to wake, ns."""
        if self.has_ended:
            return NEVER
        return max(self._process.alarm, self._stopped_until)

    def listen(self) -> bool:
        """Let the program hear what was said to it; whether it was."""
        now = self._now_ns()
        if not self._heard or self.has_ended or now < self._stopped_until:
            return False
        heard, self._heard = self._heard, b""
        self._said += self._process.live(now, now, heard)
        return True

    def live_until(self, ns: int) -> int:
        """Live until then, or until it speaks; the time that is reached."""
        said = self._process.live(self._now_ns(), ns)
        self._said += said
        return max(self._now_ns(), self._process.now) if said else ns

    def run_due(self) -> bool:
        """Send what the program has said; whether it had."""
        said, self._said = self._said, b""
        if said:
            self.send(said)
        return bool(said)

    def next_event_ns(self) -> Optional[int]:
        """When there is something to be sent, ns."""
        return self._now_ns() if self._said else None

    # What a test does to it

    @property
    def pid(self) -> int:
        """Of its process."""
        return self._process.pid

    def stop_for(self, seconds: float) -> None:
        """Let it stand still while time goes on, as a stopped process does."""
        self._stopped_until = self._now_ns() + round(seconds * 1e9)

    def kill(self) -> None:
        """End the program: the host loses its board."""
        self.has_ended = True
        self._process.close()
        self.hang_up()

    def close(self) -> None:
        """Give everything back."""
        if not self.has_ended:
            self._process.close()
