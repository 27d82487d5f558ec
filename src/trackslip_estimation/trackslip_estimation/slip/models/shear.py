# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Soil that the tracks shear before the machine moves; compiled.

    ω_j    sprocket speed                                                rad/s
    s_j    share of the soil's shear that track j has built up, with its
           sense: 0 where it stands, sgn ω_j once it has run on          −1 … 1
    K₀     way of a track over which that happens, ``start_shear``       m

A track thrusts as far as it has sheared the soil under it (3.3). From a standstill, and when it turns back,
it runs on the spot for a centimetre or two until it thrusts as much as the machine resists and its
acceleration takes; K is not known here. So a share 1 − s_j sgn ω_j of a track's speed may be an error.
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
_BUILT = 1e-4  # of the shear is missing where it counts as built up: after nine times K₀


@compiled
def build_up(state: State, dt: float, c: Config) -> None:
    """s ``dt`` s later, with the state's speeds and motion."""
    built = state.shear
    if state.motion.motion == _STANDING:
        built[0] = built[1] = 0.0
        return
    for side in range(2):
        speed = state.speeds.left if side == 0 else state.speeds.right
        distance = c.rolling_radius * abs(speed) * dt
        missing = math.copysign(1.0, speed) - built[side]
        built[side] -= missing * math.expm1(-distance / c.velocity_errors.start_shear)


@compiled
def starts(drive: State, c: Config) -> bool:
    """Whether a track that turns has hardly sheared the soil yet."""
    left, right = lost_speeds(drive, c)
    distance = c.rolling_radius * abs(drive.speeds.left), c.rolling_radius * abs(drive.speeds.right)
    return bool(abs(left) > _BUILT * distance[0] or abs(right) > _BUILT * distance[1])


@compiled
def lost_speeds(drive: State, c: Config) -> tuple[float, float]:
    """What of the left and the right track's speed may go into the soil, m/s."""
    left, right = c.rolling_radius * drive.speeds.left, c.rolling_radius * drive.speeds.right
    return left - abs(left) * drive.shear[0], right - abs(right) * drive.shear[1]


@compiled
def lost_variances(drive: State, c: Config) -> tuple[float, float]:
    """Of what that takes from v, (m/s)², and from ω times B, alike in both tracks but for a share.

    Lasting for τ, the errors move a machine that starts or turns back by K₀, one standard deviation, and by
    no more than its tracks go.
    """
    e, (left, right) = c.velocity_errors, lost_speeds(drive, c)
    both = (left + right) / 2.0
    fastest = c.rolling_radius * max(abs(drive.speeds.left), abs(drive.speeds.right))
    share = min(1.0, e.start_shear / max(fastest * e.time, 1e-12))
    return share * both**2, share * ((right - left) ** 2 + (e.yaw_rate_ratio * both) ** 2)
