# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Errors against a reference at each of its samples and stamps, without re-alignment.

e      error of x, y, heading        m, m, rad
P      covariance of the estimate    (3, 3)
R      covariance of the reference's own pose, 0 if its message has none   (3, 3)
S      P + R: errors of estimate and reference are taken as independent
NEES   eᵀ S⁻¹ e, on average 3 if P and R are consistent; of x and y alone 2; nan where S is singular

Samples of a reference without a heading have nan; their positions are scored all the same.
"""

from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, Rows
from trackslip_common.orientations import wrap_angles
from trackslip_tools.replay.dead_reckoning import Path
from trackslip_tools.replay.series import Series

MIN_MOVING_SPEED = 0.05  # m/s of the faster track's frame, and of the track; below, slip is not scored
_SINGULAR_EIGENVALUE = 1e-12  # of correlations; below, S counts as singular, because of rounding


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


def score(path: Path, reference: Path) -> Score | None:
    """RMS errors at the stamps of the reference; None if the path covers none of them."""
    errors = errors_of(path, reference)
    if not len(errors):
        return None
    position, heading = np.hypot(errors[:, 0], errors[:, 1]), errors[np.isfinite(errors[:, 2]), 2]
    return Score(len(errors), _rms(position), _rms(heading) if heading.size else None)


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


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
