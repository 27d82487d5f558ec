# SPDX-License-Identifier: Apache-2.0
"""The offered quality of service of a topic, as rosbag2 writes it into a bag (metadata version 9)."""

import yaml

from trackslip_common.topics import Flow

_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_DEPTH = 10


def offered_qos(flow: Flow) -> str:
    """YAML list with one profile, for ``ros2 bag play`` to offer the same again."""
    profile = {
        "history": "keep_last",
        "depth": 1 if flow is Flow.LATCHED else _DEPTH,
        "reliability": "best_effort" if flow is Flow.SENSOR else "reliable",
        "durability": "transient_local" if flow is Flow.LATCHED else "volatile",
        "deadline": dict(_FOREVER),
        "lifespan": dict(_FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False, default_flow_style=False)
