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

from trackslip_common.compiled import compiled
from trackslip_common.parameters import parameter
from trackslip_estimation.slip.models.model import ICR, Gaussian
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

LEFT_CENTRE, RIGHT_CENTRE = FIRST, SECOND
_NARROWEST = 0.1  # m between the two centres, however little the vehicle resists to turn


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

    def constants(self) -> dict[str, float]:
        """What the compiled equations need."""
        unknown = self.noise.initial_centre_stddev**2
        return super().constants() | {"first_variance": unknown, "second_variance": unknown}

    def walk(self, motion: MotionState) -> FloatArray:
        """The centres move in turns only."""
        walk = super().walk(motion)
        if motion.motion is Motion.TURNING:
            walk[LEFT_CENTRE] = walk[RIGHT_CENTRE] = self.noise.centre * self.hurry(motion)
        return walk


@compiled
def equations(x: FloatArray, left: float, right: float, c: Any) -> tuple[float, float]:
    """v in m/s and ω in rad/s but for the misfits: r ω_j (1 − i₀) = v − ω y_j solved for them."""
    hold = c.rolling_radius * (1.0 - x[COMMON_SLIP])
    rate = hold * (right - left) / max(x[LEFT_CENTRE] - x[RIGHT_CENTRE], _NARROWEST)
    return hold * (left + right) / 2.0 + rate * (x[LEFT_CENTRE] + x[RIGHT_CENTRE]) / 2.0, rate


@compiled
def equations_jacobian(x: FloatArray, left: float, right: float, c: Any) -> FloatArray:
    """(3, 10) derivative of v and ω by the state, in the first and last row."""
    J = np.zeros((3, SIZE))
    apart, middle = x[LEFT_CENTRE] - x[RIGHT_CENTRE], (x[LEFT_CENTRE] + x[RIGHT_CENTRE]) / 2.0
    rate = equations(x, left, right, c)[1]
    if apart > _NARROWEST:
        J[2, LEFT_CENTRE], J[2, RIGHT_CENTRE] = -rate / apart, rate / apart
    J[2, COMMON_SLIP] = -c.rolling_radius * (right - left) / max(apart, _NARROWEST)
    J[0] = middle * J[2]
    J[0, LEFT_CENTRE] += rate / 2.0
    J[0, RIGHT_CENTRE] += rate / 2.0
    J[0, COMMON_SLIP] -= c.rolling_radius * (left + right) / 2.0
    return J
