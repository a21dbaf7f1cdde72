"""A client of klippy's API socket that lives in a simulation's loop."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import termios
from pathlib import Path
from typing import Any

_END = b"\x03"


class ApiError(Exception):
    """Klippy refused a request; the text is klippy's."""


class ApiClient:
    """Requests, answers, and the console lines that come in between."""

    def __init__(self, path: Path):
        """path: the socket klippy will listen on, maybe not there yet."""
        self._path = path
        self._socket: socket.socket | None = None
        self._in = b""
        self._out = b""
        self._next_id = 0
        self._answers: dict[int, dict] = {}
        self.console: list[str] = []
        self.connections = 0  # that have ended

    def fileno(self) -> int:
        """The socket, -1 while there is none."""
        return -1 if self._socket is None else self._socket.fileno()

    def connected(self) -> bool:
        """Whether klippy has taken the connection."""
        return self._socket is not None

    def settled(self) -> bool:
        """Whether both sides have read everything that was said.

        Klippy may have spoken, or begun to listen, since the last pump();
        time must not move before that was dealt with.
        """
        if self._socket is None:
            return not self._connect()
        unsent = fcntl.ioctl(self._socket, termios.TIOCOUTQ, b"\0" * 4)
        unread = fcntl.ioctl(self._socket, termios.FIONREAD, b"\0" * 4)
        return not self._out and not any(unsent) and not any(unread)

    def pump(self) -> bool:
        """Connect, send and receive as far as possible."""
        if self._socket is None:
            return self._connect()
        moved = self._flush()
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            return moved
        except ConnectionResetError:  # it left while we were speaking
            data = b""
        if not data:
            self.close()
            return False
        *messages, self._in = (self._in + data).split(_END)
        for message in messages:
            self._dispatch(json.loads(message))
        return True

    def request(self, method: str, params: dict[str, Any]) -> int:
        """Send a request; the number under which `answer` finds the reply."""
        self._next_id += 1
        message = {"id": self._next_id, "method": method, "params": params}
        self._out += json.dumps(message).encode() + _END
        self._flush()
        return self._next_id

    def answered(self, number: int) -> bool:
        """Whether the reply to a request has come."""
        return number in self._answers

    def answer(self, number: int) -> Any:
        """The reply's result. Raises ApiError where klippy refused."""
        reply = self._answers.pop(number)
        if "error" in reply:
            raise ApiError(reply["error"].get("message", str(reply["error"])))
        return reply.get("result")

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
            self._in = self._out = b""
            self.connections += 1

    def _connect(self) -> bool:
        if not self._path.exists():
            return False
        client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            client.connect(os.fspath(self._path))
        except OSError as error:
            client.close()
            if error.errno in (errno.ECONNREFUSED, errno.ENOENT):
                return False
            raise
        client.setblocking(False)
        self._socket = client
        self.request("gcode/subscribe_output", {"response_template": {}})
        return True

    def _flush(self) -> bool:
        if self._socket is None or not self._out:
            return False
        try:
            count = self._socket.send(self._out)
        except BlockingIOError:
            return False
        except (BrokenPipeError, ConnectionResetError):
            self.close()
            return True
        self._out = self._out[count:]
        return count > 0

    def _dispatch(self, message: dict) -> None:
        if "id" in message:
            self._answers[message["id"]] = message
        elif "response" in message.get("params", {}):
            self.console += message["params"]["response"].split("\n")
