# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the benchmark: a listener, and bare nodes as the floor of the measurements.

``bench_ros.py NAME`` is a bare rclpy node that publishes the topics of the driver NAME at the same rates,
with constant messages. ``odometry`` publishes stamped odometry at 101 Hz: within a second it covers every
phase of the graph's cycle, busy and idle. ``relay`` replaces the slip estimator: it publishes constant
odometry with the stamp of each sprocket sample.
"""

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor

from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.qos import publisher_qos, subscriber_qos
from trackslip_common.nodes.run import Executor
from trackslip_drivers import conversions
from trackslip_drivers.records import HydraulicsSample, ImuSample, ScanSample, SprocketSample

RATES = {"can_driver": 100.0, "watson_imu": 71.11, "sick_pls": 25.0, "odometry": 101.0}
FLOOR = "floor/"  # prefix of its topics


class Listener:
    """Counts messages on topics; on odometry topics it stores the age of each message."""

    def __init__(self, topics: tuple[str, ...], odometry: tuple[str, ...] = ()) -> None:
        self.received: Counter[str] = Counter()
        self.ages_ms: dict[str, list[float]] = {topic: [] for topic in odometry}
        self.node = rclpy.create_node("bench")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        for topic in topics:
            name = topic.removeprefix(FLOOR)
            callback = self._count_callback(topic)
            self.node.create_subscription(topic_class(name), topic, callback, subscriber_qos(name), raw=True)
        for topic in odometry:
            callback = self._age_callback(self.ages_ms[topic])
            self.node.create_subscription(
                topic_class("odometry"), topic, callback, subscriber_qos("odometry")
            )

    def listen(self, seconds: float) -> None:
        """Handle incoming messages for so long."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def reset(self) -> None:
        """Reset all counts."""
        self.received.clear()
        for ages in self.ages_ms.values():
            ages.clear()

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown()
        self.node.destroy_node()

    def _count_callback(self, topic: str) -> Callable[[bytes], None]:
        def count(_: bytes) -> None:
            self.received[topic] += 1

        return count

    def _age_callback(self, ages_ms: list[float]) -> Callable[[Any], None]:
        def store(message: Any) -> None:
            stamp = message.header.stamp
            ages_ms.append((time.time_ns() - stamp.sec * 1_000_000_000 - stamp.nanosec) * 1e-6)

        return store


def messages_of(name: str) -> dict[str, Any]:
    """Topic → message of a driver, as large as the real one."""
    if name == "can_driver":
        sprockets, hydraulics = (
            SprocketSample(0, 1.0, 1.0, 1.0, 1.0),
            HydraulicsSample(0, 1.0, 1.0, 1.0, 1.0, 1.0),
        )
        return {
            "sprockets": conversions.fill_joint_state(
                conversions.blank_joint_state(make, "base_link"), sprockets
            ),
            "hydraulics": conversions.fill_track_hydraulics(
                conversions.blank_track_hydraulics(make, "base_link"), hydraulics
            ),
        }
    if name == "watson_imu":
        sample = ImuSample(0, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), over_range=False)
        return {
            "imu/data_raw": conversions.fill_imu(conversions.blank_imu(make, "imu_link", 0.1, 0.1), sample),
            "imu/mag": conversions.fill_magnetic_field(
                conversions.blank_magnetic_field(make, "imu_link", 0.1), sample
            ),
        }
    if name == "sick_pls":
        scan = ScanSample(0, -1.57, 0.0087, 0.0, 0.04, 0.0, 50.0, np.linspace(2.0, 40.0, 361))
        return {"scan": conversions.laser_scan(make, scan, "laser")}
    return {"odometry": make("nav_msgs/msg/Odometry")}


def floor(name: str) -> None:
    """Publish until interrupted."""
    rclpy.init()
    node = rclpy.create_node(f"floor_{name}")
    outputs = [
        (node.create_publisher(type(message), FLOOR + topic, publisher_qos(topic)), message)
        for topic, message in messages_of(name).items()
    ]

    def publish() -> None:
        due_s = time.monotonic()
        while True:
            for publisher, message in outputs:
                if name == "odometry":
                    message.header.stamp = node.get_clock().now().to_msg()
                publisher.publish(message)
            due_s += 1.0 / RATES[name]
            time.sleep(max(due_s - time.monotonic(), 0.0))

    threading.Thread(target=publish, daemon=True).start()
    rclpy.spin(node)


def relay() -> None:
    """Publish odometry for each sprocket sample, without an estimate, until interrupted."""
    rclpy.init()
    node = rclpy.create_node("relay")
    message = make("nav_msgs/msg/Odometry")
    publisher = node.create_publisher(type(message), "odometry", publisher_qos("odometry"))

    def republish(sprockets: Any) -> None:
        message.header.stamp = sprockets.header.stamp
        publisher.publish(message)

    node.create_subscription(topic_class("sprockets"), "sprockets", republish, subscriber_qos("sprockets"))
    executor = Executor()
    executor.add_node(node)
    while rclpy.ok():
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    try:
        relay() if sys.argv[1] == "relay" else floor(sys.argv[1])
    except KeyboardInterrupt:
        sys.exit(130)
