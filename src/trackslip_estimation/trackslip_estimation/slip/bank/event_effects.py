# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""States that each event resets or inflates, and the fault that it assumes of its source; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.single_state import add_state, replace_state
from trackslip_estimation.slip.events import (
    ANGLES,
    ANY_HEADING,
    BECAME_JUMP,
    BIASED,
    FAILED,
    HEADING_OFF,
    HEADING_REPEATS,
    HEADING_WANDERS,
    HEADINGS,
    HIDDEN,
    LATE,
    MEASURED,
    MOVED,
    NOISE,
    OFFSET,
    OUTLIER,
    RECOVERED,
    REPEATS,
    REVERSED,
    SCATTERS,
    SKIDDED,
    SLID,
    SLIPPED,
    STAYS,
    STUCK,
    SWUNG,
    TURNED,
    WANDERS,
    Event,
)
from trackslip_estimation.slip.late_stamps import inflate_delay, reset_delay
from trackslip_estimation.slip.levers import is_heading_unknown, is_sum_known, to_sensor_position
from trackslip_estimation.slip.models.dispatch import couple_turn_states, has_velocity_errors
from trackslip_estimation.slip.models.model import (
    DOWNHILL,
    FIX_DELAY,
    GYRO_BIAS,
    GYRO_SCALE,
    SWING,
    SWING_RATE,
    YAW,
    X,
    Y,
)
from trackslip_estimation.slip.models.speed import COMMON_SLIP, ROTATION_OFFSET, TURN_STATE_1, TURN_STATE_2
from trackslip_estimation.slip.observations.heading import compass_offset
from trackslip_estimation.slip.records import BRAKE, GYROS, TRACKS
from trackslip_estimation.slip.source_faults import (
    IS_FAILED,
    IS_HEADING_OFF,
    IS_HEADING_REPEATING,
    IS_HEADING_WANDERING,
    IS_HEALTHY,
    IS_IGNORED,
    IS_OFFSET,
    IS_REPEATING,
    IS_SCATTERING,
    IS_STAYING,
    IS_WANDERING,
    is_one_failed,
    is_partly_failed,
)
from trackslip_estimation.slip.source_offsets import (
    has_mostly_correlated_errors,
    latest_pose_source,
    pose_source_number,
    prior_offset_variance,
    to_measured_position,
    to_sensor_heading,
)
from trackslip_estimation.slip.wandering import begin_wander

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import EventRecord, State

_LEARNED_BY_HEADING = GYRO_SCALE, FIX_DELAY, TURN_STATE_2, ROTATION_OFFSET
_SLOPE_STDDEV = 2.0  # of k while the machine slides
_POSITION = (1 << X) | (1 << Y)
_NOT_ABOUT_SOURCE = -1
_FAULTS = np.full(len(Event), _NOT_ABOUT_SOURCE)  # fault of the source after each event
_FAULTS[[RECOVERED, BECAME_JUMP]] = IS_HEALTHY
_FAULTS[OFFSET], _FAULTS[WANDERS] = IS_OFFSET, IS_WANDERING
_FAULTS[REPEATS], _FAULTS[STAYS], _FAULTS[SCATTERS] = IS_REPEATING, IS_STAYING, IS_SCATTERING
_FAULTS[HEADING_OFF], _FAULTS[HEADING_WANDERS] = IS_HEADING_OFF, IS_HEADING_WANDERING
_FAULTS[HEADING_REPEATS], _FAULTS[FAILED] = IS_HEADING_REPEATING, IS_FAILED
_HEADING_FAULTS = IS_HEADING_OFF, IS_HEADING_WANDERING, IS_HEADING_REPEATING


@compiled
def sector_angle(part: int) -> tuple[float, float]:
    """Angle of sector ``part`` of the circle from the first one, rad, and variance inside it, rad²."""
    return 2.0 * math.pi * part / HEADINGS, (math.pi / HEADINGS) ** 2 / 2.0


@compiled
def apply_event(state: State, e: EventRecord, c: Config) -> int:
    """Reset or inflate the states that an event changes; return the reset states as bits."""
    P, source, previous_fault = state.covariance[:], e.source, state.fault[e.source]
    _set_source_fault(state, e)
    if e.event == OFFSET:
        return _begin_offset(state, e, c)
    if e.event in (HEADING_OFF, HEADING_WANDERS):
        return _reset_state(state, c.yaw_offsets[source], 0.0, ANY_HEADING**2, c)
    if e.event in (RECOVERED, BECAME_JUMP) and e.part == ANGLES:
        return _end_heading_fault(state, e, c)
    if e.event in (RECOVERED, BECAME_JUMP):
        return _end_fault(state, e, previous_fault, c)
    if e.event == MOVED:
        return _reset_position(state, e, c)
    if e.event == TURNED:
        return _reset_heading(state, e, c)
    if e.event == SWUNG:
        return _reset_swing(state, e, c)
    if e.event in (SLIPPED, SLID):
        P[DOWNHILL, DOWNHILL] += _SLOPE_STDDEV**2 if e.event == SLID else 0.0
        return _change_slip(state, e, c)
    if e.event == BIASED:
        _inflate_gyro_bias(P, max(e.value, c.events.bias_unseen), c)
    elif e.event == WANDERS:
        begin_wander(state.offsets[pose_source_number(source, c)].wander, P, c)
    elif e.event == LATE:
        inflate_delay(state, source, c)
    elif e.event == SKIDDED:
        P[X, X] += e.value**2
        P[Y, Y] += e.value**2
    elif e.event == FAILED:
        return _inflate_failed_state(state, e, c)
    if e.event == BIASED and e.value > 0.0:
        return _move_offset_to_position(state, source, c)
    return 0


@compiled
def _reset_state(state: State, k: int, mean: float, variance: float, c: Config) -> int:
    """Reset state k to an uncorrelated mean and variance; return its bit."""
    replace_state(state.mean[: c.size], state.covariance[:], k, mean, variance)
    return 1 << k


@compiled
def _set_source_fault(state: State, e: EventRecord) -> None:
    """Set the fault, noise or sole fix that an event assumes of its source."""
    source, fault = e.source, _FAULTS[e.event]
    if e.event == OUTLIER:
        state.fault[source] = IS_IGNORED
    elif e.event == NOISE:
        state.adaptation.fix_log_weights[source] = 1e-9
    elif e.event == MOVED:
        state.sole_fix_source = source
        if state.fault[source] == IS_SCATTERING:
            state.fault_ns[source], state.fault[source] = state.stamp_ns, IS_HEALTHY
    elif fault in _HEADING_FAULTS or (fault == IS_HEALTHY and e.part == ANGLES):
        state.heading_fault_ns[source], state.heading_fault[source] = state.stamp_ns, fault
    elif fault != _NOT_ABOUT_SOURCE:
        state.fault_ns[source], state.fault[source] = state.stamp_ns, fault
        if e.event == FAILED and is_partly_failed(e.part):
            state.fault[source] = e.part


@compiled
def _reset_position(state: State, e: EventRecord, c: Config) -> int:
    """Reset the position, and a heading that depends on the same sole fix."""
    x = state.mean
    reset_states = _reset_state(state, X, x[X], e.value**2, c) | _reset_state(state, Y, x[Y], e.value**2, c)
    if state.sole_fix_heading:
        reset_states |= _reset_state(state, YAW, x[YAW], ANY_HEADING**2, c)
        state.sole_fix_heading = False
    return reset_states


@compiled
def _begin_offset(state: State, e: EventRecord, c: Config) -> int:
    """Reset the offset of a source's positions or velocities to zero, with the variance of the event."""
    first, number, opened = c.offsets[e.source], pose_source_number(e.source, c), e.value**2
    if first < 0:
        return 0
    if number >= 0:
        state.offsets[number].variance = 0.0
    return _reset_state(state, first, 0.0, opened, c) | _reset_state(state, first + 1, 0.0, opened, c)


@compiled
def _end_fault(state: State, e: EventRecord, previous_fault: int, c: Config) -> int:
    """End a fault of a source or unit; BECAME_JUMP moves its offset into the position."""
    x, P, source = state.mean[: c.size], state.covariance[:], e.source
    if previous_fault == IS_WANDERING and e.event == BECAME_JUMP:
        wander = state.offsets[pose_source_number(source, c)].wander
        reset_states = _reset_state(state, X, x[X] + wander.east, wander.variance, c)
        return reset_states | _reset_state(state, Y, x[Y] + wander.north, wander.variance, c)
    if c.offsets[source] >= 0:
        if e.event == BECAME_JUMP:
            to_measured_position(x, P, source, 1.0, c)
        reset_states = _end_offset(state, source, c)
        return reset_states | _POSITION if e.event == BECAME_JUMP else reset_states
    if source == TRACKS and has_velocity_errors(c):
        _open_slip(state, 0.0, c)
    return 0


@compiled
def _end_heading_fault(state: State, e: EventRecord, c: Config) -> int:
    """End a fault of angles; BECAME_JUMP moves their offset into the heading, and keeps that of a swing."""
    source, index, is_jump = e.source, c.yaw_offsets[e.source], e.event == BECAME_JUMP
    if is_jump and c.measures_swing[source] == 1:
        return 0
    if is_jump:
        to_sensor_heading(state.mean[: c.size], state.covariance[:], source, 1.0, c)
    reset_states = _reset_state(state, index, 0.0, c.prior_variance[index], c)
    return reset_states | (1 << YAW) if is_jump else reset_states


@compiled
def _end_offset(state: State, source: int, c: Config) -> int:
    """Reset the offset of a source's positions to the receiver's prior, that of its velocities to zero."""
    first, number, usual = c.offsets[source], pose_source_number(source, c), 0.0
    if number >= 0:
        usual = prior_offset_variance(state, source, c)
        state.offsets[number].variance = usual
    return _reset_state(state, first, 0.0, usual, c) | _reset_state(state, first + 1, 0.0, usual, c)


@compiled
def _move_offset_to_position(state: State, source: int, c: Config) -> int:
    """Move a receiver's offset into the position, as the machine caused it; reset it as at the start."""
    x, P = state.mean[: c.size], state.covariance[:]
    to_measured_position(x, P, source, 1.0, c)
    reset_states = _end_offset(state, source, c)
    to_measured_position(x, P, source, -1.0, c)
    return reset_states | _POSITION


@compiled
def _change_slip(state: State, e: EventRecord, c: Config) -> int:
    """Change i₀ at an unknown moment up to the measurement that shows it; return the reset states.

    Where the machine is stuck or grips again, the moment matters to the position along the path. An earlier
    change, which the offset of a coarse receiver hid, moves that offset into the position.
    """
    x, P, apart = state.mean, state.covariance[:], state.mean[COMMON_SLIP] - c.prior_mean[COMMON_SLIP]
    is_stuck = e.event == SLIPPED and e.part == STUCK
    change = 1.0 - apart if is_stuck else apart
    distance = c.rolling_radius * (state.speeds.left + state.speeds.right) / 2.0
    distance *= change * (e.decided_ns - state.stamp_ns) * 1e-9
    variance, cos, sin = distance * distance / 12.0, math.cos(x[YAW]), math.sin(x[YAW])
    P[X, X] += variance * cos * cos
    P[Y, Y] += variance * sin * sin
    P[X, Y] += variance * cos * sin
    P[Y, X] += variance * cos * sin
    if is_stuck:
        return _reset_state(state, COMMON_SLIP, 1.0, c.bank.slip_excess**2, c) | _reset_sector(state, c)
    _open_slip(state, c.events.slip_stddev**2, c)
    return _move_offset_to_position(state, e.source, c) if e.event == SLIPPED and e.value > 0.0 else 0


@compiled
def _open_slip(state: State, variance: float, c: Config) -> None:
    """Open i₀ for a change: from its latest value or, as likely, to its prior, as a machine grips again."""
    apart = state.mean[COMMON_SLIP] - c.prior_mean[COMMON_SLIP]
    state.mean[COMMON_SLIP] -= apart / 2.0
    state.covariance[COMMON_SLIP, COMMON_SLIP] += variance + apart * apart / 4.0


@compiled
def _inflate_gyro_bias(P: FloatArray, unseen: float, c: Config) -> None:
    """Inflate P for a change of the first gyro's bias, and of the heading over ``unseen`` s; in place."""
    variance = c.events.bias_stddev**2
    P[GYRO_BIAS, GYRO_BIAS] += variance
    P[YAW, YAW] += variance * unseen**2 / 3.0
    P[YAW, GYRO_BIAS] -= variance * unseen / 2.0
    P[GYRO_BIAS, YAW] -= variance * unseen / 2.0


@compiled
def _inflate_failed_state(state: State, e: EventRecord, c: Config) -> int:
    """Inflate or reset the state that failed sprockets, gyros, an odometry or the swing brake affect."""
    opened = c.events.slip_stddev**2
    if e.source == GYROS:
        state.covariance[YAW, YAW] += c.events.failure_heading**2
    elif e.source == BRAKE:
        state.covariance[SWING_RATE, SWING_RATE] += c.swing.fastest**2
    elif e.source < TRACKS:
        state.covariance[COMMON_SLIP, COMMON_SLIP] += opened
    elif e.source == TRACKS and is_one_failed(e.part):
        return _reset_turning(state, c)
    elif e.source == TRACKS and is_partly_failed(e.part):
        source = latest_pose_source(state, c)
        moved = 0
        if has_mostly_correlated_errors(state, source, c):
            moved = _move_offset_to_position(state, source, c)
        return moved | _reset_state(state, COMMON_SLIP, c.prior_mean[COMMON_SLIP], opened, c)
    elif e.source == TRACKS and e.part == HIDDEN:
        return _reset_sector(state, c) | _move_offset_to_position(state, latest_pose_source(state, c), c)
    elif e.source == TRACKS:
        return _reset_sector(state, c)
    return 0


@compiled
def _reset_turning(state: State, c: Config) -> int:
    """Reset turn states and i₀, which seemed to change when a sprocket failed; return the reset states."""
    reset_states = 0
    for k in (TURN_STATE_1, TURN_STATE_2, COMMON_SLIP):
        reset_states |= _reset_state(state, k, c.prior_mean[k], c.prior_variance[k], c)
    couple_turn_states(state.covariance[:], c.prior_variance[TURN_STATE_1], c)
    return reset_states


@compiled
def _reset_sector(state: State, c: Config) -> int:
    """Reset a heading known to a sector, about the latest antenna: the machine has not moved as assumed."""
    if not state.is_sector:
        return 0
    state.is_sector, about = False, latest_pose_source(state, c)
    return _turn_about_sensor(
        state, about, c.prior_mean[YAW], ANY_HEADING**2, is_sum_known(state.covariance), c
    )


@compiled
def _reset_heading(state: State, e: EventRecord, c: Config) -> int:
    """Reset the heading, about the sensor of the latest position, and the states learned through it."""
    x, is_measured, was_unknown = state.mean, e.part == MEASURED, is_heading_unknown(state)
    about = latest_pose_source(state, c) if is_measured else e.source
    turn, variance = (0.0, (math.pi / HEADINGS) ** 2) if is_measured else sector_angle(e.part)
    keeps_sum = is_sum_known(state.covariance)
    if is_measured:
        turn = wrap(e.value - compass_offset(state, e.source, c) - x[YAW])
    if is_measured and c.above[e.source] == 1:  # the sum
        variance, keeps_sum = variance + state.covariance[SWING, SWING], False
    state.is_sector = not is_measured
    reset_states = _turn_about_sensor(state, about, wrap(x[YAW] + turn), variance, keeps_sum, c)
    if has_velocity_errors(c):
        for k in _LEARNED_BY_HEADING:
            reset_states |= _reset_state(state, k, c.prior_mean[k], c.prior_variance[k], c)
        reset_states |= _end_heading_offsets(state, c)
        reset_states |= _reset_slip_of_heading(state, was_unknown, e.part == REVERSED, c)
        reset_delay(state, c)
    return reset_states


@compiled
def _end_heading_offsets(state: State, c: Config) -> int:
    """End the offsets of headings that seemed off beside a wrong heading; return the reset states."""
    reset_states = 0
    for source in range(state.heading_fault.size):
        is_off = state.heading_fault[source] in (IS_HEADING_OFF, IS_HEADING_WANDERING)
        if is_off and c.measures_swing[source] == 0:
            index, state.heading_fault[source] = c.yaw_offsets[source], IS_HEALTHY
            reset_states |= _reset_state(state, index, 0.0, c.prior_variance[index], c)
    return reset_states


@compiled
def _turn_about_sensor(
    state: State, source: int, heading: float, variance: float, keeps_sum: bool, c: Config
) -> int:
    """Reset the heading; position of a sensor, and swing or ``keeps_sum``, stay. Return the reset states."""
    x, P, level = state.mean[: c.size], state.covariance[:], state.attitude.level
    to_sensor_position(x, P, level, source, 1.0, c)
    if keeps_sum:
        x[SWING] += x[YAW]
        add_state(P, SWING, YAW, 1.0)
    reset_states = _POSITION | _reset_state(state, YAW, heading, variance, c)
    if keeps_sum:
        x[SWING] = wrap(x[SWING] - x[YAW])
        add_state(P, SWING, YAW, -1.0)
        reset_states |= 1 << SWING
    to_sensor_position(x, P, level, source, -1.0, c)
    return reset_states


@compiled
def _reset_slip_of_heading(state: State, was_unknown: bool, is_reversed: bool, c: Config) -> int:
    """Reset i₀, as another heading implies another motion; return the reset states.

    A machine whose heading was unknown moves, and so does or does not grip. The reversed machine moves in the
    same direction as before.
    """
    slip, variance = state.mean[COMMON_SLIP], state.covariance[COMMON_SLIP, COMMON_SLIP]
    if was_unknown:
        reset_states = _reset_state(state, COMMON_SLIP, slip, variance, c)
        _open_slip(state, 0.0, c)
        return reset_states
    if is_reversed and slip > 1.0:
        return _reset_state(state, COMMON_SLIP, 2.0 - slip, variance, c)
    return _reset_state(state, COMMON_SLIP, c.prior_mean[COMMON_SLIP], c.prior_variance[COMMON_SLIP], c)


@compiled
def _reset_swing(state: State, e: EventRecord, c: Config) -> int:
    """Reset the swing angle to that of the event, and the swing rate to 0 ± that of the fastest swing."""
    x = state.mean
    turn, variance = sector_angle(max(e.part, 0))
    if e.part == MEASURED:
        turn = wrap(e.value - c.heading_offset[e.source] - x[SWING])
    reset_states = _reset_state(state, SWING, wrap(x[SWING] + turn), variance, c)
    return reset_states | _reset_state(state, SWING_RATE, 0.0, c.swing.fastest**2, c)
