"""One serial line: a pseudo-terminal with a micro-controller at its end."""

from __future__ import annotations

import os
import select
import tempfile
import tty
from collections import deque
from collections.abc import Callable

from ..clock import set_nonblocking
from .framing import CONTENT_MAX, Deframer, encode_block


class Link:
    """The micro-controller's end of the line.

    on_content is called with the content of every block that arrives in
    order; what it sends through `send` leaves before the acknowledgement, as
    on real hardware. Every byte is under way for latency_ns, in either
    direction.
    """

    def __init__(
        self,
        on_content: Callable[[bytes], None],
        latency_ns: int = 0,
        now_ns: Callable[[], int] = lambda: 0,
    ):
        """now_ns is needed where there is a latency."""
        self._on_content = on_content
        self._latency_ns = latency_ns
        self._now_ns = now_ns
        # (when it arrives, what), oldest first
        self._to_board: deque[tuple[int, bytes]] = deque()
        self._to_host: deque[tuple[int, bytes]] = deque()
        self._deframer = Deframer()
        self._next_seq = 0
        self._pending = b""
        self._master, self._slave = os.openpty()
        # The slave end stays open here: a host that comes and goes must not
        # hang up the line
        tty.setraw(self._slave)
        set_nonblocking(self._master)
        self.device = os.ttyname(self._slave)
        # Klippy takes such a path for the Linux-process micro-controller
        self._dir = tempfile.mkdtemp(prefix="klipper_host_", dir="/tmp")
        self.path = os.path.join(self._dir, "mcu")
        os.symlink(self.device, self.path)
        self.sent = 0
        self.received = 0
        # Whether there is anything to read, if that is known without trying
        self.is_spoken_to: Callable[[], bool] = lambda: True
        # Whether the host has the line open
        self.is_heard: Callable[[], bool] = lambda: True

    def fileno(self) -> int:
        """Readable when the host has sent something."""
        return self._master

    def pump(self) -> bool:
        """Move what can be moved; whether anything was."""
        moved = self._flush()
        while self.is_spoken_to():
            try:
                data = os.read(self._master, 65536)
            except BlockingIOError:
                break
            moved = True
            self.received += len(data)
            if self._latency_ns:
                self._to_board.append((self._arrival(), data))
            else:
                self._feed(data)
        return self._arrived() or moved

    def next_event_ns(self) -> int | None:
        """When something that is under way arrives, ns."""
        queues = (self._to_board, self._to_host)
        return min((queue[0][0] for queue in queues if queue), default=None)

    def _arrival(self) -> int:
        return self._now_ns() + self._latency_ns

    def _arrived(self) -> bool:
        """Hand the board what has arrived; whether anything has."""
        moved = False
        while self._to_board and self._to_board[0][0] <= self._now_ns():
            self._feed(self._to_board.popleft()[1])
            moved = True
        return moved

    def _feed(self, data: bytes) -> None:
        for block in self._deframer.feed(data):
            self._receive(block)

    def _receive(self, block: tuple[int, bytes] | None) -> None:
        if block is not None and block[0] == self._next_seq:
            self._next_seq = (self._next_seq + 1) & 0x0F
            self._on_content(block[1])
        # Otherwise the same short block asks for what is missing. A host that
        # has just started learns the sequence number from it.
        self._write(encode_block(self._next_seq, b""))

    def send(self, content: bytes) -> None:
        """Send one block. Raises ValueError where it does not fit."""
        if len(content) > CONTENT_MAX:
            raise ValueError("response too long for one block")
        self._write(encode_block(self._next_seq, content))

    def settled(self) -> bool:
        """Whether everything has been sent whose time has come."""
        return not self._pending

    def _write(self, data: bytes) -> None:
        if self._latency_ns:
            self._to_host.append((self._arrival(), data))
            return
        self._pending += data
        self._flush()

    def _flush(self) -> bool:
        moved = False
        while self._to_host and self._to_host[0][0] <= self._now_ns():
            self._pending += self._to_host.popleft()[1]
        while self._pending:
            try:
                count = os.write(self._master, self._pending)
            except BlockingIOError:
                # Full. A line that nobody listens at loses what comes then, as
                # one of real wires loses everything
                if not self.is_heard():
                    self._pending = b""
                break
            self._pending = self._pending[count:]
            self.sent += count
            moved = True
        return moved

    def close(self) -> None:
        """Hang up."""
        os.close(self._master)
        os.close(self._slave)
        os.unlink(self.path)
        os.rmdir(self._dir)


class RawLink(Link):
    """The same for a program that frames and acknowledges blocks itself.

    on_content is called with bytes as they arrive.
    """

    def _feed(self, data: bytes) -> None:
        self._on_content(data)

    def send(self, content: bytes) -> None:
        """Send bytes."""
        self._write(content)

    def hang_up(self) -> None:
        """The program has ended: its end of the line is closed."""
        self.is_spoken_to = lambda: False
        with select.epoll() as never_ready:
            os.dup2(never_ready.fileno(), self._master)
