# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of what comes piece by piece, against a truth that is never behind it: exact, in bounded memory."""

import math

import numpy as np

from trackslip_common.arrays import FloatArray, Rows
from trackslip_tools.replay.dead_reckoning import Path
from trackslip_tools.replay.scoring import Score, errors_of, moving_slips, nees_of_each, path_of, slip_errors
from trackslip_tools.replay.series import Series, in_order, series_of

_RECENT_NS = 1_000_000_000  # a truth of the same time may be logged so much later


class Waiting:
    """Rows that wait until something else has come as far."""

    def __init__(self) -> None:
        self._parts: list[Rows] = []

    def add(self, rows: Rows | None) -> None:
        """More of them, with the field ``stamp_ns``."""
        if rows is not None and len(rows):
            self._parts.append(rows)

    @property
    def last_ns(self) -> int:
        """The newest stamp; 0 where none waits."""
        return max((int(rows["stamp_ns"].max()) for rows in self._parts), default=0)

    def due(self, stamp_ns: int) -> Rows | None:
        """Those up to a stamp, which leave, by stamp; of several with one stamp the last. None: none."""
        if not self._parts:
            return None
        rows = self._parts[0] if len(self._parts) == 1 else np.concatenate(self._parts)
        due = rows["stamp_ns"] <= stamp_ns
        self._parts = [] if due.all() else [rows[~due]]
        return in_order(rows[due]) if due.any() else None


class Pairs:
    """Estimates, and true rows around them, both of which come piece by piece."""

    def __init__(self) -> None:
        self._truth, self._estimates = Waiting(), Waiting()

    def add(self, estimates: Rows, truth: Rows | None) -> tuple[Rows, Rows] | None:
        """More of both; the estimates that have true rows on both sides, and those. None: none yet."""
        self._truth.add(truth)
        self._estimates.add(estimates)
        until_ns = min(self._estimates.last_ns, self._truth.last_ns)
        found, true = self._estimates.due(until_ns), self._truth.due(until_ns)
        if found is None or true is None:
            return None
        inside = (found["stamp_ns"] >= true["stamp_ns"][0]) & (found["stamp_ns"] <= true["stamp_ns"][-1])
        return found[inside], true


class PathErrors:
    """RMS errors of a path, and its mean NEES where its poses have covariances.

    Samples of the reference without a heading (nan) count for the position alone. A reference with a
    ``covariance`` counts with it in the NEES; samples at which the sum of both is singular do not.
    """

    def __init__(self) -> None:
        self._reference = Waiting()  # stamp_ns, x, y, heading, and covariance where it has one
        self._recent: tuple[Path, FloatArray] | None = None  # the end of the piece before
        self._position = self._heading = self._nees = self._nees_position = 0.0  # sums of squares
        self.last_position: float | None = None  # m, at the newest sample that was compared
        self._count = self._headed = self._with_nees = self._with_nees_position = 0

    def add(self, path: Path, reference: Rows | None, covariances: FloatArray | None = None) -> None:
        """More of both; ``covariances`` (n, 3, 3) of the path's poses."""
        self._reference.add(reference)
        if not len(path.stamps_ns):
            return
        P = np.empty((len(path.stamps_ns), 0, 0)) if covariances is None else covariances
        if self._recent is not None and self._recent[0].stamps_ns[-1] < path.stamps_ns[0]:
            path, P = _joined(*self._recent, path, P)
        recent = slice(int(np.searchsorted(path.stamps_ns, path.stamps_ns[-1] - _RECENT_NS)), None)
        self._recent = Path(path.stamps_ns[recent], path.poses[recent]), P[recent]
        due = self._reference.due(int(path.stamps_ns[-1]))
        if due is None:
            return
        R = due["covariance"] if "covariance" in (due.dtype.names or ()) else None
        true = Path(due["stamp_ns"], np.column_stack([due[name] for name in ("x", "y", "heading")]), R)
        errors = errors_of(path, true)
        self._count += len(errors)
        if len(errors):
            self.last_position = float(np.hypot(*errors[-1, :2]))
        self._position += float(np.sum(errors[:, :2] ** 2))
        headed = np.isfinite(errors[:, 2])
        self._headed += int(headed.sum())
        self._heading += float(np.sum(errors[headed, 2] ** 2))
        if covariances is not None:
            pose, position = nees_of_each(path, P, true)[0], nees_of_each(path, P, true, 2)[0]
            known, known_position = headed & np.isfinite(pose), np.isfinite(position)
            self._nees += float(np.sum(pose[known]))
            self._nees_position += float(np.sum(position[known_position]))
            self._with_nees += int(known.sum())
            self._with_nees_position += int(known_position.sum())

    def add_estimates(self, estimates: Rows, reference: Rows | None) -> None:
        """More of both; (n,) with stamp_ns, pose, pose_covariance."""
        estimates = in_order(estimates)
        self.add(path_of(estimates), reference, estimates["pose_covariance"])

    @property
    def score(self) -> Score | None:
        """None where nothing was compared."""
        if not self._count:
            return None
        heading = math.sqrt(self._heading / self._headed) if self._headed else None
        return Score(self._count, math.sqrt(self._position / self._count), heading)

    @property
    def nees(self) -> float | None:
        """Mean of the pose's; None where nothing was compared."""
        return self._nees / self._with_nees if self._with_nees else None

    @property
    def nees_position(self) -> float | None:
        """Mean of the position's; None where nothing was compared."""
        return self._nees_position / self._with_nees_position if self._with_nees_position else None


class SlipErrors:
    """RMS error of left and right slip together, as ``moving_slips`` has them; ``tread`` in m."""

    def __init__(self, tread: float) -> None:
        self._tread = tread
        self._slips, self._odometry = Waiting(), Waiting()
        self._recent: Rows | None = None  # estimates
        self._sum, self._count = 0.0, 0

    def add(self, estimates: Rows, slips: Rows | None, odometry: Rows | None) -> None:
        """More of the estimates (stamp_ns, slips) and of both truths."""
        self._slips.add(slips)
        self._odometry.add(odometry)
        if not len(estimates):
            return
        estimates = in_order(estimates)
        if self._recent is not None and self._recent["stamp_ns"][-1] < estimates["stamp_ns"][0]:
            estimates = np.concatenate((self._recent, estimates))
        self._recent = estimates[
            np.searchsorted(estimates["stamp_ns"], estimates["stamp_ns"][-1] - _RECENT_NS) :
        ]
        until_ns = min(int(estimates["stamp_ns"][-1]), self._slips.last_ns, self._odometry.last_ns)
        true, driven = self._slips.due(until_ns), self._odometry.due(until_ns)
        if true is None or driven is None:
            return
        left, right = estimates["slips"][:, 0], estimates["slips"][:, 1]
        own = series_of(stamp_ns=estimates["stamp_ns"], left_slip=left, right_slip=right)
        errors = slip_errors(own, moving_slips(Series(driven), Series(true), self._tread))
        self._sum, self._count = self._sum + float(np.sum(errors**2)), self._count + errors.size

    @property
    def rmse(self) -> float | None:
        """None where nothing was compared."""
        return math.sqrt(self._sum / self._count) if self._count else None


def _joined(before: Path, P_before: FloatArray, path: Path, P: FloatArray) -> tuple[Path, FloatArray]:
    """Two pieces of a path, its heading continuous, and their covariances."""
    stamps_ns = np.concatenate((before.stamps_ns, path.stamps_ns))
    poses = np.concatenate((before.poses, path.poses))
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(stamps_ns, poses), np.concatenate((P_before, P))
