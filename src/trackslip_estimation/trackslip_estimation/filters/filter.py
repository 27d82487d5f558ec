# SPDX-License-Identifier: Apache-2.0
"""EKF or DAF over any model: one compiled call a step."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.compiled import compiled
from trackslip_estimation.filters import daf, ekf, equations
from trackslip_estimation.filters.model import (
    CONSTANTS,
    FREE_SLIPS,
    Gaussian,
    Measured,
    Model,
    Outputs,
    sprockets_measured,
)
from trackslip_estimation.motion import Motion, MotionState, Speeds

FloatArray = NDArray[np.float64]
RecordArray = NDArray[np.void]


class Held(NamedTuple):
    """A measurement held against the prediction."""

    nis: float  # normalised innovation squared, χ² if all is honest
    dof: int  # degrees of freedom
    updated: Gaussian  # the state, should the measurement be taken


class Filter:
    """One model under one filter; holds no state."""

    def __init__(self, model: Model, kappa: float | None = None) -> None:
        """EKF, or with a ``kappa`` DAF."""
        self.model = model
        self.constants = _constants(model, kappa)

    def initial(self, pose: FloatArray, pose_covariance: FloatArray) -> Gaussian:
        """A start with known pose (3,) and its covariance (3, 3)."""
        return self.model.initial(pose, pose_covariance)

    def predict(self, state: Gaussian, speeds: Speeds, dt: float, motion: MotionState) -> Gaussian:
        """The state ``dt`` s later."""
        x, P = state
        left, right, _, _ = speeds
        return Gaussian(
            *_predict(x, P, left, right, dt, int(motion.motion), int(motion.changing), self.constants)
        )

    def hold(self, state: Gaussian, speeds: Speeds, measured: Measured) -> Held:
        """What a measurement would make of the state."""
        kind, z, R = measured
        x, P, nis = _update(kind, *state, z, R, *speeds, self.constants)
        return Held(nis, z.size, Gaussian(x, P))

    def drive(self, state: Gaussian, speeds: Speeds) -> Gaussian:
        """What a sprocket sample says of the state, beyond driving the prediction."""
        measured = None if self.model.code == FREE_SLIPS else sprockets_measured(speeds)
        return state if measured is None else self.hold(state, speeds, measured).updated

    def outputs(self, state: Gaussian, speeds: Speeds) -> Outputs:
        """Twist and slips."""
        return Outputs(*_outputs(*state, speeds.left, speeds.right, self.constants))


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
    x: FloatArray, P: FloatArray, left: float, right: float, dt: float, motion: int, changing: int, c: Any
) -> tuple[FloatArray, FloatArray]:
    """x' and P' by the filter that c names."""
    if c.sigma_points:
        return daf.predict(x, P, left, right, dt, motion, changing, c)
    return ekf.predict(x, P, left, right, dt, motion, changing, c)


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
    R = equations.noise(kind, R, left, right, stretch, counted, c)
    if c.sigma_points:
        return daf.update(kind, x, P, z, R, left, right, c)
    return ekf.update(kind, x, P, z, R, left, right, c)


@compiled
def _predict(
    x: FloatArray,
    P: FloatArray,
    left: float,
    right: float,
    dt: float,
    motion: int,
    changing: int,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray]:
    """``predict`` as called from Python: arrays cross over faster than records."""
    return predict(x, P, left, right, dt, motion, changing, constants[0])


@compiled
def _update(
    kind: int,
    x: FloatArray,
    P: FloatArray,
    z: FloatArray,
    R: FloatArray,
    left: float,
    right: float,
    stretch: float,
    counted: bool,
    constants: RecordArray,
) -> tuple[FloatArray, FloatArray, float]:
    """``update`` as called from Python."""
    return update(kind, x, P, z, R, left, right, stretch, counted, constants[0])


@compiled
def _outputs(
    x: FloatArray, P: FloatArray, left: float, right: float, constants: RecordArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """``equations.outputs`` as called from Python."""
    return equations.outputs(x, P, left, right, constants[0])
