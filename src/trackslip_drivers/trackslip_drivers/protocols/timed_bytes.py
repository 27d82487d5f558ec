# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bytes that wait on a serial line for the rest of their message, and the times at which they were sent.

All bytes of a read had arrived when it returned, and the line is no faster than its rate. So each read of a
message bounds the begin of the message from above; the lowest bound is used. One prompt read is enough.
"""

from trackslip_common.units import NS_PER_S


class TimedBytes:
    """The bytes received and not yet used, with the arrival of each read.

    Args:
        bits_per_char: start, data, parity and stop bits.
        baud: line rate; 0: a network, without transmission time.

    Attributes:
        data: the bytes; ``append``, ``discard`` and ``clear`` change them.
        latest_ns: arrival of the latest read of them, or of those before them.
    """

    def __init__(self, bits_per_char: int, baud: int) -> None:
        self.data = bytearray()
        self.latest_ns = 0
        self._bits_per_char, self._baud = bits_per_char, baud
        self._reads: list[tuple[int, int]] = []  # (length of the data up to its end, arrival), of each read

    def set_baud(self, baud: int) -> None:
        """Change the line rate; for an empty buffer."""
        self._baud = baud

    def append(self, data: bytes, arrival_ns: int) -> None:
        """Add the bytes of one read, whose last one arrived by ``arrival_ns``; none: nothing changes."""
        if data:
            self.data += data
            self._reads.append((len(self.data), arrival_ns))
            self.latest_ns = arrival_ns

    def discard(self, count: int) -> None:
        """Drop bytes at the front, and the reads that ended within them."""
        del self.data[:count]
        self._reads = [(end - count, arrival_ns) for end, arrival_ns in self._reads if end > count]

    def clear(self) -> None:
        """Drop all bytes."""
        self.discard(len(self.data))

    def begun_ns(self, index: int = 0) -> int:
        """Latest time at which the byte at this index of the data can have begun to leave the sender."""
        return min(
            arrival_ns - self.transfer_ns(end - index) for end, arrival_ns in self._reads if end > index
        )

    def ended_ns(self, size: int) -> int:
        """The same for the end of the first ``size`` bytes, by the latest read alone."""
        return self.latest_ns - self.transfer_ns(len(self.data) - size)

    def transfer_ns(self, count: int) -> int:
        """Time that ``count`` characters take on the line, ns."""
        return round(count * self._bits_per_char * NS_PER_S / self._baud) if self._baud else 0
