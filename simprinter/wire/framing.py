"""Message blocks: length, sequence, content, checksum, sync byte.

The format is Klipper's (its docs/Protocol.md): at most 64 bytes a block, CRC16
with the CCITT polynomial over length, sequence and content, 0x7e at the end.
An acknowledgement is a block without content that carries the sequence number
expected next; the same block sent for a wrong one says "again from here".
"""

from __future__ import annotations

BLOCK_MIN = 5
BLOCK_MAX = 64
CONTENT_MAX = BLOCK_MAX - BLOCK_MIN
SYNC = 0x7E
DEST = 0x10
SEQ_MASK = 0x0F


def _make_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8408 if crc & 1 else 0)
        table.append(crc)
    return table


_TABLE = _make_table()


def crc16(data: bytes) -> int:
    """CRC16-CCITT, reflected, starting from 0xffff."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc


def encode_block(seq: int, content: bytes) -> bytes:
    """One block. Raises ValueError where the content does not fit."""
    if len(content) > CONTENT_MAX:
        raise ValueError(f"{len(content)} bytes do not fit into one block")
    head = bytes((BLOCK_MIN + len(content), DEST | (seq & SEQ_MASK)))
    crc = crc16(head + content)
    return head + content + bytes((crc >> 8, crc & 0xFF, SYNC))


class Deframer:
    """Finds blocks in a stream of bytes."""

    def __init__(self) -> None:
        self._buffer = b""
        self._in_sync = True

    def feed(self, data: bytes) -> list[tuple[int, bytes] | None]:
        """Blocks completed by data as (sequence, content), in order.

        None stands for damaged bytes, which the receiver answers with its
        expected sequence number.
        """
        self._buffer += data
        found: list[tuple[int, bytes] | None] = []
        while self._buffer:
            if not self._in_sync:
                skipped = self._buffer.find(SYNC)
                if skipped < 0:
                    self._buffer = b""
                    break
                self._buffer = self._buffer[skipped + 1 :]
                self._in_sync = True
                found.append(None)
                continue
            length = self._buffer[0]
            if length == SYNC:  # an idle sync byte between blocks
                self._buffer = self._buffer[1:]
                continue
            if not BLOCK_MIN <= length <= BLOCK_MAX:
                self._in_sync = False
                continue
            if len(self._buffer) < length:
                break
            self._take(length, found)
        return found

    def _take(self, length: int, found: list) -> None:
        block = self._buffer[:length]
        crc = (block[-3] << 8) | block[-2]
        if (
            block[-1] != SYNC
            or block[1] & ~SEQ_MASK != DEST
            or crc16(block[:-3]) != crc
        ):
            self._in_sync = False
            return
        self._buffer = self._buffer[length:]
        found.append((block[1] & SEQ_MASK, block[2:-3]))
