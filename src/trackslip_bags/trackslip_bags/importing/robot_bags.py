# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of other robots: of ROS 2, and of ROS 1 (format 2.0), one or several of one recording."""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import decompressors
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trackslip_bags import unpacking
from trackslip_bags.reader import Bag, absolute_name
from trackslip_bags.sources import error_line
from trackslip_bags.types import check_finite
from trackslip_common.errors import InputError

decompressors.update(unpacking.ros1_decompressors())  # with a limit on the size, unlike those of rosbags


class LoggedMessage(NamedTuple):
    """One message."""

    topic: str
    log_time_ns: int
    content: Any


class RobotLog(Protocol):
    """An open bag."""

    path: Path

    @property
    def types(self) -> Mapping[str, str]:
        """Topic → type name, as ROS 2 writes it."""

    def read(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """Messages in log order.

        Raises:
            InputError: the bag is damaged inside.
        """


class Ros2Bag:
    """A bag of ROS 2."""

    def __init__(self, bag: Bag) -> None:
        self.path, self._bag = bag.path, bag

    @property
    def types(self) -> Mapping[str, str]:
        return {absolute_name(topic): info.type_name for topic, info in self._bag.topics.items()}

    def read(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        for message in self._bag.messages(topics):
            content = self._bag.deserialize(message.raw, message.type_name)
            yield LoggedMessage(absolute_name(message.topic), message.log_time_ns, content)


class Ros1Bags:
    """Open bags of ROS 1; types are as the bags define them."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self.path = paths[0]
        with ExitStack() as opened:
            self._readers = [opened.enter_context(closing(_open_ros1(path))) for path in paths]
            self._files = opened.pop_all()

    @property
    def types(self) -> Mapping[str, str]:
        return {absolute_name(c.topic): c.msgtype for reader in self._readers for c in reader.connections}

    def read(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        parts = [self._read_one(reader, frozenset(topics)) for reader in self._readers]
        yield from heapq.merge(*parts, key=attrgetter("log_time_ns"))

    def __enter__(self) -> "Ros1Bags":
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def _read_one(self, reader: Reader, topics: frozenset[str]) -> Iterator[LoggedMessage]:
        connections = [c for c in reader.connections if absolute_name(c.topic) in topics]
        stores: dict[int, Any] = {}
        try:
            for connection in connections:
                store = get_typestore(Stores.EMPTY)
                defined = get_types_from_msg(connection.msgdef.data, connection.msgtype)
                check_finite(defined)
                store.register(defined)
                stores[connection.id] = store
            for connection, time_ns, raw in reader.messages(connections) if connections else ():
                content = stores[connection.id].deserialize_ros1(raw, connection.msgtype)
                yield LoggedMessage(absolute_name(connection.topic), time_ns, content)
        except Exception as error:
            raise InputError(f"bag '{reader.path}' is damaged inside ({error_line(error)})") from error


def _open_ros1(path: Path) -> Reader:
    reader = Reader(path)
    try:
        reader.open()
    except Exception as error:
        hint = "; rosbag reindex mends one that was cut off" if "index" in str(error) else ""
        text = f"bag '{path}' cannot be read ({error_line(error)}){hint}"
        raise InputError(f"{text}; accepted: a ROS 1 bag of format 2.0") from error
    return reader
