# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A machine with its own driver: joint states of four wheels, and a base controller's speeds, live."""

import pytest
from fixtures.own_node import started
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from trackslip_drivers.nodes.wheel_adapter import WheelAdapterNode

WHEELS = ["fl", "fr", "rl", "rr"]


def send(observer, kind, topic, message, received):
    publisher = observer.node.create_publisher(kind, topic, 10)
    observer.wait_for_ends(topic, "wheel_adapter")
    observer.wait_until_active("wheel_adapter")

    def answered():
        publisher.publish(message)
        return received

    observer.wait(answered, "sprockets")
    return received[-1]


def test_four_wheels(programs, observer):
    programs.node("wheel_adapter", left_joints=["fl", "rl"], right_joints=["fr", "rr"], joint_ratio=2.0)
    received = observer.subscribe("sprockets")
    message = JointState(name=WHEELS, position=[2.0, 4.0, 4.0, 8.0], velocity=[1.0, 2.0, 1.0, 2.0])
    message.header.stamp.sec = 17
    sprockets = send(observer, JointState, "joint_states", message, received)
    assert list(sprockets.name) == ["left_sprocket", "right_sprocket"]
    assert list(sprockets.position) == [1.5, 3.0]
    assert list(sprockets.velocity) == [0.5, 1.0]
    assert sprockets.header.stamp.sec == 17


@pytest.mark.parametrize("kind", [Odometry, Twist])
def test_base_controller(programs, observer, kind):
    name = kind.__name__.lower()
    radius = {"vehicle.kinematics.rolling_radius": 0.5}
    programs.node("wheel_adapter", message=name, topic="base", wheel_separation=1.0, **radius)
    received = observer.subscribe("sprockets")
    message = kind()
    twist = message.twist.twist if kind is Odometry else message
    twist.linear.x, twist.angular.z = 1.0, 0.5
    sprockets = send(observer, kind, "base", message, received)
    assert list(sprockets.velocity) == pytest.approx([1.5, 2.5])
    assert (sprockets.header.stamp.sec > 0) == (kind is Twist)


def test_joints_of_other_names_are_named(domain):
    with started(WheelAdapterNode, domain) as node:
        node._on_message(JointState(name=["track_l", "track_r"], velocity=[1.0, 1.0]))
        (health,) = node.health()
        assert health.message == "all rejected: lacks a joint, as they are track_l, track_r"
