# SPDX-License-Identifier: Apache-2.0
"""Truth mode ``thesis``: the forward simulation of §6.2.1, on the free body of (3.24).

    v, φ̇      speed of C along x, yaw rate                            m/s, rad/s
    u_j       track speed r ω_j, given: the motors have all the power  m/s
    F_j       thrust by slip, (3.3)                                    N
    R_j       rolling resistance ½ μ_r W sign v_j                      N
    M_r       turning moment μ W l/3 (3.8), μ the mobilised part of μ_l N m

    m v̇ = F_L + F_R - R_L - R_R          I_z φ̈ = ½ B [(F_R - R_R) - (F_L - R_L)] - M_r sign φ̇

With all of μ_l mobilised no soil of Table 6.1 carries the thrust of a turn. So it is mobilised in proportion to
the tightness of the turn, μ = μ_l min(1, B/(2 R)): whole from R = B/2 on, the radius from which on the thesis
(§3.3.1) has both tracks share the moment. The lateral motion is the slip angle's, (3.13).
"""

import math
from typing import NamedTuple

import numpy as np
from trackslip_estimation.terramechanics.strength import thrust_limit
from trackslip_estimation.vehicle import GRAVITY, Vehicle

from trackslip_sim.scenarios import Scenario
from trackslip_sim.truth.compiled import compiled
from trackslip_sim.truth.ground import Ground, soil_at
from trackslip_sim.truth.lag import kept_error, spools, top_speed
from trackslip_sim.truth.record import FloatArray, IntArray, Truth
from trackslip_sim.truth.rows import WIDTH, to_truth
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
    q: FloatArray, start: FloatArray, u: FloatArray, soil: FloatArray, body: Body, step: float, out: FloatArray
) -> None:
    """Fill ``out`` at q = (v, φ̇): what is unbalanced (force; moment over half the tread), its derivatives
    (xx, xz, zz), the thrusts, the resistances, the moment. ``soil`` is F_max, K, μ_r, μ_l."""
    h = body.half_tread
    inertia = body.yaw_inertia / h
    out[0], out[1] = body.mass * (q[0] - start[0]) / step, inertia * (q[1] - start[1]) / step
    out[2], out[3], out[4] = body.mass / step, 0.0, inertia / step
    for k in range(2):
        side = 1.0 - 2.0 * k
        v = q[0] - side * h * q[1]
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
    tightness = q[1] * h / max(abs(start[0]), body.slip_floor)
    out[9] = moment * min(max(tightness, -1.0), 1.0)
    out[1] += out[9] / h
    if abs(tightness) < 1.0:
        out[4] += moment / max(abs(start[0]), body.slip_floor)


@compiled
def solve(
    q: FloatArray, u: FloatArray, soil: FloatArray, body: Body, step: float, out: FloatArray
) -> int:
    """Advance q = (v, φ̇) by one implicit step (Newton, halved until less is unbalanced); the iterations used."""
    start, trial = q.copy(), q.copy()
    balance(q, start, u, soil, body, step, out)
    for iteration in range(MAX_ITERATIONS):
        left_over = math.hypot(out[0], out[1])
        if left_over < TOLERANCE:
            return iteration
        # rows: force by (v, φ̇); moment/h by (v, φ̇)
        a, b, c, d = out[2], body.half_tread * out[3], out[3], out[4]
        scale = a * d - b * c
        dv, dw = (d * out[0] - b * out[1]) / scale, (a * out[1] - c * out[0]) / scale
        part = 1.0
        for _ in range(MAX_HALVINGS):
            trial[0], trial[1] = q[0] - part * dv, q[1] - part * dw
            balance(trial, start, u, soil, body, step, out)
            if math.hypot(out[0], out[1]) < left_over:
                break
            part *= 0.5
        q[:] = trial
    return MAX_ITERATIONS


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
    """Rows (n, WIDTH) from rest at the origin under spools (1 + steps, 2); ``table`` rows as in ``balance``."""
    q, pose, angle, out = np.zeros(2), np.zeros(3), np.zeros(2), np.zeros(10)
    v_y = 0.0
    rows = np.zeros((1 + (len(spool) - 1) // every, WIDTH))
    rows[0, 17] = soil_at(0.0, 0.0, edges, patch_soil)
    for i in range(1, len(spool)):
        here = soil_at(pose[0], pose[1], edges, patch_soil)
        before, v_y_before = q.copy(), v_y
        iterations = solve(q, spool[i] * top_track_speed, table[here], body, step, out)
        # tan α = -sign(φ̇) φ̇² l/(4 g μ_l), erratum 6
        v_y = -q[0] * q[1] * abs(q[1]) * body.length / (4.0 * body.weight / body.mass * table[here, 3])
        turn = 0.5 * step * (before[1] + q[1])
        cos, sin = math.cos(pose[2] + 0.5 * turn), math.sin(pose[2] + 0.5 * turn)
        forward, left = 0.5 * step * (before[0] + q[0]), 0.5 * step * (v_y_before + v_y)
        pose[0] += cos * forward - sin * left
        pose[1] += sin * forward + cos * left
        pose[2] += turn
        angle += 0.5 * step * (spool[i - 1] + spool[i]) * top_track_speed / radius
        if i % every == 0:
            row = rows[i // every]
            row[0:3] = pose
            row[3], row[4], row[5] = q[0], v_y, q[1]
            row[6:8] = spool[i] * top_track_speed
            row[8:10] = angle
            row[10:14] = out[5:9]
            row[14] = out[9]
            row[15:17] = spool[i]
            row[17] = here
            row[18] = np.dot(row[10:12], row[6:8])
            row[19] = row[18] - q[0] * (out[5] + out[6] - out[7] - out[8])
            row[19] -= q[1] * (body.half_tread * (out[6] - out[8] - out[5] + out[7]) - out[9])
            row[20] = iterations
            row[21:23] = row[10:12]
    return rows


def simulate(scenario: Scenario, ground: Ground, vehicle: Vehicle, settings: TruthSettings) -> Truth:
    """Mode ``thesis`` of ``truth.simulate``; relief pressure plays no part in it.

    Raises:
        InputError: a soil lacks μ_l.
    """
    area = 2.0 * vehicle.track_width * vehicle.contact_length
    table = np.array(
        [
            [
                thrust_limit(soil.cohesion, soil.friction_angle, area, vehicle.weight),
                soil.value("shear_modulus"),
                soil.value("mu_r"),
                soil.value("mu_l"),
            ]
            for soil in ground.soils
        ]
    )
    body = Body(
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        half_tread=0.5 * vehicle.tread,
        length=vehicle.contact_length,
        weight=vehicle.weight,
        rolling_floor=settings.rolling_floor,
        slip_floor=settings.slip_floor,
    )
    top = top_speed(vehicle)
    rows = integrate(
        spools(scenario.commands(settings.step), top, kept_error(settings)),
        settings.steps_per_sample,
        settings.step,
        top * vehicle.rolling_radius,
        vehicle.rolling_radius,
        table,
        ground.edges,
        ground.patch_soil,
        body,
    )
    return to_truth(rows, ground.names, vehicle, settings, vehicle.relief_pressure)
