# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Update with the yaw rate of a gyro; compiled.

    z     measured yaw rate, of the upper structure if the gyro is mounted there  rad/s
    h     s_g (ω + σ̇) + b_g, with the state s_g − 1; b_g of a further gyro is a state of its own
    R     variance stated by the gyro                                             (rad/s)²
    d²    ν²/S; least_nis: the same with the largest possible noise

Inside its gate a reading is used in full. Where only the largest possible noise explains a reading, it is
down-weighted. Beyond that it is rejected, until the gate has widened (``gate``). A reading that passes only
the widened gate indicates an error of the state: the variance of the bias is inflated by ν², or that of σ̇ by
the square of the largest swing rate. A bias that a standstill corrects by more than its error has changed: it
loses its correlations.

In a turn any yaw rate between zero and that without slip is possible on some ground. If several such readings
in a row are outside the gate and agree with each other, the ground has changed: the variances of the turn
states and of i₀ are inflated by those at the start. A rotation against the tracks is possible on no ground.
Such a reading is always rejected: it reveals a gyro mounted upside down. So are those of a frozen gyro.

A gyro is compared with the mean speeds of the sprockets since its last reading, as far as rounding explains
their difference from the newest speeds. So the rounding error of one comparison is cancelled by the next.
Treated as noise of the gyro, the rounding error would leave the heading to the tracks. The Jacobian is taken
at steady speeds: the same rounding error in innovation and Jacobian would bias the turn states.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import copy_square, wrap
from trackslip_estimation.kalman.single_state import replace_state
from trackslip_estimation.kalman.update import (
    Observation,
    correct,
    inflate_noise_to_gate,
    predicted_covariance,
)
from trackslip_estimation.slip.adaptation import learn_from_rate
from trackslip_estimation.slip.gate import gate_limit
from trackslip_estimation.slip.mean_speeds import mean_speeds_since, store_reading
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import (
    couple_turn_states,
    has_velocity_errors,
    twist,
    twist_jacobian,
)
from trackslip_estimation.slip.models.model import GYRO_BIAS, GYRO_SCALE, SWING_RATE, YAW
from trackslip_estimation.slip.models.speed import COMMON_SLIP, TURN_STATE_1, TURN_STATE_2, YAW_RATE_ERROR
from trackslip_estimation.slip.models.swing import is_free_to_swing
from trackslip_estimation.slip.motion import Motion, is_explained_by_rounding, steady_speeds
from trackslip_estimation.slip.validity import LEAST_VARIANCE

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, Prior, State, Streak, Update


_GATED, _STANDING = int(Outcome.GATED), int(Motion.STANDING)


@compiled
def bias_index(source: int, c: Config) -> int:
    """Index of the state that is the bias of a gyro."""
    index = c.source_states[source]
    return GYRO_BIAS if index < 0 else int(index)


@compiled
def stated_variance(measurement: MeasurementRecord, state: State, c: Config) -> float:
    """Variance of a yaw rate after correction of its sign and scale, (rad/s)²."""
    scale = c.rate_scale[measurement.source]
    variance = max(measurement.noise[0, 0] / (scale * scale), LEAST_VARIANCE)
    if state.coasting:  # the yaw rate is unknown, so the bias is not observable
        variance += c.unmodelled_yaw_rate**2
    return float(variance)


@compiled
def _speeds_to_compare(state: State, source: int, stamp_ns: int, c: Config) -> tuple[float, float]:
    """Sprocket speeds to compare with a gyro, rad/s: their means since its last reading.

    Where rounding does not explain the difference, or without a recent reading, they are the newest speeds.
    """
    speeds = state.speeds
    if 0 < stamp_ns - state.readings[source].stamp_ns <= c.sprocket_timeout_ns:
        left, right, _ = mean_speeds_since(state, source, stamp_ns)
        if is_explained_by_rounding(max(abs(left - speeds.left), abs(right - speeds.right)), speeds):
            return left, right
    return speeds.left, speeds.right


@compiled
def observe_rate(state: State, measurement: MeasurementRecord, c: Config) -> Observation:
    """ν (1,), H and R of a yaw rate, and its known states."""
    source, x = measurement.source, state.mean[: c.size]
    left, right = _speeds_to_compare(state, source, measurement.stamp_ns, c)
    bias, scale, rate = bias_index(source, c), 1.0 + x[GYRO_SCALE], twist(x, left, right, c)[2]
    steady = steady_speeds(state.speeds, state.motion, c.motion_limits)
    H = twist_jacobian(x, steady[0], steady[1], c)[2:]
    for k in range(x.size):
        H[0, k] *= scale
    if c.above[source] == 1:
        rate += x[SWING_RATE]
        H[0, SWING_RATE] += scale
    H[0, bias], H[0, GYRO_SCALE] = 1.0, rate
    nu = measurement.value[0] / c.rate_scale[source] - scale * rate - x[bias]
    R = stated_variance(measurement, state, c)
    known = _known_states(left, right, bias, c)
    return Observation(np.array((nu,)), H, np.array(((R,),)), 0, known, H[:0])


@compiled
def _known_states(left: float, right: float, bias: int, c: Config) -> int:
    """Bits of the states that a yaw rate does not correct; the gain is that of a filter which knows them.

    While the machine moves, a gyro does not observe b_g and s_g: a dependence of the turning on direction and
    speed has the same effect. Neither does it observe i₀, as the turn states have its effect. Fixes correct
    all through their correlations. At standstill b_g is observable.
    """
    if not has_velocity_errors(c):
        return 0
    is_moving = left != 0.0 or right != 0.0
    return (1 << GYRO_SCALE) | (1 << COMMON_SLIP) | (1 << bias if is_moving else 0)


@inlined
def update_with_rate(
    state: State, measurement: MeasurementRecord, c: Config, update: Update, prior: Prior
) -> None:
    """Gate and update with a yaw rate (see the top of the module); arguments as in ``update``."""
    source, x, P = measurement.source, state.mean[: c.size], state.covariance[:]
    o, stated = observe_rate(state, measurement, c), stated_variance(measurement, state, c)
    o.noise[0, 0] += (state.adaptation.rate_factor - 1.0) * stated
    left, right = _speeds_to_compare(state, source, measurement.stamp_ns, c)
    is_frozen = _is_frozen(state, measurement, left, right, c)
    store_reading(state, source, measurement.stamp_ns)
    limit, innovation = c.gate_limits[1], o.innovation[0]
    update.dof, update.gate = 1, gate_limit(state, measurement, 1, c)
    measured, measured_variance = _measured_rate(state, measurement, o.noise[0, 0], c)
    is_wrong = is_frozen or _is_impossible_rate(measured, measured_variance, left, right, c)
    is_physical = np.isinf(limit) or not is_wrong
    S = o.noise[0, 0] + predicted_covariance(P, o.jacobian)[0, 0]
    least_nis = nis = innovation * innovation / S
    if is_physical and has_velocity_errors(c) and not state.coasting:
        by_tracks = state.adaptation.exposure * (1.0 + x[GYRO_SCALE]) ** 2
        is_standing = state.motion.motion == _STANDING
        least_nis = learn_from_rate(state.adaptation, innovation, S, by_tracks, stated, is_standing, c)
    streak = state.streaks[source]
    is_new_ground = is_physical and (nis > limit or streak.count > 0)
    is_new_ground = is_new_ground and _has_ground_changed(measured, x, streak, left, right, c)
    if is_new_ground:
        streak.count = 0
        _inflate_turn_states(P, c)
        S = o.noise[0, 0] + predicted_covariance(P, o.jacobian)[0, 0]
        least_nis = nis = innovation * innovation / S
    elif nis <= limit:
        streak.count = 0
    elif least_nis <= limit:
        inflate_noise_to_gate(o.noise, o.innovation, predicted_covariance(P, o.jacobian), limit)
    update.nis, update.log_determinant = nis, np.log(S)
    if least_nis > update.gate or not is_physical:
        update.outcome = _GATED
        copy_square(prior.covariance, P, c.size)
        return
    if least_nis > limit:
        if is_free_to_swing(state, source, c):  # a start or stop of the swing beyond its noise, no bias
            P[SWING_RATE, SWING_RATE] += c.swing.fastest**2
        else:
            bias = bias_index(source, c)
            P[bias, bias] += innovation * innovation
    if is_new_ground or least_nis > limit:
        copy_square(P, prior.covariance, c.size)
    correct(x, P, o)
    x[YAW] = wrap(x[YAW])
    _decouple_changed_bias(state, source, c)
    state.consistent_ns[source] = measurement.stamp_ns


@compiled
def _decouple_changed_bias(state: State, source: int, c: Config) -> None:
    """Remove the correlations of a bias that a standstill corrects by more than its error.

    An error of the bias is one of the heading too, which has integrated it. A bias that has changed is none.
    """
    index, last = bias_index(source, c), state.readings[source]
    bias, variance = state.mean[index], state.covariance[index, index]
    is_observed = state.motion.motion == _STANDING and not is_free_to_swing(state, source, c)
    if is_observed and variance <= last.bias_variance:
        squared = (bias - last.bias) ** 2
        if squared <= c.adaptation.soft_gate * c.gate_limits[1] * (last.bias_variance - variance):
            return
        replace_state(state.mean[: c.size], state.covariance[:], index, bias, variance)
    last.bias, last.bias_variance = bias, variance


@compiled
def _measured_rate(
    state: State, measurement: MeasurementRecord, variance: float, c: Config
) -> tuple[float, float]:
    """Yaw rate of the machine by the gyro alone, rad/s; variance with bias, swing and velocity error."""
    source, x, P = measurement.source, state.mean, state.covariance
    bias, measured = bias_index(source, c), measurement.value[0] / c.rate_scale[source]
    if c.above[source] == 1:
        measured -= x[SWING_RATE]
        variance += P[SWING_RATE, SWING_RATE] + 2.0 * P[SWING_RATE, YAW_RATE_ERROR]
    variance += P[bias, bias]
    if has_velocity_errors(c):
        variance += P[YAW_RATE_ERROR, YAW_RATE_ERROR]
    return (measured - x[bias]) / (1.0 + x[GYRO_SCALE]), variance


@compiled
def _rate_without_slip(left: float, right: float, c: Config) -> float:
    """Yaw rate of the machine without slip, rad/s."""
    rate: float = c.rolling_radius * (right - left) / c.tread
    return rate


@compiled
def _is_impossible_rate(rate: float, variance: float, left: float, right: float, c: Config) -> bool:
    """Whether the machine would turn against its tracks, beyond noise, bias and lag."""
    without_slip = _rate_without_slip(left, right, c)
    allowed = c.ground.against_tracks * np.sqrt(variance) + c.ground.lag * abs(without_slip)
    return has_velocity_errors(c) and rate * np.sign(without_slip) < -allowed


@compiled
def _is_frozen(state: State, measurement: MeasurementRecord, left: float, right: float, c: Config) -> bool:
    """Whether a gyro repeats a reading to the last bit although its tracks turn otherwise than at the first.

    A unit may send one reading several times, and one with few digits repeats it at rest. So the row must be
    longer than any before.
    """
    last, value, stamp_ns = state.readings[measurement.source], measurement.value[0], measurement.stamp_ns
    without_slip = _rate_without_slip(left, right, c)
    if value != last.value:
        last.longest_ns = max(last.longest_ns, last.stamp_ns - last.first_ns)
        last.value, last.first_ns, last.without_slip = value, stamp_ns, without_slip
    usual_ns = max(c.sprocket_timeout_ns, c.ground.longer_row * last.longest_ns)
    turn = abs(without_slip - last.without_slip)
    is_turn = turn > c.ground.other_turn and has_velocity_errors(c)
    by_rounding = is_explained_by_rounding(turn * c.tread / (2.0 * c.rolling_radius), state.speeds)
    return bool(is_turn and stamp_ns - last.first_ns > usual_ns and not by_rounding)


@compiled
def _has_ground_changed(
    rate: float, x: FloatArray, streak: Streak, left: float, right: float, c: Config
) -> bool:
    """Whether a yaw rate is possible on other ground, and enough readings in a row agree on it.

    A reading after the first counts if it agrees with the first, and departs from the yaw rate predicted by
    the turn states of x by at least the share ``persists`` of the first departure.
    """
    without_slip = _rate_without_slip(left, right, c)
    if not (rate * without_slip > 0.0 and abs(rate) < abs(without_slip)) or not has_velocity_errors(c):
        streak.count = 0
        return False
    predicted = twist(x, left, right, c)[2] - x[YAW_RATE_ERROR]
    efficiency, departure = rate / without_slip, (rate - predicted) / without_slip
    agrees = streak.count > 0 and abs(efficiency - streak.value) <= c.ground.agreement
    if not agrees or departure * streak.departure < c.ground.persists * streak.departure**2:
        streak.count, streak.value, streak.departure = 1, efficiency, departure
    else:
        streak.count += 1
    return bool(streak.count >= c.gate_confirmations)


@compiled
def _inflate_turn_states(P: FloatArray, c: Config) -> None:
    """Inflate the variances of the turn states and of i₀ in P by those at the start; in place."""
    P[TURN_STATE_1, TURN_STATE_1] += c.velocity_errors.first_variance
    P[TURN_STATE_2, TURN_STATE_2] += c.velocity_errors.second_variance
    couple_turn_states(P, c.velocity_errors.first_variance, c)
    P[COMMON_SLIP, COMMON_SLIP] += c.velocity_errors.slip_variance
