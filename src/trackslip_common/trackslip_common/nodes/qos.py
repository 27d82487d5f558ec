# SPDX-License-Identifier: Apache-2.0
"""Quality of service of each topic, from its flow."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from trackslip_common.topics import TOPICS, Flow

# Deep enough to sit out a few seconds of a busy processor at 100 Hz without losing a message.
_DEPTH = 1000


def qos_of(name: str) -> QoSProfile:
    """Profile for publishing or subscribing to a topic; unknown names are taken as sensor data."""
    flow = TOPICS[name].flow if name in TOPICS else Flow.SENSOR
    if flow is Flow.LATCHED:
        return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    best_effort = flow is Flow.SENSOR
    reliability = ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE
    return QoSProfile(depth=_DEPTH, reliability=reliability)
