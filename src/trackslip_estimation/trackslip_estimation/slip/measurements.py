# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements and commands of the slip estimator, and the report on each."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

from trackslip_common.arrays import FloatArray
from trackslip_estimation.attitude.records import AttitudeRejection

# Names of commands in the journal, beside the topics of the sensors.
SET_POSE = "slip_estimator/set_pose"
POSE_SET = "slip_estimator/pose_set"  # the estimator's repetition of it, for recorders
RESET, FREEZE, UNFREEZE = "slip_estimator/reset", "slip_estimator/freeze", "slip_estimator/unfreeze"
FORGET = "slip_estimator/forget"
RELOAD = "slip_estimator/parameters"


@dataclass(frozen=True)
class Sprockets:
    """Both sprockets; positive drives forward.

    Positions (continuous) are preferred: their differences do not accumulate quantisation. They are
    None in logs that hold speeds only.
    """

    source: str
    stamp_ns: int
    left_speed: float  # rad/s
    right_speed: float  # rad/s
    positions: tuple[float, float] | None = None  # rad, left and right


_ABSENT = float("nan")
UNOBSERVED = 1e6  # variance of what a planar pose does not contain


@dataclass(frozen=True)
class YawRate:
    """Yaw rate about the z axis of the machine, and the other values of the IMU along its axes.

    A value that the IMU does not measure is nan.
    """

    source: str
    stamp_ns: int
    rate: float  # rad/s
    variance: float  # (rad/s)²
    tilt_rates: tuple[float, float] = (_ABSENT, _ABSENT)  # about x and y, rad/s
    tilt_variances: tuple[float, float] = (_ABSENT, _ABSENT)  # (rad/s)²
    acceleration: tuple[float, float, float] = (
        _ABSENT,
        _ABSENT,
        _ABSENT,
    )  # specific force: upward at rest, m/s²
    acceleration_variance: float = _ABSENT  # of each axis, (m/s²)²
    up: tuple[float, float, float] = (_ABSENT, _ABSENT, _ABSENT)  # vertical by its orientation
    up_variances: tuple[float, float] = (_ABSENT, _ABSENT)  # of rotations about x and y, rad²; −1: none


@dataclass(frozen=True, eq=False)
class PoseFix:
    """Pose of a sensor in the site frame; of base_link where the sensor has no offset.

    From the source ``SET_POSE`` it is a manual pose: it replaces the estimated pose.
    """

    source: str
    stamp_ns: int  # 0 of SET_POSE: now
    pose: FloatArray  # (3,) x m, y m, heading rad
    covariance: FloatArray  # (3, 3)
    altitude: float = 0.0  # of the sensor above the site's origin, m
    altitude_variance: float = UNOBSERVED  # m²; that or more: not observed


@dataclass(frozen=True, eq=False)
class SlipFix:
    """Slips of both tracks by another estimator, as from thrust and soil in straight motion."""

    source: str
    stamp_ns: int
    slips: FloatArray  # (2,) left, right
    covariance: FloatArray  # (2, 2)


@dataclass(frozen=True)
class HeadingFix:
    """Heading by a pair of antennas or another compass, as it is mounted."""

    source: str
    stamp_ns: int
    heading: float  # rad, east = 0, counter-clockwise; nan: the message has none
    variance: float  # rad²


@dataclass(frozen=True)
class SwingAngle:
    """Angle of the upper structure against the undercarriage, by a sensor of the swing."""

    source: str
    stamp_ns: int
    angle: float  # rad, counter-clockwise; nan: the message has none
    variance: float  # rad²


@dataclass(frozen=True, eq=False)
class VelocityFix:
    """Velocity of a sensor over the ground: east and north, or along the axes of a sensor on the machine."""

    source: str
    stamp_ns: int
    velocity: FloatArray  # (2,) m/s
    covariance: FloatArray  # (2, 2) (m/s)²; ``UNOBSERVED`` or more: the second axis is not measured


@dataclass(frozen=True, eq=False)
class OdometryPose:
    """Pose of a laser or camera in its own odom frame, which drifts; only differences are used."""

    source: str
    stamp_ns: int
    position: FloatArray  # (3,) m
    orientation: FloatArray  # (4,) quaternion x, y, z, w
    frame: int  # number of its odom frame; a new frame restarts the differences
    variances: FloatArray  # (2, 3) linear and angular, of twist or pose by the parameters of the source


Measurement: TypeAlias = (
    Sprockets | YawRate | PoseFix | SlipFix | HeadingFix | OdometryPose | SwingAngle | VelocityFix
)
KINDS = (Sprockets, YawRate, PoseFix, SlipFix, HeadingFix, OdometryPose, SwingAngle, VelocityFix)


@dataclass(frozen=True)
class Command:
    """``RESET``, ``FORGET``, ``FREEZE`` or ``UNFREEZE``; acts on arrival."""

    source: str
    stamp_ns: int = 0  # commands have none


@dataclass(frozen=True, eq=False)
class Reload:
    """New values of parameters that may change while the estimator runs; acts on arrival."""

    values: Mapping[str, Any]  # dotted name → value
    source: str = RELOAD
    stamp_ns: int = 0


Input: TypeAlias = Measurement | Command | Reload


class Outcome(IntEnum):
    """Result of a measurement; the numbers are those of ``trackslip_msgs/MeasurementReport``."""

    ACCEPTED = 0
    GATED = 1  # its innovation lies outside the gate
    TOO_LATE = 2  # older than the history, or than the start of the estimate
    DUPLICATE = 3  # same source and stamp as an earlier measurement
    INVALID = 4  # not finite, beyond physical limits, or no usable covariance: see ``Fault``
    WAITING = 5  # no estimate yet: it starts with the first fix
    AHEAD = 6  # far ahead of the sprockets, or a sprocket sample that the next ones must confirm
    JUMPED = 7  # used, but the sprocket positions jump: its measured speeds count
    RESTARTED = 8  # the clock went back: the estimate restarts with this sample
    FROZEN = 9  # poses are ignored until unfreeze
    BEGUN = 10  # odometry restarts: there is no earlier pose
    DIVERGED = 11  # the estimate was not finite: it restarts

    @property
    def is_rejected(self) -> bool:
        """Whether the measurement left the state unchanged."""
        return self not in (Outcome.ACCEPTED, Outcome.JUMPED, Outcome.RESTARTED)


class Fault(IntEnum):
    """Why a measurement is invalid; 0: valid."""

    NOT_FINITE = 1  # nan or infinite
    OUT_OF_RANGE = 2  # beyond physical limits
    VARIANCE_NOT_POSITIVE = 3
    VARIANCE_OUT_OF_RANGE = 4  # beyond that of any useful sensor
    COVARIANCE_INDEFINITE = 5  # asymmetric, or with a negative eigenvalue
    COVARIANCE_NEARLY_SINGULAR = 6  # one direction is nearly certain beside the others
    NO_ROTATION = 7  # a quaternion of another length than 1


@dataclass(frozen=True)
class Report:
    """Result of one measurement."""

    source: str
    stamp_ns: int
    outcome: Outcome
    nis: float = float("nan")  # normalised innovation squared
    gate: float = float("nan")  # its limit
    dof: int = 0
    attitude: AttitudeRejection | None = None  # why orientation or altitude were rejected
    fault: Fault | None = None  # of an invalid measurement
