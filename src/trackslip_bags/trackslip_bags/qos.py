# SPDX-License-Identifier: Apache-2.0
"""The offered quality of service of a topic, as rosbag2 writes it into a bag (metadata version 9)."""

import yaml
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_DEPTH = 10


def offered_qos(latched: bool) -> str:
    """YAML list with one reliable profile, for ``ros2 bag play`` to offer again."""
    profile = {
        "history": "keep_last",
        "depth": 1 if latched else _DEPTH,
        "reliability": "reliable",
        "durability": "transient_local" if latched else "volatile",
        "deadline": dict(_FOREVER),
        "lifespan": dict(_FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([profile], sort_keys=False, default_flow_style=False)


def present_qos(text: str) -> str:
    """The profiles of a bag of any version, in the form of the present one; none where they are garbage."""
    try:
        profiles = dump_qos_v9(parse_qos(text))
    except Exception:  # noqa: BLE001 (damaged text can raise anything in the parser)
        profiles = []
    return yaml.safe_dump(profiles, sort_keys=False, default_flow_style=False)
