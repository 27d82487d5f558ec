# SPDX-License-Identifier: Apache-2.0
"""The tracks' instantaneous centres of rotation (Martínez & Mandow; Pentzer 2014) as states.

    y_L, y_R   where each track would have to run not to slip, left of C    m     r ω_j (1 − i₀) = v − ω y_j

Symbols else: ``speed_model``. Without slip y_L = B/2 and y_R = −B/2. Suits wheels, whose centres stay
put; those of tracks change sides with the sense of the turn, and run away on weak soil.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trackslip_common.parameters import parameter
from trackslip_estimation.compiled import compiled
from trackslip_estimation.filters.model import ICR, Gaussian
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

LEFT_CENTRE, RIGHT_CENTRE = FIRST, SECOND


@dataclass(frozen=True, kw_only=True)
class IcrNoise(SpeedNoise):
    """Numbers of the ICR model."""

    centre: float = parameter("y_L and y_R, while turning", unit="m/√s", ge=0.0)
    initial_centre: float = parameter("y_L = −y_R before the first turn", unit="m", gt=0.0)
    initial_centre_stddev: float = parameter("its standard deviation", unit="m", gt=0.0)


@dataclass(frozen=True)
class IcrModel(SpeedModel):
    """Numbers of the model for one vehicle (a ``model.Model``)."""

    noise: IcrNoise

    code = ICR

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """At rest, with typical centres and no slip."""
        mean, covariance = super().initial(pose, pose_covariance)
        n = self.noise
        mean[LEFT_CENTRE], mean[RIGHT_CENTRE] = n.initial_centre, -n.initial_centre
        covariance[LEFT_CENTRE, LEFT_CENTRE] = n.initial_centre_stddev**2
        covariance[RIGHT_CENTRE, RIGHT_CENTRE] = n.initial_centre_stddev**2
        return Gaussian(mean, covariance)

    def walk(self, motion: MotionState) -> FloatArray:
        """The centres move in turns only."""
        walk = super().walk(motion)
        if motion.motion is Motion.TURNING:
            walk[LEFT_CENTRE] = walk[RIGHT_CENTRE] = self.noise.centre
        return walk


@compiled
def sprockets(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(2,) v − ω y_j − r ω_j (1 − i₀) in m/s, left and right, both measured as zero."""
    hold = c.rolling_radius * (1.0 - x[COMMON_SLIP])
    return np.array(
        (
            x[SPEED] - x[RATE] * x[LEFT_CENTRE] - left * hold,
            x[SPEED] - x[RATE] * x[RIGHT_CENTRE] - right * hold,
        )
    )


@compiled
def sprockets_jacobian(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(2, 10) derivative of ``sprockets`` by the state."""
    H = np.zeros((2, SIZE))
    H[0, SPEED] = H[1, SPEED] = 1.0
    H[0, RATE], H[1, RATE] = -x[LEFT_CENTRE], -x[RIGHT_CENTRE]
    H[0, LEFT_CENTRE] = H[1, RIGHT_CENTRE] = -x[RATE]
    H[0, COMMON_SLIP], H[1, COMMON_SLIP] = c.rolling_radius * left, c.rolling_radius * right
    return H


@compiled
def sprockets_noise(left: float, right: float, stretch: float, rounding: float, c: Any) -> FloatArray:
    """R (2, 2); ``rounding`` is the variance of one track's speed from counting, (m/s)²."""
    return np.eye(2) * (misfit_variance(left, right, stretch, c) + rounding)
