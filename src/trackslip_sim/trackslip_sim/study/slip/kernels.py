# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Loops over the rows of a log along a known truth, compiled.

    x, P      true state of the filter's own model; a covariance about it    (n,), (n, n)
    F, Q      transition and its noise                                       (n, n)
    h, H, R   measurement function of x, its Jacobian, its noise             (m,), (m, n), (m, m)
    J⁻¹       posterior Cramér–Rao bound (Tichavský et al. 1998)             (n, n)

``Rows`` are measurements in the order of their stamps, after a start at stamp 0. Each has the sprocket speeds
up to its stamp.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.compiled import compiled
from trackslip_estimation.attitude.level import set_level
from trackslip_estimation.attitude.records import PITCH, ROLL
from trackslip_estimation.kalman.linear_algebra import (
    multiply,
    multiply_vector,
    root,
    sandwich,
    solve,
    weighted_square,
    wrap,
)
from trackslip_estimation.kalman.propagate import propagate_covariance
from trackslip_estimation.kalman.update import correct, independent_observation
from trackslip_estimation.slip.models.dispatch import COUPLED, body_jacobian, body_twist, linearize, slips
from trackslip_estimation.slip.models.model import POSE, SWING, YAW
from trackslip_estimation.slip.models.swing import propagate_swing_covariance
from trackslip_estimation.slip.outputs import fill_outputs
from trackslip_estimation.slip.records import ESTIMATE, SPROCKETS, STATE
from trackslip_estimation.slip.update import observe

RecordArray = NDArray[np.void]

ERRORS = 7  # x, y, φ, i_L, i_R, α, σ
SLIPS, SWING_COLUMN = slice(3, 6), 6  # of these
_ITERATIONS = 3  # the turning model is linear, the others nearly so


class Rows(NamedTuple):
    """A log as arrays for kernels."""

    measurements: RecordArray  # (k,) of ``MEASUREMENT``
    drives: RecordArray  # (k,) of ``STATE``; only speeds and motion are used


class Scratch(NamedTuple):
    """Work space for one state and its outputs."""

    state: RecordArray  # (1,) of ``STATE``
    estimate: RecordArray  # (1,) of ``ESTIMATE``


def new_scratch() -> Scratch:
    """New work space; each thread needs its own."""
    return Scratch(np.zeros(1, STATE), np.zeros(1, ESTIMATE))


@compiled
def set_attitude(drives: RecordArray, tilts: FloatArray, rates: FloatArray) -> None:
    """Set the attitude of the drives (k,) to known roll and pitch (k, 2) and rates p, q, r (k, 3)."""
    for k in range(drives.size):
        a = drives[k].attitude
        a.known = 1
        a.mean[ROLL], a.mean[PITCH] = tilts[k]
        a.rates[:] = rates[k]
        set_level(a)


@compiled
def cramer_rao_bound(
    rows: Rows, states: FloatArray, start: FloatArray, P: FloatArray, config: RecordArray
) -> FloatArray:
    """J⁻¹ after each row (k, n, n): J_k = (F J⁻¹ Fᵀ + Q)⁻¹ + Hᵀ R⁻¹ H, linearised at the truth.

    ``states`` (k, n): truth at the rows; ``start`` (n,): truth before the first row; P: covariance there.
    """
    c = config[0]
    bounds = np.empty((rows.drives.size, start.size, start.size))
    before, stamp_ns, zero = start, 0, np.zeros((start.size, start.size))
    P, scratch = P.copy(), rows.drives[:1].copy()
    for k in range(rows.drives.size):
        measurement, drive = rows.measurements[k], rows.drives[k]
        _, F, Q = linearize(before, zero, drive, (measurement.stamp_ns - stamp_ns) * 1e-9, c)
        if c.swings:
            propagate_swing_covariance(P, F)
        propagate_covariance(P, F, Q, COUPLED)
        before, stamp_ns = states[k].copy(), measurement.stamp_ns
        if measurement.kind != SPROCKETS:
            scratch[0] = drive
            scratch[0].mean[:], scratch[0].covariance[:] = before, P
            o = observe(scratch[0], measurement, c)
            correct(before.copy(), P, independent_observation(o.innovation, o.jacobian, o.noise))
        bounds[k] = P
    return bounds


@compiled
def draw_from_model(
    rows: Rows, x: FloatArray, normals: FloatArray, config: RecordArray
) -> tuple[FloatArray, FloatArray]:
    """A truth drawn from the filter's own model: states (k, n) with Q, measurements (k, 3) with R.

    ``normals`` (k, n + 3) are standard normal draws, x (n,) is the state before the first row.
    """
    c = config[0]
    n, count, stamp_ns = x.size, rows.drives.size, 0
    states, values, zero = np.empty((count, n)), np.zeros((count, 3)), np.zeros((n, n))
    scratch = rows.drives[:1].copy()
    for k in range(count):
        measurement, drive = rows.measurements[k], rows.drives[k]
        x, _, Q = linearize(x, zero, drive, (measurement.stamp_ns - stamp_ns) * 1e-9, c)
        x = x + multiply_vector(root(Q), normals[k, :n])
        x[YAW] = wrap(x[YAW])
        states[k], stamp_ns = x, measurement.stamp_ns
        if measurement.kind != SPROCKETS:
            scratch[0] = drive
            scratch[0].mean[:] = x
            o = observe(scratch[0], measurement, c)
            m = o.innovation.size
            values[k, :m] = (
                measurement.value[:m] - o.innovation + multiply_vector(root(o.noise), normals[k, n : n + m])
            )
    return states, values


@compiled
def nearest_states(
    poses: FloatArray,
    twists: FloatArray,
    speeds: FloatArray,
    drives: RecordArray,
    prior: tuple[FloatArray, FloatArray],
    config: RecordArray,
) -> FloatArray:
    """States (k, n) at ``poses`` (k, 3) with v_x and φ̇ of ``twists`` (k, 2), nearest to a prior x by its P.

    ``speeds`` (k, 2) are the sprocket speeds; only the attitude of ``drives`` (k,) is used. The lateral speed
    (some mm/s) is not fitted: at small φ̇ it would require arbitrary x_I.
    """
    c = config[0]
    x, P = prior
    states = np.empty((poses.shape[0], x.size))
    for k in range(poses.shape[0]):
        left, right = speeds[k]
        state = x.copy()
        state[POSE] = poses[k]
        for _ in range(_ITERATIONS):
            v_x, _, rate = body_twist(state, left, right, drives[k], c)
            missing = twists[k] - np.array((v_x, rate))
            J = np.ascontiguousarray(body_jacobian(state, left, right, drives[k], c)[::2])
            gain = np.ascontiguousarray(solve(root(sandwich(J, P)), multiply(J, P)).T)
            state = state + multiply_vector(gain, missing)
        states[k] = state
    return states


@compiled
def slips_of(states: FloatArray, drives: RecordArray, config: RecordArray) -> FloatArray:
    """(k, 3) left slip, right slip, slip angle from true states and true sprocket speeds."""
    c, result = config[0], np.empty((states.shape[0], 3))
    for k in range(states.shape[0]):
        left, right = drives[k].speeds.left, drives[k].speeds.right
        result[k] = slips(states[k], body_twist(states[k], left, right, drives[k], c), left, right, c)
    return result


@compiled
def output_variances(
    entries: IntArray,
    states: FloatArray,
    covariances: FloatArray,
    drives: RecordArray,
    scratch: Scratch,
    config: RecordArray,
) -> FloatArray:
    """(s, 7) variances of pose, slips and swing from covariances (k, n, n) about states (k, n), at s rows.

    The swing's are nan if no sensor is mounted on the upper structure.
    """
    c, state, estimate = config[0], scratch.state[0], scratch.estimate[0]
    variances = np.empty((entries.size, ERRORS))
    for i in range(entries.size):
        k = entries[i]
        scratch.state[0] = drives[k]
        state.mean[:], state.covariance[:] = states[k], covariances[k]
        fill_outputs(state, c, estimate)
        for j in range(3):
            variances[i, j], variances[i, 3 + j] = covariances[k, j, j], estimate.slip_covariance[j, j]
        variances[i, SWING_COLUMN] = covariances[k, SWING, SWING] if c.swings else np.nan
    return variances


@compiled
def estimation_errors(
    entries: IntArray,
    filtered: RecordArray,
    states: FloatArray,
    true_slips: FloatArray,
    scratch: Scratch,
    config: RecordArray,
) -> tuple[FloatArray, FloatArray]:
    """Errors (s, 7) of pose, slips and swing, and NEES (s, 2) of the pose and of both slips.

    Compares ``filtered`` (k,) of ``STATE`` with true states (k, n) and slips (k, 3), at s of the k rows.
    """
    c, estimate = config[0], scratch.estimate[0]
    errors, nees = np.empty((entries.size, ERRORS)), np.empty((entries.size, 2))
    for i in range(entries.size):
        k = entries[i]
        fill_outputs(filtered[k], c, estimate)
        errors[i, :3] = filtered[k].mean[:3] - states[k, :3]
        errors[i, YAW] = wrap(errors[i, YAW])
        errors[i, SLIPS] = estimate.slips - true_slips[k]
        errors[i, SWING_COLUMN] = wrap(filtered[k].mean[SWING] - states[k, SWING]) if c.swings else np.nan
        nees[i, 0] = weighted_square(root(filtered[k].covariance[:3, :3].copy()), errors[i, :3])
        nees[i, 1] = weighted_square(root(estimate.slip_covariance[:2, :2].copy()), errors[i, 3:5])
    return errors, nees
