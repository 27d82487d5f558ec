# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The records of the attitude filter, which the slip estimator keeps in its own state.

base_link has x forward, y left, z up (REP-103); ψ, θ, φ turn about z, y, x (ZYX), θ > 0 is nose down.
"""

from enum import IntEnum

import numpy as np

ROLL, PITCH, HEIGHT, BIAS_P, BIAS_Q, BIAS_X, BIAS_Y = range(7)  # rad, rad, m, rad/s, rad/s, m/s², m/s²
SIZE = 7


class AttitudeRefusal(IntEnum):
    """Why an orientation or an altitude that was wanted is not used; 0 where it is."""

    NO_ORIENTATION = 1  # its covariance begins with −1
    NO_COVARIANCE = 2  # zeros: it is not known
    NO_ROTATION = 3  # a quaternion of another length than 1
    ORIENTATION_GATED = 4  # it lies outside the gate
    SWING_UNKNOWN = 5  # nobody knows how the IMU, on the upper structure, is turned
    NO_ALTITUDE = 6  # it is no number, or its variance is none
    ALTITUDE_GATED = 7  # it lies outside the gate


LEVEL = (
    np.dtype(  # what the attitude does to a motion along the ground; all zero where it is flat, or not known
        [
            ("tilted", np.int64),  # 0 or 1: whether the rest counts
            ("forward", np.float64),  # cos θ − 1
            ("across", np.float64),  # sin φ sin θ
            ("sideways", np.float64),  # cos φ − 1
            ("turn", np.float64),  # cos φ / cos θ − 1
            ("roll_over", np.float64),  # q sin φ / cos θ, rad/s
            ("downhill_x", np.float64),  # sin θ
            ("downhill_y", np.float64),  # −sin φ cos θ
            ("lean_x", np.float64),  # cos φ sin θ: how far ahead something is that is 1 m above C
            ("lean_y", np.float64),  # −sin φ: how far left
            ("lean_variance", np.float64),  # of both
            ("turn_variance", np.float64),  # density of the yaw rate's that comes of the attitude's, rad²/s
        ],
        align=True,
    )
)

IMU = np.dtype(  # one sample, x and y along its own axes
    [
        ("stamp_ns", np.int64),
        ("rates", np.float64, (3,)),  # p, q, r: rad/s; p and q nan where there are none
        ("rate_variances", np.float64, (3,)),
        ("force", np.float64, (3,)),  # specific force: upward at rest, m/s²; nan where there is none
        ("force_variance", np.float64),
        ("levels", np.int64),  # 0 or 1: whether the force may tell the tilt
        ("up", np.float64, (3,)),  # by its orientation
        ("up_variances", np.float64, (2,)),  # of rotations about x and y, rad²; −1: it has none
        ("oriented", np.int64),  # 0 or 1: whether that may tell the tilt
        ("velocity", np.float64, (2,)),  # of C along the tracks, m/s
        ("known_velocity", np.int64),  # 0 or 1
        ("lever", np.float64, (3,)),  # place of the IMU in base_link, m
        ("turn", np.float64),  # by which its x and y axes are turned against base_link's, rad
        ("turn_variance", np.float64),  # of that, rad²
        ("lost", np.int64),  # 0 or 1: whether nobody knows that, and it tells nothing
        ("cos", np.float64),  # of the turn, once it is used
        ("sin", np.float64),
    ],
    align=True,
)

SPAN = np.dtype(  # see ``span``
    [
        ("begun", np.int64),  # 0 or 1
        ("stamp_ns", np.int64),  # of its last sample, or of its begin
        ("samples", np.int64),
        ("time", np.float64),  # T, s
        ("force", np.float64, (2,)),  # f̄ of x and y, m/s²
        ("lag", np.float64, (2,)),  # of roll and pitch at its end against its mean, times T, rad s
        ("velocity", np.float64, (2,)),  # u₀, m/s
        ("known", np.int64),  # 0 or 1: whether u is, all the time
    ],
    align=True,
)

CLIMB = np.dtype(  # see ``slip.altitude``
    [
        ("used_ns", np.int64),  # stamp of the altitude used last
        ("refused", np.int64),  # altitudes outside the gate since, in a row, that agree
        ("refused_ns", np.int64),  # stamp of the first of them
        ("apart", np.float64),  # its innovation, m
    ],
    align=True,
)

ATTITUDE = np.dtype(
    [
        ("known", np.int64),  # 0 or 1
        ("seen", np.int64),  # whether the IMU has sent anything
        ("stamp_ns", np.int64),  # of its last sample
        ("sample", IMU),  # that one
        ("mean", np.float64, (SIZE,)),
        ("covariance", np.float64, (SIZE, SIZE)),
        ("rates", np.float64, (3,)),  # p, q, r of that sample less their biases, rad/s
        ("mean_force", np.float64, (3,)),  # low-passed, m/s²
        ("span", SPAN),  # of samples whose accelerations have not told the tilt yet
        ("noise", np.float64, (2,)),  # variance of what both horizontal axes show beyond the model, (m/s²)²
        ("noise_count", np.float64, (2,)),  # samples in it
        ("oriented_ns", np.int64),  # stamp of the last orientation that was used
        ("refusal", np.int64),  # ``AttitudeRefusal`` of the last one; 0: it was used, or none is wanted
        ("climb", CLIMB),
        ("level", LEVEL),
    ],
    align=True,
)
