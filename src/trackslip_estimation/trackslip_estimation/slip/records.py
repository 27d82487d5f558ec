# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the compiled estimator: measurements, state, branches, results.

An array of records is one argument of a compiled function. Angles in rad, lengths in m, times in ns.
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

MOST_SOURCES = 15  # of all kinds together, and units
MOST_ODOMETRIES = 2

# kinds of measurements, in their order at one stamp
SPROCKETS, YAW_RATE, POSE, SLIPS, HEADING, ODOMETRY, ON_SWING, VELOCITY = range(8)


class MeasurementRecord(Record):
    """A measurement of any kind."""

    stamp_ns: int
    kind: int
    source: int  # number in ``Sources``; MANUAL: set by a user
    left_speed: float  # of the sprockets, rad/s
    right_speed: float
    left_angle: float  # rad, continuous; nan: not measured
    right_angle: float
    value: Annotated[
        FloatArray, 3
    ]  # z of the other kinds: rad/s about z, x, y; m, m, rad; left and right slip; rad; m/s, m/s
    noise: Annotated[FloatArray, (3, 3)]  # R as stated by the source; of odometry, variances in two rows
    orientation: Annotated[FloatArray, 4]  # of odometry, whose value is a position: quaternion x, y, z, w
    frame: int  # number of the odom frame
    altitude: float  # of a pose, m
    altitude_variance: float  # m²
    acceleration: Annotated[FloatArray, 3]  # specific force by an IMU, m/s²; nan: not measured
    acceleration_variance: float  # (m/s²)²
    up: Annotated[FloatArray, 3]  # vertical by the orientation of an IMU, of a length of about 1
    up_variances: Annotated[FloatArray, 2]  # rad²; −1: no orientation


MEASUREMENT = dtype_of(MeasurementRecord)

TRACKS, GYROS, BRAKE = range(MOST_SOURCES - 4, MOST_SOURCES - 1)  # sprockets, gyros, swing brake: ``fault``
MANUAL = MOST_SOURCES - 1  # source number of a manual pose: the last at its stamp


class SprocketSample(Record):
    """The latest sprocket sample."""

    seen: bool  # whether a sample was received
    stamp_ns: int  # of the sample; of the start where there is none
    left_angle: float
    right_angle: float
    known: bool  # whether the interval that ends here has speeds
    speeds: SpeedsRecord  # mean speeds of that interval
    counts: CountsRecord


SAMPLE = dtype_of(SprocketSample)


class Reading(Record):
    """The latest reading of a source."""

    stamp_ns: int  # NEVER_NS: none
    sprocket_angles: Annotated[FloatArray, 2]  # of the state at this reading
    value: float  # of a gyro, rad/s; NaN: none
    first_ns: int  # stamp of the first reading in a row of this value
    without_slip: float  # yaw rate without slip at that stamp, rad/s
    longest_ns: int  # duration of the longest earlier row of equal readings
    bias: float  # of a gyro when the machine stopped, rad/s
    bias_variance: float  # of that, (rad/s)²


class Streak(Record):
    """Consecutive yaw rates that indicate a change of ground."""

    count: int
    value: float
    departure: float


class Adaptation(Record):
    """Estimated noise of tracks, gyros and fixes (``adaptation``)."""

    track_variance: float  # s², posterior mean
    rate_factor: float  # a, factor of the variance of yaw rates
    log_weights: Annotated[FloatArray, (TRACK_ERRORS, RATE_FACTORS)]  # w of both grids
    envelope: float  # E, (m/s)²
    exposure: float  # T, (rad/s)²
    elapsed: float  # s since the last yaw rate
    speed_exposure: float  # variance of m_v, over (forward s)²/4, since the last odometry, (m/s)²
    speed_elapsed: float  # s since then
    left_speed: float  # of the sprockets in the interval before, rad/s
    right_speed: float
    fix_factors: Annotated[FloatArray, MOST_SOURCES]  # f, factor of the covariance of fixes by source
    fix_log_weights: Annotated[FloatArray, (MOST_SOURCES, FIX_FACTORS)]
    fix_innovations: Annotated[FloatArray, (MOST_SOURCES, 2)]  # latest innovation that f was estimated from
    fix_correlation: Annotated[FloatArray, MOST_SOURCES]  # correlation of consecutive innovations


ADAPTATION = dtype_of(Adaptation)


class OdometryRecord(Record):
    """Odometry of a source at the start of its next increment."""

    known: bool
    coasting: bool  # whether the sprockets had timed out
    frame: int
    position: Annotated[FloatArray, 3]
    orientation: Annotated[FloatArray, 4]
    noise: Annotated[FloatArray, (3, 3)]
    integrated_twist: Annotated[FloatArray, 3]  # ∫ twist of the state at this time
    errors: Annotated[FloatArray, 2]  # variances of the velocity errors at this time, (m/s)², (rad/s)²
    slip_weight: float  # inverse variance of the error of i₀ by recent increments
    slip_sum: float  # error of i₀ times its weight
    slip_distance: float  # track distance since i₀ became wrong, m
    slip_ns: int  # stamp at which i₀ became wrong


class Standstill(Record):
    """Number of fixes of a source in a standstill of the machine, and the swing angle there, rad."""

    count: int
    swing: float


class Offset(Record):
    """Time-correlated error of a pose source (``correlated_errors``)."""

    errors: Annotated[Table[FixErrors], QUALITIES]
    variance: float  # prior of each of the two offset states, m²; 0: no offset, or one that an event opened
    wander: Wander
    stddev: float  # as stated by the latest fix, m


OFFSET = dtype_of(Offset)


class State(Record):
    """The state of a branch at a measurement."""

    stamp_ns: int
    mean: Annotated[FloatArray, SIZE]
    covariance: Annotated[FloatArray, (SIZE, SIZE)]
    speeds: SpeedsRecord  # of the sprockets in the interval that ends here
    motion: MotionRecord
    shear: Annotated[FloatArray, 2]  # shear of the left and right track (``models.shear``)
    coasting: bool  # whether the sprockets have timed out
    sample: SprocketSample
    time_since_sample: float  # s, at the middle of a step that extrapolates the speeds of the sample
    one_sprocket: bool  # whether one sprocket and a gyro give both speeds (``one_sprocket``)
    consistent_ns: Annotated[IntArray, MOST_SOURCES]  # stamp of the latest one that did not contradict
    rejected_ns: Annotated[IntArray, MOST_SOURCES]  # time of rejections since then, without silences
    received_ns: Annotated[IntArray, MOST_SOURCES]  # stamp of the latest measurement; NEVER_NS of poses
    offsets: Annotated[Table[Offset], MOST_RECEIVERS]  # of pose sources
    sole_fix_source: int  # source of the only fix that supports the position; −1: others agree with it
    sole_fix_heading: bool  # whether the heading depends on that fix, too
    displacement: Annotated[FloatArray, 2]  # sum of predicted displacements since the start, m
    standstills: Annotated[Table[Standstill], MOST_SOURCES]
    streaks: Annotated[Table[Streak], MOST_SOURCES]  # by gyro
    readings: Annotated[Table[Reading], MOST_SOURCES]  # of gyros and odometry
    adaptation: Adaptation
    attitude: Attitude
    odometry: Annotated[Table[OdometryRecord], MOST_ODOMETRIES]
    sprocket_angles: Annotated[FloatArray, 2]  # of the left and right sprocket since the start, rad
    integrated_twist: Annotated[FloatArray, 3]  # ∫ predicted twist dt since the start: m, m, rad
    fixed_ns: int  # stamp of the latest fix; NEVER_NS: none
    delay_variance: float  # of δ without the information of fixes
    learned_downhill: float  # sine of the slope, downhill along the tracks, where k was estimated
    track_distance: float  # mean of both tracks since the start, never decreasing, m
    is_sector: bool  # whether a heading that began in a sector of the circle is not settled yet
    fault: Annotated[IntArray, MOST_SOURCES]  # ``SourceFault`` that the branch assumes, by source
    fault_ns: Annotated[IntArray, MOST_SOURCES]  # stamp since when
    heading_fault: Annotated[IntArray, MOST_SOURCES]  # of headings or swing angles, beside ``fault``
    heading_fault_ns: Annotated[IntArray, MOST_SOURCES]
    outlier_share: Annotated[FloatArray, MOST_SOURCES]  # share of outliers, by source
    last_value: Annotated[FloatArray, (MOST_SOURCES, 3)]  # of each source; of fixes that stay, their mean
    weighed_ns: Annotated[IntArray, MOST_SOURCES]  # stamp of the latest one that weighed branches


STATE = dtype_of(State)


class Update(Record):
    """Result of a step with a measurement."""

    outcome: int  # of ``measurements.Outcome``
    dof: int
    nis: float
    gate: float
    log_determinant: float  # ln |S|
    evidence: float  # ln of the likelihood of a measurement that weighs branches
    whitened: Annotated[FloatArray, 2]  # innovation of a fix along and across, over its stddev
    stated: float  # standard deviation as stated by a fix, m
    coarse: int  # 0 or 1: whether the error of a fix may be time-correlated
    measured_position: Annotated[FloatArray, 2]  # position of base_link by a coarse fix, m
    squared_repeat_distance: float  # from the previous measurement of the source, m², rad² or (m/s)²
    squared_repeat_angle: float  # of the heading of a fix, rad²
    tied: int  # 0 or 1: takes the likelihood of the most probable branch that may use the fix
    event: int  # latest ``events.Event`` in this step
    attitude: int  # ``AttitudeRejection`` of an IMU or a fix; 0: used, or not requested
    follows: bool  # whether the prior is the prediction of the previous state
    reset_states: int  # bit i: state i was reset in this step


UPDATE = dtype_of(Update)


class Prior(Record):
    """Mean and covariance before the update, inflated where the innovation was large."""

    mean: Annotated[FloatArray, SIZE]
    covariance: Annotated[FloatArray, (SIZE, SIZE)]


PRIOR = dtype_of(Prior)


HISTORY = 16  # latest events of a branch


class EventRecord(Record):
    """An event of a branch, and the step in which it opened states.

    ``part``: sector of the circle; ``MEASURED``: the source measured the angle ``value``, rad; ``HIDDEN``,
    ``STUCK``, or the fault of sprockets that partly fail; ``ANGLES``: the fault of the source's angles ended,
    not that of its positions. ``value`` is the standard deviation, m, of a skid, an offset, or a displaced
    machine. Of a slip or a bias that changed earlier it is the time since then, s, in which the offset of a
    coarse receiver absorbed it.
    """

    event: int  # of ``events.Event``
    source: int  # whose measurement it explains
    part: int
    value: float
    decided_ns: int  # stamp of the measurement that the event explains
    stamp_ns: int  # of the measurement of the step
    step_kind: int
    step_source: int
    after: int  # 0: before the step, 1: after it


EVENT = dtype_of(EventRecord)


class Snapshot(Record):
    """Entry of the window from which children of a branch start."""

    entry: int
    slot: int  # number of the branch in the row of that entry
    weight: float  # w at that entry
    turn_cost: float  # of the branch at that entry
    fixes: int  # number of fixes since then


OLDER, YOUNGER = range(2)  # snapshots: start of children now, and its successor


class Branch(Record):
    """One explanation (hypothesis) at one entry of the window."""

    weight: float  # w
    events: int  # number of events
    history: Annotated[Table[EventRecord], HISTORY]  # the latest events; event n is at n % HISTORY
    first: int  # entry of the first step for this row
    fresh: int  # 0 or 1: created by this measurement
    cusum: Annotated[FloatArray, 4]  # of innovations: ahead, behind, left, right
    slip_cost: float  # by which an implausible slip has lowered w since it was plausible
    turn_cost: float  # the same by an implausible turn
    course: float  # q of ``bank.course``: how strongly fixes confirm the heading
    course_ns: int  # stamp of the latest fix that agreed
    course_from: Annotated[FloatArray, 3]  # ``displacement`` of the state at the latest fix, m; heading, rad
    snapshots: Annotated[Table[Snapshot], 2]


BRANCH = dtype_of(Branch)


class TiltRecord(Record):
    """Attitude of an estimate."""

    known: int  # 0 or 1; 0: all other fields are zero
    tilt: Annotated[FloatArray, 3]  # roll rad, pitch rad, height m
    covariance: Annotated[FloatArray, (3, 3)]
    rates: Annotated[FloatArray, 3]  # p, q, r, rad/s
    rate_variances: Annotated[FloatArray, 3]
    force: Annotated[FloatArray, 3]  # specific force along the machine's axes, m/s²
    force_variance: float


TILT = dtype_of(TiltRecord)


class SwingRecord(Record):
    """Swing of an estimate."""

    known: int  # 0 or 1: whether a sensor is on the upper structure; 0: all other fields are zero
    angle: float  # σ in (−π, π], rad
    rate: float  # rad/s
    covariance: Annotated[FloatArray, (2, 2)]


SWINGING = dtype_of(SwingRecord)


class EstimateRecord(Record):
    """A published estimate."""

    stamp_ns: int
    pose: Annotated[FloatArray, 3]
    pose_covariance: Annotated[FloatArray, (3, 3)]
    twist: Annotated[FloatArray, 3]  # v_x, v_y m/s, yaw rate rad/s at C
    twist_covariance: Annotated[FloatArray, (3, 3)]
    horizontal: Annotated[FloatArray, 3]  # horizontal twist: along the heading, to its left, yaw rate
    tilt: TiltRecord
    rise: float  # ż, m/s; 0 while the tilt is unknown
    rise_variance: float
    slips: Annotated[FloatArray, 3]  # left slip, right slip, slip angle rad
    slip_covariance: Annotated[FloatArray, (3, 3)]
    motion: int
    swing: SwingRecord


ESTIMATE = dtype_of(EstimateRecord)


class Result(Record):
    """Result of an arrival, and the estimate that it publishes."""

    stamp_ns: int  # as used: a manual pose without a stamp gets the current one
    outcome: int
    dof: int
    nis: float
    gate: float
    attitude: int
    fault: int  # ``measurements.Fault`` of an invalid measurement; 0: none
    published: bool
    estimate: EstimateRecord  # valid where published


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
            record["value"], record["orientation"], record["frame"] = m.position, m.orientation, m.frame
            record["noise"][:2] = m.variances
    return records
