# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page's server: permitted clients, its answers, no effect of received data, and many connections.

Clients send half a request, nothing, or garbage, and stay connected.
"""

import asyncio
import http.client
import json
import logging
import os
import resource
import socket
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fixtures.patience import PATIENCE, wait_for
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from trackslip_common.errors import InputError
from trackslip_tools.live import connections
from trackslip_tools.live.connections import MAX_CONNECTIONS
from trackslip_tools.live.page import ServedFile
from trackslip_tools.live.parameters import LiveParameters
from trackslip_tools.live.server import MOST_PAGES, PageServer, ServerLog

Connect = Callable[..., socket.socket]
HALF = b"GET / HTTP/1.1\r\nHost: 127.0.0.1"
LARGE = 10_000_000  # bytes, more than the buffers of a socket
FILES = {
    "": ServedFile("text/html; charset=utf-8", b"<p>page</p>"),
    "live.js": ServedFile("text/javascript", b"1"),
    "large": ServedFile("text/plain", b"x" * LARGE),
}
LOCAL = LiveParameters(host="127.0.0.1", port=0, origins=())


@pytest.fixture
def full_state() -> dict[str, Any]:
    return {"run": "a", "number": 0}


@pytest.fixture
def logged() -> list[str]:
    return []


@pytest.fixture
def serve(full_state: dict[str, Any], logged: list[str]) -> Iterator[Callable[[], PageServer]]:
    """A function that starts a server."""
    with ExitStack() as running:

        def start() -> PageServer:
            server = PageServer(FILES, lambda: full_state, LOCAL, logged.append)
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


def ask(
    server: PageServer, method: str, path: str, host: str = "", body: bytes = b""
) -> tuple[int, str, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    connection.request(method, path, body=body or None, headers={"Host": host or f"127.0.0.1:{server.port}"})
    answer = connection.getresponse()
    content = (answer.status, answer.getheader("Content-Security-Policy") or "", answer.read())
    connection.close()
    return content


def run_conversation(conversation: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(conversation(), PATIENCE))


async def connected(server: PageServer, **headers: str) -> WebSocketClientConnection:
    request = HTTPRequest(f"ws://127.0.0.1:{server.port}/stream", headers=headers)
    return await websocket_connect(request)


def test_files_have_a_policy_that_allows_no_other_script(server: PageServer) -> None:
    status, rules, content = ask(server, "GET", "/")
    assert (status, content) == (200, b"<p>page</p>")
    assert "default-src 'none'" in rules
    assert "script-src 'self';" in rules


@pytest.mark.parametrize("path", ["/../../etc/passwd", "/live.py", "/%2e%2e/setup.py", "//", "/stream"])
def test_other_paths_are_not_found(server: PageServer, path: str) -> None:
    assert ask(server, "GET", path)[0] in (400, 404)


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_requests_other_than_get_are_refused(server: PageServer, method: str) -> None:
    assert ask(server, method, "/", body=b"{}")[0] == 405


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1", "127.0.0.1:1", "["])
def test_only_names_that_are_allowed_get_an_answer(server: PageServer, host: str) -> None:
    assert ask(server, "GET", "/", host)[0] == 403
    assert ask(server, "GET", "/", f"localhost:{server.port}")[0] == 200


def test_page_gets_the_whole_state_first_and_then_changes(server: PageServer) -> None:
    async def conversation() -> None:
        page = await connected(server, Origin=f"http://127.0.0.1:{server.port}")
        assert json.loads(await page.read_message()) == {"run": "a", "number": 0}
        server.push({"number": 1})
        assert json.loads(await page.read_message()) == {"number": 1}
        page.close()

    run_conversation(conversation)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1", "file://"])
def test_page_of_another_origin_gets_no_stream(server: PageServer, origin: str) -> None:
    async def conversation() -> None:
        with pytest.raises(HTTPClientError, match="403"):
            await connected(server, Origin=origin)

    run_conversation(conversation)


@pytest.mark.parametrize("word", ['{"command": "stop"}', "x", b"\x00" * 100])
def test_a_viewer_that_sends_is_disconnected(server: PageServer, word: str | bytes) -> None:
    async def conversation() -> None:
        page = await connected(server)
        await page.read_message()
        await page.write_message(word, binary=isinstance(word, bytes))
        assert await page.read_message() is None
        assert page.close_code == 1008

    run_conversation(conversation)


def test_page_that_does_not_read_gets_the_whole_state_later(
    server: PageServer, full_state: dict[str, Any]
) -> None:
    async def conversation() -> None:
        lazy = await connected(server)
        ballast = "x" * 1_000_000
        for number in range(1, 101):
            full_state["number"] = number
            server.push({"number": number, "ballast": ballast})
        deadline = time.monotonic() + PATIENCE
        received = []
        while not received or received[-1].get("number") != 100:
            assert time.monotonic() < deadline
            received.append(json.loads(await lazy.read_message()))
            server.push({"number": 100})
        assert len(received) < 60
        assert received[-1].get("run") == "a" or any("run" in one for one in received[1:])
        lazy.close()

    run_conversation(conversation)


def test_number_of_pages_is_limited(server: PageServer) -> None:
    async def conversation() -> None:
        pages = [await connected(server) for _ in range(MOST_PAGES)]
        with pytest.raises(HTTPClientError, match="503"):
            await connected(server)
        pages[0].close()
        while server.pages == MOST_PAGES:
            await asyncio.sleep(0.01)
        await connected(server)

    run_conversation(conversation)


def test_a_taken_port_is_refused_in_one_line(server: PageServer) -> None:
    with pytest.raises(InputError, match=rf"port {server.port} .*accepted: "):
        PageServer(FILES, dict, LiveParameters(host="127.0.0.1", port=server.port, origins=()))


@pytest.mark.parametrize("host", ["0.0.0.0", "::", ""])
def test_wildcard_address_requires_an_origin(host: str) -> None:
    with pytest.raises(InputError, match="origin"):
        PageServer(FILES, dict, LiveParameters(host=host, port=0, origins=()))
    p = LiveParameters(host=host, port=0, origins=("Digger.local", "192.168.4.1:80", "[fe80::1]"))
    assert p.allowed_hosts(5006) == {"digger.local:5006", "192.168.4.1:80", "[fe80::1]:5006"}


@pytest.mark.parametrize("origin", ["http://digger.local", "*", "digger.local/", "a b", "user@host"])
def test_malformed_origin_is_refused(origin: str) -> None:
    with pytest.raises(InputError, match="accepted"):
        LiveParameters(host="127.0.0.1", port=0, origins=(origin,)).allowed_hosts(1)


def test_specific_address_is_its_own_origin() -> None:
    assert LiveParameters(host="192.168.4.1", port=0, origins=()).allowed_hosts(80) == {"192.168.4.1:80"}
    assert LiveParameters(host="::1", port=0, origins=()).allowed_hosts(80) == {"[::1]:80"}


# Connections


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
            assert ask(server, "GET", "/")[0] == 200
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
    assert ask(server, "GET", "/")[0] == 200
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
