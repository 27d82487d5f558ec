# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The records that pass through the compiled estimator: what is measured, what is known, what became of it.

Arrays of them cross from Python as one argument each. Angles in rad, lengths in m, times in ns.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.record_types import Record, Table, dtype_of
from trackslip_estimation.attitude.records import Attitude
from trackslip_estimation.slip.adaptation import FIX_FACTORS, RATE_FACTORS, TRACK_ERRORS
from trackslip_estimation.slip.correlated_errors import MOST_RECEIVERS, QUALITIES, FixErrors
from trackslip_estimation.slip.counts import CountsRecord
from trackslip_estimation.slip.measurements import (
    SET_POSE,
    HeadingFix,
    Measurement,
    OdometryPose,
    PoseFix,
    SlipFix,
    Sprockets,
    SwingAngle,
    VelocityFix,
    YawRate,
)
from trackslip_estimation.slip.models.model import SIZE
from trackslip_estimation.slip.motion import MotionRecord, SpeedsRecord
from trackslip_estimation.slip.wandering import Wander

MOST_SOURCES = 14  # of all kinds together
MOST_ODOMETRIES = 2

# kinds, in the order at one stamp
SPROCKETS, YAW_RATE, POSE, SLIPS, HEADING, ODOMETRY, ON_SWING, VELOCITY = range(8)


class MeasurementRecord(Record):
    """One measurement of any kind."""

    stamp_ns: int
    kind: int
    source: int  # number in ``Sources``; MANUAL is a user's
    left_speed: float  # of the sprockets, rad/s
    right_speed: float
    left_angle: float  # rad, continuous; nan where there is none
    right_angle: float
    value: Annotated[
        FloatArray, 3
    ]  # z of all others: rad/s about z, x, y; m, m, rad; left and right slip; rad; m/s, m/s
    noise: Annotated[FloatArray, (3, 3)]  # R, as its source states it; of odometry, variances in two rows
    turn: Annotated[FloatArray, 4]  # of odometry, whose value is a place: quaternion x, y, z, w
    frame: int  # and number of its odom frame
    altitude: float  # of a pose, m
    altitude_variance: float  # m²
    acceleration: Annotated[FloatArray, 3]  # of an IMU: specific force, m/s²; nan where it has none
    acceleration_variance: float  # (m/s²)²
    up: Annotated[FloatArray, 3]  # by its orientation, of any length about 1
    up_variances: Annotated[FloatArray, 2]  # rad²; −1: it has none


MEASUREMENT = dtype_of(MeasurementRecord)

TRACKS, GYROS = MOST_SOURCES - 3, MOST_SOURCES - 2  # of the sprockets and of all gyros, among faults
MANUAL = MOST_SOURCES - 1  # the source number of a manual pose: the last of those with one stamp


class SprocketSample(Record):
    """The last sample of the sprockets."""

    seen: bool  # whether there was one
    stamp_ns: int  # of the start where there was none
    left_angle: float
    right_angle: float
    known: bool  # whether the interval that it closed shows speeds
    speeds: SpeedsRecord  # of that interval
    counts: CountsRecord


SAMPLE = dtype_of(SprocketSample)


class Reading(Record):
    """The last of a source."""

    stamp_ns: int  # never: there was none
    sprocket_angles: Annotated[FloatArray, 2]  # of the state then


class Streak(Record):
    """Yaw rates in a row that speak for other ground."""

    count: int
    value: float
    departure: float


class Adaptation(Record):
    """How wrong tracks, gyros and fixes are, as far as it is known (``adaptation``)."""

    track_variance: float  # s², posterior mean
    rate_factor: float  # a, of the variance of yaw rates
    log_weights: Annotated[FloatArray, (TRACK_ERRORS, RATE_FACTORS)]  # w of both
    envelope: float  # E, (m/s)²
    exposure: float  # T, (rad/s)²
    elapsed: float  # s since the last yaw rate
    speed_exposure: float  # of m_v, over f² s²/4, since the last odometry, (m/s)²
    speed_elapsed: float  # s since then
    left_speed: float  # of the sprockets in the interval before, rad/s
    right_speed: float
    fix_factors: Annotated[FloatArray, MOST_SOURCES]  # f, of the covariance of each source's fixes
    fix_log_weights: Annotated[FloatArray, (MOST_SOURCES, FIX_FACTORS)]
    fix_innovations: Annotated[FloatArray, (MOST_SOURCES, 2)]  # of the last that taught f
    fix_correlation: Annotated[FloatArray, MOST_SOURCES]  # of those that follow each other


ADAPTATION = dtype_of(Adaptation)


class OdometryRecord(Record):
    """Of a source, at the begin of its next increment."""

    known: bool
    coasting: bool  # whether the sprockets were silent
    frame: int
    place: Annotated[FloatArray, 3]
    turn: Annotated[FloatArray, 4]
    noise: Annotated[FloatArray, (3, 3)]
    integrated_twist: Annotated[FloatArray, 3]  # of the state then
    errors: Annotated[FloatArray, 2]  # variances of the velocity errors then, (m/s)², (rad/s)²
    slip_weight: float  # of what increments of late say that i₀ is off by, 1/variance
    slip_sum: float  # that times its weight
    slip_distance: float  # that the tracks have gone since it is, m
    slip_ns: int  # stamp since when


class Standstill(Record):
    """Of a machine, to a source: fixes from there, and the angle of what swings, rad."""

    count: int
    swing: float


class Offset(Record):
    """Of a source of poses, as ``correlated_errors`` has it."""

    errors: Annotated[Table[FixErrors], QUALITIES]
    variance: float  # a priori of each of its two states, m²; 0: it has none, or an event
    wander: Wander
    stddev: float  # that the source's last fix stated, m


OFFSET = dtype_of(Offset)


class State(Record):
    """All that is remembered from one measurement to the next."""

    stamp_ns: int
    mean: Annotated[FloatArray, SIZE]
    covariance: Annotated[FloatArray, (SIZE, SIZE)]
    speeds: SpeedsRecord  # of the sprockets in the interval that led here
    motion: MotionRecord
    shear: Annotated[FloatArray, 2]  # of the left and right track, see ``models.shear``
    coasting: bool  # the sprockets have been silent for too long
    sample: SprocketSample  # the last of the sprockets
    time_since_sample: float  # s since it, in the middle of a step in which its speeds are taken to go on
    consistent_ns: Annotated[IntArray, MOST_SOURCES]  # when each source was last inside its plain gate
    refused_ns: Annotated[IntArray, MOST_SOURCES]  # for how long it has insisted since, its silences apart
    received_ns: Annotated[IntArray, MOST_SOURCES]  # stamp of its last measurement; of poses never
    offsets: Annotated[Table[Offset], MOST_RECEIVERS]  # of sources of poses
    sole_fix_source: int  # source of the one fix that the place rests on; −1: others agreed with it
    sole_fix_heading: bool  # on that fix, too
    displacement: Annotated[FloatArray, 2]  # by which the place went as it was predicted, since the start, m
    standstills: Annotated[Table[Standstill], MOST_SOURCES]
    streaks: Annotated[Table[Streak], MOST_SOURCES]  # measurements in a row that speak for other ground
    readings: Annotated[Table[Reading], MOST_SOURCES]  # of gyros and odometry
    adaptation: Adaptation
    attitude: Attitude
    odometry: Annotated[Table[OdometryRecord], MOST_ODOMETRIES]
    sprocket_angles: Annotated[FloatArray, 2]  # by left and right sprocket since the start, rad
    integrated_twist: Annotated[
        FloatArray, 3
    ]  # ∫ of the twist as it was predicted, since the start: m, m, rad
    fixed_ns: int  # stamp of the last fix; never
    delay_variance: float  # of δ, had no fix shown it
    learned_downhill: float  # sine of the slope that the tracks drove down as k was learned
    track_distance: float  # by the tracks since the start, mean of both, forward or not, m
    is_sector: bool  # whether its heading is one share of the circle
    fault: Annotated[IntArray, MOST_SOURCES]  # of ``events.SourceFault``: what is assumed of each source
    fault_ns: Annotated[IntArray, MOST_SOURCES]  # stamp since when
    outlier_share: Annotated[FloatArray, MOST_SOURCES]  # of its measurements
    last_fix: Annotated[FloatArray, (MOST_SOURCES, 2)]  # place that a source stated last, m
    last_ns: Annotated[IntArray, MOST_SOURCES]  # stamp of its last measurement by which branches were weighed


STATE = dtype_of(State)


class Update(Record):
    """What became of a measurement."""

    outcome: int  # of ``measurements.Outcome``
    dof: int
    nis: float
    gate: float
    log_determinant: float  # ln |S|
    evidence: float  # ln of the density of the measurement, where branches are weighed by it
    whitened: Annotated[FloatArray, 2]  # innovation of a fix along and across, over its standard deviation
    stated: float  # standard deviation that a fix states, m
    coarse: int  # 0 or 1: whether its error may last
    measured_position: Annotated[FloatArray, 2]  # place of base_link by a coarse fix, m
    squared_repeat_distance: float  # squared distance of a fix from the source's fix before, m²
    tied: int  # 0 or 1: the fix is as likely as in the most probable branch that may use it
    opened: int  # last ``events.Event`` that opened states since the state before
    attitude: int  # ``AttitudeRefusal`` of an IMU or a fix; 0: used, or not wanted
    follows: bool  # whether the prior follows from the state before by the model
    reset_states: int  # bit i: state i does not follow from the state before


UPDATE = dtype_of(Update)


class Prior(Record):
    """What was known before a measurement, widened where it surprised."""

    mean: Annotated[FloatArray, SIZE]
    covariance: Annotated[FloatArray, (SIZE, SIZE)]


PRIOR = dtype_of(Prior)


HISTORY = 16  # events that a branch remembers


class EventRecord(Record):
    """Of a branch: before, or after, the step to which measurement it opened states.

    ``part``: of the circle, or ``MEASURED``: where the source measured the angle ``value``, rad; or ``LOST``.
    ``value`` of a skid, of fixes that are off, and of a machine that was moved is the standard deviation, m;
    of a slip and a bias that changed a while ago how long, s: an offset of the source took it for its own.
    """

    event: int  # of ``events.Event``
    source: int  # whose measurement it explains
    part: int
    value: float
    decided_ns: int  # stamp of the measurement that it explains
    stamp_ns: int  # of the measurement of the step, with kind and source
    kind: int
    of: int
    after: int  # 0 or 1: after that step


EVENT = dtype_of(EventRecord)


class Snapshot(Record):
    """Of a branch, at an entry from which children may start."""

    entry: int  # its number
    slot: int  # place of the branch in the row of that entry
    weight: float  # w then
    weighed: int  # measurements since then by which the branch was weighed


OLDER, YOUNGER = range(2)  # snapshots: where children start now, and where they do next


class Branch(Record):
    """One explanation, at one entry of the window."""

    weight: float  # w
    events: int  # how many it has had
    history: Annotated[Table[EventRecord], HISTORY]  # the last of them; event n is at n % HISTORY
    first: int  # entry of the first step that it makes for this row
    fresh: int  # 0 or 1: made by this measurement
    cusum: Annotated[FloatArray, 4]  # of innovations: ahead, behind, left, right
    snapshots: Annotated[Table[Snapshot], 2]


BRANCH = dtype_of(Branch)


class TiltRecord(Record):
    """Of an estimate."""

    known: int  # 0 or 1; the rest is zero where it is not
    tilt: Annotated[FloatArray, 3]  # roll rad, pitch rad, height m
    covariance: Annotated[FloatArray, (3, 3)]
    rates: Annotated[FloatArray, 3]  # p, q, r, rad/s
    rate_variances: Annotated[FloatArray, 3]
    force: Annotated[FloatArray, 3]  # specific force along the machine's axes, m/s²
    force_variance: float


TILT = dtype_of(TiltRecord)


class SwingRecord(Record):
    """Of an estimate."""

    known: int  # 0 or 1: whether anything sits above; the rest is zero where it does not
    angle: float  # σ in (−π, π], rad
    rate: float  # rad/s
    covariance: Annotated[FloatArray, (2, 2)]


SWINGING = dtype_of(SwingRecord)


class EstimateRecord(Record):
    """What is published."""

    stamp_ns: int
    pose: Annotated[FloatArray, 3]
    pose_covariance: Annotated[FloatArray, (3, 3)]
    twist: Annotated[FloatArray, 3]  # v_x, v_y m/s, yaw rate rad/s at C
    twist_covariance: Annotated[FloatArray, (3, 3)]
    horizontal: Annotated[FloatArray, 3]  # what of the twist is: along the heading, to its left, rate of it
    tilt: TiltRecord
    rise: float  # ż, m/s; 0 while nobody knows the tilt
    rise_variance: float
    slips: Annotated[FloatArray, 3]  # left slip, right slip, slip angle rad
    slip_covariance: Annotated[FloatArray, (3, 3)]
    motion: int
    swing: SwingRecord


ESTIMATE = dtype_of(EstimateRecord)


class Result(Record):
    """What became of an arrival, and what is published at it."""

    stamp_ns: int  # as used: a manual pose without a stamp has that of now
    outcome: int
    dof: int
    nis: float
    gate: float
    attitude: int
    fault: int  # ``measurements.Fault`` of one that is invalid; 0: none
    published: bool
    estimate: EstimateRecord  # where published


RESULT = dtype_of(Result)


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
        elif isinstance(m, VelocityFix):
            record["kind"], record["source"] = VELOCITY, sources[m.source]
            record["value"][:2], record["noise"][:2, :2] = m.velocity, m.covariance
        elif isinstance(m, OdometryPose):
            record["kind"], record["source"] = ODOMETRY, sources[m.source]
            record["value"], record["turn"], record["frame"] = m.place, m.turn, m.frame
            record["noise"][:2] = m.variances
    return records
