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

BUSY = "locked: another program has it open"

_MAX_READ_SIZE = 4096  # returned at once
_READ_DELAY_S = 0.005  # after the first byte, so that a slow line does not wake the process per byte
_WRITE_TIMEOUT_S = 0.5


class SerialPort:
    """An open port (a ``link.Port`` of bytes).

    A pty has no parity bit: the kernel refuses or ignores the setting. The port then works without parity,
    which ``note`` states.

    Args:
        url: device path or pyserial URL.
        baud: line rate.
        parity: N, E or O.

    Raises:
        serial.SerialException, OSError, termios.error: the port cannot be opened, or another program has it.
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
        if parity != serial.PARITY_NONE and self._is_parity_ignored():
            self._serial.parity = serial.PARITY_NONE  # or the next change of baud would fail
            self._note_parity(url, parity)
        is_terminal = type(self._serial) is serial.Serial and os.name == "posix"
        self._descriptor: int | None = self._serial.fileno() if is_terminal else None

    def read(self) -> Sequence[tuple[bytes, int]]:
        """All bytes available a moment after the first of them, with the time of the read.

        If the line fell silent during that moment, the last byte arrived earlier, by up to that moment. For
        better times, use several reads: one in the midst of a telegram is prompt.
        """
        data = self._read_pyserial() if self._descriptor is None else self._read_terminal(self._descriptor)
        return [(data, time.time_ns())] if data else []

    @staticmethod
    def _read_terminal(descriptor: int) -> bytes:
        """Read from a terminal: two system calls where pyserial makes six."""
        ready, _, _ = select.select([descriptor], [], [], READ_TIMEOUT_S)
        if not ready:
            return b""
        time.sleep(_READ_DELAY_S)
        data = os.read(descriptor, _MAX_READ_SIZE)
        if not data:
            raise serial.SerialException("the port has gone: ready to be read, but empty")
        return data

    def _read_pyserial(self) -> bytes:
        """Read from any port that pyserial can open."""
        data = bytes(self._serial.read(1))
        if data:
            time.sleep(_READ_DELAY_S)
        while data and len(data) < _MAX_READ_SIZE and (waiting := self._serial.in_waiting):
            data += self._serial.read(min(waiting, _MAX_READ_SIZE))
        return data

    def write(self, data: bytes) -> None:
        """Send.

        Raises:
            serial.SerialException: the port is gone, or did not accept the bytes in time.
        """
        self._serial.write(data)

    def set_baud(self, baud: int) -> None:
        """Change the rate of the open port, after all written bytes have left."""
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
                exclusive=True,  # two readers of one device would each get half of its bytes
            )
        except serial.SerialException as error:
            if error.errno == errno.EAGAIN:  # the lock is taken
                raise OSError(errno.EBUSY, BUSY) from None
            raise

    def _is_parity_ignored(self) -> bool:
        """Whether the kernel silently ignored the parity; False if the port is no terminal."""
        try:
            attributes = termios.tcgetattr(self._serial.fileno())
        except (termios.error, OSError):  # a socket; pyserial's UnsupportedOperation is an OSError
            return False
        return not attributes[2] & termios.PARENB

    def _note_parity(self, url: str, parity: str) -> None:
        self.note = f"{url} has no parity bit: opened without parity {parity}"
