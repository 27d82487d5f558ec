# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``live``: serves the live page of the running graph; read-only apart from its status on /diagnostics."""

import sys
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from trackslip_common.errors import ExitCode
from trackslip_common.nodes.base import TrackslipNode
from trackslip_common.nodes.health import OK, Health
from trackslip_common.nodes.messages import message_class
from trackslip_common.nodes.qos import best_effort_qos, latched_qos
from trackslip_common.nodes.run import run
from trackslip_common.topics import DIAGNOSTICS
from trackslip_common.vehicle_files import load_vehicle
from trackslip_tools.live import inputs
from trackslip_tools.live.encoding import local_clock_ms
from trackslip_tools.live.page import page_files
from trackslip_tools.live.parameters import DEFAULT_FILES, NODE, LiveParameters
from trackslip_tools.live.server import PageServer
from trackslip_tools.live.state import PERIOD, LiveState

_NICENESS = 5  # lower priority than the nodes that drive
_SOURCES_PERIOD_S = 1.0  # interval between checks for changed pose sources
_MOST_WAITING = 200  # queued messages of topics whose every message counts
_NEWEST_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class LiveNode(TrackslipNode[LiveParameters]):
    """Keeps messages as bytes (of most topics only the newest), and decodes and shows them periodically."""

    def __init__(self) -> None:
        super().__init__(NODE, LiveParameters, *DEFAULT_FILES)

    def configure(self) -> None:
        """Create the state and the subscriptions."""
        namespace = self.get_namespace().strip("/")
        self._server: PageServer | None = None
        self._files = page_files(f"Trackslip: {namespace or 'live'}")
        self._state = LiveState(namespace or "live", load_vehicle(), namespace)
        self._waiting: dict[str, deque[bytes]] = {}
        self._sources: dict[str, Subscription | None] = {}  # pose sources; None: invalid topic name
        for topic in inputs.TYPES:
            self._subscribe_raw(topic)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(PERIOD, self._send_frame, clock=steady)
        self.create_timer(_SOURCES_PERIOD_S, self._update_subscriptions, clock=steady)

    def activate(self) -> None:
        """Open the port, and start serving."""
        log = self.get_logger().warning
        self._server = PageServer(self._files, self._state.full_state, self.settings, log)
        self._server.start()
        self.get_logger().info(f"the live page is at {self._server.address}")

    def deactivate(self) -> None:
        """Close the port."""
        if self._server is not None:
            self._server.stop()
            self._server = None

    def health(self) -> list[Health]:
        """Address of the page, and counts of its connections."""
        assert self._server is not None
        return [Health(OK, f"serving {self._server.address}", self._server.counts)]

    def _subscribe_raw(self, topic: str) -> Subscription:
        every = topic in inputs.EVERY_MESSAGE
        self._waiting[topic] = deque(maxlen=_MOST_WAITING if every else 1)
        qos = latched_qos() if topic in inputs.LATCHED_TOPICS else best_effort_qos() if every else _NEWEST_QOS
        full = f"/{topic}" if topic == DIAGNOSTICS else topic
        kind = message_class(inputs.TYPES.get(topic, inputs.POSE_TYPE))
        subscription: Subscription = self.create_subscription(
            kind, full, partial(self._queue_message, topic), qos, raw=True
        )
        return subscription

    def _update_subscriptions(self) -> None:
        """Subscribe to the present pose sources of the slip estimator, and unsubscribe from former ones."""
        current = self._state.pose_sources - inputs.TYPES.keys()
        for topic in self._sources.keys() - current:
            subscription = self._sources.pop(topic)
            if subscription is not None:
                self.destroy_subscription(subscription)
                del self._waiting[topic]
        for topic in current - self._sources.keys():
            self._sources[topic] = None
            try:
                self._sources[topic] = self._subscribe_raw(topic)
            except InvalidTopicNameException as error:
                self._waiting.pop(topic)
                self.callback_failures.add(inputs.PARAMETERS, error)

    def _send_frame(self) -> None:
        for topic, waiting in self._waiting.items():
            while waiting:
                self._process_message(topic, waiting.popleft())
        now_ns = self.get_clock().now().nanoseconds
        frame = self._state.next_frame(time.monotonic(), local_clock_ms(now_ns))
        if self._server is not None:
            self._server.push(frame)

    def _queue_message(self, topic: str, data: bytes) -> None:
        if topic in self._waiting:
            self._waiting[topic].append(data)

    def _process_message(self, topic: str, data: bytes) -> None:
        try:
            message: Any = deserialize_message(data, message_class(inputs.TYPES.get(topic, inputs.POSE_TYPE)))
            self._state.process(topic, message, time.monotonic())
        except Exception as error:  # noqa: BLE001 (whatever is in it, the page goes on)
            self.callback_failures.add(topic, error)


def live(argv: Sequence[str] | None = None) -> int:
    """Serve until SIGINT or SIGTERM; returns the exit code."""
    return run(LiveNode, argv, niceness=_NICENESS, interrupt_code=ExitCode.DONE)


def main() -> None:
    """Entry point."""
    sys.exit(live())
