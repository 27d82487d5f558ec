# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What /tf says of an estimate: map → odom → base_link (REP-105)."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.make import Make, header
from trackslip_estimation.slip.conversions import Frames
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.mounting import quaternion_of

FloatArray = NDArray[np.float64]


def transforms(make: Make, estimate: Estimate, local: Estimate, frames: Frames) -> Any:
    """tf2_msgs/TFMessage of an estimate and of its pose in odom: map → odom → base_link."""
    turn = estimate.pose[2] - local.pose[2]
    roll, pitch, height = (0.0, 0.0, 0.0) if local.outputs.tilt is None else local.outputs.tilt.tilt.tolist()
    c, s = math.cos(turn), math.sin(turn)
    x, y, _ = local.pose
    map_odom = np.array((estimate.pose[0] - c * x + s * y, estimate.pose[1] - s * x - c * y, turn))
    level = (0.0, 0.0, 0.0)
    chain = (
        (frames.map, frames.odom, map_odom, level),
        (frames.odom, frames.base, local.pose, (roll, pitch, height)),
    )
    return make(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            _transform(make, (estimate.stamp_ns, parent, child), pose, tilt)
            for parent, child, pose, tilt in chain
        ],
    )


def _transform(
    make: Make, heads: tuple[int, str, str], pose: FloatArray, tilt: tuple[float, float, float]
) -> Any:
    """geometry_msgs/TransformStamped of (3,) x, y, heading, and of roll, pitch, height."""
    (stamp_ns, parent, child), (x, y, heading) = heads, map(float, pose)
    turn = dict(zip("xyzw", quaternion_of(tilt[0], tilt[1], heading), strict=True))
    transform = make(
        "geometry_msgs/msg/Transform",
        translation=make("geometry_msgs/msg/Vector3", x=x, y=y, z=tilt[2]),
        rotation=make("geometry_msgs/msg/Quaternion", **turn),
    )
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(make, stamp_ns, parent),
        child_frame_id=child,
        transform=transform,
    )
