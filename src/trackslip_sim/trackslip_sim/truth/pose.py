# SPDX-License-Identifier: Apache-2.0
"""From body velocities to the pose in the site frame, compiled."""

import math

from trackslip_common.compiled import compiled
from trackslip_sim.truth.record import FloatArray


@compiled
def move(pose: FloatArray, before: FloatArray, after: FloatArray, step: float) -> None:
    """Advance ``pose`` (x, y, yaw) by the mean of two velocities (v_x, v_y, φ̇) along the mean heading."""
    forward = 0.5 * step * (before[0] + after[0])
    left = 0.5 * step * (before[1] + after[1])
    turn = 0.5 * step * (before[2] + after[2])
    cos, sin = math.cos(pose[2] + 0.5 * turn), math.sin(pose[2] + 0.5 * turn)
    pose[0] += cos * forward - sin * left
    pose[1] += sin * forward + cos * left
    pose[2] += turn
