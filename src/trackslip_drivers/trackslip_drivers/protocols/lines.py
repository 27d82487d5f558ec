# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Cuts the bytes of a serial line into lines, and says when each began."""

import math
from collections.abc import Iterator
from typing import NamedTuple

_NS_PER_S = 1_000_000_000


class Line(NamedTuple):
    """One line, without its terminator; None where it was longer than any line is."""

    text: bytes | None
    begun_ns: int  # its first character left the sender no later
    ended_ns: int  # its last one did


class LineCutter:
    """Holds at most one line's worth of bytes (``limit``), so no stream can make it grow.

    Args:
        terminator: one byte that ends a line.
        limit: longest line, bytes.
        bits_per_char: start, data, parity and stop bits.
        baud: line rate; 0: the bytes come over a network, in no time.
    """

    def __init__(self, terminator: bytes, limit: int, bits_per_char: int, baud: int) -> None:
        self.limit = limit
        self._terminator = terminator
        self._bits_per_char = bits_per_char
        self._baud = baud
        self.reset()

    @property
    def bytes_held(self) -> int:
        """How many bytes wait for the rest of their line."""
        return len(self._pending)

    def reset(self) -> None:
        """Drop a half-received line."""
        self._pending = bytearray()
        self._begun_ns = math.inf  # the line that is pending began no later
        self._overlong = False

    def feed(self, data: bytes, arrival_ns: int) -> Iterator[Line]:
        """What one read returned, and when: its last byte was there by ``arrival_ns``.

        A line began no later than any of its reads leaves time for, at the line's rate. One prompt read
        among them is enough. An empty line is none.
        """
        *ended, rest = data.split(self._terminator)
        left = len(data)
        for part in ended:
            left -= len(part) + 1
            self._hold(part)
            ended_ns = arrival_ns - self.transfer_ns(left)
            self._bound(ended_ns - self.transfer_ns(1))
            text = None if self._overlong else bytes(self._pending)
            line = Line(text, round(self._begun_ns), ended_ns)
            self.reset()
            if text != b"":
                yield line
        self._hold(rest)
        if self._pending:
            self._bound(arrival_ns)

    def _bound(self, arrived_ns: int) -> None:
        """What is pending had come by then."""
        self._begun_ns = min(self._begun_ns, arrived_ns - self.transfer_ns(len(self._pending)))

    def _hold(self, part: bytes) -> None:
        """Keep bytes of an unfinished line, unless it has grown past any line's length.

        White space before it is not part of it: it may have come long before.
        """
        part = part if self._pending else part.lstrip()
        if self._overlong or len(self._pending) + len(part) > self.limit:
            self._overlong = True
            self._pending.clear()
        else:
            self._pending += part

    def transfer_ns(self, count: int) -> int:
        """How long ``count`` characters occupy the line."""
        return count * self._bits_per_char * _NS_PER_S // self._baud if self._baud else 0
