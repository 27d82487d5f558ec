# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Sub-model 1b: the turning behaviour, not the slip, is constant on a soil (symbols: ``speed``).

    κ    turning efficiency, ω = (1 − i₀) (κ D/B + ε V) + m_ω  1
    ε    side asymmetry: unequal tracks or load                rad/m
    η    speed lost in a turn, v = (1 − i₀) (V − η s) + m_v    1
    s    |D|/2 with the sign of V while both tracks run in one direction and the turn is not gentle;
         nearly zero while they counter-rotate                 m/s
    g    |D|/2 over |V| of a gentle turn: s is half of |D|/2   1

κ, η and x_I are observable in turns only, i₀ and ε while driving. On level ground ε is a constant of the
machine. Across a slope the lower track carries more load and slips differently: there ε walks. The equations
are the same in left and right turns: outer and inner track keep their roles. A gentle turn loses less speed
than η |D|/2: on the shear truth (V − v)/(|D|/2) vanishes with D, and has half of its value at |D|/2 of 0.02
to 0.07 V. With a constant ratio, a |D| by rounding of the counts would slow the machine in straight motion.

κ and η depend on each other. The inner track goes at V − |D|/2, and over the ground at V − (κ + η)|D|/2:
where κ + η is 1 it does not slip, and all slip is the outer track's. On the shear truth the sum is 0.7 to 1,
of the Warthog 0.6 to 0.8, while κ alone ranges from 0 to 0.6. So κ and κ + η have independent priors and
random walks, and a gyro that measures less turn also raises the estimated loss of speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_common.compiled import compiled
from trackslip_common.parameters import parameter
from trackslip_common.record_types import Record, dtype_of
from trackslip_estimation.slip.models import speed
from trackslip_estimation.slip.models.model import Part, Prior
from trackslip_estimation.slip.models.speed import (
    COMMON_SLIP,
    TURN_STATE_1,
    TURN_STATE_2,
    SpeedNoise,
    noise_scale,
)
from trackslip_estimation.slip.motion import Motion, MotionState

if TYPE_CHECKING:
    from trackslip_estimation.slip.config import Config


CODE, NAME, ACTIVE = 1, "turning", speed.ACTIVE + 1
EFFICIENCY, LOSS, ASYMMETRY = TURN_STATE_1, TURN_STATE_2, speed.ACTIVE
PARTS = (
    *speed.PARTS,
    Part("efficiency", slice(EFFICIENCY, EFFICIENCY + 1), "1", "turning efficiency κ"),
    Part("loss", slice(LOSS, LOSS + 1), "1", "speed lost in a turn, η"),
    Part(
        "asymmetry", slice(ASYMMETRY, ASYMMETRY + 1), "rad/m", "side asymmetry: yaw to the left per metre, ε"
    ),
)
_ASYMMETRY_WALK = 0.04  # random walk of ε per sine of the cross slope, rad/m/√m


class TurningConstants(Record):
    """Constants of the model in compiled code."""

    gentle_turn: float


CONSTANTS = dtype_of(TurningConstants)


@dataclass(frozen=True, kw_only=True)
class TurningNoise(SpeedNoise):
    """Parameters of the turning model."""

    efficiency: float = parameter(
        "random walk of the turning efficiency κ, while turning", unit="1/√s", ge=0.0
    )
    loss: float = parameter("random walk of κ + η, while turning", unit="1/√s", ge=0.0)
    gentle_turn: float = parameter(
        "|D|/2 over V at which a turn loses half of the speed that η gives", ge=0.0
    )
    initial_efficiency: float = parameter("κ before the first turn", gt=0.0, le=1.0)
    initial_efficiency_stddev: float = parameter("standard deviation of κ before the first turn", gt=0.0)
    initial_loss: float = parameter("η before the first turn", ge=0.0, le=1.0)
    initial_loss_stddev: float = parameter("standard deviation of κ + η before the first turn", gt=0.0)
    initial_asymmetry_stddev: float = parameter(
        "standard deviation of ε about 0 at the start", unit="rad/m", ge=0.0
    )


def prior(n: TurningNoise, tread: float) -> Prior:
    """Prior at rest, with typical turning and no slip."""
    start = speed.prior(n, tread)
    start.mean[EFFICIENCY], start.mean[LOSS] = n.initial_efficiency, n.initial_loss
    start.stddev[EFFICIENCY], start.stddev[LOSS] = n.initial_efficiency_stddev, n.initial_loss_stddev
    start.stddev[ASYMMETRY] = n.initial_asymmetry_stddev
    return start


def process_noise_density(n: TurningNoise, motion: MotionState) -> FloatArray:
    """(SIZE,) per √s: κ and η walk in turns only."""
    density = speed.process_noise_density(n, motion)
    if motion.motion is Motion.TURNING:
        scale = noise_scale(n, motion)
        density[EFFICIENCY], density[LOSS] = n.efficiency * scale, n.loss * scale
    return density


def constants(n: TurningNoise) -> dict[str, float]:
    """The fields of ``CONSTANTS``."""
    return {"gentle_turn": n.gentle_turn}


def velocity_error_constants(n: TurningNoise) -> dict[str, float]:
    """The fields of ``speed.CONSTANTS``."""
    return speed.constants(n, (n.initial_efficiency_stddev, n.initial_loss_stddev))


@compiled
def couple_turn_states(P: FloatArray, variance: float) -> None:
    """Couple η in P (n, n) to a ``variance`` that was added to κ: κ + η keeps its variance; in place."""
    P[LOSS, LOSS] += variance
    P[EFFICIENCY, LOSS] -= variance
    P[LOSS, EFFICIENCY] -= variance


@compiled
def add_slope_noise(Q: FloatArray, distance: float, across: float) -> None:
    """Add the random walk of ε to Q over ``distance`` m of track on a cross slope of sine ``across``."""
    Q[ASYMMETRY, ASYMMETRY] += _ASYMMETRY_WALK * _ASYMMETRY_WALK * across * across * distance


@compiled
def turn_speed_loss(V: float, D: float, c: Config) -> float:
    """s, m/s: odd in V, as a turn in reverse mirrors one forward; the cube is measured."""
    half = abs(D) / 2.0
    if half == 0.0:
        return 0.0
    share = half / (half + c.turning.gentle_turn * abs(V))
    ratio = min(max(V / half, -1.0), 1.0)
    lost: float = half * share * (ratio * ratio * ratio)
    return lost


@compiled
def equations(x: FloatArray, left: float, right: float, c: Config) -> tuple[float, float]:
    """v in m/s and ω in rad/s without the velocity errors."""
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    travel_ratio = 1.0 - x[COMMON_SLIP]
    v = travel_ratio * (V - x[LOSS] * turn_speed_loss(V, D, c))
    return v, travel_ratio * (x[EFFICIENCY] * D / c.tread + x[ASYMMETRY] * V)


@compiled
def twist(x: FloatArray, left: float, right: float, c: Config) -> tuple[float, float, float]:
    """v_x m/s, v_y m/s, ω rad/s of C."""
    v, rate = equations(x, left, right, c)
    return speed.twist(x, v, rate)


@compiled
def twist_jacobian(x: FloatArray, left: float, right: float, c: Config) -> FloatArray:
    """(3, SIZE) derivative of ``twist`` by the state."""
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    J, travel_ratio, loss = np.zeros((3, x.size)), 1.0 - x[COMMON_SLIP], turn_speed_loss(V, D, c)
    rate = x[EFFICIENCY] * D / c.tread + x[ASYMMETRY] * V
    J[0, COMMON_SLIP], J[0, LOSS] = x[LOSS] * loss - V, -travel_ratio * loss
    J[2, COMMON_SLIP] = -rate
    J[2, EFFICIENCY], J[2, ASYMMETRY] = travel_ratio * D / c.tread, travel_ratio * V
    speed.complete_jacobian(x, travel_ratio * rate, J)
    return J
