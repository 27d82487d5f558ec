# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A serial line that transmits characters one after the other at its baud rate."""

from collections import deque
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trackslip_common.units import NS_PER_S

NEVER_NS = 2**62  # later than any time of a run


@dataclass
class _Burst:
    """Characters sent back to back at one rate, the first starting at ``start_ns``."""

    data: bytes
    start_ns: int
    baud: int
    read: int = 0  # number of characters read
    reads_ns: tuple[int, ...] = ()  # see ``BaudLine.next_read_ns``


class BaudLine:
    """One direction of a serial line, from the transmitter's queue to the receiver.

    Args:
        baud: bits per second; assign to ``baud`` to change it for what is sent from then on.
        bits_per_char: start, data, parity and stop bits together (10 for 8N1, 11 for 8E1).
    """

    def __init__(self, baud: int, bits_per_char: int) -> None:
        self.baud = baud
        self.bits_per_char = bits_per_char
        self.busy_until_ns = 0
        self._bursts: deque[_Burst] = deque()

    def transfer_ns(self, count: int) -> int:
        """Time for which ``count`` characters occupy the line at the current rate, ns, rounded up."""
        return -(-count * self.bits_per_char * NS_PER_S // self.baud)

    def send(self, data: bytes, now_ns: int) -> None:
        """Queue characters; they start now, or after those already queued."""
        if not data:
            return
        start_ns = max(now_ns, self.busy_until_ns)
        self._bursts.append(_Burst(data, start_ns, self.baud))
        self.busy_until_ns = start_ns + self.transfer_ns(len(data))

    def discard_unread(self, now_ns: int) -> None:
        """Drop all characters not yet read: the transmitter has lost power."""
        self._bursts.clear()
        self.busy_until_ns = now_ns

    def next_read_ns(self, now_ns: int, tick_ns: int) -> int:
        """Next time to call ``read``, whole ticks from now, for the same result as reading at each tick.

        A receiver that bounds the start of a burst by the times of reads needs two reads: the one closest
        after a character's last bit, and the first that completes the burst.
        """
        if not self._bursts:
            return NEVER_NS
        burst = self._bursts[0]
        if len(self._bursts) > 1:
            return now_ns + tick_ns
        if not burst.reads_ns:
            first_ns = (now_ns - burst.start_ns) % tick_ns
            reads_ns = _burst_read_times(len(burst.data), burst.baud, self.bits_per_char, first_ns, tick_ns)
            burst.reads_ns = tuple(burst.start_ns + read_ns for read_ns in reads_ns)
        for read_ns in burst.reads_ns:
            if read_ns > now_ns:
                return read_ns
        return now_ns + tick_ns

    def read(self, now_ns: int) -> bytes:
        """The characters whose last bit has arrived by now and that were not read before."""
        arrived = bytearray()
        while self._bursts:
            burst = self._bursts[0]
            bits = (now_ns - burst.start_ns) * burst.baud // NS_PER_S
            complete = min(len(burst.data), max(0, bits // self.bits_per_char))
            arrived += burst.data[burst.read : complete]
            burst.read = max(burst.read, complete)
            if complete < len(burst.data):
                break
            self._bursts.popleft()
        return bytes(arrived)


@lru_cache(maxsize=256)
def _burst_read_times(count: int, baud: int, bits: int, first_ns: int, tick_ns: int) -> tuple[int, int]:
    """The two reads of a burst of ``count`` characters, ns after its start; ticks start at ``first_ns``."""
    end_ns = -(-count * bits * NS_PER_S // baud)
    ticks = np.arange(first_ns, end_ns + tick_ns, tick_ns)
    complete = np.minimum(ticks * baud // NS_PER_S // bits, count)
    late = np.where(complete > 0, ticks - complete * bits * NS_PER_S // baud, NEVER_NS)
    return int(ticks[late.argmin()]), int(ticks[np.searchsorted(complete, count)])
