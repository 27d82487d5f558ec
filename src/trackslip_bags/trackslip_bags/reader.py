# SPDX-License-Identifier: Apache-2.0
"""Reads bags: rosbag2 directories (MCAP, SQLite; compressed or not), bare files, and damaged MCAP.

Topic names are given as the bag has them, which is absolute (``/sprockets``) in every recorded bag; where
a name is asked for, ``sprockets`` and ``/sprockets`` mean the same.
"""

import heapq
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys.store import Typestore

from trackslip_bags.metadata import METADATA
from trackslip_bags.recovery.salvage import Salvage, salvage
from trackslip_bags.types import decode, store_for
from trackslip_common.errors import InputError

ACCEPTED = "a rosbag2 directory (metadata.yaml with .mcap or .db3), or an .mcap or .db3 file"


class BagMessage(NamedTuple):
    """One message as recorded; ``raw`` is its CDR form."""

    topic: str
    type_name: str
    log_time_ns: int
    raw: bytes


@dataclass(frozen=True)
class TopicInfo:
    """What a bag holds of one topic."""

    type_name: str
    count: int
    definition: MessageDefinition


class _Source(Protocol):
    """One readable part of a bag."""

    start_ns: int  # log time of the first message
    end_ns: int  # log time of the last message

    def topics(self) -> dict[str, TopicInfo]: ...

    def messages(
        self, wanted: Collection[str] | None, start_ns: int, stop_ns: int
    ) -> Iterator[BagMessage]: ...

    def close(self) -> None: ...


class Bag:
    """An open bag.

    ``damage`` describes in a few words what is wrong with it, and is empty where nothing is. ``files`` are
    the MCAP files of which it consists, if it does and rosbags takes them as they are.
    """

    def __init__(
        self, path: Path, sources: list[_Source], damage: str = "", files: tuple[Path, ...] = ()
    ) -> None:
        self.path = path
        self.damage = damage
        self.files = files
        self._sources = sources
        self._stores: dict[str, Typestore] = {}
        self.topics: dict[str, TopicInfo] = _merged(source.topics() for source in sources)
        filled = [source for source in sources if source.end_ns >= source.start_ns]
        self.start_ns = min((source.start_ns for source in filled), default=0)
        self.end_ns = max((source.end_ns for source in filled), default=0)

    @property
    def message_count(self) -> int:
        """All messages of all topics."""
        return sum(info.count for info in self.topics.values())

    @property
    def duration_s(self) -> float:
        """From the first message to the last, s."""
        return (self.end_ns - self.start_ns) * 1e-9

    def messages(
        self,
        topics: Iterable[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Messages in log order, those logged at the same time in the order written.

        Args:
            topics: the topics wanted; all where None.
            start_ns: log time of the earliest message wanted.
            stop_ns: log time before which all wanted messages lie.

        Raises:
            InputError: the bag turns out to be damaged inside.
        """
        names = None if topics is None else {absolute(topic) for topic in topics}
        wanted = None if names is None else {topic for topic in self.topics if absolute(topic) in names}
        first = self.start_ns if start_ns is None else start_ns
        stop = self.end_ns + 1 if stop_ns is None else stop_ns
        parts = [source.messages(wanted, first, stop) for source in self._sources]
        try:
            yield from parts[0] if len(parts) == 1 else heapq.merge(*parts, key=attrgetter("log_time_ns"))
        except Exception as error:
            text = f"bag '{self.path}' is damaged inside ({_line(error)}); trackslip recover saves the rest"
            raise InputError(text) from error

    def deserialize(self, raw: bytes, type_name: str) -> Any:
        """A message object (a dataclass of rosbags), by the bag's own definition of its type.

        Raises:
            InputError: the type is defined neither in the bag nor here, or ``raw`` is not of it.
        """
        store = self.store(type_name)
        try:
            return decode(store, raw, type_name)
        except Exception as error:
            raise InputError(f"bag '{self.path}': bad {type_name} ({_line(error)})") from error

    def store(self, type_name: str) -> Typestore:
        """What reads a type, by the bag's own definition of it.

        Raises:
            InputError: the type is defined neither in the bag nor here, or its definition cannot be parsed.
        """
        try:
            if type_name not in self._stores:
                self._stores[type_name] = store_for(type_name, self._definition(type_name))
            return self._stores[type_name]
        except InputError as error:
            raise InputError(f"bag '{self.path}': {error}") from error
        except Exception as error:
            raise InputError(f"bag '{self.path}': bad {type_name} ({_line(error)})") from error

    def close(self) -> None:
        """Close the files."""
        for source in self._sources:
            source.close()
        self._sources = []

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _definition(self, type_name: str) -> MessageDefinition:
        for info in self.topics.values():
            if info.type_name == type_name:
                return info.definition
        return MessageDefinition(MessageDefinitionFormat.NONE, "")


def open_bag(path: Path | str) -> Bag:
    """Open any bag; a recording that was killed opens with what is whole of it, and says so in ``damage``.

    Raises:
        InputError: there is none, it is of another kind, or nothing of it can be read.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"bag '{path}' not found; accepted: {ACCEPTED}")
    try:
        whole = _Whole(path)
        return Bag(path, [whole], files=whole.files)
    except Exception as error:  # noqa: BLE001 (foreign bytes can raise anything in the parsers)
        indexed = path.is_file() or (path / METADATA).exists()
        reason = _line(error) if indexed else "no metadata.yaml"
    parts = [_open_file(file) for file in bag_files(path)]
    sources = [source for source, _ in parts if source is not None]
    if not sources:
        raise InputError(f"bag '{path}' cannot be read ({reason}); accepted: {ACCEPTED}")
    return Bag(path, sources, "; ".join(note for _, note in parts if note) or reason)


def require_topics(bag: Bag, required: Iterable[str]) -> None:
    """Check that a bag holds what a task needs.

    Raises:
        InputError: topics are missing or empty; names them and those that are there.
    """
    present = {absolute(topic) for topic, info in bag.topics.items() if info.count}
    missing = sorted(absolute(topic) for topic in required if absolute(topic) not in present)
    if missing:
        there = ", ".join(sorted(present)) or "nothing"
        raise InputError(f"bag '{bag.path}' has no messages on {', '.join(missing)}; it holds: {there}")


def absolute(topic: str) -> str:
    """A relative topic name as it is in the root namespace; an absolute one unchanged."""
    return topic if topic.startswith("/") else f"/{topic}"


class _Whole:
    """A bag, or one file of it, that rosbags reads."""

    def __init__(self, path: Path) -> None:
        self._reader = Reader(path)
        self._reader.open()
        self.start_ns = self._reader.start_time
        self.end_ns = self._reader.end_time - 1
        self.files = _mcap_files(self._reader)

    def topics(self) -> dict[str, TopicInfo]:
        return _merged(
            {c.topic: TopicInfo(c.msgtype, c.msgcount, c.msgdef)} for c in self._reader.connections
        )

    def messages(self, wanted: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[BagMessage]:
        connections = [c for c in self._reader.connections if wanted is None or c.topic in wanted]
        if not connections:
            return
        for connection, time_ns, raw in self._reader.messages(connections, start_ns, stop_ns):
            yield BagMessage(connection.topic, connection.msgtype, time_ns, raw)

    def close(self) -> None:
        self._reader.close()


def _mcap_files(reader: Reader) -> tuple[Path, ...]:
    """The files of an open bag, as ``Bag.files`` has them."""
    storage = reader.storage
    storages = storage.storages if isinstance(storage, DirectoryReader) else [storage]
    files = [Path(str(s.path)) for s in storages if isinstance(s, McapReader)]
    is_plain = len(files) == len(storages) and reader.compression_mode != "message"
    return tuple(files) if is_plain else ()


class _Salvaged:
    """An MCAP file that rosbags refuses: cut short, as a rule."""

    def __init__(self, content: Salvage) -> None:
        self._content = content
        times = [time_ns for time_ns, _, _ in content.messages]
        self.start_ns, self.end_ns = (times[0], times[-1]) if times else (0, -1)

    def topics(self) -> dict[str, TopicInfo]:
        counts = dict.fromkeys(self._content.topics, 0)
        for _, channel, _ in self._content.messages:
            counts[channel] += 1
        return _merged(
            {topic.topic: TopicInfo(topic.type_name, counts[channel], topic.definition)}
            for channel, topic in self._content.topics.items()
        )

    def messages(self, wanted: Collection[str] | None, start_ns: int, stop_ns: int) -> Iterator[BagMessage]:
        for time_ns, channel, raw in self._content.messages:
            topic = self._content.topics[channel]
            if start_ns <= time_ns < stop_ns and (wanted is None or topic.topic in wanted):
                yield BagMessage(topic.topic, topic.type_name, time_ns, raw)

    def close(self) -> None:
        pass


def bag_files(path: Path) -> list[Path]:
    """The files of a bag without its metadata, split recordings in order: name_2 before name_10."""
    if not path.is_dir():
        return [path]
    files = [file for pattern in ("*.mcap", "*.db3") for file in path.glob(pattern)]
    numbered = [(file.stem.rpartition("_")[2], file) for file in files]
    return [file for _, file in sorted(numbered, key=lambda item: (len(item[0]), item))]


def _open_file(path: Path) -> tuple[_Source | None, str]:
    """One file of a bag (None where nothing of it can be read), and what is wrong with it."""
    try:
        return _Whole(path), ""
    except Exception as error:  # noqa: BLE001 (damaged bytes can raise anything in the parser)
        reason = _line(error)
    try:
        content = salvage(path)
    except OSError as error:
        return None, f"{path.name}: {error.strerror}"
    note = f"{path.name}: {content.problem or reason}"
    return (_Salvaged(content) if content.topics else None), note


def _merged(parts: Iterable[dict[str, TopicInfo]]) -> dict[str, TopicInfo]:
    """Topics of all parts, counts added."""
    topics: dict[str, TopicInfo] = {}
    for part in parts:
        for name, info in part.items():
            known = topics.get(name)
            topics[name] = (
                info
                if known is None
                else TopicInfo(known.type_name, known.count + info.count, known.definition)
            )
    return topics


def _line(error: Exception) -> str:
    """An error's text in one line; its kind where it has none."""
    return " ".join(str(error).split()) or type(error).__name__
