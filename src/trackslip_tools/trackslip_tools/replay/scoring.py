# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors against a reference at each of its samples and stamps, without re-alignment, in bounded memory.

e      error of x, y, heading        m, m, rad
P      covariance of the estimate    (3, 3)
R      covariance of the reference's own pose, 0 if its message has none   (3, 3)
S      P + R: errors of estimate and reference are taken as independent
NEES   eᵀ S⁻¹ e, on average 3 if P and R are consistent; of x and y alone 2; nan where S is singular

Samples of a reference without a heading have nan; their positions are scored all the same.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, Rows
from trackslip_common.orientations import wrap_angles
from trackslip_tools.replay.series import Path, Series, series_of, sort_by_stamp

MIN_MOVING_SPEED = 0.05  # m/s of the faster track's frame, and of the track; below, slip is not scored
_SINGULAR_EIGENVALUE = 1e-12  # of correlations; below, S counts as singular, because of rounding
_RECENT_NS = 1_000_000_000  # largest delay of a truth of the same stamp


@dataclass(frozen=True)
class Score:
    """Root mean square errors of one path, over the reference samples that it covers."""

    samples: int
    position: float  # m
    heading: float | None  # rad; None if the reference has none


def path_of(estimates: Rows) -> Path:
    """The poses of (n,) estimates as a path with continuous heading."""
    poses = estimates["pose"].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(estimates["stamp_ns"].copy(), poses)


def path_of_series(series: Series) -> Path:
    """The poses of messages as a path, with continuous heading where there is one."""
    poses = series.columns("x", "y", "heading")
    known = np.isfinite(poses[:, 2])
    poses[known, 2] = np.unwrap(poses[known, 2])
    covariances = series["covariance"] if "covariance" in (series.rows.dtype.names or ()) else None
    return Path(series.stamps_ns.copy(), poses, covariances)


def nees_of_each(
    path: Path, covariances: FloatArray, reference: Path, size: int = 3
) -> tuple[FloatArray, FloatArray]:
    """(k,) NEES at the samples of the reference that the path covers, and (k,) ln |S| there.

    ``size`` 3: of the pose, nan where the reference has no heading; 2: of the position. nan where S is
    singular: correlations with an eigenvalue below 1e-12, or a variance that is not positive.
    """
    errors = errors_of(path, reference)[:, :size]
    midpoints = (path.stamps_ns[1:] + path.stamps_ns[:-1]) // 2
    is_covered = is_covered_by(path, reference)
    S = covariances[np.searchsorted(midpoints, reference.stamps_ns[is_covered]), :size, :size]
    if reference.covariances is not None:
        S = S + usable_covariances(reference.covariances[is_covered, :size, :size])
    deviations, C, regular = _correlations(S)
    scaled = errors / deviations
    solved = np.linalg.solve(C, scaled[:, :, np.newaxis])[:, :, 0]
    log_dets = np.linalg.slogdet(C)[1] + 2.0 * np.log(deviations).sum(axis=1)
    return np.where(regular, np.sum(scaled * solved, axis=1), np.nan), np.where(regular, log_dets, np.nan)


def _correlations(S: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(n, m) standard deviations and (n, m, m) correlations of S, and (n,) whether S is regular.

    1 and the identity where S is singular.
    """
    variances = np.diagonal(S, axis1=1, axis2=2)
    is_regular: BoolArray = np.asarray(
        np.isfinite(S).all(axis=(1, 2)) & (variances > 0.0).all(axis=1), np.bool_
    )
    deviations = np.sqrt(np.where(is_regular[:, np.newaxis], variances, 1.0))
    identity = np.eye(S.shape[-1])
    C = np.where(is_regular[:, np.newaxis, np.newaxis], S, identity)
    C = C / deviations[:, :, np.newaxis] / deviations[:, np.newaxis, :]
    is_regular &= np.linalg.eigvalsh(C)[:, 0] > _SINGULAR_EIGENVALUE
    C = np.where(is_regular[:, np.newaxis, np.newaxis], C, identity)
    return np.where(is_regular[:, np.newaxis], deviations, 1.0), C, is_regular


def usable_covariances(R: FloatArray) -> FloatArray:
    """(n, m, m) covariances of messages; 0 for each that is not finite or not positive semidefinite."""
    finite = np.asarray(np.isfinite(R).all(axis=(1, 2)))
    symmetric = np.where(finite[:, np.newaxis, np.newaxis], (R + R.transpose(0, 2, 1)) / 2.0, 0.0)
    least, most = np.linalg.eigvalsh(symmetric)[:, [0, -1]].T
    usable: FloatArray = np.where((least >= -1e-9 * most)[:, np.newaxis, np.newaxis], symmetric, 0.0)
    return usable


def moving_slips(odometry: Series, slips: Series, tread: float) -> Series:
    """The true slips at samples at which a track's frame moves: slip is undefined at standstill.

    The slip of a track that hardly turns is nan, even if the other track moves its frame. The track's speed
    is r ω = v/(1 − i); if the truth gives a stopped track the slip 0, the track counts as rolling with its
    frame. ``odometry`` is the truth at the same stamps.
    """
    _, of_slips, of_odometry = np.intersect1d(slips.stamps_ns, odometry.stamps_ns, return_indices=True)
    v_x, turning_speed = odometry["v_x"][of_odometry], odometry["yaw_rate"][of_odometry] * tread / 2.0
    is_moving = np.abs(v_x) + np.abs(turning_speed) > MIN_MOVING_SPEED
    rows = slips.rows[of_slips[is_moving]]
    for side, ground_speed in (("left_slip", v_x - turning_speed), ("right_slip", v_x + turning_speed)):
        is_rolling = np.abs(ground_speed[is_moving]) > MIN_MOVING_SPEED * np.abs(1.0 - rows[side])
        rows[side][~is_rolling] = np.nan
    return Series(rows)


def slip_errors(estimated: Series, true: Series) -> FloatArray:
    """(k,) errors of left and right slip, at the samples that the estimate covers, without nan truths."""
    stamps_ns = estimated.stamps_ns
    is_covered = (true.stamps_ns >= stamps_ns[0]) & (true.stamps_ns <= stamps_ns[-1])
    t, requested = (stamps_ns - stamps_ns[0]) * 1e-9, (true.stamps_ns[is_covered] - stamps_ns[0]) * 1e-9
    errors = np.concatenate(
        [
            np.interp(requested, t, estimated[side]) - true[side][is_covered]
            for side in ("left_slip", "right_slip")
        ]
    )
    known: FloatArray = errors[np.isfinite(errors)]
    return known


def is_covered_by(path: Path, reference: Path) -> BoolArray:
    """(n,) whether the path covers the stamp of each sample of the reference."""
    stamps_ns = reference.stamps_ns
    return np.asarray((stamps_ns >= path.stamps_ns[0]) & (stamps_ns <= path.stamps_ns[-1]))


def errors_of(path: Path, reference: Path) -> FloatArray:
    """(k, 3) errors at the samples of the reference that the path covers, heading in (−π, π]."""
    is_covered = is_covered_by(path, reference)
    stamps_ns = reference.stamps_ns[is_covered]
    errors: FloatArray = path.poses_at(stamps_ns) - reference.poses[is_covered]
    errors[:, 2] = wrap_angles(errors[:, 2])
    return errors


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


class Mean:
    """Mean of values that come in pieces; None without values."""

    def __init__(self) -> None:
        self._sum, self.count = 0.0, 0

    def add(self, values: FloatArray) -> None:
        """Add values of any shape."""
        self._sum, self.count = self._sum + float(np.sum(values)), self.count + values.size

    @property
    def value(self) -> float | None:
        """The mean."""
        return self._sum / self.count if self.count else None

    @property
    def root(self) -> float | None:
        """Square root of the mean."""
        return math.sqrt(self._sum / self.count) if self.count else None


class PathErrors:
    """RMS errors of a path, and its mean NEES where its poses have covariances.

    Reference samples without a heading (nan) count for the position alone. The NEES adds the ``covariance``
    of a reference to that of the path. It leaves out samples at which the sum is singular.
    """

    def __init__(self) -> None:
        self._reference = TimestampQueue()  # rows of stamp_ns, x, y, heading, and covariance if there is one
        self._recent: tuple[Path, FloatArray] | None = None  # end of the previous piece
        self._position, self._heading = Mean(), Mean()  # squared errors, m², rad²
        self._nees, self._log_dets = {2: Mean(), 3: Mean()}, {2: Mean(), 3: Mean()}  # of position, of pose
        self.last_position: float | None = None  # m, at the newest compared sample

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
        if rows is not None:
            self.compare(path, path_of_series(Series(rows)), None if covariances is None else P)

    def compare(self, path: Path, reference: Path, covariances: FloatArray | None = None) -> None:
        """Add the errors at the samples of a reference that the path covers; ``covariances`` of its poses."""
        errors = errors_of(path, reference)
        if len(errors):
            self.last_position = float(np.hypot(*errors[-1, :2]))
        self._position.add(np.sum(errors[:, :2] ** 2, axis=1))
        self._heading.add(errors[np.isfinite(errors[:, 2]), 2] ** 2)
        if covariances is None:
            return
        for size in self._nees:
            nees, log_dets = nees_of_each(path, covariances, reference, size)
            known = np.isfinite(nees)
            self._nees[size].add(nees[known])
            self._log_dets[size].add(log_dets[known])

    def add_estimates(self, estimates: Rows, reference: Rows | None) -> None:
        """Add both; estimates (n,) with stamp_ns, pose, pose_covariance."""
        estimates = sort_by_stamp(estimates)
        self.add(path_of(estimates), reference, estimates["pose_covariance"])

    @property
    def score(self) -> Score | None:
        """RMS errors; None without compared samples."""
        position = self._position.root
        return None if position is None else Score(self._position.count, position, self._heading.root)

    @property
    def nees(self) -> float | None:
        """Mean NEES of the pose; None without compared samples."""
        return self._nees[3].value

    @property
    def nees_position(self) -> float | None:
        """Mean NEES of the position; None without compared samples."""
        return self._nees[2].value

    @property
    def log_likelihood(self) -> float | None:
        """Mean ln likelihood of the reference's poses, of its positions where no sample has a heading."""
        size = 3 if self._heading.count else 2
        nees, log_det = self._nees[size].value, self._log_dets[size].value
        if nees is None or log_det is None:
            return None
        return -0.5 * (nees + log_det + size * math.log(2.0 * math.pi))


class SlipErrors:
    """RMS error of left and right slip together, over the samples of ``moving_slips``; ``tread`` in m."""

    def __init__(self, tread: float) -> None:
        self._tread = tread
        self._slips, self._odometry = TimestampQueue(), TimestampQueue()
        self._recent: Rows | None = None  # estimates
        self._squares = Mean()

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
        self._squares.add(errors**2)

    @property
    def rmse(self) -> float | None:
        """RMS error; None without compared samples."""
        return self._squares.root


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
