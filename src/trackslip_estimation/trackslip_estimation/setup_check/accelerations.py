# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Accelerations of the inertial unit: their unit and sign by gravity, the direction of x by starts and stops.

v, ω       speed by the tracks, turn rate                                           m/s, rad/s
f          f_x + i f_y, without its slow part, which is a tilt                      m/s²
b, c       f = b v̇ + c v ω, fitted; b = e^(−iψ) for a unit turned by ψ to the left  1
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.units import GRAVITY
from trackslip_estimation.setup_check import remedies
from trackslip_estimation.setup_check.drive import Drive
from trackslip_estimation.setup_check.finding import (
    LEAST_LOG,
    PRIOR,
    Cause,
    Finding,
    OpenQuestion,
    odds_of,
)
from trackslip_estimation.setup_check.grid import increments, integral
from trackslip_estimation.setup_check.inertial import force_at_rest
from trackslip_estimation.setup_check.log import Array, ComplexArray, Gyro

_UNITS = {"g": GRAVITY, "mg": 1e-3 * GRAVITY, "m/s²": 1.0}  # m/s²
_LEAST_GRAVITY = 0.5  # of any unit; less is none
_NEAR = 0.2  # ln ratio up to which a size is that of gravity
_STEP = 0.2  # s: starts and stops are longer
_SLOW = 2.0  # s, length of the means that are taken off
_LARGEST_LAG = 5  # steps by which the unit may lag behind the tracks
_BLOCK = 50  # steps of a block, whose errors are independent
_LEAST_BLOCKS = 4
_LEAST_ACCELERATION = 0.05  # m/s², usual acceleration of a drive with starts and stops
_LEAST_YAW = 0.5  # rad, least angle of a unit that is not mounted as stated
_QUARTER, _NEAR_QUARTER = math.pi / 2.0, 0.25  # rad; a unit near a quarter turn is turned by that


class _Fit(NamedTuple):
    """b and c, and variances by blocks, of one part of each."""

    b: complex
    c: complex
    variance: float  # of b
    turn_variance: float  # of c


def judge_accelerations(drive: Drive) -> list[Finding]:
    """Whether gravity shows in m/s² along z; then a cause if starts and stops lie along another axis than x.

    The drive's signs are right, and its unit is neither late nor mounted upside down. Accelerations without
    gravity along z are not used by the estimator: that is a question, and no mistake.
    """
    gyro = drive.gyro
    force = None if gyro is None else force_at_rest(drive, gyro)
    if gyro is None or force is None:
        return []
    size = float(np.linalg.norm(force))
    if abs(math.log(max(size, 1e-9) / GRAVITY)) < _NEAR and force[2] > 0.5 * size:
        return [] if gyro.is_above else _judge_direction(drive, gyro)
    values = ", ".join(f"{value:.3g}" for value in force)
    what = f"tilt by {gyro.name}: its accelerations at standstill are {values}, not gravity along z in m/s²"
    units = {abs(math.log(max(size, 1e-9) * factor / GRAVITY)): name for name, factor in _UNITS.items()}
    needed = f"state their unit ({units[min(units)]}) or sign in the mapping"
    if size < _LEAST_GRAVITY:
        needed = "let its driver leave gravity in them"
    return [OpenQuestion(what, f"{needed}; at rest z is 9.8 m/s² (REP 145)")]


def _judge_direction(drive: Drive, gyro: Gyro) -> list[Finding]:
    """A cause if the x axis does not point ahead."""
    fit = _fit_forces(drive, gyro)
    if fit is None:
        return []
    yaw = -float(np.angle(fit.b))
    ahead = max(fit.b.real, 0.0)
    log_ratio = (abs(fit.b) ** 2 - ahead**2) / (2.0 * fit.variance) - PRIOR  # the scale is free
    if log_ratio < LEAST_LOG or abs(yaw) < _LEAST_YAW:
        return []
    quarters = round(yaw / _QUARTER)
    yaw = quarters * _QUARTER if abs(yaw - quarters * _QUARTER) < _NEAR_QUARTER else yaw
    direction = f"{abs(math.degrees(yaw)):.0f}° to the {'left' if yaw > 0.0 else 'right'}"
    evidence = f"its x axis points {direction} of ahead, by the forces of starts and stops"
    remedy = remedies.mounting(gyro, remedies.rotation(0.0, 0.0, yaw))
    if abs(quarters) == 2:
        what = f"{gyro.name}: {evidence}, or tracks swapped, and both counting backwards"
        return [OpenQuestion(what, f"drive 10 m ahead: if both tracks count up, {remedy}", is_wrong=True)]
    if (fit.c * (1j * fit.b).conjugate()).real < -3.0 * math.sqrt(fit.turn_variance) * abs(fit.b):
        remedy = "Exchange x and y of its accelerations (and rates), or one of their signs: they are mirrored"
    return [Cause("imu_mounting", gyro.name, evidence, odds_of(log_ratio), remedy)]


def _fit_forces(drive: Drive, gyro: Gyro) -> _Fit | None:
    """The fit at the lag with the largest b; None where the machine hardly starts and stops."""
    grid = drive.grid
    is_finite = np.isfinite(gyro.accelerations[:, :2]).all(axis=1)
    each = max(round(_STEP / grid.cell), 1)
    edges = grid.edges[::each]
    if is_finite.sum() < len(edges):
        return None
    step = float(edges[1] - edges[0])
    count = (len(edges) - 1) * each
    speed, turn = (
        np.nan_to_num(values[:count]).reshape(-1, each).sum(axis=1) / step
        for values in (grid.tracks.mean(axis=1), drive.gyro_turn)
    )
    t = gyro.t[is_finite]
    forces = increments(t, integral(t, gyro.accelerations[is_finite, :2]), edges) / step
    f: ComplexArray = _without_slow(np.asarray(forces @ np.array((1.0, 1.0j))), step)
    motion = np.column_stack([_without_slow(m, step) for m in (np.gradient(speed, step), speed * turn)])
    if float(np.sqrt(np.mean(motion[:, 0] ** 2))) < _LEAST_ACCELERATION:
        return None
    fits = [_fit_at_lag(motion, f, lag) for lag in range(-_LARGEST_LAG, _LARGEST_LAG + 1)]
    return max((fit for fit in fits if fit is not None), key=lambda fit: abs(fit.b), default=None)


def _without_slow(values: Array, step: float) -> Array:
    """Values (n,), smoothed as a central difference is, less their running mean."""
    size = max(round(_SLOW / step), 1)
    smooth = np.convolve(values, (0.25, 0.5, 0.25), "same")
    rest: Array = smooth - np.convolve(smooth, np.full(size, 1.0 / size), "same")
    return rest


def _fit_at_lag(motion: FloatArray, f: ComplexArray, lag: int) -> _Fit | None:
    """The fit of forces ``lag`` steps later; variances by leaving out one block after the other."""
    ahead, behind = max(lag, 0), max(-lag, 0)
    m, g = motion[behind : len(motion) - ahead], f[ahead : len(f) - behind]
    blocks = len(m) // _BLOCK
    if blocks < _LEAST_BLOCKS:
        return None
    parts = np.array_split(np.arange(len(m)), blocks)
    products = np.array([m[p].T @ m[p] for p in parts])
    sums = np.array([m[p].T @ g[p] for p in parts])
    total = products.sum(axis=0)
    if not np.trace(total) > 0.0:
        return None
    total = total + 1e-9 * np.trace(total) * np.eye(2)
    whole = np.linalg.solve(total, sums.sum(axis=0))
    rests = zip(total - products, sums.sum(axis=0) - sums, strict=True)
    left_out = np.array([np.linalg.solve(*rest) for rest in rests])
    spread = (blocks - 1.0) / blocks * np.sum(np.abs(left_out - left_out.mean(axis=0)) ** 2, axis=0) / 2.0
    return _Fit(complex(whole[0]), complex(whole[1]), max(float(spread[0]), 1e-4), float(spread[1]))
