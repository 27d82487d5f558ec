# SPDX-License-Identifier: Apache-2.0
"""Truth mode ``shear``: the vehicle driven over ground that shears, step by step, compiled.

Commanded sprocket speeds are limited by the pumps' flow, lag in the valves, and yield at relief pressure;
shear displacement integrates along each track's contact (Wong & Chiang 2001). See ``contact``, ``motion``.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import thrust_of_pressure
from trackslip_sim.truth.contact import (
    Shear,
    Tracks,
    carry,
    element_positions,
    find_soils,
    limit_shear,
    mobilise,
    unsheared,
)
from trackslip_sim.truth.ground import Ground, SoilMap, soil_at
from trackslip_sim.truth.lag import Valves, spools, valves_of
from trackslip_sim.truth.motion import MAX_ITERATIONS, SIZE, Machine, Newton, new_step, solve_step
from trackslip_sim.truth.pose import move
from trackslip_sim.truth.record import FloatArray
from trackslip_sim.truth.rows import WIDTH, Column, refuse_unsolved, start_row
from trackslip_sim.truth.settings import TruthSettings


class Model(NamedTuple):
    """What does not change during a run."""

    machine: Machine
    tracks: Tracks
    ground: SoilMap
    valves: Valves
    every: int  # steps between two rows


class State(NamedTuple):
    """What goes on from step to step."""

    pose: FloatArray  # (3,) x, y, yaw
    q: FloatArray  # (5,) as in ``motion``
    before: FloatArray  # (5,) q of the step before
    angle: FloatArray  # (2,) rad, of the sprockets
    spool: FloatArray  # (2,) -1 … 1
    shear: Shear
    newton: Newton


@compiled
def turn_axes(q: FloatArray, step: float) -> None:
    """Express the hull's velocity in the body axes at the end of the step (the m φ̇ v terms)."""
    cos, sin = math.cos(q[2] * step), math.sin(q[2] * step)
    q[0], q[1] = cos * q[0] + sin * q[1], cos * q[1] - sin * q[0]


@compiled
def write_row(row: FloatArray, model: Model, state: State, iterations: int) -> None:
    """Fill one row, still all zero."""
    q, force = state.q, state.newton.sums.force
    for i in range(3):
        row[Column.X + i], row[Column.V_X + i] = state.pose[i], q[i]
    row[Column.SOIL] = soil_at(state.pose[0], state.pose[1], model.ground)
    row[Column.MOMENT] = force[0, 2] + force[1, 2]
    row[Column.ITERATIONS] = iterations
    for k in range(2):
        row[Column.TRACK_SPEED + k], row[Column.ANGLE + k] = q[3 + k], state.angle[k]
        row[Column.SPOOL + k], row[Column.DRIVE + k] = state.spool[k], state.newton.drive[k]
        v = q[0] - q[2] * model.tracks.half_tread * (1.0 - 2.0 * k)
        thrust = -force[k, 0]
        resistance = state.newton.rolling[k] * v / math.sqrt(v * v + model.machine.rolling_floor**2)
        row[Column.THRUST + k], row[Column.RESISTANCE + k] = thrust, resistance
        row[Column.POWER] += thrust * q[3 + k]
        row[Column.LOSS] += (q[3 + k] - v) * thrust + q[1] * force[k, 1] + q[2] * force[k, 2]
        row[Column.LOSS] += resistance * v


@compiled
def integrate(spool: FloatArray, model: Model, state: State) -> FloatArray:
    """Drive on under spools (1 + steps, 2); rows (steps // every, WIDTH) after each ``every`` steps."""
    tracks, newton, q = model.tracks, state.newton, state.q
    step, radius = model.machine.step, model.valves.radius
    rows = np.zeros(((len(spool) - 1) // model.every, WIDTH))
    worst = 0
    for i in range(len(spool) - 1):
        find_soils(state.pose, tracks, model.ground, state.shear)
        mobilise(state.shear, tracks, model.ground)
        for k in range(2):
            state.spool[k] = spool[i + 1, k]
            newton.target[k] = spool[i + 1, k] * model.valves.top_speed * radius
            newton.rolling[k] = 0.0
            for e in range(len(tracks.x_e)):
                newton.rolling[k] += model.ground.table[state.shear.soil[k, e], 3] * tracks.load[k, e]  # μ_r
        for n in range(SIZE):
            state.before[n] = q[n]
        turn_axes(q, step)
        worst = max(worst, solve_step(q, model.machine, tracks, state.shear, newton))
        carry(state.shear, q, tracks, step)
        limit_shear(state.shear, model.ground)
        move(state.pose, state.before, q, step)
        for k in range(2):
            state.angle[k] += 0.5 * step * (state.before[3 + k] + q[3 + k]) / radius
        if (i + 1) % model.every == 0:
            write_row(rows[(i + 1) // model.every - 1], model, state, worst)
            worst = 0
    return rows


class ShearDrive:
    """A machine at rest at the origin, to be driven on piece by piece.

    Raises:
        InputError: the load leaves a track, or its front or rear, without ground pressure.
    """

    def __init__(
        self, ground: Ground, vehicle: Vehicle, settings: TruthSettings, relief_pressure: float
    ) -> None:
        _check_load(vehicle, settings)
        self.relief_pressure = relief_pressure
        self._model = Model(
            _machine(vehicle, settings, relief_pressure),
            _tracks(vehicle, settings),
            ground.map,
            valves_of(vehicle, settings),
            settings.steps_per_sample,
        )
        still = (np.zeros(3), np.zeros(SIZE), np.zeros(SIZE), np.zeros(2), np.zeros(2))
        self._state = State(*still, unsheared(settings.elements), new_step())

    def first(self) -> FloatArray:
        """The row (1, WIDTH) at the start."""
        return start_row(self._model.ground)

    def drive(self, commands: FloatArray) -> FloatArray:
        """Rows (n // steps_per_sample, WIDTH) under further commands (n, 2), rad/s.

        Raises:
            UnsolvedStepError: see there.
        """
        commands = np.ascontiguousarray(commands, dtype=np.float64)
        spool = spools(commands, self._model.valves, self._state.spool)
        rows: FloatArray = integrate(spool, self._model, self._state)
        refuse_unsolved(rows, MAX_ITERATIONS)
        return rows


def _tracks(vehicle: Vehicle, settings: TruthSettings) -> Tracks:
    """Weight is linear along the track, and split between the tracks by moments."""
    length, n = vehicle.contact_length, settings.elements
    x_e = element_positions(length, n)
    along = (1.0 + 12.0 * settings.load_x * x_e / length**2) / n
    offset = settings.load_y / vehicle.tread
    split = np.array([0.5 + offset, 0.5 - offset])
    load = vehicle.weight * split[:, None] * along[None, :]
    return Tracks(x_e, load, length * vehicle.track_width / n, 0.5 * vehicle.tread)


def _machine(vehicle: Vehicle, settings: TruthSettings, relief_pressure: float) -> Machine:
    limit = float(thrust_of_pressure(relief_pressure, 1.0, vehicle))
    return Machine(
        step=settings.step,
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        track_mass=settings.track_mass,
        drive_limit=limit,
        brake_limit=limit / vehicle.motor_efficiency**2,
        drive_stiffness=limit / settings.drive_sag,
        sliding_floor=settings.sliding_floor,
        rolling_floor=settings.rolling_floor,
        slip_floor=settings.slip_floor,
    )


def _check_load(vehicle: Vehicle, settings: TruthSettings) -> None:
    for name, value, limit in (
        ("load_x", settings.load_x, vehicle.contact_length / 6),
        ("load_y", settings.load_y, vehicle.tread / 2),
    ):
        if not abs(value) < limit:
            raise InputError(
                f"TruthSettings.{name}: {value!r} m lifts part of a track; accepted: within ±{limit:.4g} m"
            )
