# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Random machines: each differs from its nominal parameters as real machines do.

    V, D    mean of the track speeds; right track speed minus left          m/s
    d       deviation of the track speeds from their recent mean            m/s
    e_v     error of v in addition to that of the truth, of size σ_v        m/s
    e_ω     the same for ω, of size σ_ω                                     rad/s
    f       velocity errors over those of the emulated excavator            1
    τ       correlation time of both                                        s

    σ_v² = (f² − 1) ((0.0024 V)² + (0.042 d)²)     B² σ_ω² = (f² − 1) ((0.001 V)² + (0.042 d)²)

The terms were measured on the shear truth, whose own errors are those of f = 1.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from trackslip_common.arrays import FloatArray

SPEED_ERROR, TURN_ERROR, SPEED_CHANGE_ERROR = 0.0024, 0.001, 0.042  # shares of V and of d
CORRELATION_TIME = 0.14  # s, τ
GYRO_SCALE, ASYMMETRY, RADIUS, FIX_DELAY = 0.02, 0.02, 0.01, 0.1  # largest deviations of a machine
_MEAN_TIME = 0.5  # s, time constant of the recent mean


@dataclass(frozen=True, kw_only=True)
class DrawnMachine:
    """Deviations of a machine from its parameters; the defaults are the nominal machine."""

    gyro_scale: float = 1.0  # gyro output over true rate
    asymmetry: float = 0.0  # ε, rad/m
    radius: float = 1.0  # true rolling radius over the stated one
    velocity_errors: float = 1.0  # f
    fix_delay: float = 0.0  # s, age of a fix at its stamp
    gyro_noise: float = 1.0  # true standard deviation over the stated one
    fix_variance: float = 1.0  # true over stated


def uniform_variance(limit: float) -> float:
    """Variance of a uniform variable between −``limit`` and ``limit``."""
    return limit * limit / 3.0


def draw_machine(random: np.random.Generator) -> DrawnMachine:
    """A random machine."""
    return DrawnMachine(
        gyro_scale=1.0 + random.uniform(-GYRO_SCALE, GYRO_SCALE),
        asymmetry=random.uniform(-ASYMMETRY, ASYMMETRY),
        radius=1.0 + random.uniform(-RADIUS, RADIUS),
        velocity_errors=10.0 ** random.uniform(0.0, 1.0),
        fix_delay=random.uniform(-FIX_DELAY, FIX_DELAY),
        gyro_noise=random.uniform(1.0, 5.0),
        fix_variance=float(random.choice((0.5, 2.0))),
    )


class MotionErrors:
    """Converts the motion of the nominal machine to that of a drawn one, in pieces of a drive."""

    def __init__(
        self, machine: DrawnMachine, tread: float, period: float, random: np.random.Generator
    ) -> None:
        """``period``: s between two samples."""
        self._machine, self._tread, self._random = machine, tread, random
        decay, mean_decay = math.exp(-period / CORRELATION_TIME), math.exp(-period / _MEAN_TIME)
        self._noise = ([math.sqrt(1.0 - decay * decay)], [1.0, -decay])
        self._mean = ([1.0 - mean_decay], [1.0, -mean_decay])
        self._noise_state = decay * random.standard_normal((1, 2))
        self._mean_state = np.zeros((1, 2))

    def apply(self, tracks: FloatArray, twists: FloatArray) -> FloatArray:
        """(n, 3) v_x, v_y, ω of the drawn machine from track speeds (n, 2) and nominal twists (n, 3)."""
        machine = self._machine
        mean, self._mean_state = lfilter(*self._mean, tracks, axis=0, zi=self._mean_state)
        white = self._random.standard_normal(tracks.shape)
        errors, self._noise_state = lfilter(*self._noise, white, axis=0, zi=self._noise_state)
        V, d = tracks.mean(axis=1), np.abs(tracks - mean).max(axis=1)
        factor = math.sqrt(machine.velocity_errors**2 - 1.0)
        drawn = machine.radius * twists
        drawn[:, 0] += factor * np.hypot(SPEED_ERROR * V, SPEED_CHANGE_ERROR * d) * errors[:, 0]
        drawn[:, 2] += factor * np.hypot(TURN_ERROR * V, SPEED_CHANGE_ERROR * d) * errors[:, 1] / self._tread
        drawn[:, 2] += machine.asymmetry * V
        return np.asarray(drawn)


def interpolate_columns(times: FloatArray, t: FloatArray, columns: FloatArray) -> FloatArray:
    """(k, m) columns (n, m), given at times ``t`` (n,), interpolated at ``times`` (k,), s."""
    return np.stack([np.interp(times, t, column) for column in columns.T], axis=1)


def integrate_twists(twists: FloatArray, period: float, start: FloatArray) -> FloatArray:
    """(n, 3) poses after each of n periods, from a pose (3,) and twists (n, 3) at the periods' ends."""
    yaw = start[2] + period * np.cumsum(twists[:, 2])
    halfway = yaw - 0.5 * period * twists[:, 2]
    cos, sin = np.cos(halfway), np.sin(halfway)
    east, north = cos * twists[:, 0] - sin * twists[:, 1], sin * twists[:, 0] + cos * twists[:, 1]
    return np.stack((start[0] + period * np.cumsum(east), start[1] + period * np.cumsum(north), yaw), axis=1)
