# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What the soil estimator takes in and gives out, and why it rejects an input.

One at a time they are dataclasses; many at once, and inside compiled code, numpy records with the same names.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.estimator import Estimate
from trackslip_estimation.slip.motion import Motion

FloatArray = NDArray[np.float64]

# Sources: the topics they come on
HYDRAULICS, ODOMETRY, SLIPS, SWING = "hydraulics", "odometry", "track_slip", "swing/estimate"
SOURCES = (HYDRAULICS, ODOMETRY, SLIPS, SWING)
IS_HYDRAULICS, IS_ODOMETRY, IS_SLIPS, IS_SWING = range(4)  # places in it

VALUES: list[Any] = [
    ("stamp_ns", "i8"),
    ("pressures", "f8", 2),  # hydraulics: left, right, Pa
    ("spools", "f8", 2),
    ("twist", "f8", 3),  # odometry: v_x m/s, v_y m/s, yaw rate rad/s
    ("twist_covariance", "f8", (3, 3)),
    ("pose", "f8", 3),  # x m, y m, heading rad
    ("pose_covariance", "f8", (3, 3)),
    ("tilt", "f8", 2),  # roll, pitch (nose down > 0), rad; 0 where the ground counts as level
    ("tilt_variance", "f8", 2),
    ("slips", "f8", 3),  # track_slip: left, right, slip angle rad
    ("motion", "i8"),
    ("swing", "f8"),  # swing/estimate: angle of the upper structure, rad
    ("swing_stddev", "f8"),  # infinite where it is not known
]
# The source is a place in SOURCES; only the fields of this source are set
SOIL_INPUT = np.dtype([("source", "i8"), *VALUES])

_ROUNDING = 1e-9
_LARGEST = 1e12  # of any unit: beyond it is no number to reckon with
# Physical limits, beyond which an input is no measurement of a tracked vehicle
_FASTEST = 20.0  # m/s; the fastest ones drive 22
_FASTEST_TURN = 10.0  # rad/s
_FARTHEST = 1e8  # m, rad; the Earth is 4e7 m round
_STEEPEST = 1.5  # rad: beyond it nothing stands on its tracks
_LARGEST_ANGLE = 1e3  # rad, of the swing, and of its standard deviation where nobody knows it
_LARGEST_PRESSURE = 1e9  # Pa; what a transducer shows at a broken wire is for ``pressure_watch``
_LARGEST_SPOOL = 2.0  # of −1 … 1
_LARGEST_SLIP = 1e9  # of a track that hardly turns while the machine slides
_LARGEST_TWIST_VARIANCE = 1e4  # (m/s)², (rad/s)²
_LARGEST_POSE_VARIANCE = 1e10  # m², rad²
_LARGEST_TILT_VARIANCE = 10.0  # rad²


@dataclass(frozen=True)
class Hydraulics:
    """Travel hydraulics of both tracks; positive drives forward."""

    stamp_ns: int
    left_pressure: float  # Pa, differential
    right_pressure: float
    left_spool: float  # −1 … 1
    right_spool: float
    source: str = HYDRAULICS

    def write_to(self, record: Any) -> None:
        """Set the fields of a ``SOIL_INPUT``."""
        record["source"], record["stamp_ns"] = IS_HYDRAULICS, self.stamp_ns
        record["pressures"] = self.left_pressure, self.right_pressure
        record["spools"] = self.left_spool, self.right_spool


class PoseWithCovariance(NamedTuple):
    """Pose of C."""

    mean: FloatArray  # (3,) x m, y m, heading rad, site frame
    covariance: FloatArray  # (3, 3)

    def variance_along(self) -> float:
        """Of the position along the heading, m²."""
        heading = float(self.mean[2])
        ahead = np.array((math.cos(heading), math.sin(heading)))
        return max(float(ahead @ self.covariance[:2, :2] @ ahead), 0.0)

    def distance_to(self, other: "PoseWithCovariance") -> float:
        """Distance from here along the heading halfway, m."""
        (x, y, yaw), (x_there, y_there, yaw_there) = self.mean.tolist(), other.mean.tolist()
        halfway = yaw + 0.5 * math.remainder(yaw_there - yaw, 2.0 * math.pi)
        return float((x_there - x) * math.cos(halfway) + (y_there - y) * math.sin(halfway))


@dataclass(frozen=True, eq=False)
class Odometry:
    """Velocity and pose of the machine at C, as the slip estimator gives them."""

    stamp_ns: int
    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s
    twist_covariance: FloatArray  # (3, 3)
    pose: PoseWithCovariance
    tilt: tuple[float, float] = (0.0, 0.0)  # roll, pitch (nose down > 0), rad
    tilt_variance: tuple[float, float] = (0.0, 0.0)
    source: str = ODOMETRY

    def write_to(self, record: Any) -> None:
        """Set the fields of a ``SOIL_INPUT``."""
        record["source"], record["stamp_ns"] = IS_ODOMETRY, self.stamp_ns
        record["twist"], record["twist_covariance"] = self.twist, self.twist_covariance
        record["pose"], record["pose_covariance"] = self.pose
        record["tilt"], record["tilt_variance"] = self.tilt, self.tilt_variance


@dataclass(frozen=True, eq=False)
class Slips:
    """Slips of the tracks at the same stamp; how certain they are follows from the twist."""

    stamp_ns: int
    mean: FloatArray  # (3,) left, right, slip angle rad
    motion: Motion
    source: str = SLIPS

    def write_to(self, record: Any) -> None:
        """Set the fields of a ``SOIL_INPUT``."""
        record["source"], record["stamp_ns"] = IS_SLIPS, self.stamp_ns
        record["slips"], record["motion"] = self.mean, self.motion


@dataclass(frozen=True)
class Swing:
    """Where the upper structure looks at the same stamp."""

    stamp_ns: int
    angle: float  # against the undercarriage, counter-clockwise, rad
    stddev: float
    source: str = SWING

    def write_to(self, record: Any) -> None:
        """Set the fields of a ``SOIL_INPUT``."""
        record["source"], record["stamp_ns"] = IS_SWING, self.stamp_ns
        record["swing"], record["swing_stddev"] = self.angle, self.stddev


SoilInput: TypeAlias = Hydraulics | Odometry | Slips | Swing


def inputs_of(estimate: Estimate) -> tuple[SoilInput, ...]:
    """What the slip estimator publishes of an estimate, as the soil estimator takes it."""
    of, pose = estimate.outputs, PoseWithCovariance(estimate.pose, estimate.pose_covariance)
    tilt, variance = (0.0, 0.0), (0.0, 0.0)
    if of.tilt is not None:
        (roll, pitch, _), (of_roll, of_pitch, _) = of.tilt.tilt.tolist(), np.diag(of.tilt.covariance).tolist()
        tilt, variance = (roll, pitch), (of_roll, of_pitch)
    motion = (
        Odometry(estimate.stamp_ns, of.twist, of.twist_covariance, pose, tilt, variance),
        Slips(estimate.stamp_ns, of.slips, estimate.motion),
    )
    if of.swing is None:
        return motion
    return *motion, Swing(estimate.stamp_ns, of.swing.angle, math.sqrt(of.swing.covariance[0, 0]))


@compiled
def copy_input(source: Any, to: Any) -> None:
    """One ``SOIL_INPUT`` into another; assigned as a whole it would take the compiler seconds."""
    to.source, to.stamp_ns, to.motion = source.source, source.stamp_ns, source.motion
    to.swing, to.swing_stddev = source.swing, source.swing_stddev
    for k in range(2):
        to.pressures[k], to.spools[k] = source.pressures[k], source.spools[k]
        to.tilt[k], to.tilt_variance[k] = source.tilt[k], source.tilt_variance[k]
    for i in range(3):
        to.twist[i], to.pose[i], to.slips[i] = source.twist[i], source.pose[i], source.slips[i]
        for j in range(3):
            to.twist_covariance[i, j] = source.twist_covariance[i, j]
            to.pose_covariance[i, j] = source.pose_covariance[i, j]


class Rejection(Enum):
    """Why an input was not used."""

    INVALID = "holds nan or infinity"
    DUPLICATE = "same stamp as one before"
    TOO_LATE = "older than what is done already"
    AHEAD = "far ahead of the others"
    UNPAIRED = "odometry and track_slip are not both there"
    RESTARTED = "the clock went back: all begins anew"
    OUT_OF_RANGE = "beyond physical limits"
    DIVERGED = "the estimate was not finite any more: all begins anew"


# Of compiled code: the place of each in ``Rejection``
INVALID, DUPLICATE, TOO_LATE, AHEAD, UNPAIRED, RESTARTED, OUT_OF_RANGE, DIVERGED = range(8)
ACCEPTED = -1


@compiled
def fault_of(given: Any) -> int:
    """INVALID or OUT_OF_RANGE, where a ``SOIL_INPUT`` is one of both; else ACCEPTED."""
    if given.source == IS_HYDRAULICS:
        has_none = math.isnan(given.spools[0]) and math.isnan(given.spools[1])  # not measured: never closed
        of_spools = ACCEPTED if has_none else _of_numbers(given.spools, _LARGEST_SPOOL)
        return _worse(_of_numbers(given.pressures, _LARGEST_PRESSURE), of_spools)
    if given.source == IS_SLIPS:
        return _of_numbers(given.slips, _LARGEST_SLIP)
    if given.source == IS_SWING:
        return _worse(
            _of_number(given.swing, _LARGEST_ANGLE), _of_variance(given.swing_stddev, _LARGEST_ANGLE)
        )
    C, P = given.twist_covariance, given.pose_covariance
    fault = _worse(_of_number(given.twist[0], _FASTEST), _of_number(given.twist[1], _FASTEST))
    fault = _worse(fault, _of_number(given.twist[2], _FASTEST_TURN))
    fault = _worse(fault, _of_numbers(given.pose, _FARTHEST))
    for k in range(3):
        fault = _worse(fault, _of_variance(C[k, k], _LARGEST_TWIST_VARIANCE))
        fault = _worse(fault, _of_variance(P[k, k], _LARGEST_POSE_VARIANCE))
        for j in range(3):
            fault = _worse(fault, _of_number(C[k, j], _LARGEST_TWIST_VARIANCE))
            fault = _worse(fault, _of_number(P[k, j], _LARGEST_POSE_VARIANCE))
    for k in range(2):
        fault = _worse(fault, _of_number(given.tilt[k], _STEEPEST))
        fault = _worse(fault, _of_variance(given.tilt_variance[k], _LARGEST_TILT_VARIANCE))
    if fault == ACCEPTED and not _is_covariance(C):
        return INVALID
    return fault


@compiled
def _is_covariance(C: FloatArray) -> bool:
    """Whether that of v_x and yaw rate can be one."""
    product = C[0, 0] * C[2, 2]
    same = abs(C[0, 2] - C[2, 0]) <= _ROUNDING * math.sqrt(product)
    return bool(same and C[0, 2] ** 2 <= product * (1.0 + _ROUNDING))


@compiled
def _worse(one: int, other: int) -> int:
    """INVALID before OUT_OF_RANGE before ACCEPTED."""
    if one == INVALID or other == INVALID:
        return INVALID
    return max(one, other)


@compiled
def _of_numbers(values: FloatArray, largest: float) -> int:
    fault = ACCEPTED
    for k in range(len(values)):
        fault = _worse(fault, _of_number(values[k], largest))
    return fault


@compiled
def _of_number(value: float, largest: float) -> int:
    if not abs(value) < _LARGEST:
        return INVALID
    return ACCEPTED if abs(value) <= largest else OUT_OF_RANGE


@compiled
def _of_variance(variance: float, largest: float) -> int:
    return _of_number(variance, largest) if variance >= 0.0 else INVALID


@dataclass(frozen=True)
class TrackForces:
    """Forces between the tracks and the ground; pairs are left, right."""

    stamp_ns: int
    thrust: tuple[float, float]  # N
    thrust_variance: tuple[float, float]  # N²
    resistance: tuple[float, float]  # N
    resistance_variance: tuple[float, float]  # N²
    reserve: tuple[float, float]  # 1 − |F|/F_max; nan while F_max is unknown


FORCES = np.dtype(
    [
        ("stamp_ns", "i8"),
        ("thrust", "f8", 2),
        ("thrust_variance", "f8", 2),
        ("resistance", "f8", 2),
        ("resistance_variance", "f8", 2),
        ("reserve", "f8", 2),
        ("trouble", "i8", 2),  # place in ``Trouble``; not published
    ]
)


@dataclass(frozen=True, eq=False)
class SlipSeed:
    """Slips of both tracks in straight motion, from thrust and soil."""

    stamp_ns: int
    slips: FloatArray  # (2,) left, right
    covariance: FloatArray  # (2, 2)
