# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Swing of the upper structure: two states of a machine that has sensors above; compiled.

    σ, σ̇    angle of the upper structure against the undercarriage, counter-clockwise    rad, rad/s
    ω̂, a    largest swing rate, acceleration of starting and braking                     rad/s, rad/s²
    T, q    time for which an acceleration counts as white noise, density a² T of it     s, rad²/s³
    τ, ρ    correlation time of σ̇, e^(−dt/τ)                                             s, 1
    x_I     centre of rotation ahead of C (``speed``)                                    m
    g       rearward shift of the centre of gravity as σ grows by π/2, m_u c/m           m

At standstill, or while the sprockets are silent, the upper structure may swing. Noise of density q drives σ̇;
without any sensor its standard deviation grows to ω̂, τ = 2 ω̂²/q. While the tracks drive, the brake holds the
upper structure: σ̇ decays within ω̂/a and stays near zero. If it still swings when the tracks start, it keeps
the free noise until its estimated rate is small. In a branch in which the brake has failed, it may also swing
while the tracks drive, until they stand.

Tracks turn about the loaded part of their contact: x_I moves by g (cos σ' − cos σ) with the centre of
gravity. On the shear truth both move equally far. Motion of arm and bucket adds an error to x_I.
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
from trackslip_estimation.slip.records import BRAKE
from trackslip_estimation.slip.source_faults import IS_HEALTHY

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config
    from trackslip_estimation.slip.records import State


class SwingConstants(Record):
    """Constants of the swing in compiled code."""

    fastest: float  # ω̂
    free_density: float  # q
    free_time: float  # τ, s
    held_density: float
    held_time: float
    balance: float  # g
    balance_density: float  # variance of x_I per swing angle, m²/rad


CONSTANTS = dtype_of(SwingConstants)

_LEAST_SWING_RATE = 0.05  # rad/s, swing rate beyond which the brake does not count as holding
_STANDING, _STRAIGHT, _TURNING = int(Motion.STANDING), int(Motion.STRAIGHT), int(Motion.TURNING)


@dataclass(frozen=True, kw_only=True)
class SwingParameters(Parameters):
    """Parameters of the upper structure, for machines with sensors mounted on it."""

    rate: float = parameter(
        "largest swing rate, for a vehicle that states no swing drive", unit="rad/s", gt=0.0
    )
    acceleration: float = parameter(
        "acceleration at which the swing starts and brakes, for a vehicle that states no swing drive",
        unit="rad/s²",
        gt=0.0,
    )
    acceleration_time: float = parameter(
        "time for which an acceleration counts as white noise", unit="s", gt=0.0, le=10.0
    )
    held_rate: float = parameter(
        "standard deviation of the swing rate while the tracks drive", unit="rad/s", ge=0.0
    )
    balance_error: float = parameter(
        "standard deviation of the centre of rotation after a swing of 1 rad, beyond the shift by the "
        "vehicle's masses",
        unit="m/√rad",
        ge=0.0,
    )
    repeat_time: float = parameter(
        "correlation time of the errors of fixes on the upper structure that depend on their place about the "
        "swing axis, as those of a laser (``standing_share``); more frequent fixes are down-weighted",
        unit="s",
        ge=0.0,
        le=600.0,
    )
    initial_angle: float = parameter("swing angle at the start", unit="rad", ge=-6.2832, le=6.2832)
    initial_angle_stddev: float = parameter(
        "standard deviation of the swing angle at the start, without a swing sensor", unit="rad", gt=0.0
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
def is_swing_braked(state: State) -> bool:
    """Whether the tracks drive and the brake holds the upper structure, as far as a branch assumes."""
    return bool(state.motion.motion in (_STRAIGHT, _TURNING) and state.fault[BRAKE] == IS_HEALTHY)


@compiled
def end_brake_fault(state: State, previous: int) -> None:
    """End a fault of the swing brake when the tracks stop, after a ``previous`` motion."""
    if state.motion.motion == _STANDING and previous != _STANDING:
        state.fault[BRAKE] = IS_HEALTHY


@compiled
def is_free_to_swing(state: State, source: int, c: Config) -> bool:
    """Whether a source is mounted on the upper structure, and the upper structure is free to swing."""
    return bool(c.above[source] == 1 and not is_swing_braked(state))


@compiled
def is_moved_by_swing(state: State, source: int, c: Config) -> bool:
    """Whether a source is mounted on the upper structure, and the upper structure swings."""
    return bool(c.above[source] == 1 and abs(state.mean[SWING_RATE]) > _LEAST_SWING_RATE)


@compiled
def _swing_share(rate: float) -> float:
    """Share from 0 to 1 by which a swing rate counts as a swing rather than noise."""
    share: float = rate**4 / (rate**4 + _LEAST_SWING_RATE**4)
    return share


@compiled
def _rate_noise(rate: float, state: State, c: Config) -> tuple[float, float]:
    """q and τ at a swing rate."""
    n, share = c.swing, _swing_share(rate)
    if not is_swing_braked(state):
        return n.free_density, n.free_time
    return n.held_density + share * n.free_density, n.held_time + share * (n.free_time - n.held_time)


@compiled
def propagate_swing(x: FloatArray, moved: FloatArray, dt: float, state: State, c: Config) -> None:
    """Write σ and σ̇ after ``dt`` s into ``moved`` and add the shift of x_I; σ is not wrapped."""
    tau = _rate_noise(x[SWING_RATE], state, c)[1]
    lost = -math.expm1(-dt / tau)
    moved[SWING] = x[SWING] + x[SWING_RATE] * lost * tau
    moved[SWING_RATE] = x[SWING_RATE] * (1.0 - lost)
    moved[ROTATION_OFFSET] += c.swing.balance * (math.cos(moved[SWING]) - math.cos(x[SWING]))


@compiled
def linearize_swing(x: FloatArray, F: FloatArray, Q: FloatArray, dt: float, state: State, c: Config) -> None:
    """Enter the swing into F and Q of a step of ``dt`` s, in place."""
    q, tau = _rate_noise(x[SWING_RATE], state, c)
    lost = -math.expm1(-dt / tau)
    F[SWING, SWING_RATE], F[SWING_RATE, SWING_RATE] = lost * tau, 1.0 - lost
    Q[SWING_RATE, SWING_RATE] = q * tau * lost * (2.0 - lost) / 2.0
    Q[SWING, SWING_RATE] = Q[SWING_RATE, SWING] = q * (lost * tau) ** 2 / 2.0
    Q[SWING, SWING] = q * (lost * tau) ** 2 * dt / 3.0
    sin = math.sin(x[SWING] + x[SWING_RATE] * lost * tau)
    F[ROTATION_OFFSET, SWING] = c.swing.balance * (math.sin(x[SWING]) - sin)
    F[ROTATION_OFFSET, SWING_RATE] = -c.swing.balance * sin * lost * tau
    swung = _swing_share(x[SWING_RATE]) * abs(x[SWING_RATE]) * dt
    Q[ROTATION_OFFSET, ROTATION_OFFSET] += c.swing.balance_density * swung


@compiled
def propagate_swing_covariance(P: FloatArray, F: FloatArray) -> None:
    """Propagate P by off-diagonal entries of F, in place: of x_I by σ and σ̇, of σ by σ̇."""
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
