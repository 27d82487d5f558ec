# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Splits the bytes of a serial line into lines, and determines when each began."""

import math
from collections.abc import Iterator
from typing import NamedTuple

from trackslip_common.units import NS_PER_S


class Line(NamedTuple):
    """One line, without its terminator; None if it exceeded the limit."""

    text: bytes | None
    begun_ns: int  # latest time at which its first character left the sender
    ended_ns: int  # the same for the last one


class LineSplitter:
    """Splits lines; holds at most one line (``limit`` bytes), so its memory is bounded.

    Args:
        terminator: one byte that ends a line.
        limit: longest line, bytes.
        bits_per_char: start, data, parity and stop bits.
        baud: line rate; 0: a network, without transmission time.
    """

    def __init__(self, terminator: bytes, limit: int, bits_per_char: int, baud: int) -> None:
        self.limit = limit
        self._terminator = terminator
        self._bits_per_char = bits_per_char
        self._baud = baud
        self.reset()

    @property
    def bytes_held(self) -> int:
        """Number of bytes of the incomplete line."""
        return len(self._pending)

    def reset(self) -> None:
        """Drop a half-received line."""
        self._pending = bytearray()
        self._begun_ns = math.inf  # upper bound on the begin of the pending line
        self._overlong = False

    def feed(self, data: bytes, arrival_ns: int) -> Iterator[Line]:
        """The lines completed by one read, whose last byte arrived by ``arrival_ns``.

        Each read of a line bounds the line's begin from above, at the line rate. The lowest bound is used, so
        one prompt read is enough. Empty lines are skipped.
        """
        *ended, rest = data.split(self._terminator)
        left = len(data)
        for part in ended:
            left -= len(part) + 1
            self._append(part)
            ended_ns = arrival_ns - self.transfer_ns(left)
            self._bound_begin(ended_ns - self.transfer_ns(1))
            text = None if self._overlong else bytes(self._pending)
            line = Line(text, round(self._begun_ns), ended_ns)
            self.reset()
            if text != b"":
                yield line
        self._append(rest)
        if self._pending:
            self._bound_begin(arrival_ns)

    def _bound_begin(self, arrived_ns: int) -> None:
        """Bound the begin of the pending line, whose bytes arrived by ``arrived_ns``."""
        self._begun_ns = min(self._begun_ns, arrived_ns - self.transfer_ns(len(self._pending)))

    def _append(self, part: bytes) -> None:
        """Append bytes to the pending line, unless it exceeds the limit.

        Leading white space is dropped: it may have come long before.
        """
        part = part if self._pending else part.lstrip()
        if self._overlong or len(self._pending) + len(part) > self.limit:
            self._overlong = True
            self._pending.clear()
        else:
            self._pending += part

    def transfer_ns(self, count: int) -> int:
        """Time that ``count`` characters take on the line, ns."""
        return count * self._bits_per_char * NS_PER_S // self._baud if self._baud else 0
