# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of the upper structure: its motor moves to the scenario's target at full speed; compiled.

σ, σ_m    angle of the upper structure; of the motor over the gear ratio    rad
w, a      maximum rate, acceleration                                        rad/s, rad/s²
b         backlash: |σ − σ_m| ≤ b/2; the motor moves the cab at its ends    rad

The rate follows ±min(w, √(2 a |target − σ_m|)) with acceleration at most a, so that it is 0 at the target.
The reaction of the swing on the undercarriage is neglected.
"""

import math

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.errors import InputError
from trackslip_common.vehicle import UpperStructure
from trackslip_sim.scenarios.scenario import Scenario
from trackslip_sim.truth.settings import TruthSettings


class Swing:
    """The swing of one run, in pieces; it starts at rest at σ = 0.

    Raises:
        InputError: the scenario swings and the vehicle has no upper structure with a drive.
    """

    def __init__(self, scenario: Scenario, upper: UpperStructure | None, settings: TruthSettings) -> None:
        self._scenario, self._settings = scenario, settings
        self._is_still = not scenario.has_swing
        self._drive = (0.0, 0.0, 0.0)
        self._state = np.zeros(3)
        if self._is_still:
            return
        if upper is None or upper.drive is None:
            raise InputError(
                f"scenario '{scenario.name}' swings the upper structure; accepted: a vehicle with"
                " upper_structure.drive"
            )
        self._drive = upper.drive.rate, upper.drive.acceleration, upper.drive.backlash

    def drive(self, begin: int, end: int) -> FloatArray:
        """(n, 2) σ and its rate after each of the steps ``begin`` to ``end`` (excluded)."""
        if self._is_still:
            return np.zeros((end - begin, 2))
        targets = self._scenario.swing_targets(self._settings.step, begin, end)
        return np.asarray(swing_motion(targets, self._drive, self._settings.step, self._state))


@compiled
def swing_motion(
    targets: FloatArray, drive: tuple[float, float, float], step: float, state: FloatArray
) -> FloatArray:
    """(n, 2) σ and its rate after each step towards ``targets`` (n,), rad; ``drive`` is w, a, b.

    ``state`` (3,): σ, σ_m and the motor's rate; updated in place.
    """
    fastest, acceleration, backlash = drive
    swung = np.empty((targets.size, 2))
    angle, motor, rate = state
    change = acceleration * step
    for k in range(targets.size):
        before = rate
        remaining = targets[k] - motor - rate * step
        requested = math.copysign(min(fastest, math.sqrt(2.0 * acceleration * abs(remaining))), remaining)
        rate += min(max(requested - rate, -change), change)
        motor += (before + rate) / 2.0 * step
        if abs(targets[k] - motor) <= 2.0 * change * step and abs(rate) <= 2.0 * change:
            motor, rate = targets[k], 0.0
        moved = min(max(angle, motor - backlash / 2.0), motor + backlash / 2.0)
        swung[k, 0], swung[k, 1] = moved, rate if moved != angle else 0.0
        angle = moved
    state[0], state[1], state[2] = angle, motor, rate
    return swung
