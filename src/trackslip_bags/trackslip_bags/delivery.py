# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The order in which a topic's messages were delivered, kept in their log times.

A reliable publisher sends again what was lost on the way. It comes late, and what was sent after it waits
for it: messages are delivered in order, while their times of reception are not.
"""

_LONGEST_REPAIR_NS = 5_000_000_000  # a heartbeat asks every 3 s what is missing; more is a clock that was set


class DeliveryOrder:
    """Log times that, topic by topic, do not run back over a repair."""

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}

    def after_all_before(self, topic: str, came_ns: int) -> int:
        """Log time of a message that is delivered now and was received at ``came_ns``."""
        newest_ns = self._newest_ns.get(topic, came_ns)
        if 0 < newest_ns - came_ns < _LONGEST_REPAIR_NS:
            return newest_ns
        self._newest_ns[topic] = came_ns
        return came_ns
