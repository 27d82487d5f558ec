# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The records of the attitude filter, which the slip estimator keeps in its own state.

base_link has x forward, y left, z up (REP-103); ψ, θ, φ turn about z, y, x (ZYX), θ > 0 is nose down.
"""

from enum import IntEnum
from typing import Annotated

from trackslip_common.arrays import FloatArray
from trackslip_common.record_types import Record, dtype_of

ROLL, PITCH, HEIGHT, BIAS_P, BIAS_Q, BIAS_X, BIAS_Y = range(7)  # rad, rad, m, rad/s, rad/s, m/s², m/s²
SIZE = 7


class AttitudeRefusal(IntEnum):
    """Why an orientation or an altitude that was wanted is not used; 0 where it is."""

    NO_ORIENTATION = 1  # its covariance begins with −1
    NO_COVARIANCE = 2  # zeros: it is not known
    NO_ROTATION = 3  # a quaternion of another length than 1
    ORIENTATION_GATED = 4  # it lies outside the gate
    SWING_UNKNOWN = 5  # nobody knows how the IMU, on the upper structure, is turned
    NO_ALTITUDE = 6  # it is no number, or its variance is none
    ALTITUDE_GATED = 7  # it lies outside the gate


class Level(Record):
    """What the attitude does to a motion along the ground; all zero where it is flat, or not known."""

    tilted: int  # 0 or 1: whether the rest counts
    forward: float  # cos θ − 1
    across: float  # sin φ sin θ
    sideways: float  # cos φ − 1
    turn: float  # cos φ / cos θ − 1
    roll_over: float  # q sin φ / cos θ, rad/s
    downhill_x: float  # sin θ
    downhill_y: float  # −sin φ cos θ
    lean_x: float  # cos φ sin θ: how far ahead something is that is 1 m above C
    lean_y: float  # −sin φ: how far left
    lean_variance: float  # of both
    turn_variance: float  # density of the yaw rate's that comes of the attitude's, rad²/s


LEVEL = dtype_of(Level)


class ImuSample(Record):
    """One sample, x and y along its own axes."""

    stamp_ns: int
    rates: Annotated[FloatArray, 3]  # p, q, r: rad/s; p and q nan where there are none
    rate_variances: Annotated[FloatArray, 3]
    force: Annotated[FloatArray, 3]  # specific force: upward at rest, m/s²; nan where there is none
    force_variance: float
    levels: int  # 0 or 1: whether the force may tell the tilt
    up: Annotated[FloatArray, 3]  # by its orientation
    up_variances: Annotated[FloatArray, 2]  # of rotations about x and y, rad²; −1: it has none
    oriented: int  # 0 or 1: whether that may tell the tilt
    velocity: Annotated[FloatArray, 2]  # of C along the tracks, m/s
    known_velocity: int  # 0 or 1
    lever: Annotated[FloatArray, 3]  # place of the IMU in base_link, m
    turn: float  # by which its x and y axes are turned against base_link's, rad
    turn_variance: float  # of that, rad²
    lost: int  # 0 or 1: whether nobody knows that, and it tells nothing
    cos: float  # of the turn, once it is used
    sin: float


IMU = dtype_of(ImuSample)


class Span(Record):
    """See ``span``."""

    begun: int  # 0 or 1
    stamp_ns: int  # of its last sample, or of its begin
    samples: int
    time: float  # T, s
    force: Annotated[FloatArray, 2]  # f̄ of x and y, m/s²
    lag: Annotated[FloatArray, 2]  # of roll and pitch at its end against its mean, times T, rad s
    velocity: Annotated[FloatArray, 2]  # u₀, m/s
    known: int  # 0 or 1: whether u is, all the time


class Climb(Record):
    """See ``slip.observations.altitude``."""

    used_ns: int  # stamp of the altitude used last
    refused: int  # altitudes outside the gate since, in a row, that agree
    refused_ns: int  # stamp of the first of them
    apart: float  # its innovation, m


class Attitude(Record):
    """What the attitude filter knows."""

    known: int  # 0 or 1
    seen: int  # whether the IMU has sent anything
    stamp_ns: int  # of its last sample
    sample: ImuSample  # that one
    mean: Annotated[FloatArray, SIZE]
    covariance: Annotated[FloatArray, (SIZE, SIZE)]
    rates: Annotated[FloatArray, 3]  # p, q, r of that sample less their biases, rad/s
    mean_force: Annotated[FloatArray, 3]  # low-passed, m/s²
    span: Span  # of samples whose accelerations have not told the tilt yet
    noise: Annotated[FloatArray, 2]  # variance of what both horizontal axes show beyond the model, (m/s²)²
    noise_count: Annotated[FloatArray, 2]  # samples in it
    oriented_ns: int  # stamp of the last orientation that was used
    refusal: int  # ``AttitudeRefusal`` of the last one; 0: it was used, or none is wanted
    climb: Climb
    level: Level


ATTITUDE = dtype_of(Attitude)
