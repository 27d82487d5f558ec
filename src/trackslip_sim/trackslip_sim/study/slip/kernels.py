# SPDX-License-Identifier: Apache-2.0
"""Loops over the rows of a log along a known truth, compiled.

    x, P      true state of the filter's own model; a covariance about it    (n,), (n, n)
    F, Q      transition and its noise                                       (n, n)
    h, H, R   what is measured of x, its Jacobian, its noise                 (m,), (m, n), (m, m)
    J⁻¹       posterior Cramér–Rao bound (Tichavský et al. 1998)             (n, n)

Logs come as the arrays of ``filters.batch.Log``.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled_upon
from trackslip_estimation.kalman.linear_algebra import (
    apply,
    root,
    sandwich,
    solve,
    times,
    weighted_square,
    wrap,
)
from trackslip_estimation.slip.filter import update
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.models.model import POSE, SPROCKETS, YAW

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
RecordArray = NDArray[np.void]

ERRORS = 6  # x, y, φ, i_L, i_R, α
_ITERATIONS = 3  # the turning model is linear, the others nearly
_compiled = compiled_upon(equations)


@_compiled
def _move(
    x: FloatArray, dt: float, speeds: FloatArray, flags: IntArray, c: Any
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """f(x), F and Q at a state that is known."""
    left, right, departure = speeds
    _, _, motion, changing, _ = flags
    known = np.zeros((x.size, x.size))
    F = equations.transition(x, left, right, dt, motion, c)
    Q = equations.process_noise(x, known, left, right, dt, motion, changing, departure, c)
    return equations.move(x, left, right, dt, motion, c), F, Q


@_compiled
def bound(
    clock: FloatArray,
    speeds: FloatArray,
    flags: IntArray,
    noises: FloatArray,
    states: FloatArray,
    start: FloatArray,
    P: FloatArray,
    constants: RecordArray,
) -> FloatArray:
    """J⁻¹ after each row (k, n, n): J_k = (F J⁻¹ Fᵀ + Q)⁻¹ + Hᵀ R⁻¹ H, linearised at the truth.

    ``states`` (k, n) is the truth at the rows, ``start`` (n,) before the first, P what a filter knows of it.
    """
    c = constants[0]
    bounds = np.empty((clock.shape[0], start.size, start.size))
    before = start
    for k in range(clock.shape[0]):
        dt, stretch = clock[k]
        _, F, Q = _move(before, dt, speeds[k], flags[k], c)
        P = sandwich(F, P) + Q
        before = states[k].copy()
        kind = flags[k, 0]
        if kind != SPROCKETS:
            left, right, counted = speeds[k, 0], speeds[k, 1], flags[k, 4] == 1
            z, R = np.zeros(kind), noises[k, :kind, :kind].copy()  # the kinds are numbered by their size
            P = update(kind, before, P, z, R, left, right, stretch, counted, c)[1]
        bounds[k] = P
    return bounds


@_compiled
def draw(
    clock: FloatArray,
    speeds: FloatArray,
    flags: IntArray,
    noises: FloatArray,
    x: FloatArray,
    normals: FloatArray,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray]:
    """A truth that is the filter's own model: states (k, n) with Q, measurements (k, 3) with R.

    ``normals`` (k, n + 3) are standard normal draws, x (n,) is the state before the first row.
    """
    c = constants[0]
    n = x.size
    states, values = np.empty((clock.shape[0], n)), np.zeros((clock.shape[0], 3))
    for k in range(clock.shape[0]):
        x, _, Q = _move(x, clock[k, 0], speeds[k], flags[k], c)
        x += apply(root(Q), normals[k, :n])
        x[YAW] = wrap(x[YAW])
        states[k] = x
        kind = flags[k, 0]
        if kind != SPROCKETS:
            of_noise = apply(root(noises[k, :kind, :kind].copy()), normals[k, n : n + kind])
            values[k, :kind] = equations.expected(kind, x, speeds[k, 0], speeds[k, 1], c) + of_noise
    return states, values


@_compiled
def nearest(
    poses: FloatArray,
    twists: FloatArray,
    speeds: FloatArray,
    x: FloatArray,
    P: FloatArray,
    constants: RecordArray,
) -> FloatArray:
    """States (k, n) at ``poses`` (k, 3) with v_x and φ̇ of ``twists`` (k, 2), least far from x as P counts it.

    The lateral speed, some mm/s, stays the model's: at a small φ̇ it would ask for any x_I.
    """
    c = constants[0]
    states = np.empty((poses.shape[0], x.size))
    for k in range(poses.shape[0]):
        left, right = speeds[k]
        state = x.copy()
        state[POSE] = poses[k]
        for _ in range(_ITERATIONS):
            v_x, _, rate = equations.twist(state, left, right, c)
            missing = twists[k] - np.array((v_x, rate))
            J = np.ascontiguousarray(equations.twist_jacobian(state, left, right, c)[::2])
            gain = np.ascontiguousarray(solve(root(sandwich(J, P)), times(J, P)).T)
            state = state + apply(gain, missing)
        states[k] = state
    return states


@_compiled
def slips_of(states: FloatArray, speeds: FloatArray, constants: RecordArray) -> FloatArray:
    """(k, 3) left slip, right slip, slip angle of true states with true sprocket speeds."""
    slips = np.empty((states.shape[0], 3))
    certain = np.zeros((states.shape[1], states.shape[1]))
    for k in range(states.shape[0]):
        left, right = speeds[k, 0], speeds[k, 1]
        slips[k] = equations.outputs(states[k], certain, left, right, 0.0, False, constants[0])[2]
    return slips


@_compiled
def variances(
    rows: IntArray,
    states: FloatArray,
    covariances: FloatArray,
    speeds: FloatArray,
    stretches: FloatArray,
    constants: RecordArray,
) -> FloatArray:
    """(s, 6) of pose and slips, by covariances (k, n, n) about states (k, n), at s of the k rows.

    Slips are told by sprocket speeds (k, 2) that are differenced over stretches (k,).
    """
    c = constants[0]
    found = np.empty((rows.size, ERRORS))
    for i in range(rows.size):
        k = rows[i]
        P = covariances[k]
        S = equations.outputs(states[k], P, speeds[k, 0], speeds[k, 1], stretches[k], True, c)[3]
        for j in range(3):
            found[i, j], found[i, 3 + j] = P[j, j], S[j, j]
    return found


@_compiled
def compare(
    rows: IntArray,
    means: FloatArray,
    covariances: FloatArray,
    speeds: FloatArray,
    stretches: FloatArray,
    states: FloatArray,
    slips: FloatArray,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray]:
    """Errors (s, 6) of pose and slips, and their NEES (s, 2): of the pose, of both slips.

    Of means (k, n) against true states (k, n) and slips (k, 3); otherwise as ``variances``.
    """
    c = constants[0]
    errors, nees = np.empty((rows.size, ERRORS)), np.empty((rows.size, 2))
    for i in range(rows.size):
        k = rows[i]
        P = covariances[k]
        told = equations.outputs(means[k], P, speeds[k, 0], speeds[k, 1], stretches[k], True, c)
        errors[i, :3] = means[k, :3] - states[k, :3]
        errors[i, YAW] = wrap(errors[i, YAW])
        errors[i, 3:] = told[2] - slips[k]
        nees[i, 0] = weighted_square(root(P[:3, :3].copy()), errors[i, :3])
        nees[i, 1] = weighted_square(root(told[3][:2, :2].copy()), errors[i, 3:5])
    return errors, nees
