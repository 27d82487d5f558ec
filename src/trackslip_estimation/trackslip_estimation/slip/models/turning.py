# SPDX-License-Identifier: Apache-2.0
"""Sub-model 1b: not the slips are constant on a soil, but how the vehicle turns (symbols: ``speed_model``).

    κ    turning efficiency, ω = κ D/B + m_ω                   1
    η    speed lost in a turn, v = (1 − i₀) V − η s + m_v      1
    s    |D|/2 against the travel while both tracks run one way and the turn is no gentle one; almost
         nothing while they counter-rotate                     m/s
    g    |D|/2 over |V| of a turn that is gentle: s is half    1

κ, η and x_I learn in turns only, i₀ while driving. The equations are the same in left and right turns:
outer and inner track keep their roles. A gentle turn costs less than η says: on the shear truth
(V − v)/(|D|/2) vanishes with D, and has half of its value at |D|/2 of 0.02 to 0.07 V. Were it constant down
to 0, the rounding of the counts, which makes D of nothing, would slow the machine in straight motion.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_common.parameters import parameter
from trackslip_estimation.slip.models.model import TURNING, Gaussian
from trackslip_estimation.slip.models.speed import (
    COMMON_SLIP,
    FIRST,
    SECOND,
    SIZE,
    SpeedModel,
    SpeedNoise,
)
from trackslip_estimation.slip.motion import Motion, MotionState

FloatArray = NDArray[np.float64]

EFFICIENCY, LOSS = FIRST, SECOND


@dataclass(frozen=True, kw_only=True)
class TurningNoise(SpeedNoise):
    """Numbers of the turning model."""

    efficiency: float = parameter("turning efficiency κ, while turning", unit="1/√s", ge=0.0)
    loss: float = parameter("turn loss η, while turning", unit="1/√s", ge=0.0)
    gentle_turn: float = parameter("|D|/2 over V of a turn that costs half of what η says", ge=0.0)
    initial_efficiency: float = parameter("κ before the first turn", gt=0.0, le=1.0)
    initial_efficiency_stddev: float = parameter("its standard deviation", gt=0.0)
    initial_loss: float = parameter("η before the first turn", ge=0.0, le=1.0)
    initial_loss_stddev: float = parameter("its standard deviation", gt=0.0)


@dataclass(frozen=True)
class TurningModel(SpeedModel):
    """Numbers of the sub-model for one vehicle (a ``model.Model``)."""

    noise: TurningNoise

    code = TURNING

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """At rest, with typical turning and no slip."""
        mean, covariance = super().initial(pose, pose_covariance)
        n = self.noise
        mean[EFFICIENCY], mean[LOSS] = n.initial_efficiency, n.initial_loss
        covariance[EFFICIENCY, EFFICIENCY] = n.initial_efficiency_stddev**2
        covariance[LOSS, LOSS] = n.initial_loss_stddev**2
        return Gaussian(mean, covariance)

    def constants(self) -> dict[str, float]:
        """What the compiled equations need."""
        n = self.noise
        unknown = {
            "first_variance": n.initial_efficiency_stddev**2,
            "second_variance": n.initial_loss_stddev**2,
        }
        return super().constants() | unknown | {"gentle_turn": n.gentle_turn}

    def walk(self, motion: MotionState) -> FloatArray:
        """κ and η change in turns only."""
        walk = super().walk(motion)
        if motion.motion is Motion.TURNING:
            hurry = self.hurry(motion)
            walk[EFFICIENCY], walk[LOSS] = self.noise.efficiency * hurry, self.noise.loss * hurry
        return walk


@compiled
def lag(V: float, D: float, c: Any) -> float:
    """s, m/s: odd in the travel, as a turn in reverse mirrors the one forward; the cube is measured."""
    half = abs(D) / 2.0
    if half == 0.0:
        return 0.0
    share = half / (half + float(c.gentle_turn) * abs(V))
    return half * share * min(max(V / half, -1.0), 1.0) ** 3


@compiled
def equations(x: FloatArray, left: float, right: float, c: Any) -> tuple[float, float]:
    """v in m/s and ω in rad/s but for the misfits."""
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    return (1.0 - x[COMMON_SLIP]) * V - x[LOSS] * lag(V, D, c), x[EFFICIENCY] * D / c.tread


@compiled
def equations_jacobian(left: float, right: float, c: Any) -> FloatArray:
    """(3, 10) derivative of v and ω by the state, in the first and last row."""
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    J = np.zeros((3, SIZE))
    J[0, COMMON_SLIP], J[0, LOSS] = -V, -lag(V, D, c)
    J[2, EFFICIENCY] = D / c.tread
    return J
