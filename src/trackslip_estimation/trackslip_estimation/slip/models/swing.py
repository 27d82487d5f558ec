# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""How the upper structure swings: two states of a machine that has sensors above; compiled.

    σ, σ̇    angle of the upper structure against the undercarriage, counter-clockwise    rad, rad/s
    ω̂, a    fastest that it swings, at which it starts and brakes                        rad/s, rad/s²
    T, q    how long such an acceleration passes for white noise, its density a² T       s, rad²/s³
    τ, ρ    time after which σ̇ is forgotten, e^(−dt/τ)                                   s, 1
    x_I     centre of rotation ahead of C (``speed``)                                    m
    g       how far the centre of gravity goes back as it turns by π/2, m_u c/m          m

While the tracks stand, or nobody hears of them, it may swing: σ̇ is driven by noise of density q, and its
standard deviation without any sensor grows to ω̂, τ = 2 ω̂²/q. While they drive, the brake holds it: σ̇ goes
to zero within ω̂/a, and stays there but for a little. One that still swings as they start to drive does so
until it is seen to stop.

Tracks turn about where they are loaded: x_I goes with the centre of gravity, by g (cos σ' − cos σ), and errs
by what arm and bucket do meanwhile (measured on the shear truth: x_I goes as far).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import Parameters, parameter
from trackslip_common.record_types import Record, dtype_of
from trackslip_common.vehicle import VehicleParameters
from trackslip_estimation.slip.models.model import SWING, SWING_RATE
from trackslip_estimation.slip.models.speed import ROTATION_OFFSET
from trackslip_estimation.slip.motion import Motion

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


class SwingConstants(Record):
    """Parameters of the swing."""

    fastest: float  # ω̂
    free_density: float  # q
    free_time: float  # τ, s
    held_density: float
    held_time: float
    balance: float  # g
    balance_density: float  # variance of x_I by the angle swung, m²/rad


CONSTANTS = dtype_of(SwingConstants)

_SWINGS = 0.05  # rad/s, beyond which it does so whatever the tracks do
_STRAIGHT, _TURNING = int(Motion.STRAIGHT), int(Motion.TURNING)


@dataclass(frozen=True, kw_only=True)
class SwingParameters(Parameters):
    """Of the upper structure, where sensors sit on it."""

    rate: float = parameter(
        "fastest that it swings, where the vehicle has no drive of it", unit="rad/s", gt=0.0
    )
    acceleration: float = parameter(
        "at which it starts and brakes, where the vehicle has none", unit="rad/s²", gt=0.0
    )
    acceleration_time: float = parameter("for which that passes for white noise", unit="s", gt=0.0, le=10.0)
    held_rate: float = parameter(
        "standard deviation of its rate while the tracks drive", unit="rad/s", ge=0.0
    )
    balance_error: float = parameter(
        "by which the centre of rotation errs after 1 rad, beyond what the vehicle's masses say",
        unit="m/√rad",
        ge=0.0,
    )
    repeat_time: float = parameter(
        "for which fixes of what sits above err alike, by its place against the swing axis: those that "
        "follow each other faster count for less",
        unit="s",
        ge=0.0,
        le=600.0,
    )
    initial_angle: float = parameter("where it looks at the start", unit="rad", ge=-6.2832, le=6.2832)
    initial_angle_stddev: float = parameter(
        "its standard deviation, where no sensor of the swing tells", unit="rad", gt=0.0
    )


def constants(p: SwingParameters, vehicle: VehicleParameters) -> tuple[float, ...]:
    """The fields of ``CONSTANTS``, in their order."""
    drive = vehicle.upper_structure.drive if vehicle.upper_structure is not None else None
    rate, acceleration = (p.rate, p.acceleration) if drive is None else (drive.rate, drive.acceleration)
    density, held_time = acceleration**2 * p.acceleration_time, rate / acceleration
    free_time, held_density = 2.0 * rate**2 / density, 2.0 * p.held_rate**2 / held_time
    of_motion = rate, density, free_time, held_density, held_time
    return *of_motion, vehicle.swing_balance, p.balance_error**2


@compiled
def is_held(drive: State) -> bool:
    """Whether the tracks drive, so that it hardly swings."""
    return bool(drive.motion.motion == _STRAIGHT or drive.motion.motion == _TURNING)


@compiled
def may_swing(state: State, source: int, c: Config) -> bool:
    """Whether a source sits above, and what it shows may be a swing."""
    return bool(c.above[source] == 1 and not is_held(state))


@compiled
def is_moved_by_swing(state: State, source: int, c: Config) -> bool:
    """Whether a source sits above, and the upper structure swings."""
    return bool(c.above[source] == 1 and abs(state.mean[SWING_RATE]) > _SWINGS)


@compiled
def _swings(rate: float) -> float:
    """Whether it does, beyond what noise shows: from 0 to 1."""
    share: float = rate**4 / (rate**4 + _SWINGS**4)
    return share


@compiled
def _noise(rate: float, drive: State, c: Config) -> tuple[float, float]:
    """q and τ."""
    n, swings = c.swing, _swings(rate)
    if not is_held(drive):
        return n.free_density, n.free_time
    return n.held_density + swings * n.free_density, n.held_time + swings * (n.free_time - n.held_time)


@compiled
def move_swing(x: FloatArray, moved: FloatArray, dt: float, drive: State, c: Config) -> None:
    """σ and σ̇ after ``dt`` s, into ``moved``; σ is not wrapped."""
    tau = _noise(x[SWING_RATE], drive, c)[1]
    lost = -math.expm1(-dt / tau)
    moved[SWING] = x[SWING] + x[SWING_RATE] * lost * tau
    moved[SWING_RATE] = x[SWING_RATE] * (1.0 - lost)
    moved[ROTATION_OFFSET] += c.swing.balance * (math.cos(moved[SWING]) - math.cos(x[SWING]))


@compiled
def linearize_swing(x: FloatArray, F: FloatArray, Q: FloatArray, dt: float, drive: State, c: Config) -> None:
    """What F and Q have of it."""
    q, tau = _noise(x[SWING_RATE], drive, c)
    lost = -math.expm1(-dt / tau)
    F[SWING, SWING_RATE], F[SWING_RATE, SWING_RATE] = lost * tau, 1.0 - lost
    Q[SWING_RATE, SWING_RATE] = q * tau * lost * (2.0 - lost) / 2.0
    Q[SWING, SWING_RATE] = Q[SWING_RATE, SWING] = q * (lost * tau) ** 2 / 2.0
    Q[SWING, SWING] = q * (lost * tau) ** 2 * dt / 3.0
    sin = math.sin(x[SWING] + x[SWING_RATE] * lost * tau)
    F[ROTATION_OFFSET, SWING] = c.swing.balance * (math.sin(x[SWING]) - sin)
    F[ROTATION_OFFSET, SWING_RATE] = -c.swing.balance * sin * lost * tau
    swung = _swings(x[SWING_RATE]) * abs(x[SWING_RATE]) * dt
    Q[ROTATION_OFFSET, ROTATION_OFFSET] += c.swing.balance_density * swung


@compiled
def shear(P: FloatArray, F: FloatArray) -> None:
    """P after what of F is not diagonal: x_I goes with σ and σ̇, σ with σ̇."""
    of_angle, of_rate, seconds = (
        F[ROTATION_OFFSET, SWING],
        F[ROTATION_OFFSET, SWING_RATE],
        F[SWING, SWING_RATE],
    )
    for j in range(P.shape[1]):
        P[ROTATION_OFFSET, j] += of_angle * P[SWING, j] + of_rate * P[SWING_RATE, j]
    for i in range(P.shape[0]):
        P[i, ROTATION_OFFSET] += of_angle * P[i, SWING] + of_rate * P[i, SWING_RATE]
    for j in range(P.shape[1]):
        P[SWING, j] += seconds * P[SWING_RATE, j]
    for i in range(P.shape[0]):
        P[i, SWING] += seconds * P[i, SWING_RATE]
