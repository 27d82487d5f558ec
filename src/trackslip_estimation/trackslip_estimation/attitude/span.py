# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Means of accelerations over a span of samples, which update the tilt at its end; compiled.

    T       length of the span: at least LEAST_SPAN_TIME, or one sample after a gap    s
    f̄       mean of f − ω × u                                                          m/s²
    φ̄, θ̄    mean roll and pitch: those at the end, less the mean rotation by the gyro until then     rad
    u̇       (u − u₀)/T, by the velocities of the IMU at both ends                      m/s²

An error of u enters u̇ with 1/T. Fixes change the speed by a centimetre per second: between samples of 100 Hz
that is 1 m/s². Treated as noise, this error hides the tilt, which then drifts with the gyro.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.attitude.records import PITCH, ROLL

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Attitude

LONGEST_GAP = 0.5  # s, longest gap between consecutive samples
# s, least T: the pitch error is the same for 0.5, and three times as large without spans
LEAST_SPAN_TIME = 0.08


@compiled
def reset_span(a: Attitude, u: tuple[float, float]) -> None:
    """Begin a span at the new sample, where the IMU has the velocity u."""
    span = a.span
    span.stamp_ns, span.begun, span.samples, span.time = a.sample.stamp_ns, 1, 0, 0.0
    span.lag[:] = 0.0
    span.velocity[0], span.velocity[1] = u
    span.known = a.sample.known_velocity


@compiled
def accumulate_rotation(a: Attitude, roll: float, pitch: float) -> None:
    """Accumulate a rotation by the gyro since the last sample, rad, in the lag of the span."""
    a.span.lag[ROLL] += roll * a.span.time
    a.span.lag[PITCH] += pitch * a.span.time


@compiled
def add_sample(a: Attitude, force: tuple[float, float], u: tuple[float, float]) -> None:
    """Add f − ω × u of the new sample, m/s², to the span; after a gap begin a span of zero length."""
    span = a.span
    dt = (a.sample.stamp_ns - span.stamp_ns) * 1e-9
    if span.begun == 0 or not 0.0 < dt <= LONGEST_GAP:
        reset_span(a, u)
        dt, span.known = 0.0, 0
    span.stamp_ns = a.sample.stamp_ns
    span.time += dt
    span.samples += 1
    share = dt / span.time if span.samples > 1 else 1.0
    for axis in range(2):
        span.force[axis] += share * (force[axis] - span.force[axis])
    span.known = min(span.known, a.sample.known_velocity)


@compiled
def mean_tilt(a: Attitude) -> tuple[float, float]:
    """φ̄ and θ̄ of a span that ends here, rad."""
    span, x = a.span, a.mean
    if span.samples == 1:
        return x[ROLL], x[PITCH]
    return x[ROLL] - span.lag[ROLL] / span.time, x[PITCH] - span.lag[PITCH] / span.time


@compiled
def mean_acceleration(a: Attitude, u: tuple[float, float]) -> tuple[float, float]:
    """u̇ of a span that ends here at the velocity u, m/s²; zero if a velocity was unknown."""
    span = a.span
    if span.known == 0:
        return 0.0, 0.0
    return (u[0] - span.velocity[0]) / span.time, (u[1] - span.velocity[1]) / span.time
