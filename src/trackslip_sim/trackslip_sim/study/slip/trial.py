# SPDX-License-Identifier: Apache-2.0
"""One run of a cell: a truth and what the sensors say of it, drawn from one seed."""

import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.kalman.linear_algebra import root
from trackslip_estimation.slip.config import ConfigRecord
from trackslip_estimation.slip.models.model import GYRO_BIAS
from trackslip_sim.study.slip.drive import Drive, fix_deviations
from trackslip_sim.study.slip.kernels import Rows, draw, nearest, slips_of
from trackslip_sim.study.slip.parameters import MATCHED, Cell

FloatArray = NDArray[np.float64]


class Setting(NamedTuple):
    """What the runs of a cell have in common."""

    cell: Cell
    drive: Drive
    rows: Rows  # measurements without values
    config: ConfigRecord
    linear: ConfigRecord  # of the same model under the EKF
    sigma_heading: float  # rad


class Trial(NamedTuple):
    """One run before it is filtered."""

    rows: Rows
    start: tuple[FloatArray, FloatArray]  # mean and covariance that a filter begins with
    start_state: FloatArray  # (n,) the truth there
    states: FloatArray  # (k, n) the truth at the rows, as states of the filter's model
    slips: FloatArray  # (k, 3) left slip, right slip, slip angle


def generator(cell: Cell, seed: int) -> np.random.Generator:
    """The same for every filter and σ, so that these compare; another truth or soil has draws of its own."""
    return np.random.default_rng((seed, zlib.crc32(f"{cell.truth} {cell.soil}".encode())))


def make_trial(setting: Setting, seed: int) -> Trial:
    """Draw one run."""
    random = generator(setting.cell, seed)
    return (_matched if setting.cell.truth == MATCHED else _shear)(setting, random)


def _matched(setting: Setting, random: np.random.Generator) -> Trial:
    """The truth is the filter's model: a start from its covariance, noise from its Q and R."""
    rows, true_drives = setting.rows, setting.drive.true_drives
    mean, covariance = start = _start(setting, np.zeros(3))
    n = mean.size
    start_state = mean + root(covariance) @ random.standard_normal(n)
    normals = random.standard_normal((len(rows.drives), n + 3))
    true_rows = Rows(rows.measurements, true_drives)
    states, values = draw(true_rows, start_state, normals, setting.linear)
    slips = slips_of(states, true_drives, setting.linear)
    return Trial(_with_values(rows, values), start, start_state, states, slips)


def _shear(setting: Setting, random: np.random.Generator) -> Trial:
    """The truth has nothing of the model; only the gyro's bias is drawn as the filter expects it."""
    at, fixes, rates = setting.drive.truth, setting.drive.fixes, setting.drive.rates
    poses = np.stack((at.x, at.y, at.yaw), axis=1)
    deviations = fix_deviations(setting.cell, setting.sigma_heading)
    start = _start(setting, deviations * random.standard_normal(3))
    mean, covariance = prior = _start(setting, np.zeros(3))
    mean[GYRO_BIAS] = np.sqrt(covariance[GYRO_BIAS, GYRO_BIAS]) * random.standard_normal()
    values = np.zeros((len(poses), 3))
    values[fixes] = poses[fixes] + deviations * random.standard_normal((np.count_nonzero(fixes), 3))
    noise = setting.cell.sigma_omega * random.standard_normal(np.count_nonzero(rates))
    values[rates, 0] = at.yaw_rate[rates] + mean[GYRO_BIAS] + noise
    twists = np.stack((at.v_x, at.yaw_rate), axis=1)
    true_speeds = np.stack((at.left_speed, at.right_speed), axis=1)
    states = nearest(poses, twists, true_speeds, prior, setting.linear)
    slips = np.stack((at.left_slip, at.right_slip, at.slip_angle), axis=1)
    return Trial(_with_values(setting.rows, values), start, mean, states, slips)


def _start(setting: Setting, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n,) and covariance (n, n) that a filter begins with at a fix."""
    c = setting.config[0]
    mean, covariance = c["prior_mean"].copy(), np.diag(c["prior_variance"])
    mean[:3] = pose
    covariance[:3, :3] = np.diag(np.square(fix_deviations(setting.cell, setting.sigma_heading)))
    return mean, covariance


def _with_values(rows: Rows, values: FloatArray) -> Rows:
    measurements = rows.measurements.copy()
    measurements["value"] = values
    return rows._replace(measurements=measurements)
