# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Selects between the motion models; a new model needs its own module and a branch in the functions here.

    x, P       mean and covariance of the model named by c.model     (n,), (n, n)
    f, F       state after dt seconds, its Jacobian                  (n,), (n, n)
    Q          process noise of a step                               (n, n)
    ω_L, ω_R   sprocket speeds ``left`` and ``right``                rad/s
    state      record of ``STATE``; used: ``speeds`` and ``motion`` of the sprockets, their errors
               (``adaptation``, ``shear``), and the ``attitude`` on the ground
    c          record of ``config.CONFIG``

Noise densities are in continuous time, so that splitting a step does not change the noise that it adds. F is
diagonal below the pose, except for the swing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled, inlined
from trackslip_common.parameters import Parameters, parameter
from trackslip_estimation.kalman.linear_algebra import sandwich, wrap
from trackslip_estimation.slip.models import free_slips, icr, slope, speed, turning
from trackslip_estimation.slip.models.free_slips import SlipNoise
from trackslip_estimation.slip.models.icr import IcrNoise
from trackslip_estimation.slip.models.model import DOWNHILL, YAW, X, Y
from trackslip_estimation.slip.models.speed import SPEED_ERROR, TURN_STATE_1, YAW_RATE_ERROR
from trackslip_estimation.slip.models.swing import CONSTANTS as SWING_CONSTANTS
from trackslip_estimation.slip.models.swing import linearize_swing, propagate_swing
from trackslip_estimation.slip.models.turning import TurningNoise
from trackslip_estimation.slip.motion import Motion

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Level
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


MODELS: dict[str, ModuleType] = {module.NAME: module for module in (turning, icr, free_slips)}
COUPLED = YAW + 1  # rows of F that are not diagonal
_IS_TURNING = int(Motion.TURNING)
_FREE_SLIPS, _TURNING, _ICR = free_slips.CODE, turning.CODE, icr.CODE

CONSTANTS = [
    ("velocity_errors", speed.CONSTANTS),  # of the selected model
    ("turning", turning.CONSTANTS),
    ("free_slips", free_slips.CONSTANTS),
    ("swing", SWING_CONSTANTS),
]


@dataclass(frozen=True, kw_only=True)
class ModelParameters(Parameters):
    """The motion model, and the parameters of each."""

    model: str = parameter(
        "motion model: turning efficiency (sub-model 1b), its ICR form, or the free slips of the "
        "thesis (3.23)",
        choices=tuple(MODELS),
    )
    turning: TurningNoise
    icr: IcrNoise
    noise: SlipNoise

    def noise_of(self, model: str) -> Any:
        """The parameters of a model: the field named by its module's ``NOISE``, or by the model's name."""
        return getattr(self, getattr(MODELS[model], "NOISE", model))


@compiled
def twist(x: FloatArray, left: float, right: float, c: Config) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, yaw rate rad/s of C."""
    if c.model == _TURNING:
        return turning.twist(x, left, right, c)
    if c.model == _ICR:
        return icr.twist(x, left, right, c)
    return free_slips.twist(x, left, right, c)


@compiled
def twist_jacobian(x: FloatArray, left: float, right: float, c: Config) -> FloatArray:
    """(3, n) derivative of ``twist`` by the state."""
    if c.model == _TURNING:
        return turning.twist_jacobian(x, left, right, c)
    if c.model == _ICR:
        return icr.twist_jacobian(x, left, right, c)
    return free_slips.twist_jacobian(x, left, right, c)


@compiled
def body_twist(
    x: FloatArray, left: float, right: float, state: State, c: Config
) -> tuple[float, float, float]:
    """``twist`` with the sliding that gravity adds on tilted ground, along the machine's axes."""
    return slope.add_slide_velocity(x, twist(x, left, right, c), (left, right), state.attitude.level, c)


@compiled
def body_jacobian(x: FloatArray, left: float, right: float, state: State, c: Config) -> FloatArray:
    """(3, n) derivative of ``body_twist`` by the state."""
    J = twist_jacobian(x, left, right, c)
    slope.add_slide_jacobian(J, (left, right), state.attitude.level, c)
    return J


@compiled
def horizontal_twist(
    x: FloatArray, left: float, right: float, state: State, c: Config
) -> tuple[float, float, float]:
    """Horizontal part of ``body_twist``: speeds along the heading and to its left, rate of the heading."""
    return slope.horizontal_part(body_twist(x, left, right, state, c), state.attitude.level)


@compiled
def slips(
    x: FloatArray, twist_: tuple[float, float, float], left: float, right: float, c: Config
) -> FloatArray:
    """(3,) left slip, right slip, slip angle for the twist ``twist_``."""
    if c.model == _FREE_SLIPS:
        return free_slips.slips(x)
    return speed.slips(x, twist_, left, right, c)


@compiled
def slips_jacobian(
    x: FloatArray, twist_: tuple[float, float, float], J: FloatArray, speeds: tuple[float, float], c: Config
) -> FloatArray:
    """(3, n) derivative of ``slips`` by the state; J: derivative of the twist."""
    if c.model == _FREE_SLIPS:
        return free_slips.slips_jacobian(J.shape[1])
    return speed.slips_jacobian(x, twist_, J, speeds, c)


@compiled
def has_velocity_errors(c: Config) -> bool:
    """Whether the model has the velocity errors m_v and m_ω as states."""
    return bool(c.model != _FREE_SLIPS)


@compiled
def couple_turn_states(P: FloatArray, variance: float, c: Config) -> None:
    """Couple the second turn state in P (n, n) to a ``variance`` of the first, in place (turning only)."""
    if c.model == _TURNING:
        turning.couple_turn_states(P, variance)


@compiled
def _persistence(dt: float, state: State, c: Config) -> tuple[float, float]:
    """Share of the velocity errors that is left after dt, and its mean over dt."""
    return speed.persistence(dt, state.motion.motion, c) if has_velocity_errors(c) else (1.0, 1.0)


@compiled
def propagate_mean(x: FloatArray, state: State, dt: float, c: Config) -> FloatArray:
    """f; the heading at the middle of the step rotates the velocity into the site frame."""
    rho, mean_share = _persistence(dt, state, c)
    moved = x.copy()
    if has_velocity_errors(c):
        for i in range(SPEED_ERROR, YAW_RATE_ERROR + 1):  # their mean over the step
            moved[i] *= mean_share
    v_x, v_y, rate = horizontal_twist(moved, state.speeds.left, state.speeds.right, state, c)
    halfway = x[YAW] + rate * dt / 2.0
    cos, sin = math.cos(halfway), math.sin(halfway)
    moved[X] += (v_x * cos - v_y * sin) * dt
    moved[Y] += (v_x * sin + v_y * cos) * dt
    moved[YAW] = wrap(x[YAW] + rate * dt)
    if has_velocity_errors(c):
        for i in range(SPEED_ERROR, YAW_RATE_ERROR + 1):
            moved[i] = x[i] * rho
    if c.swings:
        propagate_swing(x, moved, dt, state, c)
    if c.lean_errors >= 0:
        for i in range(c.lean_errors, c.lean_errors + 2):
            moved[i] *= _lean_persistence(dt, v_x, state.attitude.level, c)
    return moved


@compiled
def _lean_persistence(dt: float, speed: float, level: Level, c: Config) -> float:
    """Share of a tilt error that is left after dt at a speed of the machine, m/s."""
    by_time, by_distance = c.lean_decays[level.known]
    return math.exp(-dt * (by_time + abs(speed) * by_distance))


@compiled
def linearize(
    x: FloatArray, P: FloatArray, state: State, dt: float, c: Config
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """f, F and Q of a step, computed together.

    Q has the random walks of the states, the velocity errors and, for sprocket speeds that are inputs, their
    noise (3.21). P, the covariance of x or zeros, matters where Q depends on x. All have the size of x.
    """
    n = x.size
    F, Q, moved = np.zeros((n, n)), np.zeros((n, n)), x.copy()
    density = c.process_noise[state.motion.motion, 1 if state.motion.changing else 0]
    for i in range(n):
        F[i, i], Q[i, i] = 1.0, density[i] * dt
    couple_turn_states(Q, density[TURN_STATE_1] * dt, c)
    if dt <= 0.0:
        return moved, F, Q
    left, right = state.speeds.left, state.speeds.right
    rho, mean_share = _persistence(dt, state, c)
    if has_velocity_errors(c):
        for i in range(SPEED_ERROR, YAW_RATE_ERROR + 1):
            moved[i] *= mean_share
    v_x, v_y, rate = horizontal_twist(moved, left, right, state, c)
    J = body_jacobian(moved, left, right, state, c)
    slope.horizontal_jacobian(J, state.attitude.level)
    is_turning = has_velocity_errors(c) and state.motion.motion == _IS_TURNING
    slope.add_slope_noise(Q, dt, is_turning, x[DOWNHILL], state.attitude.level)
    if c.model == _TURNING and state.attitude.level.known == 1:
        distance = slope.track_speed((left, right), c) * dt
        turning.add_slope_noise(Q, distance, state.attitude.level.downhill_y)
    halfway = x[YAW] + rate * dt / 2.0
    cos, sin = math.cos(halfway) * dt, math.sin(halfway) * dt
    east, north = v_x * cos - v_y * sin, v_x * sin + v_y * cos
    _integrate(J, (cos, sin), (east, north), dt)
    for i in range(COUPLED):
        for k in range(n):
            F[i, k] += J[i, k]
    F[X, YAW] -= north
    F[Y, YAW] += east
    if has_velocity_errors(c):
        growth = speed.error_growth(dt, state.motion.motion, c)
        _add_velocity_errors(F, Q, J, speed.error_variances(x, P, state, c), growth, (rho, mean_share))
        speed.add_track_error(Q, halfway, dt, state, c)
        slope.add_slide_noise(Q, halfway, dt, state, c)
        for i in range(SPEED_ERROR, YAW_RATE_ERROR + 1):
            moved[i] = x[i] * rho
    else:
        S = free_slips.twist_by_speed(x, c)
        _integrate(S, (cos, sin), (east, north), dt)
        encoder = c.free_slips.encoder
        speed_covariance = np.array((((encoder * left) ** 2 / dt, 0.0), (0.0, (encoder * right) ** 2 / dt)))
        Q[:COUPLED, :COUPLED] += sandwich(S, speed_covariance)
    moved[X], moved[Y], moved[YAW] = x[X] + east, x[Y] + north, wrap(x[YAW] + rate * dt)
    if c.swings:
        propagate_swing(x, moved, dt, state, c)
        linearize_swing(x, F, Q, dt, state, c)
    if c.lean_errors >= 0:
        share = _lean_persistence(dt, v_x, state.attitude.level, c)
        for i in range(c.lean_errors, c.lean_errors + 2):
            F[i, i], moved[i], Q[i, i] = share, x[i] * share, 1.0 - share * share
    return moved, F, Q


@inlined
def _integrate(J: FloatArray, direction: tuple[float, float], moved: tuple[float, float], dt: float) -> None:
    """Turn J (3, k), a derivative of the mean twist, into that of the pose after ``dt``; in place.

    ``direction``: cosine and sine of the mean heading, times dt; ``moved``: east and north, m.
    """
    (cos, sin), (east, north) = direction, moved
    for k in range(J.shape[1]):
        along, across, turn = J[0, k], J[1, k], J[2, k]
        J[X, k] = cos * along - sin * across - north * dt / 2.0 * turn
        J[Y, k] = sin * along + cos * across + east * dt / 2.0 * turn
        J[YAW, k] = dt * turn


@compiled
def _add_velocity_errors(
    F: FloatArray,
    Q: FloatArray,
    G: FloatArray,
    variances: tuple[float, float],
    growth: tuple[float, float, float],
    persistence: tuple[float, float],
) -> None:
    """Enter the velocity errors into F and Q; G (3, n): derivative of the pose by their mean over a step."""
    of_mean, of_both, of_end = growth
    rho, mean_share = persistence
    for k in range(SPEED_ERROR, YAW_RATE_ERROR + 1):
        variance = variances[k - SPEED_ERROR]
        for i in range(COUPLED):
            for j in range(COUPLED):
                Q[i, j] += G[i, k] * G[j, k] * variance * of_mean
            Q[i, k] = Q[k, i] = G[i, k] * variance * of_both
            F[i, k] = G[i, k] * mean_share
        Q[k, k] += variance * of_end
        F[k, k] = rho
