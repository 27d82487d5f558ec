# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the demo: checks connections, activates the emulator, counts messages, reads estimates."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Set
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from trackslip_common.nodes.messages import topic_class
from trackslip_common.nodes.qos import publisher_qos
from trackslip_common.topics import SENSOR_TOPICS
from trackslip_estimation.slip.conversions import pose_fix
from trackslip_sim.nodes.remote_lifecycle import RemoteLifecycle

WATCHED_TOPICS = (*SENSOR_TOPICS, "box_pose", "gnss_pose", "odometry", "track_slip")
_WATCHING_NODES = frozenset({"record", "demo"})
_ENDPOINTS = {  # topic → nodes that must be connected on it, if all of them run
    **{topic: set(_WATCHING_NODES) for topic in WATCHED_TOPICS},
    "sprockets": {"can_driver", "slip_estimator", "record", "demo"},
    "imu/data_raw": {"watson_imu", "slip_estimator", "record", "demo"},
    "scan": {"sick_pls", "box_localizer", "record", "demo"},
    "box_pose": {"box_localizer", "slip_estimator", "record", "demo"},
    "fix": {"nmea_gnss", "gnss_localizer", "record", "demo"},
    "fix_velocity": {"nmea_gnss", "record", "demo"},
    "heading": {"nmea_gnss", "slip_estimator", "record", "demo"},
    "gnss_pose": {"gnss_localizer", "slip_estimator", "record", "demo"},
    "hydraulics": {"can_driver", "soil_estimator", "record", "demo"},
    "odometry": {"slip_estimator", "box_localizer", "record", "demo"},
    "track_slip": {"slip_estimator", "record", "demo"},
    "machine_state": {"slip_estimator", "soil_estimator", "record"},
    "track_forces": {"soil_estimator", "record"},
    "soil": {"soil_estimator", "record"},
    "measurement_reports": {"slip_estimator", "record"},
    "truth/odometry": {"record"},
}


def join_graph() -> None:
    """Start ROS without signal handlers."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)


def leave_graph() -> None:
    """End ROS; safe to call twice."""
    rclpy.try_shutdown()


class DemoMonitor(Node):
    """Subscriptions for the status line and the table."""

    def __init__(self) -> None:
        super().__init__("demo")
        self.received: Counter[str] = Counter()  # messages, per topic
        self.emitted: dict[str, int] = {}  # messages that the emulator's devices sent, per topic
        self.finished = False
        self.pose = (math.nan, math.nan, math.nan)
        self.slips = (math.nan, math.nan, math.nan)
        self.healthy_nodes: set[str] = set()  # nodes whose last status is not an error: their ports are open
        self._recorder_publishers: dict[str, str] = {}  # topic → number of those that the recorder receives
        self._spinner = SingleThreadedExecutor()
        self._spinner.add_node(self)
        self._emulator = RemoteLifecycle(self, self._spinner, "emulator")
        self._watched = {}
        for topic in WATCHED_TOPICS:
            handler = {"odometry": self._on_odometry, "track_slip": self._on_slip}.get(topic)
            self._watched[topic] = self.create_subscription(
                topic_class(topic), topic, self._counting_callback(topic, handler), publisher_qos(topic)
            )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def spin_for(self, seconds: float) -> None:
        """Handle callbacks for a time, s."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            self._spinner.spin_once(timeout_sec=left)

    def missing_endpoints(self, running: Set[str]) -> set[str]:
        """``topic: node`` of every missing endpoint of the running nodes.

        Recorder and demo are also checked for connections: discovered publishers may not be connected yet.
        """
        missing = set()
        for topic, nodes in _ENDPOINTS.items():
            if not nodes <= running | _WATCHING_NODES:
                continue
            name = self.resolve_topic_name(topic)
            publishers = self.get_publishers_info_by_topic(name)
            infos = publishers + self.get_subscriptions_info_by_topic(name)
            missing |= {f"{topic}: {node}" for node in nodes - {info.node_name for info in infos}}
            if publishers and self._recorder_publishers.get(name, "0") == "0":
                missing.add(f"{topic}: record")
            if publishers and topic in self._watched and not self._watched[topic].get_publisher_count():
                missing.add(f"{topic}: demo")
        return missing

    def configure_emulator(self, timeout: float) -> bool:
        """Configure the emulator, which creates its ports; False if not (yet) done."""
        return self._emulator.request_transition(
            Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE, timeout
        )

    def activate_emulator(self, timeout: float) -> bool:
        """Activate the emulator; False if not (yet) done."""
        return self._emulator.request_transition(
            Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE, timeout
        )

    def close(self) -> None:
        """Leave the graph."""
        self._spinner.shutdown(timeout_sec=1.0)
        self.destroy_node()

    def _counting_callback(self, topic: str, handler: Callable[[Any], None] | None) -> Callable[[Any], None]:
        def count(message: Any) -> None:
            self.received[topic] += 1
            if handler is not None:
                handler(message)

        return count

    def _on_odometry(self, message: Any) -> None:
        x, y, heading = pose_fix(message, "odometry").pose
        self.pose = (float(x), float(y), float(heading))

    def _on_slip(self, message: Any) -> None:
        self.slips = (message.left_slip, message.right_slip, message.slip_angle)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if status.level == DiagnosticStatus.ERROR:
                self.healthy_nodes.discard(status.name)
            else:
                self.healthy_nodes.add(status.name)
            if status.name == "record: publishers":
                self._recorder_publishers = {pair.key: pair.value for pair in status.values}
            if status.name == "emulator":
                self._read_emulator_status({pair.key: pair.value for pair in status.values}.items())

    def _read_emulator_status(self, values: Iterable[tuple[str, str]]) -> None:
        for key, value in values:
            word, _, topic = key.partition(" ")
            if word == "emitted" and topic in SENSOR_TOPICS:
                self.emitted[topic] = int(value)
            if key == "finished":
                self.finished = value == "True"
