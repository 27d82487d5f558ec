# SPDX-License-Identifier: Apache-2.0
"""Speeds of both tracks, as twist and slips imply them.

v_j    ground speed of a track's frame, v_x ∓ φ̇ B/2              m/s
r ω_j  speed of the track itself, v_j/(1 − i_j), from i = 1 − v/(r ω)   m/s
"""

import numpy as np
from numpy.typing import NDArray

from trackslip_common.vehicle import Vehicle

FloatArray = NDArray[np.float64]

_SPINNING = 1e-9  # of 1 − i: a track that spins in place has any speed


def frame_speeds(twist: FloatArray, vehicle: Vehicle) -> FloatArray:
    """(2,) v_j of left and right for a twist (3,) at C, m/s."""
    half = 0.5 * vehicle.tread * float(twist[2])
    return float(twist[0]) + np.array((-half, half))


def track_speeds(twist: FloatArray, slips: FloatArray, vehicle: Vehicle) -> FloatArray:
    """(2,) r ω_j, m/s; nan where the slip is 1."""
    rolling = 1.0 - slips[:2]
    known = np.abs(rolling) > _SPINNING
    return np.where(known, frame_speeds(twist, vehicle) / np.where(known, rolling, 1.0), np.nan)
