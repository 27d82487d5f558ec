# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Selects one message per epoch where a receiver sends several: HDT and THS, GPGGA and GNGGA."""

import math

_TIMEOUT_NS = 3_000_000_000  # silence of a better message, after which the next best is used
_SAME_EPOCH_NS = 4_000_000  # stamps closer than this are of one epoch; receivers send 100 a second at most
_NEXT_EPOCH_SHARE = 0.6  # of the epoch period: a message of equal rank that comes later is of the next epoch


class EpochSource:
    """Selects the message of a measurement: the best rank, and the first of its epoch.

    ``arrival_ns``: arrival of the latest message that is selected, duplicate or not.
    """

    def __init__(self) -> None:
        self.duplicates = 0  # measurements dropped as duplicates of an epoch
        self.duplicates_of_same_kind = 0  # duplicates from the same message
        self.reset()

    def reset(self) -> None:
        """Forget the selected message; any may come first."""
        self._name = ""
        self._rank = -1
        self._stamp_ns = self.arrival_ns = -math.inf
        self._period_ns = 0.0  # between the latest two epochs; 0: unknown

    def accept(self, name: str, rank: int, stamp_ns: int, arrival_ns: int) -> bool:
        """Whether a measurement is used.

        Args:
            name: the message type.
            rank: higher is better, such as for a message with an accuracy.
            stamp_ns: its epoch, on a steady clock.
            arrival_ns: arrival of the message's first byte.
        """
        elapsed_ns = abs(stamp_ns - self._stamp_ns)
        is_same = name == self._name
        if is_same or rank > self._rank:
            is_next = elapsed_ns > _SAME_EPOCH_NS
        elif rank == self._rank:
            is_next = elapsed_ns > max(_NEXT_EPOCH_SHARE * self._period_ns, _SAME_EPOCH_NS)
        else:
            is_next = arrival_ns - self.arrival_ns > _TIMEOUT_NS
        if is_same or rank > self._rank or is_next:
            self._name, self._rank, self.arrival_ns = name, rank, arrival_ns
        if not is_next:
            self.duplicates += 1
            self.duplicates_of_same_kind += is_same
            return False
        self._period_ns = elapsed_ns if elapsed_ns <= _TIMEOUT_NS else 0.0
        self._stamp_ns = stamp_ns
        return True
