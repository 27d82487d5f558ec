# SPDX-License-Identifier: Apache-2.0
"""One implicit step of hull and tracks on frictional ground, compiled.

    q = (v_x, v_y, φ̇, u_L, u_R)   hull velocity at C, track speeds u = r ω       m/s, rad/s
    M                              diag(m, m, I_z, m_t, m_t), m_t felt at the track
    R_j                            rolling resistance ½ μ_r W of a track          N

The step minimises  ½ (q - q₀)ᵀ M (q - q₀)/Δt + Σ f ρ + Σ R_j |v_j| + drive(u)  over q: backward Euler,
written as a convex function because friction is one. So it is stable at any stiffness, stands still without
chatter, and dissipates: power of the tracks ≥ losses + growth of kinetic energy, at each step.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_sim.truth.contact import shear_sums
from trackslip_sim.truth.record import FloatArray

SIZE = 5
TOLERANCE = 1e-6  # N or N m left unbalanced
MAX_ITERATIONS = 60
MAX_ATTEMPTS = 20
FLAT = 0.1  # of its initial slope: where the search along a Newton step ends


class Machine(NamedTuple):
    """Numbers of the vehicle as the kernel needs them; SI units."""

    mass: float
    yaw_inertia: float
    half_tread: float
    track_mass: float
    element_area: float
    drive_limit: float  # N, thrust at relief pressure, motor driving
    brake_limit: float  # N, the same with the motor driven
    drive_stiffness: float  # N per m/s of lag behind the oil
    sliding_floor: float
    rolling_floor: float
    slip_floor: float


class Sums(NamedTuple):
    """Work space and results of one evaluation; see ``shear_sums``."""

    force: FloatArray
    curvature: FloatArray
    gradient: FloatArray  # (5,)
    matrix: FloatArray  # (5, 5)
    drive: FloatArray  # (2,) N, thrust of the motors


def new_sums() -> Sums:
    """Work space for ``solve_step``."""
    return Sums(
        np.zeros((2, 3)),
        np.zeros((2, 6)),
        np.zeros(SIZE),
        np.zeros((SIZE, SIZE)),
        np.zeros(2),
    )


@compiled
def evaluate(
    q: FloatArray,
    start: FloatArray,
    target: FloatArray,
    limits: FloatArray,
    strength: FloatArray,
    rolling: FloatArray,
    x_e: FloatArray,
    machine: Machine,
    step: float,
    sums: Sums,
) -> None:
    """Fill ``sums`` at q; its ``gradient`` (5,) is the force left unbalanced."""
    shear_sums(q, strength, x_e, machine.half_tread, machine.sliding_floor, sums.force, sums.curvature)
    gradient = sums.gradient
    for i in range(SIZE):
        gradient[i] = inertia_of(i, machine) / step * (q[i] - start[i])
    for k in range(2):
        arm = machine.half_tread * (1.0 - 2.0 * k)
        v = q[0] - q[2] * arm
        rho = math.sqrt(v * v + machine.rolling_floor**2)
        along = sums.force[k, 0] + rolling[k] * v / rho
        gradient[0] += along
        gradient[1] += sums.force[k, 1]
        gradient[2] += sums.force[k, 2] - arm * along
        lag = target[k] - q[3 + k]
        drive = min(max(machine.drive_stiffness * lag, limits[k, 0]), limits[k, 1])
        gradient[3 + k] -= sums.force[k, 0] + drive
        sums.drive[k] = drive


@compiled
def inertia_of(i: int, machine: Machine) -> float:
    """Diagonal of M, kg or kg m²."""
    if i < 2:
        return machine.mass
    return machine.yaw_inertia if i == 2 else machine.track_mass


@compiled
def assemble(
    q: FloatArray,
    target: FloatArray,
    limits: FloatArray,
    rolling: FloatArray,
    machine: Machine,
    step: float,
    sums: Sums,
) -> None:
    """Fill ``sums.matrix`` with the second derivatives (5, 5) at q, where ``evaluate`` has been."""
    matrix = sums.matrix
    matrix[:] = 0.0
    for i in range(SIZE):
        matrix[i, i] = inertia_of(i, machine) / step
    for k in range(2):
        arm = machine.half_tread * (1.0 - 2.0 * k)
        h_xx, h_xy, h_xyx, h_yy, h_yyx, h_yyxx = sums.curvature[k]
        v = q[0] - q[2] * arm
        rho = math.sqrt(v * v + machine.rolling_floor**2)
        roll = rolling[k] * machine.rolling_floor**2 / rho**3
        matrix[0, 0] += h_xx + roll
        matrix[0, 1] += h_xy
        matrix[0, 2] += h_xyx - arm * (h_xx + roll)
        matrix[1, 1] += h_yy
        matrix[1, 2] += h_yyx - arm * h_xy
        matrix[2, 2] += h_yyxx - 2.0 * arm * h_xyx + arm * arm * (h_xx + roll)
        matrix[0, 3 + k] -= h_xx
        matrix[1, 3 + k] -= h_xy
        matrix[2, 3 + k] -= h_xyx - arm * h_xx
        push = machine.drive_stiffness * (target[k] - q[3 + k])
        yields = not limits[k, 0] < push < limits[k, 1]
        matrix[3 + k, 3 + k] += h_xx + (0.0 if yields else machine.drive_stiffness)


@compiled
def solve_symmetric(matrix: FloatArray, right: FloatArray, result: FloatArray) -> None:
    """Positive definite A x = b by L D Lᵀ in place; only the upper triangle of A is read."""
    n = len(right)
    result[:] = right
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
def solve_step(
    q: FloatArray,
    target: FloatArray,
    strength: FloatArray,
    rolling: FloatArray,
    x_e: FloatArray,
    machine: Machine,
    step: float,
    sums: Sums,
) -> int:
    """Advance q by one step towards the track speeds ``target`` (2,); returns the iterations used.

    Newton's method; where its step overshoots, the minimum along it is bracketed by the slope.
    """
    start = q.copy()
    limits = relief_limits(start, machine)
    change = np.empty(SIZE)
    evaluate(q, start, target, limits, strength, rolling, x_e, machine, step, sums)
    for iteration in range(MAX_ITERATIONS):
        if np.max(np.abs(sums.gradient)) < TOLERANCE:
            return iteration
        assemble(q, target, limits, rolling, machine, step, sums)
        solve_symmetric(sums.matrix, sums.gradient, change)
        slope = -np.dot(sums.gradient, change)
        low_slope, high_slope = slope, 0.0
        low, high, part = 0.0, 1.0, 1.0
        for attempt in range(MAX_ATTEMPTS):
            if attempt % 2 == 1:
                part = low + (high - low) * low_slope / (low_slope - high_slope)
            elif attempt:
                part = 0.5 * (low + high)
            evaluate(q - part * change, start, target, limits, strength, rolling, x_e, machine, step, sums)
            here = -np.dot(sums.gradient, change)
            if abs(here) <= -FLAT * slope or (here < 0.0 and part == 1.0):
                break
            if here > 0.0:
                high, high_slope = part, here
            else:
                low, low_slope = part, here
        q -= part * change
    return MAX_ITERATIONS


@compiled
def relief_limits(q: FloatArray, machine: Machine) -> FloatArray:
    """Lowest and highest thrust of each motor (2, 2), N: a driven motor holds more than it can drive."""
    limits = np.empty((2, 2))
    for k in range(2):
        speed = q[3 + k] / machine.slip_floor
        more = machine.brake_limit - machine.drive_limit
        limits[k, 0] = -machine.drive_limit - more * min(max(speed, 0.0), 1.0)
        limits[k, 1] = machine.drive_limit + more * min(max(-speed, 0.0), 1.0)
    return limits
