# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Angle and speed of both sprockets from positions in whole counts; compiled.

    p       position by the encoder                                          rad
    q       angle of a count                                                 rad
    θ, ω    angle and speed: ω walks by ``_SPEED_WALK``                      rad, rad/s
    P       covariance of both, the same of either sprocket

A Kalman filter follows each sprocket, with R = q²/12; and θ stays within half a count of p. So no rounding
adds up, and little of it passes for a motion. Fine counts say all: then θ is p.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from trackslip_common.compiled import compiled
from trackslip_common.record_types import Record, dtype_of

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.motion import SpeedsRecord
    from trackslip_estimation.slip.records import MeasurementRecord

_SPEED_WALK = 0.2  # rad/s in a second


class CountsRecord(Record):
    """What is known of both sprockets."""

    left: float  # θ, rad
    right: float
    left_speed: float  # ω, rad/s
    right_speed: float
    variance: float  # of θ, rad²
    shared: float  # covariance of θ and ω, rad²/s
    speed_variance: float  # of ω, (rad/s)²


COUNTS = dtype_of(CountsRecord)


class Gain(NamedTuple):
    """What a position does to θ and ω, and what is open of both afterwards."""

    angle: float
    speed: float  # 1/s
    variance: float  # rad²
    shared: float  # rad²/s
    speed_variance: float  # (rad/s)²


@compiled
def begin_counts(counts: CountsRecord, closing: MeasurementRecord, c: Config) -> None:
    """At a position that continues none."""
    counts.left, counts.right = closing.left_angle, closing.right_angle
    counts.left_speed = counts.right_speed = counts.shared = 0.0
    counts.variance, counts.speed_variance = c.encoder_resolution**2 / 12.0, c.max_sprocket_speed**2


@compiled
def counted_speeds(
    counts: CountsRecord, closing: MeasurementRecord, dt: float, c: Config, speeds: SpeedsRecord
) -> None:
    """Mean speeds up to the position of ``closing``, ``dt`` s later, into ``speeds``."""
    gain, half = _gain(counts, dt, c), c.encoder_resolution / 2.0
    left = _follow(counts.left, counts.left_speed, closing.left_angle, dt, gain, half)[0]
    right = _follow(counts.right, counts.right_speed, closing.right_angle, dt, gain, half)[0]
    common = (1.0 - gain.angle) * (counts.variance + counts.shared * dt)
    speeds.left, speeds.right = (left - counts.left) / dt, (right - counts.right) / dt
    speeds.interval, speeds.angle_variance = dt, gain.variance
    speeds.variance = max(gain.variance + counts.variance - 2.0 * common, 0.0) / (dt * dt)


@compiled
def follow_counts(counts: CountsRecord, closing: MeasurementRecord, dt: float, c: Config) -> None:
    """``counts`` at the position of ``closing``, ``dt`` s later."""
    gain, half = _gain(counts, dt, c), c.encoder_resolution / 2.0
    counts.left, counts.left_speed = _follow(
        counts.left, counts.left_speed, closing.left_angle, dt, gain, half
    )
    counts.right, counts.right_speed = _follow(
        counts.right, counts.right_speed, closing.right_angle, dt, gain, half
    )
    counts.variance, counts.shared, counts.speed_variance = gain.variance, gain.shared, gain.speed_variance


@compiled
def _gain(counts: CountsRecord, dt: float, c: Config) -> Gain:
    walk = _SPEED_WALK**2 * dt
    speed_variance = counts.speed_variance + walk
    shared = counts.shared + (counts.speed_variance + walk / 2.0) * dt
    variance = counts.variance + (2.0 * counts.shared + (counts.speed_variance + walk / 3.0) * dt) * dt
    S = variance + c.encoder_resolution**2 / 12.0
    angle, speed = variance / S, shared / S
    kept, left_open = 1.0 - angle, max(speed_variance - speed * shared, 0.0)
    return Gain(angle, speed, kept * variance, kept * shared, left_open)


@compiled
def _follow(
    angle: float, speed: float, position: float, dt: float, gain: Gain, half: float
) -> tuple[float, float]:
    """θ and ω."""
    innovation = position - angle - speed * dt
    after = angle + speed * dt + gain.angle * innovation
    return min(max(after, position - half), position + half), speed + gain.speed * innovation
