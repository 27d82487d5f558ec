# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A pty that a driver opens as if it were a serial device."""

import contextlib
import os
import pty
import termios
import tty
from pathlib import Path

from trackslip_common.errors import InputError

_MOST_BYTES = 65536
_PORTS = "/dev/pts/"  # to which links of ours lead
_BAUD_OF_CODE = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdecimal()
}


class PtyPort:
    """The device's end; the client opens ``link``, a symbolic link to the other end.

    The slave is raw from the start and stays open here, so that nothing is echoed and a client may come and
    go. What a client does not read in time is refused by the kernel once its buffer is full, as a UART
    overruns: those bytes are lost and counted. So are those sent while it is unplugged.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.bytes_lost = 0
        self.plugged = False
        self.plug()

    def plug(self) -> None:
        """Appear, as a new device under the old name.

        Raises:
            InputError: something else has that name.
        """
        if os.path.lexists(self.link) and not self._is_port():
            raise InputError(
                f"device_directory: '{self.link}' is no port of an emulator, and is not replaced; "
                "accepted: a directory of its own"
            )
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._slave))
        self.plugged = True

    @property
    def baud(self) -> int | None:
        """The rate that the client has set; None while unplugged."""
        return _BAUD_OF_CODE[termios.tcgetattr(self._master)[5]] if self.plugged else None

    def read(self) -> bytes:
        """What the client has written; empty when nothing."""
        if not self.plugged:
            return b""
        try:
            return os.read(self._master, _MOST_BYTES)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Hand to the client; the number of bytes that it, or the kernel for it, accepted."""
        sent = 0
        with contextlib.suppress(BlockingIOError):
            while self.plugged and sent < len(data):
                sent += os.write(self._master, data[sent:])
        self.bytes_lost += len(data) - sent
        return sent

    def _is_port(self) -> bool:
        return self.link.is_symlink() and str(self.link.readlink()).startswith(_PORTS)

    def close(self) -> None:
        """Unplug: the client sees the device disappear; safe to call twice."""
        if self.plugged:
            self.plugged = False
            self.link.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(self._master)
