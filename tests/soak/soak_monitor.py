# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Observations of a soak: latency, missing reports, and errors in ``/diagnostics``."""

import math
import re
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from trackslip_common.nodes.messages import message_class, topic_class
from trackslip_common.nodes.qos import subscriber_qos

_NUMBER = re.compile(r"\d+(\.\d+)?")  # messages that differ only in numbers count as one


class Monitor:
    """A node that observes the graph."""

    def __init__(self, domain: int) -> None:
        rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("soak")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._arrivals: dict[int, float] = {}  # stamp of sprockets → arrival, s of the steady clock
        self._sequence = -1
        self._latencies: list[float] = []
        self.totals = {"estimates": 0, "reports missing": 0, "restarts of the drive": 0, "errors": 0}
        self.errors: dict[str, int] = {}
        for topic, handle in (
            ("sprockets", self._on_sprockets),
            ("odometry", self._on_odometry),
            ("measurement_reports", self._on_report),
        ):
            self._node.create_subscription(topic_class(topic), topic, handle, subscriber_qos(topic))
        kind = message_class("diagnostic_msgs/msg/DiagnosticArray")
        self._node.create_subscription(kind, "/diagnostics", self._on_diagnostics, 100)

    def spin_until(self, until_s: float) -> None:
        """Handle incoming messages until then."""
        while (left := until_s - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def latency(self) -> dict[tuple[str, str], float]:
        """Quantiles of the delay from sprockets to their odometry on arrival, ms, since the last call."""
        latencies, self._latencies = self._latencies or [math.nan], []
        p50, p99 = np.quantile(latencies, (0.5, 0.99))
        return {("graph", "latency p50 (ms)"): 1e3 * p50, ("graph", "latency p99 (ms)"): 1e3 * p99}

    def close(self) -> None:
        """Destroy the node."""
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def _on_sprockets(self, message: Any) -> None:
        if len(self._arrivals) > 10_000:
            self._arrivals.clear()
        self._arrivals[_stamp(message)] = time.monotonic()

    def _on_odometry(self, message: Any) -> None:
        self.totals["estimates"] += 1
        arrival_s = self._arrivals.pop(_stamp(message), None)
        if arrival_s is not None:
            self._latencies.append(time.monotonic() - arrival_s)

    def _on_report(self, message: Any) -> None:
        self.totals["reports missing"] += max(message.sequence - self._sequence - 1, 0) * (
            self._sequence >= 0
        )
        self.totals["restarts of the drive"] += message.outcome == message.RESTARTED
        self._sequence = message.sequence

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            if status.level == status.ERROR:
                self.totals["errors"] += 1
                text = _NUMBER.sub("…", f"{status.name}: {status.message}")
                self.errors[text] = self.errors.get(text, 0) + 1


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)
