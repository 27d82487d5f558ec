# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Record of all constants of the compiled estimator, made from its parameters."""

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from trackslip_common.arrays import FloatArray, IntArray
from trackslip_common.clock_monitor import ClockLimits
from trackslip_common.parameter_record import fill_record
from trackslip_common.record_types import Record, dtype_of
from trackslip_common.units import GRAVITY
from trackslip_estimation.attitude.parameters import AttitudeConstants
from trackslip_estimation.attitude.parameters import constants as attitude_constants
from trackslip_estimation.kalman import chi_square
from trackslip_estimation.slip import adaptation
from trackslip_estimation.slip.adaptation import AdaptationConstants
from trackslip_estimation.slip.bank.parameters import BankParameters, ReceiverParameters
from trackslip_estimation.slip.coasting import unknown_motion
from trackslip_estimation.slip.events import Event, EventParameters, event_rates
from trackslip_estimation.slip.ground import GroundParameters
from trackslip_estimation.slip.models.dispatch import CONSTANTS, MODELS
from trackslip_estimation.slip.models.free_slips import FreeSlipsConstants
from trackslip_estimation.slip.models.model import GYRO_BIAS, SENSOR_ERRORS, SIZE, SWING, UNDERCARRIAGE_SIZE
from trackslip_estimation.slip.models.speed import TURN_STATE_1, SpeedConstants
from trackslip_estimation.slip.models.swing import SwingConstants
from trackslip_estimation.slip.models.swing import constants as swing_constants
from trackslip_estimation.slip.models.turning import TurningConstants
from trackslip_estimation.slip.motion import LimitsRecord, Motion, MotionState, limits_record
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import BRAKE, GYROS, MOST_SOURCES, TRACKS, Adaptation
from trackslip_estimation.slip.sources import COVARIANCES, DRIFT_TIME, LEAN_TIME, YAW_TIME

ConfigRecord = NDArray[np.void]

_INITIAL_TILT = 0.2  # rad, standard deviation of a tilt that an IMU has not measured yet


class Config(Record):
    """All constants of the estimator."""

    model: int
    active: int  # number of uncertain states
    size: int  # number of states in use
    swings: bool  # whether a sensor is on the upper structure
    swing_axis: Annotated[FloatArray, 2]  # in base_link, m
    swing_pose_source: int  # first pose source on the upper structure; −1: none
    sigma_points: bool  # DAF, else EKF
    kappa: float  # of the DAF
    rolling_radius: float  # r, m
    tread: float  # B, m
    encoder_resolution: float  # rad
    velocity_errors: SpeedConstants  # of the chosen model
    turning: TurningConstants
    free_slips: FreeSlipsConstants
    swing: SwingConstants
    adaptation: AdaptationConstants
    process_noise: Annotated[FloatArray, (len(Motion), 2, SIZE)]  # variance per s, by ``MotionState``
    prior_mean: Annotated[FloatArray, SIZE]
    prior_variance: Annotated[FloatArray, SIZE]
    prior_covariance: Annotated[FloatArray, (SIZE, SIZE)]  # without the pose
    resumes: bool  # whether the noise estimation starts from ``start``, else from its priors
    start: Adaptation
    initial_pose: Annotated[FloatArray, 3]
    initial_covariance: Annotated[FloatArray, (3, 3)]
    starts_with_fix: bool  # else with the first sprocket sample
    motion_limits: LimitsRecord
    sprocket_timeout_ns: int
    max_sprocket_speed: float  # rad/s
    unknown_speed: float  # standard deviation of an unknown speed, m/s
    unknown_yaw_rate: float  # rad/s
    unknown_time: float  # correlation time of both, s
    unmodelled_yaw_rate: float  # standard deviation of an unknown yaw rate that is no state, rad/s
    max_gap: float  # s
    shows_motion: Annotated[IntArray, MOST_SOURCES]  # 0 or 1: odometry, and units if any
    window_ns: int
    clock: ClockLimits
    gate_limits: Annotated[FloatArray, 4]  # g by degrees of freedom 0 … 3; infinite: all are accepted
    gate_relaxation: float
    gate_confirmations: int
    timeouts_ns: Annotated[IntArray, MOST_SOURCES]  # by source, as all below
    levers: Annotated[FloatArray, (MOST_SOURCES, 3)]  # m
    above: Annotated[IntArray, MOST_SOURCES]  # 0 or 1: whether on the upper structure
    rate_scale: Annotated[FloatArray, MOST_SOURCES]  # signed scale of a gyro
    is_gyro: Annotated[IntArray, MOST_SOURCES]  # 0 or 1
    stamp_errors: Annotated[FloatArray, MOST_SOURCES]  # σ_t, s
    use_heading: Annotated[IntArray, MOST_SOURCES]  # 0 or 1
    use_altitude: Annotated[IntArray, MOST_SOURCES]  # 0 or 1
    position_floor: Annotated[FloatArray, MOST_SOURCES]  # m
    heading_floor: Annotated[FloatArray, MOST_SOURCES]  # rad
    heading_ceiling: Annotated[FloatArray, MOST_SOURCES]  # rad
    heading_offset: Annotated[FloatArray, MOST_SOURCES]  # rad
    measures_swing: Annotated[IntArray, MOST_SOURCES]  # 0 or 1: whether the source measures swing angles
    velocity_floor: Annotated[FloatArray, MOST_SOURCES]  # m/s
    body_axes: Annotated[IntArray, MOST_SOURCES]  # 0 or 1: whether velocities are along the sensor's axes
    repeat_times: Annotated[FloatArray, MOST_SOURCES]  # of fixes by a laser on the upper structure, s
    standing_share: Annotated[FloatArray, MOST_SOURCES]
    events: EventParameters
    bank: BankParameters
    receivers: ReceiverParameters
    ground: GroundParameters
    log_rates: Annotated[FloatArray, (len(Event), MOST_SOURCES)]  # ln of event rates, 1/s; −∞: no rate
    poses: int  # number of pose sources
    offsets: Annotated[IntArray, MOST_SOURCES]  # first state of the position or velocity offset; −1: none
    yaw_offsets: Annotated[IntArray, MOST_SOURCES]  # state of the heading or swing angle offset; −1: none
    source_states: Annotated[IntArray, MOST_SOURCES]  # state of the gyro bias or odometry scale; −1: none
    lean_errors: int  # first of two states of tilt errors, over their standard deviation; −1: none
    lean_stddevs: Annotated[FloatArray, 2]  # rad, of an unknown slope, and of a known tilt
    lean_decays: Annotated[FloatArray, (2, 2)]  # of both errors, 1/s and 1/m
    mountings: Annotated[
        FloatArray, (MOST_SOURCES, 4)
    ]  # of odometry: quaternion from its axes to base_link's, x, y, z, w
    odometries: int  # number of odometry sources
    odometry_number: Annotated[IntArray, MOST_SOURCES]  # number among the odometry sources
    odometry_noise: Annotated[IntArray, MOST_SOURCES]  # index in ``COVARIANCES``: origin of its covariance
    odometry_variances: Annotated[FloatArray, (MOST_SOURCES, 2)]  # declared, (m/s)², (rad/s)²
    odometry_gap: Annotated[FloatArray, MOST_SOURCES]  # s
    tilt_source: int  # IMU that measures the attitude; −1: none, the ground is flat
    tilt_lever: Annotated[FloatArray, 3]  # lever arm of that IMU, m
    tilt_acceleration: int  # 0 or 1: whether its accelerations are used
    tilt_orientation: int  # 0 or 1: whether its orientation is used
    attitude: AttitudeConstants


CONFIG = dtype_of(Config)


def make_config(p: SlipEstimatorParameters, window_ns: int | None = None) -> ConfigRecord:
    """(1,) of ``CONFIG``; ``window_ns``: largest delay of a measurement, instead of the parameters' one."""
    config = np.zeros(1, CONFIG)
    c = config[0]
    c["kappa"], c["sigma_points"] = p.kappa, p.filter == "daf"
    c["rolling_radius"], c["tread"] = p.vehicle.kinematics.rolling_radius, p.vehicle.kinematics.tread
    c["encoder_resolution"] = p.encoder_resolution
    c["initial_pose"], c["initial_covariance"] = p.initial_pose()
    c["starts_with_fix"] = p.start == "first_fix"
    c["motion_limits"] = limits_record(p.motion)[0]
    c["sprocket_timeout_ns"], c["max_sprocket_speed"] = round(p.sprocket_timeout * 1e9), p.max_sprocket_speed
    unknown = unknown_motion(p.vehicle.kinematics, p.max_sprocket_speed)
    c["unknown_speed"], c["unknown_yaw_rate"] = unknown.speed, unknown.yaw_rate
    c["unknown_time"] = unknown.time
    c["unmodelled_yaw_rate"] = unknown.yaw_rate if p.model == "free_slips" else 0.0
    c["adaptation"] = adaptation.constants(p.adaptation)
    for name in ("events", "bank", "receivers", "ground"):
        fill_record(c[name], getattr(p, name))
    c["max_gap"] = p.max_gap
    c["window_ns"] = round(p.history_window * 1e9) if window_ns is None else window_ns
    c["clock"] = (round(p.max_gap * 1e9), p.jump_confirmations, c["sprocket_timeout_ns"])
    _set_model(c, p)
    numbers = {name: number for number, name in enumerate(p.timeouts_ns())}
    _set_sources(c, p, numbers)
    _set_rates(c, p, numbers)
    _set_odometry(c, p, numbers)
    _set_source_states(c, p, numbers)
    return config


def _set_model(c: Config, p: SlipEstimatorParameters) -> None:
    """Set constants, priors and process noise of the chosen model."""
    model, noise = MODELS[p.model], p.noise_of(p.model)
    c["model"], c["active"] = model.CODE, SENSOR_ERRORS if p.swings else model.ACTIVE
    c["swings"], c["size"] = p.swings, SENSOR_ERRORS if p.swings else UNDERCARRIAGE_SIZE
    for name, dtype in CONSTANTS:
        values = {}
        if name in MODELS:
            values = MODELS[name].constants(p.noise_of(name))
        elif hasattr(model, "velocity_error_constants"):
            values = model.velocity_error_constants(noise)
        c[name] = tuple(values.get(field, 0.0) for field in dtype.names or ())
    c["swing"], c["swing_axis"] = swing_constants(p.swing, p.vehicle), p.vehicle.swing_axis
    prior = model.prior(noise, p.vehicle.kinematics.tread)
    c["prior_mean"], c["prior_variance"] = prior.mean, np.square(prior.stddev)
    if p.swings:
        c["prior_mean"][SWING], c["prior_variance"][SWING] = p.initial_swing()
    c["prior_covariance"] = np.diag(c["prior_variance"])
    if hasattr(model, "couple_turn_states"):
        model.couple_turn_states(c["prior_covariance"], float(c["prior_variance"][TURN_STATE_1]))
    c["prior_variance"] = np.diag(c["prior_covariance"])
    for motion in Motion:
        for changing in (False, True):
            density = model.process_noise_density(noise, MotionState(motion, changing))
            c["process_noise"][motion, int(changing)] = np.square(density)


def _set_sources(c: Config, p: SlipEstimatorParameters, numbers: Mapping[str, int]) -> None:
    """Set gates, levers and noise of sources; ``numbers``: name → number, in the order of ``timeouts_ns``."""
    tail = 1.0 - p.gate_probability
    c["gate_limits"] = [np.inf, *(chi_square.upper_limit(dof, tail) for dof in (1, 2, 3))]
    c["gate_relaxation"], c["gate_confirmations"] = p.gate_relaxation, p.gate_confirmations
    c["rate_scale"] = c["timeouts_ns"] = 1
    for name, timeout_ns in p.timeouts_ns().items():
        c["timeouts_ns"][numbers[name]] = timeout_ns
    for name, pose in p.poses().items():
        k = numbers[name]
        c["levers"][k], c["use_heading"][k] = pose.lever, pose.use_heading
        c["stamp_errors"][k] = pose.stamp_error
        c["position_floor"][k], c["heading_floor"][k] = pose.position_floor, pose.heading_floor
        c["heading_ceiling"][k] = pose.heading_ceiling
        c["standing_share"][k] = pose.standing_share
        c["use_altitude"][k] = pose.use_altitude
    for name, compass in p.compasses().items():
        k = numbers[name]
        c["heading_offset"][k], c["heading_floor"][k] = compass.offset, compass.heading_floor
        c["stamp_errors"][k] = compass.stamp_error
    for name, encoder in p.swing_encoders().items():
        k = numbers[name]
        c["heading_offset"][k], c["measures_swing"][k] = encoder.offset, 1
    for name, velocity in p.velocities().items():
        k = numbers[name]
        c["levers"][k], c["velocity_floor"][k] = velocity.lever, velocity.velocity_floor
        c["body_axes"][k], c["heading_offset"][k] = velocity.axes == "body", velocity.mounting_yaw
    above = [numbers[name] for name, source in p.mountable_sources().items() if source.above]
    c["above"][above] = 1
    for name, pose in p.poses().items():
        if pose.above and pose.standing_share > 0.0:
            c["repeat_times"][numbers[name]] = p.swing.repeat_time
    c["swing_pose_source"] = next((numbers[name] for name in p.poses() if numbers[name] in above), -1)
    c["shows_motion"][[TRACKS, *(numbers[name] for name in p.odometries())]] = 1
    c["shows_motion"][[GYROS, BRAKE]] = bool(p.gyros()), bool(above)
    for name, gyro in p.gyros().items():
        c["rate_scale"][numbers[name]], c["is_gyro"][numbers[name]] = gyro.sign * gyro.scale, 1
    c["attitude"], c["tilt_source"] = attitude_constants(p.attitude, measures_height=p.measures_height), -1
    if p.tilt_source is not None:
        imu = p.gyros()[p.tilt_source]
        c["tilt_source"], c["tilt_lever"] = numbers[p.tilt_source], imu.lever
        c["tilt_acceleration"], c["tilt_orientation"] = imu.use_acceleration, imu.use_orientation
        c["attitude"]["orientation_time"], c["attitude"]["gate"] = imu.orientation_time, c["gate_limits"][2]


def _set_rates(c: Config, p: SlipEstimatorParameters, numbers: Mapping[str, int]) -> None:
    """Set the rates of events by source; a source without own rates uses 1/s for its faults and jumps."""
    by_name = {name: (pose.fault_rate, pose.jump_rate) for name, pose in p.poses().items()}
    by_name |= {name: (compass.fault_rate, compass.jump_rate) for name, compass in p.compasses().items()}
    swing = p.events.swing_rate
    by_name |= {name: (encoder.fault_rate, swing) for name, encoder in p.swing_encoders().items()}
    by_name |= {name: (velocity.fault_rate, 1.0) for name, velocity in p.velocities().items()}
    by_number = {numbers[name]: rates for name, rates in by_name.items()}
    c["log_rates"] = -np.inf
    for k in range(MOST_SOURCES):
        rates = event_rates(p.events, *by_number.get(k, (1.0, 1.0)), p.bank.repeat_jitter)
        for event, rate in rates.items():
            c["log_rates"][event, k] = math.log(rate)
    c["log_rates"][Event.FAILED, BRAKE] = math.log(swing)


def _set_odometry(c: Config, p: SlipEstimatorParameters, numbers: Mapping[str, int]) -> None:
    c["odometries"] = len(p.odometries())
    for number, (name, odometry) in enumerate(p.odometries().items()):
        k = numbers[name]
        c["odometry_number"][k], c["odometry_noise"][k] = number, COVARIANCES.index(odometry.covariance)
        c["levers"][k], c["mountings"][k] = odometry.lever, odometry.mounting
        c["odometry_variances"][k] = odometry.velocity_stddev**2, odometry.yaw_rate_stddev**2
        c["odometry_gap"][k] = odometry.max_gap


def _set_source_states(c: Config, p: SlipEstimatorParameters, numbers: Mapping[str, int]) -> None:
    """Add states: offsets, biases of further gyros, scales of odometries, time-correlated tilt errors."""
    c["source_states"] = c["yaw_offsets"] = -1
    bias = float(c["prior_variance"][GYRO_BIAS]), c["process_noise"][..., GYRO_BIAS].copy()
    scalar_errors = dict.fromkeys(list(p.gyros())[1:], bias)
    scalar_errors |= {name: (o.drift**2, o.drift**2 / DRIFT_TIME) for name, o in p.odometries().items()}
    index, c["lean_errors"], c["offsets"], c["poses"] = SENSOR_ERRORS, -1, -1, len(p.poses())
    for name in (*p.poses(), *p.velocities()):
        c["offsets"][numbers[name]] = index
        index += 2
    yaw_offsets = {name: (stddev**2, stddev**2 / YAW_TIME) for name, stddev in p.yaw_offsets().items()}
    for field, states in (("yaw_offsets", yaw_offsets), ("source_states", scalar_errors)):
        for name, (variance, walk) in states.items():
            c[field][numbers[name]] = index
            c["prior_variance"][index] = c["prior_covariance"][index, index] = variance
            c["process_noise"][..., index] = walk
            index += 1
    if p.has_tilt_states:
        slope = p.attitude.unknown_slope
        c["lean_errors"] = index
        c["lean_stddevs"] = slope, p.attitude.accelerometer_bias_stddev / GRAVITY
        c["lean_decays"] = (0.0, 1.0 / p.attitude.unknown_slope_length), (1.0 / LEAN_TIME, 0.0)
        has_imu = p.tilt_source is not None
        variance = (_INITIAL_TILT / slope) ** 2 if has_imu and slope > 0.0 else 1.0
        for axis in (index, index + 1):
            c["prior_variance"][axis] = c["prior_covariance"][axis, axis] = variance
        index += 2
    if index > SENSOR_ERRORS:
        c["active"] = c["size"] = index
