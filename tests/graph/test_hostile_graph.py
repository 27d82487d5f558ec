# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A second publisher of an input, messages of a wrong frame, and floods of messages are reported."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from fixtures.observer import Observer
from fixtures.own_node import own_node, started
from fixtures.patience import wait_for
from rclpy.node import Node
from rclpy.serialization import serialize_message

from trackslip_common.nodes.health import ERROR
from trackslip_common.nodes.messages import make, message_class, topic_class
from trackslip_common.nodes.qos import publisher_qos
from trackslip_common.rate_limiter import MAX_BURST
from trackslip_estimation.nodes.box_localizer import BoxLocalizerNode
from trackslip_estimation.nodes.gnss_localizer import GnssLocalizerNode
from trackslip_estimation.nodes.slip_estimator import SlipEstimatorNode
from trackslip_estimation.nodes.soil_estimator import SoilEstimatorNode


@pytest.fixture
def estimator(domain: int) -> Iterator[SlipEstimatorNode]:
    with started(SlipEstimatorNode, domain, sources__box_pose__frame_id="map") as node:
        yield node


@pytest.fixture
def other(estimator: SlipEstimatorNode) -> Iterator[Node]:
    node = rclpy.create_node("other", use_global_arguments=False)
    yield node
    node.destroy_node()


def test_a_second_publisher_of_an_input_is_an_error(estimator: SlipEstimatorNode, other: Node) -> None:
    def publisher(topic: str) -> Any:
        return other.create_publisher(topic_class(topic), topic, publisher_qos(topic))

    publishers = [
        publisher(topic) for topic in ("sprockets", "slip_estimator/set_pose", "slip_estimator/set_pose")
    ]
    wait_for(lambda: estimator.count_publishers("slip_estimator/set_pose") == 2)
    wait_for(lambda: estimator.count_publishers("sprockets") == 1)
    assert estimator.inputs.health() == []
    second = publisher("sprockets")
    wait_for(estimator.inputs.health)
    (health,) = estimator.inputs.health()
    assert (health.level, health.message) == (
        ERROR,
        "several publishers of sprockets (end all but one, or set a namespace for each machine)",
    )
    assert health.values == {"sprockets": 2, "publishers of sprockets": "/other, /other"}
    other.destroy_publisher(second)
    wait_for(lambda: not estimator.inputs.health())
    assert len(publishers) == 3


def test_a_pose_of_another_frame_is_refused_and_counted(estimator: SlipEstimatorNode) -> None:
    (subscription,) = (s for s in estimator.subscriptions if s.topic_name == "/box_pose")
    pose = make("geometry_msgs/msg/PoseWithCovarianceStamped")
    for frame in ("laser", "", "map"):
        pose.header.frame_id = frame
        subscription.callback(serialize_message(pose))
    assert estimator.tally.total["box_pose", "of another frame"] == 2
    assert "box_pose: of another frame" in estimator.health()[0].values


def test_a_publisher_of_another_type_is_an_error_at_a_remapped_topic_too(
    domain: int, observer: Observer
) -> None:
    """A pose without covariance, or the fixes of another driver: no message of it ever arrives."""
    with own_node(GnssLocalizerNode, domain, "-r", "fix:=/gps/fix") as node:
        node.start()
        wrong = observer.node.create_publisher(message_class("geometry_msgs/msg/PoseStamped"), "/gps/fix", 1)
        wait_for(node.inputs.health)
        (health,) = node.inputs.health()
        text = "fix is published as geometry_msgs/msg/PoseStamped; accepted: sensor_msgs/msg/NavSatFix"
        assert (health.level, health.message) == (ERROR, text)
        observer.node.destroy_publisher(wrong)
        wait_for(lambda: not node.inputs.health())
        publishers = [node.create_publisher(topic_class("fix"), "/gps/fix", 1) for _ in range(2)]
        wait_for(lambda: any("several publishers of fix" in one.message for one in node.inputs.health()))
        assert len(publishers) == 2


@pytest.mark.parametrize(
    ("frame", "x", "w", "reason"),
    [
        ("odom", 0.0, 1.0, "its frame is 'odom'"),
        ("map", float("nan"), 1.0, "not_finite"),
        ("map", 0.0, 0.0, "not_finite"),
        ("map", 1e9, 1.0, "out_of_range"),
    ],
)
def test_a_set_pose_that_is_not_used_is_logged(
    estimator: SlipEstimatorNode, frame: str, x: float, w: float, reason: str, capfd: Any
) -> None:
    (subscription,) = (s for s in estimator.subscriptions if s.topic_name == "/slip_estimator/set_pose")
    pose = make("geometry_msgs/msg/PoseWithCovarianceStamped")
    pose.header.frame_id, pose.pose.pose.position.x, pose.pose.pose.orientation.w = frame, x, w
    pose.pose.covariance[:] = np.eye(6).ravel() * 1e-4
    subscription.callback(pose)
    assert (
        f"slip_estimator/set_pose: pose is not used ({reason}); accepted: frame 'map'"
        in capfd.readouterr().err
    )


@pytest.mark.parametrize(
    ("names", "seconds", "reason"),
    [
        (["left", "right"], 5, "not_finite: check names, positions and velocities"),
        (["left_sprocket", "right_sprocket"], 5, "duplicate: check the stamps"),
        (["left_sprocket", "right_sprocket"], 0, "too_late: check the stamps"),
    ],
)
def test_rejected_sprockets_are_an_error_with_their_reason(
    estimator: SlipEstimatorNode, names: list[str], seconds: int, reason: str
) -> None:
    receive = {s.topic_name: s.callback for s in estimator.subscriptions}
    pose = make("geometry_msgs/msg/PoseWithCovarianceStamped")
    pose.header.frame_id, pose.header.stamp.sec = "map", 5
    pose.pose.covariance[:] = np.eye(6).ravel() * 1e-4
    sprockets = make("sensor_msgs/msg/JointState", name=["left_sprocket", "right_sprocket"])
    sprockets.velocity = sprockets.position = [0.0, 0.0]
    sprockets.header.stamp.sec = 5
    receive["/box_pose"](serialize_message(pose))
    receive["/sprockets"](serialize_message(sprockets))
    assert "sprockets rejected" not in estimator.health()[0].message
    sprockets.name, sprockets.header.stamp.sec = names, seconds
    receive["/sprockets"](serialize_message(sprockets))
    estimator._sources._used_s -= 1.0
    health = estimator.health()[0]
    assert (health.level, f"({reason}" in health.message) == (ERROR, True), health.message


def test_stamp_beyond_all_times_is_no_failure(estimator: SlipEstimatorNode) -> None:
    receive = {s.topic_name: s.callback for s in estimator.subscriptions}
    for topic in ("sprockets", "imu/data_raw", "box_pose"):
        message = topic_class(topic)()
        message.header.frame_id = "map"
        message.header.stamp.sec, message.header.stamp.nanosec = 2**31 - 1, 2**32 - 1
        receive[f"/{topic}"](serialize_message(message))
    assert estimator.callback_failures.last == ""


def test_receiver_of_one_hertz_is_not_lost_between_two_fixes(domain: int) -> None:
    with started(GnssLocalizerNode, domain) as node:
        (subscription,) = (s for s in node.subscriptions if s.topic_name == "/fix")
        assert node.health()[0].message == "no fixes"
        fix = make("sensor_msgs/msg/NavSatFix", latitude=48.0, longitude=11.0)
        fix.status.status = 0
        fix.position_covariance, fix.position_covariance_type = np.eye(3).ravel(), 2
        for _ in range(node.settings.datum_fixes):
            subscription.callback(fix)
        node.health()
        subscription.callback(fix)
        assert [node.health()[0].message for _ in range(2)] == ["running", "running"]
        node._silence._last -= 10.0
        assert node.health()[0].message == "no fixes"


def test_slow_scanner_is_not_lost_between_two_scans(domain: int) -> None:
    with started(BoxLocalizerNode, domain) as node:
        (subscription,) = (s for s in node.subscriptions if s.topic_name == "/scan")
        assert node.health()[0].message.startswith("no scans")
        subscription.callback(make("sensor_msgs/msg/LaserScan"))
        texts = {node.health()[0].message for _ in range(2)}
        assert texts == {"box not found; clear the view of the laser"}
        node._silence._last -= 10.0
        assert node.health()[0].message.startswith("no scans")


def test_flood_of_messages_is_dropped_and_its_publisher_named(
    estimator: SlipEstimatorNode, other: Node
) -> None:
    """At 10 kHz the executor still runs timers, and the queue stays bounded."""
    publisher = other.create_publisher(topic_class("box_pose"), "box_pose", publisher_qos("box_pose"))
    wait_for(lambda: estimator.count_publishers("box_pose") == 1)
    (subscription,) = (s for s in estimator.subscriptions if s.topic_name == "/box_pose")
    pose = serialize_message(make("geometry_msgs/msg/PoseWithCovarianceStamped"))
    sent = 2 * round(MAX_BURST)
    for _ in range(sent):
        subscription.callback(pose)
    (health,) = estimator.inputs.health()
    accepted = estimator.tally.total["box_pose", "of another frame"]
    assert health.level == ERROR
    assert health.message == f"{sent - accepted} messages of box_pose were too many"
    assert health.values == {"box_pose dropped": sent - accepted, "publishers of box_pose": "/other"}
    assert accepted >= MAX_BURST
    assert estimator.inputs.health() == []
    other.destroy_publisher(publisher)


def test_inputs_of_the_soil_estimator_stay_observable_beside_its_counters(domain: int) -> None:
    with started(SoilEstimatorNode, domain) as node:
        node.publish_health()
        assert node.inputs.health() == []
        assert node.callback_failures.last == ""
