# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Shear of the soil under the tracks before the machine moves; compiled.

    ω_j    sprocket speed                                                rad/s
    s_j    share of the soil's shear that track j has built up, signed:
           0 at standstill, approaches sgn ω_j as the track runs         −1 … 1
    K₀     track distance over which s_j builds up by 1 − 1/e,
           ``start_shear``                                               m

The thrust of a track grows with its shear of the soil (3.3). After a standstill or a reversal a track runs on
the spot for a centimetre or two, until its thrust balances the resistance and accelerates the machine. K is
not known here. So a share 1 − s_j sgn ω_j of a track's speed may be an error.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.compiled import compiled
from trackslip_estimation.slip.motion import Motion

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

_STANDING = int(Motion.STANDING)
_MISSING_SHEAR = 1e-4  # missing share at which the shear counts as built up: after nine times K₀


@compiled
def update_shear(state: State, dt: float, c: Config) -> None:
    """Update s after ``dt`` s at the state's speeds and motion."""
    shear = state.shear
    if state.motion.motion == _STANDING:
        shear[0] = shear[1] = 0.0
        return
    for side in range(2):
        speed = state.speeds.left if side == 0 else state.speeds.right
        distance = c.rolling_radius * abs(speed) * dt
        missing = math.copysign(1.0, speed) - shear[side]
        shear[side] -= missing * math.expm1(-distance / c.velocity_errors.start_shear)


@compiled
def is_shear_building_up(state: State, c: Config) -> bool:
    """Whether a track turns and the shear under it is not built up yet."""
    left, right = shear_speeds(state, c)
    distance = c.rolling_radius * abs(state.speeds.left), c.rolling_radius * abs(state.speeds.right)
    return bool(abs(left) > _MISSING_SHEAR * distance[0] or abs(right) > _MISSING_SHEAR * distance[1])


@compiled
def shear_speeds(state: State, c: Config) -> tuple[float, float]:
    """Parts of the left and the right track's speed that the shear of the soil may absorb, m/s."""
    left, right = c.rolling_radius * state.speeds.left, c.rolling_radius * state.speeds.right
    return left - abs(left) * state.shear[0], right - abs(right) * state.shear[1]


@compiled
def shear_variances(state: State, c: Config) -> tuple[float, float]:
    """Variances by the lost speeds: of v, and of ω times B, (m/s)².

    Both tracks lose the same share of speed, up to ``yaw_rate_ratio``. With correlation time τ, one standard
    deviation moves a machine that starts or reverses by K₀, and by no more than the track distance.
    """
    e, (left, right) = c.velocity_errors, shear_speeds(state, c)
    mean = (left + right) / 2.0
    fastest = c.rolling_radius * max(abs(state.speeds.left), abs(state.speeds.right))
    share = min(1.0, e.start_shear / max(fastest * e.time, 1e-12))
    return share * mean**2, share * ((right - left) ** 2 + (e.yaw_rate_ratio * mean) ** 2)
