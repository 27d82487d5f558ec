# SPDX-License-Identifier: Apache-2.0
"""What a motion model tells a filter, and what they pass to each other.

Each model's state begins with x, y, φ and ends with the bias of the gyro; all but the pose is constant
plus a walk. Its equations are compiled functions (``equations`` chooses between the models); its numbers
reach them in one ``CONSTANTS`` record.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.slip.motion import MotionState

FloatArray = NDArray[np.float64]

X, Y, YAW = range(3)  # of every model's state: site frame, m, m, rad
POSE = slice(X, YAW + 1)
LARGEST_STATE = 10

FREE_SLIPS, TURNING, ICR = range(3)  # models
SPROCKETS, YAW_RATE, POSITION, FULL_POSE, SLIPS = range(5)  # kinds of measurement

CONSTANTS = np.dtype(
    [
        ("model", np.int64),
        ("sigma_points", np.bool_),  # DAF, else EKF
        ("kappa", np.float64),  # of the DAF
        ("rolling_radius", np.float64),  # r, m
        ("tread", np.float64),  # B, m
        ("encoder_resolution", np.float64),  # rad
        ("encoder", np.float64),  # (3.21), √s
        ("straight_misfit", np.float64),
        ("turning_misfit", np.float64),
        ("changing_misfit", np.float64),
        ("standing_misfit", np.float64),  # m/s
        ("yielding_slip", np.float64),
        ("rate_misfit", np.float64),
        ("misfit_time", np.float64),  # τ, s
        ("first_variance", np.float64),  # of how the vehicle turns and slips, on ground not known yet
        ("second_variance", np.float64),
        ("gentle_turn", np.float64),
        ("slip_variance", np.float64),
        ("walk", np.float64, (4, 2, LARGEST_STATE)),  # variance per s, by motion and whether it changes
    ],
    align=True,
)


class Gaussian(NamedTuple):
    """Mean and covariance of the state."""

    mean: FloatArray  # (n,)
    covariance: FloatArray  # (n, n)


class Measured(NamedTuple):
    """A measurement as the filters take it."""

    kind: int
    value: FloatArray  # (m,) z
    noise: FloatArray  # (m, m) R


DRIVEN = Measured(SPROCKETS, np.empty(0), np.empty((0, 0)))  # a sprocket sample: drives the prediction


@dataclass(frozen=True, eq=False)
class Outputs:
    """What a model's state means, with covariances."""

    twist: FloatArray  # (3,) v_x m/s, v_y m/s, yaw rate rad/s at C
    twist_covariance: FloatArray  # (3, 3)
    slips: FloatArray  # (3,) left slip, right slip, slip angle rad
    slip_covariance: FloatArray  # (3, 3)


class Model(Protocol):
    """The numbers of a motion model; its equations are compiled."""

    @property
    def code(self) -> int:
        """FREE_SLIPS, TURNING or ICR."""

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """A start with known pose (3,) and its covariance (3, 3)."""

    def constants(self) -> dict[str, float]:
        """Fields of ``CONSTANTS``; what the model has no use for is left out."""

    def walk(self, motion: MotionState) -> FloatArray:
        """(n,) standard deviation per √s of each state."""


def rate_measured(rate: float, variance: float) -> Measured:
    """z = φ̇ + b_g of a gyro."""
    return Measured(YAW_RATE, np.array((rate,)), np.array(((variance,),)))


def slips_measured(slips: FloatArray, covariance: FloatArray) -> Measured:
    """z = (i_L, i_R)."""
    value, noise = (np.array(a, dtype=np.float64, order="C") for a in (slips, covariance))
    return Measured(SLIPS, value, noise)


def pose_measured(pose: FloatArray, covariance: FloatArray, use_heading: bool) -> Measured:
    """z = (x, y) and, where wanted, φ."""
    rows = YAW + 1 if use_heading else YAW
    kind = FULL_POSE if use_heading else POSITION
    value = np.array(pose[:rows], dtype=np.float64, order="C")
    return Measured(kind, value, np.array(covariance[:rows, :rows], dtype=np.float64, order="C"))
