# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Offered QoS profiles of a topic in the form of rosbag2 (metadata version 9)."""

import yaml

_INFINITE = {"sec": 9223372036, "nsec": 854775807}
_DEPTH = 10


def offered_qos(latched: bool) -> str:
    """YAML list with one reliable profile, which ``ros2 bag play`` offers."""
    profile = {
        "history": "keep_last",
        "depth": 1 if latched else _DEPTH,
        "reliability": "reliable",
        "durability": "transient_local" if latched else "volatile",
        "deadline": dict(_INFINITE),
        "lifespan": dict(_INFINITE),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_INFINITE),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False, default_flow_style=False)
