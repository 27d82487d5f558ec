# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Reads bags: rosbag2 directories (MCAP, SQLite; compressed or not), bare files, and damaged MCAP.

Returned topic names are those of the bag, which are absolute (``/sprockets``) in recorded bags. In arguments,
``sprockets`` and ``/sprockets`` are equivalent.
"""

import heapq
from collections.abc import Iterable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

from rosbags.typesys.store import Typestore

from trackslip_bags.metadata import METADATA, Schema, check_metadata
from trackslip_bags.namespace import NamespaceView, machine_namespaces
from trackslip_bags.sources import (
    BagMessage,
    Source,
    TopicInfo,
    WholeBag,
    bag_files,
    begins_with,
    error_line,
    merge_topics,
    open_file,
)
from trackslip_bags.types import decode, store_for
from trackslip_common.errors import InputError, did_you_mean, joined_names

_ROS1 = b"#ROSBAG"
ACCEPTED = "a rosbag2 directory (metadata.yaml with .mcap or .db3), or an .mcap or .db3 file"


class Bag:
    """An open bag.

    ``damage`` describes the damage in a few words; empty without damage. ``files`` are its MCAP files if all
    of its files are plain MCAP.
    """

    def __init__(
        self, path: Path, sources: list[Source], damage: str = "", files: tuple[Path, ...] = ()
    ) -> None:
        self.path = path
        self.damage = damage
        self.files = files
        self.sources = sources
        self._stores: dict[str, Typestore] = {}
        self.topics: dict[str, TopicInfo] = merge_topics(source.topics() for source in sources)
        filled = [source for source in sources if source.end_ns >= source.start_ns]
        self.start_ns = min((source.start_ns for source in filled), default=0)
        self.end_ns = max((source.end_ns for source in filled), default=0)

    @property
    def message_count(self) -> int:
        """Number of messages of all topics."""
        return sum(info.count for info in self.topics.values())

    @property
    def duration_s(self) -> float:
        """Time from the first to the last message, s."""
        return (self.end_ns - self.start_ns) * 1e-9

    def matching_topics(self, topics: Iterable[str]) -> list[str]:
        """The topics of the bag among these, as the bag names and orders them."""
        names = {absolute_name(topic) for topic in topics}
        return [topic for topic in self.topics if absolute_name(topic) in names]

    def messages(
        self,
        topics: Iterable[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Messages in log order; messages of equal log time in the order written.

        Args:
            topics: the requested topics; None: all.
            start_ns: log time of the earliest requested message.
            stop_ns: log time before which all requested messages lie.

        Raises:
            InputError: the bag is damaged inside.
        """
        requested = None if topics is None else frozenset(self.matching_topics(topics))
        first = self.start_ns if start_ns is None else start_ns
        stop = self.end_ns + 1 if stop_ns is None else stop_ns
        parts = [source.messages(requested, first, stop) for source in self.sources]
        try:
            yield from parts[0] if len(parts) == 1 else heapq.merge(*parts, key=attrgetter("log_time_ns"))
        except Exception as error:
            text = (
                f"bag '{self.path}' is damaged inside ({error_line(error)}); trackslip recover saves the rest"
            )
            raise InputError(text) from error

    def deserialize(self, raw: bytes, type_name: str) -> Any:
        """A message object (a dataclass of rosbags), by the bag's own definition of its type.

        Raises:
            InputError: the type is defined neither in the bag nor here, or ``raw`` is not of this type.
        """
        store = self.store(type_name)
        try:
            return decode(store, raw, type_name)
        except Exception as error:
            raise InputError(f"bag '{self.path}': bad {type_name} ({error_line(error)})") from error

    def store(self, type_name: str) -> Typestore:
        """The type store that reads a type by the bag's own definition.

        Raises:
            InputError: the type is defined neither in the bag nor here, or its definition cannot be parsed.
        """
        try:
            if type_name not in self._stores:
                schemas = (info.schema for info in self.topics.values() if info.type_name == type_name)
                self._stores[type_name] = store_for(type_name, next(schemas, Schema("", b"")))
            return self._stores[type_name]
        except InputError as error:
            raise InputError(f"bag '{self.path}': {error}") from error
        except Exception as error:
            raise InputError(f"bag '{self.path}': bad {type_name} ({error_line(error)})") from error

    def close(self) -> None:
        """Close the files."""
        for source in self.sources:
            source.close()
        self.sources = []

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_bag(path: Path | str, namespace: str = "") -> Bag:
    """Open any bag; the readable part of a damaged one, described by ``damage``.

    With a ``namespace``, only its topics are visible, named without it.

    Raises:
        InputError: there is no bag, it is of another kind, or nothing of it can be read.
    """
    bag = _open(path)
    return in_namespace(bag, namespace) if namespace else bag


def in_namespace(bag: Bag, namespace: str) -> Bag:
    """One machine's part of an open bag, with topic names relative to the namespace.

    Raises:
        InputError: the namespace has no topics; names those of the machines of the bag.
    """
    if not any(topic.startswith(f"/{namespace.strip('/')}/") for topic in bag.topics):
        machines = ", ".join(filter(None, machine_namespaces(bag.topics)))
        accepted = machines or "none: no machine of the bag has a namespace"
        raise InputError(f"--namespace {namespace}: nothing is in it; accepted: {accepted}")
    return Bag(bag.path, [NamespaceView(source, namespace) for source in bag.sources], bag.damage)


def _open(path: Path | str) -> Bag:
    path = Path(path)
    if not path.exists():
        raise InputError(f"bag '{path}' not found; accepted: {ACCEPTED}")
    refuse_pipes(path)
    if begins_with(path, _ROS1):
        raise InputError(f"bag '{path}' is of ROS 1: trackslip import converts it (docs/import.md)")
    try:
        if (path / METADATA).exists():
            check_metadata(path)
        source = WholeBag(path)
        return Bag(path, [source], files=source.files)
    except Exception as error:  # noqa: BLE001 (foreign bytes can raise anything in the parsers)
        indexed = path.is_file() or (path / METADATA).exists()
        reason = error_line(error) if indexed else "no metadata.yaml"
        missing = reason if indexed and isinstance(error, FileNotFoundError) else ""
    parts = [open_file(file) for file in bag_files(path)]
    sources = [source for source, _ in parts if source is not None]
    notes = "; ".join(filter(None, (missing, *(note for _, note in parts)))) or reason
    if not sources:
        raise InputError(f"bag '{path}' cannot be read ({notes}); accepted: {ACCEPTED}")
    return Bag(path, sources, notes)


def refuse_pipes(path: Path) -> None:
    """Refuse pipes and devices, which may have no end.

    Raises:
        InputError: the path, or a file in it, is neither a regular file nor a directory.
    """
    for file in (path, *(path.iterdir() if path.is_dir() else ())):
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise InputError(
                f"bag '{path}' cannot be read ('{file}' is no regular file); accepted: {ACCEPTED}"
            )


def require_one_type(bag: Bag, topics: Iterable[str]) -> None:
    """Check that each topic has one message type: fields are read by one definition.

    Raises:
        InputError: a topic has several types; names them.
    """
    for topic in topics:
        info = bag.topics[topic]
        if info.other_types:
            types = " and ".join(sorted({info.type_name, *info.other_types}))
            raise InputError(
                f"bag '{bag.path}': {topic} has messages of several types ({types}); accepted: one"
            )


def require_topics(bag: Bag, required: Iterable[str]) -> None:
    """Check that a bag has messages on the required topics.

    Raises:
        InputError: topics are missing or empty; names them and the existing ones.
    """
    present = {absolute_name(topic) for topic, info in bag.topics.items() if info.count}
    missing = sorted(absolute_name(topic) for topic in required if absolute_name(topic) not in present)
    if missing:
        namespaces = sorted(name.removesuffix(missing[0]) for name in present if name.endswith(missing[0]))
        if namespaces:
            inside = joined_names(name.strip("/") for name in namespaces)
            there = f"; namespaces with it: {inside} (--namespace {namespaces[0].strip('/')})"
        else:
            there = did_you_mean(missing[0], present)
            there = there or f"; it holds: {joined_names(sorted(present)) or 'nothing'}"
        raise InputError(f"bag '{bag.path}' has no messages on {', '.join(missing)}{there}")


def absolute_name(topic: str) -> str:
    """The absolute form of a topic name; relative names are those of the root namespace."""
    return topic if topic.startswith("/") else f"/{topic}"
