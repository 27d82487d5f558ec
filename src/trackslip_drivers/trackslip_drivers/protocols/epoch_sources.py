# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One measurement an epoch, where a receiver sends it in several messages: HDT and THS, GPGGA and GNGGA."""

import math

_TIMEOUT_NS = 3_000_000_000  # of a better message that came before: then the next best is used
_SAME_NS = 4_000_000  # within which two stamps are of one epoch; receivers send 100 a second at most
_SHARE = 0.6  # of the time between epochs, after which another message of equal rank is of the next one


class EpochSource:
    """The message that a measurement is taken from: of the best rank, the first of its epoch."""

    def __init__(self) -> None:
        self.repeated = 0  # measurements that another message, or the same one before, had stated
        self.crowded = 0  # those of them of the same message
        self.reset()

    def reset(self) -> None:
        """Any source may come first."""
        self._name = ""
        self._rank = -1
        self._stamp_ns = self._arrival_ns = -math.inf
        self._period_ns = 0.0  # between the latest two epochs; 0: unknown

    def accept(self, name: str, rank: int, stamp_ns: int, arrival_ns: int) -> bool:
        """Whether a measurement is used.

        Args:
            name: the message that states it.
            rank: higher is better, as of a message that states an accuracy.
            stamp_ns: its epoch, on a steady clock.
            arrival_ns: when the message began to arrive.
        """
        after_ns = abs(stamp_ns - self._stamp_ns)
        is_same = name == self._name
        if is_same or rank > self._rank:
            is_next = after_ns > _SAME_NS
        elif rank == self._rank:
            is_next = after_ns > max(_SHARE * self._period_ns, _SAME_NS)
        else:
            is_next = arrival_ns - self._arrival_ns > _TIMEOUT_NS
        if is_same or rank > self._rank or is_next:
            self._name, self._rank, self._arrival_ns = name, rank, arrival_ns
        if not is_next:
            self.repeated += 1
            self.crowded += is_same
            return False
        self._period_ns = after_ns if after_ns <= _TIMEOUT_NS else 0.0
        self._stamp_ns = stamp_ns
        return True
