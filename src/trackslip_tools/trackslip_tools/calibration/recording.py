# SPDX-License-Identifier: Apache-2.0
"""A bag as arrays: what calibration needs of it, by stamp, in seconds from the bag's first message."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_bags.reader import Bag, require_topics
from trackslip_common.errors import InputError
from trackslip_common.make import stamp_ns_of
from trackslip_estimation.slip import conversions
from trackslip_estimation.slip.motion import Motion, MotionParameters, MotionState, Speeds, classify
from trackslip_tools.replay.inputs import SPROCKETS

FloatArray = NDArray[np.float64]

HYDRAULICS = "hydraulics"
_DIAGONAL = (0, 7, 35)  # x, y and yaw in a 6×6 covariance, row by row


class Series(NamedTuple):
    """Readings in the order of their stamps."""

    t: FloatArray  # (n,) s
    values: FloatArray  # (n, k)


@dataclass(frozen=True, eq=False)
class Recording:
    """One drive; what the bag lacks is empty."""

    name: str
    sprockets: Series  # left, right: rad, continuous
    gyro: Series  # about x, y, z of the unit: rad/s, as it gives them
    poses: Series  # x m, y m, heading rad (continuous); the variances that are claimed for them
    hydraulics: Series  # left, right: Pa; left, right spool (nan where there is none)
    motion: NDArray[np.int64]  # (n,) Motion at each sprocket sample

    def turned(self) -> FloatArray:
        """(n,) integral of the gyro's rate about its z axis, at its stamps, rad; bias and all."""
        t, rates = self.gyro
        steps = np.diff(t) * (rates[1:, 2] + rates[:-1, 2]) / 2.0
        return np.concatenate(([0.0], np.cumsum(steps)))[: len(t)]

    def angles_at(self, t: FloatArray) -> FloatArray:
        """(n, 2) of the left and right sprocket at other times, rad."""
        known, angles = self.sprockets
        return np.column_stack([np.interp(t, known, column) for column in angles.T])


def read_recording(bag: Bag, gyro: str, poses: str, limits: MotionParameters) -> Recording:
    """Read the sprockets, the gyro and the pose source of these names, and the hydraulics.

    Raises:
        InputError: the bag lacks the sprockets, or a topic is of a type that does not serve.
    """
    require_topics(bag, [SPROCKETS])
    driven = _integrated(_series(bag, SPROCKETS, _sprockets, 4))
    fixes = _series(bag, poses, _pose, 6)
    fixes.values[:, 2] = np.unwrap(fixes.values[:, 2])
    return Recording(
        bag.path.name,
        driven,
        _series(bag, gyro, _rates, 3),
        fixes,
        _series(bag, HYDRAULICS, _hydraulics, 4),
        motions(driven, limits),
    )


def motions(sprockets: Series, limits: MotionParameters) -> NDArray[np.int64]:
    """(n,) standing, straight or turning at each sample; unknown at the first."""
    t, angles = sprockets
    state, found = MotionState(), [int(Motion.UNKNOWN)]
    for dt, (left, right) in zip(np.diff(t).tolist(), np.diff(angles, axis=0).tolist(), strict=True):
        state = classify(state, Speeds(left / dt, right / dt, dt, differenced=True), dt, limits)
        found.append(int(state.motion))
    return np.array(found[: len(t)], dtype=np.int64)


def _series(bag: Bag, topic: str, read: Callable[[Any], tuple[float, ...]], columns: int) -> Series:
    """One topic by stamp, the first of each stamp; readings that are no numbers are left out."""
    rows: dict[int, tuple[float, ...]] = {}
    for message in bag.messages([topic] if topic else []):
        content = bag.deserialize(message.raw, message.type_name)
        try:
            values = read(content)
        except AttributeError as error:
            kind = f"bag '{bag.path}': {topic} is a {message.type_name}"
            raise InputError(f"{kind}; accepted: {_ACCEPTED[read]}") from error
        if all(map(math.isfinite, values[:2])):
            rows.setdefault(stamp_ns_of(content), values)
    stamps = sorted(rows)
    t = np.array([(stamp - bag.start_ns) * 1e-9 for stamp in stamps])
    return Series(t, np.array([rows[stamp] for stamp in stamps]).reshape(-1, columns))


def _sprockets(message: Any) -> tuple[float, ...]:
    """Left and right speed, left and right position."""
    found = conversions.sprockets(message, SPROCKETS)
    return (found.left_speed, found.right_speed, *(found.positions or (math.nan, math.nan)))


def _rates(message: Any) -> tuple[float, ...]:
    rates = message.angular_velocity
    return rates.x, rates.y, rates.z


def _pose(message: Any) -> tuple[float, ...]:
    """Of PoseWithCovarianceStamped or Odometry."""
    variances = (float(message.pose.covariance[k]) for k in _DIAGONAL)
    return (*conversions.planar_pose(message.pose.pose).tolist(), *variances)


def _hydraulics(message: Any) -> tuple[float, ...]:
    return message.left_pressure, message.right_pressure, message.left_spool, message.right_spool


def _integrated(readings: Series) -> Series:
    """Angles: the positions, or where any is missing the integral of the speeds."""
    t, values = readings
    if np.isfinite(values[:, 2:]).all():
        return Series(t, values[:, 2:])
    steps = values[1:, :2] * np.diff(t)[:, np.newaxis]
    return Series(t, np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0))))


_ACCEPTED: Mapping[Callable[[Any], tuple[float, ...]], str] = MappingProxyType(
    {
        _sprockets: "sensor_msgs/msg/JointState",
        _rates: "sensor_msgs/msg/Imu",
        _pose: "geometry_msgs/msg/PoseWithCovarianceStamped or nav_msgs/msg/Odometry",
        _hydraulics: "trackslip_msgs/msg/TrackHydraulics",
    }
)
