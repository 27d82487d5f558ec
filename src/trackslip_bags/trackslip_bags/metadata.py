# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``metadata.yaml`` of a bag, read first by ``ros2 bag``: content of the bag and of each file."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import yaml

from trackslip_common.errors import joined_names

METADATA = "metadata.yaml"  # in the directory of each bag
METADATA_VERSION = 9  # Jazzy, Kilted

MAX_TOPICS = 4096  # limit per bag; recordings have some hundreds
MAX_FILES = 10_000  # limit per bag
_LARGEST = 16_000_000  # bytes, limit of the text
_TIMES = (("starting_time", "nanoseconds_since_epoch"), ("duration", "nanoseconds"))
_TOPICS, _FILES = "topics_with_message_count", "relative_file_paths"

LATEST_NS = 2**63 - 1  # year 2262: rosbag2's times are signed
_NO_START_NS = LATEST_NS  # rosbag2's starting time of an empty bag


ROS2MSG, IDL = "ros2msg", ("ros2idl", "omgidl")  # encodings of definitions that are read


class Schema(NamedTuple):
    """The definition of a message type as MCAP carries it."""

    encoding: str  # ROS2MSG or one of IDL; empty if unknown
    data: bytes
    type_hash: str = ""  # RIHS01; empty if unknown


@dataclass
class Topic:
    """One topic of a bag and its number of messages."""

    type_name: str
    schema: Schema
    qos_yaml: str  # the offered profiles, a YAML list
    count: int = 0


@dataclass
class Extent:
    """Log times and number of messages."""

    start_ns: int = _NO_START_NS
    end_ns: int = 0
    count: int = 0

    def add(self, log_time_ns: int) -> None:
        """Include one message."""
        if log_time_ns < self.start_ns:
            self.start_ns = log_time_ns
        if log_time_ns > self.end_ns:
            self.end_ns = log_time_ns
        self.count += 1

    def as_yaml(self) -> dict[str, Any]:
        """The entries of ``metadata.yaml`` for a bag or a file."""
        return {
            "duration": {"nanoseconds": max(self.end_ns - self.start_ns, 0)},
            "starting_time": {"nanoseconds_since_epoch": self.start_ns},
            "message_count": self.count,
        }


def metadata_text(topics: Mapping[str, Topic], files: Mapping[str, Extent], distro: str) -> str:
    """Text of ``metadata.yaml``; topics by name, files by name in the order written."""
    information = {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        **_total_extent(files.values()).as_yaml(),
        "topics_with_message_count": [_topic_entry(name, topic) for name, topic in topics.items()],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(files),
        "files": [{"path": name, **extent.as_yaml()} for name, extent in files.items()],
        "custom_data": None,
        "ros_distro": distro,
    }
    tree = {"rosbag2_bagfile_information": information}
    text: str = yaml.dump(tree, Dumper=yaml.CSafeDumper, sort_keys=False)
    return text


def check_metadata(bag: Path) -> None:
    """Check a bag's ``metadata.yaml`` before any file that it names is opened.

    Its times are not used, since the files state their own; invalid times show damage.

    Raises:
        ValueError: it is too large, names a file twice, or has invalid topics or times.
        FileNotFoundError: files that it names are missing.
        OSError: it cannot be read.
    """
    path = bag / METADATA
    if path.stat().st_size > _LARGEST:
        raise ValueError(f"{METADATA} has more than {_LARGEST // 10**6} MB")
    with path.open("rb") as file:
        tree = yaml.load(file, Loader=yaml.CSafeLoader)
    information = tree.get("rosbag2_bagfile_information") if isinstance(tree, dict) else None
    if not isinstance(information, dict):
        raise ValueError(f"{METADATA}: no rosbag2_bagfile_information")
    version = information.get("version")
    if isinstance(version, int) and version > METADATA_VERSION:
        raise ValueError(
            f"{METADATA} has version {version} (accepted: up to {METADATA_VERSION}): it is not used"
        )
    for group, name in _TIMES:
        stated = information.get(group)
        time_ns = stated.get(name) if isinstance(stated, dict) else stated
        if type(time_ns) is not int or not 0 <= time_ns <= LATEST_NS:
            raise ValueError(f"{METADATA}: {group}: {time_ns!r:.40}; accepted: {name}, 0 to {LATEST_NS}")
    _read_list({"files": [], **information}, "files", MAX_FILES)
    _check_topics(_read_list(information, _TOPICS, MAX_TOPICS))
    _check_files(bag, _read_list(information, _FILES, MAX_FILES))


def _read_list(information: Mapping[str, Any], name: str, max_length: int) -> list[Any]:
    entries = information.get(name)
    if not isinstance(entries, list) or len(entries) > max_length:
        size = f"{len(entries)} entries" if isinstance(entries, list) else "no list"
        raise ValueError(f"{METADATA}: {name}: {size}; accepted: a list of up to {max_length}")
    return entries


def _check_topics(topics: Iterable[Any]) -> None:
    for topic in topics:
        entry = topic.get("topic_metadata") if isinstance(topic, dict) else None
        if not isinstance(entry, dict):
            raise ValueError(f"{METADATA}: {topic!r:.40}; accepted: a topic with its topic_metadata")
        count = topic.get("message_count")
        if type(count) is not int or not 0 <= count < 2**63:
            raise ValueError(f"{METADATA}: message_count: {count!r:.40}; accepted: a whole number, 0 or more")
        for name in ("name", "type"):
            if not isinstance(entry.get(name), str):
                raise ValueError(f"{METADATA}: {name}: {entry.get(name)!r:.40}; accepted: a text")


def _check_files(bag: Path, files: Iterable[Any]) -> None:
    """Raise if a file is listed twice, under any name, or if files are missing."""
    seen: set[tuple[int, int]] = set()
    missing = []
    for name in files:
        if not isinstance(name, str) or not name or "\0" in name:
            raise ValueError(f"{METADATA}: {_FILES}: {name!r:.40}; accepted: names of files")
        file = bag / PurePath(name).name  # as rosbags resolves the name
        if not file.exists():
            missing.append(file.name)
            continue
        status = file.stat()
        if (status.st_dev, status.st_ino) in seen:
            raise ValueError(f"{METADATA}: {_FILES}: '{name:.200}' is there twice; accepted: each file once")
        seen.add((status.st_dev, status.st_ino))
    if missing:
        raise FileNotFoundError(
            f"{joined_names(missing)} missing, which {METADATA} lists: copy what was recorded into the folder"
        )


def _total_extent(extents: Iterable[Extent]) -> Extent:
    total = Extent()
    for extent in extents:
        total.start_ns = min(total.start_ns, extent.start_ns)
        total.end_ns = max(total.end_ns, extent.end_ns)
        total.count += extent.count
    return total


def _topic_entry(name: str, topic: Topic) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": yaml.load(topic.qos_yaml, Loader=yaml.CSafeLoader),
            "type_description_hash": topic.schema.type_hash,
        },
        "message_count": topic.count,
    }
