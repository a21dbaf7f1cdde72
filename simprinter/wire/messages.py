"""Message formats, their parameters as bytes, and the data dictionary."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Any

# Integers, whatever their declared width, travel in the same variable-length
# form; buffers as a length byte and their content.
_INTEGERS = {"%u", "%i", "%hu", "%hi", "%c"}
_SIGNED = {"%i", "%hi"}
_BUFFERS = {"%s", "%.*s", "%*s"}


def encode_int(value: int) -> bytes:
    """Variable-length form of a 32-bit integer (signed or not)."""
    if value >= 1 << 31:
        value -= 1 << 32
    out = []
    # A byte carries 7 bits; the first may stand for -32..95, so that small
    # negative numbers stay short
    for shift in (28, 21, 14, 7):
        bound = 1 << (shift - 2)
        if not -bound <= value < 3 * bound:
            out.append(((value >> shift) & 0x7F) | 0x80)
    out.append(value & 0x7F)
    return bytes(out)


def decode_int(data: bytes, pos: int) -> tuple[int, int]:
    """Signed value at pos and the position behind it."""
    byte = data[pos]
    pos += 1
    value = byte & 0x7F
    if byte & 0x60 == 0x60:
        value |= -0x20
    while byte & 0x80:
        byte = data[pos]
        pos += 1
        value = (value << 7) | (byte & 0x7F)
    return value, pos


class Message:
    """One format such as `uptime high=%u clock=%u`."""

    def __init__(self, ident: int, text: str):
        self.ident = ident
        self.text = text
        words = text.split()
        self.name = words[0]
        self.params = []
        for word in words[1:]:
            name, kind = word.split("=")
            if kind not in _INTEGERS and kind not in _BUFFERS:
                raise ValueError(f"unknown parameter type in {text!r}")
            self.params.append((name, kind))

    def encode(self, values: dict[str, Any]) -> bytes:
        """Content of a block that carries this message."""
        out = [encode_int(self.ident)]
        for name, kind in self.params:
            value = values[name]
            if kind in _BUFFERS:
                out.append(bytes((len(value),)) + bytes(value))
            else:
                out.append(encode_int(value))
        return b"".join(out)

    def decode(self, data: bytes, pos: int) -> tuple[list, int]:
        """Parameter values in order and the position behind them."""
        values: list = []
        for _, kind in self.params:
            if kind in _BUFFERS:
                end = pos + 1 + data[pos]
                values.append(data[pos + 1 : end])
                pos = end
                continue
            value, pos = decode_int(data, pos)
            if kind not in _SIGNED:
                value &= 0xFFFFFFFF
            values.append(value)
        return values, pos


class Dictionary:
    """What a micro-controller understands and says."""

    def __init__(
        self,
        commands: list[str],
        responses: list[str],
        constants: dict[str, Any],
        enumerations: dict[str, dict[str, Any]],
        app: str,
    ):
        # A host knows the numbers of these two before it has the dictionary
        answer = Message(0, "identify_response offset=%u data=%.*s")
        identify = Message(1, "identify offset=%u count=%c")
        self.responses = {answer.name: answer}
        self.commands = {identify.ident: identify}
        self.constants = constants
        for text in responses:
            message = Message(1 + len(self.responses), text)
            self.responses[message.name] = message
        first = 1 + len(self.responses)
        for ident, text in enumerate(commands, first):
            self.commands[ident] = Message(ident, text)
        self._content = {
            "app": app,
            "version": "simulated-1",
            "build_versions": "simulated",
            "commands": {m.text: m.ident for m in self.commands.values()},
            "responses": {m.text: m.ident for m in self.responses.values()},
            "enumerations": enumerations,
            "config": constants,
        }
        self.json = json.dumps(self._content, sort_keys=True).encode()
        self.identify_data = zlib.compress(self.json)

    def response(self, name: str, values: dict[str, Any]) -> bytes:
        """Content of a block with one response."""
        return self.responses[name].encode(values)

    def parse(self, content: bytes) -> list[tuple[str, list]]:
        """Commands in a block as (name, values in declared order).

        Raises ValueError for a number that was never declared.
        """
        return parse(self.commands, content)


def parse(
    commands: Mapping[int, Message], content: bytes
) -> list[tuple[str, list]]:
    """Commands in a block as (name, values in declared order).

    Raises ValueError for a number that was never declared.
    """
    found = []
    pos = 0
    while pos < len(content):
        ident, pos = decode_int(content, pos)
        message = commands.get(ident)
        if message is None:
            raise ValueError(f"unknown command number {ident}")
        values, pos = message.decode(content, pos)
        found.append((message.name, values))
    return found
