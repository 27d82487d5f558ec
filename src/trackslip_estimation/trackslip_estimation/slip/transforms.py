# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms of an estimate on /tf: map → odom → base_link (REP-105)."""

import math
from typing import Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.make import MessageFactory, header, set_stamp
from trackslip_estimation.slip.conversions import Frames
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.mounting import quaternion_from_angles


def blank_transforms(make: MessageFactory, frames: Frames) -> Any:
    """tf2_msgs/TFMessage for ``fill_transforms``: map → odom → base_link."""
    chain = ((frames.map, frames.odom), (frames.odom, frames.base))
    return make(
        "tf2_msgs/msg/TFMessage",
        transforms=[
            make("geometry_msgs/msg/TransformStamped", header=header(make, 0, parent), child_frame_id=child)
            for parent, child in chain
        ],
    )


def fill_transforms(message: Any, estimate: Estimate, local: Estimate) -> None:
    """Fill the message with an estimate and its pose in odom."""
    turn = estimate.pose[2] - local.pose[2]
    flat = (0.0, 0.0, 0.0)
    roll, pitch, height = flat if local.outputs.tilt is None else local.outputs.tilt.tilt.tolist()
    _, _, map_height = flat if estimate.outputs.tilt is None else estimate.outputs.tilt.tilt.tolist()
    c, s = math.cos(turn), math.sin(turn)
    x, y, _ = local.pose
    map_odom = np.array((estimate.pose[0] - c * x + s * y, estimate.pose[1] - s * x - c * y, turn))
    to_odom, to_base = message.transforms
    _fill(to_odom, estimate.stamp_ns, map_odom, (0.0, 0.0, map_height - height))
    _fill(to_base, estimate.stamp_ns, local.pose, (roll, pitch, height))


def _fill(message: Any, stamp_ns: int, pose: FloatArray, tilt: tuple[float, float, float]) -> None:
    """Fill a geometry_msgs/TransformStamped with (3,) x, y, heading, and with roll, pitch, height."""
    set_stamp(message, stamp_ns)
    translation, rotation = message.transform.translation, message.transform.rotation
    x, y, heading = pose.tolist()
    translation.x, translation.y, translation.z = x, y, tilt[2]
    rotation.x, rotation.y, rotation.z, rotation.w = quaternion_from_angles(tilt[0], tilt[1], heading)
