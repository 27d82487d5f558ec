# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How well the estimator does on a random drive, and whether it knows how well.

e, P   error of the estimated pose, its covariance     (3,), (3, 3)
NEES   eᵀ P⁻¹ e, on average 3 if P is consistent
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.log import make_log, run_log
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import POSE, SPROCKETS
from trackslip_sim.drives.drive import RandomDrive

LARGE = 30.0  # NEES
_SILENCE = 10.0  # s without fixes that count as such
_LONG = 60.0  # s, minutes without
_SETTLED = 10.0  # s after fixes came back


class Score(NamedTuple):
    """Of one drive."""

    position_rmse: float  # m, while there are fixes
    nees: float  # mean over the drive
    longest: float  # s for which it was above ``LARGE`` without a break
    headings: FloatArray  # (a,) |e_φ| over its standard deviation, ``_SETTLED`` after fixes came back
    ends: FloatArray  # (b,) e² of x and y by their covariance, at the end of minutes without fixes
    end_errors: FloatArray  # (b,) m
    refused_in_a_row: int  # fixes


class _Path(NamedTuple):
    """What the estimator published."""

    t: FloatArray  # (n,) s
    errors: FloatArray  # (n, 3)
    covariances: FloatArray  # (n, 3, 3)
    accepted: NDArray[np.bool_]  # (m,) of the fixes


def score(drive: RandomDrive, p: SlipEstimatorParameters) -> Score:
    """The estimator's, on one drive."""
    path = _run(drive, p)
    t, errors, P = path.t, path.errors, path.covariances
    nees = _squares(errors, P)
    gaps = np.diff(drive.fix_times, append=np.inf)
    last, back = drive.fix_times[:-1][gaps[:-1] > _SILENCE], drive.fix_times[1:][gaps[:-1] > _SILENCE]
    due = back + _SETTLED
    stays = np.diff(np.searchsorted(drive.fix_times, np.stack((due - 1.0, due))), axis=0)[0] > 0
    settled = np.searchsorted(t, due[stays])
    settled = settled[settled < len(t)]
    long = back[back - last > _LONG]
    ends = np.searchsorted(t, long) - 1
    seen = np.searchsorted(drive.fix_times, t, side="right")
    fresh = (seen > 0) & (t - drive.fix_times[np.maximum(seen - 1, 0)] < 1.0)
    planar = errors[ends, :2]
    return Score(
        position_rmse=float(np.sqrt(np.square(errors[fresh, :2]).sum(axis=1).mean())),
        nees=float(nees.mean()),
        longest=_longest(nees > LARGE) * float(t[1] - t[0]),
        headings=np.abs(errors[settled, 2]) / np.sqrt(P[settled, 2, 2]),
        ends=_squares(planar, P[ends, :2, :2]),
        end_errors=np.hypot(*planar.T),
        refused_in_a_row=_longest(~path.accepted),
    )


def _run(drive: RandomDrive, p: SlipEstimatorParameters) -> _Path:
    """Estimates at the sprocket samples against the truth."""
    stamps, errors, covariances, accepted = [], [], [], []
    for block in run_log(make_log(drive.measurements, p), p):
        of = block.measurements["kind"]
        published = of == SPROCKETS
        stamps_ns = block.measurements["stamp_ns"][published]
        stamps.append((stamps_ns - drive.measurements["stamp_ns"].min()) * 1e-9)
        error = block.states["mean"][published, :3] - drive.pose_at(stamps_ns)
        error[:, 2] = np.remainder(error[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        errors.append(error)
        covariances.append(block.states["covariance"][published, :3, :3])
        accepted.append(block.updates["outcome"][of == POSE] == Outcome.ACCEPTED)
    return _Path(*map(np.concatenate, (stamps, errors, covariances, accepted)))


def _squares(errors: FloatArray, P: FloatArray) -> FloatArray:
    """(k,) eᵀ P⁻¹ e."""
    return np.asarray(np.einsum("ki,ki->k", errors, np.linalg.solve(P, errors[:, :, np.newaxis])[:, :, 0]))


def _longest(flags: NDArray[np.bool_]) -> int:
    """The most that are set in a row."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return int(np.diff(edges)[::2].max(initial=0))
