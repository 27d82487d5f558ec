# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Serves the live page from its own thread: read-only files, and an outgoing stream of frames.

Each frame is encoded once, and all pages get the same text. A page that lags by seconds misses frames, and
then gets the whole state again; nothing waits for it. Requests are answered only under an allowed host name.
No script of another site can therefore read the page through a browser (DNS rebinding, other origins).
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
from trackslip_tools.live.page import ServedFile
from trackslip_tools.live.parameters import LiveParameters, open_sockets

_LOGGERS = ("tornado", "asyncio")
_LOG_PERIOD_S = 1.0
MOST_PAGES = 24  # served at the same time
_PING = 10  # s, interval of pings; a page without an answer is disconnected
_MOST_WAITING = 40  # frames: largest lag of a page, five seconds
_LARGEST_REQUEST = 4096  # bytes of a header or body
_CLOSED_BY_RULE = 1008  # close code of websockets: policy violation
_STOP_TIMEOUT_S = 10.0
# Content-Security-Policy: no external content, no inline scripts, no forms, no frames around it.
_CONTENT_POLICY = (
    "default-src 'none'; script-src 'self'; connect-src 'self' ws://{host}; img-src data:; "
    "style-src 'self' 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class ServerLog(logging.Handler):
    """Passes at most one line a second to ``log``; ``count`` counts all warnings and errors.

    Clients can cause thousands of log records a second.
    """

    def __init__(self, log: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(logging.WARNING)
        self.count = 0
        self._log, self._clock = log, clock
        self._next_s = -float("inf")

    def attach(self) -> None:
        """Start receiving log records."""
        for name in _LOGGERS:
            logging.getLogger(name).addHandler(self)

    def detach(self) -> None:
        """Stop receiving log records."""
        for name in _LOGGERS:
            logging.getLogger(name).removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Count a record, and log its first line and its cause."""
        self.count += 1
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + _LOG_PERIOD_S
        lines = record.getMessage().splitlines()[:1]
        if record.exc_info is not None and record.exc_info[0] is not None:
            lines += format_exception_only(record.exc_info[0], record.exc_info[1])[-1:]
        self._log(f"live page: {': '.join(line.strip() for line in lines)} ({self.count} such lines so far)")


class PageServer:
    """Serves from ``start`` to ``stop``; ``full_state`` returns the state for a new page, from any thread.

    ``log`` gets at most one line a second about errors of connections, from any thread.

    Raises:
        InputError: address, port or origins cannot be used.
    """

    def __init__(
        self,
        files: Mapping[str, ServedFile],
        full_state: Callable[[], dict[str, Any]],
        parameters: LiveParameters,
        log: Callable[[str], None] = lambda line: show(line, file=sys.stderr),
    ) -> None:
        parameters.allowed_hosts(parameters.port)  # check before sockets are opened
        self._sockets = open_sockets(parameters.host, parameters.port)
        self.port = int(self._sockets[0].getsockname()[1])
        self._allowed = parameters.allowed_hosts(self.port)
        self._full_state, self._files = full_state, files
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, name="page", daemon=True)
        self._pages: set[_StreamHandler] = set()
        self._log = ServerLog(log)
        self._refused = 0  # requests
        shared = {"server": self}
        application = Application(
            [(r"/stream", _StreamHandler, shared), (r"/(.*)", _FileHandler, shared)],
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
        """URL of the page."""
        return f"http://{sorted(self._allowed)[0]}/"

    @property
    def pages(self) -> int:
        """Number of connected pages."""
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
        """Start the thread of the server."""
        self._thread.start()

    def stop(self) -> None:
        """Close the port and all pages; call once."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_STOP_TIMEOUT_S)

    def push(self, frame: dict[str, Any]) -> None:
        """Send a frame to all pages; returns at once."""
        if self._pages:
            self._loop.call_soon_threadsafe(self._send, _encode_frame(frame))

    def _send(self, text: str) -> None:
        for page in list(self._pages):
            page.queue_frame(text)

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


def _encode_frame(frame: dict[str, Any]) -> str:
    return json.dumps(frame, separators=(",", ":"), allow_nan=False)


class _Handler(RequestHandler):
    """Answers requests under an allowed host name."""

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
class _FileHandler(_Handler):
    """The page and its files."""

    def data_received(self, chunk: bytes) -> None:
        """Ignore the body of a request."""

    def get(self, name: str) -> None:
        file = self.server._files.get(name)
        if file is None:
            raise HTTPError(404)
        self.set_header("Content-Security-Policy", _CONTENT_POLICY.format(host=self.request.host.lower()))
        self.set_header("Content-Type", file.kind)
        self.set_header("Cache-Control", "no-cache")  # browsers ask again, and get 304 if unchanged
        self.write(file.content)

    head = get


class _StreamHandler(_Handler, WebSocketHandler):
    """Stream of one page."""

    def initialize(self, server: PageServer) -> None:
        super().initialize(server)
        self._sending: asyncio.Future[None] | None = None
        self._waiting: deque[str] = deque()
        self._needs_state = True  # the first frame is the whole state

    def prepare(self) -> None:
        super().prepare()
        if len(self.server._pages) >= MOST_PAGES:
            raise HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        """Accept only pages from an allowed host."""
        return urlsplit(origin).netloc.lower() in self.server._allowed

    def open(self, *_: str) -> None:
        self.server._pages.add(self)
        self.set_nodelay(True)
        self.queue_frame("")  # sends the whole state

    def on_message(self, message: str | bytes) -> None:
        """Close the stream: pages may not send messages."""
        self.close(_CLOSED_BY_RULE)

    def on_close(self) -> None:
        self.server._pages.discard(self)

    def queue_frame(self, text: str) -> None:
        """Queue a frame; a page with a full queue loses its frames, and then gets the whole state again."""
        if len(self._waiting) >= _MOST_WAITING:
            self._waiting.clear()
            self._needs_state = True
        if not self._needs_state:
            self._waiting.append(text)
        if self._sending is None or self._sending.done():
            self._sending = asyncio.ensure_future(self._send())

    async def _send(self) -> None:
        """Send the queue as fast as the page receives it."""
        try:
            while text := self._next_text():
                await self.write_message(text)
        except (WebSocketClosedError, StreamClosedError):
            self.server._pages.discard(self)

    def _next_text(self) -> str:
        """The next text to send; empty if there is none."""
        if self._needs_state:
            state = self.server._full_state()
            self._needs_state = not state
            return _encode_frame(state) if state else ""
        return self._waiting.popleft() if self._waiting else ""
