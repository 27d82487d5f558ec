# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""An exception in a driver's thread is counted and reported; the port stays open and data continue."""

import errno
import math
import os
import queue
import time
from collections.abc import Callable, Iterator
from enum import Enum

import pytest
from fixtures.heading_sentences import hdt
from fixtures.own_node import NoParameters, started
from fixtures.patience import wait_for

from trackslip_common.nodes.health import ERROR, WARN
from trackslip_drivers.nodes.driver import DriverNode
from trackslip_drivers.nodes.nmea_gnss import NmeaNode
from trackslip_drivers.nodes.sick_pls import SickNode
from trackslip_drivers.nodes.watson_imu import WatsonNode
from trackslip_drivers.protocols import watson
from trackslip_drivers.protocols.nmea_sentences import Position, gga, gst, rmc
from trackslip_drivers.protocols.sick_telegram import TelegramFault
from trackslip_drivers.stamping import StampEvent

DRIVE_NS = 12_000_000_000
Encoder = Callable[[Position], bytes]
POSITION = Position(0, -33.9, 151.2, 60.0, 4, 0.6, 0.01, 0.02, 120.0, 0.2, 1.0, 10.0)


class QueuePort:
    """A port that delivers the items of a queue."""

    note = ""

    def __init__(self) -> None:
        self.items: queue.Queue[bytes] = queue.Queue()

    def read(self):
        try:
            return [(self.items.get(timeout=0.05), time.time_ns())]
        except queue.Empty:
            return []

    def close(self) -> None:
        pass


class FragileDriver(DriverNode[NoParameters, bytes]):
    """A driver that fails on the bytes ``bad``."""

    def __init__(self) -> None:
        super().__init__("fragile_driver", NoParameters)
        self.port, self.begun, self.received = QueuePort(), 0, []

    def open_port(self):
        return self.port

    def restart_decoding(self) -> None:
        self.begun += 1

    def receive(self, data: bytes, steady_ns: int) -> None:
        if data == b"bad":
            raise ValueError("no such telegram")
        self.received.append(data)
        self.count_message()


@pytest.fixture
def driver(domain: int) -> Iterator[FragileDriver]:
    with started(FragileDriver, domain) as node:
        yield node


def test_driver_continues_after_an_exception_in_decoding_and_reports_it(driver):
    for data in (b"1", b"bad", b"2"):
        driver.port.items.put(data)
    wait_for(lambda: len(driver.received) >= 2)
    assert driver.received == [b"1", b"2"]
    assert driver.begun == 2  # at the opening, and after the failure to discard partial data
    assert driver._link.state().openings == 1
    (entry,) = driver.callback_failures.health()
    assert entry.level == ERROR
    assert "received data: ValueError: no such telegram (test_driver_failures.py:" in entry.message


def messages(driver: FragileDriver, seconds: float) -> list[str]:
    """Successive distinct messages of the driver's health."""
    texts = [""]
    give_up = time.monotonic() + seconds
    while time.monotonic() < give_up:
        (entry,) = driver.health()
        texts += [entry.message] * (entry.message != texts[-1])
        time.sleep(0.01)
    return texts[1:]


def test_reopened_silent_port_is_reported_as_silent(domain, monkeypatch):
    monkeypatch.setattr("trackslip_drivers.nodes.driver._OPENING_TIME", 0.1)
    monkeypatch.setattr(FragileDriver, "period", 0.02)
    monkeypatch.setattr(FragileDriver, "silence", 0.4)
    with started(FragileDriver, domain) as node:
        texts, where = messages(node, 1.5), node.link_name()
        assert node._link.state().openings > 1
    assert texts[-1] == f"{where}: no bytes; check power and port"
    assert sum("no data yet" in text for text in texts) == 1


def test_most_frequent_reason_is_reported_as_last_rejection(driver):
    """A scanner sends garbage; occasionally it answers at no rate."""
    driver.port.items.put(b"1")
    reasons = Enum("reasons", {"GARBAGE": "bytes between telegrams", "MUTE": "no answer at any rate"})
    for _ in range(3):
        driver.tally.add("scan", reasons.GARBAGE, 40)
        driver.tally.add("scan", reasons.MUTE)
        assert driver.health()[0].values["last rejected"] == "bytes between telegrams"


def test_remedy_is_that_of_the_reason(driver, monkeypatch):
    monkeypatch.setattr(FragileDriver, "remedies", {TelegramFault.BAD_CRC.value: "check the cable"})
    driver.port.items.put(b"1")
    wait_for(lambda: driver.received)
    driver.tally.add("scan", TelegramFault.BAD_CRC, detail="7 of 9")
    assert driver.health()[0].message == "running; some is rejected: 7 of 9; check the cable"
    driver._last_s = -math.inf
    assert driver.health()[0].message.endswith("none is usable: 7 of 9; check the cable")


@pytest.mark.parametrize(
    ("node", "reason"),
    [
        (NmeaNode, "no complete message"),  # of a scanner, or an inertial unit
        (WatsonNode, watson.Rejection.TEXT.value),  # of a receiver
        (WatsonNode, watson.Rejection.OVERLONG.value),  # of a scanner
        (SickNode, TelegramFault.GARBAGE.value),
    ],
)
def test_remedy_for_the_data_of_another_device_names_the_port(node, reason):
    """Ports change their numbers when a computer starts, or when devices are plugged in again."""
    assert "is on this port" in node.remedies.get(reason, node.format_advice)


def test_reason_of_unusable_data_is_a_recent_rejection(driver, monkeypatch):
    driver.port.items.put(b"1")
    wait_for(lambda: driver.received)
    driver.tally.add("scan", StampEvent.SHIFTED)
    assert driver.health()[0].message == f"running; scan: {StampEvent.SHIFTED.value}"
    driver._last_s = -math.inf
    assert "none is usable: no complete message;" in driver.health()[0].message
    driver.tally.add("scan", TelegramFault.BAD_CRC)
    assert "none is usable: bad CRC;" in driver.health()[0].message
    monkeypatch.setattr("trackslip_drivers.nodes.driver.REPORT_TIME", 0.0)
    assert "none is usable: no complete message;" in driver.health()[0].message


def test_device_slower_than_its_driver_expects_is_reported_as_slow(driver, monkeypatch):
    """A receiver at its factory's 1 Hz: it was running and without bytes by turns."""
    driver.port.items.put(b"1")
    wait_for(lambda: driver.received)
    driver.period, now_s = 0.1, time.monotonic()
    for age_s in (0.1, 0.9, 1.1):
        driver._intervals, driver._last_s = (1.0, 1.01), now_s - age_s
        monkeypatch.setattr(time, "monotonic", lambda: now_s)
        assert driver.health()[0].message.endswith("bytes come too seldom; " + driver.slow_advice)
    driver._intervals = (1.0, 0.1)  # after a gap
    driver._last_s = now_s - 0.1
    assert driver.health()[0].message == "running"
    driver._intervals, driver._last_s = (1.0, 1.01), now_s - 2.5
    assert "too seldom" not in driver.health()[0].message


def test_port_without_permission_names_the_group(driver):
    driver.link._note_error(PermissionError(errno.EACCES, os.strerror(errno.EACCES)))
    driver.link._set_port(None)
    assert driver.health()[0].message.endswith(
        "not connected (Permission denied); add this user to the group of the port (dialout)"
    )


def leave_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the receiver an empty line that affects no fed sentence."""
    monkeypatch.setattr(NmeaNode, "open_port", lambda _: QueuePort())
    monkeypatch.setattr(NmeaNode, "restart_decoding", lambda _: None)
    monkeypatch.setattr(NmeaNode, "on_silence", lambda *_: None)


@pytest.fixture
def receiver(domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[NmeaNode]:
    """The driver of a receiver on an empty line, whose thread does nothing between fed sentences."""
    leave_alone(monkeypatch)
    with started(NmeaNode, domain) as node:
        wait_for(lambda: node.link.state().openings)
        yield node


def drive_until_missing(node: NmeaNode, missing: Encoder, *others: Encoder) -> None:
    """Feed 12 s of sentences at 10 Hz; those of ``missing`` cease after 3 s."""
    begin_ns = time.monotonic_ns() - DRIVE_NS
    for elapsed_ns in range(0, DRIVE_NS, 100_000_000):
        at = POSITION._replace(time_ns=3_600_000_000_000 + elapsed_ns)
        present = others if elapsed_ns > 3_000_000_000 else (missing, *others)
        node.receive(b"".join(encode(at) for encode in present), begin_ns + elapsed_ns)


def test_stamps_of_a_host_that_is_not_on_utc_are_no_rejections(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All fixes are used, and a wrong checksum among them is the reason that counts."""
    leave_alone(monkeypatch)
    with started(NmeaNode, domain, host_clock_is_utc=True) as node:
        wait_for(lambda: node.link.state().openings)
        now_ns = time.monotonic_ns()
        late = POSITION._replace(time_ns=(time.time_ns() - 3_600_000_000_000) % 86_400_000_000_000)
        node.receive(gga(late), now_ns)
        event = "running; receiver's clock: not the host's UTC: latency assumed; keep this computer on UTC"
        assert node.health()[0].message.startswith(event)
        node.receive(gga(late)[:-4] + b"\r\n", now_ns + 100_000_000)
        assert node.health()[0].message.startswith("running; some is rejected: ")


def test_receiver_that_sends_no_position_any_more_is_distinguished_from_a_wrong_rate(
    receiver: NmeaNode,
) -> None:
    drive_until_missing(receiver, gga, rmc, hdt)
    assert "(HDT, RMC), but no GGA" in receiver.unusable_data_message()


@pytest.mark.parametrize(
    ("missing", "others", "words"),
    [
        (hdt, (gga, rmc), "; no heading any more; check the second antenna"),
        (rmc, (gga, hdt), "; no fix_velocity any more; check"),
        (gst, (gga, rmc), "; fix has no accuracy of the receiver any more, but HDOP times range_errors; "),
    ],
)
def test_heading_velocity_or_accuracy_that_ceases_while_fixes_come_is_a_warning(
    receiver: NmeaNode, missing: Encoder, others: tuple[Encoder, ...], words: str
) -> None:
    """A receiver that lost its second antenna left the driver running without a word."""
    drive_until_missing(receiver, missing, *others)
    (health, *_) = receiver.health()
    assert (health.level, words in health.message) == (WARN, True)
