# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The live page's server: permitted clients, its answers, and no effect of received data."""

import asyncio
import http.client
import json
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from fixtures.patience import PATIENCE
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from trackslip_common.errors import InputError
from trackslip_tools.live.page import ServedFile
from trackslip_tools.live.parameters import LiveParameters
from trackslip_tools.live.server import MOST_PAGES, PageServer

FILES = {
    "": ServedFile("text/html; charset=utf-8", b"<p>page</p>"),
    "live.js": ServedFile("text/javascript", b"1"),
}
LOCAL = LiveParameters(host="127.0.0.1", port=0, origins=())


@pytest.fixture
def full_state() -> dict[str, Any]:
    return {"run": "a", "number": 0}


@pytest.fixture
def server(full_state: dict[str, Any]) -> Iterator[PageServer]:
    running = PageServer(FILES, lambda: full_state, LOCAL)
    running.start()
    yield running
    running.stop()


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
