# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Speeds of both tracks from twist and slips, compiled.

v_j    ground speed of a track's frame, v_x ∓ φ̇ B/2              m/s
r ω_j  speed of the track itself, v_j/(1 − i_j), from i = 1 − v/(r ω)   m/s
"""

import math

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled

_SPINNING = 1e-9  # least |1 − i|: a track that spins in place may have any speed


@compiled
def frame_speeds(twist: FloatArray, tread: float) -> tuple[float, float]:
    """Return v_j, left and right, for a twist (3,) at C, m/s."""
    half = 0.5 * tread * twist[2]
    return twist[0] - half, twist[0] + half


@compiled
def track_speed(frame_speed: float, slip: float) -> float:
    """Return r ω of a track, m/s; nan where the slip is 1."""
    rolling = 1.0 - slip
    return frame_speed / rolling if abs(rolling) > _SPINNING else math.nan
