# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that nodes send as bytes equal, byte by byte, those that rclpy sends."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import pytest

from trackslip_bags.messages import make as make_for_bags
from trackslip_bags.messages import serialize
from trackslip_bags.types import ensure_type, fields_by
from trackslip_common.message_buffer import MessageBuffer
from trackslip_common.nodes.messages import fields_of, make, type_name_of
from trackslip_common.nodes.outputs import PackedOutput
from trackslip_common.nodes.qos import reliable_qos
from trackslip_drivers import conversions as of_sensors
from trackslip_drivers.records import HydraulicsSample, ImuSample, SprocketSample, SwingSample
from trackslip_estimation.slip import conversions as of_estimates
from trackslip_estimation.slip.estimator import Estimate, Outputs, Swing, Tilt
from trackslip_estimation.slip.measurements import Outcome, Report
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.transforms import blank_transforms, fill_transforms

STAMP_NS = 1_700_000_000_123_456_789
RANDOM = np.random.default_rng(1)
NUMBERS: list[Any] = [RANDOM.normal(size=n) for n in (3, (3, 3), 3, 3, 3, 3, (3, 3), 3)]
TILT = Tilt(*[*NUMBERS[:5], 0.25])
SWING = Swing(0.5, -0.25, np.diag((0.01, 0.04)))
OUTPUTS = Outputs(*[*NUMBERS[5:], TILT, 0.1, 1e-4, RANDOM.normal(size=3), np.eye(3), SWING])
ESTIMATE = Estimate(STAMP_NS, RANDOM.normal(size=3), RANDOM.normal(size=(3, 3)), OUTPUTS, Motion.TURNING)
LOCAL = Estimate(STAMP_NS, RANDOM.normal(size=3), RANDOM.normal(size=(3, 3)), OUTPUTS, Motion.TURNING)
FRAMES = of_estimates.Frames("map", "odom", "base_link")
SPROCKETS = SprocketSample(STAMP_NS, float("nan"), 2.5, -0.5, 1e-300)
HYDRAULICS = HydraulicsSample(STAMP_NS, 1e7, -2e6, 0.5, -0.25, float("nan"))
IMU = ImuSample(STAMP_NS, (0.1, 0.2, 9.8), (0.3, -0.4, 0.5), (1e-5, 2e-5, -4e-5), over_range=False)
REPORT = Report("box_pose", STAMP_NS, Outcome.GATED, 20.5, 11.3, 3)

Blank: TypeAlias = Callable[[Any], Any]
Fill: TypeAlias = Callable[[Any], None]
FILLED: dict[str, tuple[Blank, Fill]] = {
    "sprockets": (
        lambda make: of_sensors.blank_joint_state(make, "base_link"),
        lambda message: of_sensors.fill_joint_state(message, SPROCKETS),
    ),
    "swing": (
        lambda make: of_sensors.blank_swing(make, "base_link"),
        lambda message: of_sensors.fill_swing(message, SwingSample(STAMP_NS, 0.5, 0.25)),
    ),
    "hydraulics": (
        lambda make: of_sensors.blank_track_hydraulics(make, "base_link"),
        lambda message: of_sensors.fill_track_hydraulics(message, HYDRAULICS),
    ),
    "imu": (
        lambda make: of_sensors.blank_imu(make, "imu_link", 0.1, 0.2),
        lambda message: of_sensors.fill_imu(message, IMU),
    ),
    "magnetic field": (
        lambda make: of_sensors.blank_magnetic_field(make, "imu_link", 0.1),
        lambda message: of_sensors.fill_magnetic_field(message, IMU),
    ),
    "odometry": (
        lambda make: of_estimates.blank_odometry(make, "map", "base_link"),
        lambda message: of_estimates.fill_odometry(message, ESTIMATE),
    ),
    "track slip": (
        lambda make: of_estimates.blank_track_slip(make, "base_link"),
        lambda message: of_estimates.fill_track_slip(message, ESTIMATE),
    ),
    "attitude": (
        lambda make: of_estimates.blank_attitude(make, "base_link"),
        lambda message: of_estimates.fill_attitude(message, ESTIMATE, TILT),
    ),
    "swing estimate": (
        lambda make: of_estimates.blank_swing(make, "base_link"),
        lambda message: of_estimates.fill_swing(message, ESTIMATE, SWING),
    ),
    "machine state": (
        lambda make: of_estimates.blank_machine_state(make, "map", "base_link"),
        lambda message: of_estimates.fill_machine_state(message, ESTIMATE),
    ),
    "report": (
        lambda make: of_estimates.blank_measurement_report(make, "box_pose"),
        lambda message: of_estimates.fill_measurement_report(message, REPORT, 2**40),
    ),
}


@pytest.mark.parametrize("name", FILLED)
def test_a_message_sent_as_bytes_is_what_rclpy_sends(name: str, observer: Any) -> None:
    blank, fill = FILLED[name]
    message, received = blank(make), list[bytes]()
    observer.node.create_subscription(type(message), "line", received.append, reliable_qos(), raw=True)
    publisher = observer.node.create_publisher(type(message), "line", reliable_qos())
    packed = PackedOutput(publisher, blank(make))
    fill(message)
    publisher.publish(message)
    fill(packed.message)
    packed.publish()
    observer.wait(lambda: len(received) == 2, "both")
    of_rclpy = MessageBuffer(type_name_of(type(message)), fields_of, received[0])  # zeros in the padding
    assert bytes(of_rclpy) == received[1]
    assert len(received[0]) == len(received[1])


def buffer_for_bags(blank: Any) -> MessageBuffer:
    type_name = blank.__msgtype__
    return MessageBuffer(type_name, fields_by(ensure_type(type_name)), serialize(blank))


def test_transforms_filled_in_bytes_are_those_of_their_objects() -> None:
    message = blank_transforms(make_for_bags, FRAMES)
    buffer = buffer_for_bags(message)
    for one in (message, buffer.message):
        fill_transforms(one, ESTIMATE, LOCAL)
    assert bytes(buffer) == serialize(message)


def test_buffer_has_the_values_of_the_last_fill() -> None:
    blank = of_sensors.blank_joint_state(make_for_bags, "base_link")
    buffer = buffer_for_bags(blank)
    for sample in (SPROCKETS._replace(left_position=1.0), SPROCKETS):
        of_sensors.fill_joint_state(buffer.message, sample)
        assert bytes(buffer) == serialize(of_sensors.fill_joint_state(blank, sample))
    assert buffer.message.header.stamp.nanosec == STAMP_NS % 10**9


@pytest.mark.parametrize("field", ["name", "no_such_field", "header"])
def test_text_fields_cannot_be_set_in_bytes(field: str) -> None:
    buffer = buffer_for_bags(of_sensors.blank_joint_state(make_for_bags, "base_link"))
    with pytest.raises(AttributeError):
        setattr(buffer.message, field, "other")
