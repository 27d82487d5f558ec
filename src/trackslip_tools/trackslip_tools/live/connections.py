# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tornado's HTTP server with one limit for all connections, so that strangers cannot keep a good client out.

Where the limit is reached, a new connection takes the place of the oldest one of a group: of those that have
not sent a whole request, or of those that have, whichever are more. A good client sends its request at once,
and is answered before its turn to be closed comes.
"""

import asyncio
import resource
import socket
from collections.abc import Callable, Iterable
from typing import Any

from tornado.http1connection import HTTP1ServerConnection
from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream

MOST = 96  # connections: 24 pages, and six more that each of a dozen browsers opens while it loads
HEADER_TIMEOUT_S = 5.0  # for the whole header of a request, and again for the body
_LIFE_S = 60.0  # of a connection that is no page's stream: 1 MB over a weak link
_FEWEST = 16  # to which the limit falls where descriptors are scarce: what two browsers open
_IN_A_ROW = 16  # connections accepted before the requests of those that are open are read
_BACK_OFF_S = 0.1
_READ_BUFFER = 32_768  # bytes of a connection


class BoundedServer(HTTPServer):
    """Serves ``most`` connections at a time, of which old ones give way to new ones."""

    def initialize(self, *args: Any, **options: Any) -> None:
        """As ``HTTPServer``; also ``streams``: how many connections have become streams of pages."""
        self._streams: Callable[[], int] = options.pop("streams")
        options |= dict.fromkeys(("idle_connection_timeout", "body_timeout"), HEADER_TIMEOUT_S)
        super().initialize(*args, **options)
        descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        self.most = min(MOST, descriptors // 2) if descriptors > 0 else MOST  # the node needs some, too
        self.displaced = 0  # connections closed in favour of newer ones
        self._waiting: dict[IOStream, asyncio.TimerHandle] = {}  # for a request; oldest first
        self._asked: dict[IOStream, asyncio.TimerHandle] = {}  # have sent one; oldest first
        self._listeners: list[socket.socket] = []

    @property
    def connections(self) -> int:
        """How many are open, streams included."""
        return len(self._waiting) + len(self._asked) + self._streams()

    def listen_on(self, listeners: Iterable[socket.socket]) -> None:
        """Accept connections of listening sockets, which ``stop`` closes."""
        for listener in listeners:
            self._listeners.append(listener)
            self._watch(listener)

    def stop(self) -> None:
        """Accept no more connections."""
        for listener in self._listeners:
            asyncio.get_event_loop().remove_reader(listener)
            listener.close()
        self._listeners.clear()

    def note_request(self, server_conn: object) -> None:
        """Count a connection to those that have sent a whole request."""
        assert isinstance(server_conn, HTTP1ServerConnection)
        if server_conn.stream in self._waiting:
            self._asked[server_conn.stream] = self._waiting.pop(server_conn.stream)

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """Serve a new connection."""
        self._waiting[stream] = asyncio.get_event_loop().call_later(_LIFE_S, stream.close)
        super().handle_stream(stream, address)

    def on_close(self, server_conn: object) -> None:
        """A connection has closed, or become the stream of a page."""
        assert isinstance(server_conn, HTTP1ServerConnection)
        self._forget(server_conn.stream)
        super().on_close(server_conn)

    def _watch(self, listener: socket.socket) -> None:
        if listener in self._listeners:
            asyncio.get_event_loop().add_reader(listener, self._accept, listener)

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(_IN_A_ROW):
            try:
                connection, address = listener.accept()
            except BlockingIOError:
                return
            except OSError:  # no descriptor is left, most often
                self._back_off(listener)
                return
            self._displace(self.most - 1)
            self.handle_stream(IOStream(connection, max_buffer_size=_READ_BUFFER), address)

    def _back_off(self, listener: socket.socket) -> None:
        """Go on a little later, with fewer connections."""
        self.most = max(_FEWEST, self.connections * 3 // 4)
        self._displace(self.most - 1)
        loop = asyncio.get_event_loop()
        loop.remove_reader(listener)
        loop.call_later(_BACK_OFF_S, self._watch, listener)

    def _displace(self, most: int) -> None:
        """Close the oldest connections until no more than ``most`` are open, or nothing but streams are."""
        while self.connections > most and (self._waiting or self._asked):
            larger = self._waiting if len(self._waiting) >= len(self._asked) else self._asked
            stream = next(iter(larger))
            self._forget(stream)
            stream.close()
            self.displaced += 1

    def _forget(self, stream: IOStream) -> None:
        for kept in (self._waiting, self._asked):
            if stream in kept:
                kept.pop(stream).cancel()
