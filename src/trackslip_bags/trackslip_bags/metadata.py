# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``metadata.yaml``, which ``ros2 bag`` reads first of all: what a bag holds, and each of its files."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import yaml

METADATA = "metadata.yaml"  # in the directory of each bag
METADATA_VERSION = 9  # Jazzy, Kilted

_NO_START_NS = 2**63 - 1  # rosbag2's starting time of what holds no messages


class Schema(NamedTuple):
    """The definition of a message type as MCAP carries it."""

    encoding: str  # "ros2msg" or "ros2idl"; empty where nobody knows the definition
    data: bytes
    type_hash: str  # RIHS01; empty where unknown


@dataclass
class Topic:
    """One topic of a bag, and how many messages it has."""

    type_name: str
    schema: Schema
    qos_yaml: str  # the offered profiles, a YAML list
    count: int = 0


@dataclass
class Extent:
    """From when to when messages were logged, and how many."""

    start_ns: int = _NO_START_NS
    end_ns: int = 0
    count: int = 0

    def add(self, log_time_ns: int) -> None:
        """One more message."""
        if log_time_ns < self.start_ns:
            self.start_ns = log_time_ns
        if log_time_ns > self.end_ns:
            self.end_ns = log_time_ns
        self.count += 1

    def as_yaml(self) -> dict[str, Any]:
        """As ``metadata.yaml`` states it for a bag and again for each file."""
        return {
            "duration": {"nanoseconds": max(self.end_ns - self.start_ns, 0)},
            "starting_time": {"nanoseconds_since_epoch": self.start_ns},
            "message_count": self.count,
        }


def metadata_text(topics: Mapping[str, Topic], files: Mapping[str, Extent], distro: str) -> str:
    """The whole text; topics by name, files by name in the order written."""
    information = {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        **_total(files.values()).as_yaml(),
        "topics_with_message_count": [_topic(name, topic) for name, topic in topics.items()],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(files),
        "files": [{"path": name, **extent.as_yaml()} for name, extent in files.items()],
        "custom_data": None,
        "ros_distro": distro,
    }
    text: str = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
    return text


def _total(extents: Iterable[Extent]) -> Extent:
    total = Extent()
    for extent in extents:
        total.start_ns = min(total.start_ns, extent.start_ns)
        total.end_ns = max(total.end_ns, extent.end_ns)
        total.count += extent.count
    return total


def _topic(name: str, topic: Topic) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": name,
            "type": topic.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": yaml.safe_load(topic.qos_yaml),
            "type_description_hash": topic.schema.type_hash,
        },
        "message_count": topic.count,
    }
