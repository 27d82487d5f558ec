# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Angle and speed of both sprockets from positions in whole counts; compiled.

    p       position of the encoder, or the integral of its speeds                   rad
    q       angle of a count                                                         rad
    θ, ω    angle and speed: ω walks by ``_SPEED_WALK``                              rad, rad/s
    P       covariance of both, the same of either sprocket

A Kalman filter estimates angle and speed of each sprocket with R = q²/12. θ stays within half a count of p:
quantisation errors do not accumulate, and hardly appear as motion. With fine counts θ equals p.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, dtype_of
from trackslip_estimation.kalman.constant_velocity import RateCovariance, propagate_rate_covariance

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config

_SPEED_WALK = 0.2  # rad/s/√s


class CountsRecord(Record):
    """Filter state of both sprockets."""

    left_ahead: float  # p − θ, rad
    right_ahead: float
    left_speed: float  # ω, rad/s
    right_speed: float
    variance: float  # of θ, rad²
    covariance: float  # of θ and ω, rad²/s
    speed_variance: float  # of ω, (rad/s)²


COUNTS = dtype_of(CountsRecord)


class SprocketEstimate(NamedTuple):
    """Estimated angle and speed of a sprocket at a position."""

    ahead: float  # p − θ, rad
    speed: float  # ω, rad/s
    mean: float  # mean of ω since the previous position, rad/s


class CountsEstimate(NamedTuple):
    """Estimated angles and speeds of both sprockets at a position."""

    left: SprocketEstimate
    right: SprocketEstimate
    variance: float  # of θ, rad²
    covariance: float  # of θ and ω, rad²/s
    speed_variance: float  # of ω, (rad/s)²
    mean_variance: float  # of the mean speeds, (rad/s)²


class _Gain(NamedTuple):
    """Gains of a position: share of p − θ that stays, and gain of ω."""

    rest: float
    speed: float  # 1/s


@compiled
def begin_counts(counts: CountsRecord, c: Config) -> None:
    """Reset the filter at a position without predecessor."""
    counts.left_ahead = counts.right_ahead = counts.left_speed = counts.right_speed = 0.0
    counts.variance, counts.covariance = c.encoder_resolution**2 / 12.0, 0.0
    counts.speed_variance = c.max_sprocket_speed**2


@compiled
def filter_counts(counts: CountsRecord, left: float, right: float, dt: float, c: Config) -> CountsEstimate:
    """Estimate ``dt`` s after ``counts``, from mean encoder speeds ``left`` and ``right``, rad/s."""
    before = RateCovariance(counts.variance, counts.covariance, counts.speed_variance)
    variance, covariance, speed_variance = propagate_rate_covariance(before, dt, _SPEED_WALK)
    R, half = c.encoder_resolution**2 / 12.0, c.encoder_resolution / 2.0
    S = variance + R
    gain = _Gain(R / S, covariance / S)
    updated = gain.rest * variance
    cross_covariance = gain.rest * (counts.variance + counts.covariance * dt)  # of θ now and before
    return CountsEstimate(
        _filter_sprocket(counts.left_ahead, counts.left_speed, left, dt, gain, half),
        _filter_sprocket(counts.right_ahead, counts.right_speed, right, dt, gain, half),
        updated,
        gain.rest * covariance,
        max(speed_variance - gain.speed * covariance, 0.0),
        max(updated + counts.variance - 2.0 * cross_covariance, 0.0) / (dt * dt),
    )


@compiled
def _filter_sprocket(
    ahead: float, speed: float, measured: float, dt: float, gain: _Gain, half: float
) -> SprocketEstimate:
    innovation = ahead + (measured - speed) * dt
    after = min(max(gain.rest * innovation, -half), half)
    return SprocketEstimate(after, speed + gain.speed * innovation, measured - (after - ahead) / dt)


@compiled
def store_counts(estimate: CountsEstimate, counts: CountsRecord) -> None:
    """Store an estimate in ``counts``."""
    counts.left_ahead, counts.left_speed = estimate.left.ahead, estimate.left.speed
    counts.right_ahead, counts.right_speed = estimate.right.ahead, estimate.right.speed
    counts.variance, counts.covariance = estimate.variance, estimate.covariance
    counts.speed_variance = estimate.speed_variance
