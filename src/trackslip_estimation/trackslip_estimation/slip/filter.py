# SPDX-License-Identifier: Apache-2.0
"""EKF or DAF over any model: one compiled call a step."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_common.compiled import compiled
from trackslip_estimation.kalman import daf, ekf
from trackslip_estimation.slip.models import dispatch as equations
from trackslip_estimation.slip.models.model import (
    CONSTANTS,
    DRIVEN,
    SPROCKETS,
    Gaussian,
    Measured,
    Model,
    Outputs,
)
from trackslip_estimation.slip.motion import STANDSTILL, Motion, MotionState, Speeds

FloatArray = NDArray[np.float64]
RecordArray = NDArray[np.void]


class Held(NamedTuple):
    """A measurement held against the prediction."""

    predicted: Gaussian  # the state without it
    updated: Gaussian  # the state, should it be taken
    nis: float  # normalised innovation squared, χ² if all is honest


class Filter:
    """One model under one filter; holds no state."""

    def __init__(self, model: Model, kappa: float | None = None) -> None:
        """EKF, or with a ``kappa`` DAF."""
        self.model = model
        self.constants = _constants(model, kappa)
        start = self.initial(np.zeros(3), np.eye(3))
        self.step(start, STANDSTILL, 0.0, MotionState(), DRIVEN)  # compiles now, not at the first measurement
        self.outputs(start, STANDSTILL)

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """A start with known pose (3,) and its covariance (3, 3)."""
        return self.model.initial(pose, pose_covariance)

    def step(
        self, state: Gaussian, speeds: Speeds, dt: float, motion: MotionState, measured: Measured
    ) -> Held:
        """The state ``dt`` s later, and what a measurement would make of it."""
        kind, z, R = measured
        x, P, x_updated, P_updated, nis = _step(
            kind,
            *state,
            z,
            R,
            speeds.left,
            speeds.right,
            speeds.stretch,
            speeds.differenced,
            dt,
            int(motion.motion),
            int(motion.changing),
            motion.departure,
            self.constants,
        )
        return Held(Gaussian(x, P), Gaussian(x_updated, P_updated), nis)

    def outputs(self, state: Gaussian, speeds: Speeds) -> Outputs:
        """Twist and slips."""
        return Outputs(
            *_outputs(*state, speeds.left, speeds.right, speeds.stretch, speeds.differenced, self.constants)
        )


def _constants(model: Model, kappa: float | None) -> RecordArray:
    """(1,) record of ``CONSTANTS``."""
    record = np.zeros(1, CONSTANTS)
    record["model"], record["sigma_points"], record["kappa"] = model.code, kappa is not None, kappa or 0.0
    for name, value in model.constants().items():
        record[name] = value
    for motion in Motion:
        for changing in (False, True):
            walk = model.walk(MotionState(motion, changing))
            record["walk"][0, motion, int(changing), : walk.size] = np.square(walk)
    return record


@compiled
def predict(
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    dt: float,
    motion: int,
    changing: int,
    departure: float,
    c: Any,
) -> tuple[FloatArray, FloatArray]:
    """x' and P' by the filter that c names."""
    if c.sigma_points:
        return daf.predict(x, P, left, right, dt, motion, changing, departure, c)
    return ekf.predict(x, P, left, right, dt, motion, changing, departure, c)


@compiled
def update(
    kind: int,
    x: FloatArray,
    P: FloatArray,
    z: FloatArray,
    R: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    c: Any,
) -> tuple[FloatArray, FloatArray, float]:
    """x', P' and NIS by the filter that c names."""
    R = equations.noise(kind, x, R, left, right, stretch, counted, c)
    if c.sigma_points:
        return daf.update(kind, x, P, z, R, left, right, c)
    return ekf.update(kind, x, P, z, R, left, right, c)


@compiled
def step(
    kind: int,
    x: FloatArray,
    P: FloatArray,
    z: FloatArray,
    R: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    dt: float,
    motion: int,
    changing: int,
    departure: float,
    c: Any,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Predicted x and P, then x', P' and NIS; sprockets say no more than they drove: nan."""
    x, P = predict(x, P, left, right, dt, motion, changing, departure, c)
    if kind == SPROCKETS:
        return x, P, x, P, np.nan
    x_updated, P_updated, nis = update(kind, x, P, z, R, left, right, stretch, counted, c)
    return x, P, x_updated, P_updated, nis


@compiled
def _step(
    kind: int,
    x: FloatArray,
    P: FloatArray,
    z: FloatArray,
    R: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    dt: float,
    motion: int,
    changing: int,
    departure: float,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """``step`` as called from Python: arrays cross over faster than records."""
    return step(
        kind, x, P, z, R, left, right, stretch, counted, dt, motion, changing, departure, constants[0]
    )


@compiled
def _outputs(
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """``equations.outputs`` as called from Python."""
    return equations.outputs(x, P, left, right, stretch, counted, constants[0])
