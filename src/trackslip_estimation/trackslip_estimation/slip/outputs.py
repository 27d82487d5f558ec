# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs of a state: pose, twist, slips, tilt and swing, with their covariances; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled, inlined
from trackslip_estimation.kalman.linear_algebra import wrap
from trackslip_estimation.kalman.update import predicted_covariance
from trackslip_estimation.slip.levers import unknown_heading_variance, unknown_swing_variance
from trackslip_estimation.slip.models.dispatch import (
    body_jacobian,
    body_twist,
    has_velocity_errors,
    horizontal_twist,
    slips,
    slips_jacobian,
)
from trackslip_estimation.slip.models.model import SWING, SWING_RATE, YAW
from trackslip_estimation.slip.models.speed import COMMON_SLIP
from trackslip_estimation.slip.motion import Motion, steady_speeds
from trackslip_estimation.slip.records import TRACKS
from trackslip_estimation.slip.source_faults import IS_LEFT_FAILED, is_partly_failed
from trackslip_estimation.slip.source_offsets import latest_pose_source
from trackslip_estimation.slip.tilt import fill_tilt

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import EstimateRecord, State, SwingRecord


_UNKNOWN = int(Motion.UNKNOWN)
_ANY_SLIP = 1.0 / 3.0  # second moment of a slip that is uniform between 0 and 1
_NO_DIRECTION = math.pi**2 / 12.0  # rad², variance of a uniform direction within half a turn


@inlined
def fill_estimate(state: State, c: Config, estimate: EstimateRecord) -> None:
    """Fill a record of ``ESTIMATE`` from a state; unknown motion while counts are lost."""
    fill_motion(state, c, estimate)
    fill_tilt(state, estimate)
    fill_swing(state, estimate.swing, c)
    estimate.stamp_ns, estimate.motion = state.stamp_ns, state.motion.motion
    if is_partly_failed(state.fault[TRACKS]):  # the soil estimator uses the sprockets as measured
        estimate.motion = _UNKNOWN


@compiled
def fill_motion(state: State, c: Config, estimate: EstimateRecord) -> None:
    """Fill pose, twist and slips of a record of ``ESTIMATE``, with covariances."""
    fill_outputs(state, c, estimate)
    estimate.pose[:], estimate.pose_covariance[:] = state.mean[:3], state.covariance[:3, :3]
    source = latest_pose_source(state, c)
    about_sensor = unknown_heading_variance(state, source, c)
    if c.above[source] == 1:
        about_sensor += unknown_swing_variance(state.covariance, source, c)
    for i in range(YAW):
        estimate.pose_covariance[i, i] += about_sensor
    if estimate.slip_covariance[2, 2] == 0.0:  # at a standstill there is no direction
        estimate.slip_covariance[2, 2] = _NO_DIRECTION


@compiled
def _twist_and_slips(state: State, left: float, right: float, c: Config) -> FloatArray:
    """(6,) v_x, v_y, yaw rate; left slip, right slip, slip angle."""
    values, x = np.empty(6), state.mean
    twist_ = body_twist(x, left, right, state, c)
    values[0], values[1], values[2] = twist_
    values[3:] = slips(x, twist_, left, right, c)
    if _are_slips_unknown(state, c):
        values[3] = values[4] = x[COMMON_SLIP]
    return values


@compiled
def _are_slips_unknown(state: State, c: Config) -> bool:
    """Whether the speeds of the tracks are unknown; their slips are then the common slip of the ground."""
    return bool(state.coasting and has_velocity_errors(c))


@compiled
def fill_outputs(state: State, c: Config, estimate: EstimateRecord) -> None:
    """Fill twist and slips of a record of ``ESTIMATE``, with covariances."""
    x, P = state.mean[: c.size], state.covariance[:]
    left, right, variance = steady_speeds(state.speeds, state.motion, c.motion_limits)
    values = _twist_and_slips(state, left, right, c)
    twist_ = (values[0], values[1], values[2])
    J = body_jacobian(x, left, right, state, c)
    twist_covariance = predicted_covariance(P, J)
    S = slips_jacobian(x, twist_, J, (left, right), c)
    if _are_slips_unknown(state, c):
        S[:2] = 0.0
        S[0, COMMON_SLIP] = S[1, COMMON_SLIP] = 1.0
    slip_covariance = predicted_covariance(P, S)
    if _are_slips_unknown(state, c):  # the ground may have changed, for each track
        slip_covariance[0, 0] += c.events.slip_stddev**2
        slip_covariance[1, 1] += c.events.slip_stddev**2
    if state.one_sprocket:  # an encoder that fails says nothing of the slip, and a track may spin
        side = 0 if state.fault[TRACKS] == IS_LEFT_FAILED else 1
        slip_covariance[side, side] += _ANY_SLIP
    if variance > 0.0:
        stddev = math.sqrt(variance)
        by_left = (
            _twist_and_slips(state, left + stddev, right, c)
            - _twist_and_slips(state, left - stddev, right, c)
        ) / 2.0
        by_right = (
            _twist_and_slips(state, left, right + stddev, c)
            - _twist_and_slips(state, left, right - stddev, c)
        ) / 2.0
        for by in (by_left, by_right):
            twist_covariance += np.outer(by[:3], by[:3])
            slip_covariance += np.outer(by[3:], by[3:])
    estimate.twist[:], estimate.slips[:] = values[:3], values[3:]
    horizontal = horizontal_twist(x, left, right, state, c)
    for i in range(3):
        estimate.horizontal[i] = horizontal[i]
    estimate.twist_covariance[:], estimate.slip_covariance[:] = twist_covariance, slip_covariance


@compiled
def fill_swing(state: State, swing: SwingRecord, c: Config) -> None:
    """Fill a record of ``SWINGING`` from a state."""
    swing.known, swing.angle, swing.rate = 0, 0.0, 0.0
    swing.covariance[:] = 0.0
    if c.swings:
        swing.known, swing.rate = 1, state.mean[SWING_RATE]
        swing.angle = wrap(state.mean[SWING])
        swing.covariance[:] = state.covariance[SWING : SWING_RATE + 1, SWING : SWING_RATE + 1]
