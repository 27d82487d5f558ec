# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the readable part of a damaged bag to a new one, with a new index and ``metadata.yaml``."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from mcap.records import Message
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from trackslip_bags.metadata import METADATA
from trackslip_bags.reader import ACCEPTED, Bag, open_bag, refuse_pipes
from trackslip_bags.recovery.salvage import MAGIC, DamagedFile, SalvagedTopic
from trackslip_bags.sources import PACKED, TopicInfo, bag_files, begins_with
from trackslip_bags.writer import BagWriter, own_schema
from trackslip_common.errors import InputError
from trackslip_common.yaml_text import MAX_CHARACTERS, parse_yaml

_CDR = b"\0"  # first byte of every CDR message
_PROGRESS_STEP = 1000  # messages between two progress reports


@dataclass
class Recovery:
    """Counts of recovered and lost data."""

    messages: int = 0
    stated: int | None = None  # messages by ``metadata.yaml``; None without it, as after a killed recorder
    rejected: int = 0  # messages that are not CDR, or of a second type of a topic
    lost_bytes: int = 0  # after the last complete record
    truncated_files: int = 0
    problems: list[str] = field(default_factory=list)  # descriptions, one per damaged file


def recover(path: Path, output: Path, advance: Callable[[float], None] = lambda _: None) -> Recovery:
    """Write the readable part of the bag at ``path`` to a new bag; ``path`` stays unchanged.

    Args:
        path: a bag's directory, or one file of it.
        output: the directory to create.
        advance: called with the share of the bag read since its last call.

    Raises:
        InputError: there is no bag at ``path``, or ``output`` exists or cannot be written.
    """
    if not path.exists():
        raise InputError(f"bag '{path}' not found; accepted: {ACCEPTED}")
    refuse_pipes(path)
    files = bag_files(path)
    mcap_files = [file for file in files if begins_with(file, MAGIC)]
    is_mcap = mcap_files and not any(file.suffix == PACKED for file in files)
    other = None if is_mcap else open_bag(path)
    with BagWriter(output) as bag:
        copy = _Copy(bag, Recovery(stated=_stated_count(path)))
        if other is not None:
            copy.add_other_bag(other, advance)
        for k, file in enumerate(mcap_files if other is None else ()):
            if k > 0:
                bag.split()
            copy.add_mcap(file, lambda share: advance(share / len(mcap_files)))
    return copy.recovery


class _Copy:
    """A new bag, and the counts of what is copied to it."""

    def __init__(self, bag: BagWriter, recovery: Recovery) -> None:
        self._bag, self.recovery = bag, recovery

    def add_mcap(self, path: Path, advance: Callable[[float], None]) -> None:
        """Copy the complete messages of an MCAP file, and all its topics, also empty ones."""
        file, recovery = DamagedFile(path), self.recovery
        reported = 0.0
        unreadable: list[str] = []
        for message in _readable_messages(file, unreadable):
            if file.share_read > reported:  # chunk by chunk
                advance(file.share_read - reported)
                reported = file.share_read
            topic = file.topics[message.channel_id]
            self._write(topic, message.data, message.log_time, message.publish_time)
        advance(1.0 - reported)
        for topic in file.topics.values():
            self._add_topic(topic)
        recovery.truncated_files += file.is_truncated
        recovery.lost_bytes += file.lost_bytes
        if problem := "".join(unreadable) or file.problem:
            recovery.problems.append(f"{path.name}: {problem}")

    def add_other_bag(self, bag: Bag, advance: Callable[[float], None]) -> None:
        """Copy a bag of SQLite files, which SQLite repairs when it opens them, or of compressed files."""
        topics = {name: _topic(name, info) for name, info in bag.topics.items()}
        if bag.damage:
            self.recovery.problems.append(bag.damage)
        with bag:
            try:
                for k, message in enumerate(bag.messages()):
                    if k > 0 and k % _PROGRESS_STEP == 0:
                        advance(_PROGRESS_STEP / bag.message_count)
                    time_ns = message.log_time_ns
                    self._write(topics[message.topic], message.raw, time_ns, time_ns)
            except InputError as error:
                self.recovery.problems.append(str(error))
        for topic in topics.values():
            self._add_topic(topic)

    def _add_topic(self, topic: SalvagedTopic) -> None:
        if topic.topic not in self._bag.topics:
            self._bag.add_topic(topic.topic, topic.type_name, _current_qos(topic.qos_yaml), topic.schema)

    def _write(self, topic: SalvagedTopic, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write a message; one that is no CDR, or of another type than its topic, is rejected."""
        self._add_topic(topic)
        has_type = self._bag.topics[topic.topic].type_name == topic.type_name
        if not has_type or not data.startswith(_CDR):
            self.recovery.rejected += 1
            return
        self._bag.write(topic.topic, topic.type_name, data, log_time_ns, publish_time_ns)
        self.recovery.messages += 1


def _readable_messages(file: DamagedFile, unreadable: list[str]) -> Iterator[Message]:
    """The messages up to an error of the disk, whose reason ``unreadable`` gets."""
    try:
        yield from file.messages()
    except OSError as error:
        unreadable.append(error.strerror or "unreadable")


def _topic(name: str, info: TopicInfo) -> SalvagedTopic:
    """A topic as in MCAP; old bags without definitions get those known here."""
    schema = info.schema
    if not schema.encoding:
        with suppress(InputError):  # unknown type: the bytes are kept all the same
            schema = own_schema(info.type_name)
    return SalvagedTopic(name, info.type_name, schema, "")


def _stated_count(path: Path) -> int | None:
    """Number of messages stated in ``metadata.yaml``; None if unreadable."""
    try:
        with (path / METADATA).open(encoding="utf-8") as file:
            text = file.read(MAX_CHARACTERS + 1)
        count = parse_yaml(text, "metadata")["rosbag2_bagfile_information"]["message_count"]
    except Exception:  # noqa: BLE001 (damaged text can raise anything in the parser)
        return None
    return count if isinstance(count, int) else None


def _current_qos(text: str) -> str:
    """QoS profiles of a bag of any version in the current form; an empty list if unreadable."""
    try:
        profiles = dump_qos_v9(parse_qos(text))
    except Exception:  # noqa: BLE001 (damaged text can raise anything in the parser)
        profiles = []
    return yaml.safe_dump(profiles, sort_keys=False, default_flow_style=False)
