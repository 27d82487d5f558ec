# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""A motion along tilted ground: what gravity adds to it, and what of it is horizontal; compiled.

    k        speed downhill over that of the tracks, by the sine of the slope     1
    U        mean of the tracks' speeds, forward or not                           m/s
    φ, θ     roll, pitch; level: the record of ``attitude`` that holds what of them is needed

    T        |D| of a turn that is not gentle                                     m/s

    v_x += (k U + 1.0 T) sin θ        v_y −= (k U + 0.35 T) sin φ cos θ

Tracks hold a machine on a slope by sliding: with a force of their weight times sin θ more or less along
them (uphill they slip more), sin φ across (it crabs downhill, without a turn). As long as the soil is
far from its strength the shear is alike in both directions, and so is k; it grows as the strength comes
near. In a turn all of the shear is mobilised, and slides whichever way is downhill: by how much hardly
depends on the soil (both factors are measured on the shear truth at 15°, on sand, sandy loam and dry
clay; ± 0.5). How the machine turns changes with its direction on the slope, too: κ, η and x_I walk
there. Near the strength the tracks spin uphill and roll downhill: what k says in one direction holds
in another the less, the larger k is (``update_direction``). Horizontal is

    v_x cos θ + v_y sin φ sin θ,  v_y cos φ        and        ψ̇ = (q sin φ + r cos φ)/cos θ
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_estimation.slip.models.model import DOWNHILL, YAW
from trackslip_estimation.slip.models.speed import ROTATION_OFFSET, TURN_STATE_1, TURN_STATE_2

if TYPE_CHECKING:
    from trackslip_estimation.attitude.records import Level
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State

Twist = tuple[float, float, float]

_GENTLE = 0.05  # sine of a slope that shows k half
_GENTLE_TURN = 0.1  # |D| over U of a turn that counts half
_AHEAD, _ASIDE = 1.0, 0.35  # of T
_TURNED = 0.1  # change of what the tracks drive down, as a sine, that makes k another one
_OTHER = 0.5  # of k, by which it then is, by the sine of the slope
_WALKS = 0.5, 0.75, 0.25  # of κ, η and x_I in turns, by the sine of the slope: 1/√s, 1/√s, m/√s


@compiled
def slide(x: FloatArray, twist: Twist, speeds: tuple[float, float], level: Level, c: Config) -> Twist:
    """The twist with what gravity adds; ``speeds`` are those of the sprockets, rad/s."""
    if level.tilted == 0:
        return twist
    by, T = x[DOWNHILL] * track_speed(speeds, c), turn_speed(speeds, c)
    ahead, aside = by + _AHEAD * T, by + _ASIDE * T
    return twist[0] + ahead * level.downhill_x, twist[1] + aside * level.downhill_y, twist[2]


@compiled
def slide_jacobian(J: FloatArray, speeds: tuple[float, float], level: Level, c: Config) -> None:
    """J (3, n), the derivative of the twist, with that of what gravity adds."""
    if level.tilted == 1:
        J[0, DOWNHILL] = track_speed(speeds, c) * level.downhill_x
        J[1, DOWNHILL] = track_speed(speeds, c) * level.downhill_y


@compiled
def track_speed(speeds: tuple[float, float], c: Config) -> float:
    """U."""
    U: float = c.rolling_radius * (abs(speeds[0]) + abs(speeds[1])) / 2.0
    return U


@compiled
def turn_speed(speeds: tuple[float, float], c: Config) -> float:
    """T; the rounding of the counts is no turn."""
    D, U = c.rolling_radius * abs(speeds[1] - speeds[0]), track_speed(speeds, c)
    return D * D / (D + _GENTLE_TURN * U) if D > 0.0 else 0.0


@compiled
def horizontal(twist: Twist, level: Level) -> Twist:
    """Speeds along the heading and to its left, m/s, and rate of the heading, rad/s."""
    if level.tilted == 0:
        return twist
    v_x, v_y, r = twist
    ahead = v_x * (1.0 + level.forward) + v_y * level.across
    return ahead, v_y * (1.0 + level.sideways), r * (1.0 + level.turn) + level.roll_over


@compiled
def horizontal_jacobian(J: FloatArray, level: Level) -> None:
    """J (3, n) of the twist becomes that of ``horizontal``."""
    if level.tilted == 0:
        return
    for k in range(J.shape[1]):
        J[0, k] = J[0, k] * (1.0 + level.forward) + J[1, k] * level.across
        J[1, k] *= 1.0 + level.sideways
        J[2, k] *= 1.0 + level.turn


@compiled
def update_direction(state: State) -> None:
    """Where the tracks drive down what they drove up, or aside, k is another one: the softer, the more."""
    V, level = state.speeds.left + state.speeds.right, state.attitude.level
    if V == 0.0 or level.tilted == 0:
        return
    down = math.copysign(level.downhill_x, V * level.downhill_x)
    changed = abs(down - state.learned_downhill)
    if changed < _TURNED:
        return
    steep = math.sqrt(level.downhill_x**2 + level.downhill_y**2 + _GENTLE**2)
    state.covariance[DOWNHILL, DOWNHILL] += (_OTHER * state.mean[DOWNHILL] * changed / steep) ** 2
    state.learned_downhill = down


@compiled
def set_slope_noise(Q: FloatArray, dt: float, turns: bool, level: Level) -> None:
    """What the heading errs by as roll and gyro err; k, which shows on slopes only, changes there only."""
    slope = level.downhill_x**2 + level.downhill_y**2
    Q[DOWNHILL, DOWNHILL] *= slope / (slope + _GENTLE**2)
    Q[YAW, YAW] += level.turn_variance * dt
    if turns and level.tilted == 1:
        of_first, of_second, of_offset = _WALKS
        Q[TURN_STATE_1, TURN_STATE_1] += of_first**2 * slope * dt
        Q[TURN_STATE_2, TURN_STATE_2] += of_second**2 * slope * dt
        Q[ROTATION_OFFSET, ROTATION_OFFSET] += of_offset**2 * slope * dt
