# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Dead-reckoned paths for comparison: encoders alone, and encoders with the heading of the gyro.

ω_L, ω_R   sprocket speeds        rad/s
r, B       rolling radius, tread  m
V          r (ω_L + ω_R)/2        m/s, no slip
"""

import numpy as np

from trackslip_common.arrays import FloatArray, IntArray, Rows
from trackslip_common.vehicle import Kinematics
from trackslip_estimation.slip.records import SPROCKETS, YAW_RATE
from trackslip_tools.replay.growing import MOST_DRAWN, GrowingRows
from trackslip_tools.replay.scoring import PathErrors, Score
from trackslip_tools.replay.series import Path, series_of

_MAX_DISORDER_NS = 2_000_000_000  # largest disorder of stamps: the estimator's window
_GYRO_TIMEOUT_NS = 60_000_000_000  # gyro silence after which its rate is held constant
_MAX_VALUE = 1e9  # rad, rad/s: largest plausible value
_PATH = np.dtype([("stamp_ns", np.int64), ("pose", np.float64, (3,))])


class DeadReckoner:
    """One dead-reckoned path in pieces, from the first pose of a reference; its score against the reference.

    The path is thinned for plots, the score uses all of it.
    """

    def __init__(self, vehicle: Kinematics, *, with_gyro: bool) -> None:
        self._vehicle, self._with_gyro = vehicle, with_gyro
        self._sprockets: list[Rows] = []
        self._gyro: list[Rows] = []
        self._end: tuple[int, FloatArray] | None = None  # stamp and pose at the end of the path so far
        self._early_reference: list[Rows] = []  # rows of the reference until the start
        self._errors, self._drawn = PathErrors(), GrowingRows(_PATH, MOST_DRAWN)
        self.first_ns: int | None = None  # stamp of the first sprocket sample

    def add(self, arrivals: Rows, reference: Rows | None) -> None:
        """Add both; rows of the reference have stamp_ns, x, y, heading."""
        for parts, samples in (
            (self._sprockets, _sprocket_samples(arrivals)),
            (self._gyro, _yaw_rates(arrivals)),
        ):
            if len(samples):
                parts.append(samples)
        if self.first_ns is None and self._sprockets:
            self.first_ns = int(self._sprockets[0]["stamp_ns"].min())
        if self._end is None:
            self._early_reference += [] if reference is None else [reference]
            self._begin(self.first_ns)
        self._extend(self._advance(), reference)

    def result(self) -> tuple[Path | None, Score | None]:
        """Path and score after the last piece."""
        self._extend(self._advance(whole=True), None)
        rows = self._drawn.rows()
        return (Path(rows["stamp_ns"], rows["pose"]) if len(rows) else None), self._errors.score

    def _begin(self, first_ns: int | None) -> None:
        """Start at the first reference pose with a heading at or after the first sprocket sample."""
        if first_ns is None or not self._early_reference:
            return
        reference = np.concatenate(self._early_reference)
        later = reference[(reference["stamp_ns"] >= first_ns) & np.isfinite(reference["heading"])]
        if len(later):
            start = later[np.argmin(later["stamp_ns"])]
            self._end = int(start["stamp_ns"]), np.array([start[name] for name in ("x", "y", "heading")])
            self._early_reference.clear()

    def _extend(self, path: Path | None, reference: Rows | None) -> None:
        nothing = Path(np.empty(0, np.int64), np.empty((0, 3)))
        self._errors.add(path or nothing, reference)
        if path is not None:
            rows = np.empty(len(path.stamps_ns), _PATH)
            rows["stamp_ns"], rows["pose"] = path.stamps_ns, path.poses
            self._drawn.add(rows if not len(self._drawn) else rows[1:])

    def _advance(self, *, whole: bool = False) -> Path | None:
        """The next piece of the path, as far as no late sample can change it, or ``whole`` to the end."""
        if self._end is None or not self._sprockets or (self._with_gyro and not self._gyro):
            return None
        sprockets = _sort_by_stamp(np.concatenate(self._sprockets))
        last_ns = int(sprockets["stamp_ns"][-1])
        until_ns, rates = last_ns - _MAX_DISORDER_NS, None
        if self._with_gyro:
            rates = _sort_by_stamp(np.concatenate(self._gyro))
            until_ns = min(until_ns, max(int(rates["stamp_ns"][-1]), last_ns - _GYRO_TIMEOUT_NS))
        end = len(sprockets) if whole else int(np.searchsorted(sprockets["stamp_ns"], until_ns, side="right"))
        if not end or sprockets["stamp_ns"][end - 1] <= self._end[0]:
            return None
        path = _dead_reckon(self._vehicle, sprockets[:end], *self._end, rates)
        self._end = int(path.stamps_ns[-1]), path.poses[-1]
        self._sprockets = [sprockets[end - 1 :]]
        if rates is not None:
            self._gyro = [rates[max(int(np.searchsorted(rates["stamp_ns"], self._end[0])) - 1, 0) :]]
        return path


def _sprocket_samples(rows: Rows) -> Rows:
    """Speeds and positions of the valid sprocket samples; both positions may be missing (nan)."""
    rows = rows[rows["kind"] == SPROCKETS]
    speeds, positions = (
        np.column_stack((rows[f"left_{name}"], rows[f"right_{name}"])) for name in ("speed", "angle")
    )
    is_valid = (np.abs(speeds) < _MAX_VALUE).all(axis=1)
    is_valid &= (np.abs(positions) < _MAX_VALUE).all(axis=1) | np.isnan(positions).all(axis=1)
    samples = series_of(stamp_ns=rows["stamp_ns"], speeds=speeds, positions=positions).rows
    return np.asarray(samples[is_valid])


def _yaw_rates(rows: Rows) -> Rows:
    """The valid yaw rates."""
    rows = rows[rows["kind"] == YAW_RATE]
    rates, variances = rows["value"][:, 0], rows["noise"][:, 0, 0]
    is_valid = (np.abs(rates) < _MAX_VALUE) & (variances > 0.0) & (variances < _MAX_VALUE**2)
    return np.asarray(series_of(stamp_ns=rows["stamp_ns"], rate=rates).rows[is_valid])


def _sort_by_stamp(rows: Rows) -> Rows:
    if (np.diff(rows["stamp_ns"]) >= 0).all():
        return rows
    return rows[np.argsort(rows["stamp_ns"], kind="stable")]


def _dead_reckon(
    vehicle: Kinematics, sprockets: Rows, start_ns: int, start_pose: FloatArray, gyro: Rows | None
) -> Path:
    """Path from ``start_pose`` (3,) at ``start_ns``, without slip.

    The heading is the integral of the gyro's rate (bias included). Without a gyro it follows from the
    difference of the tracks' speeds.
    """
    stamps = sprockets["stamp_ns"]
    after = stamps > start_ns
    grid = np.concatenate(([start_ns], stamps[after]))

    def since_start(travel: FloatArray) -> FloatArray:
        at_start = np.interp(start_ns - stamps[0], stamps - stamps[0], travel)
        return np.asarray(np.concatenate(([at_start], travel[after])) - at_start, dtype=np.float64)

    left, right = (since_start(vehicle.rolling_radius * angles) for angles in _sprocket_angles(sprockets))
    yaw = (right - left) / vehicle.tread if gyro is None else _gyro_angle(gyro, grid)
    heading = start_pose[2] + yaw
    steps = np.diff((left + right) / 2.0)
    mean_heading = (heading[1:] + heading[:-1]) / 2.0
    x = start_pose[0] + np.concatenate(([0.0], np.cumsum(steps * np.cos(mean_heading))))
    y = start_pose[1] + np.concatenate(([0.0], np.cumsum(steps * np.sin(mean_heading))))
    return Path(grid, np.stack((x, y, heading), axis=-1))


def _sprocket_angles(sprockets: Rows) -> FloatArray:
    """(2, n) angle of the left and right sprocket, rad: the positions, or the integral of the speeds."""
    if not np.isnan(sprockets["positions"]).any():
        return np.asarray(sprockets["positions"].T)
    steps = sprockets["speeds"][1:] * (np.diff(sprockets["stamp_ns"]) * 1e-9)[:, np.newaxis]
    return np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0))).T


def _gyro_angle(gyro: Rows, grid: IntArray) -> FloatArray:
    """(n,) angle since grid[0], rad, by the trapezoidal rule; the rate is held before and after the log."""
    stamps, rates = gyro["stamp_ns"], gyro["rate"]
    edges = np.unique(np.concatenate((stamps, grid)))
    rate = np.interp(edges - edges[0], stamps - edges[0], rates)
    angle = np.concatenate(([0.0], np.cumsum((rate[1:] + rate[:-1]) / 2.0 * np.diff(edges) * 1e-9)))
    angle -= angle[np.searchsorted(edges, grid[0])]
    return angle[np.searchsorted(edges, grid)]
