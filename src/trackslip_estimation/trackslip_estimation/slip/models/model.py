# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""What all motion models have in common: the first numbers of the state, and how a model describes itself.

A model is a module of this folder. It names the numbers of its state, each with its unit, gives their prior
and the density of their process noise, and has its equations as compiled functions; ``dispatch`` chooses
between the models.
"""

from typing import NamedTuple

from trackslip_common.arrays import FloatArray

X, Y, YAW, GYRO_BIAS = range(4)  # site frame, m, m, rad; rad/s
GYRO_SCALE, FIX_DELAY = 10, 11  # behind the numbers that each model has of its own
DOWNHILL = 12  # of the models that know how the vehicle turns
POSE = slice(X, YAW + 1)
UNDERCARRIAGE_SIZE = 14  # numbers of a machine that nothing swings on, and no source of which errs by itself
SWING, SWING_RATE = (
    UNDERCARRIAGE_SIZE,
    UNDERCARRIAGE_SIZE + 1,
)  # σ of the upper structure (``swing``) and σ̇, rad, rad/s
SENSOR_ERRORS = SWING_RATE + 1  # of sources that have errors of their own (``source_states``)
MOST_SENSOR_ERRORS = 18
SIZE = SENSOR_ERRORS + MOST_SENSOR_ERRORS  # of every state record; what a model has not is zero
SPEED_TIME = 1.0  # s, for which a speed lasts that nothing shows


class Part(NamedTuple):
    """A named slice of a state."""

    name: str
    at: slice
    unit: str  # of each number, divided by commas
    meaning: str


COMMON = (
    Part("pose", POSE, "m, m, rad", "x, y, heading of the track-contact centre in the site frame"),
    Part("gyro_bias", slice(GYRO_BIAS, GYRO_BIAS + 1), "rad/s", "what a gyro shows of no rotation"),
    Part("gyro_scale", slice(GYRO_SCALE, GYRO_SCALE + 1), "1", "what a gyro shows of 1 rad/s, less 1"),
    Part("fix_delay", slice(FIX_DELAY, FIX_DELAY + 1), "1", "delay of all fixes, over their stamp errors"),
)


class Prior(NamedTuple):
    """What is known at the start, but for the pose."""

    mean: FloatArray  # (SIZE,)
    stddev: FloatArray  # (SIZE,)
