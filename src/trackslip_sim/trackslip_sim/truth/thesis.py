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
from trackslip_sim.truth.lag import Valves, spools, valves_of
from trackslip_sim.truth.pose import move
from trackslip_sim.truth.rows import WIDTH, Column, refuse_unsolved, start_row
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
    every: int  # steps between two rows


class Balance(NamedTuple):
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
    step: Balance


@compiled
def balance(q: FloatArray, body: Body, at: Balance) -> None:
    """Fill the forces, their slopes, thrusts, resistances and moment at q."""
    h, start, soil, force, slope = body.half_tread, at.start, at.soil, at.force, at.slope
    inertia = body.yaw_inertia / h
    force[0], force[1] = body.mass * (q[0] - start[0]) / body.step, inertia * (q[2] - start[2]) / body.step
    slope[0], slope[1], slope[2] = body.mass / body.step, 0.0, inertia / body.step
    for k in range(2):
        side = 1.0 - 2.0 * k
        v = q[0] - side * h * q[2]
        reach = body.length / (max(abs(at.u[k]), body.slip_floor) * soil[1])  # i l/K of one m/s of sliding
        x = (at.u[k] - v) * reach
        size = abs(x)
        if size < 1e-4:
            share, bend = 0.5 * size, 0.5 - size / 3.0
        else:
            share = 1.0 + math.expm1(-size) / size
            bend = (1.0 - share - math.exp(-size)) / size
        rho = math.sqrt(v * v + body.rolling_floor**2)
        limit = 0.5 * soil[2] * body.weight
        at.thrust[k] = math.copysign(soil[0] * share, x)
        at.resistance[k] = limit * v / rho
        steep = soil[0] * bend * reach + limit * body.rolling_floor**2 / rho**3
        force[0] += at.resistance[k] - at.thrust[k]
        force[1] -= side * (at.resistance[k] - at.thrust[k])
        slope[0] += steep
        slope[1] -= side * steep
        slope[2] += h * steep
    moment = soil[3] * body.weight * body.length / 3.0
    tightness = q[2] * h / max(abs(start[0]), body.slip_floor)
    at.moment[0] = moment * min(max(tightness, -1.0), 1.0)
    force[1] += at.moment[0] / h
    if abs(tightness) < 1.0:
        slope[2] += moment / max(abs(start[0]), body.slip_floor)


@compiled
def solve(q: FloatArray, body: Body, at: Balance) -> int:
    """Advance q by one implicit step: Newton's, halved until the residual falls; returns the iterations."""
    trial = at.trial
    for i in range(3):
        at.start[i] = trial[i] = q[i]
    balance(q, body, at)
    for iteration in range(MAX_ITERATIONS):
        force, moment = at.force[0], at.force[1]
        left_over = math.hypot(force, moment)
        if left_over < TOLERANCE:
            return iteration
        a, b, c, d = at.slope[0], body.half_tread * at.slope[1], at.slope[1], at.slope[2]
        scale = a * d - b * c
        dv, dw = (d * force - b * moment) / scale, (a * moment - c * force) / scale
        part = 1.0
        for _ in range(MAX_HALVINGS):
            trial[0], trial[2] = q[0] - part * dv, q[2] - part * dw
            balance(trial, body, at)
            if math.hypot(at.force[0], at.force[1]) < left_over:
                break
            part *= 0.5
        for i in range(3):
            q[i] = trial[i]
    return MAX_ITERATIONS


@compiled
def write_row(row: FloatArray, state: State, body: Body, counts: tuple[int, int]) -> None:
    """Fill one row; ``counts`` are the soil's index and the iterations."""
    q, at = state.q, state.step
    for i in range(3):
        row[Column.X + i], row[Column.V_X + i] = state.pose[i], q[i]
    for k in range(2):
        row[Column.TRACK_SPEED + k], row[Column.ANGLE + k] = at.u[k], state.angle[k]
        row[Column.THRUST + k], row[Column.DRIVE + k] = at.thrust[k], at.thrust[k]
        row[Column.RESISTANCE + k], row[Column.SPOOL + k] = at.resistance[k], state.spool[k]
        row[Column.LOAD + k] = 0.5 * body.weight
    row[Column.MOMENT] = at.moment[0]
    power = at.thrust[0] * at.u[0] + at.thrust[1] * at.u[1]
    left, right = at.thrust[0] - at.resistance[0], at.thrust[1] - at.resistance[1]
    gain = q[0] * (left + right) + q[2] * (body.half_tread * (right - left) - at.moment[0])
    row[Column.POWER], row[Column.LOSS] = power, power - gain
    row[Column.SOIL], row[Column.ITERATIONS] = counts


@compiled
def integrate(spool: FloatArray, model: Model, state: State) -> FloatArray:
    """Advance under spools (1 + steps, 2); rows (steps // every, WIDTH) after each ``every`` steps."""
    body, q, at = model.body, state.q, state.step
    top = model.valves.top_speed * model.valves.radius
    before = np.zeros(3)
    rows = np.zeros(((len(spool) - 1) // model.every, WIDTH))
    worst = 0
    for i in range(1, len(spool)):
        here = soil_at(state.pose[0], state.pose[1], model.ground)
        for n in range(3):
            before[n] = q[n]
        for n in range(4):
            at.soil[n] = model.ground.table[here, n]
        for k in range(2):
            at.u[k], state.spool[k] = spool[i, k] * top, spool[i, k]
        worst = max(worst, solve(q, body, at))
        # tan α = -sign(φ̇) φ̇² l/(4 g μ_l), erratum 6
        q[1] = -q[0] * q[2] * abs(q[2]) * body.length * body.mass / (4.0 * body.weight * at.soil[3])
        move(state.pose, before, q, model.terrain, body.step)
        for k in range(2):
            state.angle[k] += 0.5 * body.step * (spool[i - 1, k] + spool[i, k]) * top / model.valves.radius
        if i % model.every == 0:
            write_row(rows[i // model.every - 1], state, body, (here, worst))
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
            raise InputError(f"terrain '{ground.terrain.name}': mode thesis knows none; accepted: mode shear")
        self.relief_pressure = vehicle.relief_pressure
        self._model = Model(
            _body(vehicle, settings),
            ground.map._replace(table=_table(ground, vehicle)),
            FLAT.map,
            valves_of(vehicle, settings),
            settings.steps_per_sample,
        )
        self._weight = vehicle.weight
        work = Balance(*(np.zeros(size) for size in (3, 3, 2, 4, 2, 3, 2, 2, 1)))
        self._state = State(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(2), work)

    def first(self) -> FloatArray:
        """The row (1, WIDTH) at the start."""
        return start_row(self._model.ground, self._weight)

    def drive(self, commands: FloatArray, burden: FloatArray | None = None) -> FloatArray:
        """Rows (n // steps_per_sample, WIDTH) under further commands (n, 2), rad/s; ``burden`` is ignored.

        Raises:
            UnsolvedStepError: the solver did not balance a step.
        """
        del burden
        spool = spools(commands, self._model.valves, self._state.spool)
        rows: FloatArray = integrate(spool, self._model, self._state)
        refuse_unsolved(rows, MAX_ITERATIONS)
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
