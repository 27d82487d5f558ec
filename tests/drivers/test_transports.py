# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The read loop of links to ports and buses, on real ptys and sockets."""

import gc
import math
import socket
import termios
import threading
import time
from contextlib import ExitStack, suppress
from functools import partial

import can
import pytest
from fixtures.patience import PATIENCE, wait_for

from trackslip_drivers.transports.can_bus import CanBus
from trackslip_drivers.transports.link import Handlers, Link
from trackslip_drivers.transports.serial_port import SerialPort
from trackslip_sim.demo.run import free_udp_port
from trackslip_sim.devices.pty_port import PtyPort

IGNORED = Handlers(lambda *_: None, lambda: None)
UDP_PORT = free_udp_port()
GROUP = "239.74.163.2"


class Received:
    """Collects the data, stamps and openings that a link reports."""

    def __init__(self):
        self.data = []
        self.stamps = []
        self.openings = 0

    def on_data(self, data, arrival_ns):
        self.data.append(data)
        self.stamps.append(arrival_ns)

    def on_open(self):
        self.openings += 1


@pytest.fixture
def received():
    return Received()


@pytest.fixture
def start_link(received):
    links = []

    def start(open_port, silence_s=math.inf, on_data=None):
        link = Link("test", open_port, Handlers(on_data or received.on_data, received.on_open), silence_s)
        links.append(link)
        link.start()
        return link

    yield start
    for link in links:
        link.stop()
        link._thread.join(PATIENCE)  # the time-out of ``stop`` is shorter than a possible stall of the host
        assert not link._thread.is_alive()


def test_bytes_pass_a_pty_in_both_directions(pty_port, received, start_link):
    every_byte = bytes(range(256))
    link = start_link(partial(SerialPort, str(pty_port.link), 9600, "N"))
    wait_for(lambda: link.state().connected)
    before_ns = time.time_ns()
    assert pty_port.write(every_byte) == 256
    wait_for(lambda: len(b"".join(received.data)) == 256)
    assert b"".join(received.data) == every_byte
    assert before_ns <= received.stamps[0] <= time.time_ns()
    assert link.write(every_byte)
    received = bytearray()
    wait_for(lambda: received.extend(pty_port.read()) or len(received) >= 256)
    assert received == every_byte
    assert pty_port.read() == b""
    assert link.state().note == ""
    assert link.call_with_port(lambda port: port.set_baud(38400))
    assert pty_port.baud == 38400


def test_reconnects_when_the_device_comes_back(tmp_path, received, start_link):
    first = PtyPort(tmp_path / "device")
    link = start_link(partial(SerialPort, str(first.link), 9600, "N"))
    wait_for(lambda: link.state().connected)
    first.write(b"one")
    wait_for(lambda: b"".join(received.data) == b"one")
    first.close()
    wait_for(lambda: link.state().errors >= 2)  # the loss, and a failed opening
    assert not link.write(b"x")
    wait_for(lambda: link.state().last_error == "No such file or directory")
    second = PtyPort(tmp_path / "device")
    wait_for(lambda: link.state().openings == 2)
    second.write(b"two")
    wait_for(lambda: b"".join(received.data) == b"onetwo")
    assert received.openings == 2
    link.stop()
    second.close()


def test_socket_url(received, start_link):
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        link = start_link(partial(SerialPort, url, 9600, "E"))
        client, _ = server.accept()
        wait_for(lambda: received.openings == 1)  # opening discards earlier bytes
        client.sendall(b"x" * 10000)
        wait_for(lambda: sum(map(len, received.data)) == 10000)
        client.close()
        wait_for(lambda: link.state().errors >= 1)
        client, _ = server.accept()
        wait_for(lambda: received.openings == 2)
        client.sendall(b"again")
        wait_for(lambda: b"".join(received.data).endswith(b"again"))
        link.stop()
        client.close()


def test_silence_is_reported_only_after_an_empty_read(received, start_link):
    """Bytes that wait while the reader is busy are not a silence."""
    reads = [[(b"a", 1)], [(b"b", 2)], [], [(b"c", 3)], []]
    reported = []

    class Port(BrokenPort):
        def read(self):
            if not reads:
                raise self.error
            return reads.pop(0)

    link = Link(
        "test",
        lambda: Port(OSError("gone"), []),
        Handlers(received.on_data, received.on_open, lambda: reported.append(list(received.data))),
    )
    link.start()
    wait_for(lambda: link.state().errors >= 1)
    link.stop()
    assert reported == [[b"a", b"b"], [b"a", b"b", b"c"]]


def test_reason_of_a_locked_or_missing_port_does_not_repeat_its_name(pty_port, tmp_path, start_link):
    """The node prints the device and its port before this reason."""
    first = SerialPort(str(pty_port.link), 9600, "N")
    for place, reason in (
        (str(pty_port.link), "locked: another program has it open"),
        (str(tmp_path / "none"), "No such file or directory"),
        ("socket://127.0.0.1:1", "Connection refused"),
    ):
        link = start_link(partial(SerialPort, place, 9600, "N"))
        wait_for(partial(lambda one: one.state().errors, link))
        assert link.state().last_error == reason
    first.close()


class BrokenPort:
    """A port that raises the given error; every kind of error must lead to a new opening."""

    note = "broken"

    def __init__(self, error, closed):
        self.error = error
        self.closed = closed

    def read(self):
        raise self.error

    def write(self, data):
        raise self.error

    def close(self):
        self.closed.append(self)


def test_error_is_known_before_the_port_is_closed(start_link):
    links, errors = [], []

    class SlowPort(BrokenPort):
        def close(self):
            errors.append(links[0].state().last_error)

    opened = threading.Event()
    links.append(start_link(lambda: opened.wait() and SlowPort(OSError(5, "gone"), [])))
    opened.set()
    wait_for(lambda: errors)
    assert errors[0] == "gone"


@pytest.mark.parametrize(
    "error", [OSError(5, "gone"), termios.error(22, "bad"), can.CanOperationError("off")]
)
def test_any_error_closes_counts_and_reopens(start_link, error):
    closed = []
    link = start_link(partial(BrokenPort, error, closed))
    wait_for(lambda: link.state().errors >= 2)
    link.stop()
    state = link.state()
    assert state.openings == len(closed)
    assert state.openings - state.errors in (0, 1)  # may be stopped before the last error
    assert str(error.args[-1]) in state.last_error
    assert not state.connected


def test_callback_that_fails_does_not_end_the_link(pty_port, start_link):
    link = start_link(partial(SerialPort, str(pty_port.link), 9600, "N"), on_data=lambda *_: 1 / 0)
    wait_for(lambda: link.state().connected)
    pty_port.write(b"x")
    wait_for(lambda: link.state().openings == 2)
    assert link.state().last_error == "ZeroDivisionError: division by zero"


def test_pauses_double_up_to_half_a_second(start_link, monkeypatch):
    pauses = []

    def refuse():
        raise OSError("absent")

    link = Link("test", refuse, IGNORED)

    def wait(pause_s):
        pauses.append(pause_s)
        if len(pauses) == 7:
            link._stopping.set()
        return False

    monkeypatch.setattr(link._stopping, "wait", wait)
    link._run()
    assert pauses == pytest.approx([0.1, 0.2, 0.4, 0.5, 0.5, 0.5, 0.5])
    assert link.state().errors == 7


class SilentPort:
    note = ""

    def read(self):
        time.sleep(0.005)
        return ()

    def close(self):
        pass


def test_silent_port_is_reopened_without_a_pause(start_link, monkeypatch):
    """Data that arrive while the port is closed would be lost."""
    pauses = []
    link = start_link(SilentPort, silence_s=0.02)
    monkeypatch.setattr(link._stopping, "wait", pauses.append)
    wait_for(lambda: link.state().openings >= 5)
    assert pauses == []
    assert link.state().last_error == "nothing received for 0.02 s"


def test_stop_does_not_wait_for_an_opening_that_hangs():
    release = threading.Event()
    closed = []

    def hang():
        release.wait(PATIENCE)
        return BrokenPort(OSError(), closed)

    link = Link("test", hang, IGNORED)
    link.start()
    link.stop()
    assert link._thread.is_alive()  # ``stop`` returned although the opening still hangs
    release.set()
    link._thread.join(PATIENCE)
    assert not link._thread.is_alive()
    assert len(closed) == 1  # the port opened after ``stop`` is closed again


def test_frames_of_this_host_and_port_alone_are_received_over_udp_multicast(received, start_link):
    """Otherwise any host that reaches the UDP port of the emulated bus could send as the machine."""
    link = start_link(partial(CanBus, "udp_multicast", GROUP, {"port": UDP_PORT}))
    wait_for(lambda: link.state().connected)
    peer = CanBus("udp_multicast", GROUP, {"port": UDP_PORT})
    other = CanBus("udp_multicast", GROUP, {"port": free_udp_port()})
    before_ns = time.time_ns()
    other.write((1, b"not ours"))
    with ExitStack() as stack:
        strangers = []
        with suppress(can.CanError):  # no network here
            bus = can.Bus(GROUP, interface="udp_multicast", port=UDP_PORT)  # of the default interface
            strangers.append(stack.enter_context(bus))
        for n in range(200):
            for stranger in strangers:
                stranger.send(can.Message(arbitration_id=7, data=[n]))
            peer.write((0x0CFF1080, bytes([n] * 8)))
    wait_for(lambda: len(received.data) >= 200)
    assert received.data == [(0x0CFF1080, bytes([n] * 8)) for n in range(200)]
    assert received.stamps == sorted(received.stamps)
    assert before_ns - 1_000_000 <= received.stamps[0] <= time.time_ns()
    assert link.write((0x0CFF1180, b"12345678"))
    wait_for(lambda: any(frame == (0x0CFF1180, b"12345678") for frame, _ in peer.read()))
    peer.close()
    other.close()


def test_bus_that_cannot_be_opened_is_an_error_and_nothing_else(caplog):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", port := free_udp_port()))
        with pytest.raises(can.CanError):
            CanBus("udp_multicast", GROUP, {"port": port})
    gc.collect()
    assert caplog.messages == []


def test_gateway_that_refuses_the_connection_is_an_error_at_once_without_log_lines(caplog):
    """python-can tried again for 10 s without a pause, with 70 000 lines a second."""
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        with pytest.raises(ConnectionRefusedError):
            CanBus("socketcand", "can0", {"host": "127.0.0.1", "port": closed.getsockname()[1]})
    assert caplog.messages == []


def test_link_stops_while_its_port_keeps_receiving(received, start_link):
    class Flood(BrokenPort):
        def read(self):
            while True:
                time.sleep(0.001)
                yield b"x", 0

    start_link(lambda: Flood(OSError(), []))
    wait_for(lambda: received.data)
