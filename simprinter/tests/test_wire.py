"""The serial protocol: numbers, messages, blocks, and the line itself."""

from __future__ import annotations

import os
import tty

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.wire.framing import (
    BLOCK_MAX,
    CONTENT_MAX,
    SYNC,
    Deframer,
    crc16,
    encode_block,
)
from simprinter.wire.link import Link
from simprinter.wire.messages import (
    Message,
    decode_int,
    encode_int,
)

CONTENTS = st.binary(max_size=CONTENT_MAX)


def slow_crc(data: bytes) -> int:
    """The division itself, bit by bit, on unreflected numbers."""
    bits = [int(b) for byte in data for b in f"{byte:08b}"[::-1]]
    rest = 0xFFFF
    for bit in bits:
        out = (rest >> 15) ^ bit
        rest = (rest << 1) & 0xFFFF
        if out:
            rest ^= 0x1021
    return int(f"{rest:016b}"[::-1], 2)


@given(st.binary(max_size=80))
def test_crc_is_the_division(data):
    assert crc16(data) == slow_crc(data)
    # The check value of CRC-16/MCRF4XX
    assert crc16(b"123456789") == 0x6F91


# Numbers and messages


def groups(value: int, size: int) -> bytes:
    """A 32-bit number as `size` groups of 7 bits, highest first."""
    parts = [(value >> (7 * i)) & 0x7F for i in reversed(range(size))]
    return bytes([part | 0x80 for part in parts[:-1]] + parts[-1:])


# The table in Klipper's Protocol.md; what is above 2**31 - 1 is the same 32
# bits as a negative number and may be sent as that
@pytest.mark.parametrize(
    ("low", "high", "size"),
    [
        (-32, 95, 1),
        (-4096, 12287, 2),
        (-524288, 1572863, 3),
        (-67108864, 201326591, 4),
        (-(1 << 31), (1 << 31) - 1, 5),
    ],
)
def test_documented_sizes(low, high, size):
    for value in (low, high):
        assert encode_int(value) == groups(value, size)
    for value in (low - 1, high + 1) if size < 5 else ():
        assert encode_int(value) == groups(value, size + 1)


@given(
    st.integers(-(1 << 31), (1 << 32) - 1),
    st.integers(-(1 << 31), (1 << 31) - 1),
    st.binary(max_size=40),
)
def test_message_comes_back(number, signed, data):
    message = Message(77, "all a=%u b=%i c=%*s")
    content = message.encode({"a": number, "b": signed, "c": data})
    ident, pos = decode_int(content, 0)
    values = [number & 0xFFFFFFFF, signed, data]
    assert (ident, message.decode(content, pos)) == (
        77,
        (values, len(content)),
    )
    # Klippy's Python side sends large unsigned numbers in 5 bytes
    found = Message(3, "b v=%u").decode(groups(number, 5), 0)
    assert found == ([number & 0xFFFFFFFF], 5)


# Blocks


def test_block_layout():
    block = encode_block(0x13, b"\x01\x02")
    crc = slow_crc(b"\x07\x13\x01\x02")
    assert block == bytes((7, 0x13, 1, 2, crc >> 8, crc & 0xFF, 0x7E))
    assert len(encode_block(0, bytes(CONTENT_MAX))) == BLOCK_MAX == 64
    with pytest.raises(ValueError, match="60 bytes"):
        encode_block(0, bytes(CONTENT_MAX + 1))


BLOCKS = st.lists(
    st.tuples(st.integers(0, 15), CONTENTS, st.integers(0, 3)), max_size=8
)


@given(BLOCKS, st.data())
def test_blocks_come_back_however_they_are_split(blocks, data):
    # Idle sync bytes between blocks are nothing
    stream = b"".join(
        encode_block(seq, content) + bytes([SYNC]) * idle
        for seq, content, idle in blocks
    )
    found, deframer = [], Deframer()
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += deframer.feed(stream[:size])
        stream = stream[size:]
    assert found == [block[:2] for block in blocks]


@given(CONTENTS, st.data())
def test_damaged_byte_is_noticed(content, data):
    block = bytearray(encode_block(3, content))
    where = data.draw(st.integers(0, len(block) - 1))
    block[where] ^= data.draw(st.integers(1, 255))
    good = encode_block(4, b"good")
    # A wrong length may swallow some of what follows, never all
    found = Deframer().feed(bytes(block) + good * 10)
    assert (3, content) not in found
    assert found[-1] == (4, b"good")
    if block[0] != SYNC:
        assert None in found


# The line


class HostEnd:
    """The host's side of a line, and all that the board's side received."""

    def __init__(self, latency_ns: int) -> None:
        self.contents: list[bytes] = []
        self.answers: list[bytes] = []
        self.ns = 5000
        self.link = Link(self._take, latency_ns, lambda: self.ns)
        self.open()

    def open(self) -> None:
        self._fd = os.open(self.link.path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._fd)
        os.set_blocking(self._fd, False)
        self._deframer = Deframer()

    def close(self) -> None:
        os.close(self._fd)

    def _take(self, content: bytes) -> None:
        self.contents.append(content)
        for answer in self.answers:
            self.link.send(answer)

    def send(self, data: bytes) -> list[tuple[int, bytes] | None]:
        """Send, let the board's side work; what comes back."""
        while data:
            data = data[os.write(self._fd, data) :]
            self.link.pump()
        return self.receive()

    def receive(self) -> list[tuple[int, bytes] | None]:
        found = []
        while True:
            try:
                found += self._deframer.feed(os.read(self._fd, 4096))
            except BlockingIOError:
                return found


@pytest.fixture
def host_end(request):
    """A line at 5000 ns; it takes that many ns."""
    end = HostEnd(getattr(request, "param", 0))
    yield end
    end.close()
    end.link.close()


def test_wrong_number_is_answered_by_the_right_one(host_end):
    # The board waits for 0x10, a host starts at 0x11
    assert host_end.send(encode_block(1, b"hello")) == [(0, b"")]
    assert host_end.contents == []
    # Sent twice it is run once; answers leave before the acknowledgement
    host_end.answers = [b"a", b"b"]
    found = host_end.send(encode_block(0, b"hello"))
    assert found == [(1, b"a"), (1, b"b"), (1, b"")]
    assert host_end.send(encode_block(0, b"hello")) == [(1, b"")]
    assert host_end.contents == [b"hello"]


def test_what_is_damaged_or_lost_is_asked_for_again(host_end):
    blocks = [encode_block(i, bytes([i])) for i in range(3)]
    damaged = blocks[0][:2] + b"?" + blocks[0][3:]
    assert host_end.send(damaged) == [(0, b"")]
    # Those behind it wait for it
    assert host_end.send(blocks[1] + blocks[2]) == [(0, b""), (0, b"")]
    assert host_end.contents == []
    answers = host_end.send(b"".join(blocks))
    assert answers == [(1, b""), (2, b""), (3, b"")]
    assert host_end.contents == [b"\x00", b"\x01", b"\x02"]
    assert host_end.link.received == 6 * len(blocks[0])


def test_numbers_wrap_and_a_host_that_restarts_learns_them(host_end):
    for i in range(37):
        found = host_end.send(encode_block(i, bytes([i])))
        assert found == [((i + 1) % 16, b"")]
    assert host_end.contents == [bytes([i]) for i in range(37)]
    host_end.close()
    host_end.open()
    assert host_end.send(encode_block(1, b"again")) == [(5, b"")]
    assert host_end.send(encode_block(5, b"again")) == [(6, b"")]


def test_what_the_host_does_not_read_is_kept(host_end):
    link = host_end.link
    for i in range(10_000):
        link.send(i.to_bytes(2, "big"))
    assert not link.settled()
    found = host_end.receive()
    while not link.settled():
        assert link.pump()
        found += host_end.receive()
    assert found == [(0, i.to_bytes(2, "big")) for i in range(10_000)]
    assert link.sent == 10_000 * 7
    assert not link.pump()
    with pytest.raises(ValueError, match="too long"):
        link.send(bytes(CONTENT_MAX + 1))


@pytest.mark.parametrize("host_end", [1000], indirect=True)
def test_bytes_are_under_way_in_both_directions(host_end):
    link = host_end.link
    host_end.answers = [b"a"]
    assert host_end.send(encode_block(0, b"one")) == []
    host_end.ns = 5300
    host_end.send(encode_block(1, b"two"))
    # The line is empty as far as counting goes, and knows when it goes on
    assert link.received == 16
    assert link.settled()
    for ns, contents, answers in (
        (5999, [], []),
        (6000, [b"one"], []),
        (6300, [b"one", b"two"], []),
        (6999, [b"one", b"two"], []),
        (7000, [b"one", b"two"], [(1, b"a"), (1, b"")]),
        (7300, [b"one", b"two"], [(2, b"a"), (2, b"")]),
    ):
        due = link.next_event_ns()
        host_end.ns = ns
        assert link.pump() is (ns == due)
        assert host_end.contents == contents
        assert host_end.receive() == answers
    assert link.next_event_ns() is None


def test_path_is_one_of_a_linux_process_while_it_is_open():
    link = Link(lambda content: None)
    assert link.path.startswith("/tmp/klipper_host_")
    assert os.path.realpath(link.path) == link.device
    link.close()
    assert not os.path.exists(os.path.dirname(link.path))
