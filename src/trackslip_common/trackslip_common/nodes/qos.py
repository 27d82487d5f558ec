# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of each topic, from its flow."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from trackslip_common.topics import TOPICS, Flow

# Deep enough for a few seconds of a busy processor at 100 Hz without loss of a message.
_DEPTH = 1000


def publisher_qos(name: str) -> QoSProfile:
    """Profile for publishing one of the project's topics.

    Sensors are published reliably: a best-effort subscriber matches, and a recorder gets all messages.
    """
    if TOPICS[name].flow is Flow.LATCHED:
        return latched_qos()
    return reliable_qos()


def subscriber_qos(name: str) -> QoSProfile:
    """Profile for subscribing; a topic that is not the project's is treated as sensor data."""
    flow = TOPICS[name].flow if name in TOPICS else Flow.SENSOR
    if flow is Flow.LATCHED:
        return latched_qos()
    return best_effort_qos() if flow is Flow.SENSOR else reliable_qos()


def latched_qos(depth: int = 1) -> QoSProfile:
    """Reliable profile that keeps the last messages for later subscribers."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def reliable_qos() -> QoSProfile:
    """Reliable profile, for publishers that offer it."""
    return QoSProfile(depth=_DEPTH)


def best_effort_qos() -> QoSProfile:
    """Sensor-data profile with a deep queue; it matches any publisher."""
    return QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
