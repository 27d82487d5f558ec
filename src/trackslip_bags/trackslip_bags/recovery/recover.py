# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the readable part of a damaged bag to a new one, with a new index and ``metadata.yaml``."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import yaml
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


class _RecoveredMessage(NamedTuple):
    """One complete message."""

    topic: SalvagedTopic
    log_time_ns: int
    publish_time_ns: int
    data: bytes


# Messages of one file, then all its topics, also empty ones.
RecoveredItems = Iterator[_RecoveredMessage | SalvagedTopic]
# Reads one file; calls its argument with each share read.
ReadPart = Callable[[Callable[[float], None]], RecoveredItems]


def recover(path: Path, output: Path, advance: Callable[[float], None] = lambda _: None) -> Recovery:
    """Write the readable part of the bag at ``path`` to a new bag; ``path`` stays unchanged.

    Args:
        path: a bag's directory, or one file of it.
        output: the directory to create.
        advance: called with the share of the bag read since its last call.

    Raises:
        InputError: there is no bag at ``path``, or ``output`` exists or cannot be written.
    """
    recovery = Recovery(stated=_stated_count(path))
    parts = _part_readers(path, recovery)

    def advance_in_part(share: float) -> None:
        advance(share / len(parts))

    bag = BagWriter(output)
    try:
        with bag:
            for k, part in enumerate(parts):
                if k > 0:
                    bag.split()
                _copy(part(advance_in_part), bag, recovery)
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)  # a partial recovery would look complete
        raise
    return recovery


def _part_readers(path: Path, recovery: Recovery) -> list[ReadPart]:
    """One reading function per MCAP file; a single one for other bags."""
    if not path.exists():
        raise InputError(f"bag '{path}' not found; accepted: {ACCEPTED}")
    refuse_pipes(path)
    files = bag_files(path)
    mcap_files = [file for file in files if begins_with(file, MAGIC)]
    if mcap_files and not any(file.suffix == PACKED for file in files):
        return [partial(_read_mcap, file, recovery) for file in mcap_files]
    return [partial(_read_other_bag, open_bag(path), recovery)]


def _read_mcap(path: Path, recovery: Recovery, advance: Callable[[float], None]) -> RecoveredItems:
    file = DamagedFile(path)
    problem, reported = "", 0.0
    try:
        for message in file.messages():
            if file.share_read > reported:  # chunk by chunk
                advance(file.share_read - reported)
                reported = file.share_read
            topic = file.topics[message.channel_id]
            yield _RecoveredMessage(topic, message.log_time, message.publish_time, message.data)
    except OSError as error:  # a bad disk: earlier messages are kept
        problem = error.strerror or "unreadable"
    advance(1.0 - reported)
    yield from file.topics.values()
    recovery.truncated_files += file.is_truncated
    recovery.lost_bytes += file.lost_bytes
    if problem or file.problem:
        recovery.problems.append(f"{path.name}: {problem or file.problem}")


def _read_other_bag(bag: Bag, recovery: Recovery, advance: Callable[[float], None]) -> RecoveredItems:
    """Messages of SQLite files, which SQLite repairs when it opens them, or of compressed files."""
    topics = {name: _topic(name, info) for name, info in bag.topics.items()}
    if bag.damage:
        recovery.problems.append(bag.damage)
    with bag:
        try:
            for k, message in enumerate(bag.messages()):
                if k > 0 and k % _PROGRESS_STEP == 0:
                    advance(_PROGRESS_STEP / bag.message_count)
                yield _RecoveredMessage(
                    topics[message.topic], message.log_time_ns, message.log_time_ns, message.raw
                )
        except InputError as error:
            recovery.problems.append(str(error))
    yield from topics.values()


def _topic(name: str, info: TopicInfo) -> SalvagedTopic:
    """A topic as in MCAP; old bags without definitions get those known here."""
    schema = info.schema
    if not schema.encoding:
        with suppress(InputError):  # unknown type: the bytes are kept all the same
            schema = own_schema(info.type_name)
    return SalvagedTopic(name, info.type_name, schema, "")


def _copy(part: RecoveredItems, bag: BagWriter, recovery: Recovery) -> None:
    for item in part:
        topic = item.topic if isinstance(item, _RecoveredMessage) else item
        try:
            if topic.topic not in bag.topics:
                bag.add_topic(topic.topic, topic.type_name, _current_qos(topic.qos_yaml), topic.schema)
            if isinstance(item, _RecoveredMessage):
                _write(item, bag, recovery)
        except InputError:  # the topic exists with another type
            recovery.rejected += isinstance(item, _RecoveredMessage)


def _write(message: _RecoveredMessage, bag: BagWriter, recovery: Recovery) -> None:
    if not message.data.startswith(_CDR):
        recovery.rejected += 1
        return
    topic = message.topic
    bag.write(topic.topic, topic.type_name, message.data, message.log_time_ns, message.publish_time_ns)
    recovery.messages += 1


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
