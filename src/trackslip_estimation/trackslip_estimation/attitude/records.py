# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the attitude filter, which are part of the slip estimator's state.

base_link has x forward, y left, z up (REP-103); ψ, θ, φ turn about z, y, x (ZYX), θ > 0 is nose down.
"""

from enum import IntEnum
from typing import Annotated

from trackslip_common.arrays import FloatArray
from trackslip_common.record_types import Record, dtype_of

ROLL, PITCH, HEIGHT, BIAS_P, BIAS_Q, BIAS_X, BIAS_Y = range(7)  # rad, rad, m, rad/s, rad/s, m/s², m/s²
SIZE = 7


class AttitudeRejection(IntEnum):
    """Why a requested orientation or altitude is not used; 0 if it is."""

    NO_ORIENTATION = 1  # its covariance begins with −1
    NO_COVARIANCE = 2  # its covariance is zero: unknown
    NO_ROTATION = 3  # its quaternion is not of norm 1
    ORIENTATION_GATED = 4  # it lies outside the gate
    SWING_UNKNOWN = 5  # the swing of the upper structure that carries the IMU is unknown
    NO_ALTITUDE = 6  # it is not finite, or its variance is not positive
    ALTITUDE_GATED = 7  # it lies outside the gate


class Level(Record):
    """Effect of the attitude on a motion along the ground; zero where ground is flat or attitude unknown."""

    known: int  # 0 or 1: whether the attitude is known
    forward: float  # cos θ − 1
    across: float  # sin φ sin θ
    sideways: float  # cos φ − 1
    turn: float  # cos φ / cos θ − 1
    yaw_rate_offset: float  # q sin φ / cos θ, part of the yaw rate due to the pitch rate, rad/s
    downhill_x: float  # sin θ
    downhill_y: float  # −sin φ cos θ
    lean_x: float  # cos φ sin θ: forward displacement of a point above C, per m of height
    lean_y: float  # −sin φ: displacement to the left
    lean_variance: float  # variance of both
    turn_variance: float  # noise density of the yaw rate due to errors of the attitude, rad²/s


LEVEL = dtype_of(Level)


class ImuSample(Record):
    """One sample, x and y along the IMU's own axes."""

    stamp_ns: int
    rates: Annotated[FloatArray, 3]  # p, q, r, rad/s; p and q nan if not measured
    rate_variances: Annotated[FloatArray, 3]
    force: Annotated[FloatArray, 3]  # specific force, upward at rest, m/s²; nan if not measured
    force_variance: float
    use_force: int  # 0 or 1: whether the force may correct the tilt
    up: Annotated[FloatArray, 3]  # up vector by its orientation
    up_variances: Annotated[FloatArray, 2]  # of rotations about x and y, rad²; −1: no orientation
    use_orientation: int  # 0 or 1: whether the orientation may correct the tilt
    velocity: Annotated[FloatArray, 2]  # of C along the tracks, m/s
    known_velocity: int  # 0 or 1: whether the velocity is known
    lever: Annotated[FloatArray, 3]  # lever arm of the IMU in base_link, m
    turn: float  # yaw angle of its x and y axes against base_link, rad
    turn_variance: float  # of this angle, rad²
    swing_unknown: int  # 0 or 1: whether this angle is unknown; then the sample corrects nothing
    cos: float  # of this angle, set on use
    sin: float


IMU = dtype_of(ImuSample)


class Span(Record):
    """Means over a span of samples (``span``)."""

    begun: int  # 0 or 1
    stamp_ns: int  # of its last sample, or of its start
    samples: int
    time: float  # T, s
    force: Annotated[FloatArray, 2]  # f̄ of x and y, m/s²
    lag: Annotated[FloatArray, 2]  # roll and pitch at its end less their mean, times T, rad s
    velocity: Annotated[FloatArray, 2]  # u₀, m/s
    known: int  # 0 or 1: whether u is known throughout


class Altitudes(Record):
    """The last altitude used, and those rejected since (``slip.observations.altitude``)."""

    used_ns: int  # stamp of the last altitude that was used
    rejections: int  # number of altitudes outside the gate since, in a row, that agree
    rejected_ns: int  # stamp of the first of these altitudes
    innovation: float  # of the first, m


class Attitude(Record):
    """State of the attitude filter."""

    known: int  # 0 or 1: whether roll and pitch are known
    seen: int  # 0 or 1: whether the IMU has sent a sample
    stamp_ns: int  # of its last sample
    reached_ns: int  # stamp to which roll and pitch are propagated: beyond the last sample while it is silent
    sample: ImuSample  # newest sample
    mean: Annotated[FloatArray, SIZE]
    covariance: Annotated[FloatArray, (SIZE, SIZE)]
    rates: Annotated[FloatArray, 3]  # p, q, r of the newest sample less their biases, rad/s
    mean_force: Annotated[FloatArray, 3]  # low-passed, m/s²
    span: Span  # samples whose accelerations have not corrected the tilt yet
    noise: Annotated[FloatArray, 2]  # variance of both horizontal axes beyond the model, (m/s²)²
    noise_count: Annotated[FloatArray, 2]  # effective number of samples in ``noise``
    slide: Annotated[FloatArray, 2]  # velocities that the tracks do not show, by those of roll and pitch, m/s
    fastest: float  # recent speed of the tracks, m/s
    oriented_ns: int  # stamp of the last orientation that was used
    rejection: int  # ``AttitudeRejection`` of the last orientation; 0: used, or not requested
    altitudes: Altitudes
    level: Level


ATTITUDE = dtype_of(Attitude)
