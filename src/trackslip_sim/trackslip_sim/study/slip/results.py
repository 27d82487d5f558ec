# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What a cell of the study comes to.

e      error against the truth
NEES   eᵀ P⁻¹ e of pose or slips, on average their number if P is consistent
NIS    νᵀ S⁻¹ ν of a measurement, on average its number
N      runs; the χ² bounds are those of a mean over N runs
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
IGNORING = ("position_rmse", "turning_slip_rmse", "nees_pose")
_POSITION, _HEADING, _SLIPS, _ALPHA = slice(0, 2), slice(2, 3), slice(3, 5), slice(5, 6)
_SWING = slice(6, 7)


@dataclass(frozen=True)
class Row:
    """RMSE and root of the mean bound over runs and scored time; means of NEES and NIS over the same."""

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
    slip_rmse: float  # both tracks together
    slip_bound: float
    turning_slip_rmse: float
    turning_slip_bound: float
    alpha_rmse: float  # rad
    alpha_bound: float
    nees_pose: float
    nees_pose_bounds: Interval
    nees_pose_inside: float  # share of the time at which the mean over the runs is inside the bounds
    nees_slip: float
    nees_slip_bounds: Interval
    nees_slip_inside: float
    nis_pose: float
    nis_pose_bounds: Interval
    nis_yaw_rate: float
    nis_yaw_rate_bounds: Interval
    terrain: str = ""
    ignoring_position_rmse: float | None = None  # of a filter to which the ground is flat, on a terrain
    ignoring_turning_slip_rmse: float | None = None
    ignoring_nees_pose: float | None = None
    swing_rmse: float | None = None  # rad, where sensors sit above
    swing_bound: float | None = None


class Sums(NamedTuple):
    """Of one run, or of several together, at each scored time."""

    squares: FloatArray  # (s, 7) errors squared: x, y, φ, i_L, i_R, α, σ
    bounds: FloatArray  # (s, 7) least variances
    nees: FloatArray  # (s, 2) pose, slips
    nis: FloatArray  # (2,) pose, yaw rate; means over time


def total(runs: Iterable[Sums]) -> Sums:
    """Of several runs, one or more."""
    return reduce(lambda a, b: Sums(*map(add, a, b)), runs)


def mean_bounds(dof: int, runs: int) -> Interval:
    """Between which the mean over runs of a χ² number lies with ``CONFIDENCE``."""
    beyond = np.array(((1.0 + CONFIDENCE) / 2.0, (1.0 - CONFIDENCE) / 2.0))
    low, high = chdtri(dof * runs, beyond) / runs
    return float(low), float(high)


def summary(cell: Cell, p: StudyParameters, sums: Sums, drive: Drive) -> Row:
    """Means over runs and time."""
    runs, always = p.seeds, np.ones_like(drive.moving)
    squares, bounds, nees, nis = (part / runs for part in sums)
    values: dict[str, Any] = asdict(cell)
    values |= {"sigma_heading": p.sigma_heading, "scenario": p.scenario, "seeds": runs}
    for name, columns, requested, tracks in (
        ("position", _POSITION, always, 1),
        ("heading", _HEADING, always, 1),
        ("slip", _SLIPS, drive.moving, 2),
        ("turning_slip", _SLIPS, drive.turning, 2),
        ("alpha", _ALPHA, drive.moving, 1),
        *([("swing", _SWING, always, 1)] if drive.swings else []),
    ):
        values[f"{name}_rmse"] = _root_mean(squares[requested, columns], tracks)
        values[f"{name}_bound"] = _root_mean(bounds[requested, columns], tracks)
    numbers = {"nees_pose": 3, "nees_slip": 2, "nis_pose": drive.fix_size, "nis_yaw_rate": 1}
    intervals = {name: mean_bounds(dof, runs) for name, dof in numbers.items()}
    values |= {f"{name}_bounds": interval for name, interval in intervals.items()}
    for name, found in (("nees_pose", nees[:, 0]), ("nees_slip", nees[drive.moving, 1])):
        low, high = intervals[name]
        values[name] = _mean(found)
        values[f"{name}_inside"] = _mean((low <= found) & (found <= high))
    values["nis_pose"], values["nis_yaw_rate"] = map(float, nis)
    return Row(**values)


def _mean(values: NDArray[Any]) -> float:
    """Nan over no time."""
    return float(np.mean(values)) if values.size else float("nan")


def _root_mean(squares: FloatArray, tracks: int) -> float:
    """Over time, of the sum of the columns, or of their mean over the tracks; nan over no time."""
    if not len(squares):
        return float("nan")
    return float(np.sqrt(np.mean(squares.sum(axis=1)) / tracks))
