# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Result of one cell of the study.

e      error against the truth
NEES   eᵀ P⁻¹ e of pose or slips; its mean is their dimension if P is consistent
NIS    νᵀ S⁻¹ ν of a measurement; its mean is its dimension if consistent
N      runs; the χ² bounds apply to a mean over N runs
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from trackslip_common.arrays import FloatArray
from trackslip_sim.study.slip.drive import Drive
from trackslip_sim.study.slip.parameters import Cell, StudyParameters

Interval = tuple[float, float]

CONFIDENCE = 0.95
IGNORING_ATTITUDE = ("position_rmse", "turning_slip_rmse", "nees_pose")
_POSITION, _HEADING, _SLIPS, _ALPHA = slice(0, 2), slice(2, 3), slice(3, 5), slice(5, 6)
_SWING = slice(6, 7)


@dataclass(frozen=True)
class Row:
    """RMSE, root of the mean bound, and means of NEES and NIS; all over runs and scored time."""

    truth: str
    soil: str
    filter: str
    sigma_xy: float  # m
    sigma_omega: float  # rad/s
    sigma_heading: float  # rad
    scenario: str
    seeds: int
    position_rmse: float  # m
    position_bound: float
    heading_rmse: float  # rad
    heading_bound: float
    slip_rmse: float  # 1, RMS over both tracks
    slip_bound: float
    turning_slip_rmse: float
    turning_slip_bound: float
    alpha_rmse: float  # rad
    alpha_bound: float
    nees_pose: float
    nees_pose_bounds: Interval
    nees_pose_inside: float  # share of time with the mean over runs inside the bounds
    nees_slip: float
    nees_slip_bounds: Interval
    nees_slip_inside: float
    nis_pose: float
    nis_pose_bounds: Interval
    nis_yaw_rate: float
    nis_yaw_rate_bounds: Interval
    terrain: str = ""
    ignoring_position_rmse: float | None = None  # of the filter without attitude, on terrain
    ignoring_turning_slip_rmse: float | None = None
    ignoring_nees_pose: float | None = None
    swing_rmse: float | None = None  # rad, if sensors are on the upper structure
    swing_bound: float | None = None


class Sums(NamedTuple):
    """Sums over one or more runs, at each scored time."""

    squares: FloatArray  # (s, 7) squared errors of x, y, φ, i_L, i_R, α, σ
    bounds: FloatArray  # (s, 7) least variances
    nees: FloatArray  # (s, 2) pose, slips
    nis: FloatArray  # (2,) pose, yaw rate; means over time


def sum_runs(runs: Iterable[Sums]) -> Sums:
    """The sum over one or more runs."""
    return reduce(lambda a, b: Sums(*map(add, a, b)), runs)


def mean_bounds(dof: int, runs: int) -> Interval:
    """Interval that contains the mean over runs of a χ² variable with probability ``CONFIDENCE``."""
    tails = np.array(((1.0 + CONFIDENCE) / 2.0, (1.0 - CONFIDENCE) / 2.0))
    low, high = chdtri(dof * runs, tails) / runs
    return float(low), float(high)


def summary(cell: Cell, p: StudyParameters, sums: Sums, drive: Drive) -> Row:
    """The row of a cell: means over runs and time."""
    runs, always = p.seeds, np.ones_like(drive.moving)
    squares, bounds, nees, nis = (part / runs for part in sums)
    values: dict[str, Any] = asdict(cell)
    values |= {"sigma_heading": p.sigma_heading, "scenario": p.scenario, "seeds": runs}
    for name, columns, mask, tracks in (
        ("position", _POSITION, always, 1),
        ("heading", _HEADING, always, 1),
        ("slip", _SLIPS, drive.moving, 2),
        ("turning_slip", _SLIPS, drive.turning, 2),
        ("alpha", _ALPHA, drive.moving, 1),
        *([("swing", _SWING, always, 1)] if drive.swings else []),
    ):
        values[f"{name}_rmse"] = _root_mean(squares[mask, columns], tracks)
        values[f"{name}_bound"] = _root_mean(bounds[mask, columns], tracks)
    dimensions = {"nees_pose": 3, "nees_slip": 2, "nis_pose": drive.fix_size, "nis_yaw_rate": 1}
    intervals = {name: mean_bounds(dof, runs) for name, dof in dimensions.items()}
    values |= {f"{name}_bounds": interval for name, interval in intervals.items()}
    for name, column in (("nees_pose", nees[:, 0]), ("nees_slip", nees[drive.moving, 1])):
        low, high = intervals[name]
        values[name] = _mean(column)
        values[f"{name}_inside"] = _mean((low <= column) & (column <= high))
    values["nis_pose"], values["nis_yaw_rate"] = map(float, nis)
    return Row(**values)


def _mean(values: NDArray[Any]) -> float:
    """The mean; nan of no values."""
    return float(np.mean(values)) if values.size else float("nan")


def _root_mean(squares: FloatArray, tracks: int) -> float:
    """Root of the mean over time of the columns' sum over ``tracks``; nan of no samples."""
    if not len(squares):
        return float("nan")
    return float(np.sqrt(np.mean(squares.sum(axis=1)) / tracks))
