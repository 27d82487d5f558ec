# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The emulated scanner answers each command as specified in the table of telegrams."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.driver_defaults import PLS
from numpy.typing import NDArray

from trackslip_common.tally import Tally
from trackslip_drivers.protocols import sick_commands as commands
from trackslip_drivers.protocols.sick_scan import Scan, decode_scan
from trackslip_drivers.protocols.sick_telegram import (
    FROM_SENSOR,
    TO_SENSOR,
    Control,
    Telegram,
    TelegramParser,
    make_telegram,
)
from trackslip_drivers.sick_parameters import SickParameters
from trackslip_sim.devices.sick_device import SickDevice, SickDeviceParameters

MS = 1_000_000
BOOT_NS = 500 * MS
START = SickDeviceParameters(boot_delay=BOOT_NS / 1e9, power_on_baud=9600)
OK, WRONG_PASSWORD, FAULT = b"\xa0\x00\x00", b"\xa0\x01\x00", b"\xa0\x02\x00"
INSTALL = commands.installation_mode(b"SICK_PLS")


def stairs(stamp_ns: int) -> NDArray[np.float64]:
    """(361,) ranges, m, one centimetre longer per ray."""
    return 1.0 + 0.01 * np.arange(361, dtype=np.float64)


class Terminal:
    """A host of a booted device; receives each answer in whole."""

    def __init__(self, parameters: SickParameters = PLS) -> None:
        self.now_ns = 0
        self.device = SickDevice(parameters, START, stairs, 0)
        self.parser = TelegramParser(FROM_SENSOR, 9600, parameters.bits_per_char, Tally(), "scan")
        self.greeting = self.wait(BOOT_NS + 50 * MS)

    def wait(self, duration_ns: int) -> list[bytes | Control]:
        self.now_ns += duration_ns
        events = self.parser.feed(self.device.step(self.now_ns), self.now_ns)
        return [event.payload if isinstance(event, Telegram) else event for event in events]

    def send(self, command: bytes, wait_ns: int = 60 * MS) -> list[bytes | Control]:
        self.device.receive(make_telegram(command, TO_SENSOR), self.now_ns, None)
        return self.wait(wait_ns)


def test_scanner_ignores_commands_while_booting_and_then_announces_itself() -> None:
    device = SickDevice(PLS, START, stairs, 0)
    device.receive(make_telegram(commands.STOP, TO_SENSOR), BOOT_NS - 1, None)
    assert device.bytes_ignored == 8
    assert device.step(BOOT_NS) == b""
    assert Terminal().greeting == [b"\x90PLS101-312\x00"]


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (commands.STOP, OK),
        (commands.STREAM_ALL, OK),
        (commands.STREAM_MINIMA, OK),
        (INSTALL, OK),
        (commands.installation_mode(b"SICK_LMS"), WRONG_PASSWORD),
        (commands.set_baud(38400), FAULT),
        (b"\x20\x77", FAULT),
        (commands.STATUS, b"\xb1\x25\x00"),
        (commands.ERRORS, b"\xb2\x00\x00\x00"),
        (commands.RESET, b"\x91\x00"),
        (b"\x77", b"\x92\x00"),
    ],
)
def test_each_command_has_its_reply(command: bytes, reply: bytes) -> None:
    assert Terminal().send(command) == [Control.ACK, reply]


def test_a_corrupt_command_is_not_acknowledged() -> None:
    terminal = Terminal()
    terminal.device.receive(make_telegram(commands.STOP, TO_SENSOR)[:-1] + b"\x00", terminal.now_ns, None)
    assert terminal.wait(60 * MS) == [Control.NAK]


def test_baud_rate_changes_once_the_reply_is_sent() -> None:
    terminal = Terminal()
    terminal.send(INSTALL)
    terminal.device.receive(make_telegram(commands.set_baud(38400), TO_SENSOR), terminal.now_ns, 9600)
    terminal.wait(20 * MS)
    assert terminal.device.baud == 9600
    assert terminal.wait(40 * MS) == [OK]
    assert terminal.device.baud == 38400


def test_scanner_ignores_commands_at_another_baud_rate() -> None:
    device = Terminal().device
    device.receive(make_telegram(commands.STOP, TO_SENSOR), BOOT_NS + 60 * MS, 38400)
    assert device.bytes_ignored == 8
    assert device.step(BOOT_NS + 200 * MS) == b""
    device.receive(make_telegram(commands.STOP, TO_SENSOR), BOOT_NS + 200 * MS, 9600)
    assert device.bytes_ignored == 8
    assert device.step(BOOT_NS + 300 * MS)[:1] == b"\x06"


def test_a_mode_change_closes_the_settings() -> None:
    terminal = Terminal()
    terminal.send(INSTALL)
    terminal.send(commands.STOP)
    assert terminal.send(commands.set_baud(19200)) == [Control.ACK, FAULT]


def test_an_lms_sets_its_rate_directly() -> None:
    lms = replace(PLS, model="lms", parity="N")
    assert Terminal(lms).send(commands.set_baud(19200)) == [Control.ACK, OK]


@pytest.mark.parametrize("command", [commands.REQUEST_VALUES_PLS, commands.REQUEST_VALUES_LMS])
def test_one_scan_on_request(command: bytes) -> None:
    terminal = Terminal()
    acknowledgement, scan = terminal.send(command, 1000 * MS)
    assert acknowledgement is Control.ACK
    assert isinstance(scan, bytes)
    decoded = decode_scan(Telegram(scan, 0, 0), PLS)
    assert isinstance(decoded, Scan)
    np.testing.assert_allclose(decoded.sample.ranges, stairs(0))
    assert terminal.wait(2000 * MS) == []
    assert terminal.device.scans_emitted == 1


def test_minima_of_each_degree() -> None:
    terminal = Terminal()
    terminal.send(commands.STREAM_MINIMA)
    (payload,) = terminal.wait(500 * MS)
    assert isinstance(payload, bytes)
    decoded = decode_scan(Telegram(payload, 0, 0), PLS)
    assert isinstance(decoded, Scan)
    np.testing.assert_allclose(decoded.sample.ranges, stairs(0)[:-1:2])


def test_scan_is_counted_when_its_last_byte_is_sent() -> None:
    terminal = Terminal()
    terminal.send(commands.STREAM_ALL)
    terminal.wait(839 * MS - 60 * MS)
    assert terminal.device.scans_emitted == 0
    terminal.wait(160 * MS)
    assert terminal.device.scans_emitted == len(terminal.device.stamps) == 1


def test_a_reset_is_a_new_start() -> None:
    terminal = Terminal()
    terminal.send(commands.STREAM_ALL)
    assert terminal.send(commands.RESET, 2000 * MS)[-2:] == [b"\x91\x00", b"\x90PLS101-312\x00"]
    assert terminal.wait(2000 * MS) == []


def test_the_status_byte_is_sent() -> None:
    terminal = Terminal()
    terminal.device.status = 0x80
    assert terminal.send(commands.STOP) == [Control.ACK, b"\xa0\x00\x80"]
