# SPDX-License-Identifier: Apache-2.0
"""Sub-model 1b: not the slips are constant on a soil, but how the vehicle turns (symbols: ``speed_model``).

    κ    turning efficiency, ω = κ D/B                  1
    η    speed lost in a turn, v = (1 − i₀) V − η |D|/2 1

κ, η and x_I learn in turns only, i₀ while driving. The equations are the same in left and right turns:
outer and inner track keep their roles.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import parameter
from trackslip_estimation.compiled import compiled
from trackslip_estimation.filters.model import TURNING, Gaussian
from trackslip_estimation.filters.speed_model import (
    COMMON_SLIP,
    FIRST,
    RATE,
    SECOND,
    SIZE,
    SPEED,
    SpeedModel,
    SpeedNoise,
    misfit_variance,
)
from trackslip_estimation.motion import Motion, MotionState

FloatArray = NDArray[np.float64]

EFFICIENCY, LOSS = FIRST, SECOND


@dataclass(frozen=True, kw_only=True)
class TurningNoise(SpeedNoise):
    """Numbers of the turning model."""

    efficiency: float = parameter("turning efficiency κ, while turning", unit="1/√s", ge=0.0)
    loss: float = parameter("turn loss η, while turning", unit="1/√s", ge=0.0)
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

    def walk(self, motion: MotionState) -> FloatArray:
        """κ and η change in turns only."""
        walk = super().walk(motion)
        if motion.motion is Motion.TURNING:
            walk[EFFICIENCY], walk[LOSS] = self.noise.efficiency, self.noise.loss
        return walk


@compiled
def sprockets(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(2,) v − (1 − i₀) V + η |D|/2 in m/s and ω − κ D/B in rad/s, both measured as zero."""
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    return np.array(
        (
            x[SPEED] - (1.0 - x[COMMON_SLIP]) * V + x[LOSS] * abs(D) / 2.0,
            x[RATE] - x[EFFICIENCY] * D / c.tread,
        )
    )


@compiled
def sprockets_jacobian(left: float, right: float, c: Any) -> FloatArray:
    """(2, 10) derivative of ``sprockets`` by the state."""
    V, D = c.rolling_radius * (left + right) / 2.0, c.rolling_radius * (right - left)
    H = np.zeros((2, SIZE))
    H[0, SPEED], H[0, COMMON_SLIP], H[0, LOSS] = 1.0, V, abs(D) / 2.0
    H[1, RATE], H[1, EFFICIENCY] = 1.0, -D / c.tread
    return H


@compiled
def sprockets_noise(left: float, right: float, stretch: float, rounding: float, c: Any) -> FloatArray:
    """R (2, 2); ``rounding`` is the variance of one track's speed from counting, (m/s)²."""
    misfit = misfit_variance(left, right, stretch, c)
    return np.array(((misfit + rounding / 2.0, 0.0), (0.0, (misfit + 2.0 * rounding) / c.tread**2)))
