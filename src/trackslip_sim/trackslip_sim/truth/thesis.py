# SPDX-License-Identifier: Apache-2.0
"""Truth mode ``thesis``: the forward simulation of §6.2.1, on the free body of (3.24).

    v, φ̇      speed of C along x, yaw rate                            m/s, rad/s
    u_j       track speed r ω_j, given: the motors have all the power  m/s
    F_j       thrust by slip, (3.3)                                    N
    R_j       rolling resistance ½ μ_r W sign v_j                      N
    M_r       turning moment μ W l/3 (3.8), μ the mobilised part of μ_l N m

    m v̇ = F_L + F_R - R_L - R_R          I_z φ̈ = ½ B [(F_R - R_R) - (F_L - R_L)] - M_r sign φ̇

With all of μ_l mobilised no soil of Table 6.1 carries the thrust of a turn. So it is mobilised in proportion
to the tightness of the turn, μ = μ_l min(1, B/(2 R)): whole at R <= B/2, where the thesis (§3.3.1) begins to
have both tracks share the moment. The lateral motion is the slip angle's, (3.13).
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.strength import thrust_limit
from trackslip_sim.scenarios.scenario import Scenario
from trackslip_sim.truth.ground import Ground, soil_at
from trackslip_sim.truth.lag import kept_error, spools, top_speed
from trackslip_sim.truth.pose import move
from trackslip_sim.truth.record import FloatArray, IntArray, Truth
from trackslip_sim.truth.rows import WIDTH, Column, refuse_unsolved, to_truth
from trackslip_sim.truth.settings import TruthSettings

TOLERANCE = 1e-6  # N left unbalanced, moments over half the tread
MAX_ITERATIONS = 50
MAX_HALVINGS = 30


class Body(NamedTuple):
    """Numbers of the vehicle as the kernel needs them; SI units."""

    mass: float
    yaw_inertia: float
    half_tread: float
    length: float
    weight: float
    rolling_floor: float
    slip_floor: float


@compiled
def balance(
    q: FloatArray,
    start: FloatArray,
    u: FloatArray,
    soil: FloatArray,
    body: Body,
    step: float,
    out: FloatArray,
) -> None:
    """Fill ``out`` at q = (v_x, v_y, φ̇); ``soil`` is F_max, K, μ_r, μ_l.

    0, 1: unbalanced force, and moment over ½ B. 2, 3: derivatives of the force by v_x, and over ½ B by φ̇.
    4: of the moment's share by φ̇. 5, 6: thrusts. 7, 8: resistances. 9: turning moment.
    """
    h = body.half_tread
    inertia = body.yaw_inertia / h
    out[0], out[1] = body.mass * (q[0] - start[0]) / step, inertia * (q[2] - start[2]) / step
    out[2], out[3], out[4] = body.mass / step, 0.0, inertia / step
    for k in range(2):
        side = 1.0 - 2.0 * k
        v = q[0] - side * h * q[2]
        reach = body.length / (max(abs(u[k]), body.slip_floor) * soil[1])  # of one m/s, in i l/K
        x = (u[k] - v) * reach
        size = abs(x)
        if size < 1e-4:
            share, slope = 0.5 * size, 0.5 - size / 3.0
        else:
            share = 1.0 + math.expm1(-size) / size
            slope = (1.0 - share - math.exp(-size)) / size
        rho = math.sqrt(v * v + body.rolling_floor**2)
        limit = 0.5 * soil[2] * body.weight
        out[5 + k] = math.copysign(soil[0] * share, x)
        out[7 + k] = limit * v / rho
        bend = soil[0] * slope * reach + limit * body.rolling_floor**2 / rho**3
        out[0] += out[7 + k] - out[5 + k]
        out[1] -= side * (out[7 + k] - out[5 + k])
        out[2] += bend
        out[3] -= side * bend
        out[4] += h * bend
    moment = soil[3] * body.weight * body.length / 3.0
    tightness = q[2] * h / max(abs(start[0]), body.slip_floor)
    out[9] = moment * min(max(tightness, -1.0), 1.0)
    out[1] += out[9] / h
    if abs(tightness) < 1.0:
        out[4] += moment / max(abs(start[0]), body.slip_floor)


@compiled
def solve(q: FloatArray, u: FloatArray, soil: FloatArray, body: Body, step: float, out: FloatArray) -> int:
    """Advance q by one implicit step: Newton's, halved until less is unbalanced; returns the iterations."""
    start, trial = q.copy(), q.copy()
    balance(q, start, u, soil, body, step, out)
    for iteration in range(MAX_ITERATIONS):
        left_over = math.hypot(out[0], out[1])
        if left_over < TOLERANCE:
            return iteration
        a, b, c, d = out[2], body.half_tread * out[3], out[3], out[4]
        scale = a * d - b * c
        dv, dw = (d * out[0] - b * out[1]) / scale, (a * out[1] - c * out[0]) / scale
        part = 1.0
        for _ in range(MAX_HALVINGS):
            trial[0], trial[2] = q[0] - part * dv, q[2] - part * dw
            balance(trial, start, u, soil, body, step, out)
            if math.hypot(out[0], out[1]) < left_over:
                break
            part *= 0.5
        q[:] = trial
    return MAX_ITERATIONS


@compiled
def write_row(
    row: FloatArray, pose: FloatArray, q: FloatArray, u: FloatArray, out: FloatArray, body: Body
) -> None:
    """Fill one row but for angle, spool, soil and iterations."""
    row[Column.X : Column.V_X] = pose
    row[Column.V_X : Column.TRACK_SPEED] = q
    row[Column.TRACK_SPEED : Column.ANGLE] = u
    row[Column.THRUST : Column.RESISTANCE] = out[5:7]
    row[Column.RESISTANCE : Column.MOMENT] = out[7:9]
    row[Column.MOMENT] = out[9]
    power = np.dot(out[5:7], u)
    left, right = out[5] - out[7], out[6] - out[8]
    gain = q[0] * (left + right) + q[2] * (body.half_tread * (right - left) - out[9])
    row[Column.POWER], row[Column.LOSS] = power, power - gain
    row[Column.DRIVE :] = out[5:7]


@compiled
def integrate(
    spool: FloatArray,
    every: int,
    step: float,
    top_track_speed: float,
    radius: float,
    table: FloatArray,
    edges: FloatArray,
    patch_soil: IntArray,
    body: Body,
) -> FloatArray:
    """Rows (n, WIDTH) from rest at the origin under spools (1 + steps, 2); ``table`` as in ``balance``."""
    q, pose, angle, out = np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(10)
    rows = np.zeros((1 + (len(spool) - 1) // every, WIDTH))
    rows[0, Column.SOIL] = soil_at(0.0, 0.0, edges, patch_soil)
    worst = 0
    for i in range(1, len(spool)):
        here = soil_at(pose[0], pose[1], edges, patch_soil)
        soil, u, before = table[here], spool[i] * top_track_speed, q.copy()
        worst = max(worst, solve(q, u, soil, body, step, out))
        # tan α = -sign(φ̇) φ̇² l/(4 g μ_l), erratum 6
        q[1] = -q[0] * q[2] * abs(q[2]) * body.length * body.mass / (4.0 * body.weight * soil[3])
        move(pose, before, q, step)
        angle += 0.5 * step * (spool[i - 1] + spool[i]) * top_track_speed / radius
        if i % every == 0:
            row = rows[i // every]
            write_row(row, pose, q, u, out, body)
            row[Column.ANGLE : Column.THRUST] = angle
            row[Column.SPOOL : Column.SOIL] = spool[i]
            row[Column.SOIL], row[Column.ITERATIONS], worst = here, worst, 0
    return rows


def simulate(scenario: Scenario, ground: Ground, vehicle: Vehicle, settings: TruthSettings) -> Truth:
    """Mode ``thesis`` of ``truth.simulate``; relief pressure plays no part in it.

    Raises:
        InputError: a soil lacks μ_l.
    """
    top = top_speed(vehicle)
    rows = integrate(
        spools(scenario.commands(settings.step), top, kept_error(settings)),
        settings.steps_per_sample,
        settings.step,
        top * vehicle.rolling_radius,
        vehicle.rolling_radius,
        _table(ground, vehicle),
        ground.edges,
        ground.patch_soil,
        _body(vehicle, settings),
    )
    refuse_unsolved(rows, MAX_ITERATIONS)
    return to_truth(rows, ground.names, vehicle, settings, vehicle.relief_pressure)


def _table(ground: Ground, vehicle: Vehicle) -> FloatArray:
    """F_max N, K m, μ_r, μ_l of each soil (soils, 4)."""
    area = 2.0 * vehicle.track_width * vehicle.contact_length
    rows = [
        [
            thrust_limit(soil.cohesion, soil.friction_angle, area, vehicle.weight),
            soil.value("shear_modulus"),
            soil.value("mu_r"),
            soil.value("mu_l"),
        ]
        for soil in ground.soils
    ]
    return np.array(rows, dtype=np.float64)


def _body(vehicle: Vehicle, settings: TruthSettings) -> Body:
    return Body(
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        half_tread=0.5 * vehicle.tread,
        length=vehicle.contact_length,
        weight=vehicle.weight,
        rolling_floor=settings.rolling_floor,
        slip_floor=settings.slip_floor,
    )
