# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The drive on one soil: inputs of the estimator that all runs on this soil share.

Runs differ in their noise. The rounding of the encoders belongs to the drive and is the same for all runs.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from trackslip_common.arrays import BoolArray, FloatArray, IntArray
from trackslip_common.errors import InputError
from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.log import make_log, run_in_one_block, start_of_log
from trackslip_estimation.slip.measurements import Measurement, PoseFix, Sprockets, SwingAngle, YawRate
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.records import EVENT, ON_SWING, POSE, SPROCKETS, YAW_RATE, to_records
from trackslip_estimation.slip.window import Window
from trackslip_sim.machine.placement import upper_poses
from trackslip_sim.machine.sensors import SensorNoise, mounting_of
from trackslip_sim.parameters import load_emulator_parameters
from trackslip_sim.scenarios.scenario import load_scenario
from trackslip_sim.study.slip.kernels import RecordArray, Rows, set_attitude
from trackslip_sim.study.slip.parameters import NODE, Cell, StudyParameters
from trackslip_sim.truth.record import Truth
from trackslip_sim.truth.simulate import simulate
from trackslip_tools.replay.scoring import MIN_MOVING_SPEED


@dataclass(frozen=True, eq=False)
class Drive:
    """Rows of measurements in the order of their stamps, after the fix at time 0 that starts the filters."""

    full_truth: Truth  # evenly sampled
    truth: Truth  # at the rows
    begin: Window  # state of the estimator at the start
    rows: Rows  # values and noises are set per run and cell
    true_drives: RecordArray  # (k,) drives of the rows, from angles without rounding
    samples: IntArray  # rows of the sprocket samples, at which the estimator publishes
    scored: IntArray  # (s,) ``samples`` after settling
    moving: BoolArray  # (s,) whether slips are defined
    turning: BoolArray  # (s,) moving, and in a turn
    sensor_poses: FloatArray  # (k, 3) true pose of the sensor of the fixes
    start_sensor_pose: FloatArray  # (3,) true pose of this sensor at the start
    gyro_yaw_rate: FloatArray  # (k,) true yaw rate of the gyro's mount, rad/s
    swings: bool  # whether any sensor is mounted on the upper structure
    fix_size: int  # components of a fix: 3, or 2 without heading
    noise: SensorNoise  # of the other axes of the inertial unit, used on terrain

    @property
    def is_fix(self) -> BoolArray:
        """(k,) whether a row is a pose."""
        fixes: BoolArray = self.rows.measurements["kind"] == POSE
        return fixes

    @property
    def is_rate(self) -> BoolArray:
        """(k,) whether a row is a yaw rate."""
        rates: BoolArray = self.rows.measurements["kind"] == YAW_RATE
        return rates

    @property
    def is_angle(self) -> BoolArray:
        """(k,) whether a row is an angle of the swing encoder."""
        angles: BoolArray = self.rows.measurements["kind"] == ON_SWING
        return angles

    def with_noise(self, cell: Cell, sigma_heading: float) -> RecordArray:
        """(k,) measurements with the noises of a cell, without the values of a run."""
        measurements = self.rows.measurements.copy()
        measurements["noise"][self.is_fix] = np.diag(np.square(fix_deviations(cell, sigma_heading)))
        for axis in range(3 if cell.terrain else 1):
            measurements["noise"][self.is_rate, axis, axis] = cell.sigma_omega**2
        return measurements


def fix_deviations(cell: Cell, sigma_heading: float) -> FloatArray:
    """(3,) standard deviations of a fix in x, y, heading; m, m, rad."""
    return np.array((cell.sigma_xy, cell.sigma_xy, sigma_heading))


def make_drive(p: StudyParameters, estimator: SlipEstimatorParameters, soil: str, terrain: str = "") -> Drive:
    """The drive of the scenario on the shear truth of a soil; an empty ``terrain``: the scenario's own.

    Raises:
        InputError: scenario, soil or sources are refused, or on level ground nothing moves after settling.
    """
    truth = _simulate(p, estimator, soil, terrain)
    end = int(truth.duration * p.sprocket_rate + 1e-6) / p.sprocket_rate
    sprockets = list(_sprockets(truth, p, end, estimator.encoder_resolution))
    readings = [*_rates(p.gyro_rate, end, estimator), *_angles(p.swing_rate, end, estimator)]
    measurements = [*sprockets, *readings, *_fixes(p, end, estimator)]
    begin, rows = _read_log(measurements, estimator)
    stamps_ns, kinds = rows.measurements["stamp_ns"], rows.measurements["kind"]
    at = truth.interpolate(stamps_ns * 1e-9)
    samples = np.flatnonzero(kinds == SPROCKETS)
    scored = samples[at.t[samples] > p.settling]
    if terrain:
        rates = np.stack((at.roll_rate, at.pitch_rate, at.yaw_rate), axis=1)
        set_attitude(rows.drives, np.stack((at.roll, at.pitch), axis=1), rates)
    moving = _is_moving(at, estimator)[scored]
    if not moving.any() and not terrain:  # too steep a slope: only the pose is scored
        raise InputError(
            f"{NODE}: after {p.settling:g} s of settling nothing moves in '{p.scenario}' on {soil}"
        )
    return Drive(
        full_truth=truth,
        truth=at,
        begin=begin,
        rows=rows,
        true_drives=_true_drives(truth, at, rows, 1.0 / p.sprocket_rate),
        samples=samples,
        scored=scored,
        moving=moving,
        turning=moving & (rows.drives["motion"]["motion"][scored] == Motion.TURNING),
        noise=load_emulator_parameters({}).noise,
        sensor_poses=_sensor_poses(at, estimator),
        start_sensor_pose=_sensor_poses(truth.interpolate(0.0), estimator)[0],
        gyro_yaw_rate=_gyro_yaw_rate(at, estimator),
        swings=estimator.swings,
        fix_size=3 if estimator.poses()[_first_source(estimator.poses(), "pose_sources")].use_heading else 2,
    )


def _simulate(p: StudyParameters, estimator: SlipEstimatorParameters, soil: str, terrain: str) -> Truth:
    scenario = load_scenario(p.scenario, terrain, p.duration)
    whole, upper = estimator.vehicle.whole(), estimator.vehicle.upper_structure
    return simulate(scenario, soil=soil, vehicle=whole, upper=upper)


def _read_log(measurements: list[Measurement], p: SlipEstimatorParameters) -> tuple[Window, Rows]:
    """The state at the start, and the rows after it with their sprocket speeds."""
    log = make_log(to_records(measurements, SlipEstimator(p).sources), p)
    start, config = start_of_log(log, p, np.zeros(0, EVENT))
    window = run_in_one_block(log.rest, start, config)
    if window.best["coasting"][: window.count].any():
        raise InputError(
            f"{NODE}: sprocket_rate: the estimator takes the time between two samples for silence"
        )
    drives = window.best[1 : window.count].copy()
    drives["adaptation"]["track_variance"] = 0.0  # bound and matched truth have no such error
    return start, Rows(log.rest, drives)


def _sprockets(truth: Truth, p: StudyParameters, end: float, resolution: float) -> Iterator[Measurement]:
    """Sprocket samples with positions in whole encoder counts."""
    times = np.arange(round(end * p.sprocket_rate) + 1) / p.sprocket_rate
    at = truth.interpolate(times)
    angles = np.stack((at.left_angle, at.right_angle), axis=1)
    counted = np.floor(angles / resolution) * resolution if resolution > 0.0 else angles
    for t, (left, right) in zip(times.tolist(), counted.tolist(), strict=True):
        yield Sprockets("sprockets", _to_ns(t), 0.0, 0.0, (left, right))


def _rates(rate: float, end: float, estimator: SlipEstimatorParameters) -> Iterator[Measurement]:
    """Yaw rates at ``rate`` Hz with placeholder values."""
    source = _first_source(estimator.gyros(), "yaw_rate_sources")
    for k in range(1, int(end * rate + 1e-6) + 1):
        yield YawRate(source, _to_ns(k / rate), 0.0, 1.0)


def _fixes(p: StudyParameters, end: float, estimator: SlipEstimatorParameters) -> Iterator[Measurement]:
    """Fixes from time 0 on, with placeholder values."""
    source = _first_source(estimator.poses(), "pose_sources")
    covariance = np.diag((1.0, 1.0, p.sigma_heading**2))
    for k in range(int(end * p.fix_rate + 1e-6) + 1):
        yield PoseFix(source, _to_ns(k / p.fix_rate), np.zeros(3), covariance)


def _angles(rate: float, end: float, estimator: SlipEstimatorParameters) -> Iterator[Measurement]:
    """Angles of the first swing encoder with placeholder values; none without an encoder."""
    stddev = mounting_of(estimator.vehicle).encoder_stddev
    for source in list(estimator.swing_encoders())[:1]:
        for k in range(1, int(end * rate + 1e-6) + 1):
            yield SwingAngle(source, _to_ns(k / rate), 0.0, stddev**2)


def _sensor_poses(at: Truth, estimator: SlipEstimatorParameters) -> FloatArray:
    """(k, 3) true pose of the sensor of the fixes, on level ground."""
    source = next(iter(estimator.poses().values()))
    poses = np.stack((at.x, at.y, at.yaw), axis=1)
    if source.above:
        poses = upper_poses(poses, at.swing, estimator.vehicle.swing_axis)
    ahead, left, _ = source.lever
    if ahead != 0.0 or left != 0.0:
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        poses[:, 0] += cos * ahead - sin * left
        poses[:, 1] += sin * ahead + cos * left
    return poses


def _gyro_yaw_rate(at: Truth, estimator: SlipEstimatorParameters) -> FloatArray:
    """(k,) true yaw rate of the gyro's mount, rad/s."""
    above = next(iter(estimator.gyros().values())).above
    return at.yaw_rate + at.swing_rate if above else at.yaw_rate


def _first_source(sources: Mapping[str, object], name: str) -> str:
    if not sources:
        raise InputError(f"{NODE}: {name}: none; accepted: one or more")
    return next(iter(sources))


def _to_ns(t: float) -> int:
    return round(t * 1e9)


def _true_drives(truth: Truth, at: Truth, rows: Rows, period: float) -> RecordArray:
    """(k,) the rows' drives with the true mean speeds over the sample interval that contains each row."""
    ends = np.ceil(at.t / period - 1e-6) * period
    before, after = truth.interpolate(ends - period), truth.interpolate(ends)
    drives = rows.drives.copy()
    drives["speeds"]["left"] = (after.left_angle - before.left_angle) / period
    drives["speeds"]["right"] = (after.right_angle - before.right_angle) / period
    drives["speeds"]["variance"] = drives["speeds"]["angle_variance"] = 0.0
    return drives


def _is_moving(at: Truth, estimator: SlipEstimatorParameters) -> BoolArray:
    """(k,) whether machine (as in the scores of a replay) and both tracks move; else slips are undefined."""
    vehicle = estimator.vehicle.kinematics
    on_ground = np.abs(at.v_x) + np.abs(at.yaw_rate) * vehicle.tread / 2.0 > MIN_MOVING_SPEED
    slower = vehicle.rolling_radius * np.minimum(np.abs(at.left_speed), np.abs(at.right_speed))
    moving: BoolArray = on_ground & (slower > MIN_MOVING_SPEED)
    return moving
