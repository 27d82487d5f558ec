# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs and outputs of the soil estimator, and the reasons to reject an input.

Single ones are dataclasses; arrays, and compiled code, use numpy records with the same field names.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, Table, dtype_of, make_table
from trackslip_common.topics import MACHINE_STATE
from trackslip_estimation.covariance import is_covariance_compiled
from trackslip_estimation.slip.motion import Motion

# Sources, named by topic
HYDRAULICS = "hydraulics"
SOURCES = (HYDRAULICS, MACHINE_STATE)
IS_HYDRAULICS, IS_MACHINE_STATE = range(2)  # indices in ``SOURCES``


class InputValues(Record):
    """Values of hydraulics and of the machine state."""

    stamp_ns: int
    pressures: Annotated[FloatArray, 2]  # hydraulics: left, right, Pa
    spools: Annotated[FloatArray, 2]
    twist: Annotated[FloatArray, 3]  # machine_state: v_x m/s, v_y m/s, yaw rate rad/s
    twist_covariance: Annotated[FloatArray, (3, 3)]
    pose: Annotated[FloatArray, 3]  # x m, y m, heading rad
    pose_covariance: Annotated[FloatArray, (3, 3)]
    tilt: Annotated[FloatArray, 2]  # roll, pitch (nose down > 0), rad; 0 (level ground) if unknown
    tilt_variance: Annotated[FloatArray, 2]  # rad²; infinite if unknown
    slips: Annotated[FloatArray, 3]  # left, right, slip angle rad
    motion: int
    swing: float  # angle of the upper structure, rad
    swing_variance: float  # rad², infinite if unknown


class SourceField(Record):
    """Source of an input."""

    source: int  # index in ``SOURCES``


class SoilInputRecord(InputValues, SourceField):
    """An input; only the fields of its source are set."""


SOIL_INPUT = dtype_of(SoilInputRecord)
_STATE_FIELDS = (
    *("stamp_ns", "twist", "twist_covariance", "tilt", "tilt_variance", "slips", "motion"),
    *("swing", "swing_variance"),
)

_LARGEST = 1e12  # in any unit; larger numbers are INVALID
# Physical limits of a tracked vehicle; larger values are OUT_OF_RANGE
_FASTEST = 20.0  # m/s; the fastest vehicles drive 22
_FASTEST_TURN = 10.0  # rad/s
_FARTHEST = 1e8  # m, rad; the Earth's circumference is 4e7 m
_STEEPEST = 1.5  # rad; beyond it a machine has tipped over
_LARGEST_ANGLE = 1e3  # rad, of the swing
_LARGEST_SWING_VARIANCE = 1e6  # rad², of an unknown angle
_LARGEST_PRESSURE = 1e9  # Pa; readings of a broken wire are left to ``pressure_watch``
_LARGEST_SPOOL = 2.0  # nominal range −1 … 1
_LARGEST_SLIP = 1e9  # reached by a track that hardly turns while the machine slides
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

    def write_to(self, record: SoilInputRecord) -> None:
        """Set the fields of an input."""
        record["source"], record["stamp_ns"] = IS_HYDRAULICS, self.stamp_ns
        record["pressures"] = self.left_pressure, self.right_pressure
        record["spools"] = self.left_spool, self.right_spool


class PoseWithCovariance(NamedTuple):
    """Pose of C with its covariance."""

    mean: FloatArray  # (3,) x m, y m, heading rad, site frame
    covariance: FloatArray  # (3, 3)

    def variance_along(self) -> float:
        """Return the variance of the position along the heading, m²."""
        heading = float(self.mean[2])
        ahead = np.array((math.cos(heading), math.sin(heading)))
        return max(float(ahead @ self.covariance[:2, :2] @ ahead), 0.0)

    def distance_to(self, other: "PoseWithCovariance") -> float:
        """Return the distance from this pose to another along the mean of both headings, m."""
        (x, y, yaw), (x_there, y_there, yaw_there) = self.mean.tolist(), other.mean.tolist()
        halfway = yaw + 0.5 * math.remainder(yaw_there - yaw, 2.0 * math.pi)
        return float((x_there - x) * math.cos(halfway) + (y_there - y) * math.sin(halfway))


@dataclass(frozen=True, eq=False)
class MachineState:
    """State of the machine at C at one instant, from the slip estimator."""

    stamp_ns: int
    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s
    twist_covariance: FloatArray  # (3, 3)
    pose: PoseWithCovariance
    slips: FloatArray  # (3,) left, right, slip angle rad; uncertainty: see the twist
    motion: Motion
    tilt: tuple[float, float] = (0.0, 0.0)  # roll, pitch (nose down > 0), rad
    tilt_variance: tuple[float, float] = (0.0, 0.0)  # rad², infinite if unknown
    swing: float = 0.0  # angle of the upper structure against the undercarriage, counter-clockwise, rad
    swing_variance: float = math.inf  # rad², infinite if unknown
    source: str = MACHINE_STATE

    def write_to(self, record: SoilInputRecord) -> None:
        """Set the fields of an input."""
        record["source"] = IS_MACHINE_STATE
        record["pose"], record["pose_covariance"] = self.pose
        for name in _STATE_FIELDS:
            record[name] = getattr(self, name)


SoilInput: TypeAlias = Hydraulics | MachineState


def inputs_from_estimates(estimates: NDArray[np.void]) -> Table[SoilInputRecord]:
    """Return inputs (n,) from (n,) of ``slip.records.ESTIMATE``, equal to those from live messages."""
    inputs = make_table(SoilInputRecord, SOIL_INPUT, len(estimates))
    inputs["source"] = IS_MACHINE_STATE
    for name in ("stamp_ns", "twist", "twist_covariance", "pose", "pose_covariance", "slips", "motion"):
        inputs[name] = estimates[name]
    tilt, swing = estimates["tilt"], estimates["swing"]
    has_tilt, has_swing = tilt["known"] == 1, swing["known"] == 1
    variances = np.diagonal(tilt["covariance"], axis1=1, axis2=2)[:, :2]
    inputs["tilt"] = np.where(has_tilt[:, np.newaxis], tilt["tilt"][:, :2], 0.0)
    inputs["tilt_variance"] = np.where(has_tilt[:, np.newaxis], variances, math.inf)
    inputs["swing"] = np.where(has_swing, swing["angle"], 0.0)
    inputs["swing_variance"] = np.where(has_swing, swing["covariance"][:, 0, 0], math.inf)
    return inputs


@compiled
def copy_input(source: SoilInputRecord, to: SoilInputRecord) -> None:
    """Copy an input field by field: assignment of whole records takes seconds to compile."""
    to.source = source.source
    for k in range(2):
        to.pressures[k], to.spools[k] = source.pressures[k], source.spools[k]
    copy_state(source, to)


@compiled
def copy_state(source: InputValues, to: InputValues) -> None:
    """Copy all values but the hydraulics."""
    to.stamp_ns, to.motion = source.stamp_ns, source.motion
    to.swing, to.swing_variance = source.swing, source.swing_variance
    for k in range(2):
        to.tilt[k], to.tilt_variance[k] = source.tilt[k], source.tilt_variance[k]
    for i in range(3):
        to.twist[i], to.pose[i], to.slips[i] = source.twist[i], source.pose[i], source.slips[i]
        for j in range(3):
            to.twist_covariance[i, j] = source.twist_covariance[i, j]
            to.pose_covariance[i, j] = source.pose_covariance[i, j]


class Rejection(Enum):
    """Why an input is not used."""

    INVALID = "contains nan or infinity"
    DUPLICATE = "duplicate stamp"
    TOO_LATE = "older than processed data"
    AHEAD = "stamp far ahead of the others"
    RESTARTED = "the clock went back: the estimator was reset"
    OUT_OF_RANGE = "beyond physical limits"
    DIVERGED = "the estimate was not finite: the estimator was reset"


# For compiled code: index of each in ``Rejection``
INVALID, DUPLICATE, TOO_LATE, AHEAD, RESTARTED, OUT_OF_RANGE, DIVERGED = range(7)
ACCEPTED = -1


@compiled
def check_input(record: SoilInputRecord) -> int:
    """Return INVALID or OUT_OF_RANGE for an input that is either, else ACCEPTED."""
    if record.source == IS_HYDRAULICS:
        has_none = math.isnan(record.spools[0]) and math.isnan(record.spools[1])  # unmeasured: never closed
        spool_fault = ACCEPTED if has_none else _check_numbers(record.spools, _LARGEST_SPOOL)
        return _worse_result(_check_numbers(record.pressures, _LARGEST_PRESSURE), spool_fault)
    C, P = record.twist_covariance, record.pose_covariance
    fault = _worse_result(_check_number(record.twist[0], _FASTEST), _check_number(record.twist[1], _FASTEST))
    fault = _worse_result(fault, _check_number(record.twist[2], _FASTEST_TURN))
    fault = _worse_result(fault, _check_numbers(record.pose, _FARTHEST))
    fault = _worse_result(fault, _check_numbers(record.slips, _LARGEST_SLIP))
    if record.swing_variance != math.inf:
        fault = _worse_result(fault, _check_number(record.swing, _LARGEST_ANGLE))
        fault = _worse_result(fault, _check_variance(record.swing_variance, _LARGEST_SWING_VARIANCE))
    for k in range(3):
        fault = _worse_result(fault, _check_variance(C[k, k], _LARGEST_TWIST_VARIANCE))
        fault = _worse_result(fault, _check_variance(P[k, k], _LARGEST_POSE_VARIANCE))
        for j in range(3):
            fault = _worse_result(fault, _check_number(C[k, j], _LARGEST_TWIST_VARIANCE))
            fault = _worse_result(fault, _check_number(P[k, j], _LARGEST_POSE_VARIANCE))
    for k in range(2):
        fault = _worse_result(fault, _check_number(record.tilt[k], _STEEPEST))
        if record.tilt_variance[k] != math.inf:
            fault = _worse_result(fault, _check_variance(record.tilt_variance[k], _LARGEST_TILT_VARIANCE))
    if fault == ACCEPTED and not is_covariance_compiled(C):
        return INVALID
    return fault


@compiled
def _worse_result(one: int, other: int) -> int:
    """Return the worse result: INVALID before OUT_OF_RANGE before ACCEPTED."""
    if one == INVALID or other == INVALID:
        return INVALID
    return max(one, other)


@compiled
def _check_numbers(values: FloatArray, largest: float) -> int:
    fault = ACCEPTED
    for k in range(len(values)):
        fault = _worse_result(fault, _check_number(values[k], largest))
    return fault


@compiled
def _check_number(value: float, largest: float) -> int:
    if not abs(value) < _LARGEST:
        return INVALID
    return ACCEPTED if abs(value) <= largest else OUT_OF_RANGE


@compiled
def _check_variance(variance: float, largest: float) -> int:
    return _check_number(variance, largest) if variance >= 0.0 else INVALID


@dataclass(frozen=True)
class TrackForces:
    """Forces between the tracks and the ground; pairs are left, right."""

    stamp_ns: int
    thrust: tuple[float, float]  # N
    thrust_variance: tuple[float, float]  # N²
    resistance: tuple[float, float]  # N
    resistance_variance: tuple[float, float]  # N²
    reserve: tuple[float, float]  # 1 − |F|/F_max; nan while F_max is unknown


class ForcesRecord(Record):
    """Record of ``TrackForces``."""

    stamp_ns: int
    thrust: Annotated[FloatArray, 2]
    thrust_variance: Annotated[FloatArray, 2]
    resistance: Annotated[FloatArray, 2]
    resistance_variance: Annotated[FloatArray, 2]
    reserve: Annotated[FloatArray, 2]
    trouble: Annotated[IntArray, 2]  # value of ``stall.TrackCondition``; not published


FORCES = dtype_of(ForcesRecord)


@dataclass(frozen=True, eq=False)
class SlipSeed:
    """Slips of both tracks in straight motion, from thrust and soil."""

    stamp_ns: int
    slips: FloatArray  # (2,) left, right
    covariance: FloatArray  # (2, 2)
