# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 bags (MCAP storage) from messages that are serialized already.

A chunk is closed and handed to the operating system at the latest ``CHUNK_SPAN_NS`` of data after it was
begun: a recorder killed at any moment loses no more than that, and the file up to there stays readable.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

from trackslip_common.errors import InputError
from trackslip_estimation.bags.types import ros_distro, schema_text, type_hash

CHUNK_SPAN_NS = 500_000_000
METADATA_VERSION = 9  # of metadata.yaml: Jazzy, Kilted

_NO_QOS = "[]"  # an empty list in metadata.yaml's own terms: ros2 bag plays with default QoS
_NO_START_NS = 2**63 - 1  # rosbag2's starting time of a bag without messages


@dataclass
class _Topic:
    """What is known of one topic while its bag is being written."""

    type_name: str
    type_hash: str
    qos_yaml: str
    channel: int
    count: int = 0


class BagWriter:
    """One bag being written: a directory with ``<name>_0.mcap``, and ``metadata.yaml`` once closed.

    Raises:
        InputError: ``path`` exists already or cannot be created.
    """

    def __init__(self, path: Path | str, distro: str | None = None) -> None:
        self.path = Path(path)
        self.distro = distro or ros_distro()
        self.start_ns: int | None = None  # log time of the earliest message
        self.end_ns: int | None = None  # log time of the latest message
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[str, int] = {}
        self._chunk_start_ns: int | None = None
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise InputError(f"bag '{self.path}' exists already; accepted: a path where nothing is") from None
        except OSError as error:
            raise InputError(f"bag '{self.path}' cannot be created ({error.strerror})") from error
        self.file = self.path / f"{self.path.resolve().name}_0.mcap"
        self._stream = self.file.open("xb")
        self._mcap = Writer(self._stream, compression=CompressionType.ZSTD)
        self._mcap.start(profile="ros2", library="trackslip")
        self._stream.flush()

    def add_topic(self, topic: str, type_name: str, qos_yaml: str = "") -> None:
        """Make a topic known before its first message; again with the same type does nothing.

        ``qos_yaml`` is rosbag2's text of the offered QoS profiles (a YAML list, version 9).

        Raises:
            InputError: the type is unknown, or the topic is there with another type.
        """
        known = self._topics.get(topic)
        if known is not None:
            if known.type_name != type_name:
                raise InputError(f"topic '{topic}' is of type {known.type_name} in this bag, not {type_name}")
            return
        digest = type_hash(type_name)
        if type_name not in self._schemas:
            text = schema_text(type_name).encode()
            self._schemas[type_name] = self._mcap.register_schema(type_name, SchemaEncoding.ROS2, text)
        qos = qos_yaml or _NO_QOS
        channel = self._mcap.register_channel(
            topic,
            MessageEncoding.CDR,
            self._schemas[type_name],
            {"offered_qos_profiles": qos, "topic_type_hash": digest},
        )
        self._topics[topic] = _Topic(type_name, digest, qos, channel)

    def write(
        self,
        topic: str,
        type_name: str,
        data: bytes,
        log_time_ns: int,
        publish_time_ns: int | None = None,
    ) -> None:
        """Append one serialized (CDR) message as it is; its topic is added where it is new.

        Raises:
            InputError: as ``add_topic``.
        """
        known = self._topics.get(topic)
        if known is None or known.type_name != type_name:
            self.add_topic(topic, type_name)
            known = self._topics[topic]
        if self._chunk_start_ns is None:
            self._chunk_start_ns = log_time_ns
        elif abs(log_time_ns - self._chunk_start_ns) >= CHUNK_SPAN_NS:  # either way: clocks get set
            self.flush()
            self._chunk_start_ns = log_time_ns
        publish_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        self._mcap.add_message(known.channel, log_time_ns, data, publish_ns)
        known.count += 1
        self.start_ns = log_time_ns if self.start_ns is None else min(self.start_ns, log_time_ns)
        self.end_ns = log_time_ns if self.end_ns is None else max(self.end_ns, log_time_ns)

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system: for a recorder whose topics fall silent."""
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self._chunk_start_ns = None

    @property
    def counts(self) -> dict[str, int]:
        """Messages written, per topic."""
        return {name: topic.count for name, topic in self._topics.items()}

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; closing again does nothing."""
        if self._stream.closed:
            return
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        unfinished = self.path / "metadata.yaml.tmp"
        unfinished.write_text(yaml.safe_dump(self._metadata(), sort_keys=False), encoding="utf-8")
        unfinished.replace(self.path / "metadata.yaml")

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _metadata(self) -> dict[str, Any]:
        """What ``ros2 bag`` reads first of all."""
        information = {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **self._extent(),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": name,
                        "type": topic.type_name,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": yaml.safe_load(topic.qos_yaml),
                        "type_description_hash": topic.type_hash,
                    },
                    "message_count": topic.count,
                }
                for name, topic in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.file.name],
            "files": [{"path": self.file.name, **self._extent()}],
            "custom_data": None,
            "ros_distro": self.distro,
        }
        return {"rosbag2_bagfile_information": information}

    def _extent(self) -> dict[str, Any]:
        """Time and size, which ``metadata.yaml`` states for the bag and again for its file."""
        start_ns = _NO_START_NS if self.start_ns is None else self.start_ns
        return {
            "duration": {"nanoseconds": 0 if self.end_ns is None else self.end_ns - start_ns},
            "starting_time": {"nanoseconds_since_epoch": start_ns},
            "message_count": sum(topic.count for topic in self._topics.values()),
        }
