# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What an IMU felt since its accelerations last told the tilt: means over a span of samples; compiled.

    T       span: as long as wanted, or one sample where they are further apart        s
    f̄       mean of f − ω × u                                                          m/s²
    φ̄, θ̄    mean roll and pitch: those at its end, less what the gyro has turned since, on average   rad
    u̇       (u − u₀)/T, by the velocities of the IMU's place at both ends              m/s²

An error of u goes into u̇ by 1/T. Fixes move the speed by a centimetre per second: between samples of 100 Hz
that is 1 m/s², and taken for noise it hides the tilt, which then drifts with the gyro.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.attitude.records import PITCH, ROLL

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Attitude

LONGEST = 0.5  # s, between samples of which one follows from the other
SHORTEST = 0.08  # s, T: pitch errs by as much with a span of 0.5, and by three times as much without


@compiled
def begin_span(a: Attitude, u: tuple[float, float]) -> None:
    """A span begins at the new sample, where the IMU's place has the velocity u."""
    span = a.span
    span.stamp_ns, span.begun, span.samples, span.time = a.sample.stamp_ns, 1, 0, 0.0
    span.lag[:] = 0.0
    span.velocity[0], span.velocity[1] = u
    span.known = a.sample.known_velocity


@compiled
def turn_span(a: Attitude, roll: float, pitch: float) -> None:
    """The gyro has turned the machine by so much, rad, since the sample before."""
    a.span.lag[ROLL] += roll * a.span.time
    a.span.lag[PITCH] += pitch * a.span.time


@compiled
def feel(a: Attitude, force: tuple[float, float], u: tuple[float, float]) -> None:
    """The new sample's f − ω × u, m/s²; one that does not follow on another is a span of no time."""
    span = a.span
    dt = (a.sample.stamp_ns - span.stamp_ns) * 1e-9
    if span.begun == 0 or not 0.0 < dt <= LONGEST:
        begin_span(a, u)
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
    """φ̄ and θ̄ of a span that ends here."""
    span, x = a.span, a.mean
    if span.samples == 1:
        return x[ROLL], x[PITCH]
    return x[ROLL] - span.lag[ROLL] / span.time, x[PITCH] - span.lag[PITCH] / span.time


@compiled
def own_acceleration(a: Attitude, u: tuple[float, float]) -> tuple[float, float]:
    """u̇ of a span that ends here, with the velocity u; nothing where one was not known."""
    span = a.span
    if span.known == 0:
        return 0.0, 0.0
    return (u[0] - span.velocity[0]) / span.time, (u[1] - span.velocity[1]) / span.time
