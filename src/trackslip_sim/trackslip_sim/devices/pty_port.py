# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A pseudo-terminal (pty) that a driver opens like a serial device."""

import contextlib
import os
import pty
import termios
import tty
from pathlib import Path

from trackslip_common.errors import InputError

_MAX_READ = 65536
_PTY_FOLDER = "/dev/pts/"  # target of an emulator's links
_BAUD_OF_CODE = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdecimal()
}


class PtyPort:
    """The device's end of a pty; the client opens ``link``, a symbolic link to the other end.

    The slave is raw from the start and stays open here: nothing is echoed, and clients may reconnect. If a
    client does not read, the kernel's buffer fills; further bytes are lost, as in a UART overrun. Lost
    bytes are counted, also those written while the port is unplugged.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self.bytes_lost = 0
        self.plugged = False
        self.plug()

    def plug(self) -> None:
        """Create the pty and its link, as a device that is plugged in.

        Raises:
            InputError: another file has the name of the link.
        """
        if os.path.lexists(self.link) and not self._has_own_link():
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
        """The baud rate set by the client; None while unplugged."""
        return _BAUD_OF_CODE[termios.tcgetattr(self._master)[5]] if self.plugged else None

    def read(self) -> bytes:
        """Bytes written by the client; may be empty."""
        if not self.plugged:
            return b""
        try:
            return os.read(self._master, _MAX_READ)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Send bytes to the client; returns how many the kernel accepted."""
        sent = 0
        with contextlib.suppress(BlockingIOError):
            while self.plugged and sent < len(data):
                sent += os.write(self._master, data[sent:])
        self.bytes_lost += len(data) - sent
        return sent

    def _has_own_link(self) -> bool:
        return self.link.is_symlink() and str(self.link.readlink()).startswith(_PTY_FOLDER)

    def close(self) -> None:
        """Unplug: remove the link and close the pty; safe to call twice."""
        if self.plugged:
            self.plugged = False
            self.link.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(self._master)
