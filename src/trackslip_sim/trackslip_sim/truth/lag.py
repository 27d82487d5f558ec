# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Valves and pumps: spool positions from commanded sprocket speeds, limited by the pump flow."""

import math
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.vehicle import Vehicle
from trackslip_estimation.terramechanics.hydraulics import speed_of_flow
from trackslip_sim.truth.settings import TruthSettings


class Valves(NamedTuple):
    """First-order lag of the spools behind the commands, and the track speed of a full spool."""

    top_speed: float  # rad/s, of a sprocket at full pump flow
    decay: float  # share of a spool's control error that remains after one step
    radius: float  # m, of the sprockets


def valves_of(vehicle: Vehicle, settings: TruthSettings) -> Valves:
    """The valves of a vehicle for the integration step of the settings."""
    return Valves(
        top_speed=float(speed_of_flow(vehicle.pump_flow, 1.0, vehicle)),
        decay=math.exp(-settings.step / settings.valve_time_constant),
        radius=vehicle.rolling_radius,
    )


@compiled
def spool_positions(commands: FloatArray, valves: Valves, start: FloatArray) -> FloatArray:
    """Spool positions (n + 1, 2), -1 … 1, from ``start`` (2,), under commanded speeds (n, 2), rad/s."""
    positions = np.empty((len(commands) + 1, 2))
    for k in range(2):
        positions[0, k] = start[k]
        for i in range(len(commands)):
            requested = min(max(commands[i, k] / valves.top_speed, -1.0), 1.0)
            positions[i + 1, k] = requested + (positions[i, k] - requested) * valves.decay
    return positions
