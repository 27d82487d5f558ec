# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Tornado's HTTP server with a limit on all connections, so that attackers cannot lock out a regular client.

At the limit, a new connection displaces the oldest one of the larger group: connections without a complete
request, or connections with one. A regular client sends its request at once and is answered before its turn
to be displaced comes.
"""

import asyncio
import resource
import socket
from collections.abc import Callable, Iterable
from typing import Any

from tornado.http1connection import HTTP1ServerConnection
from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream

MAX_CONNECTIONS = 96  # connections: 24 pages, and six more for each of a dozen browsers that load the page
HEADER_TIMEOUT_S = 5.0  # for the whole header of a request, and the same for the body
_LIFE_S = 60.0  # lifetime of a connection without a stream: 1 MB over a weak link
_MIN_CONNECTIONS = 16  # lower bound of the limit when descriptors are scarce: connections of two browsers
_MAX_ACCEPTS = 16  # connections accepted before requests on open ones are read
_BACK_OFF_S = 0.1
_READ_BUFFER = 32_768  # bytes per connection


class BoundedServer(HTTPServer):
    """Serves at most ``max_connections`` connections at a time; new ones displace old ones."""

    def initialize(self, *args: Any, **options: Any) -> None:
        """As ``HTTPServer``, with ``streams``: number of connections that became streams of pages."""
        self._streams: Callable[[], int] = options.pop("streams")
        options |= dict.fromkeys(("idle_connection_timeout", "body_timeout"), HEADER_TIMEOUT_S)
        super().initialize(*args, **options)
        descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        share = descriptors // 2 if descriptors > 0 else MAX_CONNECTIONS  # some are left for the node
        self.max_connections = min(MAX_CONNECTIONS, share)
        self.displaced = 0  # connections closed in favour of newer ones
        self._waiting: dict[IOStream, asyncio.TimerHandle] = {}  # without a complete request; oldest first
        self._requested: dict[IOStream, asyncio.TimerHandle] = {}  # with a request; oldest first
        self._listeners: list[socket.socket] = []

    @property
    def connections(self) -> int:
        """Number of open connections, including streams."""
        return len(self._waiting) + len(self._requested) + self._streams()

    def listen_on(self, listeners: Iterable[socket.socket]) -> None:
        """Accept connections on listening sockets, until ``stop`` closes them."""
        for listener in listeners:
            self._listeners.append(listener)
            self._watch_listener(listener)

    def stop(self) -> None:
        """Stop accepting connections."""
        for listener in self._listeners:
            asyncio.get_event_loop().remove_reader(listener)
            listener.close()
        self._listeners.clear()

    def note_request(self, server_conn: object) -> None:
        """Mark a connection as one with a complete request."""
        assert isinstance(server_conn, HTTP1ServerConnection)
        if server_conn.stream in self._waiting:
            self._requested[server_conn.stream] = self._waiting.pop(server_conn.stream)

    def handle_stream(self, stream: IOStream, address: Any) -> None:
        """Serve a new connection."""
        self._waiting[stream] = asyncio.get_event_loop().call_later(_LIFE_S, stream.close)
        super().handle_stream(stream, address)

    def on_close(self, server_conn: object) -> None:
        """Forget a connection that was closed, or that became a stream."""
        assert isinstance(server_conn, HTTP1ServerConnection)
        self._forget_stream(server_conn.stream)
        super().on_close(server_conn)

    def _watch_listener(self, listener: socket.socket) -> None:
        if listener in self._listeners:
            asyncio.get_event_loop().add_reader(listener, self._accept_connections, listener)

    def _accept_connections(self, listener: socket.socket) -> None:
        for _ in range(_MAX_ACCEPTS):
            try:
                connection, address = listener.accept()
            except BlockingIOError:
                return
            except OSError:  # usually out of descriptors
                self._back_off(listener)
                return
            self._displace_oldest(self.max_connections - 1)
            self.handle_stream(IOStream(connection, max_buffer_size=_READ_BUFFER), address)

    def _back_off(self, listener: socket.socket) -> None:
        """Lower the limit of connections, and accept again a little later."""
        self.max_connections = max(_MIN_CONNECTIONS, self.connections * 3 // 4)
        self._displace_oldest(self.max_connections - 1)
        loop = asyncio.get_event_loop()
        loop.remove_reader(listener)
        loop.call_later(_BACK_OFF_S, self._watch_listener, listener)

    def _displace_oldest(self, most: int) -> None:
        """Close the oldest connections until at most ``most`` are open, or only streams are left."""
        while self.connections > most and (self._waiting or self._requested):
            larger = self._waiting if len(self._waiting) >= len(self._requested) else self._requested
            stream = next(iter(larger))
            self._forget_stream(stream)
            stream.close()
            self.displaced += 1

    def _forget_stream(self, stream: IOStream) -> None:
        for group in (self._waiting, self._requested):
            if stream in group:
                group.pop(stream).cancel()
