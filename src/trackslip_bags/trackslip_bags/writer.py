# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 bags (MCAP storage) from serialized messages.

A chunk spans at most ``CHUNK_SPAN_NS`` of data and is then passed to the operating system. A recorder killed
at any moment loses no more than that, and the file remains readable up to there. Each file of a split bag
is self-contained: it has all topics and definitions.
"""

import math
import os
import shutil
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from io import BufferedWriter, FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from mcap.well_known import MessageEncoding
from mcap.writer import CompressionType, Writer

from trackslip_bags.definitions import installed_schema, ros_distro
from trackslip_bags.metadata import METADATA, Extent, Schema, Topic, metadata_text
from trackslip_common.atomic_files import replace_atomically
from trackslip_common.errors import InputError

CHUNK_SPAN_NS = 500_000_000
W = TypeVar("W", bound="BagWriter")

_NO_QOS = "[]"  # empty list in metadata.yaml: ros2 bag plays with default QoS


def refuse_existing(path: Path | None) -> None:
    """Check, before the work for a bag, that its path is free.

    Raises:
        InputError: the path exists.
    """
    if path is not None and (path.exists() or path.is_symlink()):
        raise _exists_error(path)


def _exists_error(path: Path) -> InputError:
    return InputError(f"bag '{path}' exists already; accepted: a path that does not exist")


def _is_utf8(name: str) -> bool:
    """Whether a name has no surrogates, by which Python represents bytes that are not UTF-8."""
    return not any("\ud800" <= character <= "\udfff" for character in name)


class BagWriter:
    """A bag being written: a directory with ``<name>_0.mcap`` and so on, ``metadata.yaml`` once closed.

    Args:
        path: the directory to create.
        split_size: size of a file, bytes, at which the next one begins.
        split_duration: largest log time span of a file, s.
        library: name of the writer in each file.

    Raises:
        InputError: ``path`` exists already or cannot be created.
        OSError: from any method: the disk is full or gone. Flushed messages are kept.
    """

    def __init__(
        self,
        path: Path | str,
        split_size: float = math.inf,
        split_duration: float = math.inf,
        library: str = "trackslip",
    ) -> None:
        self.path = Path(path)
        self._split_size, self._split_ns = split_size, split_duration * 1e9
        self._library = library
        self.topics: dict[str, Topic] = {}
        self._extents: dict[str, Extent] = {}  # by file name
        self._counts_before: list[dict[str, int]] = []  # messages per topic at the start of each file
        self._removed: Counter[str] = Counter()  # messages per topic in removed files
        self._chunk_start_ns: int | None = None
        self._saved: dict[str, int] = {}  # counts at the last flush
        if not _is_utf8(self.path.name):  # metadata.yaml has the names of files
            raise InputError(f"bag {str(self.path)!r}: the name is not UTF-8; accepted: a name that is")
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise _exists_error(self.path) from None
        except OSError as error:
            raise InputError(f"bag '{self.path}' cannot be created ({error.strerror})") from error
        try:
            self._begin_file()
        except OSError as error:
            self._remove_directory()
            raise InputError(f"bag '{self.path}' cannot be written ({error.strerror})") from error

    def add_topic(self, topic: str, type_name: str, qos_yaml: str = "", schema: Schema | None = None) -> None:
        """Add a topic before its first message; repeating it with the same type has no effect.

        Args:
            topic: name of the topic.
            type_name: ``package/msg/Name``.
            qos_yaml: rosbag2's text of the offered QoS profiles (a YAML list, version 9).
            schema: the definition of the type; by default the one known here.

        Raises:
            InputError: the type is unknown, or the topic exists with another type.
        """
        entry = self.topics.get(topic)
        if entry is not None:
            if entry.type_name != type_name:
                raise InputError(f"topic '{topic}' is of type {entry.type_name} in this bag, not {type_name}")
            return
        added = Topic(type_name, schema or own_schema(type_name), qos_yaml or _NO_QOS)
        self.topics[topic] = added
        self._file.add_topic(topic, added)

    def write(
        self,
        topic: str,
        type_name: str,
        data: bytes,
        log_time_ns: int,
        publish_time_ns: int | None = None,
    ) -> None:
        """Append one serialized (CDR) message unchanged; a new topic is added.

        Bags have no times before 1970: earlier messages are logged at time 0.

        Raises:
            InputError: as ``add_topic``.
        """
        entry = self.topics.get(topic)
        if entry is None or entry.type_name != type_name:
            self.add_topic(topic, type_name)
            entry = self.topics[topic]
        publish_time_ns = max(log_time_ns if publish_time_ns is None else publish_time_ns, 0)
        log_time_ns = max(log_time_ns, 0)
        if self._chunk_start_ns is None:
            self._chunk_start_ns = log_time_ns
        elif abs(log_time_ns - self._chunk_start_ns) >= CHUNK_SPAN_NS:  # either way: clocks are set
            self.flush()
            self._chunk_start_ns = log_time_ns
        if self._is_full(log_time_ns):
            self.split()
        self._file.write(topic, data, log_time_ns, publish_time_ns)
        entry.count += 1

    def flush(self) -> None:
        """Close the chunk and pass it to the operating system, for recorders whose topics stop."""
        self._file.flush()
        self._chunk_start_ns = None
        self._saved = self.counts

    def split(self) -> None:
        """Continue in a new file."""
        self._file.close()
        self._begin_file()

    def remove_file(self, name: str) -> None:
        """Delete a finished file; the metadata will not name it.

        Raises:
            OSError: it cannot be deleted.
        """
        number = int(Path(name).stem.rpartition("_")[2])
        before, after = self._counts_before[number : number + 2]
        (self.path / name).unlink()
        self._removed.update({topic: count - before.get(topic, 0) for topic, count in after.items()})
        del self._extents[name]

    @property
    def file(self) -> Path:
        """The current file."""
        return self._file.path

    @property
    def counts(self) -> dict[str, int]:
        """Messages written, per topic."""
        return {name: topic.count for name, topic in self.topics.items()}

    @property
    def unsaved(self) -> dict[str, int]:
        """Messages not yet passed to the operating system, per topic."""
        return {name: count - self._saved.get(name, 0) for name, count in self.counts.items()}

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; repeated calls have no effect."""
        if self._file.closed:
            return
        self._file.close()
        remaining = {n: replace(t, count=t.count - self._removed[n]) for n, t in self.topics.items()}
        text = metadata_text(remaining, self._extents, ros_distro())
        replace_atomically(self.path / METADATA, text)

    def abandon(self) -> None:
        """Close the file as it is, like a killed recorder, after a disk error."""
        self._file.abandon()

    def __enter__(self: W) -> W:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag; after any error remove it, for a part of a result would look complete.

        Raises:
            InputError: the disk is full or gone.
        """
        try:
            if error is None:
                self.close()
        except OSError as at_the_end:
            error = at_the_end
        if error is not None:
            self.abandon()
            self._remove_directory()
        if isinstance(error, OSError):
            raise InputError(f"bag '{self.path}' cannot be written ({error.strerror})") from error

    def _remove_directory(self) -> None:
        """Remove the directory, which was created here, with its content."""
        shutil.rmtree(self.path, ignore_errors=True)

    def _begin_file(self) -> None:
        name = f"{self.path.resolve().name}_{len(self._counts_before)}.mcap"
        self._counts_before.append(self.counts)
        self._extents[name] = Extent()
        self._file = _File(self.path / name, self._extents[name], self.topics, self._library)

    def _is_full(self, log_time_ns: int) -> bool:
        extent = self._file.extent
        if not extent.count or self._split_size == self._split_ns == math.inf:
            return False
        span_ns = max(log_time_ns, extent.end_ns) - min(log_time_ns, extent.start_ns)
        return span_ns >= self._split_ns or self._file.size >= self._split_size


class _Stream(BufferedWriter):
    """A file with its size counted: asking the system per message takes a tenth of a recorder's time."""

    size = 0  # bytes

    def write(self, data: Any, /) -> int:
        self.size += len(data)
        return super().write(data)


class _File:
    """One MCAP file with its channels, schemas and extent."""

    def __init__(self, path: Path, extent: Extent, topics: Mapping[str, Topic], library: str) -> None:
        self.path = path
        self.extent = extent
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, Schema], int] = {}
        self._stream = _Stream(FileIO(path, "x"))
        self._mcap = Writer(self._stream, compression=CompressionType.ZSTD)
        self._mcap.start(profile="ros2", library=library)
        self._stream.flush()
        for name, topic in topics.items():
            self.add_topic(name, topic)

    def add_topic(self, name: str, topic: Topic) -> None:
        key = topic.type_name, topic.schema
        if key not in self._schemas:
            schema = topic.schema
            self._schemas[key] = self._mcap.register_schema(topic.type_name, schema.encoding, schema.data)
        metadata = {"offered_qos_profiles": topic.qos_yaml, "topic_type_hash": topic.schema.type_hash}
        self._channels[name] = self._mcap.register_channel(
            name, MessageEncoding.CDR, self._schemas[key], metadata
        )

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        self._mcap.add_message(self._channels[topic], log_time_ns, data, publish_time_ns)
        self.extent.add(log_time_ns)

    def flush(self) -> None:
        self._mcap.flush()  # type: ignore[no-untyped-call]

    @property
    def size(self) -> int:
        """Bytes written, without the current chunk."""
        return self._stream.size

    @property
    def closed(self) -> bool:
        return self._stream.closed

    def close(self) -> None:
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def abandon(self) -> None:
        with suppress(OSError):  # unwritten data cannot be flushed; the file is closed all the same
            self._stream.close()


def own_schema(type_name: str) -> Schema:
    """The installed definition of a type, or that of rosbags without ROS.

    Raises:
        InputError: there is no definition.
    """
    schema = installed_schema(type_name)
    if schema is None:
        from trackslip_bags.types import known_schema  # needs rosbags, which is not on the vehicle

        schema = known_schema(type_name)
    return schema
