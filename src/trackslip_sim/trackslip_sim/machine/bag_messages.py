# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of records for a bag: serialized together per topic, written in the order of arrival."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import absolute_name
from trackslip_bags.writer import BagWriter
from trackslip_common.topics import TOPICS
from trackslip_drivers import conversions
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample, SwingSample
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_sim.machine.message_columns import Columns, MessageColumns, stamp_columns

Serialize = Callable[[Sequence[Any]], Iterable[bytes]]
"""The records of one topic to their messages."""


class Recording:
    """Records to be written; ``serializers`` has the topics whose records are not messages already."""

    def __init__(self, bag: BagWriter, serializers: Mapping[str, Serialize]) -> None:
        self._bag = bag
        self._serializers = serializers
        self._order: list[tuple[str, int]] = []
        self._records: defaultdict[str, list[Any]] = defaultdict(list)

    def add(self, topic: str, record: Any, log_time_ns: int) -> None:
        """Append one record."""
        self._order.append((topic, log_time_ns))
        self._records[topic].append(record)

    def write(self) -> None:
        """Write all added records to the bag and clear them."""
        messages = {
            topic: iter(self._serializers.get(topic, _serialize_each)(records))
            for topic, records in self._records.items()
        }
        channels = {topic: (absolute_name(topic), TOPICS[topic].type_name) for topic in messages}
        for topic, log_time_ns in self._order:
            self._bag.write(*channels[topic], next(messages[topic]), log_time_ns)
        self._order.clear()
        self._records.clear()


def _serialize_each(messages: Sequence[Any]) -> Iterable[bytes]:
    return map(serialize, messages)


def column_serializer(blank: Any, columns: Callable[[Sequence[Any]], Columns]) -> Serialize:
    """A serializer of messages equal to ``blank`` except for the columns of their records."""
    layout = MessageColumns(blank)
    return lambda records: layout.serialize(columns(records))


def sensor_serializers(watson: WatsonParameters, base_frame: str) -> dict[str, Serialize]:
    """Serializers of the drivers' records; the constant fields come from the drivers' conversions."""
    stddevs = (watson.linear_acceleration_stddev, watson.angular_velocity_stddev)
    imu = conversions.blank_imu(make, watson.frame_id, *stddevs)
    field = conversions.blank_magnetic_field(make, watson.frame_id, watson.magnetic_field_stddev)
    return {
        "sprockets": column_serializer(conversions.blank_joint_state(make, base_frame), _sprocket_columns),
        "swing": column_serializer(conversions.blank_swing(make, base_frame), _swing_columns),
        "hydraulics": column_serializer(
            conversions.blank_track_hydraulics(make, base_frame), _hydraulics_columns
        ),
        "imu/data_raw": column_serializer(imu, _imu_columns),
        "imu/mag": column_serializer(field, _field_columns),
    }


def _sprocket_columns(samples: Sequence[SprocketSample]) -> Columns:
    return {
        **stamp_columns([s.stamp_ns for s in samples]),
        "position": np.array([(s.left_position, s.right_position) for s in samples]),
        "velocity": np.array([(s.left_velocity, s.right_velocity) for s in samples]),
    }


def _swing_columns(samples: Sequence[SwingSample]) -> Columns:
    return {
        **stamp_columns([s.stamp_ns for s in samples]),
        "position": np.array([[s.position] for s in samples]),
        "velocity": np.array([[s.velocity] for s in samples]),
    }


def _hydraulics_columns(samples: Sequence[HydraulicsSample]) -> Columns:
    names = ("left_pressure", "right_pressure", "left_spool", "right_spool", "supply_pressure")
    columns = {name: np.array([getattr(s, name) for s in samples]) for name in names}
    return {**stamp_columns([s.stamp_ns for s in samples]), **columns}


def _imu_columns(samples: Sequence[ImuSample]) -> Columns:
    return {
        **stamp_columns([s.stamp_ns for s in samples]),
        **_vector_columns("angular_velocity", [s.angular_velocity for s in samples]),
        **_vector_columns("linear_acceleration", [s.acceleration for s in samples]),
    }


def _field_columns(samples: Sequence[ImuSample]) -> Columns:
    return {
        **stamp_columns([s.stamp_ns for s in samples]),
        **_vector_columns("magnetic_field", [s.magnetic_field for s in samples]),
    }


def _vector_columns(name: str, vectors: Sequence[Any]) -> Columns:
    return dict(zip((f"{name}.x", f"{name}.y", f"{name}.z"), np.array(vectors).T, strict=True))
