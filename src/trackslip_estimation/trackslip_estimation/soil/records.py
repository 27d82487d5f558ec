# SPDX-License-Identifier: Apache-2.0
"""What the soil estimator takes in and gives out, and why it refuses an input."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.motion import Motion

FloatArray = NDArray[np.float64]

HYDRAULICS, ODOMETRY, SLIPS = "hydraulics", "odometry", "track_slip"  # sources: the topics they come on
_ROUNDING = 1e-9
_LARGEST = 1e12  # Pa, m/s, …: beyond it is no measurement


@dataclass(frozen=True)
class Hydraulics:
    """Travel hydraulics of both tracks; positive drives forward."""

    stamp_ns: int
    left_pressure: float  # Pa, differential
    right_pressure: float
    left_spool: float  # −1 … 1
    right_spool: float
    source: str = HYDRAULICS

    def is_finite(self) -> bool:
        """Whether all are numbers."""
        values = (self.left_pressure, self.right_pressure, self.left_spool, self.right_spool)
        return all(abs(v) < _LARGEST for v in values)


class Place(NamedTuple):
    """Where C is."""

    pose: FloatArray  # (3,) x m, y m, heading rad, site frame
    covariance: FloatArray  # (3, 3)

    def along(self) -> float:
        """Variance of the position along the heading, m²."""
        ahead = np.array((math.cos(self.pose[2]), math.sin(self.pose[2])))
        return max(float(ahead @ self.covariance[:2, :2] @ ahead), 0.0)

    def way_to(self, other: "Place") -> float:
        """Way from here along the heading halfway, m."""
        (x, y, yaw), (x_there, y_there, yaw_there) = self.pose.tolist(), other.pose.tolist()
        halfway = yaw + 0.5 * math.remainder(yaw_there - yaw, 2.0 * math.pi)
        return float((x_there - x) * math.cos(halfway) + (y_there - y) * math.sin(halfway))


@dataclass(frozen=True, eq=False)
class Odometry:
    """Velocity and place of the machine at C, as the slip estimator gives them."""

    stamp_ns: int
    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s
    twist_covariance: FloatArray  # (3, 3)
    place: Place
    source: str = ODOMETRY

    def is_finite(self) -> bool:
        """Whether all are numbers, and the covariance of v_x and yaw rate can be one."""
        if not _are_numbers(self.twist, self.twist_covariance, *self.place):
            return False
        (v_x, _, both), _, (_, _, rate) = self.twist_covariance.tolist()
        return bool(v_x >= 0.0 and rate >= 0.0 and both**2 <= v_x * rate * (1.0 + _ROUNDING))


@dataclass(frozen=True, eq=False)
class Slips:
    """Slips of the tracks at the same stamp; how certain they are follows from the twist."""

    stamp_ns: int
    mean: FloatArray  # (3,) left, right, slip angle rad
    motion: Motion
    source: str = SLIPS

    def is_finite(self) -> bool:
        """Whether all are numbers."""
        return _are_numbers(self.mean)


SoilInput: TypeAlias = Hydraulics | Odometry | Slips


def inputs_of(estimate: Estimate) -> tuple[Odometry, Slips]:
    """What the slip estimator publishes of an estimate, as the soil estimator takes it."""
    of, place = estimate.outputs, Place(estimate.pose, estimate.pose_covariance)
    return (
        Odometry(estimate.stamp_ns, of.twist, of.twist_covariance, place),
        Slips(estimate.stamp_ns, of.slips, estimate.motion),
    )


class Refusal(Enum):
    """Why an input was not used."""

    INVALID = "holds nan or infinity"
    DUPLICATE = "same stamp as one before"
    TOO_LATE = "older than what is done already"
    AHEAD = "far ahead of the others"
    UNPAIRED = "odometry and track_slip are not both there"
    RESTARTED = "the clock went back: all begins anew"


@dataclass(frozen=True)
class TrackForces:
    """Forces between the tracks and the ground; pairs are left, right."""

    stamp_ns: int
    thrust: tuple[float, float]  # N
    thrust_variance: tuple[float, float]  # N²
    resistance: tuple[float, float]  # N
    resistance_variance: tuple[float, float]  # N²
    reserve: tuple[float, float]  # 1 − |F|/F_max; nan while F_max is unknown


@dataclass(frozen=True, eq=False)
class SlipSeed:
    """Slips of both tracks in straight motion, told by thrust and soil."""

    stamp_ns: int
    slips: FloatArray  # (2,) left, right
    covariance: FloatArray  # (2, 2)


def _are_numbers(*arrays: FloatArray) -> bool:
    return all(bool((np.abs(array) < _LARGEST).all()) for array in arrays)
