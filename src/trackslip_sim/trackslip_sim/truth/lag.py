# SPDX-License-Identifier: Apache-2.0
"""Valves and pumps: from commanded sprocket speed to what the oil allows."""

import math

import numpy as np

from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import speed_of_flow
from trackslip_sim.truth.record import FloatArray
from trackslip_sim.truth.settings import TruthSettings


def top_speed(vehicle: Vehicle) -> float:
    """Sprocket speed at full pump flow, rad/s."""
    return float(speed_of_flow(vehicle.pump_flow, 1.0, vehicle))


def kept_error(settings: TruthSettings) -> float:
    """Part of a spool's distance from its command that is left after one step."""
    return math.exp(-settings.step / settings.valve_time_constant)


@compiled
def spools(commands: FloatArray, top: float, keep: float) -> FloatArray:
    """Spool positions (n + 1, 2), -1 … 1, from rest, under commanded speeds (n, 2), rad/s.

    ``top`` is the speed of full flow, rad/s; ``keep`` the part of an error left after one step.
    """
    positions = np.zeros((len(commands) + 1, 2))
    for i in range(len(commands)):
        for k in range(2):
            wanted = min(max(commands[i, k] / top, -1.0), 1.0)
            positions[i + 1, k] = wanted + (positions[i, k] - wanted) * keep
    return positions
