# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One implicit step of hull and tracks on frictional ground, compiled.

    q = (v_x, v_y, φ̇, u_L, u_R)   hull velocity at C, track speeds u = r ω       m/s, rad/s
    M                              diag(m, m, I_z, m_t, m_t); m_t: inertia of track and motor as a mass
    R_j                            rolling resistance ½ μ_r W of a track          N
    G                              weight along the ground and its moment about C       N, N m

The step minimises  ½ (q - q₀)ᵀ M (q - q₀)/Δt + Σ f ρ + Σ R_j |v_j| - Gᵀ q + drive(u)  over q: backward Euler
as a convex minimisation, since the friction potential is convex. The step is therefore stable at any
stiffness and has no chatter at standstill. It dissipates energy: at each step the power of tracks and weight
is ≥ losses + growth of kinetic energy.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_sim.truth.contact import Shear, ShearSums, Tracks, shear_sums

SIZE = 5
TOLERANCE = 8e-11  # largest unbalanced force over the weight: a few times the rounding error on stiff ground
MAX_ITERATIONS = 60
MAX_ATTEMPTS = 20
SLOPE_RATIO = 0.1  # share of the initial slope at which the line search along a Newton step ends


class Machine(NamedTuple):
    """Numbers of the vehicle as the kernel needs them; SI units."""

    step: float  # s, Δt
    mass: float
    yaw_inertia: float
    track_mass: float
    drive_limit: float  # N, thrust at relief pressure, motor driving
    brake_limit: float  # N, the same with the motor driven
    drive_stiffness: float  # N per m/s below the speed at the oil flow
    sliding_floor: float
    rolling_floor: float
    slip_floor: float
    tolerance: float  # N or N m left unbalanced


class Newton(NamedTuple):
    """Input, work space and result of one step."""

    start: FloatArray  # (5,) q₀
    target: FloatArray  # (2,) m/s, track speeds at the oil flow
    limits: FloatArray  # (2, 2) N, lowest and highest thrust of each motor
    rolling: FloatArray  # (2,) R_j, N
    gravity: FloatArray  # (3,) G
    sums: ShearSums
    gradient: FloatArray  # (5,) unbalanced force
    matrix: FloatArray  # (5, 5) second derivatives, upper triangle
    change: FloatArray  # (5,) the Newton step
    trial: FloatArray  # (5,) q along the Newton step
    drive: FloatArray  # (2,) N, thrust of the motors


def new_step(gravity: FloatArray) -> Newton:
    """Work space for ``solve_step``; ``gravity`` is G, which the caller updates in place."""
    sums = ShearSums(np.zeros((2, 3)), np.zeros((2, 6)))
    inputs = np.zeros(SIZE), np.zeros(2), np.zeros((2, 2)), np.zeros(2), gravity
    return Newton(*inputs, sums, np.zeros(5), np.zeros((5, 5)), np.zeros(5), np.zeros(5), np.zeros(2))


@compiled
def evaluate_forces(q: FloatArray, machine: Machine, tracks: Tracks, shear: Shear, newton: Newton) -> None:
    """Fill ``sums``, ``gradient`` and ``drive`` at q."""
    shear_sums(q, shear, tracks, machine.sliding_floor, newton.sums)
    force, gradient = newton.sums.force, newton.gradient
    for i in range(SIZE):
        gradient[i] = inertia_of(i, machine) / machine.step * (q[i] - newton.start[i])
        if i < 3:
            gradient[i] -= newton.gravity[i]
    for k in range(2):
        arm = tracks.half_tread * (1.0 - 2.0 * k)
        v = q[0] - q[2] * arm
        rho = math.sqrt(v * v + machine.rolling_floor**2)
        along = force[k, 0] + newton.rolling[k] * v / rho
        gradient[0] += along
        gradient[1] += force[k, 1]
        gradient[2] += force[k, 2] - arm * along
        lag = newton.target[k] - q[3 + k]
        drive = min(max(machine.drive_stiffness * lag, newton.limits[k, 0]), newton.limits[k, 1])
        gradient[3 + k] -= force[k, 0] + drive
        newton.drive[k] = drive


@compiled
def inertia_of(i: int, machine: Machine) -> float:
    """Diagonal of M, kg or kg m²."""
    if i < 2:
        return machine.mass
    return machine.yaw_inertia if i == 2 else machine.track_mass


@compiled
def assemble_matrix(q: FloatArray, machine: Machine, tracks: Tracks, newton: Newton) -> None:
    """Fill ``matrix`` at q; ``evaluate_forces`` must have been called at the same q."""
    matrix, curvature = newton.matrix, newton.sums.curvature
    for i in range(SIZE):
        for column in range(i, SIZE):
            matrix[i, column] = inertia_of(i, machine) / machine.step if i == column else 0.0
    for k in range(2):
        arm = tracks.half_tread * (1.0 - 2.0 * k)
        h_xx, h_xy, h_xyx = curvature[k, 0], curvature[k, 1], curvature[k, 2]
        h_yy, h_yyx, h_yyxx = curvature[k, 3], curvature[k, 4], curvature[k, 5]
        v = q[0] - q[2] * arm
        rho = math.sqrt(v * v + machine.rolling_floor**2)
        roll = newton.rolling[k] * machine.rolling_floor**2 / rho**3
        matrix[0, 0] += h_xx + roll
        matrix[0, 1] += h_xy
        matrix[0, 2] += h_xyx - arm * (h_xx + roll)
        matrix[1, 1] += h_yy
        matrix[1, 2] += h_yyx - arm * h_xy
        matrix[2, 2] += h_yyxx - 2.0 * arm * h_xyx + arm * arm * (h_xx + roll)
        matrix[0, 3 + k] -= h_xx
        matrix[1, 3 + k] -= h_xy
        matrix[2, 3 + k] -= h_xyx - arm * h_xx
        drive = machine.drive_stiffness * (newton.target[k] - q[3 + k])
        is_limited = not newton.limits[k, 0] < drive < newton.limits[k, 1]
        matrix[3 + k, 3 + k] += h_xx + (0.0 if is_limited else machine.drive_stiffness)


@compiled
def solve_symmetric(matrix: FloatArray, right: FloatArray, result: FloatArray) -> None:
    """Solve A x = b for positive definite A by L D Lᵀ in place; only the upper triangle of A is read."""
    n = len(right)
    for i in range(n):
        result[i] = right[i]
    for i in range(n):
        for row in range(i + 1, n):
            factor = matrix[i, row] / matrix[i, i]
            for column in range(row, n):
                matrix[row, column] -= factor * matrix[i, column]
            result[row] -= factor * result[i]
    for i in range(n - 1, -1, -1):
        for column in range(i + 1, n):
            result[i] -= matrix[i, column] * result[column]
        result[i] /= matrix[i, i]


@compiled
def solve_step(q: FloatArray, machine: Machine, tracks: Tracks, shear: Shear, newton: Newton) -> int:
    """Advance q by one step towards the track speeds ``target``; returns the iterations used.

    Newton's method; where its step overshoots, a line search brackets the minimum by the slope.
    """
    for i in range(SIZE):
        newton.start[i] = q[i]
    set_relief_limits(q, machine, newton.limits)
    evaluate_forces(q, machine, tracks, shear, newton)
    for iteration in range(MAX_ITERATIONS):
        if is_balanced(newton.gradient, machine.tolerance):
            return iteration
        assemble_matrix(q, machine, tracks, newton)
        solve_symmetric(newton.matrix, newton.gradient, newton.change)
        slope = slope_along(newton)
        low_slope, high_slope = slope, 0.0
        low, high, part = 0.0, 1.0, 1.0
        for attempt in range(MAX_ATTEMPTS):
            if attempt % 2 == 1:
                part = low + (high - low) * low_slope / (low_slope - high_slope)
            elif attempt:
                part = 0.5 * (low + high)
            for i in range(SIZE):
                newton.trial[i] = q[i] - part * newton.change[i]
            evaluate_forces(newton.trial, machine, tracks, shear, newton)
            trial_slope = slope_along(newton)
            if abs(trial_slope) <= -SLOPE_RATIO * slope or (trial_slope < 0.0 and part == 1.0):
                break
            if trial_slope > 0.0:
                high, high_slope = part, trial_slope
            else:
                low, low_slope = part, trial_slope
        for i in range(SIZE):
            q[i] = newton.trial[i]
    return MAX_ITERATIONS


@compiled
def is_balanced(gradient: FloatArray, tolerance: float) -> bool:
    """Whether the magnitudes of all unbalanced forces are below ``tolerance``."""
    count = 0
    for force in gradient:
        count += abs(force) < tolerance
    return count == len(gradient)


@compiled
def slope_along(newton: Newton) -> float:
    """Derivative of the minimised function with respect to the fraction of the Newton step."""
    slope = 0.0
    for i in range(SIZE):
        slope -= newton.gradient[i] * newton.change[i]
    return slope


@compiled
def set_relief_limits(q: FloatArray, machine: Machine, limits: FloatArray) -> None:
    """Fill the lowest and highest thrust of each motor (2, 2), N; a motor driven by its track holds more."""
    extra = machine.brake_limit - machine.drive_limit
    for k in range(2):
        speed = q[3 + k] / machine.slip_floor
        limits[k, 0] = -machine.drive_limit - extra * min(max(speed, 0.0), 1.0)
        limits[k, 1] = machine.drive_limit + extra * min(max(-speed, 0.0), 1.0)
