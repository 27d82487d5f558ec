# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Exact errors against a truth that is logged with the estimates, in pieces and in bounded memory."""

import math
from collections.abc import Callable

import numpy as np

from trackslip_common.arrays import FloatArray, Rows
from trackslip_common.orientations import wrap_angles
from trackslip_tools.replay.dead_reckoning import Path
from trackslip_tools.replay.scoring import Score, errors_of, moving_slips, nees_of_each, path_of, slip_errors
from trackslip_tools.replay.series import Series, series_of, sort_by_stamp

_RECENT_NS = 1_000_000_000  # largest delay of a truth of the same stamp


class TimestampQueue:
    """Rows that wait for another series to reach their stamps."""

    def __init__(self) -> None:
        self._parts: list[Rows] = []

    def add(self, rows: Rows | None) -> None:
        """Add rows with the field ``stamp_ns``."""
        if rows is not None and len(rows):
            self._parts.append(rows)

    @property
    def last_ns(self) -> int:
        """The newest stamp; 0 without rows."""
        return max((int(rows["stamp_ns"].max()) for rows in self._parts), default=0)

    def pop_until(self, stamp_ns: int) -> Rows | None:
        """Remove and return the rows up to a stamp, by stamp; the last of equal stamps. None: no rows."""
        if not self._parts:
            return None
        rows = self._parts[0] if len(self._parts) == 1 else np.concatenate(self._parts)
        due = rows["stamp_ns"] <= stamp_ns
        self._parts = [] if due.all() else [rows[~due]]
        return sort_by_stamp(rows[due]) if due.any() else None


class PathErrors:
    """RMS errors of a path, and its mean NEES where its poses have covariances.

    Reference samples without a heading (nan) count for the position alone. The NEES adds the ``covariance``
    of a reference to that of the path. It leaves out samples at which the sum is singular.
    """

    def __init__(self) -> None:
        self._reference = TimestampQueue()  # rows of stamp_ns, x, y, heading, and covariance if there is one
        self._recent: tuple[Path, FloatArray] | None = None  # end of the previous piece
        self._position = self._heading = self._nees = self._nees_position = 0.0  # sums of squares
        self.last_position: float | None = None  # m, at the newest compared sample
        self._count = self._with_heading = self._with_nees = self._with_nees_position = 0

    def add(self, path: Path, reference: Rows | None, covariances: FloatArray | None = None) -> None:
        """Add both; ``covariances`` (n, 3, 3) of the path's poses."""
        self._reference.add(reference)
        if not len(path.stamps_ns):
            return
        P = np.empty((len(path.stamps_ns), 0, 0)) if covariances is None else covariances
        if self._recent is not None and self._recent[0].stamps_ns[-1] < path.stamps_ns[0]:
            path, P = _join_paths(*self._recent, path, P)
        recent = slice(int(np.searchsorted(path.stamps_ns, path.stamps_ns[-1] - _RECENT_NS)), None)
        self._recent = Path(path.stamps_ns[recent], path.poses[recent]), P[recent]
        rows = self._reference.pop_until(int(path.stamps_ns[-1]))
        if rows is None:
            return
        R = rows["covariance"] if "covariance" in (rows.dtype.names or ()) else None
        poses = np.column_stack([rows[name] for name in ("x", "y", "heading")])
        reference_path = Path(rows["stamp_ns"], poses, R)
        errors = errors_of(path, reference_path)
        self._count += len(errors)
        if len(errors):
            self.last_position = float(np.hypot(*errors[-1, :2]))
        self._position += float(np.sum(errors[:, :2] ** 2))
        has_heading = np.isfinite(errors[:, 2])
        self._with_heading += int(has_heading.sum())
        self._heading += float(np.sum(errors[has_heading, 2] ** 2))
        if covariances is not None:
            pose, _ = nees_of_each(path, P, reference_path)
            position, _ = nees_of_each(path, P, reference_path, 2)
            has_nees, has_position_nees = has_heading & np.isfinite(pose), np.isfinite(position)
            self._nees += float(np.sum(pose[has_nees]))
            self._nees_position += float(np.sum(position[has_position_nees]))
            self._with_nees += int(has_nees.sum())
            self._with_nees_position += int(has_position_nees.sum())

    def add_estimates(self, estimates: Rows, reference: Rows | None) -> None:
        """Add both; estimates (n,) with stamp_ns, pose, pose_covariance."""
        estimates = sort_by_stamp(estimates)
        self.add(path_of(estimates), reference, estimates["pose_covariance"])

    @property
    def score(self) -> Score | None:
        """RMS errors; None without compared samples."""
        if not self._count:
            return None
        heading = math.sqrt(self._heading / self._with_heading) if self._with_heading else None
        return Score(self._count, math.sqrt(self._position / self._count), heading)

    @property
    def nees(self) -> float | None:
        """Mean NEES of the pose; None without compared samples."""
        return self._nees / self._with_nees if self._with_nees else None

    @property
    def nees_position(self) -> float | None:
        """Mean NEES of the position; None without compared samples."""
        return self._nees_position / self._with_nees_position if self._with_nees_position else None


class SlipErrors:
    """RMS error of left and right slip together, over the samples of ``moving_slips``; ``tread`` in m."""

    def __init__(self, tread: float) -> None:
        self._tread = tread
        self._slips, self._odometry = TimestampQueue(), TimestampQueue()
        self._recent: Rows | None = None  # estimates
        self._sum, self._count = 0.0, 0

    def add(self, estimates: Rows, slips: Rows | None, odometry: Rows | None) -> None:
        """Add estimates (stamp_ns, slips) and both truths."""
        self._slips.add(slips)
        self._odometry.add(odometry)
        if not len(estimates):
            return
        estimates = sort_by_stamp(estimates)
        if self._recent is not None and self._recent["stamp_ns"][-1] < estimates["stamp_ns"][0]:
            estimates = np.concatenate((self._recent, estimates))
        last_ns = int(estimates["stamp_ns"][-1])
        self._recent = estimates[np.searchsorted(estimates["stamp_ns"], last_ns - _RECENT_NS) :]
        until_ns = min(last_ns, self._slips.last_ns, self._odometry.last_ns)
        true_slips, true_odometry = self._slips.pop_until(until_ns), self._odometry.pop_until(until_ns)
        if true_slips is None or true_odometry is None:
            return
        left, right = estimates["slips"][:, 0], estimates["slips"][:, 1]
        series = series_of(stamp_ns=estimates["stamp_ns"], left_slip=left, right_slip=right)
        errors = slip_errors(series, moving_slips(Series(true_odometry), Series(true_slips), self._tread))
        self._sum, self._count = self._sum + float(np.sum(errors**2)), self._count + errors.size

    @property
    def rmse(self) -> float | None:
        """RMS error; None without compared samples."""
        return math.sqrt(self._sum / self._count) if self._count else None


class PairedErrors:
    """RMS errors of a part of ``ESTIMATE``, where known, against truth logged with it; both come in pieces.

    Args:
        part, name: field of the estimate, and of this field; its values are (n,) or (n, k).
        true_columns: rows of the truth → (k, m) true values.
        is_angle: whether errors are angles, of which the shorter one counts.
    """

    def __init__(
        self, part: str, name: str, true_columns: Callable[[Rows], FloatArray], *, is_angle: bool = False
    ) -> None:
        self._part, self._name, self._true_columns, self._is_angle = part, name, true_columns, is_angle
        self._truth, self._estimates = TimestampQueue(), TimestampQueue()
        self._squares, self._count = np.zeros(1), 0  # sums of squares of each column

    def add(self, estimates: Rows, truth: Rows | None) -> None:
        """Add records of ``ESTIMATE``, and rows of the truth."""
        known = estimates[estimates[self._part]["known"] == 1]
        self._estimates.add(series_of(stamp_ns=known["stamp_ns"], value=known[self._part][self._name]).rows)
        self._truth.add(truth)
        until_ns = min(self._estimates.last_ns, self._truth.last_ns)
        due, true = self._estimates.pop_until(until_ns), self._truth.pop_until(until_ns)
        if due is None or true is None:
            return
        due = due[(due["stamp_ns"] >= true["stamp_ns"][0]) & (due["stamp_ns"] <= true["stamp_ns"][-1])]
        columns = self._true_columns(true)
        expected = [np.interp(due["stamp_ns"], true["stamp_ns"], column) for column in columns]
        errors = due["value"].reshape(len(due), len(columns)) - np.column_stack(expected)
        errors = wrap_angles(errors) if self._is_angle else errors
        self._squares, self._count = self._squares + np.sum(errors**2, axis=0), self._count + len(due)

    def rmse(self, columns: slice = slice(None)) -> float | None:
        """RMS error of some columns together; None without compared samples."""
        return math.sqrt(float(np.mean(self._squares[columns])) / self._count) if self._count else None


def _join_paths(before: Path, P_before: FloatArray, path: Path, P: FloatArray) -> tuple[Path, FloatArray]:
    """Two pieces of a path as one, with continuous heading, and their covariances."""
    stamps_ns = np.concatenate((before.stamps_ns, path.stamps_ns))
    poses = np.concatenate((before.poses, path.poses))
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(stamps_ns, poses), np.concatenate((P_before, P))
