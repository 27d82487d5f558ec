# SPDX-License-Identifier: Apache-2.0
"""What the estimator is told of each source."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from trackslip_common.errors import InputError
from trackslip_estimation.slip.gating import shifted
from trackslip_estimation.slip.measurements import PoseFix, YawRate
from trackslip_estimation.slip.models.model import YAW, Gaussian, Measured, pose_measured

T = TypeVar("T")


@dataclass(frozen=True)
class PoseSource:
    """A source of poses."""

    use_heading: bool
    lever: tuple[float, float]  # m, place of the sensor in base_link
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

    def measured(self, fix: PoseFix) -> Measured:
        """A prepared fix as the filter takes it."""
        return pose_measured(fix.pose, fix.covariance, self.tells_heading(fix))

    def to_sensor(self, state: Gaussian) -> Gaussian:
        """The state with the sensor's place for that of base_link: a fix then measures it directly."""
        return Gaussian(*shifted(*state, np.array(self.lever), 1.0))

    def from_sensor(self, state: Gaussian) -> Gaussian:
        """Back again."""
        return Gaussian(*shifted(*state, np.array(self.lever), -1.0))


@dataclass(frozen=True)
class YawRateSource:
    """A gyro."""

    sign: int  # −1 where it is mounted upside down
    scale: float  # what it shows of 1 rad/s
    timeout_ns: int

    def prepared(self, measurement: YawRate) -> YawRate:
        """Positive to the left, in true rad/s."""
        if self.sign == 1 and self.scale == 1.0:
            return measurement
        rate, variance = self.sign * measurement.rate / self.scale, measurement.variance / self.scale**2
        return replace(measurement, rate=rate, variance=variance)


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
