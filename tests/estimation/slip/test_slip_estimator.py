# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The slip estimator on a small exact truth: it converges and is consistent."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fixtures.changes import changed
from scipy.stats import chi2

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Outcome, PoseFix, Sprockets, YawRate
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.slip.parameters import SlipEstimatorParameters

S = 1_000_000_000
Run = Callable[..., Any]
ParametersFactory = Callable[..., SlipEstimatorParameters]


@pytest.mark.parametrize(
    ("segment", "motion"),
    [
        ((20.0, 2.0, 2.0, 0.10, 0.10, 0.0), Motion.STRAIGHT),
        ((20.0, 2.0, 2.0, 0.12, 0.07, 0.0), Motion.STRAIGHT),
        ((20.0, 1.2, 2.0, -0.05, 0.20, 0.0), Motion.TURNING),
        ((20.0, 2.0, 1.2, 0.20, -0.05, 0.0), Motion.TURNING),
        ((20.0, -2.0, -1.2, 0.15, 0.05, 0.0), Motion.TURNING),
    ],
)
def test_known_slips_are_found(
    drive: Callable[..., Any], segment: tuple[float, ...], motion: Motion, thesis_run: Run
) -> None:
    last = thesis_run(drive([segment]).measurements).estimates[-1]
    np.testing.assert_allclose(last.outputs.slips[:2], segment[3:5], atol=0.03)
    assert (np.sqrt(np.diag(last.outputs.slip_covariance))[:2] < 0.035).all()
    assert last.motion is motion


def test_slip_angle_is_found_with_a_heading_source(drive: Callable[..., Any], thesis_run: Run) -> None:
    found = drive([(30.0, 1.0, 2.0, 0.0, 0.2, 0.15)]).measurements
    last = thesis_run(found, noise__initial_slip_angle=0.2, noise__slip_angle_turning=0.005).estimates[-1]
    assert last.outputs.slips[2] == pytest.approx(0.15, abs=0.03)


def test_pose_and_twist_follow_the_truth(drive: Callable[..., Any], thesis_run: Run) -> None:
    driven = drive([(5.0, 2.0, 2.0, 0.1, 0.1, 0.0), (10.0, 1.0, 2.0, 0.0, 0.2, 0.0)])
    for e in thesis_run(driven.measurements).estimates[250:]:
        truth = driven.truth[e.stamp_ns]
        assert np.hypot(*(e.pose - truth[:3])[:2]) < 0.08
        assert np.cos(e.pose[2] - truth[2]) > np.cos(0.06)
    assert e.outputs.twist[0] == pytest.approx(0.159 * (1.0 + 1.6) / 2.0, abs=0.01)
    assert e.outputs.twist[2] == pytest.approx(0.159 * (1.6 - 1.0) / 0.73, abs=0.01)


def test_pose_covariance_is_consistent(drive: Callable[..., Any], thesis_run: Run) -> None:
    """The slips walk as the filter assumes.

    20 seeds at three times 5 s apart: 60 × χ²(3), nearly independent; the mean is within the 10⁻⁴ tails
    of 20 × χ²(3) on either side, 1.63 to 4.95.
    """
    walk = {"noise__slip_steady": 0.02, "noise__slip_moving": 0.02}
    values = []
    for seed in range(20):
        segments = [(5.0, 2.0, 2.0, 0.0, 0.0, 0.0), (10.0, 1.2, 2.0, 0.0, 0.0, 0.0)]
        driven = drive(
            segments,
            seed=seed,
            step_ms=50,
            gyro_every=2,
            fix_every=10,
            slip_walk=0.02,
            encoder=0.002,
            gyro_bias=0.002,
        )
        steps = thesis_run(driven.measurements, noise__initial_slip=0.02, **walk)
        by_stamp = {e.stamp_ns: e for e in steps.estimates}
        for t in (5, 10, 15):
            e, truth = by_stamp[t * S], driven.truth[t * S]
            error = e.pose - truth[:3]
            error[2] = np.angle(np.exp(1j * error[2]))
            values.append(error @ np.linalg.solve(e.pose_covariance, error))
    low, high = chi2.ppf((1e-4, 1.0 - 1e-4), 3 * 20) / 20
    assert low < np.mean(values) < high
    assert np.mean(np.array(values) < chi2.ppf(0.95, 3)) > 0.85


def turning_slips(left: float, right: float, kappa: float, eta: float, common: float) -> tuple[float, float]:
    """(i_L, i_R) of sub-model 1b: v = (1 − i₀) V − η|D|/2, φ̇ = κ D/B."""
    V, D = (left + right) / 2.0, right - left  # rad/s: V and D divided by r
    v, turn = (1.0 - common) * V - eta * abs(D) / 2.0, kappa * D / 2.0
    return 1.0 - (v - turn) / left, 1.0 - (v + turn) / right


def turning_drive(drive: Callable[..., Any], **options: Any) -> Any:
    """Straights and turns to both sides, on one soil: κ 0.45, η 0.4, i₀ 0.01."""
    legs = (
        (5.0, 2.0, 2.0),
        (6.0, 1.0, 2.0),
        (5.0, 2.0, 2.0),
        (6.0, 2.0, 0.8),
        (5.0, 2.2, 2.2),
        (6.0, 1.2, 2.2),
    )
    return drive([(t, a, b, *turning_slips(a, b, 0.45, 0.4, 0.01), 0.0) for t, a, b in legs], **options)


def test_slips_of_one_turn_are_used_in_the_next(drive: Callable[..., Any], thesis_run: Run) -> None:
    """Sub-model 1b: fixes and gyro end before the last turn, and the slips in it are correct."""
    driven = turning_drive(drive)
    found = [m for m in driven.measurements if isinstance(m, Sprockets) or m.stamp_ns < 26 * S]
    by_stamp = {e.stamp_ns: e for e in thesis_run(found, model="turning").estimates}
    for t in (29 * S, 33 * S):
        np.testing.assert_allclose(by_stamp[t].outputs.slips[:2], driven.truth[t][3:5], atol=0.05)
    assert np.hypot(*(by_stamp[33 * S].pose - driven.truth[33 * S][:3])[:2]) < 0.15


def test_sub_model_1b_is_consistent_without_velocity_errors(
    drive: Callable[..., Any], thesis_run: Run
) -> None:
    """The truth has no velocity errors, which the filter models: the mean NEES is between 0.5 and 4.5."""
    values = []
    for seed in range(10):
        driven = turning_drive(drive, seed=seed, step_ms=50, gyro_every=2, fix_every=10, encoder=0.001)
        by_stamp = {e.stamp_ns: e for e in thesis_run(driven.measurements, model="turning").estimates}
        for t in (8 * S, 14 * S, 20 * S, 26 * S, 32 * S):
            e, truth = by_stamp[t], driven.truth[t]
            error = e.pose - truth[:3]
            error[2] = np.angle(np.exp(1j * error[2]))
            values.append(error @ np.linalg.solve(e.pose_covariance, error))
    assert 0.5 < np.mean(values) < 4.5
    assert max(values) < chi2.ppf(1.0 - 1e-4, 3)


def test_estimator_starts_at_the_first_fix(
    drive: Callable[..., Any], thesis_parameters: ParametersFactory
) -> None:
    driven = drive([(4.0, 2.0, 2.0, 0.1, 0.1, 0.0)])
    late = [m for m in driven.measurements if not isinstance(m, PoseFix) or m.stamp_ns >= 2 * S]
    estimator = SlipEstimator(thesis_parameters(start="first_fix"))
    with pytest.raises(RuntimeError):
        estimator.estimate()
    steps = []
    for m in late:
        started = estimator.started
        steps.append(estimator.process(m))
        assert started == (steps[-1][0].outcome is not Outcome.WAITING) or isinstance(m, PoseFix)
    waiting = [r for r, _ in steps if r.outcome is Outcome.WAITING]
    assert {r.source for r in waiting} == {"sprockets", "imu/data_raw"}
    assert max(r.stamp_ns for r in waiting) <= 2 * S
    first = next(e for _, e in steps if e is not None)
    assert first.stamp_ns > 2 * S
    start = next(m for m in late if isinstance(m, PoseFix))
    np.testing.assert_allclose(first.pose, start.pose, atol=0.02)


def test_configured_start_is_the_first_estimate(thesis_parameters: ParametersFactory) -> None:
    estimator = SlipEstimator(
        thesis_parameters(initial_x=1.0, initial_y=-2.0, initial_yaw=0.5, initial_yaw_stddev=0.1)
    )
    assert estimator.process(YawRate("imu/data_raw", 5, 0.0, 1e-4))[0].outcome is Outcome.WAITING
    assert estimator.process(PoseFix("box_pose", 6, np.zeros(3), np.eye(3)))[0].outcome is Outcome.WAITING
    report, estimate = estimator.process(Sprockets("sprockets", 7, 0.0, 0.0, (0.0, 0.0)))
    assert report.outcome is Outcome.ACCEPTED
    assert estimate is not None
    np.testing.assert_array_equal(estimate.pose, (1.0, -2.0, 0.5))
    np.testing.assert_allclose(np.diag(estimate.pose_covariance), (0.0009, 0.0009, 0.01))


def test_positions_override_speeds(drive: Callable[..., Any], thesis_run: Run) -> None:
    found = drive([(3.0, 2.0, 2.0, 0.0, 0.0, 0.0)], fix_every=10**9).measurements
    lying = [replace(m, left_speed=7.0, right_speed=-3.0) if isinstance(m, Sprockets) else m for m in found]
    last = thesis_run([m for m in lying if not isinstance(m, PoseFix)]).estimates[-1]
    np.testing.assert_allclose(last.pose, (0.159 * 2.0 * 3.0, 0.0, 0.0), atol=0.01)
    assert last.outputs.twist[0] == pytest.approx(0.318, abs=1e-3)


def test_slips_keep_their_prior_at_standstill_from_the_start(
    drive: Callable[..., Any], thesis_run: Run
) -> None:
    last = thesis_run(drive([(5.0, 0.0, 0.0, 0.0, 0.0, 0.0)]).measurements).estimates[-1]
    np.testing.assert_allclose(last.outputs.slips, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(last.outputs.slip_covariance)), (0.1, 0.1, 0.01), rtol=1e-6)


@pytest.mark.parametrize("model", ["turning", "free_slips"])
def test_covariances_stay_symmetric_and_positive(
    drive: Callable[..., Any], model: str, thesis_run: Run
) -> None:
    segments = [
        (3.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (5.0, 2.0, 2.0, 0.1, 0.1, 0.0),
        (5.0, -1.0, 1.0, 0.3, 0.3, 0.1),
    ]
    for e in thesis_run(drive(segments, seed=3).measurements, model=model).estimates:
        for P in (e.pose_covariance, e.outputs.slip_covariance, e.outputs.twist_covariance):
            np.testing.assert_allclose(P, P.T, atol=1e-12)
            assert np.linalg.eigvalsh(P)[0] > -1e-12
        assert np.linalg.eigvalsh(e.pose_covariance)[0] > 0.0


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5])
def test_fixes_at_standstill_leave_the_variance_of_their_common_part(
    drive: Callable[..., Any], thesis_run: Run, share: float
) -> None:
    found = drive([(10.0, 0.0, 0.0, 0.0, 0.0, 0.0)]).measurements
    changes = {"initial_position_stddev": 1.0, "sources__box_pose__standing_share": share}
    last = thesis_run(found, **changes).estimates[-1]
    expected = 0.03 * np.sqrt(share + (1.0 - share) / 51)
    assert np.sqrt(last.pose_covariance[0, 0]) == pytest.approx(expected, rel=0.05)
    assert np.hypot(*last.pose[:2]) < 0.03
    assert np.sqrt(last.pose_covariance[2, 2]) < 0.02  # heading errors are not correlated


@pytest.mark.parametrize(("model", "filter_"), [("turning", "ekf"), ("free_slips", "daf")])
def test_fixes_beyond_half_a_turn_are_no_outliers(
    drive: Callable[..., Any], thesis_run: Run, model: str, filter_: str
) -> None:
    """Four turns on the spot; headings of fixes are within ±π."""
    driven = drive([(42.0, -2.0, 2.0, 0.3, 0.3, 0.0)])
    wrapped = changed(
        driven.measurements,
        PoseFix,
        lambda m: replace(m, pose=np.array((*m.pose[:2], np.angle(np.exp(1j * m.pose[2]))))),
    )
    found = thesis_run(wrapped, model=model, filter=filter_)
    assert driven.truth[max(driven.truth)][2] > 8.0 * np.pi * 0.9
    assert sum(r.outcome is Outcome.GATED for r in found.reports if r.source == "box_pose") <= 1
    for e in found.estimates[100:]:
        assert -np.pi < e.pose[2] <= np.pi
        assert np.cos(e.pose[2] - driven.truth[e.stamp_ns][2]) > np.cos(0.1)


def test_covariance_grows_in_an_outage_and_shrinks_at_the_next_fix(
    drive: Callable[..., Any], thesis_run: Run
) -> None:
    driven = drive([(30.0, 2.0, 1.8, 0.1, 0.1, 0.0)])
    kept = [m for m in driven.measurements if not (isinstance(m, PoseFix) and 10 * S < m.stamp_ns < 20 * S)]
    spread = {
        e.stamp_ns: float(np.sqrt(np.trace(e.pose_covariance[:2, :2]))) for e in thesis_run(kept).estimates
    }
    assert spread[19 * S] > 3.0 * spread[10 * S]
    assert spread[30 * S] < 1.3 * spread[10 * S]
