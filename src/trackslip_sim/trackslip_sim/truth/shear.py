# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Truth mode ``shear``: drives the vehicle over ground that shears, compiled.

The pump flow limits the commanded sprocket speeds, the valves lag, and the tracks slow down at relief
pressure. Shear displacement integrates along each track's contact (Wong & Chiang 2001). On a terrain the
weight has a component along the ground. The position of the weight sets the loads of the contacts. See
``contact``, ``load``, ``motion``.
"""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.elements import element_positions
from trackslip_estimation.terramechanics.hydraulics import thrust_of_pressure
from trackslip_sim.truth.contact import (
    Shear,
    Tracks,
    advect_shear,
    find_soils,
    limit_shear,
    mobilise,
    undisturbed_shear,
)
from trackslip_sim.truth.ground import Ground, SoilMap, soil_at
from trackslip_sim.truth.lag import Valves, spool_positions, valves_of
from trackslip_sim.truth.load import Load, distribute_load, set_normal_force
from trackslip_sim.truth.mass_properties import unloaded_centre
from trackslip_sim.truth.motion import MAX_ITERATIONS, SIZE, TOLERANCE, Machine, Newton, new_step, solve_step
from trackslip_sim.truth.pose import advance_pose, attitude_of, body_rates, pose_rates
from trackslip_sim.truth.rows import WIDTH, Column, require_solved
from trackslip_sim.truth.settings import TruthSettings
from trackslip_sim.truth.terrain import FLAT, Terrain, TerrainMap, shape_at

SETTLING_TIME = 3.0  # s at standstill on a slope before the start: the soil shears until it holds the machine
MIN_RADIUS = 2.0  # contact lengths, least radius of ground that the tangent plane approximates


class Model(NamedTuple):
    """Constants of a run."""

    machine: Machine
    tracks: Tracks
    ground: SoilMap
    terrain: TerrainMap
    valves: Valves
    steps_per_row: int  # steps between two rows


class State(NamedTuple):
    """State carried from step to step."""

    pose: FloatArray  # (3,) x, y, yaw
    q: FloatArray  # (5,) as in ``motion``
    before: FloatArray  # (5,) q of the previous step
    angle: FloatArray  # (2,) rad, of the sprockets
    spool: FloatArray  # (2,) -1 … 1
    shear: Shear
    load: Load
    shape: FloatArray  # (6,) of the ground, work space
    newton: Newton


@compiled
def rotate_velocity(q: FloatArray, step: float) -> None:
    """Express the hull's velocity in the body axes at the end of the step (the m φ̇ v terms)."""
    cos, sin = math.cos(q[2] * step), math.sin(q[2] * step)
    q[0], q[1] = cos * q[0] + sin * q[1], cos * q[1] - sin * q[0]


@compiled
def write_row(row: FloatArray, model: Model, state: State, iterations: int) -> None:
    """Fill one row; it must be all zero before."""
    q, force, shape = state.q, state.newton.sums.force, state.shape
    for i in range(3):
        row[Column.X + i], row[Column.V_X + i] = state.pose[i], q[i]
    yaw = state.pose[2]
    shape_at(state.pose[0], state.pose[1], model.terrain, shape)
    row[Column.Z] = shape[0]
    row[Column.PITCH], row[Column.ROLL] = attitude_of(shape, yaw)
    row[Column.ROLL_RATE], row[Column.PITCH_RATE] = body_rates(shape, yaw, q[0], q[1], q[2])
    row[Column.SOIL] = soil_at(state.pose[0], state.pose[1], model.ground)
    row[Column.MOMENT] = force[0, 2] + force[1, 2]
    row[Column.ITERATIONS] = iterations
    for k in range(2):
        row[Column.TRACK_SPEED + k], row[Column.ANGLE + k] = q[3 + k], state.angle[k]
        row[Column.SPOOL + k], row[Column.DRIVE + k] = state.spool[k], state.newton.drive[k]
        row[Column.LOAD + k] = np.sum(model.tracks.load[k])
        row[Column.SIDE] -= force[k, 1]
        v = q[0] - q[2] * model.tracks.half_tread * (1.0 - 2.0 * k)
        thrust = -force[k, 0]
        resistance = state.newton.rolling[k] * v / math.sqrt(v * v + model.machine.rolling_floor**2)
        row[Column.THRUST + k], row[Column.RESISTANCE + k] = thrust, resistance
        row[Column.POWER] += thrust * q[3 + k]
        row[Column.LOSS] += (q[3 + k] - v) * thrust + q[1] * force[k, 1] + q[2] * force[k, 2]
        row[Column.LOSS] += resistance * v


@compiled
def set_contact_loads(model: Model, state: State) -> None:
    """Fill ``load`` and the elements' loads for the next step: ground at the midpoint, axes at the end."""
    q, pose, half = state.q, state.pose, 0.5 * model.machine.step
    shape_at(pose[0], pose[1], model.terrain, state.shape)
    x, y, yaw = pose_rates(state.shape, pose[2], half * q[0], half * q[1], half * q[2])
    shape_at(pose[0] + x, pose[1] + y, model.terrain, state.shape)
    pitch, roll = attitude_of(state.shape, pose[2] + 2.0 * yaw)
    set_normal_force(state.load, pitch, roll)
    distribute_load(state.load, model.tracks)


@compiled
def set_acceleration(model: Model, state: State) -> None:
    """Set ``load.acceleration``: the hull's acceleration in the step solved last."""
    for i in range(2):
        state.load.acceleration[i] = (state.q[i] - state.newton.start[i]) / model.machine.step


@compiled
def integrate(spool: FloatArray, mass_properties: FloatArray, model: Model, state: State) -> FloatArray:
    """Advance under spools (1 + steps, 2); a row (WIDTH,) after each ``steps_per_row`` steps.

    ``mass_properties``: weight and centre as in ``Load``, (steps, 4), or (1, 4) if constant.
    """
    tracks, newton, q = model.tracks, state.newton, state.q
    step, radius = model.machine.step, model.valves.radius
    rows = np.zeros(((len(spool) - 1) // model.steps_per_row, WIDTH))
    worst = 0
    for i in range(len(spool) - 1):
        for n in range(4):
            state.load.mass_properties[n] = mass_properties[min(i, len(mass_properties) - 1), n]
        set_contact_loads(model, state)
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
        rotate_velocity(q, step)
        worst = max(worst, solve_step(q, model.machine, tracks, state.shear, newton))
        set_acceleration(model, state)
        advect_shear(state.shear, q, tracks, step)
        limit_shear(state.shear, model.ground)
        advance_pose(state.pose, state.before, q, model.terrain, step)
        for k in range(2):
            state.angle[k] += 0.5 * step * (state.before[3 + k] + q[3 + k]) / radius
        if (i + 1) % model.steps_per_row == 0:
            write_row(rows[(i + 1) // model.steps_per_row - 1], model, state, worst)
            worst = 0
    return rows


class ShearDrive:
    """A machine that starts at rest at the origin and is driven piece by piece.

    Raises:
        InputError: the load leaves a track, or its front or rear, without ground pressure; or the ground
        bends too sharply; or the machine tips over on it.
    """

    def __init__(
        self, ground: Ground, vehicle: Vehicle, settings: TruthSettings, relief_pressure: float
    ) -> None:
        centre = unloaded_centre(vehicle, settings)
        _check_load(centre, vehicle)
        self._height_factor = float(ground.terrain != FLAT)  # factor of h_g, 0 on flat ground
        mass_properties = self._mass_properties(np.array(((vehicle.weight, *centre),)))
        self.relief_pressure = relief_pressure
        self._terrain = ground.terrain
        _check_terrain(self._terrain, vehicle)
        self._model = Model(
            _machine(vehicle, settings, relief_pressure),
            _tracks(vehicle, settings),
            ground.map,
            self._terrain.map,
            valves_of(vehicle, settings),
            settings.steps_per_sample,
        )
        rest = (np.zeros(3), np.zeros(SIZE), np.zeros(SIZE), np.zeros(2), np.zeros(2))
        load = Load(mass_properties[0], np.zeros(2), np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(1))
        newton = new_step(load.gravity)
        self._state = State(*rest, undisturbed_shear(settings.elements), load, np.zeros(6), newton)
        set_contact_loads(self._model, self._state)
        if self._terrain != FLAT:
            self._settle(round(SETTLING_TIME / settings.step))

    def _settle(self, steps: int) -> None:
        """Integrate ``steps`` at standstill, so that the soil holds the machine; then reset the pose to 0."""
        state = self._state
        integrate(np.zeros((steps + 1, 2)), state.load.mass_properties[None].copy(), self._model, state)
        for start in (state.pose, state.q, state.before, state.angle, state.load.acceleration):
            start[:] = 0.0
        set_contact_loads(self._model, state)
        self._check_upright()

    def first_row(self) -> FloatArray:
        """The row (1, WIDTH) at the start."""
        row = np.zeros((1, WIDTH))
        write_row(row[0], self._model, self._state, 0)
        return row

    def _mass_properties(self, rows: FloatArray) -> FloatArray:
        """Rows (n, 4) of ``Load``; the height of the centre is set to 0 on flat ground."""
        return np.ascontiguousarray(rows * (1.0, 1.0, 1.0, self._height_factor))

    def drive(self, commands: FloatArray, mass_properties: FloatArray | None = None) -> FloatArray:
        """Rows (n // steps_per_sample, WIDTH) under further commands (n, 2), rad/s; loads as in ``Mode``.

        Raises:
            InputError: the machine tips over.
            UnsolvedStepError: the solver did not balance a step.
        """
        commands = np.ascontiguousarray(commands, dtype=np.float64)
        spool = spool_positions(commands, self._model.valves, self._state.spool)
        properties = (
            self._state.load.mass_properties[None].copy()
            if mass_properties is None
            else self._mass_properties(mass_properties)
        )
        rows: FloatArray = integrate(spool, properties, self._model, self._state)
        require_solved(rows, MAX_ITERATIONS)
        self._check_upright()
        return rows

    def _check_upright(self) -> None:
        if self._state.load.tipped[0]:
            x, y = self._state.pose[:2]
            raise InputError(
                f"terrain '{self._terrain.name}': the machine tips over before ({x:.1f}, {y:.1f}) m;"
                " accepted: gentler ground, or a centre of gravity that is lower"
            )


def _check_terrain(terrain: Terrain, vehicle: Vehicle) -> None:
    min_radius = MIN_RADIUS * vehicle.contact_length
    if not terrain.radius >= min_radius:
        raise InputError(
            f"terrain '{terrain.name}': a bend of radius {terrain.radius:.3g} m is refused;"
            f" accepted: >= {min_radius:.3g} m, {MIN_RADIUS:g} contact lengths"
        )


def _tracks(vehicle: Vehicle, settings: TruthSettings) -> Tracks:
    length, n = vehicle.contact_length, settings.elements
    area = length * vehicle.track_width / n
    return Tracks(element_positions(length, n), np.zeros((2, n)), area, 0.5 * vehicle.tread, length)


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
        tolerance=TOLERANCE * vehicle.weight,
    )


def _check_load(centre: FloatArray, vehicle: Vehicle) -> None:
    for name, value, limit in (
        ("load_x", float(centre[0]), vehicle.contact_length / 6),
        ("load_y", float(centre[1]), vehicle.tread / 2),
    ):
        if not abs(value) < limit:
            raise InputError(
                f"TruthSettings.{name}: {value!r} m lifts part of a track; accepted: within ±{limit:.4g} m"
            )
