# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The serial port class on real ptys."""

import termios
import time

import pytest
import serial

from trackslip_drivers.transports.serial_port import SerialPort


@pytest.mark.parametrize("attempt", [0, 1])
def test_parity_on_a_pty_falls_back_with_a_note(pty_port, attempt):
    for _ in range(attempt):  # the kernel ignores the first attempt and refuses those after it
        SerialPort(str(pty_port.link), 9600, "N").close()
    port = SerialPort(str(pty_port.link), 9600, "E")
    assert "opened without parity E" in port.note
    assert pty_port.baud == 9600
    port.set_baud(500000)
    assert pty_port.baud == 500000
    pty_port.write(b"abc")
    assert port.read()[0][0] == b"abc"
    port.close()


def test_other_terminal_errors_are_not_swallowed(monkeypatch):
    def refuse(*_, **__):
        raise termios.error(22, "Invalid argument")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(termios.error):
        SerialPort("anything", 9600, "N")


def test_bytes_that_arrive_in_drips_are_read_at_once(pty_port, monkeypatch):
    port, sleep = SerialPort(str(pty_port.link), 9600, "N"), time.sleep

    def drip(duration):
        pty_port.write(b"def")
        sleep(duration + 0.1)  # the kernel delivers the bytes with a delay

    monkeypatch.setattr(time, "sleep", drip)
    pty_port.write(b"abc")
    ((data, _),) = port.read()
    assert data == b"abcdef"
    port.close()


def test_pty_counts_unread_bytes(pty_port):
    sent = 300_000
    accepted = pty_port.write(bytes(sent))
    assert 0 < accepted < sent
    assert pty_port.bytes_lost == sent - accepted
    port = SerialPort(str(pty_port.link), 9600, "N")  # opening discards earlier bytes
    assert port.read() == []
    pty_port.write(b"new")
    assert port.read()[0][0] == b"new"
    port.close()


def test_port_in_use_is_locked(pty_port):
    port = SerialPort(str(pty_port.link), 9600, "N")
    with pytest.raises(OSError, match="locked: another program has it open"):
        SerialPort(str(pty_port.link), 9600, "N")
    pty_port.write(b"whole")
    assert port.read()[0][0] == b"whole"
    port.close()
    SerialPort(str(pty_port.link), 9600, "E").close()
    SerialPort(str(pty_port.link), 9600, "N").close()
