# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Serves the live page from a thread of its own: files to read, and a stream of frames that takes no word.

Each frame is made and encoded once, and the same text goes to all pages. A page that falls behind by
seconds misses frames, and then gets all again; nothing waits for it. Requests are answered only if they come
by a name that is allowed, so that no other site's script reads the page through a browser (DNS rebinding,
other origins).
"""

import asyncio
import json
import logging
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from traceback import format_exception_only
from typing import Any
from urllib.parse import urlsplit

from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler, stream_request_body
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from trackslip_common.errors import show
from trackslip_tools.live.connections import BoundedServer
from trackslip_tools.live.page import File
from trackslip_tools.live.parameters import LiveParameters, bound

_SOURCES = ("tornado", "asyncio")  # loggers
_PAUSE_S = 1.0
MOST_PAGES = 24  # that are served at the same time
_PING = 10  # s after which a page that does not answer is given up
_MOST_WAITING = 40  # frames, five seconds: what a phone may fall behind
_LARGEST_REQUEST = 4096  # bytes of a header, or of a body, which nobody needs
_CLOSED_BY_RULE = 1008  # of websockets: the other side broke the rules
_READY = 10.0  # s
_RULES = (  # for the browser: nothing from elsewhere, no script in the page, no form, no frame around it
    "default-src 'none'; script-src 'self'; connect-src 'self' ws://{host}; img-src data:; "
    "style-src 'self' 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class ServerLog(logging.Handler):
    """Gives ``log`` one line a second; ``count`` is of all warnings and errors.

    Strangers cause what is logged, thousands of times a second where they want to.
    """

    def __init__(self, log: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(logging.WARNING)
        self.count = 0
        self._log, self._clock = log, clock
        self._next_s = -float("inf")

    def attach(self) -> None:
        """Take what is logged from now on."""
        for name in _SOURCES:
            logging.getLogger(name).addHandler(self)

    def detach(self) -> None:
        """Take no more."""
        for name in _SOURCES:
            logging.getLogger(name).removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Count a record, and log its first line and its cause."""
        self.count += 1
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + _PAUSE_S
        lines = record.getMessage().splitlines()[:1]
        if record.exc_info is not None and record.exc_info[0] is not None:
            lines += format_exception_only(record.exc_info[0], record.exc_info[1])[-1:]
        self._log(f"live page: {': '.join(line.strip() for line in lines)} ({self.count} such lines so far)")


class PageServer:
    """Serves from ``start`` to ``stop``; ``whole`` gives what a new page needs, from any thread.

    ``log`` takes a line about what goes wrong with connections, once a second at most, from any thread.

    Raises:
        InputError: address, port or origins cannot be used.
    """

    def __init__(
        self,
        files: Mapping[str, File],
        whole: Callable[[], dict[str, Any]],
        parameters: LiveParameters,
        log: Callable[[str], None] = lambda line: show(line, file=sys.stderr),
    ) -> None:
        parameters.allowed(parameters.port)  # refused before anything is opened
        self._sockets = bound(parameters.host, parameters.port)
        self.port = int(self._sockets[0].getsockname()[1])
        self._allowed = parameters.allowed(self.port)
        self._whole, self._files = whole, files
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="page", daemon=True)
        self._pages: set[_Stream] = set()
        self._log = ServerLog(log)
        self._refused = 0  # requests
        shared = {"server": self}
        application = Application(
            [(r"/stream", _Stream, shared), (r"/(.*)", _Files, shared)],
            websocket_ping_interval=_PING,
            websocket_max_message_size=_LARGEST_REQUEST,
            log_function=lambda _: None,
        )
        self._http = BoundedServer(
            application,
            max_header_size=2 * _LARGEST_REQUEST,
            max_body_size=_LARGEST_REQUEST,
            streams=lambda: self.pages,
        )

    @property
    def address(self) -> str:
        """To type into a browser."""
        return f"http://{sorted(self._allowed)[0]}/"

    @property
    def pages(self) -> int:
        """How many look."""
        return len(self._pages)

    @property
    def counts(self) -> dict[str, int]:
        """Name → number, for /diagnostics."""
        return {
            "pages": self.pages,
            "connections": self._http.connections,
            "connections displaced": self._http.displaced,
            "requests refused": self._refused,
            "server warnings": self._log.count,
        }

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def stop(self) -> None:
        """Close the port and all pages; once."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_READY)

    def push(self, frame: dict[str, Any]) -> None:
        """Send a frame to all pages; returns at once."""
        if self._pages:
            self._loop.call_soon_threadsafe(self._send, _encoded(frame))

    def _send(self, text: str) -> None:
        for page in list(self._pages):
            page.offer(text)

    def _serve(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._log.attach()
        self._http.listen_on(self._sockets)
        try:
            self._loop.run_forever()
        finally:
            self._http.stop()
            for page in list(self._pages):
                page.close()
            self._loop.run_until_complete(self._http.close_all_connections())
            self._loop.close()
            self._log.detach()


def _encoded(frame: dict[str, Any]) -> str:
    return json.dumps(frame, separators=(",", ":"), allow_nan=False)


class _Handler(RequestHandler):
    """Answers those who ask by an allowed name."""

    def initialize(self, server: PageServer) -> None:
        self.server = server

    def prepare(self) -> None:
        self.server._http.note_request(self.request.server_connection)
        if self.request.host.lower() not in self.server._allowed:
            raise HTTPError(403)

    def set_default_headers(self) -> None:
        self.set_header("Server", "trackslip")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.server._refused += 1
        self.finish(f"{status_code}\n")


@stream_request_body
class _Files(_Handler):
    """The page and what belongs to it."""

    def data_received(self, chunk: bytes) -> None:
        """A body is read by nobody."""

    def get(self, name: str) -> None:
        file = self.server._files.get(name)
        if file is None:
            raise HTTPError(404)
        self.set_header("Content-Security-Policy", _RULES.format(host=self.request.host.lower()))
        self.set_header("Content-Type", file.kind)
        self.set_header("Cache-Control", "no-cache")  # asked again, and answered 304 where it is the same
        self.write(file.content)

    head = get


class _Stream(_Handler, WebSocketHandler):
    """One page's stream."""

    def initialize(self, server: PageServer) -> None:
        super().initialize(server)
        self._sending: asyncio.Future[None] | None = None
        self._waiting: deque[str] = deque()
        self._missed = True  # the first frame it gets is whole

    def prepare(self) -> None:
        super().prepare()
        if len(self.server._pages) >= MOST_PAGES:
            raise HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        """Only pages that came from here."""
        return urlsplit(origin).netloc.lower() in self.server._allowed

    def open(self, *_: str) -> None:
        self.server._pages.add(self)
        self.set_nodelay(True)
        self.offer("")  # it gets the whole

    def on_message(self, message: str | bytes) -> None:
        """Nobody has anything to say here."""
        self.close(_CLOSED_BY_RULE)

    def on_close(self) -> None:
        self.server._pages.discard(self)

    def offer(self, text: str) -> None:
        """A frame; a page that has not taken many of those before it misses them, and then gets all again."""
        if len(self._waiting) >= _MOST_WAITING:
            self._waiting.clear()
            self._missed = True
        if not self._missed:
            self._waiting.append(text)
        if self._sending is None or self._sending.done():
            self._sending = asyncio.ensure_future(self._send())

    async def _send(self) -> None:
        """All that waits, as fast as the page takes it."""
        try:
            while text := self._next():
                await self.write_message(text)
        except (WebSocketClosedError, StreamClosedError):
            self.server._pages.discard(self)

    def _next(self) -> str:
        """What the page gets next; empty where there is nothing yet."""
        if self._missed:
            whole = self.server._whole()
            self._missed = not whole
            return _encoded(whole) if whole else ""
        return self._waiting.popleft() if self._waiting else ""
