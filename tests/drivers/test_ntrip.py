# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Corrections from a caster on loopback: whole messages arrive under any fault; no password is disclosed."""

import base64
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fixtures.ntrip_caster import OK, Caster, Serve, rtcm
from fixtures.patience import wait_for

from trackslip_common.config_files import load_parameters
from trackslip_common.errors import InputError
from trackslip_drivers.nmea_parameters import NmeaParameters, NtripParameters
from trackslip_drivers.transports import ntrip
from trackslip_drivers.transports.ntrip import Credentials, NtripClient, read_credentials

USER, PASSWORD = "crew7", "s3cret-Zq9"
GGA = b"$GNGGA,101530.20,4806.0,N,01136.0,E,4,18,0.6,500.0,M,20.0,M,1.0,0000*4B\r\n"
LINE_RATE = 11_520  # B/s


@pytest.fixture
def casters() -> Iterator[Callable[..., Caster]]:
    opened: list[Caster] = []

    def make(*behaviours: Serve) -> Caster:
        opened.append(Caster(*behaviours))
        return opened[-1]

    yield make
    for caster in opened:
        caster.close()


@pytest.fixture(autouse=True)
def _short_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ntrip, "STALL_S", 0.5)
    monkeypatch.setattr(ntrip, "_LONGEST_WAIT_S", 0.5)
    monkeypatch.setattr(ntrip, "FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(ntrip, "LONGEST_PAUSE_S", 0.2)


def parameters(port: int, **more: object) -> NtripParameters:
    values = {"ntrip.host": "127.0.0.1", "ntrip.port": port, "ntrip.mountpoint": "SITE1"}
    values |= {f"ntrip.{name}": value for name, value in more.items()}
    return load_parameters(NmeaParameters, "nmea_gnss", ("nmea_gnss.yaml",), values).ntrip


class Receiver:
    """A running client inside a ``with`` block, its received messages, and its faults."""

    def __init__(self, caster: Caster, gga: bytes | None = GGA, **more: object) -> None:
        self.messages: list[bytes] = []
        self.faults: list[str] = []
        p = parameters(caster.port, **more)
        self.client = NtripClient(
            p, Credentials(USER, PASSWORD), LINE_RATE, self.messages.append, lambda: gga
        )

    def __enter__(self) -> "Receiver":
        self.client.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.client.stop()

    def wait(self, until: Callable[[], bool]) -> None:
        """Wait up to half a minute for a condition, and record the client's faults."""
        end = time.monotonic() + 30.0
        while not until() and time.monotonic() < end:
            fault = self.client.state().fault
            if fault not in self.faults:
                self.faults.append(fault)
            time.sleep(0.01)
        assert until(), self.faults

    def wait_for_fault(self, words: str) -> None:
        self.wait(lambda: words in self.client.state().fault)


def streams(count: int, answer: bytes = OK) -> Serve:
    """A caster that sends ``count`` messages, then nothing until the client disconnects."""

    def serve(connection: socket.socket, _: bytes) -> None:
        connection.sendall(answer)
        for k in range(count):
            connection.sendall(rtcm(number=k))
            time.sleep(0.001)
        while connection.recv(4096):
            pass

    return serve


def replies(data: bytes) -> Serve:
    return lambda connection, _: connection.sendall(data)


def drips(begin: bytes, drop: bytes) -> Serve:
    """A caster that sends a drop every 0.1 s and never ends."""

    def serve(connection: socket.socket, _: bytes) -> None:
        connection.sendall(begin)
        while True:
            connection.sendall(drop)
            time.sleep(0.1)

    return serve


@pytest.mark.parametrize(
    "answer", [OK, *(b"ICY 200 OK\r\n" + more for more in (b"", b"\r\n", b"Server: old\r\n\r\n"))]
)
def test_whole_messages_arrive_in_order(casters: Callable[..., Caster], answer: bytes) -> None:
    caster = casters(streams(20, answer))
    with Receiver(caster) as receiver:
        receiver.wait(lambda: len(receiver.messages) == 20)
        assert receiver.messages == [rtcm(number=k) for k in range(20)]
        state = receiver.client.state()
        assert (state.fault, state.messages, state.left_out) == ("", 20, 0)
    request = caster.requests[0].decode()
    assert request.startswith("GET /SITE1 HTTP/1.1")
    assert f"Basic {base64.b64encode(f'{USER}:{PASSWORD}'.encode()).decode()}" in request
    assert f"Ntrip-GGA: {GGA.decode().strip()}" in request


def test_chunked_streams_are_read(casters: Callable[..., Caster]) -> None:
    def serve(connection: socket.socket, _: bytes) -> None:
        connection.sendall(OK[:-2] + b"Transfer-Encoding: chunked\r\n\r\n")
        for k in range(5):
            connection.sendall(b"%x\r\n%s\r\n" % (len(rtcm()), rtcm(number=k)))
        connection.recv(4096)

    with Receiver(casters(serve)) as receiver:
        receiver.wait(lambda: len(receiver.messages) == 5)
        assert receiver.messages == [rtcm(number=k) for k in range(5)]


def test_positions_go_back_to_the_caster(casters: Callable[..., Caster]) -> None:
    received: list[bytes] = []

    def serve(connection: socket.socket, _: bytes) -> None:
        connection.sendall(OK)
        while len(b"".join(received)) < 3 * len(GGA):
            connection.sendall(rtcm())
            connection.settimeout(0.05)
            try:
                received.append(connection.recv(4096))
            except TimeoutError:
                continue

    with Receiver(casters(serve, streams(0)), gga_interval=0.1) as receiver:
        receiver.wait(lambda: len(b"".join(received)) >= 3 * len(GGA))
    assert b"".join(received).startswith(3 * GGA)


def test_caster_is_not_asked_before_there_is_a_position_for_it(casters: Callable[..., Caster]) -> None:
    caster = casters(streams(1))
    with Receiver(caster, gga=None) as receiver:
        receiver.wait_for_fault("waiting for a fix")
        assert caster.requests == []
    with Receiver(caster, gga=None, gga_interval=0.0) as receiver:
        receiver.wait(lambda: len(receiver.messages) == 1)


def test_position_that_is_no_more_known_is_not_sent_again(casters: Callable[..., Caster]) -> None:
    caster = casters(replies(OK + rtcm()))
    with Receiver(caster) as receiver:
        receiver.wait(lambda: len(receiver.messages) == 1)
        receiver.client._gga = lambda: None
        receiver.wait_for_fault("waiting for a fix")
        requests = len(caster.requests)
        time.sleep(0.3)
        assert len(caster.requests) == requests


def test_caster_that_often_closes_is_soon_asked_again(
    casters: Callable[..., Caster], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ntrip, "LONGEST_PAUSE_S", 3600.0)

    def serve(connection: socket.socket, _: bytes) -> None:
        connection.sendall(OK + rtcm())
        time.sleep(0.15)

    with Receiver(casters(serve)) as receiver:
        receiver.wait(lambda: receiver.client.state().connections >= 14)


FAULTS: dict[str, tuple[Serve, str]] = {
    "stalls": (streams(0), "sends nothing for"),
    "drops": (replies(OK + rtcm()), "closed the connection"),
    "drops before it answers": (replies(b""), "closed the connection"),
    "garbage for an answer": (replies(b"\x00\xff garbage\r\n" * 50), "answers no HTTP"),
    "garbage for a stream": (replies(OK + bytes(range(256)) * 400), "sends no RTCM 3"),
    "refuses": (replies(b"HTTP/1.1 401 Unauthorized\r\n\r\n"), "refuses user or password (401)"),
    "no mountpoint": (replies(b"SOURCETABLE 200 OK\r\n\r\nSTR;OTHER;\r\n"), "has no such mountpoint"),
    "sourcetable": (
        replies(b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\nSTR;OTHER;\r\n"),
        "has no such mountpoint",
    ),
    "refuses in version 1": (replies(b"ICY 401 Unauthorized\r\n\r\n"), "refuses user or password"),
    "refuses in words": (replies(b"ERROR - Bad Password\r\n"), "refuses user or password"),
    "sourcetable as text": (
        replies(b"HTTP/1.0 200 OK\r\nContent-Type: text/plain\r\n\r\nSTR;OTHER;\r\nENDSOURCETABLE\r\n"),
        "has no such mountpoint",
    ),
    "redirects": (replies(b"HTTP/1.1 302 Found\r\nLocation: /\r\n\r\n"), "302; check ntrip.host"),
    "web page": (replies(b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html>"), "a web page; check"),
    "endless header": (drips(b"HTTP/1.1 200 OK\r\nX: ", b"x"), "does not complete its answer"),
    "endless delay": (drips(b"", b"HTTP/1.1 100 Continue\r\n\r\n"), "does not complete its answer"),
    "drips": (drips(OK, b"\0"), "sends no RTCM 3"),
    "ends in a chunk": (
        replies(OK[:-2] + b"Transfer-Encoding: chunked\r\n\r\nff\r\n" + rtcm()),
        "closed the connection",
    ),
    "fails": (replies(b"HTTP/1.1 503 Busy\r\n\r\n"), "answers 503"),
    "1 MB/s": (replies(OK + 2000 * rtcm(1000)), "sends more than"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_and_corrections_come_again_after_it(
    casters: Callable[..., Caster], name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    serve, words = FAULTS[name]
    is_named = threading.Event()
    caster = casters(
        lambda connection, request: (streams(30) if is_named.is_set() else serve)(connection, request)
    )
    with Receiver(caster) as receiver:
        receiver.wait_for_fault(words)
        is_named.set()
        receiver.wait(
            lambda: receiver.client.state().fault == "" and receiver.messages[-1:] == [rtcm(number=29)]
        )
        texts = " ".join([*receiver.faults, receiver.client.where, repr(vars(receiver.client))])
    out, err = capfd.readouterr()
    assert out + err == ""
    for secret in (PASSWORD, USER, base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()):
        assert secret not in texts


def test_caster_without_tls_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = int(server.getsockname()[1])
        p = parameters(port, tls=True)
        client = NtripClient(p, None, LINE_RATE, lambda _: None, lambda: GGA)
        client.start()
        with server.accept()[0] as connection:
            connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
            wait_for(lambda: "check ntrip.tls" in client.state().fault)
        client.stop()


def test_flood_reaches_the_receiver_no_faster_than_its_line(casters: Callable[..., Caster]) -> None:
    """A caster that then closes cannot be reached."""
    caster, began_s = casters(FAULTS["1 MB/s"][0], streams(0)), time.monotonic()
    with Receiver(caster) as receiver:
        receiver.wait_for_fault("sends more than")
        assert sum(map(len, receiver.messages)) < LINE_RATE * (1.0 + time.monotonic() - began_s)
        assert receiver.client.state().left_out > 0
    caster.close()
    with Receiver(caster) as receiver:
        receiver.wait_for_fault("not connected")


@pytest.mark.parametrize(
    ("content", "mode"),
    [(f"{USER}\n{PASSWORD}\n", 0o640), (f"{USER}\n", 0o600), ("", 0o600), (f"a:b\n{PASSWORD}\n", 0o600)],
)
def test_credentials_are_two_lines_of_a_file_that_only_its_owner_reads(
    tmp_path: Path, content: str, mode: int
) -> None:
    file = tmp_path / "ntrip"
    file.write_text(f"{USER}\n{PASSWORD}\n", encoding="utf-8")
    file.chmod(0o600)
    credentials = read_credentials(file)
    assert (credentials.user, credentials.password) == (USER, PASSWORD)
    assert PASSWORD not in f"{credentials} {credentials!r}"
    file.write_text(content, encoding="utf-8")
    file.chmod(mode)
    for path in (file, tmp_path / "missing"):
        with pytest.raises(InputError) as refused:
            read_credentials(path)
        assert PASSWORD not in str(refused.value)
        assert "\n" not in str(refused.value)


def test_caster_without_a_mountpoint_is_refused() -> None:
    with pytest.raises(InputError, match="mountpoint"):
        parameters(2101, mountpoint="a b")
