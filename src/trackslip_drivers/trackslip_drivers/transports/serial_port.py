# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A serial port behind any pyserial URL: a device path, a pty, ``socket://``, ``rfc2217://``."""

import errno
import os
import select
import termios
import time
from collections.abc import Sequence

import serial

from trackslip_drivers.transports.link import READ_TIMEOUT_S

_MOST_BYTES = 4096  # handed on at once
_GATHER_S = 0.005  # from the first byte to the read, or a dripping line would wake the process for each drop
_WRITE_TIMEOUT_S = 0.5


class SerialPort:
    """An open port (a ``link.Port`` of bytes).

    A pty carries no parity bit: the kernel refuses or ignores the setting. Then the port works without, and
    ``note`` states it.

    Args:
        url: device path or pyserial URL.
        baud: line rate.
        parity: N, E or O.

    Raises:
        serial.SerialException, OSError, termios.error: it cannot be opened, or another program has it open.
    """

    def __init__(self, url: str, baud: int, parity: str) -> None:
        self.note = ""
        try:
            self._serial = self._open(url, baud, parity)
        except termios.error:
            if parity == serial.PARITY_NONE:
                raise
            self._serial = self._open(url, baud, serial.PARITY_NONE)
            self._note_parity(url, parity)
        if parity != serial.PARITY_NONE and self._parity_was_ignored():
            self._serial.parity = serial.PARITY_NONE  # or the next change of baud would fail
            self._note_parity(url, parity)
        is_terminal = type(self._serial) is serial.Serial and os.name == "posix"
        self._descriptor: int | None = self._serial.fileno() if is_terminal else None

    def read(self) -> Sequence[tuple[bytes, int]]:
        """All that is there a moment after the first of it; the time is that of the read.

        By then the last byte has been there for up to that moment, where the line fell silent in it. Who
        needs to know better looks at several reads: one in the midst of a telegram is prompt.
        """
        data = self._read_any() if self._descriptor is None else self._read_terminal(self._descriptor)
        return [(data, time.time_ns())] if data else []

    @staticmethod
    def _read_terminal(descriptor: int) -> bytes:
        """From a terminal: two calls of the system where pyserial makes six."""
        ready, _, _ = select.select([descriptor], [], [], READ_TIMEOUT_S)
        if not ready:
            return b""
        time.sleep(_GATHER_S)
        data = os.read(descriptor, _MOST_BYTES)
        if not data:
            raise serial.SerialException("the port has gone: ready to be read, but empty")
        return data

    def _read_any(self) -> bytes:
        """From whatever pyserial can open."""
        data = bytes(self._serial.read(1))
        if data:
            time.sleep(_GATHER_S)
        while data and len(data) < _MOST_BYTES and (waiting := self._serial.in_waiting):
            data += self._serial.read(min(waiting, _MOST_BYTES))
        return data

    def write(self, data: bytes) -> None:
        """Send.

        Raises:
            serial.SerialException: the port is gone, or did not accept the bytes in time.
        """
        self._serial.write(data)

    def set_baud(self, baud: int) -> None:
        """Change the rate of the open port, once what was written has left."""
        self._serial.flush()
        self._serial.baudrate = baud

    def close(self) -> None:
        """Release the device."""
        self._serial.close()

    @staticmethod
    def _open(url: str, baud: int, parity: str) -> serial.Serial:
        try:
            return serial.serial_for_url(
                url,
                baud,
                parity=parity,
                timeout=READ_TIMEOUT_S,
                write_timeout=_WRITE_TIMEOUT_S,
                exclusive=True,  # two that read one device get half of its bytes each
            )
        except serial.SerialException as error:
            if error.errno == errno.EAGAIN:  # of the lock
                raise OSError(errno.EBUSY, "locked: another program has it open") from None
            raise

    def _parity_was_ignored(self) -> bool:
        """Whether the kernel left the parity off silently; false where there is no terminal."""
        try:
            attributes = termios.tcgetattr(self._serial.fileno())
        except (termios.error, OSError):  # a socket; pyserial's UnsupportedOperation is an OSError
            return False
        return not attributes[2] & termios.PARENB

    def _note_parity(self, url: str, parity: str) -> None:
        self.note = f"{url} has no parity bit: opened without parity {parity}"
