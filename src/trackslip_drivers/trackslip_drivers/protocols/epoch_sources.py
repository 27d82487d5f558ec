# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One measurement an epoch, where a receiver sends it in several messages: HDT and THS, GPGGA and GNGGA."""

import math

_TIMEOUT_NS = 3_000_000_000  # of a source that came before: then the next best is used
_SAME_NS = 4_000_000  # within which two stamps are of one epoch; receivers send 100 a second at most


class EpochSource:
    """The message that a measurement is taken from: of the best rank, the first that came."""

    def __init__(self) -> None:
        self.repeated = 0  # measurements that another message, or the same one before, had stated
        self.reset()

    def reset(self) -> None:
        """Any source may come first."""
        self._name = ""
        self._rank = -1
        self._stamp_ns = -math.inf

    def accept(self, name: str, rank: int, stamp_ns: int) -> bool:
        """Whether a measurement is used.

        Args:
            name: the message that states it.
            rank: higher is better, as of a message that states an accuracy.
            stamp_ns: its epoch, on a steady clock.
        """
        is_late = stamp_ns - self._stamp_ns > _TIMEOUT_NS or stamp_ns < self._stamp_ns - _TIMEOUT_NS
        if name == self._name or rank > self._rank or is_late:
            self._name, self._rank = name, rank
            if abs(stamp_ns - self._stamp_ns) > _SAME_NS:
                self._stamp_ns = stamp_ns
                return True
        self.repeated += 1
        return False
