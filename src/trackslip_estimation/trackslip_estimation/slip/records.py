# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The records that pass through the compiled estimator: what is measured, what is known, what became of it.

Arrays of them cross from Python as one argument each. Angles in rad, lengths in m, times in ns.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.attitude.records import ATTITUDE
from trackslip_estimation.slip.adaptation import FIX_FACTORS, RATE_FACTORS, TRACK_ERRORS
from trackslip_estimation.slip.correlated_errors import MOST_RECEIVERS
from trackslip_estimation.slip.measurements import (
    SET_POSE,
    HeadingFix,
    Measurement,
    OdometryPose,
    PoseFix,
    SlipFix,
    Sprockets,
    SwingAngle,
    YawRate,
)
from trackslip_estimation.slip.models.model import SIZE
from trackslip_estimation.slip.motion import MOTION, SPEEDS

MOST_SOURCES = 12  # gyros, poses, slips, headings and odometries together
MOST_ODOMETRIES = 2

SPROCKETS, YAW_RATE, POSE, SLIPS, HEADING, ODOMETRY, ON_SWING = range(7)  # kinds, in the order at one stamp

MEASUREMENT = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("kind", np.int64),
        ("source", np.int64),  # number in ``Sources``; MANUAL is a user's
        ("left_speed", np.float64),  # of the sprockets, rad/s
        ("right_speed", np.float64),
        ("left_angle", np.float64),  # rad, continuous; nan where there is none
        ("right_angle", np.float64),
        (
            "value",
            np.float64,
            (3,),
        ),  # z of all others: rad/s about z, x, y; m, m, rad; left and right slip; rad
        ("noise", np.float64, (3, 3)),  # R, as its source states it; of odometry, variances in two rows
        ("turn", np.float64, (4,)),  # of odometry, whose value is a place: quaternion x, y, z, w
        ("frame", np.int64),  # and number of its odom frame
        ("altitude", np.float64),  # of a pose, m
        ("altitude_variance", np.float64),  # m²
        ("acceleration", np.float64, (3,)),  # of an IMU: specific force, m/s²; nan where it has none
        ("acceleration_variance", np.float64),  # (m/s²)²
        ("up", np.float64, (3,)),  # by its orientation, of any length about 1
        ("up_variances", np.float64, (2,)),  # rad²; −1: it has none
    ],
    align=True,
)
MANUAL = MOST_SOURCES - 1  # the source number of a manual pose: the last of those with one stamp

SAMPLE = np.dtype(
    [
        ("seen", np.bool_),  # whether there was one
        ("stamp_ns", np.int64),  # of the start where there was none
        ("left_angle", np.float64),
        ("right_angle", np.float64),
        ("known", np.bool_),  # whether the interval that it closed shows speeds
        ("speeds", SPEEDS),  # of that interval
    ],
    align=True,
)

STREAK = np.dtype([("count", np.int64), ("value", np.float64), ("departure", np.float64)], align=True)

ADAPTATION = np.dtype(
    [
        ("track_variance", np.float64),  # s², posterior mean
        ("rate_factor", np.float64),  # a, of the variance of yaw rates
        ("log_weights", np.float64, (TRACK_ERRORS, RATE_FACTORS)),  # w of both
        ("envelope", np.float64),  # E, (m/s)²
        ("exposure", np.float64),  # T, (rad/s)²
        ("elapsed", np.float64),  # s since the last yaw rate
        ("speed_exposure", np.float64),  # of m_v, over f² s²/4, since the last odometry, (m/s)²
        ("speed_elapsed", np.float64),  # s since then
        ("left_speed", np.float64),  # of the sprockets in the interval before, rad/s
        ("right_speed", np.float64),
        ("fix_factors", np.float64, (MOST_SOURCES,)),  # f, of the covariance of each source's fixes
        ("fix_log_weights", np.float64, (MOST_SOURCES, FIX_FACTORS)),
        ("fix_innovations", np.float64, (MOST_SOURCES, 2)),  # of the last that taught f
        ("fix_likeness", np.float64, (MOST_SOURCES,)),  # of those that follow each other
    ],
    align=True,
)

ODOMETRY_POSE = np.dtype(  # of a source, at the begin of its next increment
    [
        ("known", np.bool_),
        ("coasting", np.bool_),  # whether the sprockets were silent
        ("stamp_ns", np.int64),
        ("frame", np.int64),
        ("place", np.float64, (3,)),
        ("turn", np.float64, (4,)),
        ("noise", np.float64, (3, 3)),
        ("driven", np.float64, (2,)),  # of the state then
        ("moved", np.float64, (3,)),  # as well
        ("errors", np.float64, (2,)),  # variances of the velocity errors then, (m/s)², (rad/s)²
        ("slip_weight", np.float64),  # of what increments of late say that i₀ is off by, 1/variance
        ("slip_sum", np.float64),  # that times its weight
        ("slip_way", np.float64),  # that the tracks have gone since it is, m
        ("slip_ns", np.int64),  # stamp since when
    ],
    align=True,
)

STAND = np.dtype(  # of a machine, to a source: fixes from there, and the angle of what swings, rad
    [("count", np.int64), ("swing", np.float64)], align=True
)

OFFSET = np.dtype(  # of a source of poses, as ``correlated_errors`` has it
    [
        ("f", np.float64),
        ("g", np.float64),
        ("time", np.float64),  # τ, s
        ("observed", np.float64),  # s, for which the source gave coarse fixes
        ("variance", np.float64),  # a priori of each of its two states, m²; 0: it has none, or an event
        ("stddev", np.float64),  # that the source's last fix stated, m
        ("jitter", np.float64),  # share of that variance which is another one in each fix
        ("count", np.float64),  # fixes that showed it
        ("shown", np.float64, (2,)),  # place that the last fix showed, m
        ("way", np.float64, (2,)),  # of the state then, m
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("mean", np.float64, (SIZE,)),
        ("covariance", np.float64, (SIZE, SIZE)),
        ("speeds", SPEEDS),  # of the sprockets in the interval that led here
        ("motion", MOTION),
        ("shear", np.float64, (2,)),  # of the left and right track, see ``models.shear``
        ("coasting", np.bool_),  # the sprockets have been silent for too long
        ("sample", SAMPLE),  # the last of the sprockets
        ("unheard", np.float64),  # s since it, in the middle of a step in which its speeds are taken to go on
        ("consistent_ns", np.int64, (MOST_SOURCES,)),  # when each source was last inside its plain gate
        ("refused_ns", np.int64, (MOST_SOURCES,)),  # for how long it has insisted since, its silences apart
        ("heard_ns", np.int64, (MOST_SOURCES,)),  # stamp of its last measurement; of poses never
        ("offsets", OFFSET, (MOST_RECEIVERS,)),  # of sources of poses
        ("rests_on", np.int64),  # source of the one fix that the place rests on; −1: others agreed with it
        ("way", np.float64, (2,)),  # by which the place went as it was predicted, since the start, m
        ("stands", STAND, (MOST_SOURCES,)),
        ("streaks", STREAK, (MOST_SOURCES,)),  # measurements in a row that speak for other ground
        ("adaptation", ADAPTATION),
        ("attitude", ATTITUDE),
        ("odometry", ODOMETRY_POSE, (MOST_ODOMETRIES,)),
        ("driven", np.float64, (2,)),  # by left and right sprocket since the start, rad
        ("moved", np.float64, (3,)),  # ∫ of the twist as it was predicted, since the start: m, m, rad
        ("fixed_ns", np.int64),  # stamp of the last fix
        ("down", np.float64),  # sine of the slope that the tracks drove down as k was learned
        ("ran", np.float64),  # by the tracks since the start, mean of both, forward or not, m
        ("is_sector", np.bool_),  # whether its heading is one share of the circle
        ("fault", np.int64, (MOST_SOURCES,)),  # of ``events.SourceFault``: what is assumed of each source
        ("fault_ns", np.int64, (MOST_SOURCES,)),  # stamp since when
        ("outlier_share", np.float64, (MOST_SOURCES,)),  # of its measurements
        ("last_fix", np.float64, (MOST_SOURCES, 2)),  # place that a source stated last, m
        (
            "last_ns",
            np.int64,
            (MOST_SOURCES,),
        ),  # stamp of its last measurement by which branches were weighed
    ],
    align=True,
)

UPDATE = np.dtype(
    [
        ("outcome", np.int64),  # of ``measurements.Outcome``
        ("dof", np.int64),
        ("nis", np.float64),
        ("gate", np.float64),
        ("log_determinant", np.float64),  # ln |S|
        ("evidence", np.float64),  # ln of the density of the measurement, where branches are weighed by it
        ("whitened", np.float64, (2,)),  # innovation of a fix along and across, over its standard deviation
        ("stated", np.float64),  # standard deviation that a fix states, m
        ("coarse", np.int64),  # 0 or 1: whether its error may last
        ("shown", np.float64, (2,)),  # place of base_link by a coarse fix, m
        ("repeated", np.int64),  # 0 or 1: the fix is bit for bit the one before
        ("opened", np.int64),  # last ``events.Event`` that opened states since the state before
        ("attitude", np.int64),  # ``AttitudeRefusal`` of an IMU or a fix; 0: used, or not wanted
        ("follows", np.bool_),  # whether the prior follows from the state before by the model
        ("renewed", np.int64),  # bit i: state i does not follow from the state before
        ("prior_mean", np.float64, (SIZE,)),  # before the measurement, widened where it surprised
        ("prior_covariance", np.float64, (SIZE, SIZE)),
    ],
    align=True,
)

HISTORY = 16  # events that a branch remembers

EVENT = np.dtype(  # of a branch: before, or after, the step to which measurement it opened states
    [
        ("event", np.int64),  # of ``events.Event``
        ("source", np.int64),  # whose measurement it explains
        ("part", np.int64),  # of the circle
        ("value", np.float64),  # angle that the source measured, rad; of a skid its standard deviation, m
        ("decided_ns", np.int64),  # stamp of the measurement that it explains
        ("stamp_ns", np.int64),  # of the measurement of the step, with kind and source
        ("kind", np.int64),
        ("of", np.int64),
        ("after", np.int64),  # 0 or 1: after that step
    ],
    align=True,
)

BRANCH = np.dtype(  # one explanation, at one entry of the window
    [
        ("weight", np.float64),  # w
        ("events", np.int64),  # how many it has had
        ("history", EVENT, (HISTORY,)),  # the last of them; event n is at n % HISTORY
        ("first", np.int64),  # entry of the first step that it makes for this row
        ("fresh", np.int64),  # 0 or 1: made by this measurement
        ("cusum", np.float64, (4,)),  # of innovations: ahead, behind, left, right
        ("snapshot", np.int64),  # entry from which its children start
        ("slot", np.int64),  # place in the row of that entry
        ("snapshot_weight", np.float64),  # w then
        ("weighed", np.int64),  # measurements since then by which it was weighed
    ],
    align=True,
)

TILT = np.dtype(  # of an estimate
    [
        ("known", np.int64),  # 0 or 1; the rest is zero where it is not
        ("tilt", np.float64, (3,)),  # roll rad, pitch rad, height m
        ("covariance", np.float64, (3, 3)),
        ("rates", np.float64, (3,)),  # p, q, r, rad/s
        ("rate_variances", np.float64, (3,)),
        ("force", np.float64, (3,)),  # specific force along the machine's axes, m/s²
        ("force_variance", np.float64),
    ],
    align=True,
)

SWINGING = np.dtype(  # of an estimate
    [
        ("known", np.int64),  # 0 or 1: whether anything sits above; the rest is zero where it does not
        ("angle", np.float64),  # σ in (−π, π], rad
        ("rate", np.float64),  # rad/s
        ("covariance", np.float64, (2, 2)),
    ],
    align=True,
)

ESTIMATE = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("pose", np.float64, (3,)),
        ("pose_covariance", np.float64, (3, 3)),
        ("twist", np.float64, (3,)),  # v_x, v_y m/s, yaw rate rad/s at C
        ("twist_covariance", np.float64, (3, 3)),
        ("horizontal", np.float64, (3,)),  # what of the twist is: along the heading, to its left, rate of it
        ("tilt", TILT),
        ("rise", np.float64),  # ż, m/s; 0 while nobody knows the tilt
        ("rise_variance", np.float64),
        ("slips", np.float64, (3,)),  # left slip, right slip, slip angle rad
        ("slip_covariance", np.float64, (3, 3)),
        ("motion", np.int64),
        ("swing", SWINGING),
    ],
    align=True,
)

RESULT = np.dtype(
    [
        ("stamp_ns", np.int64),  # as used: a manual pose without a stamp has that of now
        ("outcome", np.int64),
        ("dof", np.int64),
        ("nis", np.float64),
        ("gate", np.float64),
        ("attitude", np.int64),
        ("fault", np.int64),  # ``measurements.Fault`` of one that is invalid; 0: none
        ("published", np.bool_),
        ("estimate", ESTIMATE),  # where published
    ],
    align=True,
)


def to_records(measurements: Sequence[Measurement], sources: Mapping[str, int]) -> NDArray[np.void]:
    """(k,) of ``MEASUREMENT``; ``sources``: name → number."""
    records = np.zeros(len(measurements), MEASUREMENT)
    for record, m in zip(records, measurements, strict=True):
        record["stamp_ns"] = m.stamp_ns
        if isinstance(m, Sprockets):
            record["kind"] = SPROCKETS
            record["left_speed"], record["right_speed"] = m.left_speed, m.right_speed
            record["left_angle"], record["right_angle"] = m.positions or (np.nan, np.nan)
        elif isinstance(m, YawRate):
            record["kind"], record["source"] = YAW_RATE, sources[m.source]
            record["value"] = (m.rate, *m.tilt_rates)
            noise = record["noise"]
            noise[0, 0], (noise[1, 1], noise[2, 2]) = m.variance, m.tilt_variances
            record["acceleration"] = m.acceleration
            record["acceleration_variance"] = m.acceleration_variance
            record["up"], record["up_variances"] = m.up, m.up_variances
        elif isinstance(m, PoseFix):
            record["kind"] = POSE
            record["source"] = MANUAL if m.source == SET_POSE else sources[m.source]
            record["value"], record["noise"] = m.pose, m.covariance
            record["altitude"], record["altitude_variance"] = m.altitude, m.altitude_variance
        elif isinstance(m, SlipFix):
            record["kind"], record["source"] = SLIPS, sources[m.source]
            record["value"][:2], record["noise"][:2, :2] = m.slips, m.covariance
        elif isinstance(m, HeadingFix):
            record["kind"], record["source"] = HEADING, sources[m.source]
            record["value"][0], record["noise"][0, 0] = m.heading, m.variance
        elif isinstance(m, SwingAngle):
            record["kind"], record["source"] = ON_SWING, sources[m.source]
            record["value"][0], record["noise"][0, 0] = m.angle, m.variance
        elif isinstance(m, OdometryPose):
            record["kind"], record["source"] = ODOMETRY, sources[m.source]
            record["value"], record["turn"], record["frame"] = m.place, m.turn, m.frame
            record["noise"][:2] = m.variances
    return records
