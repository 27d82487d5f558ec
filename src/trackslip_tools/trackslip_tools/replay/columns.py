# SPDX-License-Identifier: Apache-2.0
"""What ``conversions`` reads from a message, read from all messages of a topic at once, to the last bit."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.columns import Columns, IrregularError
from trackslip_common.topics import LEFT_SPROCKET, RIGHT_SPROCKET
from trackslip_estimation.slip.measurements import Measurement, PoseFix, SlipFix, Sprockets, YawRate

FloatArray = NDArray[np.float64]
Reader = Callable[[Columns], list[Measurement]]

_PLANAR = np.array((0, 1, 5))  # x, y, yaw among x y z roll pitch yaw


def stamps_ns(columns: Columns) -> NDArray[np.int64]:
    """(n,) of the headers."""
    seconds = columns["header.stamp.sec"].astype(np.int64)
    return seconds * 1_000_000_000 + columns["header.stamp.nanosec"]


def sprockets(columns: Columns, source: str) -> list[Measurement]:
    """From sensor_msgs/JointState.

    Raises:
        IrregularError: the joints do not keep their places.
    """
    names = columns["name"]
    if not (names == names[:1]).all():
        raise IrregularError("joints change places")
    joints = names[0].tolist() if len(names) else []

    def of(values: FloatArray, joint: str) -> list[float]:
        at = joints.index(joint) if joint in joints else values.shape[1]
        found: list[float] = (
            values[:, at] if at < values.shape[1] else np.full(len(values), np.nan)
        ).tolist()
        return found

    left, right = (of(columns["velocity"], joint) for joint in (LEFT_SPROCKET, RIGHT_SPROCKET))
    positions: Any = [None] * len(names)
    if columns["position"].shape[1] > 0:
        positions = zip(
            *(of(columns["position"], joint) for joint in (LEFT_SPROCKET, RIGHT_SPROCKET)), strict=True
        )
    rows = zip(stamps_ns(columns).tolist(), left, right, positions, strict=True)
    return [Sprockets(source, *row) for row in rows]


def yaw_rates(columns: Columns, source: str, default_variance: float) -> list[Measurement]:
    """From sensor_msgs/Imu."""
    variances = columns["angular_velocity_covariance"][:, 8]
    variances = np.where(variances == 0.0, default_variance, variances)
    rows = zip(
        stamps_ns(columns).tolist(), columns["angular_velocity.z"].tolist(), variances.tolist(), strict=True
    )
    return [YawRate(source, *row) for row in rows]


def pose_fixes(columns: Columns, source: str) -> list[Measurement]:
    """From geometry_msgs/PoseWithCovarianceStamped."""
    covariances = columns["pose.covariance"].reshape(-1, 6, 6)
    planar = np.ascontiguousarray(covariances[:, _PLANAR[:, np.newaxis], _PLANAR])
    rows = zip(stamps_ns(columns).tolist(), poses(columns), planar, strict=True)
    return [PoseFix(source, *row) for row in rows]


def slip_fixes(columns: Columns, source: str) -> list[Measurement]:
    """From trackslip_msgs/TrackSlip."""
    slips = np.column_stack((columns["left_slip"], columns["right_slip"]))
    covariances = columns["covariance"].reshape(-1, 3, 3)[:, :2, :2]
    rows = zip(stamps_ns(columns).tolist(), slips, covariances, strict=True)
    return [SlipFix(source, *row) for row in rows]


def poses(columns: Columns) -> FloatArray:
    """(n, 3) x, y, heading of what has a pose with covariance."""
    x, y, z, w = (columns[f"pose.pose.orientation.{axis}"] for axis in "xyzw")
    sines, cosines = 2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)
    headings = [math.atan2(s, c) for s, c in zip(sines.tolist(), cosines.tolist(), strict=True)]
    return np.column_stack((columns["pose.pose.position.x"], columns["pose.pose.position.y"], headings))


def numbers(columns: Columns) -> FloatArray:
    """(n, k) rows of ``inputs.numbers_of``."""
    if "left_slip" in columns:
        return np.column_stack([columns[n] for n in ("left_slip", "right_slip", "slip_angle", "covariance")])
    found = poses(columns)
    if "twist.covariance" not in columns:
        return found
    velocity = [columns[f"twist.twist.{name}"] for name in ("linear.x", "linear.y", "angular.z")]
    return np.column_stack((found, *velocity, columns["pose.covariance"], columns["twist.covariance"]))
