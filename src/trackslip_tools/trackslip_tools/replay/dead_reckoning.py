# SPDX-License-Identifier: Apache-2.0
"""Paths without a filter, for comparison: encoders alone, and encoders with the gyro's heading.

ω_L, ω_R   sprocket speeds        rad/s
r, B       rolling radius, tread  m
V          r (ω_L + ω_R)/2        m/s, no slip
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_common.vehicle import Vehicle
from trackslip_estimation.slip.measurements import Sprockets, YawRate

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Path:
    """Poses over time in the site frame."""

    stamps_ns: NDArray[np.int64]  # (n,) increasing
    poses: FloatArray  # (n, 3) x m, y m, heading rad (continuous)

    def at(self, stamps_ns: NDArray[np.int64]) -> FloatArray:
        """(k, 3) poses at other stamps, linear between samples; nan outside the path."""
        origin = self.stamps_ns[0]
        t, wanted = (self.stamps_ns - origin) * 1e-9, (stamps_ns - origin) * 1e-9
        columns = [np.interp(wanted, t, column, left=np.nan, right=np.nan) for column in self.poses.T]
        return np.stack(columns, axis=-1)


def dead_reckon(
    vehicle: Vehicle,
    sprockets: Sequence[Sprockets],
    start_ns: int,
    start_pose: FloatArray,
    gyro: Sequence[YawRate] = (),
) -> Path:
    """Path from ``start_pose`` (3,) at ``start_ns``, with no slip.

    The heading is the integral of the gyro's rate where it is given (bias and all), else that of the
    difference of the tracks' speeds.
    """
    stamps = np.array([s.stamp_ns for s in sprockets], dtype=np.int64)
    after = stamps > start_ns
    grid = np.concatenate(([start_ns], stamps[after]))

    def since_start(travel: FloatArray) -> FloatArray:
        at_start = np.interp(start_ns - stamps[0], stamps - stamps[0], travel)
        return np.asarray(np.concatenate(([at_start], travel[after])) - at_start, dtype=np.float64)

    left, right = (since_start(vehicle.rolling_radius * turned) for turned in _turned(sprockets, stamps))
    turned = _integral(gyro, grid) if gyro else (right - left) / vehicle.tread
    heading = start_pose[2] + turned
    steps = np.diff((left + right) / 2.0)
    halfway = (heading[1:] + heading[:-1]) / 2.0
    x = start_pose[0] + np.concatenate(([0.0], np.cumsum(steps * np.cos(halfway))))
    y = start_pose[1] + np.concatenate(([0.0], np.cumsum(steps * np.sin(halfway))))
    return Path(grid, np.stack((x, y, heading), axis=-1))


def _turned(sprockets: Sequence[Sprockets], stamps: NDArray[np.int64]) -> FloatArray:
    """(2, n) rad turned by the left and right sprocket: their positions, or the integral of their speeds."""
    positions = [s.positions for s in sprockets if s.positions is not None]
    if len(positions) == len(sprockets):
        return np.array(positions, dtype=np.float64).T
    speeds = np.array([(s.left_speed, s.right_speed) for s in sprockets], dtype=np.float64)
    steps = speeds[1:] * (np.diff(stamps) * 1e-9)[:, np.newaxis]
    return np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0))).T


def _integral(gyro: Sequence[YawRate], grid: NDArray[np.int64]) -> FloatArray:
    """(n,) rad turned since grid[0] by the trapezoidal rule, the rate held before and after the log."""
    stamps = np.array([g.stamp_ns for g in gyro], dtype=np.int64)
    rates = np.array([g.rate for g in gyro], dtype=np.float64)
    edges = np.unique(np.concatenate((stamps, grid)))
    rate = np.interp(edges - edges[0], stamps - edges[0], rates)
    turned = np.concatenate(([0.0], np.cumsum((rate[1:] + rate[:-1]) / 2.0 * np.diff(edges) * 1e-9)))
    turned -= turned[np.searchsorted(edges, grid[0])]
    return turned[np.searchsorted(edges, grid)]
