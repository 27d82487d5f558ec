# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A truth matched to sub-model 1b, for tests: how the vehicle turns is given, so the slips are known exactly.

V, D     r (ω_L + ω_R)/2, r (ω_R - ω_L)                 m/s
i₀       slip common to both tracks                      1
κ, η     turning efficiency, speed lost in a turn        1
x_I      longitudinal offset of the centre of rotation   m

v = (1 - i₀) V - η |D|/2        φ̇ = κ D/B        v_y = -φ̇ x_I
"""

from dataclasses import dataclass

import numpy as np

from trackslip_common.parameters import Parameters, parameter
from trackslip_common.soils import Soil
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.resistance import longitudinal_resistance
from trackslip_estimation.terramechanics.strength import thrust_limit
from trackslip_estimation.terramechanics.traction import thrust
from trackslip_sim.scenarios.scenario import Scenario
from trackslip_sim.truth.lag import spools, valves_of
from trackslip_sim.truth.record import FloatArray, Truth
from trackslip_sim.truth.rows import WIDTH, Column, Recorder
from trackslip_sim.truth.settings import TruthSettings


@dataclass(frozen=True, kw_only=True)
class Turning(Parameters):
    """The constants of sub-model 1b."""

    common_slip: float = parameter("slip i₀ of both tracks", gt=-1.0, lt=1.0)
    efficiency: float = parameter("turning efficiency κ", gt=0.0, le=1.0)
    speed_loss: float = parameter("speed lost in a turn η", ge=0.0, le=1.0)
    rotation_offset: float = parameter("offset of the centre of rotation x_I", unit="m")


def simulate_kinematic(
    scenario: Scenario, turning: Turning, soil: Soil, vehicle: Vehicle, settings: TruthSettings
) -> Truth:
    """Drive ``scenario`` from rest at the origin as ``turning`` says; the sprockets lag first-order.

    Thrusts are those of the slips on ``soil`` by (3.3), resistances ½ μ_r W; nothing is integrated from them,
    and there is no turning moment. The scenario's own soil, patches and relief pressure play no part.

    Raises:
        InputError: the soil lacks K or μ_r.
    """
    step, every = settings.step, settings.steps_per_sample
    valves = valves_of(vehicle, settings)
    spool = spools(scenario.commands(step), valves, np.zeros(2))
    u = spool * valves.top_speed * vehicle.rolling_radius
    difference = u[:, 1] - u[:, 0]
    v_x = (1.0 - turning.common_slip) * u.mean(axis=1) - 0.5 * turning.speed_loss * np.abs(difference)
    yaw_rate = turning.efficiency * difference / vehicle.tread
    v_y = -yaw_rate * turning.rotation_offset
    yaw = _integral(yaw_rate, step)
    middle = yaw[:-1] + 0.25 * step * (yaw_rate[:-1] + yaw_rate[1:])
    forward, left = 0.5 * (v_x[:-1] + v_x[1:]), 0.5 * (v_y[:-1] + v_y[1:])

    c = Column
    rows = np.zeros((len(u), WIDTH))
    rows[1:, c.X] = np.cumsum(step * (np.cos(middle) * forward - np.sin(middle) * left))
    rows[1:, c.Y] = np.cumsum(step * (np.sin(middle) * forward + np.cos(middle) * left))
    rows[:, c.YAW], rows[:, c.V_X], rows[:, c.V_Y], rows[:, c.YAW_RATE] = yaw, v_x, v_y, yaw_rate
    limit = thrust_limit(
        soil.cohesion, soil.friction_angle, 2.0 * vehicle.track_width * vehicle.contact_length, vehicle.weight
    )
    for k, side in enumerate((1.0, -1.0)):
        v = v_x - 0.5 * side * vehicle.tread * yaw_rate
        slip = np.divide(
            u[:, k] - v, u[:, k], out=np.zeros_like(v), where=np.abs(u[:, k]) > settings.slip_floor
        )
        force = thrust(slip * np.sign(u[:, k]), limit, soil.value("shear_modulus"), vehicle.contact_length)
        rows[:, c.TRACK_SPEED + k], rows[:, c.ANGLE + k] = (
            u[:, k],
            _integral(u[:, k], step) / vehicle.rolling_radius,
        )
        rows[:, c.THRUST + k], rows[:, c.DRIVE + k] = force, force
        rows[:, c.RESISTANCE + k] = longitudinal_resistance(v, soil.value("mu_r"), vehicle.weight)
        rows[:, c.SPOOL + k] = spool[:, k]
        rows[:, c.LOAD + k] = 0.5 * vehicle.weight
    return Recorder(vehicle, settings, vehicle.relief_pressure, (soil.name,)).truth(rows[::every])


def _integral(rate: FloatArray, step: float) -> FloatArray:
    """∫ rate dt (n,) from 0, by trapezoids."""
    return np.concatenate([[0.0], np.cumsum(0.5 * step * (rate[:-1] + rate[1:]))])
