# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the benchmark: a listener, and bare nodes as the floor of the latencies.

``bench_ros.py odometry`` is a bare rclpy node that publishes stamped odometry at 101 Hz: within a second it
covers every phase of the graph's cycle, busy and idle. ``relay`` replaces the slip estimator: it publishes
constant odometry with the stamp of each sprocket sample.
"""

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor

from trackslip_common.nodes.messages import make, topic_class
from trackslip_common.nodes.qos import publisher_qos, subscriber_qos
from trackslip_common.nodes.run import Executor

FLOOR, FLOOR_RATE = "floor/", 101.0  # prefix of its topic; Hz


class Listener:
    """Counts messages on topics and keeps the last; on odometry topics it stores the age of each message."""

    def __init__(self, topics: tuple[str, ...], odometry: tuple[str, ...] = ()) -> None:
        self.received: Counter[str] = Counter()
        self.last: dict[str, bytes] = {}  # message of each topic, serialized
        self.ages_ms: dict[str, list[float]] = {topic: [] for topic in odometry}
        self.node = rclpy.create_node("bench")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        for topic in topics:
            callback = self._count_callback(topic)
            self.node.create_subscription(
                topic_class(topic), topic, callback, subscriber_qos(topic), raw=True
            )
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
        def count(message: bytes) -> None:
            self.received[topic] += 1
            self.last[topic] = message

        return count

    def _age_callback(self, ages_ms: list[float]) -> Callable[[Any], None]:
        def store(message: Any) -> None:
            stamp = message.header.stamp
            ages_ms.append((time.time_ns() - stamp.sec * 1_000_000_000 - stamp.nanosec) * 1e-6)

        return store


def repeat(publish: Callable[[], None], period: float) -> None:
    """Call ``publish`` each ``period``, s."""
    due_s = time.monotonic()
    while True:
        publish()
        due_s += period
        time.sleep(max(due_s - time.monotonic(), 0.0))


def floor() -> None:
    """Publish stamped odometry until interrupted."""
    rclpy.init()
    node = rclpy.create_node("floor_odometry")
    message = make("nav_msgs/msg/Odometry")
    publisher = node.create_publisher(type(message), FLOOR + "odometry", publisher_qos("odometry"))

    def publish() -> None:
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    threading.Thread(target=repeat, args=(publish, 1.0 / FLOOR_RATE), daemon=True).start()
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
        relay() if sys.argv[1] == "relay" else floor()
    except KeyboardInterrupt:
        sys.exit(130)
