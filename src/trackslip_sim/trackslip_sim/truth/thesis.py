# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Truth mode ``thesis``: the forward simulation of §6.2.1 with the free body of (3.24).

    v, φ̇      speed of C along x, yaw rate                            m/s, rad/s
    u_j       track speed r ω_j, an input: unlimited motor power       m/s
    F_j       thrust from slip, (3.3)                                  N
    R_j       rolling resistance ½ μ_r W sign v_j                      N
    M_r       turning moment μ W l/3 (3.8); μ: mobilised part of μ_l   N m

    m v̇ = F_L + F_R - R_L - R_R          I_z φ̈ = ½ B [(F_R - R_R) - (F_L - R_L)] - M_r sign φ̇

With all of μ_l mobilised no soil of Table 6.1 carries the thrust of a turn. The mobilised part is therefore
μ = μ_l min(1, B/(2 R)). It is all of μ_l at R <= B/2, where in the thesis (§3.3.1) both tracks begin to
share the moment. The lateral velocity follows from the slip angle (3.13).
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.strength import thrust_limit
from trackslip_sim.truth.ground import Ground, SoilMap, soil_at
from trackslip_sim.truth.lag import Valves, spool_positions, valves_of
from trackslip_sim.truth.pose import advance_pose
from trackslip_sim.truth.rows import WIDTH, Column, require_solved
from trackslip_sim.truth.settings import TruthSettings
from trackslip_sim.truth.terrain import FLAT, TerrainMap

TOLERANCE = 1e-6  # N, largest unbalanced force; moments are divided by half the tread
MAX_ITERATIONS = 50
MAX_HALVINGS = 30


class Body(NamedTuple):
    """Numbers of the vehicle as the kernel needs them; SI units."""

    step: float
    mass: float
    yaw_inertia: float
    half_tread: float
    length: float
    weight: float
    rolling_floor: float
    slip_floor: float


class Model(NamedTuple):
    """Constants of a run; the ground's table holds F_max N, K m, μ_r, μ_l of each soil."""

    body: Body
    ground: SoilMap
    terrain: TerrainMap
    valves: Valves
    steps_per_row: int  # steps between two rows


class ForceBalance(NamedTuple):
    """Input of one step, and the forces at the velocity evaluated last."""

    start: FloatArray  # (3,) q before the step
    trial: FloatArray  # (3,) q evaluated last
    u: FloatArray  # (2,) m/s
    soil: FloatArray  # (4,) F_max, K, μ_r, μ_l
    force: FloatArray  # (2,) unbalanced force, and moment over ½ B
    slope: FloatArray  # (3,) ∂force/∂v_x, ∂force/∂φ̇ over ½ B, ∂(moment over ½ B)/∂φ̇
    thrust: FloatArray  # (2,)
    resistance: FloatArray  # (2,)
    moment: FloatArray  # (1,) turning moment


class State(NamedTuple):
    """State carried from step to step."""

    pose: FloatArray  # (3,) x, y, yaw
    q: FloatArray  # (3,) v_x, v_y, φ̇
    angle: FloatArray  # (2,) rad, of the sprockets
    spool: FloatArray  # (2,) -1 … 1
    balance: ForceBalance


@compiled
def evaluate_forces(q: FloatArray, body: Body, balance: ForceBalance) -> None:
    """Fill the forces, their slopes, thrusts, resistances and moment at q."""
    h, start, soil, force, slope = body.half_tread, balance.start, balance.soil, balance.force, balance.slope
    inertia = body.yaw_inertia / h
    force[0], force[1] = body.mass * (q[0] - start[0]) / body.step, inertia * (q[2] - start[2]) / body.step
    slope[0], slope[1], slope[2] = body.mass / body.step, 0.0, inertia / body.step
    for k in range(2):
        side = 1.0 - 2.0 * k
        v = q[0] - side * h * q[2]
        # i l/K of one m/s of sliding
        slip_gain = body.length / (max(abs(balance.u[k]), body.slip_floor) * soil[1])
        x = (balance.u[k] - v) * slip_gain
        size = abs(x)
        if size < 1e-4:
            share, bend = 0.5 * size, 0.5 - size / 3.0
        else:
            share = 1.0 + math.expm1(-size) / size
            bend = (1.0 - share - math.exp(-size)) / size
        rho = math.sqrt(v * v + body.rolling_floor**2)
        limit = 0.5 * soil[2] * body.weight
        balance.thrust[k] = math.copysign(soil[0] * share, x)
        balance.resistance[k] = limit * v / rho
        force_slope = soil[0] * bend * slip_gain + limit * body.rolling_floor**2 / rho**3
        force[0] += balance.resistance[k] - balance.thrust[k]
        force[1] -= side * (balance.resistance[k] - balance.thrust[k])
        slope[0] += force_slope
        slope[1] -= side * force_slope
        slope[2] += h * force_slope
    moment = soil[3] * body.weight * body.length / 3.0
    tightness = q[2] * h / max(abs(start[0]), body.slip_floor)
    balance.moment[0] = moment * min(max(tightness, -1.0), 1.0)
    force[1] += balance.moment[0] / h
    if abs(tightness) < 1.0:
        slope[2] += moment / max(abs(start[0]), body.slip_floor)


@compiled
def solve_step(q: FloatArray, body: Body, balance: ForceBalance) -> int:
    """Advance q by one implicit step: Newton's, halved until the residual falls; returns the iterations."""
    trial = balance.trial
    for i in range(3):
        balance.start[i] = trial[i] = q[i]
    evaluate_forces(q, body, balance)
    for iteration in range(MAX_ITERATIONS):
        force, moment = balance.force[0], balance.force[1]
        residual = math.hypot(force, moment)
        if residual < TOLERANCE:
            return iteration
        a, b, c, d = balance.slope[0], body.half_tread * balance.slope[1], balance.slope[1], balance.slope[2]
        scale = a * d - b * c
        dv, dw = (d * force - b * moment) / scale, (a * moment - c * force) / scale
        part = 1.0
        for _ in range(MAX_HALVINGS):
            trial[0], trial[2] = q[0] - part * dv, q[2] - part * dw
            evaluate_forces(trial, body, balance)
            if math.hypot(balance.force[0], balance.force[1]) < residual:
                break
            part *= 0.5
        for i in range(3):
            q[i] = trial[i]
    return MAX_ITERATIONS


@compiled
def write_row(row: FloatArray, state: State, body: Body, counts: tuple[int, int]) -> None:
    """Fill one row; ``counts`` are the soil's index and the iterations."""
    q, balance = state.q, state.balance
    for i in range(3):
        row[Column.X + i], row[Column.V_X + i] = state.pose[i], q[i]
    for k in range(2):
        row[Column.TRACK_SPEED + k], row[Column.ANGLE + k] = balance.u[k], state.angle[k]
        row[Column.THRUST + k], row[Column.DRIVE + k] = balance.thrust[k], balance.thrust[k]
        row[Column.RESISTANCE + k], row[Column.SPOOL + k] = balance.resistance[k], state.spool[k]
        row[Column.LOAD + k] = 0.5 * body.weight
    row[Column.MOMENT] = balance.moment[0]
    power = balance.thrust[0] * balance.u[0] + balance.thrust[1] * balance.u[1]
    left, right = balance.thrust[0] - balance.resistance[0], balance.thrust[1] - balance.resistance[1]
    gain = q[0] * (left + right) + q[2] * (body.half_tread * (right - left) - balance.moment[0])
    row[Column.POWER], row[Column.LOSS] = power, power - gain
    row[Column.SOIL], row[Column.ITERATIONS] = counts


@compiled
def integrate(spool: FloatArray, model: Model, state: State) -> FloatArray:
    """Advance under spools (1 + steps, 2); a row (WIDTH,) after each ``steps_per_row`` steps."""
    body, q, balance = model.body, state.q, state.balance
    top_speed = model.valves.top_speed * model.valves.radius
    before = np.zeros(3)
    rows = np.zeros(((len(spool) - 1) // model.steps_per_row, WIDTH))
    worst = 0
    for i in range(1, len(spool)):
        soil = soil_at(state.pose[0], state.pose[1], model.ground)
        for n in range(3):
            before[n] = q[n]
        for n in range(4):
            balance.soil[n] = model.ground.table[soil, n]
        for k in range(2):
            balance.u[k], state.spool[k] = spool[i, k] * top_speed, spool[i, k]
        worst = max(worst, solve_step(q, body, balance))
        # tan α = -sign(φ̇) φ̇² l/(4 g μ_l), erratum 6
        q[1] = -q[0] * q[2] * abs(q[2]) * body.length * body.mass / (4.0 * body.weight * balance.soil[3])
        advance_pose(state.pose, before, q, model.terrain, body.step)
        for k in range(2):
            state.angle[k] += (
                0.5 * body.step * (spool[i - 1, k] + spool[i, k]) * top_speed / model.valves.radius
            )
        if i % model.steps_per_row == 0:
            write_row(rows[i // model.steps_per_row - 1], state, body, (soil, worst))
            worst = 0
    return rows


class ThesisDrive:
    """A machine that starts at rest at the origin, driven piece by piece; relief pressure has no effect.

    Raises:
        InputError: a soil lacks μ_l, or the ground is not flat.
    """

    def __init__(
        self, ground: Ground, vehicle: Vehicle, settings: TruthSettings, relief_pressure: float
    ) -> None:
        del relief_pressure
        if ground.terrain != FLAT:
            raise InputError(
                f"terrain '{ground.terrain.name}': mode thesis requires flat ground; accepted: mode shear"
            )
        self.relief_pressure = vehicle.relief_pressure
        self._model = Model(
            _body(vehicle, settings),
            ground.map._replace(table=_table(ground, vehicle)),
            FLAT.map,
            valves_of(vehicle, settings),
            settings.steps_per_sample,
        )
        work = ForceBalance(*(np.zeros(size) for size in (3, 3, 2, 4, 2, 3, 2, 2, 1)))
        self._state = State(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(2), work)

    def first_row(self) -> FloatArray:
        """The row (1, WIDTH) at the start."""
        row = np.zeros((1, WIDTH))
        row[0, Column.SOIL] = soil_at(0.0, 0.0, self._model.ground)
        row[0, Column.LOAD : Column.LOAD + 2] = 0.5 * self._model.body.weight
        return row

    def drive(self, commands: FloatArray, mass_properties: FloatArray | None = None) -> FloatArray:
        """Rows (n // steps_per_sample, WIDTH) under further commands (n, 2), rad/s; loads are ignored.

        Raises:
            UnsolvedStepError: the solver did not balance a step.
        """
        del mass_properties
        spool = spool_positions(commands, self._model.valves, self._state.spool)
        rows: FloatArray = integrate(spool, self._model, self._state)
        require_solved(rows, MAX_ITERATIONS)
        return rows


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
        step=settings.step,
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        half_tread=0.5 * vehicle.tread,
        length=vehicle.contact_length,
        weight=vehicle.weight,
        rolling_floor=settings.rolling_floor,
        slip_floor=settings.slip_floor,
    )
