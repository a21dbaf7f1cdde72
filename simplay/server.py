"""Serves the page of a played printer, to browsers of this computer only.

It listens on 127.0.0.1, answers who asks for it by that name or as localhost
(another name in Host is a page from elsewhere whose name was made to lead
here), and takes orders and files from its own page alone (Origin). It gives
away the files of the folder page/ and printer.cfg, and writes printer.cfg; what
the page orders are commands of this program, never those of a shell. Everything
about klippy goes from the browser to Moonraker, which has rules of its own.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import threading
from collections import deque
from pathlib import Path
from typing import Any, Optional, Protocol

from tornado import httpserver, web, websocket
from tornado.iostream import StreamClosedError

from simplay.network import LOOPBACK

_FOLDER = Path(__file__).with_name("page")
# Bytes of a printer.cfg; of an order
_LARGEST_CONFIG, _LARGEST_ORDER = 512 * 1024, 1024
_MOST_VIEWERS = 8
# Lines of the terminal that a page is shown when it comes
_LINES = 200
# Real seconds between two looks at whether a viewer is still there
_PING_EVERY = 20
_START_LIMIT = 10.0


class Desk(Protocol):
    """What the page is about."""

    moonraker_url: str
    config_file: Path

    def hello(self) -> dict[str, Any]:
        """What a page has to know first."""

    def do(self, line: str) -> None:
        """Do what could be typed at the terminal; for other threads."""

    def choose(self, name: str) -> None:
        """Have another printer; for other threads."""


class PageServer:
    """Runs in a thread of its own from start() to close()."""

    def __init__(self, port: int, desk: Desk):
        self.port = port
        self.desk = desk
        names = (f"{LOOPBACK}:{port}", f"localhost:{port}")
        self.hosts = frozenset(names)
        self.origins = frozenset(f"http://{name}" for name in names)
        self.url = f"http://{LOOPBACK}:{port}"
        self._viewers: set[Live] = set()
        self._lines: deque[str] = deque(maxlen=_LINES)
        self._loop = asyncio.new_event_loop()
        self._thread: Optional[threading.Thread] = None
        self._failure: Optional[BaseException] = None

    # For other threads

    @property
    def is_watched(self) -> bool:
        """Whether any page is open."""
        return bool(self._viewers)

    def start(self) -> None:
        """Begin to answer. Raises OSError if the port is taken."""
        ready = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(ready,), name="page", daemon=True
        )
        self._thread.start()
        ready.wait(_START_LIMIT)
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """End it."""
        if self._thread is not None:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(_START_LIMIT)
            self._thread = None

    def show_frame(self, frame: dict[str, Any]) -> None:
        """Show it to whoever keeps up, and to all if something was touched."""
        # No later frame tells of its touches again; they are as rare as lines
        may_skip = not frame.get("touches")
        self._publish({"kind": "frame", **frame}, may_skip)

    def show_line(self, line: str) -> None:
        """Show what the terminal shows."""
        self._lines.append(line)
        self._publish({"kind": "line", "line": line}, False)

    def show_hello(self) -> None:
        """Show that it is another printer now."""
        self._publish(self.desk.hello(), False)

    def _publish(self, message: dict[str, Any], may_skip: bool) -> None:
        if self._viewers:
            text = json.dumps(message)
            self._loop.call_soon_threadsafe(self._send, text, may_skip)

    # In its own thread

    def _run(self, ready: threading.Event) -> None:
        loop = self._loop
        asyncio.set_event_loop(loop)
        try:
            server = httpserver.HTTPServer(
                self._application(), max_body_size=_LARGEST_CONFIG
            )
            server.listen(self.port, LOOPBACK)
        except OSError as error:
            self._failure = error
            return
        finally:
            ready.set()
        loop.run_forever()
        server.stop()
        loop.run_until_complete(server.close_all_connections())
        loop.close()

    def _application(self) -> web.Application:
        given = {"server": self}
        return web.Application(
            [
                ("/live", Live, given),
                ("/printer.cfg", Config, given),
                (
                    "/(.*)",
                    Files,
                    {
                        **given,
                        "path": str(_FOLDER),
                        "default_filename": "index.html",
                    },
                ),
            ],
            log_function=lambda handler: None,
            policy=self.policy,
            websocket_ping_interval=_PING_EVERY,
            websocket_max_message_size=_LARGEST_ORDER,
        )

    def _send(self, text: str, may_skip: bool) -> None:
        for viewer in tuple(self._viewers):
            viewer.send(text, may_skip)

    def join(self, viewer: Live) -> bool:
        """A page has come; whether there is room for it."""
        if len(self._viewers) >= _MOST_VIEWERS:
            return False
        hello = {**self.desk.hello(), "lines": list(self._lines)}
        viewer.send(json.dumps(hello), False)
        self._viewers.add(viewer)
        return True

    def leave(self, viewer: Live) -> None:
        """A page is gone."""
        self._viewers.discard(viewer)

    def policy(self) -> str:
        """What the page may load: itself, and Moonraker's answers."""
        moonraker = self.desk.moonraker_url
        sockets = [f"ws://{host}" for host in sorted(self.hosts)]
        sockets.append(moonraker.replace("http", "ws", 1))
        return (
            "default-src 'none'; script-src 'self'; style-src 'self';"
            f" img-src 'self' {moonraker};"
            f" connect-src 'self' {moonraker} {' '.join(sockets)};"
            " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )


class _Guarded(web.RequestHandler):
    """Answers its own page and nobody else."""

    server: PageServer

    def initialize(self, server: PageServer) -> None:
        self.server = server

    def prepare(self) -> None:
        if self.request.host not in self.server.hosts:
            raise web.HTTPError(403)
        origin = self.request.headers.get("Origin")
        if origin is not None and origin not in self.server.origins:
            raise web.HTTPError(403)

    def set_default_headers(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        # Called by the constructor, before initialize()
        policy = self.application.settings["policy"]
        self.set_header("Content-Security-Policy", policy())


class Files(_Guarded, web.StaticFileHandler):
    """The files of the page."""

    def initialize(
        self, server: PageServer, path: str, default_filename: str
    ) -> None:
        self.server = server
        web.StaticFileHandler.initialize(self, path, default_filename)

    def set_extra_headers(self, path: str) -> None:
        self.set_header("Cache-Control", "no-store")


class Config(_Guarded):
    """printer.cfg, read and written as a whole."""

    def get(self) -> None:
        """The text; ETag: which one it is."""
        try:
            data = self.server.desk.config_file.read_bytes()
        except OSError as error:
            raise web.HTTPError(404) from error
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.set_header("ETag", _mark(data))
        self.write(data)

    def put(self) -> None:
        """Another text, for the one that If-Match names."""
        # A form cannot PUT, and a script of another page has an Origin
        if "Origin" not in self.request.headers:
            raise web.HTTPError(403)
        file, data = self.server.desk.config_file, self.request.body
        try:
            data.decode()
        except UnicodeDecodeError as error:
            raise web.HTTPError(400) from error
        wanted = self.request.headers.get("If-Match")
        if wanted != _mark(file.read_bytes()):
            raise web.HTTPError(412)
        new = file.with_name(".printer.cfg.new")
        new.write_bytes(data)
        os.replace(new, file)
        self.set_header("ETag", _mark(data))
        self.set_status(204)

    def compute_etag(self) -> None:
        """That of get(), not tornado's."""


class Live(_Guarded, websocket.WebSocketHandler):
    """A page that looks on: frames and lines there, orders back."""

    _writing: Optional[asyncio.Future] = None

    def prepare(self) -> None:
        super().prepare()
        # Every browser names it here
        if "Origin" not in self.request.headers:
            raise web.HTTPError(403)

    def check_origin(self, origin: str) -> bool:
        return origin in self.server.origins

    def open(self, *unused: str) -> None:
        if not self.server.join(self):
            self.close(1013, "too many pages are open")

    def on_close(self) -> None:
        self.server.leave(self)

    def on_message(self, message: str | bytes) -> None:
        try:
            order = json.loads(message)
            desk = self.server.desk
            # Orders without a meaning are answered by a line
            if isinstance(order.get("do"), str):
                desk.do(order["do"])
            elif isinstance(order.get("scene"), str):
                desk.choose(order["scene"])
        except (ValueError, AttributeError):
            self.close(1003, "not understood")

    def send(self, text: str, may_skip: bool) -> None:
        """Show it; frames only to a browser that has taken the last one."""
        busy = self._writing is not None and not self._writing.done()
        if busy and may_skip:
            return
        self._writing = asyncio.ensure_future(self._write(text))

    async def _write(self, text: str) -> None:
        try:
            await self.write_message(text)
        except (websocket.WebSocketClosedError, StreamClosedError):
            self.server.leave(self)


def _mark(data: bytes) -> str:
    return f'"{hashlib.sha256(data).hexdigest()[:16]}"'
