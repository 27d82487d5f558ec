# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page's server with clients that send half a request, nothing, or garbage, and stay connected."""

import http.client
import logging
import os
import resource
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from fixtures.patience import PATIENCE, wait_for

from trackslip_tools.live import connections
from trackslip_tools.live.connections import MAX_CONNECTIONS
from trackslip_tools.live.page import ServedFile
from trackslip_tools.live.parameters import LiveParameters
from trackslip_tools.live.server import PageServer, ServerLog

Connect = Callable[..., socket.socket]
HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1"
LARGE = 10_000_000  # bytes, more than the buffers of a socket
FILES = {"": ServedFile("text/html", b"<p>page</p>"), "large": ServedFile("text/plain", b"x" * LARGE)}


@pytest.fixture
def logged() -> list[str]:
    return []


@pytest.fixture
def serve(logged: list[str]) -> Iterator[Callable[[], PageServer]]:
    """A function that starts a server."""
    with ExitStack() as running:

        def start() -> PageServer:
            parameters = LiveParameters(host="127.0.0.1", port=0, origins=())
            server = PageServer(FILES, lambda: {"run": "a"}, parameters, logged.append)
            server.start()
            running.callback(server.stop)
            return server

        yield start


@pytest.fixture
def server(serve: Callable[[], PageServer], monkeypatch: pytest.MonkeyPatch) -> PageServer:
    """A server with long time-outs."""
    for name in ("HEADER_TIMEOUT_S", "_LIFE_S"):
        monkeypatch.setattr(connections, name, 10.0 * PATIENCE)
    return serve()


@pytest.fixture
def hasty(serve: Callable[[], PageServer], monkeypatch: pytest.MonkeyPatch) -> PageServer:
    """A server that waits 0.2 s for the rest of a request."""
    monkeypatch.setattr(connections, "HEADER_TIMEOUT_S", 0.2)
    return serve()


@pytest.fixture
def connect() -> Iterator[Connect]:
    """A function that connects to a server and sends some bytes."""
    with ExitStack() as opened:

        def open_connection(server: PageServer, sent: bytes = b"") -> socket.socket:
            client = socket.create_connection(("127.0.0.1", server.port), PATIENCE)
            opened.enter_context(client)
            client.sendall(sent)
            return client

        yield open_connection


def status(server: PageServer) -> int:
    """HTTP status of the page."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    connection.request("GET", "/")
    response = connection.getresponse()
    response.read()
    connection.close()
    return response.status


def is_closed(client: socket.socket) -> bool:
    """Wait until the server has closed the connection; True then."""
    try:
        while client.recv(4096):
            pass
    except ConnectionError:
        pass
    return True


def request_bytes(server: PageServer, path: str, **headers: str) -> bytes:
    lines = [f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{server.port}"]
    return "\r\n".join([*lines, *(f"{name}: {value}" for name, value in headers.items()), "", ""]).encode()


@pytest.mark.parametrize("sent", [b"", b"G", HALF, HALF + b"\r\nContent-Length: 9\r\n", b"\x16\x03\x01\x02"])
def test_half_sent_request_is_closed_after_header_timeout(
    sent: bytes, hasty: PageServer, connect: Connect
) -> None:
    assert is_closed(connect(hasty, sent))


def test_bytes_that_come_one_by_one_do_not_delay_the_header_timeout(
    hasty: PageServer, connect: Connect
) -> None:
    client = connect(hasty, HALF)
    client.setblocking(False)

    def is_over() -> bool:
        try:
            return client.send(b"1") < 0
        except ConnectionError:
            return True

    wait_for(is_over)


def test_half_sent_body_is_closed_after_its_timeout(hasty: PageServer, connect: Connect) -> None:
    body = request_bytes(hasty, "/", **{"Content-Length": "9"}).replace(b"GET", b"POST") + b"123"
    assert is_closed(connect(hasty, body))


def test_connection_with_an_unread_answer_is_closed(
    serve: Callable[[], PageServer], connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "_LIFE_S", 0.2)
    server = serve()
    connect(server, request_bytes(server, "/large"))
    wait_for(lambda: server.counts["connections"] == 1)
    wait_for(lambda: server.counts["connections"] == 0)


@pytest.mark.parametrize("path", ["", "/"], ids=["half-sent", "answered"])
def test_new_connections_replace_the_oldest(path: str, server: PageServer, connect: Connect) -> None:
    sent = request_bytes(server, path) if path else HALF
    clients = []
    for _ in range(MAX_CONNECTIONS + 40):
        clients.append(connect(server, sent))
        assert server.counts["connections"] <= MAX_CONNECTIONS
        if len(clients) % 20 == 0:
            assert status(server) == 200
    assert is_closed(clients[0])
    wait_for(lambda: server.counts["connections displaced"] >= 40)


def test_half_sent_requests_do_not_replace_whole_ones(server: PageServer, connect: Connect) -> None:
    good = connect(server, request_bytes(server, "/large"))
    start = good.recv(100)
    for _ in range(MAX_CONNECTIONS + 40):
        connect(server, HALF)
    received = len(start)
    while received < LARGE:
        received += len(good.recv(1_000_000))
    wait_for(lambda: server.counts["connections displaced"] >= 40)


def test_streams_of_pages_count_and_are_kept(server: PageServer, connect: Connect) -> None:
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    page = connect(server, request_bytes(server, "/stream", **upgrade, **key))
    wait_for(lambda: server.pages == 1)
    for _ in range(MAX_CONNECTIONS + 40):
        connect(server, HALF)
    wait_for(lambda: server.counts["connections"] == MAX_CONNECTIONS)
    assert server.pages == 1
    server.push({"number": 12345})
    seen = b""
    while b"12345" not in seen:
        seen += page.recv(4096)


@pytest.fixture
def scarce() -> Iterator[Callable[[int], None]]:
    """A function that leaves this process only so many free file descriptors."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    fillers: list[int] = []

    def leave(free: int) -> None:
        most = max(int(path.name) for path in Path("/proc/self/fd").iterdir()) + 100
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        try:
            while True:
                fillers.append(os.open(os.devnull, os.O_RDONLY))
        except OSError:
            release(free)

    def release(count: int) -> None:
        for _ in range(count):
            os.close(fillers.pop())

    yield leave
    release(len(fillers))
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_half_sent_requests_are_closed_when_descriptors_run_out(
    server: PageServer, connect: Connect, scarce: Callable[[int], None], logged: list[str]
) -> None:
    scarce(41)  # 20 at each end, and one for the valid client
    for _ in range(20):
        connect(server, HALF)
    wait_for(lambda: server.counts["connections"] == 20)
    assert status(server) == 200
    assert server.counts["connections displaced"] > 0
    assert logged == []


def test_accepting_pauses_when_descriptors_run_out(
    server: PageServer, connect: Connect, scarce: Callable[[int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []
    back_off = connections.BoundedServer._back_off

    def counted(self: connections.BoundedServer, listener: socket.socket) -> None:
        tried.append(listener)
        back_off(self, listener)

    monkeypatch.setattr(connections.BoundedServer, "_back_off", counted)
    monkeypatch.setattr(connections, "_BACK_OFF_S", PATIENCE)
    scarce(1)
    connect(server)
    wait_for(lambda: tried)
    time.sleep(0.3)
    assert len(tried) == 1


def test_server_logs_one_line_a_second(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="tornado")  # an import of distributed raises the level
    caplog.set_level(logging.WARNING, logger="tornado.general")
    now_s, lines = [0.0], list[str]()
    log = ServerLog(lines.append, lambda: now_s[0])
    log.attach()
    for k in range(400):
        now_s[0] = k / 100.0
        logging.getLogger("tornado.general").warning("rubbish from a stranger\nand more of it")
    log.detach()
    logging.getLogger("tornado.general").warning("no more of it")
    assert len(lines) == 4
    assert lines[-1] == "live page: rubbish from a stranger (301 such lines so far)"
    assert log.count == 400


def test_malformed_requests_are_refused_without_a_log_line(server: PageServer, logged: list[str]) -> None:
    forms = ("multipart/form-data", "application/x-www-form-urlencoded", "multipart/form-data; boundary=a")
    for kind in forms:
        for body in (b"\xff\xfe%%%", b"--a\r\n\r\n--a--"):
            connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
            headers = {"Host": f"127.0.0.1:{server.port}", "Content-Type": kind, "Cookie": "\xff=;"}
            connection.request("POST", "/?%ff=%ff", body=body, headers=headers)
            assert connection.getresponse().status == 405
            connection.close()
    assert server.counts["requests refused"] == 6
    assert logged == []
