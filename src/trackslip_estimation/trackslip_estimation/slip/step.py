# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The step of the slip estimator: propagate, predict the observation, gate, update; compiled.

    state         record of ``STATE`` at the previous measurement; in place
    closing       record of ``MEASUREMENT``: the next sprocket sample, at the end of the interval
    measurement   record of ``MEASUREMENT``
    c             record of ``config.CONFIG``
    update        record of ``UPDATE``: result of the step
    prior         record of ``PRIOR``: mean and covariance before the update

Live node, replay, tuning, studies and smoother share this step.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.attitude.records import SIZE as ATTITUDE_SIZE
from trackslip_estimation.kalman import daf
from trackslip_estimation.kalman.linear_algebra import copy_square, used_size
from trackslip_estimation.kalman.positive import make_positive
from trackslip_estimation.kalman.propagate import propagate_covariance
from trackslip_estimation.kalman.single_state import limit_stddev
from trackslip_estimation.slip.adaptation import add_track_error_noise, clear_track_error
from trackslip_estimation.slip.coasting import (
    add_unknown_motion_noise,
    inflate_start_pose,
    set_unknown_speeds,
)
from trackslip_estimation.slip.events import ANY_HEADING
from trackslip_estimation.slip.late_stamps import propagate_delay
from trackslip_estimation.slip.levers import (
    UNKNOWN_HEADING,
    decouple_unknown_angles,
    is_sum_known,
)
from trackslip_estimation.slip.measurements import Outcome
from trackslip_estimation.slip.models.dispatch import (
    COUPLED,
    has_velocity_errors,
    linearize,
    propagate_mean,
)
from trackslip_estimation.slip.models.model import SENSOR_ERRORS, SIZE, UNDERCARRIAGE_SIZE, YAW, X, Y
from trackslip_estimation.slip.models.shear import update_shear
from trackslip_estimation.slip.models.slope import inflate_downhill_slip
from trackslip_estimation.slip.models.swing import end_brake_fault, propagate_swing_covariance
from trackslip_estimation.slip.motion import reset_motion, update_motion
from trackslip_estimation.slip.observations.altitude import update_height
from trackslip_estimation.slip.observations.odometry import integrate_motion
from trackslip_estimation.slip.records import MANUAL, POSE, SPROCKETS, TRACKS
from trackslip_estimation.slip.source_faults import IS_FAILED, IS_HEALTHY, propagate_faults
from trackslip_estimation.slip.source_offsets import propagate_offsets
from trackslip_estimation.slip.sprockets import (
    close_interval,
    has_position_jump,
    set_speeds,
    set_zero_speeds,
    store_sample,
)
from trackslip_estimation.slip.tilt import (
    correct_height_by_position,
    propagate_height_by_twist,
    propagate_silent_tilt,
)
from trackslip_estimation.slip.update import apply_measurement

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import MeasurementRecord, Prior, State, Update


_SETTLED_HEADING = 0.1  # rad, standard deviation below which the motion has shown a heading
_LEAST_DISTANCE = 0.1  # m, track distance beyond which the machine has moved
_ACCEPTED, _JUMPED = int(Outcome.ACCEPTED), int(Outcome.JUMPED)


@inlined
def step(
    state: State,
    closing: MeasurementRecord,
    measurement: MeasurementRecord,
    c: Config,
    update: Update,
    prior: Prior,
) -> None:
    """The state after a measurement: propagated to its stamp, and updated where it is accepted."""
    propagate_with_sprockets(state, closing, measurement.stamp_ns, c)
    update.outcome, update.dof, update.follows = _ACCEPTED, 0, not state.coasting
    update.attitude, update.evidence, update.whitened[:] = 0, 0.0, 0.0
    update.squared_repeat_distance = update.squared_repeat_angle = math.inf
    update.tied = 0
    update.coarse, update.stated, update.measured_position[:] = 0, 0.0, 0.0
    update.nis = update.gate = update.log_determinant = np.nan
    prior.mean = state.mean
    copy_square(state.covariance, prior.covariance, c.size)
    if measurement.kind == POSE:
        state.fixed_ns = measurement.stamp_ns
    if measurement.kind == SPROCKETS:
        if has_position_jump(state.sample, measurement, c):
            update.outcome = _JUMPED
        store_sample(state, measurement, c)
    elif measurement.source == MANUAL:
        set_manual_pose(state, measurement)
        update.follows = False
    else:
        if measurement.kind == POSE:
            decouple_unknown_angles(state, measurement.source, c)
        apply_measurement(state, measurement, c, update, prior)
        _clear_known_sector(state)
        _correct_height(state, update, prior)
        if measurement.kind == POSE and update.outcome == _ACCEPTED:
            update.attitude = update_height(state, measurement, c)
    if measurement.kind != SPROCKETS:
        make_positive(state.covariance, prior.covariance, c.size)
        if state.attitude.known == 1:
            make_positive(state.attitude.covariance, state.attitude.covariance, ATTITUDE_SIZE)


@inlined
def _correct_height(state: State, update: Update, prior: Prior) -> None:
    """Correct the height by a correction of the position, but for an initial or a reset position."""
    is_reset = update.reset_states & ((1 << X) | (1 << Y)) != 0
    if (
        update.follows
        and not is_reset
        and update.outcome == _ACCEPTED
        and state.track_distance > _LEAST_DISTANCE
    ):
        correct_height_by_position(state, state.mean[X] - prior.mean[X], state.mean[Y] - prior.mean[Y])


@inlined
def _clear_known_sector(state: State) -> None:
    """Clear ``is_sector`` once the heading is known much better than to a sector."""
    if state.is_sector and state.covariance[YAW, YAW] < _SETTLED_HEADING**2:
        state.is_sector = False


@inlined
def propagate_with_sprockets(state: State, closing: MeasurementRecord, stamp_ns: int, c: Config) -> None:
    """Propagate the state to ``stamp_ns`` by the sprockets; coast while they are silent."""
    if state.sample.seen and state.sample.stamp_ns == stamp_ns == state.stamp_ns:
        return  # at the sample: no time passes
    known_ns, reached_ns = set_speeds(state, closing, stamp_ns, c), state.stamp_ns
    if known_ns > reached_ns:
        dt = (known_ns - reached_ns) * 1e-9
        previous = state.motion.motion
        update_motion(state.motion, state.speeds, dt, c.motion_limits)
        end_brake_fault(state, previous)
        propagate(state, dt, c)
        if not state.sample.seen:
            inflate_start_pose(state, known_ns, c)
        state.coasting, reached_ns = False, known_ns
    if known_ns < stamp_ns:
        coast(state, (stamp_ns - reached_ns) * 1e-9, c)
        closes_interval = closing.kind == SPROCKETS and closing.stamp_ns == stamp_ns
        if closes_interval and state.fault[TRACKS] != IS_FAILED:
            close_interval(state, closing, c)
    state.stamp_ns = stamp_ns
    propagate_silent_tilt(state, stamp_ns, c)


@compiled
def coast(state: State, dt: float, c: Config) -> None:
    """Propagate over ``dt`` s of silence. Beyond ``max_gap`` the covariance stays: the pose is lost."""
    dt = min(dt, c.max_gap)
    if not state.coasting:
        set_unknown_speeds(state, c)
    set_zero_speeds(state.speeds)
    clear_track_error(state.adaptation)
    reset_motion(state.motion)
    state.shear[:] = 0.0
    propagate(state, dt, c)
    add_unknown_motion_noise(state, dt, c)
    if not is_sum_known(state.covariance):
        limit_stddev(state.covariance[:], YAW, UNKNOWN_HEADING if state.is_sector else ANY_HEADING)
    state.coasting = True


@compiled
def integrate_tracks(state: State, dt: float, c: Config) -> None:
    """Integrate sprocket angles and track distance over ``dt`` s."""
    left, right = state.speeds.left, state.speeds.right
    state.sprocket_angles[0] += left * dt
    state.sprocket_angles[1] += right * dt
    state.track_distance += c.rolling_radius * (abs(left) + abs(right)) / 2.0 * dt


@compiled
def propagate(state: State, dt: float, c: Config) -> None:
    """Propagate mean and covariance by ``dt`` s with the speeds and the motion of the state."""
    P, n = state.covariance[:], c.size
    if not c.sigma_points:
        n = max(used_size(P, n), SENSOR_ERRORS if c.swings else UNDERCARRIAGE_SIZE)
    x = state.mean[:n]
    integrate_motion(state, dt, c)
    integrate_tracks(state, dt, c)
    propagate_height_by_twist(state, dt, c)
    if has_velocity_errors(c):
        add_track_error_noise(state, dt, c)
        inflate_downhill_slip(state)
    moved, F, Q = linearize(x, P, state, dt, c)
    if P[YAW, YAW] > UNKNOWN_HEADING**2:  # the displacement may have any direction
        squared = (moved[X] - x[X]) ** 2 + (moved[Y] - x[Y]) ** 2
        P[X, X] += 2.0 * squared
        P[Y, Y] += 2.0 * squared
    state.displacement[X] += moved[X] - x[X]
    state.displacement[Y] += moved[Y] - x[Y]
    if has_velocity_errors(c):
        update_shear(state, dt, c)
    if not c.sigma_points:
        x[:] = moved
        if c.swings:
            propagate_swing_covariance(P, F)
        propagate_covariance(P, F, Q, COUPLED)
    else:
        covariance = P[: x.size, : x.size].copy()
        points, weights = daf.sigma_points(x, covariance, c.kappa, c.active)
        for i in range(weights.size):
            points[i] = propagate_mean(points[i], state, dt, c)
        mean, departures, weights = daf.moments(points, weights, YAW)
        x[:] = mean
        P[: x.size, : x.size] = daf.spread_covariance(departures, weights) + Q
    propagate_offsets(state, dt, c)
    propagate_faults(state, dt, c)
    propagate_delay(state, dt, c)


@compiled
def set_manual_pose(state: State, manual: MeasurementRecord) -> None:
    """Set a manual pose; all other states stay."""
    x, P = state.mean, state.covariance
    for i in range(3):
        x[i] = manual.value[i]
        for j in range(SIZE):
            P[i, j] = P[j, i] = 0.0
    P[:3, :3] = manual.noise
    state.is_sector = state.sole_fix_heading = False
    state.fault[:] = state.heading_fault[:] = IS_HEALTHY
    for k in range(len(state.standstills)):
        state.standstills[k].count = 0
