# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Readable parts of a bag: files that rosbags opens, and the readable rest of damaged MCAP files."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Protocol

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader

from trackslip_bags import sqlite_files, unpacking
from trackslip_bags.metadata import IDL, MAX_TOPICS, ROS2MSG, Schema
from trackslip_bags.recovery.salvage import DamagedFile

PACKED = ".zstd"
_ENCODINGS = {
    MessageDefinitionFormat.NONE: "",
    MessageDefinitionFormat.MSG: ROS2MSG,
    MessageDefinitionFormat.IDL: IDL[0],
}
SUFFIXES = (".mcap", ".db3", f".mcap{PACKED}", f".db3{PACKED}")  # of the files of a bag

unpacking.limit_rosbags()
sqlite_files.use_companion_files()


class BagMessage(NamedTuple):
    """One message as recorded; ``raw`` is its CDR form."""

    topic: str
    type_name: str
    log_time_ns: int
    raw: bytes


@dataclass(frozen=True)
class TopicInfo:
    """Information on one topic of a bag."""

    type_name: str
    count: int
    schema: Schema
    other_types: frozenset[str] = frozenset()  # further types of the topic's messages, an error


class Source(Protocol):
    """One readable part of a bag."""

    start_ns: int  # log time of the first message
    end_ns: int  # log time of the last message

    def topics(self) -> dict[str, TopicInfo]: ...

    def messages(
        self, names: Collection[str] | None, start_ns: int, stop_ns: int
    ) -> Iterator[BagMessage]: ...

    def close(self) -> None: ...


class WholeBag:
    """A bag, or one file of it, that rosbags can read.

    The topics are those of its files: a ``metadata.yaml`` may be edited or of an earlier version, and rosbags
    omits topics whose QoS profiles differ from it. ``metadata.yaml`` adds topics without messages.
    """

    def __init__(self, path: Path) -> None:
        for packed in path.glob(f"*{PACKED}"):
            unpacking.decompress_file(packed)
        self._reader = Reader(path)
        self._reader.open()
        count = len(self.topics())
        if count > MAX_TOPICS:
            self._reader.close()
            raise ValueError(f"{count} topics; accepted: up to {MAX_TOPICS}")
        self._packed = self._reader.compression_mode == "message"
        self._packed |= path.is_file() and self._has_packed_messages()
        spans = [s.metadata for s in _storages(self._reader) if s.metadata.message_count]
        self.start_ns = min((span.start_time for span in spans), default=0)
        self.end_ns = max((span.end_time for span in spans), default=0) - 1
        self.files = () if self._packed else _mcap_files(self._reader)

    def topics(self) -> dict[str, TopicInfo]:
        recorded = [c for storage in _storages(self._reader) for c in storage.connections]
        infos = [{c.topic: TopicInfo(c.msgtype, c.msgcount, _schema_of(c))} for c in recorded]
        stated = [{c.topic: TopicInfo(c.msgtype, 0, _schema_of(c))} for c in self._reader.connections]
        return merge_topics(infos + stated)

    def messages(self, names: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[BagMessage]:
        for storage in _storages(self._reader):
            connections = [c for c in storage.connections if names is None or c.topic in names]
            if not connections:
                continue
            for connection, time_ns, raw in storage.messages(connections, start_ns, stop_ns):
                yield BagMessage(
                    connection.topic, connection.msgtype, time_ns, unpacking.decompress_message(raw)
                )

    def _has_packed_messages(self) -> bool:
        """Whether messages are compressed one by one; files do not state it, only metadata.yaml does."""
        try:
            return any(unpacking.is_packed(raw) for _, _, raw in islice(self._reader.messages(), 1))
        except Exception:  # noqa: BLE001 (damaged bytes can raise anything in the parser, which reading reports)
            return False

    def close(self) -> None:
        self._reader.close()


def _schema_of(connection: Connection) -> Schema:
    """The definition that a bag has of the type of a topic."""
    definition = connection.msgdef
    return Schema(_ENCODINGS[definition.format], definition.data.encode(), connection.digest)


def _mcap_files(reader: Reader) -> tuple[Path, ...]:
    """The MCAP files of an open bag, as in ``Bag.files``."""
    storages = _storages(reader)
    files = [Path(str(s.path)) for s in storages if isinstance(s, McapReader)]
    return tuple(files) if len(files) == len(storages) else ()


def _storages(reader: Reader) -> list[Any]:
    """The storage of each file of an open bag, in the order recorded: metadata.yaml may list another."""
    storage = reader.storage
    if not isinstance(storage, DirectoryReader):
        return [storage]
    storages: list[Any] = list(storage.storages)
    return sorted(storages, key=lambda one: _split_number(Path(str(one.path))))


class SalvagedFile:
    """The complete messages of an MCAP file that rosbags refuses, usually truncated.

    All messages are in memory: recordings are split long before their size matters. ``problem`` describes
    the damage; empty if the file is complete.

    Raises:
        OSError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        file = DamagedFile(path)
        messages = ((m.log_time, m.channel_id, m.data) for m in file.messages())
        self._messages = sorted(messages, key=itemgetter(0))
        self._topics, self.problem = file.topics, file.problem
        times = [time_ns for time_ns, _, _ in self._messages]
        self.start_ns, self.end_ns = (times[0], times[-1]) if times else (0, -1)

    def topics(self) -> dict[str, TopicInfo]:
        counts = Counter(channel for _, channel, _ in self._messages)
        return merge_topics(
            {topic.topic: TopicInfo(topic.type_name, counts[channel], topic.schema)}
            for channel, topic in self._topics.items()
        )

    def messages(self, names: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[BagMessage]:
        for time_ns, channel, raw in self._messages:
            topic = self._topics[channel]
            if start_ns <= time_ns < stop_ns and (names is None or topic.topic in names):
                yield BagMessage(topic.topic, topic.type_name, time_ns, raw)

    def close(self) -> None:
        pass


def bag_files(path: Path) -> list[Path]:
    """The data files of a bag; split files in numeric order: name_2 before name_10."""
    if not path.is_dir():
        return [path]
    files = [file for suffix in SUFFIXES for file in path.glob(f"*{suffix}") if file.is_file()]
    distinct: dict[tuple[int, int], Path] = {}
    for file in sorted(files, key=_split_number):
        status = file.stat()
        distinct.setdefault((status.st_dev, status.st_ino), file)  # read a file with several links once
    return list(distinct.values())


def _split_number(path: Path) -> tuple[int, str, str]:
    """Sort key of the files of a bag, in the order recorded."""
    number = path.name.removesuffix(PACKED).rpartition("_")[2]
    return len(number), number, path.name


def begins_with(path: Path, magic: bytes) -> bool:
    """Whether a file is readable and begins with ``magic``."""
    try:
        with path.open("rb") as file:
            return file.read(len(magic)) == magic
    except OSError:  # a directory, or not readable
        return False


def open_file(path: Path) -> tuple[Source | None, str]:
    """One file of a bag (None if nothing can be read), and a description of its damage."""
    if path.suffix == PACKED:
        return _open_packed(path)
    try:
        return WholeBag(path), ""
    except Exception as error:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
        reason = error_line(error)
    if begins_with(path, sqlite_files.MAGIC):
        return None, f"{path.name}: {reason}"
    try:
        file = SalvagedFile(path)
    except OSError as error:
        return None, f"{path.name}: {error.strerror}"
    if not file.topics():
        return None, f"{path.name}: {reason}"
    return file, f"{path.name}: {file.problem or reason}"


def _open_packed(path: Path) -> tuple[Source | None, str]:
    """A file that was compressed as a whole; it stays open after its temporary folder is removed."""
    with TemporaryDirectory(prefix="trackslip_") as folder:
        plain = Path(folder, path.stem)
        try:
            with plain.open("wb") as output:
                unpacking.decompress_file(path, output)
        except Exception as error:  # noqa: BLE001 (damaged bytes can raise anything in the library)
            return None, f"{path.name}: {error_line(error)}"
        return open_file(plain)


def merge_topics(parts: Iterable[dict[str, TopicInfo]]) -> dict[str, TopicInfo]:
    """Topics of all parts, counts added."""
    topics: dict[str, TopicInfo] = {}
    for part in parts:
        for name, info in part.items():
            earlier = topics.get(name)
            topics[name] = info if earlier is None else _merge_infos(earlier, info)
    return topics


def _merge_infos(first: TopicInfo, second: TopicInfo) -> TopicInfo:
    """Combined information of two parts of a bag on one topic."""
    types = {first.type_name, second.type_name, *first.other_types, *second.other_types}
    return replace(first, count=first.count + second.count, other_types=frozenset(types - {first.type_name}))


def error_line(error: Exception) -> str:
    """An error's text in one line, or its type if empty."""
    return " ".join(str(error).split()) or type(error).__name__
