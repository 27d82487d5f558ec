# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What is read of a robot's bag, of either ROS."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from trackslip_bags.reader import Bag, absolute


class Logged(NamedTuple):
    """One message."""

    topic: str
    log_time_ns: int
    content: Any


class RobotLog(Protocol):
    """An open bag."""

    path: Path

    @property
    def types(self) -> Mapping[str, str]:
        """Topic → type name."""

    def read(self, topics: Sequence[str]) -> Iterator[Logged]:
        """Messages in log order."""


class Ros2Bag:
    """A bag of ROS 2."""

    def __init__(self, bag: Bag) -> None:
        self.path, self._bag = bag.path, bag

    @property
    def types(self) -> Mapping[str, str]:
        """Topic → type name."""
        return {absolute(topic): info.type_name for topic, info in self._bag.topics.items()}

    def read(self, topics: Sequence[str]) -> Iterator[Logged]:
        """Messages in log order.

        Raises:
            InputError: the bag is damaged inside.
        """
        for message in self._bag.messages(topics):
            content = self._bag.deserialize(message.raw, message.type_name)
            yield Logged(absolute(message.topic), message.log_time_ns, content)
