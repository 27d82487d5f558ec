# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How implausible the motion is that a branch assumes; compiled.

Fixes and yaw rates are used with any slip, and with any turning efficiency. So the likelihood of the motion
itself lowers ln of the branch's weight, once in ``PERIOD``.

    i₀       slip common to both tracks
    D        difference of both track speeds over the tread: yaw rate without slip      rad/s
    ω        yaw rate                                                                   rad/s
    e        ω/D, turning efficiency

Tracks that grip turn the machine too, and tracks that spin do not: e/(1 − i₀) is between
``_LEAST_EFFICIENCY`` and 1. Sprockets that do not measure the motion show its yaw rate by chance only.
On some ground a machine hardly turns, and it does so for long. So a turning efficiency outside its range, by
a gyro, costs a branch no more than ``_MOST_TURN_COST`` in all: the *turn cost*, a cumulative sum (CUSUM) of
z²/2 less its mean ½. Branches in which a sprocket or the gyro fails do not pay it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.update import predicted_covariance
from trackslip_estimation.slip.models.dispatch import has_velocity_errors, twist, twist_jacobian
from trackslip_estimation.slip.models.model import GYRO_BIAS
from trackslip_estimation.slip.models.slope import is_on_slope
from trackslip_estimation.slip.models.speed import COMMON_SLIP, YAW_RATE_ERROR
from trackslip_estimation.slip.one_sprocket import latest_rate
from trackslip_estimation.slip.records import TRACKS
from trackslip_estimation.slip.source_faults import IS_FAILED, has_staying_fixes, is_one_failed
from trackslip_estimation.slip.sprockets import shows_standstill

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

PERIOD = 0.5  # s, correlation time of the motion
USUAL_PENALTY = 0.5  # of a normal deviate, z²/2
_MOST_LEVEL_SLIP = 1.0  # i₀ of a stuck machine
_LEAST_RATE = 0.1  # rad/s, of D in a turn
_LEAST_EFFICIENCY = 0.25  # e/(1 − i₀) of a machine with long tracks on ground that grips well
_LARGEST_REDUCTION = 3.0  # by an implausible turn: the machine lags behind its tracks, and encoders err
_MOST_TURN_COST = 5.0  # ln of the odds of failed sprockets against ground on which the machine hardly turns
_RATE_SHARE = 0.15  # of the yaw rate, standard deviation of what the tracks predict
_RATE_NOISE = 0.02  # rad/s
_SLIP_DIFFERENCE = 0.15  # standard deviation of the difference of both slips
_RATE_RANGE = 2.0  # rad/s, range of what failed sprockets show
_LOG_TWO_PI = math.log(2.0 * math.pi)


@compiled
def is_stuck(state: State, c: Config) -> bool:
    """Whether a branch assumes that the tracks spin: i₀ is nearer to 1 than a usual change of slip."""
    return bool(has_velocity_errors(c) and state.mean[COMMON_SLIP] > 1.0 - 2.0 * c.events.slip_stddev)


@compiled
def is_gripping(state: State, c: Config) -> bool:
    """Whether a branch assumes that the tracks grip: they do not spin, and i₀ is in its range."""
    return bool(
        has_velocity_errors(c) and not is_stuck(state, c) and state.mean[COMMON_SLIP] > c.bank.least_slip
    )


@compiled
def implausibility(state: State, c: Config) -> float:
    """Reduction of ln of a branch's weight for the motion that it assumes."""
    if not has_velocity_errors(c):
        return 0.0
    if state.fault[TRACKS] == IS_FAILED or is_one_failed(state.fault[TRACKS]):
        return min(_chance_agreement(state, c), _LARGEST_REDUCTION)
    in_turn = _turn_penalty(state, c) + _speed_penalty(state, c)
    return slip_range_penalty(state, c) + min(in_turn, _LARGEST_REDUCTION)


@compiled
def slip_range_penalty(state: State, c: Config) -> float:
    """Reduction of ln of a branch's weight for an i₀ outside its physical range."""
    if not has_velocity_errors(c) or state.fault[TRACKS] == IS_FAILED:
        return 0.0
    excess = max(
        state.mean[COMMON_SLIP] - _most_slip(state, c), c.bank.least_slip - state.mean[COMMON_SLIP], 0.0
    )
    variance = c.bank.slip_excess**2 + state.covariance[COMMON_SLIP, COMMON_SLIP]
    return float(excess * excess / (2.0 * variance))


@compiled
def _most_slip(state: State, c: Config) -> float:
    """Largest i₀: that of a stuck machine on level ground."""
    is_level = state.attitude.level.known == 1 and not is_on_slope(state)
    return float(_MOST_LEVEL_SLIP if is_level else c.bank.most_slip)


@compiled
def _speed_penalty(state: State, c: Config) -> float:
    """The reduction for a machine in a turn that is faster than both tracks, or moves against them."""
    left, right = c.rolling_radius * state.speeds.left, c.rolling_radius * state.speeds.right
    fastest = max(abs(left), abs(right))
    if abs(right - left) < _LEAST_RATE * c.tread or state.coasting:
        return 0.0
    v, variance = _twist_component(state, 0, c)
    beyond = max(v - max(left, right, 0.0), min(left, right, 0.0) - v, 0.0) / fastest
    is_against = v * (left + right) < 0.0
    excess = max(beyond - (_most_slip(state, c) - 1.0 if is_against else -c.bank.least_slip), 0.0)
    return float(excess * excess / (2.0 * (c.bank.slip_excess**2 + variance / fastest**2)))


@compiled
def _turn_penalty(state: State, c: Config) -> float:
    """The reduction for a stuck machine that turns, or one that does not although only its fixes stay."""
    left, right, i_0 = state.speeds.left, state.speeds.right, state.mean[COMMON_SLIP]
    D = c.rolling_radius * (right - left) / c.tread
    spins, stays = is_stuck(state, c), has_staying_fixes(state)
    if abs(D) < _LEAST_RATE or state.coasting or not (spins or stays):
        return 0.0
    rate, variance = _twist_component(state, 2, c)
    excess = max(rate / D - (1.0 - i_0) if spins else _LEAST_EFFICIENCY * (1.0 - i_0) - rate / D, 0.0)
    variance = c.bank.slip_excess**2 + state.covariance[COMMON_SLIP, COMMON_SLIP] + variance / D**2
    return float(excess * excess / (2.0 * variance))


@compiled
def turn_range_penalty(state: State, c: Config) -> float:
    """The reduction for a turning efficiency, by a gyro, outside its physical range."""
    left, right = c.rolling_radius * state.speeds.left, c.rolling_radius * state.speeds.right
    rate, D, grip = latest_rate(state, c), (right - left) / c.tread, 1.0 - state.mean[COMMON_SLIP]
    if state.coasting or math.isnan(rate) or not has_velocity_errors(c):
        return 0.0
    with_tracks = math.copysign(rate, rate * D)
    beyond = with_tracks - max(grip, 0.0) * abs(D)
    excess = max(_LEAST_EFFICIENCY * grip * abs(D) - with_tracks, beyond, 0.0)
    by_slip = max(_SLIP_DIFFERENCE**2, 2.0 * state.adaptation.track_variance) * (left + right) ** 2 / 4.0
    variance = (c.bank.slip_excess**2 + state.covariance[COMMON_SLIP, COMMON_SLIP]) * D**2
    variance += by_slip / c.tread**2 + state.covariance[GYRO_BIAS, GYRO_BIAS] + _RATE_NOISE**2
    return float(min(excess * excess / (2.0 * variance), _LARGEST_REDUCTION))


@compiled
def total_turn_reduction(turn_cost: float) -> float:
    """Reduction of ln of a branch's weight by all of an implausible turn, whose cause lasts."""
    return min(turn_cost, _MOST_TURN_COST)


@compiled
def is_turn_implausible(state: State, c: Config) -> bool:
    """Whether the turning efficiency by a gyro is 1 σ outside its physical range."""
    return bool(turn_range_penalty(state, c) > USUAL_PENALTY)


@compiled
def _twist_component(state: State, k: int, c: Config) -> tuple[float, float]:
    """v_x, v_y or ω of a branch, m/s or rad/s, and its variance."""
    x, left, right = state.mean[: c.size], state.speeds.left, state.speeds.right
    J = twist_jacobian(x, left, right, c)[k : k + 1]
    return twist(x, left, right, c)[k], predicted_covariance(state.covariance[:], J)[0, 0]


@compiled
def _chance_agreement(state: State, c: Config) -> float:
    """ln of the odds that sprockets which show the yaw rate measure it, against failed ones; at least 0."""
    sample, is_one = state.sample, is_one_failed(state.fault[TRACKS])
    if not sample.known or (shows_standstill(sample, c) if is_one else not state.coasting):
        return 0.0
    rate, variance = latest_rate(state, c), _RATE_NOISE**2
    if not is_one:
        rate, variance = _twist_component(state, 2, c)
    shown = _shown_rate(state, c)
    if math.isnan(rate) or (abs(shown) < _LEAST_RATE and not is_one):
        return 0.0
    variance += state.covariance[GYRO_BIAS, GYRO_BIAS] + (_RATE_SHARE * shown) ** 2
    healthy = -((shown - rate) ** 2) / (2.0 * variance) - (math.log(variance) + _LOG_TWO_PI) / 2.0
    return float(max(healthy + math.log(_RATE_RANGE), 0.0))


@compiled
def _shown_rate(state: State, c: Config) -> float:
    """Yaw rate that the latest sample shows, rad/s."""
    x = state.mean[: c.size].copy()
    x[YAW_RATE_ERROR] = 0.0
    return float(twist(x, state.sample.speeds.left, state.sample.speeds.right, c)[2])
