# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""States that all motion models share, and the records by which a model describes itself.

A model is a module of this folder. It names its states, each with its unit, and gives their prior, the
density of their process noise, and its equations as compiled functions; ``dispatch`` selects the model.
"""

from typing import NamedTuple

from trackslip_common.arrays import FloatArray

X, Y, YAW, GYRO_BIAS = range(4)  # site frame, m, m, rad; rad/s
GYRO_SCALE, FIX_DELAY = 10, 11  # behind the states of each model
DOWNHILL = 12  # k of the models with turn states
POSE = slice(X, YAW + 1)
UNDERCARRIAGE_SIZE = 14  # states without swing and sensor errors
SWING, SWING_RATE = UNDERCARRIAGE_SIZE, UNDERCARRIAGE_SIZE + 1  # σ and σ̇ (``swing``), rad, rad/s
SENSOR_ERRORS = SWING_RATE + 1  # first sensor error (``source_offsets``)
MOST_SENSOR_ERRORS = 18
SIZE = SENSOR_ERRORS + MOST_SENSOR_ERRORS  # of every state record; unused states are zero
SPEED_TIME = 1.0  # s, correlation time of an unobserved speed that is no state


class Part(NamedTuple):
    """A named slice of a state."""

    name: str
    at: slice
    unit: str  # of each state, separated by commas
    meaning: str


COMMON = (
    Part("pose", POSE, "m, m, rad", "x, y, heading of the track-contact centre in the site frame"),
    Part("gyro_bias", slice(GYRO_BIAS, GYRO_BIAS + 1), "rad/s", "gyro bias"),
    Part("gyro_scale", slice(GYRO_SCALE, GYRO_SCALE + 1), "1", "gyro scale error"),
    Part("fix_delay", slice(FIX_DELAY, FIX_DELAY + 1), "1", "delay of all fixes, over their stamp errors"),
)


class Prior(NamedTuple):
    """Mean and standard deviation of the states at the start, except for the pose."""

    mean: FloatArray  # (SIZE,)
    stddev: FloatArray  # (SIZE,)
