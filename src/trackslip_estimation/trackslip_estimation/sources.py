# SPDX-License-Identifier: Apache-2.0
"""What the estimator is told of each source, and what of a measurement belongs to its sensor.

l = (l_x, l_y)   place of a sensor that measures poses, in base_link   m
p_s = p + R(φ) l its place in the site frame                          m
T                derivative of (p_s, φ) by (p, φ), within the state
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from trackslip_common.errors import InputError
from trackslip_estimation.filters.model import YAW, Gaussian, X, Y
from trackslip_estimation.measurements import PoseFix, YawRate

FloatArray = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True)
class PoseSource:
    """A source of poses."""

    use_heading: bool
    lever: tuple[float, float]  # m, l
    position_floor: float  # m, smallest standard deviation that is believed
    heading_floor: float  # rad
    heading_ceiling: float  # rad, standard deviation beyond which a fix's heading is not used
    timeout_ns: int

    def prepared(self, fix: PoseFix) -> PoseFix:
        """The fix with no variance below the floors."""
        heading_floor = self.heading_floor if self.use_heading else 0.0
        floors = np.square((self.position_floor, self.position_floor, heading_floor))
        missing = np.maximum(floors - np.diag(fix.covariance), 0.0)
        return replace(fix, covariance=fix.covariance + np.diag(missing)) if missing.any() else fix

    def tells_heading(self, fix: PoseFix) -> bool:
        """Whether the fix's heading is a measurement: a doubtful one may be wrong by whole quarter turns."""
        return self.use_heading and fix.covariance[YAW, YAW] <= self.heading_ceiling**2

    @property
    def is_apart(self) -> bool:
        """Whether the sensor is not at base_link."""
        return self.lever != (0.0, 0.0)

    def to_sensor(self, state: Gaussian) -> Gaussian:
        """The state with the sensor's place for that of base_link: a fix then measures it directly."""
        return _shifted(state, self.lever, 1.0)

    def from_sensor(self, state: Gaussian) -> Gaussian:
        """Back again."""
        return _shifted(state, self.lever, -1.0)


@dataclass(frozen=True)
class YawRateSource:
    """A gyro."""

    sign: int  # −1 where it is mounted upside down
    timeout_ns: int

    def prepared(self, measurement: YawRate) -> YawRate:
        """Positive to the left."""
        return measurement if self.sign == 1 else replace(measurement, rate=-measurement.rate)


def named(sources: Sequence[str]) -> list[str]:
    """The sources of a parameter list; '' names none."""
    return [source for source in sources if source]


def each(parameter: str, values: Sequence[T], sources: Sequence[str]) -> list[T]:
    """A parameter's value for each source: one holds for all.

    Raises:
        InputError: there are neither one nor as many as there are sources.
    """
    names = named(sources)
    if len(set(names)) < len(names):
        raise InputError(f"sources {', '.join(names)}: one is named twice; accepted: each once")
    if len(values) not in (1, len(names)):
        raise InputError(
            f"{parameter}: {len(values)} values for the sources '{', '.join(names)}'; "
            "accepted: one for all, or one for each"
        )
    return list(values) * len(names) if len(values) == 1 else list(values)


def _shifted(state: Gaussian, lever: tuple[float, float], sign: float) -> Gaussian:
    """p ± R(φ) l, with the covariance that goes with it."""
    if lever == (0.0, 0.0):
        return state
    c, s = np.cos(state.mean[YAW]), np.sin(state.mean[YAW])
    east, north = sign * (c * lever[0] - s * lever[1]), sign * (s * lever[0] + c * lever[1])
    mean, T = state.mean.copy(), np.eye(state.mean.size)
    mean[X] += east
    mean[Y] += north
    T[X, YAW], T[Y, YAW] = -north, east
    return Gaussian(mean, T @ state.covariance @ T.T)
