# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""One run of a cell: a truth and its measurements, drawn from one seed."""

import math
import zlib
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.kalman.linear_algebra import root
from trackslip_estimation.slip.config import ConfigRecord
from trackslip_estimation.slip.levers import to_sensor
from trackslip_estimation.slip.models.model import FIX_DELAY, GYRO_BIAS, GYRO_SCALE, SIZE, SWING, SWING_RATE
from trackslip_estimation.slip.models.model import POSE as OF_POSE
from trackslip_estimation.slip.models.speed import ROTATION_OFFSET
from trackslip_estimation.slip.models.turning import ASYMMETRY
from trackslip_estimation.slip.models.turning import CODE as TURNING
from trackslip_estimation.slip.records import POSE, YAW_RATE
from trackslip_sim.machine import drawn
from trackslip_sim.machine.drawn import (
    DrawnMachine,
    MotionErrors,
    draw_machine,
    integrate_twists,
    interpolate_columns,
    uniform_variance,
)
from trackslip_sim.machine.sensors import tilt_readings
from trackslip_sim.study.slip.drive import Drive, fix_deviations
from trackslip_sim.study.slip.kernels import RecordArray, Rows, draw_from_model, nearest_states, slips_of
from trackslip_sim.study.slip.parameters import DRAWN, MATCHED, SHEAR, Cell

_DRAWN_STATES = 19  # leading states with drawn noise; a study does not use the states after them


class Setting(NamedTuple):
    """Data common to the runs of a cell."""

    cell: Cell
    drive: Drive
    rows: Rows  # measurements without values
    config: ConfigRecord
    linear: ConfigRecord  # the same model with the EKF
    sigma_heading: float  # rad


class Trial(NamedTuple):
    """One run before filtering."""

    rows: Rows
    start: tuple[FloatArray, FloatArray]  # initial mean and covariance of the filter
    start_state: FloatArray  # (n,) true state at the start
    truth_covariance: FloatArray  # (n, n) of the true state about the filter's initial mean
    states: FloatArray  # (k, n) true states of the filter's model at the rows
    slips: FloatArray  # (k, 3) left slip, right slip, slip angle
    machine: DrawnMachine = DrawnMachine()


def run_generator(cell: Cell, seed: int) -> np.random.Generator:
    """Random generator of a run: equal for all filters and σ, different for each truth and soil."""
    return np.random.default_rng((seed, zlib.crc32(f"{cell.truth} {cell.soil}".encode())))


def make_trial(setting: Setting, seed: int) -> Trial:
    """Draw one run."""
    random = run_generator(setting.cell, seed)
    trial = {MATCHED: _matched_trial, SHEAR: _shear_trial, DRAWN: _drawn_trial}[setting.cell.truth](
        setting, random
    )
    if setting.cell.terrain:
        _write_tilt_readings(setting, trial.rows.measurements, random)
    return trial


def _write_tilt_readings(setting: Setting, measurements: RecordArray, random: np.random.Generator) -> None:
    """Write roll rate, pitch rate and specific force into the (k,) measurements of a run."""
    drive = setting.drive
    noise, rates = replace(drive.noise, gyro_stddev=setting.cell.sigma_omega), drive.is_rate
    readings = tilt_readings(drive.full_truth, drive.truth.t[rates], noise, random)
    measurements["value"][rates, 1:] = readings[:, :2]
    measurements["acceleration"][rates] = readings[:, 2:]
    measurements["acceleration_variance"][rates] = noise.acceleration_stddev**2


def _matched_trial(setting: Setting, random: np.random.Generator) -> Trial:
    """A run whose truth is the filter's model: start drawn from its covariance, noise from its Q and R."""
    rows, true_drives = setting.rows, setting.drive.true_drives
    mean, covariance = start = _initial_estimate(setting, np.zeros(3))
    start_state = mean + root(covariance) @ _normals(random, 1, 0)[0]
    normals = _normals(random, len(rows.drives), 3)
    true_rows = Rows(rows.measurements, true_drives)
    states, values = draw_from_model(true_rows, start_state, normals, setting.linear)
    slips = slips_of(states, true_drives, setting.linear)
    return Trial(_with_values(rows, values), start, start_state, covariance, states, slips)


def _normals(random: np.random.Generator, count: int, extra: int) -> FloatArray:
    """(count, SIZE + extra) standard normal draws for states and measurements."""
    drawn = random.standard_normal((count, _DRAWN_STATES + extra))
    normals = np.zeros((count, SIZE + extra))
    normals[:, :_DRAWN_STATES], normals[:, SIZE:] = drawn[:, :_DRAWN_STATES], drawn[:, _DRAWN_STATES:]
    return normals


def _shear_trial(setting: Setting, random: np.random.Generator) -> Trial:
    """A run on the shear truth, which is independent of the model; initial errors follow the prior.

    These are the errors of the gyro bias, and of the swing angle of a cab without encoder.
    """
    drive = setting.drive
    at, fixes, rates = drive.truth, drive.is_fix, drive.is_rate
    poses = np.stack((at.x, at.y, at.yaw), axis=1)
    deviations = fix_deviations(setting.cell, setting.sigma_heading)
    start_fix = drive.start_sensor_pose + deviations * random.standard_normal(3)
    mean, covariance = prior = _initial_estimate(setting, drive.start_sensor_pose)
    mean[OF_POSE] = 0.0  # at the origin
    mean[GYRO_BIAS] = np.sqrt(covariance[GYRO_BIAS, GYRO_BIAS]) * random.standard_normal()
    values = np.zeros((len(poses), 3))
    values[fixes] = drive.sensor_poses[fixes] + deviations * random.standard_normal(
        (np.count_nonzero(fixes), 3)
    )
    noise = setting.cell.sigma_omega * random.standard_normal(np.count_nonzero(rates))
    values[rates, 0] = drive.gyro_yaw_rate[rates] + mean[GYRO_BIAS] + noise
    twists = np.stack((at.v_x, at.yaw_rate), axis=1)
    true_speeds = np.stack((at.left_speed, at.right_speed), axis=1)
    states = nearest_states(poses, twists, true_speeds, drive.true_drives, prior, setting.linear)
    swing_error = 0.0  # rad, initial error of the swing angle
    if drive.swings:
        swing_error = _write_swing(setting, mean, states, values, random)
    start = _initial_estimate(setting, start_fix, swing_error)
    slips = np.stack((at.left_slip, at.right_slip, at.slip_angle), axis=1)
    return Trial(_with_values(setting.rows, values), start, mean, covariance, states, slips)


def _write_swing(
    setting: Setting, start: FloatArray, states: FloatArray, values: FloatArray, random: np.random.Generator
) -> float:
    """Write the true swing into ``start`` (n,) and ``states`` (k, n), encoder angles into ``values`` (k, 3).

    Returns the initial error of the filter's σ, rad: 0 with an encoder.
    """
    drive, c = setting.drive, setting.linear[0]
    at, is_angle = drive.truth, drive.is_angle
    start[SWING] = drive.full_truth.swing[0]
    states[:, SWING], states[:, SWING_RATE] = at.swing, at.swing_rate
    states[:, ROTATION_OFFSET] += c["swing"]["balance"] * (np.cos(at.swing) - np.cos(start[SWING]))
    source = setting.rows.measurements["source"][is_angle]
    noise = setting.rows.measurements["noise"][is_angle]
    offset = c["heading_offset"][source]
    values[is_angle, 0] = (
        at.swing[is_angle] + offset + np.sqrt(noise[:, 0, 0]) * random.standard_normal(len(noise))
    )
    return 0.0 if is_angle.any() else math.sqrt(c["prior_variance"][SWING]) * random.standard_normal()


def _drawn_trial(setting: Setting, random: np.random.Generator) -> Trial:
    """A run of a drawn machine on the shear truth; the estimator has the nominal parameters.

    Slips refer to the nominal rolling radius: an error of the radius is not observable apart from slip.
    """
    drive, machine, c = setting.drive, draw_machine(random), setting.config[0]
    truth, at, fixes, rates = drive.full_truth, drive.truth, drive.is_fix, drive.is_rate
    r, B, period = c["rolling_radius"], c["tread"], float(truth.t[1])
    errors = MotionErrors(machine, B, period, random)
    twists = errors.apply(
        r * np.stack((truth.left_speed, truth.right_speed), axis=1),
        np.stack((truth.v_x, truth.v_y, truth.yaw_rate), axis=1),
    )
    poses = np.concatenate((np.zeros((1, 3)), integrate_twists(twists[1:], period, np.zeros(3))))
    delay = machine.fix_delay
    row_poses = interpolate_columns(at.t, truth.t, poses)
    row_twists = interpolate_columns(at.t, truth.t, twists)
    deviations = fix_deviations(setting.cell, setting.sigma_heading) * np.sqrt(machine.fix_variance)
    start = _initial_estimate(setting, deviations * random.standard_normal(3))
    mean, covariance = prior = _initial_estimate(setting, np.zeros(3))
    mean[GYRO_BIAS] = np.sqrt(covariance[GYRO_BIAS, GYRO_BIAS]) * random.standard_normal()
    stamp_error, truth_covariance = c["stamp_errors"].max(), covariance.copy()
    mean[GYRO_SCALE], mean[FIX_DELAY] = machine.gyro_scale - 1.0, delay / stamp_error
    truth_covariance[GYRO_SCALE, GYRO_SCALE] = uniform_variance(drawn.GYRO_SCALE)
    truth_covariance[FIX_DELAY, FIX_DELAY] = uniform_variance(drawn.FIX_DELAY / stamp_error)
    if c["model"] == TURNING:
        mean[ASYMMETRY] = machine.asymmetry
        truth_covariance[ASYMMETRY, ASYMMETRY] = uniform_variance(drawn.ASYMMETRY)
    values, fix_times = np.zeros((len(row_poses), 3)), at.t[fixes] - delay
    values[fixes] = interpolate_columns(fix_times, truth.t, poses)
    values[fixes] += deviations * random.standard_normal((len(fix_times), 3))
    noise = machine.gyro_noise * setting.cell.sigma_omega * random.standard_normal(np.count_nonzero(rates))
    values[rates, 0] = machine.gyro_scale * row_twists[rates, 2] + mean[GYRO_BIAS] + noise
    true_speeds = np.stack((at.left_speed, at.right_speed), axis=1)
    states = nearest_states(
        row_poses, row_twists[:, ::2].copy(), true_speeds, drive.true_drives, prior, setting.linear
    )
    slips = slips_of(states, drive.true_drives, setting.linear)
    slips[:, 2] = at.slip_angle
    return Trial(_with_values(setting.rows, values), start, mean, truth_covariance, states, slips, machine)


def with_machine_noise(rows: Rows, machine: DrawnMachine, config: ConfigRecord) -> tuple[Rows, ConfigRecord]:
    """Rows and model parameters with the true noise of a machine, for the bound."""
    measurements, true = rows.measurements.copy(), config.copy()
    noise, kind = measurements["noise"], measurements["kind"]
    noise[kind == YAW_RATE] *= machine.gyro_noise**2
    noise[kind == POSE] *= machine.fix_variance
    for name in ("straight", "turning", "changing"):
        true["velocity_errors"][name] *= machine.velocity_errors
    return rows._replace(measurements=measurements), true


def _initial_estimate(
    setting: Setting, pose: FloatArray, swing_error: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Initial mean (n,) and covariance (n, n) of a filter at a fix, with an error of the swing, rad."""
    c = setting.config[0]
    mean, covariance = c["prior_mean"].copy(), c["prior_covariance"].copy()
    mean[:3] = pose
    covariance[:3, :3] = np.diag(np.square(fix_deviations(setting.cell, setting.sigma_heading)))
    begin, source = setting.drive.begin.best[0], setting.drive.begin.measurements["source"][0]
    mean[SWING] += swing_error
    to_sensor(mean[: c["size"]], covariance, begin["attitude"]["level"], source, -1.0, c)
    return mean, covariance


def _with_values(rows: Rows, values: FloatArray) -> Rows:
    measurements = rows.measurements.copy()
    measurements["value"] = values
    return rows._replace(measurements=measurements)
