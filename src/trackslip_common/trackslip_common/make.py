# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Messages built from type name and fields; live nodes and bags share every conversion."""

from typing import Any, Protocol

from trackslip_common.units import NS_PER_S

_LATEST_NS = 2**31 * NS_PER_S - 1  # of a stamp; a received one may be later, by its nanoseconds


class MessageFactory(Protocol):
    """Builds a message, rclpy's or a bag's own: ``make("std_msgs/msg/Header", stamp=…, frame_id=…)``."""

    def __call__(self, type_name: str, **fields: Any) -> Any:
        """The message."""


def header(make: MessageFactory, stamp_ns: int, frame_id: str) -> Any:
    """std_msgs/Header."""
    sec, nanosec = _seconds_of(stamp_ns)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def set_stamp(message: Any, stamp_ns: int) -> None:
    """Stamp a message that has a header."""
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = _seconds_of(stamp_ns)


def _seconds_of(stamp_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of a stamp; of a later one than a message can hold, those of the latest."""
    return divmod(min(stamp_ns, _LATEST_NS), NS_PER_S)


def stamp_ns_of(message: Any) -> int:
    """Stamp of any message with a header."""
    stamp = message.header.stamp
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
