# SPDX-License-Identifier: Apache-2.0
"""A cell's runs: drawn, filtered, and held against the truth and against the bound."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trackslip_estimation.slip.batch import run
from trackslip_estimation.slip.models.model import POSE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, make_filter
from trackslip_sim.study.slip.drive import Drive
from trackslip_sim.study.slip.kernels import bound, compare, variances
from trackslip_sim.study.slip.parameters import SHEAR, Cell, StudyParameters
from trackslip_sim.study.slip.results import Row, Sums, summary, total
from trackslip_sim.study.slip.trial import Setting, Trial, make_trial

FloatArray = NDArray[np.float64]
Map = Callable[[Callable[[int], Sums], Iterable[int]], Iterable[Sums]]


def evaluate(
    cell: Cell, drive: Drive, p: StudyParameters, estimator: SlipEstimatorParameters, map_: Map = map
) -> Row:
    """All runs of a cell; ``map_`` may spread them over threads."""
    setting = make_setting(cell, drive, p, estimator)
    common = least(setting, make_trial(setting, 0)) if cell.truth == SHEAR else None  # all drive the same

    def one(seed: int) -> Sums:
        trial = make_trial(setting, seed)
        return score(setting, trial, least(setting, trial) if common is None else common)

    return summary(cell, p, total(map_(one, range(p.seeds))), drive)


def make_setting(cell: Cell, drive: Drive, p: StudyParameters, estimator: SlipEstimatorParameters) -> Setting:
    """What the runs of a cell have in common."""
    filter_ = make_filter(estimator.changed({"filter": cell.filter}))
    linear = filter_.constants.copy()
    linear["sigma_points"] = False  # but Jacobians
    return Setting(cell, drive, drive.log(cell, p.sigma_heading), filter_, linear, p.sigma_heading)


def score(setting: Setting, trial: Trial, bounds: FloatArray) -> Sums:
    """One run, filtered; ``bounds`` (s, 6) are its least variances."""
    drive, scored = setting.drive, setting.drive.scored
    result = run(trial.log, setting.filter, trial.start)
    errors, nees = compare(
        scored, result.means, result.covariances, *drive.told, trial.states, trial.slips, setting.linear
    )
    settled = np.arange(len(result.nis)) >= scored[0]
    nis = np.array([result.nis[settled & kind].mean() for kind in (drive.fixes, drive.rates)])
    return Sums(np.square(errors), bounds, nees, nis)


def least(setting: Setting, trial: Trial) -> FloatArray:
    """(s, 6) variances by the posterior Cramér–Rao bound."""
    drive, log, linear = setting.drive, trial.log, setting.linear
    rows = (log.times, log.speeds, log.flags, log.noises)
    covariances = bound(*rows, trial.states, trial.start_state, trial.start.covariance, linear)
    return variances(drive.scored, trial.states, covariances, *drive.told, linear)


class Trace(NamedTuple):
    """One run to be drawn, at the sprocket samples."""

    t: FloatArray  # (s,) s
    poses: FloatArray  # (s, 3) true
    estimated_poses: FloatArray  # (s, 3)
    slips: FloatArray  # (s, 3) true left slip, right slip, slip angle
    estimated_slips: FloatArray  # (s, 3)
    slip_deviations: FloatArray  # (s, 3) as the filter sees them


def trace(setting: Setting, seed: int) -> Trace:
    """One run of a cell."""
    trial, drive = make_trial(setting, seed), setting.drive
    result = run(trial.log, setting.filter, trial.start)
    estimated = (drive.samples, result.means, result.covariances, *drive.told)
    errors, _ = compare(*estimated, trial.states, trial.slips, setting.linear)
    deviations = np.sqrt(variances(*estimated, setting.linear))
    t, poses, slips = (
        drive.truth.t[drive.samples],
        trial.states[drive.samples, POSE],
        trial.slips[drive.samples],
    )
    return Trace(t, poses, poses + errors[:, :3], slips, slips + errors[:, 3:], deviations[:, 3:])
