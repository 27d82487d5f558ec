# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The runs of a cell: drawn, filtered, and compared with the truth and the Cramér–Rao bound."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from trackslip_common.arrays import FloatArray
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.log import run_in_one_block
from trackslip_estimation.slip.models.model import POSE
from trackslip_estimation.slip.parameters import SlipEstimatorParameters
from trackslip_estimation.slip.window import Window, copy_first_entry, make_like
from trackslip_sim.study.slip.drive import Drive
from trackslip_sim.study.slip.kernels import (
    SLIPS,
    cramer_rao_bound,
    estimation_errors,
    new_scratch,
    output_variances,
)
from trackslip_sim.study.slip.parameters import DRAWN, SHEAR, Cell, StudyParameters
from trackslip_sim.study.slip.results import IGNORING_ATTITUDE, Row, Sums, sum_runs, summary
from trackslip_sim.study.slip.trial import Setting, Trial, make_trial, with_machine_noise

_UNSPECIFIED_SOURCE = "unknown_source"  # of fixes, with default settings: its stamp error is unspecified


def evaluate(cell: Cell, drive: Drive, p: StudyParameters, estimator: SlipEstimatorParameters) -> Row:
    """The row of a cell over all its runs; on terrain also the errors of a filter without attitude."""
    row = _evaluate(cell, drive, p, estimator)
    if not cell.terrain:
        return row
    flat = _evaluate(cell, drive, p, estimator.changed({"use_attitude": False}))
    return replace(row, **{f"ignoring_{name}": getattr(flat, name) for name in IGNORING_ATTITUDE})


def _evaluate(cell: Cell, drive: Drive, p: StudyParameters, estimator: SlipEstimatorParameters) -> Row:
    setting = make_setting(cell, drive, p, estimator)
    is_shear = cell.truth == SHEAR  # all seeds have the same drive and bound
    common = least_variances(setting, make_trial(setting, 0)) if is_shear else None

    def score_seed(seed: int) -> Sums:
        trial = make_trial(setting, seed)
        return score(setting, trial, least_variances(setting, trial) if common is None else common)

    return summary(cell, p, sum_runs(map(score_seed, range(p.seeds))), drive)


def make_setting(cell: Cell, drive: Drive, p: StudyParameters, estimator: SlipEstimatorParameters) -> Setting:
    """Data common to the runs of a cell."""
    config, linear = (make_config(estimator.changed({"filter": name})) for name in (cell.filter, "ekf"))
    for c in (config, linear):
        c["heading_ceiling"] = np.inf
        c["position_floor"] = c["heading_floor"] = 0.0
        if cell.truth == DRAWN:
            c["stamp_errors"] = drawn_machine_parameters(estimator).poses()[_UNSPECIFIED_SOURCE].stamp_error
        else:  # the statistics given to the filters are exact
            c["gate_limits"], c["stamp_errors"] = np.inf, 0.0
        if drive.swings:  # fixes on a cab have no time-correlated error
            c["repeat_times"] = c["standing_share"] = 0.0
    rows = drive.rows._replace(measurements=drive.with_noise(cell, p.sigma_heading))
    return Setting(cell, drive, rows, config, linear, p.sigma_heading)


def drawn_machine_parameters(estimator: SlipEstimatorParameters) -> SlipEstimatorParameters:
    """Estimator parameters for a drawn machine: its fixes come from an unspecified source."""
    return estimator.changed({"pose_sources": (_UNSPECIFIED_SOURCE,)})


def score(setting: Setting, trial: Trial, bounds: FloatArray) -> Sums:
    """Filter and score one run; ``bounds`` (s, 7) are its least variances."""
    drive, scored = setting.drive, setting.drive.scored
    window = _run_filter(setting, trial)
    states, nis_of = window.best[1 : window.count], window.updates["nis"][1 : window.count]
    errors, nees = estimation_errors(scored, states, trial.states, trial.slips, new_scratch(), setting.linear)
    settled = np.arange(len(nis_of)) >= scored[0]
    nis = np.array([nis_of[settled & kind].mean() for kind in (drive.is_fix, drive.is_rate)])
    return Sums(np.square(errors), bounds, nees, nis)


def _run_filter(setting: Setting, trial: Trial) -> Window:
    """The filtered states of a run, after its start."""
    drive = setting.drive
    begin = make_like(drive.begin, 2)
    copy_first_entry(begin, drive.begin)
    begin.best["mean"][0], begin.best["covariance"][0] = trial.start
    return run_in_one_block(trial.rows.measurements, begin, setting.config)


def least_variances(setting: Setting, trial: Trial) -> FloatArray:
    """(s, 7) least variances by the posterior Cramér–Rao bound."""
    drive, linear = setting.drive, setting.linear
    rows, true = with_machine_noise(trial.rows, trial.machine, linear)
    covariances = cramer_rao_bound(rows, trial.states, trial.start_state, trial.truth_covariance, true)
    return output_variances(drive.scored, trial.states, covariances, trial.rows.drives, new_scratch(), linear)


class Trace(NamedTuple):
    """One run for a figure, at the sprocket samples."""

    t: FloatArray  # (s,) s
    poses: FloatArray  # (s, 3) true
    estimated_poses: FloatArray  # (s, 3)
    slips: FloatArray  # (s, 3) true left slip, right slip, slip angle
    estimated_slips: FloatArray  # (s, 3)
    slip_deviations: FloatArray  # (s, 3) standard deviations stated by the filter


def trace(setting: Setting, seed: int) -> Trace:
    """One run of a cell for a figure."""
    trial, drive = make_trial(setting, seed), setting.drive
    window = _run_filter(setting, trial)
    states = window.best[1 : window.count]
    errors, _ = estimation_errors(
        drive.samples, states, trial.states, trial.slips, new_scratch(), setting.linear
    )
    means, covariances = states["mean"], states["covariance"]
    deviations = np.sqrt(
        output_variances(drive.samples, means, covariances, states, new_scratch(), setting.linear)
    )
    t = drive.truth.t[drive.samples]
    poses = trial.states[drive.samples, POSE]
    slips = trial.slips[drive.samples]
    return Trace(t, poses, poses + errors[:, :3], slips, slips + errors[:, SLIPS], deviations[:, SLIPS])
