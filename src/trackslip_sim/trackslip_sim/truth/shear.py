# SPDX-License-Identifier: Apache-2.0
"""Truth mode ``shear``: the vehicle driven over ground that shears, step by step, compiled.

Commanded sprocket speeds are limited by the pumps' flow, lag in the valves, and yield at relief pressure;
shear displacement integrates along each track's contact (Wong & Chiang 2001). See ``contact``, ``motion``.
"""

import math

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import thrust_of_pressure
from trackslip_sim.scenarios.scenario import Scenario
from trackslip_sim.truth.contact import carry, element_loads, element_positions, find_soils, forget, mobilise
from trackslip_sim.truth.ground import Ground, soil_at
from trackslip_sim.truth.lag import kept_error, top_speed
from trackslip_sim.truth.motion import MAX_ITERATIONS, Machine, Sums, new_sums, solve_step
from trackslip_sim.truth.pose import move
from trackslip_sim.truth.record import FloatArray, IntArray, Truth
from trackslip_sim.truth.rows import WIDTH, Column, refuse_unsolved, to_truth
from trackslip_sim.truth.settings import TruthSettings


@compiled
def turn_axes(q: FloatArray, step: float) -> None:
    """Express the hull's velocity in the body axes at the end of the step (the m φ̇ v terms)."""
    cos, sin = math.cos(q[2] * step), math.sin(q[2] * step)
    q[0], q[1] = cos * q[0] + sin * q[1], cos * q[1] - sin * q[0]


@compiled
def write_row(
    row: FloatArray,
    pose: FloatArray,
    q: FloatArray,
    angle: FloatArray,
    spool: FloatArray,
    rolling: FloatArray,
    soil: int,
    machine: Machine,
    sums: Sums,
) -> None:
    """Fill one row, still all zero, but for the iterations."""
    row[Column.X : Column.V_X] = pose
    row[Column.V_X : Column.TRACK_SPEED] = q[:3]
    row[Column.TRACK_SPEED : Column.ANGLE] = q[3:]
    row[Column.ANGLE : Column.THRUST] = angle
    row[Column.SPOOL : Column.SOIL] = spool
    row[Column.SOIL] = soil
    row[Column.DRIVE :] = sums.drive
    row[Column.MOMENT] = sums.force[0, 2] + sums.force[1, 2]
    for k in range(2):
        v = q[0] - q[2] * machine.half_tread * (1.0 - 2.0 * k)
        thrust = -sums.force[k, 0]
        resistance = rolling[k] * v / math.sqrt(v * v + machine.rolling_floor**2)
        row[Column.THRUST + k], row[Column.RESISTANCE + k] = thrust, resistance
        row[Column.POWER] += thrust * q[3 + k]
        row[Column.LOSS] += (q[3 + k] - v) * thrust + q[1] * sums.force[k, 1] + q[2] * sums.force[k, 2]
        row[Column.LOSS] += resistance * v


@compiled
def integrate(
    commands: FloatArray,
    every: int,
    step: float,
    keep: float,
    top: float,
    radius: float,
    x_e: FloatArray,
    load: FloatArray,
    table: FloatArray,
    edges: FloatArray,
    patch_soil: IntArray,
    machine: Machine,
    sums: Sums,
) -> FloatArray:
    """Rows (1 + steps // every, WIDTH) from rest at the origin under ``commands`` (steps, 2), rad/s.

    ``keep`` is the part of a spool's error left after one step, ``top`` the speed of full flow, rad/s.
    """
    n = len(x_e)
    pose, angle, spool, q = np.zeros(3), np.zeros(2), np.zeros(2), np.zeros(5)
    rolling, j, strength = np.zeros(2), np.zeros((2, n, 2)), np.zeros((2, n))
    soil = np.zeros((2, n), dtype=np.int64)
    rows = np.zeros((1 + len(commands) // every, WIDTH))
    worst = 0
    rows[0, Column.SOIL] = soil_at(0.0, 0.0, edges, patch_soil)
    for i in range(len(commands)):
        find_soils(pose, x_e, machine.half_tread, edges, patch_soil, soil)
        mobilise(j, load, machine.element_area, soil, table, strength)
        for k in range(2):
            wanted = min(max(commands[i, k] / top, -1.0), 1.0)
            spool[k] = wanted + (spool[k] - wanted) * keep
            rolling[k] = 0.0
            for e in range(n):
                rolling[k] += table[soil[k, e], 3] * load[k, e]  # μ_r
        before = q.copy()
        turn_axes(q, step)
        worst = max(worst, solve_step(q, spool * top * radius, strength, rolling, x_e, machine, step, sums))
        carry(j, q, x_e, machine.half_tread, step)
        forget(j, soil, table)
        move(pose, before, q, step)
        angle += 0.5 * step * (before[3:] + q[3:]) / radius
        if (i + 1) % every == 0:
            row = rows[(i + 1) // every]
            here = soil_at(pose[0], pose[1], edges, patch_soil)
            write_row(row, pose, q, angle, spool, rolling, here, machine, sums)
            row[Column.ITERATIONS], worst = worst, 0
    return rows


def simulate(scenario: Scenario, ground: Ground, vehicle: Vehicle, settings: TruthSettings) -> Truth:
    """Mode ``shear`` of ``truth.simulate``.

    Raises:
        InputError: the load leaves a track, or its front or rear, without ground pressure.
    """
    relief = scenario.relief_pressure or vehicle.relief_pressure
    commands = scenario.commands(settings.step)
    rows = run(commands, ground, vehicle, settings, relief, settings.steps_per_sample)
    return to_truth(rows, ground.names, vehicle, settings, relief)


def run(
    commands: FloatArray,
    ground: Ground,
    vehicle: Vehicle,
    settings: TruthSettings,
    relief_pressure: float,
    every: int,
) -> FloatArray:
    """``integrate`` with its arguments drawn from the records; one row every ``every`` steps.

    Raises:
        InputError: the load leaves a track, or its front or rear, without ground pressure.
        UnsolvedStepError: see there.
    """
    _check_load(vehicle, settings)
    x_e = element_positions(vehicle.contact_length, settings.elements)
    load = element_loads(
        vehicle.weight, vehicle.tread, x_e, vehicle.contact_length, settings.load_x, settings.load_y
    )
    rows = integrate(
        np.ascontiguousarray(commands, dtype=np.float64),
        every,
        settings.step,
        kept_error(settings),
        top_speed(vehicle),
        vehicle.rolling_radius,
        x_e,
        load,
        ground.table,
        ground.edges,
        ground.patch_soil,
        _machine(vehicle, settings, relief_pressure),
        new_sums(),
    )
    refuse_unsolved(rows, MAX_ITERATIONS)
    return rows


def _machine(vehicle: Vehicle, settings: TruthSettings, relief_pressure: float) -> Machine:
    limit = float(thrust_of_pressure(relief_pressure, 1.0, vehicle))
    return Machine(
        mass=vehicle.mass,
        yaw_inertia=vehicle.yaw_inertia,
        half_tread=0.5 * vehicle.tread,
        track_mass=settings.track_mass,
        element_area=vehicle.contact_length * vehicle.track_width / settings.elements,
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
