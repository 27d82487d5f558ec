# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of the models with turn states: two equations for v and ω, and the velocity errors.

x, y, φ    position of the track-contact centre C, heading            m, m, rad (site frame)
b_g, s_g   bias and scale of the yaw-rate gyro; s_g − 1 is the state  rad/s, 1
δ          delay of fixes, as a multiple of their source's stamp error 1
m_v, m_ω   velocity errors: v and ω beyond a model's two equations    m/s, rad/s
a, b       turn states: each model has its own pair
i₀         slip common to both tracks                                 1
x_I        centre of rotation ahead of C, v_y = −ω x_I                m
v, ω       speed of C along x, yaw rate                               m/s, rad/s
i_L, i_R   resulting slips, 1 − (v ∓ ω B/2)/(r ω_j)                   1
V, D       r (ω_L + ω_R)/2, r (ω_R − ω_L), from the sprockets         m/s
d          largest departure of a track speed from its recent mean    m/s
s          track error (``adaptation``), as a share of a track's speed 1
U          q (2V² + D²/2 + w d²), q = (1 − i₀)², at most 1: squared speeds over the ground  (m/s)²
τ, σ       correlation time of the velocity errors, their size        s, m/s
ρ          e^(−dt/τ)                                                  1

Velocity errors are first-order Gauss–Markov processes: ṁ = −m/τ + noise, of size σ in v and σ/B in ω.
Measured on the shear truth, σ is a small share of V and D at steady speed. It is smaller in ω than in v,
since both tracks oscillate in phase. While the speed changes, σ is a large share of d: the vehicle follows
its tracks with a lag, oscillates on the soil, and settles within tenths of a second. On a soil that yields
more, the errors and i₀ are larger; those of a machine that is stuck are small again: σ² grows with
1 + (i₀ (1 − i₀)/i_y)². This quantifies the jump hypothesis (3.22). A start adds the shear of the soil
(``shear``). Real tracks have larger errors: a share s of each track's speed over the ground adds s² U/4 to
the variance of v and s² U to that of ω B; it also lets i₀ walk and the machine move sideways.
While the sprockets are silent the motion is UNKNOWN: V and D are 0, and the velocity errors are the speeds
themselves (``coasting``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, dtype_of
from trackslip_estimation.slip.models.model import (
    COMMON,
    DOWNHILL,
    FIX_DELAY,
    GYRO_BIAS,
    GYRO_SCALE,
    SIZE,
    Part,
    Prior,
    X,
    Y,
)
from trackslip_estimation.slip.models.shear import shear_variances
from trackslip_estimation.slip.motion import Motion, MotionState, rounding_variance

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


SPEED_ERROR, YAW_RATE_ERROR, TURN_STATE_1, TURN_STATE_2, COMMON_SLIP, ROTATION_OFFSET = range(4, 10)
VELOCITY_ERRORS = slice(SPEED_ERROR, YAW_RATE_ERROR + 1)
ACTIVE = 13  # number of states, with those of ``model``
PARTS = (
    *COMMON,
    Part("velocity_errors", VELOCITY_ERRORS, "m/s, rad/s", "velocity errors of speed and yaw rate"),
    Part("common_slip", slice(COMMON_SLIP, COMMON_SLIP + 1), "1", "slip common to both tracks"),
    Part("rotation_offset", slice(ROTATION_OFFSET, ROTATION_OFFSET + 1), "m", "centre of rotation x_I"),
    Part("downhill_slip", slice(DOWNHILL, DOWNHILL + 1), "1", "downhill speed over track speed, k"),
)


class SpeedConstants(Record):
    """Constants of the velocity errors in compiled code."""

    straight: float  # share of V
    turning: float  # share of D
    changing: float  # share of d
    standing: float  # m/s
    yielding_slip: float
    yaw_rate_ratio: float
    time: float  # τ, s
    start_shear: float  # m
    first_variance: float  # of the turn states, on unknown ground
    second_variance: float
    slip_variance: float  # of i₀, on unknown ground


CONSTANTS = dtype_of(SpeedConstants)

_DELAY_WALK = 0.1  # 1/√s, random walk of δ: the machine lags behind its tracks by a varying time
SLOWEST = 0.02  # m/s, least speed of track or vehicle at which slip and slip angle are defined
_CREEP = SLOWEST / 2.0  # m/s, largest assumed speed of a slower track
_SILENT, _STANDING, _TURNING = int(Motion.UNKNOWN), int(Motion.STANDING), int(Motion.TURNING)


@dataclass(frozen=True, kw_only=True)
class SpeedNoise(Parameters):
    """Prior, process noise, and errors of a model's two equations."""

    common_slip: float = parameter("random walk of the common slip i₀, while driving", unit="1/√s", ge=0.0)
    rotation_offset: float = parameter(
        "random walk of the centre of rotation x_I, while turning", unit="m/√s", ge=0.0
    )
    gyro_bias: float = parameter("random walk of the gyro bias", unit="rad/s/√s", ge=0.0)
    straight_velocity_error: float = parameter("velocity error in straight motion, as a share of V", ge=0.0)
    turning_velocity_error: float = parameter("velocity error in turns, as a share of D", ge=0.0)
    changing_velocity_error: float = parameter("velocity error while speeds change, as a share of d", ge=0.0)
    standing_velocity_error: float = parameter(
        "velocity error at standstill: track speed that counts as zero", unit="m/s", gt=0.0, le=1.0
    )
    yielding_slip: float = parameter("i₀ of a soil that doubles the variance of the velocity errors", gt=0.0)
    yaw_rate_error_ratio: float = parameter("ratio of the steady error of ω times B to that of v", ge=0.0)
    velocity_error_time: float = parameter("correlation time τ of the velocity errors", unit="s", gt=0.0)
    start_shear: float = parameter(
        "track distance that the soil may absorb before the machine starts or reverses", unit="m", gt=0.0
    )
    settling: float = parameter(
        "factor of the process noise of x_I and the turn states while speeds change", ge=1.0
    )
    initial_common_slip_stddev: float = parameter("standard deviation of i₀ at the start", gt=0.0)
    initial_rotation_offset_stddev: float = parameter(
        "standard deviation of x_I at the start", unit="m", gt=0.0
    )
    downhill_slip: float = parameter("random walk of k, while driving on a slope", unit="1/√s", ge=0.0)
    initial_downhill_slip: float = parameter("k before the first slope", ge=0.0)
    initial_downhill_slip_stddev: float = parameter("standard deviation of k before the first slope", ge=0.0)
    initial_gyro_bias_stddev: float = parameter(
        "standard deviation of b_g at the start", unit="rad/s", gt=0.0
    )
    initial_gyro_scale_stddev: float = parameter("standard deviation of s_g about 1 at the start", ge=0.0)


def prior(n: SpeedNoise, tread: float) -> Prior:
    """Prior at rest, with no slip; the model adds its turn states."""
    stddev = np.zeros(SIZE)
    stddev[SPEED_ERROR], stddev[YAW_RATE_ERROR] = n.standing_velocity_error, n.standing_velocity_error / tread
    stddev[COMMON_SLIP] = n.initial_common_slip_stddev
    stddev[ROTATION_OFFSET] = n.initial_rotation_offset_stddev
    stddev[GYRO_BIAS], stddev[GYRO_SCALE] = n.initial_gyro_bias_stddev, n.initial_gyro_scale_stddev
    stddev[FIX_DELAY], stddev[DOWNHILL] = 1.0, n.initial_downhill_slip_stddev
    mean = np.zeros(SIZE)
    mean[DOWNHILL] = n.initial_downhill_slip
    return Prior(mean, stddev)


def process_noise_density(n: SpeedNoise, motion: MotionState) -> FloatArray:
    """(SIZE,) per √s: b_g and δ walk always, i₀ and k except at standstill, x_I in turns only."""
    density = np.zeros(SIZE)
    density[GYRO_BIAS], density[FIX_DELAY] = n.gyro_bias, _DELAY_WALK
    if motion.motion is not Motion.STANDING:
        density[COMMON_SLIP], density[DOWNHILL] = n.common_slip, n.downhill_slip
    if motion.motion is Motion.TURNING:
        density[ROTATION_OFFSET] = n.rotation_offset * noise_scale(n, motion)
    return density


def noise_scale(n: SpeedNoise, motion: MotionState) -> float:
    """Factor of the process noise of x_I and the turn states: 1 at steady speeds."""
    return n.settling if motion.changing else 1.0


def constants(n: SpeedNoise, pair_stddev: tuple[float, float]) -> dict[str, float]:
    """The fields of ``CONSTANTS``; ``pair_stddev`` is that of the turn states at the start."""
    return {
        "straight": n.straight_velocity_error,
        "turning": n.turning_velocity_error,
        "changing": n.changing_velocity_error,
        "standing": n.standing_velocity_error,
        "yielding_slip": n.yielding_slip,
        "yaw_rate_ratio": n.yaw_rate_error_ratio,
        "time": n.velocity_error_time,
        "start_shear": n.start_shear,
        "first_variance": pair_stddev[0] ** 2,
        "second_variance": pair_stddev[1] ** 2,
        "slip_variance": n.initial_common_slip_stddev**2,
    }


@compiled
def twist(x: FloatArray, v: float, rate: float) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, ω rad/s of C, where a model's equations give ``v`` and ``rate``."""
    rate += x[YAW_RATE_ERROR]
    return v + x[SPEED_ERROR], -rate * x[ROTATION_OFFSET], rate


@compiled
def complete_jacobian(x: FloatArray, rate: float, J: FloatArray) -> None:
    """Complete J (3, n), which has a model's derivatives of v and ω in its first and last row; in place."""
    J[0, SPEED_ERROR] = J[2, YAW_RATE_ERROR] = 1.0
    for k in range(x.size):
        J[1, k] = -x[ROTATION_OFFSET] * J[2, k]
    J[1, ROTATION_OFFSET] -= rate + x[YAW_RATE_ERROR]


@compiled
def _error_time(motion: int, c: Config) -> float:
    """τ, s; while the sprockets are silent, that of the speeds themselves."""
    return c.unknown_time if motion == _SILENT else c.velocity_errors.time


@compiled
def persistence(dt: float, motion: int, c: Config) -> tuple[float, float]:
    """Share of a velocity error that is left after dt, ρ, and the mean share over it, (1 − ρ) τ/dt."""
    a = dt / _error_time(motion, c)
    if a <= 0.0:
        return 1.0, 1.0
    lost = -math.expm1(-a)
    return 1.0 - lost, lost / a


@compiled
def error_growth(dt: float, motion: int, c: Config) -> tuple[float, float, float]:
    """Growth of a unit error in dt: variance of its mean over dt, covariance with its end, end variance."""
    a = dt / _error_time(motion, c)
    if a <= 0.0:
        return 0.0, 0.0, 0.0
    lost = -math.expm1(-a)  # 1 − ρ
    if a < 1e-2:  # cancellation in the closed form
        mean = a * (2.0 / 3.0 - a / 2.0)
    else:
        mean = (2.0 * a - 4.0 * lost + 1.0 - (1.0 - lost) ** 2) / (a * a)
    end, both = 1.0 - (1.0 - lost) ** 2, lost * lost / a
    if end > 0.0:  # inertia: between given ends, the mean varies less than a Markov process
        explained = both * both / end
        mean = explained + (mean - explained) * a * a / (1.0 + a * a)
    return mean, both, end


@compiled
def error_variances(x: FloatArray, P: FloatArray, state: State, c: Config) -> tuple[float, float]:
    """Variances of m_v, (m/s)², and of m_ω, (rad/s)²; their expectation over i₀.

    They grow while sprocket speeds are extrapolated, since these may have changed (``coasting``).
    """
    e, speeds, motion = c.velocity_errors, state.speeds, state.motion
    if motion.motion == _SILENT:
        return c.unknown_speed**2, c.unknown_yaw_rate**2
    if motion.motion == _TURNING:
        steady = e.turning * c.rolling_radius * (speeds.right - speeds.left)
    else:
        steady = e.straight * c.rolling_radius * (speeds.left + speeds.right) / 2.0
    changing = e.changing * departure(state, c)
    squared_slip = x[COMMON_SLIP] ** 2 + P[COMMON_SLIP, COMMON_SLIP]
    yielding = 1.0 + squared_slip * squared_travel_ratio(x, P) / (e.yielding_slip * e.yielding_slip)
    of_tracks = state.adaptation.track_variance * track_exposure(state, c)
    of_speed, of_rate = shear_variances(state, c)
    of_speed += (steady**2 + changing**2) * yielding + e.standing**2
    of_speed += c.adaptation.forward**2 * of_tracks / 4.0
    of_rate += ((e.yaw_rate_ratio * steady) ** 2 + changing**2) * yielding + e.standing**2 + of_tracks
    if motion.motion != _STANDING:
        rounding = c.rolling_radius**2 * rounding_variance(e.time, speeds)
        of_speed, of_rate = of_speed + rounding / 2.0, of_rate + 2.0 * rounding
    extrapolated = state.time_since_sample / c.unknown_time
    unknown_rate = 1.0 if state.one_sprocket else extrapolated  # a gyro measures it
    return (
        of_speed + extrapolated * c.unknown_speed**2,
        of_rate / (c.tread * c.tread) + unknown_rate * c.unknown_yaw_rate**2,
    )


@compiled
def track_exposure(state: State, c: Config) -> float:
    """U, (m/s)²."""
    left, right = c.rolling_radius * state.speeds.left, c.rolling_radius * state.speeds.right
    U = left * left + right * right + c.adaptation.changing_weight * departure(state, c) ** 2
    return float(U * squared_travel_ratio(state.mean, state.covariance))


@compiled
def squared_travel_ratio(x: FloatArray, P: FloatArray) -> float:
    """E[(1 − i₀)²], at most 1: squared speed of the machine over that of its tracks.

    A machine that is faster than its tracks has lost counts, which adds no error.
    """
    return float(min((1.0 - x[COMMON_SLIP]) ** 2 + P[COMMON_SLIP, COMMON_SLIP], 1.0))


@compiled
def departure(state: State, c: Config) -> float:
    """d: largest difference of the track speeds from their recent mean, m/s."""
    return float(c.rolling_radius * state.motion.departure)


@compiled
def add_track_error(Q: FloatArray, heading: float, dt: float, state: State, c: Config) -> None:
    """Add the track error beside the velocity errors to Q (n, n): a walk of i₀, and sideways motion.

    The sideways speed is modelled as white noise, which holds for steps longer than τ.
    """
    n, track_variance = c.adaptation, state.adaptation.track_variance
    if state.motion.motion != _STANDING:
        Q[COMMON_SLIP, COMMON_SLIP] += n.common_slip**2 * track_variance * dt
    left, right = c.rolling_radius * state.speeds.left, c.rolling_radius * state.speeds.right
    of_speed = track_variance * (left * left + right * right) / 4.0
    of_speed *= squared_travel_ratio(state.mean, state.covariance)
    sideways = n.sideways**2 * of_speed * 2.0 * c.velocity_errors.time * dt
    cos, sin = math.cos(heading), math.sin(heading)
    Q[X, X] += sideways * sin * sin
    Q[Y, Y] += sideways * cos * cos
    Q[X, Y] -= sideways * cos * sin
    Q[Y, X] -= sideways * cos * sin


@compiled
def slips(
    x: FloatArray, twist_: tuple[float, float, float], left: float, right: float, c: Config
) -> FloatArray:
    """(3,) i_L, i_R, α from the twist and the sprockets.

    A track below ``SLOWEST`` turns at an unknown low speed. Its slip is the smaller of i₀ and the slip at
    the speed ``_CREEP``, at which it skids.
    """
    v_x, v_y, rate = twist_
    values = np.zeros(3)
    for side in range(2):
        track = c.rolling_radius * (left if side == 0 else right)
        sign = -1.0 if side == 0 else 1.0
        frame = v_x + sign * rate * c.tread / 2.0
        if abs(track) < SLOWEST:
            values[side] = min(x[COMMON_SLIP], 1.0 - abs(frame) / _CREEP)
        else:
            values[side] = 1.0 - frame / track
    if abs(v_x) >= SLOWEST:
        values[2] = math.atan(v_y / v_x)
    return values


@compiled
def slips_jacobian(
    x: FloatArray, twist_: tuple[float, float, float], J: FloatArray, speeds: tuple[float, float], c: Config
) -> FloatArray:
    """(3, n) derivative of ``slips`` at the sprockets' ``speeds``, by that of the twist, J (3, n)."""
    v_x, v_y, rate = twist_
    S = np.zeros(J.shape)
    for side in range(2):
        track = c.rolling_radius * speeds[side]
        sign = -1.0 if side == 0 else 1.0
        frame = v_x + sign * rate * c.tread / 2.0
        if abs(track) < SLOWEST and x[COMMON_SLIP] <= 1.0 - abs(frame) / _CREEP:
            S[side, COMMON_SLIP] = 1.0
        else:
            if abs(track) < SLOWEST:
                track = math.copysign(_CREEP, frame)
            S[side] = -(J[0] + sign * c.tread / 2.0 * J[2]) / track
    if abs(v_x) >= SLOWEST:
        S[2] = (v_x * J[1] - v_y * J[0]) / (v_x * v_x + v_y * v_y)
    return S
