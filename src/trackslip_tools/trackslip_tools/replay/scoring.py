# SPDX-License-Identifier: Apache-2.0
"""Errors against a reference: every sample of it, at its own stamp, with no re-alignment.

e      error of x, y, heading        m, m, rad
P      covariance that was claimed   (3, 3)
NEES   eᵀ P⁻¹ e, on average 3 if P is consistent
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trackslip_tools.replay.dead_reckoning import Path
from trackslip_tools.replay.series import Rows, Series

FloatArray = NDArray[np.float64]

_BLOCK = 100_000  # samples
MOVING = 0.05  # m/s of the faster track's frame, below which slip is not scored


@dataclass(frozen=True)
class Score:
    """Root mean square errors of one path, over the samples that it covers."""

    samples: int
    position: float  # m
    heading: float  # rad


def in_order(estimates: Rows) -> Rows:
    """(n,) estimates by stamp; of two with the same one, before and after a restart, the later one counts."""
    stamps_ns = estimates["stamp_ns"]
    if (np.diff(stamps_ns) > 0).all():
        return estimates
    _, from_the_end = np.unique(stamps_ns[::-1], return_index=True)
    return estimates[::-1][from_the_end]


def path_of(estimates: Rows) -> Path:
    """The poses of (n,) estimates as a path with continuous heading."""
    poses = estimates["pose"].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Path(estimates["stamp_ns"].copy(), poses)


def score(path: Path, reference: Path) -> Score | None:
    """Errors at the stamps of the reference; None where the path covers none of them."""
    errors = _errors(path, reference)
    if not len(errors):
        return None
    position, heading = np.hypot(errors[:, 0], errors[:, 1]), errors[:, 2]
    return Score(len(errors), _rms(position), _rms(heading))


def mean_nees(estimates: Rows, reference: Path) -> float | None:
    """Mean NEES of (x, y, heading), each sample with the covariance of the estimate nearest in time."""
    return nees(path_of(estimates), estimates["pose_covariance"], reference)


class NeesCollector:
    """Mean NEES of estimates that come piece by piece, against a reference that is never behind them."""

    def __init__(self) -> None:
        self._last: Rows | None = None  # (1,) estimate
        self._waiting: list[Rows] = []  # of the reference
        self._sum, self._count = 0.0, 0

    def add(self, estimates: Rows, reference: Rows | None) -> None:
        """More of both; rows of the reference have stamp_ns, x, y, heading."""
        if reference is not None:
            self._waiting.append(reference)
        if not len(estimates) or not self._waiting:
            self._last = estimates[-1:] if len(estimates) else self._last
            return
        estimates = in_order(estimates)
        if self._last is not None and self._last["stamp_ns"][0] < estimates["stamp_ns"][0]:
            estimates = np.concatenate((self._last, estimates))
        waiting = np.concatenate([_poses_of(rows) for rows in self._waiting])
        due = waiting["stamp_ns"] <= estimates["stamp_ns"][-1]
        self._waiting, self._last = [waiting[~due]], estimates[-1:]
        poses = np.column_stack([waiting[name][due] for name in ("x", "y", "heading")])
        path = path_of(estimates)
        found = nees_of_each(path, estimates["pose_covariance"], Path(waiting["stamp_ns"][due], poses))[0]
        self._sum, self._count = self._sum + float(found.sum()), self._count + len(found)

    def mean(self) -> float | None:
        """None where nothing was compared."""
        return self._sum / self._count if self._count else None


def _poses_of(rows: Rows) -> Rows:
    found = np.empty(len(rows), [(n, rows.dtype[n]) for n in ("stamp_ns", "x", "y", "heading")])
    for name in found.dtype.names or ():
        found[name] = rows[name]
    return found


def nees(path: Path, covariances: FloatArray, reference: Path) -> float | None:
    """Mean NEES of a path whose poses have ``covariances`` (n, 3, 3)."""
    found = nees_of_each(path, covariances, reference)[0]
    return float(np.mean(found)) if len(found) else None


def nees_of_each(path: Path, covariances: FloatArray, reference: Path) -> tuple[FloatArray, FloatArray]:
    """(k,) NEES at the samples of the reference that the path covers, and (k,) ln |P| there."""
    errors = _errors(path, reference)
    midpoints = (path.stamps_ns[1:] + path.stamps_ns[:-1]) // 2
    nearest = np.searchsorted(midpoints, reference.stamps_ns[_inside(path, reference)])
    found, log_dets = np.empty(len(errors)), np.empty(len(errors))
    for first in range(0, len(errors), _BLOCK):  # copies of all covariances would not fit into memory
        part = slice(first, first + _BLOCK)
        P = covariances[nearest[part]]
        weighed = np.linalg.solve(P, errors[part, :, np.newaxis])[:, :, 0]
        found[part], log_dets[part] = np.sum(errors[part] * weighed, axis=1), np.linalg.slogdet(P)[1]
    return found, log_dets


def moving_slips(odometry: Series, slips: Series, tread: float) -> Series:
    """The samples of the true slips at which a track's frame moves: elsewhere a slip means nothing.

    ``odometry`` is the truth at the same stamps.
    """
    _, at, of = np.intersect1d(slips.stamps_ns, odometry.stamps_ns, return_indices=True)
    v_x, rate = odometry["v_x"][of], odometry["yaw_rate"][of]
    return Series(slips.rows[at[np.abs(v_x) + np.abs(rate) * tread / 2.0 > MOVING]])


def slip_rmse(estimated: Series, true: Series) -> float | None:
    """RMS error of left and right slip together, at the stamps of the truth."""
    own = estimated.stamps_ns
    inside = (true.stamps_ns >= own[0]) & (true.stamps_ns <= own[-1])
    if not inside.any():
        return None
    t, wanted = (own - own[0]) * 1e-9, (true.stamps_ns[inside] - own[0]) * 1e-9
    errors = [
        np.interp(wanted, t, estimated[side]) - true[side][inside] for side in ("left_slip", "right_slip")
    ]
    return _rms(np.stack(errors, axis=-1))


def _inside(path: Path, reference: Path) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (reference.stamps_ns >= path.stamps_ns[0]) & (
        reference.stamps_ns <= path.stamps_ns[-1]
    )
    return inside


def _errors(path: Path, reference: Path) -> FloatArray:
    """(k, 3) at the samples of the reference that the path covers, heading in (−π, π]."""
    inside = _inside(path, reference)
    stamps_ns = reference.stamps_ns[inside]
    errors = np.negative(reference.poses[inside], dtype=np.float64)
    for first in range(0, len(errors), _BLOCK):
        part = slice(first, first + _BLOCK)
        errors[part] += path.at(stamps_ns[part])
        errors[part, 2] = np.angle(np.exp(1j * errors[part, 2]))
    return errors


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
