# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Valves and pumps: from commanded sprocket speed to what the oil allows."""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import speed_of_flow
from trackslip_sim.truth.settings import TruthSettings


class Valves(NamedTuple):
    """How spools follow commands, and tracks the spools."""

    top_speed: float  # rad/s, of a sprocket at full pump flow
    kept: float  # part of a spool's distance from its command that is left after one step
    radius: float  # m, of the sprockets


def valves_of(vehicle: Vehicle, settings: TruthSettings) -> Valves:
    """The valves of a vehicle under the settings' step."""
    return Valves(
        top_speed=float(speed_of_flow(vehicle.pump_flow, 1.0, vehicle)),
        kept=math.exp(-settings.step / settings.valve_time_constant),
        radius=vehicle.rolling_radius,
    )


@compiled
def spools(commands: FloatArray, valves: Valves, start: FloatArray) -> FloatArray:
    """Spool positions (n + 1, 2), -1 … 1, from ``start`` (2,), under commanded speeds (n, 2), rad/s."""
    positions = np.empty((len(commands) + 1, 2))
    for k in range(2):
        positions[0, k] = start[k]
        for i in range(len(commands)):
            requested = min(max(commands[i, k] / valves.top_speed, -1.0), 1.0)
            positions[i + 1, k] = requested + (positions[i, k] - requested) * valves.kept
    return positions
