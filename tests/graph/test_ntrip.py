# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Corrections live: from a caster on loopback through nmea_gnss to a receiver on a serial line."""

import base64
import os
import pty
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from fixtures.ntrip_caster import OK, Caster, rtcm
from fixtures.observer import last_of, last_values
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters, ListParameters

from trackslip_bags.reader import open_bag
from trackslip_drivers.protocols.nmea_sentences import Position, gga, gst

pytestmark = pytest.mark.xdist_group("graph")

USER, PASSWORD = "crew7x", "s3cret-Zq9"
SECRETS = (USER, PASSWORD, base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode())
LATITUDE, LONGITUDE = 48.137, 11.575
PERIOD_S = 0.1


class Receiver:
    """A receiver on a pseudo-terminal: sends epochs and stores the bytes written to it."""

    def __init__(self) -> None:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self.received = b""
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._ends.is_set():
            ready, _, _ = select.select([self._master], [], [], max(due_s - time.monotonic(), 0.0))
            if ready:
                self.received += os.read(self._master, 4096)
            if time.monotonic() >= due_s:
                at = Position(time.time_ns(), LATITUDE, LONGITUDE, 520.0, 4, 0.6, 0.01, 0.02, 90.0, 0.0)
                os.write(self._master, gga(at) + gst(at))
                due_s += PERIOD_S

    def close(self) -> None:
        self._ends.set()
        self._thread.join()


class Station:
    """The caster: refuses at first; later streams and stores the received positions."""

    def __init__(self) -> None:
        self.positions = b""
        self.sent = 0
        self.refuses = threading.Event()
        self.refuses.set()

    def serve(self, connection: socket.socket, _: bytes) -> None:
        if self.refuses.is_set():
            connection.sendall(b'HTTP/1.1 401 Unauthorized\r\nWWW-Authenticate: Basic realm=""\r\n\r\n')
            return
        connection.sendall(OK)
        connection.settimeout(PERIOD_S)
        while True:
            connection.sendall(rtcm(number=self.sent))
            self.sent += 1
            try:
                data = connection.recv(4096)
            except TimeoutError:
                continue
            if not data:
                return
            self.positions += data


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    one = Receiver()
    yield one
    one.close()


@pytest.fixture
def station() -> Station:
    return Station()


@pytest.fixture
def caster(station: Station) -> Iterator[Caster]:
    one = Caster(station.serve)
    yield one
    one.close()


def parameters_of(observer: Any, node: str) -> str:
    """All parameters of a node with their values, as text."""
    names = observer.ask(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
    return str(observer.ask(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names)))


def test_corrections_reach_the_receiver_and_no_credential_leaves_its_file(
    programs: Any, observer: Any, receiver: Receiver, station: Station, caster: Caster
) -> None:
    file = programs.folder / "credentials"
    file.write_text(f"{USER}\n{PASSWORD}\n", encoding="utf-8")
    file.chmod(0o600)
    fixes, healths, logs = observer.subscribe("fix"), observer.healths(), []
    observer.node.create_subscription(Log, "/rosout", lambda message: logs.append(message.msg), 1000)
    recorder = programs.node("record", output=str(programs.folder / "bag"))
    node = programs.node(
        "nmea_gnss",
        "--log-level",
        "nmea_gnss:=debug",
        serial_port=receiver.port,
        ntrip__host="127.0.0.1",
        ntrip__port=caster.port,
        ntrip__mountpoint="SITE1",
        ntrip__credentials_file=str(file),
        ntrip__gga_interval=0.5,
    )

    def reports(words: str) -> Callable[[], bool]:
        return lambda: words in getattr(last_of(healths, "nmea_gnss: corrections"), "message", "")

    observer.wait(reports("refuses user or password (401)"), "the refusal")
    observer.wait(lambda: len(fixes) > 10, "fixes without corrections")
    observer.wait(lambda: len(caster.requests) > 2, "the caster to be asked again")
    lines = [line for line in node.stderr.splitlines() if "refuses user or password" in line]
    assert len(lines) == 1
    assert f"127.0.0.1:{caster.port}, mountpoint SITE1" in lines[0]
    station.refuses.clear()
    observer.wait(reports("corrections come"), "corrections")
    observer.wait(lambda: receiver.received.count(rtcm()[:3]) > 20, "corrections at the receiver")
    observer.wait(lambda: station.positions.count(b"GGA,") > 3, "positions at the caster")
    first = int.from_bytes(receiver.received[3:5], "big")
    whole = b"".join(rtcm(number=first + k) for k in range(20))
    assert receiver.received.startswith(whole)
    assert b"4808.22" in station.positions
    values = last_values(healths, "nmea_gnss: corrections")
    assert float(values["age of corrections (s)"]) < 10.0
    assert int(values["left out"]) == 0
    assert fixes[-1].latitude == pytest.approx(LATITUDE)
    texts = [*logs, *map(str, healths), parameters_of(observer, "nmea_gnss")]
    assert node.end()[0] == 0
    assert recorder.end()[0] == 0
    texts += [node.stdout, node.stderr, recorder.stdout, recorder.stderr]
    with open_bag(programs.folder / "bag") as bag:
        recorded = {message.topic: message.raw for message in bag.messages()}
        raw = b"".join(message.raw for message in bag.messages())
    assert "/fix" in recorded
    others = [f for f in programs.folder.rglob("*") if f.is_file() and f != file]
    raw += b"".join(f.read_bytes() for f in others)
    for secret in SECRETS:
        assert secret not in "".join(texts)
        assert secret.encode() not in raw
