# SPDX-License-Identifier: Apache-2.0
"""What the slip estimator takes in, and what it says it did with each piece."""

from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_ROUNDING = 1e-9  # of a correlation of 1


@dataclass(frozen=True)
class Sprockets:
    """Both sprockets; positive drives forward.

    Positions (continuous) are preferred: their differences do not accumulate quantisation. They are
    None in logs that hold speeds only.
    """

    source: str
    stamp_ns: int
    left_speed: float  # rad/s
    right_speed: float  # rad/s
    positions: tuple[float, float] | None = None  # rad, left and right

    def is_finite(self) -> bool:
        """Whether every number given is a number."""
        return bool(np.isfinite((self.left_speed, self.right_speed, *(self.positions or ()))).all())


@dataclass(frozen=True)
class YawRate:
    """Rate of turn of the machine about the vertical."""

    source: str
    stamp_ns: int
    rate: float  # rad/s
    variance: float  # (rad/s)²

    def is_finite(self) -> bool:
        """Whether the rate is a number and its variance a positive one."""
        return bool(np.isfinite(self.rate) and np.isfinite(self.variance) and self.variance > 0.0)


@dataclass(frozen=True, eq=False)
class PoseFix:
    """Pose of base_link in the site frame."""

    source: str
    stamp_ns: int
    pose: FloatArray  # (3,) x m, y m, heading rad
    covariance: FloatArray  # (3, 3)

    def is_finite(self) -> bool:
        """Whether pose and covariance are numbers, and the variance positive in every direction."""
        if not (np.isfinite(self.pose).all() and np.isfinite(self.covariance).all()):
            return False
        variances = np.diag(self.covariance)
        if not (variances > 0.0).all():
            return False
        deviations = np.sqrt(variances)
        correlation = self.covariance / np.outer(deviations, deviations)
        return bool(np.linalg.eigvalsh(correlation)[0] > -_ROUNDING)


Measurement: TypeAlias = Sprockets | YawRate | PoseFix


class Outcome(IntEnum):
    """What became of a measurement; the numbers are those of ``trackslip_msgs/MeasurementReport``."""

    ACCEPTED = 0
    GATED = 1  # its innovation lies outside the gate
    TOO_LATE = 2  # older than the history, or than the start of the estimate
    DUPLICATE = 3  # same source and stamp as one taken before
    INVALID = 4  # holds nan or infinity, or a variance that is not positive
    WAITING = 5  # no estimate yet: it starts with the first fix


@dataclass(frozen=True)
class Report:
    """What the estimator did with one measurement when it took it."""

    source: str
    stamp_ns: int
    outcome: Outcome
    nis: float = float("nan")  # normalised innovation squared
    gate: float = float("nan")  # its limit
    dof: int = 0
