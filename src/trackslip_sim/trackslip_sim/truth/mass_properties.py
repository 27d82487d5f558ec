# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Weight and centre of gravity of the machine under swing angle and bucket load.

m, m_u, m_b    mass of the empty machine, of its upper structure, of the bucket's load    kg
r_0, r_g       centre of gravity at σ = 0 and empty bucket; the current one               m
c, a, r_b      centre of the upper structure ahead of its axis; the axis; the bucket      m
R              rotation by σ

r_g = (m r_0 + m_u (R c - c) + m_b (a + R (r_b - a)))/(m + m_b)

Only the weight changes: the equations of motion keep m and I_z of the empty machine.
"""

from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_common.units import GRAVITY
from trackslip_common.vehicle import UpperStructure, Vehicle
from trackslip_sim.scenarios.scenario import Scenario
from trackslip_sim.truth.settings import TruthSettings


def unloaded_centre(vehicle: Vehicle, settings: TruthSettings) -> FloatArray:
    """r_0 (3,), m: the vehicle's centre of gravity plus the settings' offset ``load_x``, ``load_y``."""
    centre = vehicle.centre_of_gravity
    x, y, z = (centre.x, centre.y, centre.z) if centre is not None else (0.0, 0.0, 0.0)
    return np.array((x + settings.load_x, y + settings.load_y, z))


@dataclass(frozen=True)
class MassProperties:
    """Weight and centre of gravity during one run.

    Raises:
        InputError: the scenario loads a bucket that the vehicle does not have.
    """

    scenario: Scenario
    vehicle: Vehicle
    upper: UpperStructure | None
    settings: TruthSettings

    def __post_init__(self) -> None:
        if self.scenario.has_bucket_load and self.vehicle.bucket is None:
            raise InputError(
                f"scenario '{self.scenario.name}' loads the bucket; accepted: a vehicle with mass.bucket"
            )

    def rows(self, swing: FloatArray, begin: int, end: int) -> FloatArray:
        """(n, 4) weight, N, and r_g, m, for steps ``begin`` to ``end`` (excluded); ``swing`` (n,) is σ."""
        mass, upper, bucket = self.vehicle.mass, self.upper, self.vehicle.bucket
        axis = (upper.swing_axis_x, upper.swing_axis_y) if upper is not None else (0.0, 0.0)
        moments = np.tile(mass * unloaded_centre(self.vehicle, self.settings), (end - begin, 1))
        cos, sin = np.cos(swing), np.sin(swing)
        if upper is not None:
            moments[:, 0] += upper.mass * upper.centre_x * (cos - 1.0)
            moments[:, 1] += upper.mass * upper.centre_x * sin
        masses = np.full(end - begin, mass)
        if bucket is not None:
            carried = self.scenario.bucket_masses(self.settings.step, begin, end)
            ahead, left = bucket.x - axis[0], -axis[1]
            moments[:, 0] += carried * (axis[0] + cos * ahead - sin * left)
            moments[:, 1] += carried * (axis[1] + sin * ahead + cos * left)
            moments[:, 2] += carried * bucket.z
            masses += carried
        return np.column_stack((GRAVITY * masses, moments / masses[:, None]))
