# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The study: the filters' inputs, the bound, and the detection of inconsistent filters."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.records import assert_same_bits
from fixtures.study_bench import Bench, assert_same_bound, expected_bound, make_bench
from numpy.typing import NDArray
from scipy.stats import chi2

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_estimation.slip.config import make_config
from trackslip_estimation.slip.models import free_slips
from trackslip_estimation.slip.models.dispatch import twist
from trackslip_estimation.slip.models.model import FIX_DELAY, GYRO_BIAS, GYRO_SCALE
from trackslip_estimation.slip.models.model import POSE as OF_POSE
from trackslip_estimation.slip.models.turning import ASYMMETRY
from trackslip_estimation.slip.motion import Motion, MotionState, Speeds, smoothed_speeds
from trackslip_estimation.slip.parameters import SlipEstimatorParameters, load_slip_parameters
from trackslip_estimation.slip.records import MEASUREMENT, POSE, STATE
from trackslip_sim.study.slip.drive import make_drive
from trackslip_sim.study.slip.evaluate import least_variances, score, trace
from trackslip_sim.study.slip.kernels import Rows, cramer_rao_bound
from trackslip_sim.study.slip.parameters import (
    DRAWN,
    MATCHED,
    SHEAR,
    Cell,
    StudyParameters,
    load_study_parameters,
)
from trackslip_sim.study.slip.results import Row, Sums, mean_bounds, sum_runs
from trackslip_sim.study.slip.trial import Setting, Trial, make_trial

SEEDS = 8
PERIOD = 0.01  # s


@pytest.fixture(scope="module")
def p() -> StudyParameters:
    return load_study_parameters({"scenario": "slalom", "duration": 24.0, "settling": 12.0, "seeds": SEEDS})


@pytest.fixture(scope="module")
def estimator() -> SlipEstimatorParameters:
    return load_slip_parameters()


@pytest.fixture(scope="module")
def bench(p: StudyParameters, estimator: SlipEstimatorParameters) -> Bench:
    return make_bench(p, estimator)


def cell(truth: str = MATCHED, filter_: str = "ekf", sigma_xy: float = 0.02, soil: str = "sand") -> Cell:
    return Cell(truth, soil, filter_, sigma_xy, 0.01)


def speeds_of(drives: NDArray[np.void]) -> FloatArray:
    """(k, 2) left and right, rad/s."""
    return np.stack((drives["speeds"]["left"], drives["speeds"]["right"]), axis=1)


def steady(drives: NDArray[np.void], p: SlipEstimatorParameters) -> FloatArray:
    """(k, 2) the speeds from which slips are computed, rad/s."""
    speeds = []
    for drive in drives:
        motion, changing, *rest = drive["motion"].item()
        state = MotionState(Motion(motion), changing, *rest)
        speeds.append(smoothed_speeds(Speeds(*drive["speeds"].item()), state, p.motion)[:2])
    return np.array(speeds)


def scored(setting: Setting, trial: Trial) -> Sums:
    return score(setting, trial, least_variances(setting, trial))


# Inputs of the filters


def test_filters_get_rounded_sprockets_and_the_truth_exact_ones(bench: Bench) -> None:
    p, estimator, drive = bench
    samples, step = drive.samples, estimator.encoder_resolution / PERIOD
    truth, true = drive.truth, speeds_of(drive.true_drives)
    assert len(samples) == round(p.duration * p.sprocket_rate)
    np.testing.assert_allclose(truth.t[samples], PERIOD * np.arange(1, len(samples) + 1), atol=1e-9)
    np.testing.assert_allclose(np.cumsum(true[samples, 0]) * PERIOD, truth.left_angle[samples], atol=1e-9)
    np.testing.assert_allclose(np.cumsum(true[samples, 1]) * PERIOD, truth.right_angle[samples], atol=1e-9)
    rounding = speeds_of(drive.rows.drives[samples]) - true[samples]
    assert step / 3.0 < np.abs(rounding).max() < step  # rad/s per count
    straight = truth.t[samples] % 6.0 > 5.0  # the slalom turns every six seconds
    smooth = steady(drive.rows.drives[samples], estimator) - true[samples]
    assert np.std(smooth[straight]) < np.std(rounding[straight]) / 3.0


def test_noise_is_as_large_as_the_filters_assume(bench: Bench) -> None:
    p, _, drive = bench
    setting, fixes, rates = bench.setting(cell(SHEAR)), drive.is_fix, drive.is_rate
    trials = [make_trial(setting, seed) for seed in range(10)]
    of_fixes = np.concatenate(
        [t.rows.measurements["value"][fixes] - t.states[fixes, OF_POSE] for t in trials]
    )
    np.testing.assert_allclose(of_fixes.std(axis=0), (0.02, 0.02, p.sigma_heading), rtol=0.05)
    of_rates = [
        t.rows.measurements["value"][rates, 0] - drive.truth.yaw_rate[rates] - t.states[0, GYRO_BIAS]
        for t in trials
    ]
    assert np.std(of_rates) == pytest.approx(0.01, rel=0.05)
    biases = {float(t.states[0, GYRO_BIAS]) for t in trials}
    assert len(biases) == 10


@pytest.mark.parametrize("truth", [SHEAR, pytest.param(MATCHED, marks=pytest.mark.slow)])
def test_filters_are_compared_on_the_same_draws(truth: str, bench: Bench) -> None:
    ekf, daf, again = (bench.trial(cell(truth, name), seed=1) for name in ("ekf", "daf", "ekf"))
    other = bench.trial(cell(truth, soil="dry_clay"), seed=1)
    for of_ekf, of_daf, repeated in zip(ekf.rows, daf.rows, again.rows, strict=True):
        assert_same_bits(of_ekf, of_daf)
        assert_same_bits(of_ekf, repeated)
    assert not np.array_equal(ekf.rows.measurements["value"], other.rows.measurements["value"])


def test_states_on_the_shear_truth_move_as_the_machine_does(bench: Bench) -> None:
    setting = bench.setting(cell(SHEAR))
    states, at = make_trial(setting, seed=0).states, bench.drive.truth
    for k in range(100, len(states), 97):
        v_x, _, rate = twist(states[k], at.left_speed[k], at.right_speed[k], setting.linear[0])
        assert (v_x, rate) == pytest.approx((at.v_x[k], at.yaw_rate[k]), abs=1e-6)
        np.testing.assert_array_equal(states[k, OF_POSE], (at.x[k], at.y[k], at.yaw[k]))


def test_drive_without_motion_is_refused(estimator: SlipEstimatorParameters) -> None:
    p = load_study_parameters({"scenario": "start_stop", "duration": 2.0, "settling": 1.0})
    with pytest.raises(InputError, match="nothing moves in 'start_stop' on sand"):
        make_drive(p, estimator, "sand")


# The bound


def test_the_bound_is_the_textbook_recursion(estimator: SlipEstimatorParameters) -> None:
    """The bound in a steady turn equals the textbook recursion."""
    config, rows = make_config(estimator), Rows(np.zeros(30, MEASUREMENT), np.zeros(30, STATE))
    config["stamp_errors"] = 0.0
    rows.measurements["stamp_ns"] = round(PERIOD * 1e9) * np.arange(1, 31)
    rows.measurements["kind"][9::10] = POSE
    rows.measurements["noise"] = fix = np.diag((4e-4, 4e-4, 1e-4))
    rows.drives["speeds"] = Speeds(1.6, 1.2, 4e-4, 2e-8)
    rows.drives["motion"]["motion"] = Motion.TURNING
    x, P = config["prior_mean"][0].copy(), config["prior_covariance"][0].copy()
    x[OF_POSE], P[OF_POSE, OF_POSE] = (1.0, 2.0, 0.5), fix
    spare = np.flatnonzero(np.diag(P) == 0.0)  # of absent sources
    P[spare, spare] = 1e-4
    offset = int(config["yaw_offsets"][0, 0])

    def measure(x: FloatArray) -> FloatArray:
        return x[OF_POSE] + np.array((0.0, 0.0, x[offset]))

    states, expected = expected_bound(rows, x, P, config, {POSE: measure})
    assert_same_bound(cramer_rao_bound(rows, states, x, P, config)[-1], expected, 1e-5)


@pytest.mark.slow
def test_kalman_filter_attains_the_bound_of_a_linear_problem(bench: Bench) -> None:
    """With a precise heading the matched truth is linear and Gaussian: RMSE, bound and P agree."""
    setting = bench._replace(p=replace(bench.p, sigma_heading=1e-6)).setting(cell(MATCHED))
    sums = sum_runs(scored(setting, make_trial(setting, seed)) for seed in range(30))
    for columns in (slice(0, 2), slice(3, 5)):
        attained = np.sqrt(sums.squares[:, columns].mean() / sums.bounds[:, columns].mean())
        assert attained == pytest.approx(1.0, abs=0.12)


# Scores of filters


def test_bounds_of_a_mean_are_those_of_chi_squared() -> None:
    assert mean_bounds(3, 1) == pytest.approx((0.2158, 9.3484), abs=1e-4)  # from printed tables
    low, high = mean_bounds(2, 100)
    draws = chi2.rvs(2, size=(20_000, 100), random_state=0).mean(axis=1)
    assert np.mean((low <= draws) & (draws <= high)) == pytest.approx(0.95, abs=0.01)


def assert_consistent(row: Row) -> None:
    for name in ("nees_pose", "nees_slip", "nis_pose", "nis_yaw_rate"):
        low, high = getattr(row, f"{name}_bounds")
        assert low < getattr(row, name) < high


@pytest.mark.parametrize("filter_", ["ekf", "daf"])
def test_on_its_own_model_a_filter_is_consistent_and_near_the_bound(filter_: str, bench: Bench) -> None:
    row = bench.row(cell(MATCHED, filter_))
    assert_consistent(row)
    for name in ("position", "heading", "slip"):
        assert getattr(row, f"{name}_rmse") == pytest.approx(getattr(row, f"{name}_bound"), rel=0.25)


@pytest.mark.parametrize("filter_", [pytest.param("ekf", marks=pytest.mark.slow), "daf"])
def test_a_model_with_a_smaller_state_is_consistent_too(filter_: str, p: StudyParameters) -> None:
    """Entries of a record beyond the model's state have no variance and stay zero."""
    bench = make_bench(p, load_slip_parameters({"model": "free_slips"}))
    assert_consistent(bench.row(cell(MATCHED, filter_)))
    assert not bench.trial(cell(MATCHED, filter_)).states[:, free_slips.ACTIVE :].any()


@pytest.mark.parametrize(("factor", "outside"), [(1e-3, "above"), (10.0, "below")])
def test_wrong_measurement_noise_shows_in_the_nees(factor: float, outside: str, bench: Bench) -> None:
    """The filter's R is too large, or too small by more than the filter can adapt."""
    setting = bench.setting(cell(MATCHED))

    def misinformed(seed: int) -> Sums:
        trial = make_trial(setting, seed)
        measurements = trial.rows.measurements.copy()
        measurements["noise"] *= factor
        return scored(setting, trial._replace(rows=trial.rows._replace(measurements=measurements)))

    low, high = mean_bounds(3, SEEDS)
    nees = float(np.mean(sum_runs(map(misinformed, range(SEEDS))).nees[:, 0])) / SEEDS
    assert nees > high if outside == "above" else nees < low


def test_slips_are_scored_in_turns_apart(bench: Bench) -> None:
    """Each segment of the slalom after settling is a turn, with a moment of straight driving in between."""
    p, _, drive = bench
    assert len(drive.scored) == round((p.duration - p.settling) * p.sprocket_rate)
    assert drive.moving.all()
    assert 0.8 < drive.turning.mean() < 1.0


def test_a_trace_shows_the_run_that_is_scored(bench: Bench) -> None:
    setting = bench.setting(cell(SHEAR))
    run, sums = trace(setting, seed=2), scored(setting, make_trial(setting, seed=2))
    later = run.t > bench.p.settling
    for estimated, true, columns in (
        (run.estimated_slips, run.slips, slice(3, 6)),
        (run.estimated_poses, run.poses, OF_POSE),
    ):
        np.testing.assert_allclose(np.square(estimated - true)[later], sums.squares[:, columns], atol=1e-9)
    assert (run.slip_deviations[later, :2] > 0.0).all()


# On a terrain


def assert_near_bound_on_slope(row: Row) -> None:
    assert row.position_rmse < 1.25 * row.position_bound
    assert row.turning_slip_rmse < 1.5 * row.turning_slip_bound
    assert 1.5 < row.nees_pose < 4.5


def test_filter_on_a_slope_is_near_its_bound_unless_it_ignores_the_slope(
    estimator: SlipEstimatorParameters,
) -> None:
    values = {"scenario": "slalom", "duration": 24.0, "settling": 12.0, "seeds": 3}
    p = load_study_parameters({**values, "terrains": ["slope_down_15"]})
    on_slope = replace(cell(SHEAR, sigma_xy=0.01), terrain="slope_down_15")
    bench = make_bench(p, estimator, terrain="slope_down_15")
    level = bench.drive.rows.drives["attitude"]["level"]
    np.testing.assert_allclose(level["downhill_x"], np.sin(bench.drive.truth.pitch), atol=1e-12)
    row = bench.row(on_slope)
    assert row.terrain == "slope_down_15"
    assert_near_bound_on_slope(row)
    assert row.ignoring_nees_pose is not None
    assert row.ignoring_nees_pose > 2.0 * row.nees_pose


def test_accelerations_are_measured_on_terrain_only(bench: Bench) -> None:
    plain, sloping = (
        bench.trial(replace(cell(SHEAR), terrain=terrain)).rows.measurements["acceleration"]
        for terrain in ("", "side_slope_15")
    )
    assert np.isnan(plain[bench.drive.is_rate]).all()
    measured = sloping[bench.drive.is_rate]
    assert np.mean(measured[:, 2]) == pytest.approx(9.81, abs=0.05)  # on level ground


def test_bound_of_drawn_machines_uses_their_distribution(bench: Bench) -> None:
    """Delays, gyro scale and asymmetry are drawn with the variances of the bound."""
    setting = bench.setting(cell(DRAWN))
    trials = [make_trial(setting, seed) for seed in range(60)]
    drawn = [FIX_DELAY, GYRO_SCALE, ASYMMETRY]
    variances = np.mean([trial.start_state[drawn] ** 2 for trial in trials], axis=0)
    assert variances / np.diag(trials[0].truth_covariance)[drawn] == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("soil", ["sand", "sandy_loam", "clayey_soil", "dry_clay"])
@pytest.mark.parametrize("terrain", ["slope_15", "slope_down_15", "side_slope_15", "hill"])
def test_slopes_of_15_degrees_cost_no_accuracy_against_their_bound(
    terrain: str, soil: str, estimator: SlipEstimatorParameters
) -> None:
    if soil == "clayey_soil" and terrain in ("slope_15", "hill"):
        pytest.skip("the machine does not climb it: docs/slopes.md")
    p = load_study_parameters({"seeds": 5, "terrains": [terrain]})
    bench = make_bench(p, estimator, soil, terrain)
    for sigma_xy in (0.01, 0.05):
        assert_near_bound_on_slope(bench.row(replace(cell(SHEAR, "ekf", sigma_xy, soil), terrain=terrain)))
