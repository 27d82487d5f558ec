# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Packed messages have the same values as their objects, bit for bit."""

import math
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from trackslip_bags.types import ensure_type, fields_by
from trackslip_common.message_fields import (
    RECORDS,
    FrameFields,
    HydraulicsFields,
    OdometryPoseFields,
    OrientationFields,
    SprocketFields,
    SwingFields,
)
from trackslip_common.message_reading import read
from trackslip_common.nodes.messages import fields_of, make, message_class, packed_topic
from trackslip_common.packed import PackedMessage
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET, TOPICS

KINDS = [
    *RECORDS.items(),
    ("sensor_msgs/msg/JointState", SwingFields),
    ("sensor_msgs/msg/Imu", OrientationFields),
    ("nav_msgs/msg/Odometry", OdometryPoseFields),
    ("nav_msgs/msg/Odometry", FrameFields),
]


def packed(message: Any) -> PackedMessage:
    return PackedMessage(serialize_message(message), packed_topic(type(message)))


def with_numbers(message: Any, random: np.random.Generator) -> Any:
    """The message with new values in each field and filled lists."""
    for field in fields_of(type_of(message)):
        value = getattr(message, field.name)
        if hasattr(value, "get_fields_and_field_types"):
            with_numbers(value, random)
        elif field.name == "name":
            message.name = [RIGHT_SPROCKET, LEFT_SPROCKET]
        elif field.type == "string":
            setattr(message, field.name, "abcdefg"[: random.integers(8)])
        elif field.type == "float64":
            setattr(message, field.name, random_floats(field.length, random))
        elif field.type == "bool":
            setattr(message, field.name, True)
        else:
            setattr(message, field.name, int(random.integers(1, 100)))
    return message


def random_floats(length: int | None, random: np.random.Generator) -> Any:
    if length is None:
        return float(random.normal())
    return random.normal(size=length) if length >= 0 else random.normal(size=2).tolist()


def type_of(message: Any) -> str:
    package, kind, _ = type(message).__module__.split(".", 2)
    return f"{package}/{kind}/{type(message).__name__}"


@pytest.mark.parametrize(("type_name", "kind"), KINDS)
def test_a_packed_message_reads_as_its_object(type_name: str, kind: Any) -> None:
    random = np.random.default_rng(1)
    for _ in range(10):
        if type_name.endswith("SoilEstimate"):
            message = make(type_name, mu_r=0.1, reason="abc", identifiable=True, class_probabilities=[0.5])
        else:
            message = with_numbers(make(type_name), random)
        expected, fields = read(kind, message), read(kind, packed(message))
        for one, other in zip(expected, fields, strict=True):
            assert type(one) is type(other)
            np.testing.assert_array_equal(one, other)


def test_a_topic_whose_layout_changes_is_read_on() -> None:
    topic = packed_topic(message_class("sensor_msgs/msg/JointState"))
    for names in ([LEFT_SPROCKET, RIGHT_SPROCKET], [RIGHT_SPROCKET, "boom", LEFT_SPROCKET]) * 2:
        for frame in ("base_link", *map(str, range(40))):
            message = make("sensor_msgs/msg/JointState", name=names, velocity=[1.0, 2.0, 3.0][: len(names)])
            message.header.frame_id = frame
            one = PackedMessage(serialize_message(message), topic)
            assert read(FrameFields, one).frame == frame
            speeds = dict(zip(names, message.velocity, strict=True))
            fields = read(SprocketFields, one)
            assert (fields.left_speed, fields.right_speed) == (speeds[LEFT_SPROCKET], speeds[RIGHT_SPROCKET])
            assert not fields.has_positions
            assert math.isnan(fields.left_position)


def test_a_packed_message_without_a_layout_is_read_by_its_object() -> None:
    array = make("diagnostic_msgs/msg/DiagnosticArray")
    array.header.frame_id = "here"
    array.status = [make("diagnostic_msgs/msg/DiagnosticStatus", name="a")]
    assert read(FrameFields, packed(array)).frame == "here"


def test_a_packed_message_of_another_type_is_refused_as_its_object_is() -> None:
    message = make("sensor_msgs/msg/Imu")
    for form in (message, packed(message)):
        with pytest.raises(AttributeError, match="left_pressure"):
            read(HydraulicsFields, form)


@pytest.mark.parametrize(
    "type_name", sorted({t.type_name for t in TOPICS.values()} - {"tf2_msgs/msg/TFMessage"})
)
def test_rclpy_and_the_definitions_of_bags_state_the_same_fields(type_name: str) -> None:
    assert list(fields_of(type_name)) == list(fields_by(ensure_type(type_name))(type_name))
