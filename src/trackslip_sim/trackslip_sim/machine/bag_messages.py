# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of records for a bag: serialized together per topic, written in the order of arrival."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from trackslip_bags.messages import make, serialize
from trackslip_bags.reader import absolute_name
from trackslip_bags.types import ensure_type, fields_by
from trackslip_bags.writer import BagWriter
from trackslip_common.message_buffer import MessageBuffer
from trackslip_common.topics import TOPICS
from trackslip_drivers import conversions
from trackslip_drivers.watson_parameters import WatsonParameters
from trackslip_sim.machine.message_columns import Columns, MessageColumns

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
    """Serializers of the drivers' records by the drivers' own conversions."""
    stddevs = (watson.linear_acceleration_stddev, watson.angular_velocity_stddev)
    imu = conversions.blank_imu(make, watson.frame_id, *stddevs)
    field = conversions.blank_magnetic_field(make, watson.frame_id, watson.magnetic_field_stddev)
    joints, swing = conversions.blank_joint_state(make, base_frame), conversions.blank_swing(make, base_frame)
    hydraulics = conversions.blank_track_hydraulics(make, base_frame)
    return {
        "sprockets": _filling_serializer(joints, conversions.fill_joint_state),
        "swing": _filling_serializer(swing, conversions.fill_swing),
        "hydraulics": _filling_serializer(hydraulics, conversions.fill_track_hydraulics),
        "imu/data_raw": _filling_serializer(imu, conversions.fill_imu),
        "imu/mag": _filling_serializer(field, conversions.fill_magnetic_field),
    }


def _filling_serializer(blank: Any, fill: Callable[[Any, Any], object]) -> Serialize:
    """A serializer that fills each record into the bytes of ``blank``, as the nodes of the drivers do."""
    type_name = blank.__msgtype__
    buffer = MessageBuffer(type_name, fields_by(ensure_type(type_name)), serialize(blank))

    def serialize_all(records: Sequence[Any]) -> Iterator[bytes]:
        for record in records:
            fill(buffer.message, record)
            yield bytes(buffer)

    return serialize_all
