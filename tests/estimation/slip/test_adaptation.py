# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptation of the noise of tracks, gyro and fixes to its true size; estimation of the gyro scale."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from fixtures.drawn_machine import Machine, drive, parameters
from fixtures.pose_errors import errors_over
from fixtures.records import assert_order_does_not_matter

from trackslip_estimation.slip.estimator import SlipEstimator
from trackslip_estimation.slip.measurements import Outcome, PoseFix, YawRate
from trackslip_estimation.slip.models.model import GYRO_SCALE
from trackslip_estimation.slip.models.turning import ASYMMETRY
from trackslip_estimation.slip.standstill import standstill_inflation


@cache
def run(machine: Machine) -> Any:
    """The last state, a record of ``STATE``."""
    estimator = SlipEstimator(parameters())
    estimator.process_all(drive(machine).measurements)
    return estimator.window.best[estimator.window.count - 1].copy()


def track_error(state: Any) -> float:
    return float(np.sqrt(state["adaptation"]["track_variance"]))


def test_track_error_of_ideal_tracks_is_near_zero() -> None:
    assert track_error(run(Machine())) < 0.01


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_track_error_is_estimated(share: float) -> None:
    assert 0.5 * share < track_error(run(Machine(track_error=share))) < 2.0 * share


@pytest.mark.parametrize(("share", "least", "most"), [(0.0, 0.0, 0.04), (0.05, 0.02, 0.1)])
def test_track_error_is_estimated_from_fixes_without_a_gyro(share: float, least: float, most: float) -> None:
    """Without a gyro, fixes alone correct the track error from its prior of 10 %."""
    recorded = drive(Machine(duration=100.0, track_error=share))
    without_gyro = [m for m in recorded.measurements if not isinstance(m, YawRate)]
    found, estimator = errors_over(without_gyro, recorded, parameters(yaw_rate_sources=[""]))
    assert least < track_error(estimator.window.best[estimator.window.count - 1]) < most
    assert found.between(30.0).heading_nees < 2.5


def test_the_track_error_is_unknown_and_large_at_the_start() -> None:
    assert track_error(run(Machine(duration=0.5))) > 0.05


def test_noise_factor_of_a_gyro_as_stated_is_1() -> None:
    assert run(Machine())["adaptation"]["rate_factor"] == pytest.approx(1.0, abs=0.2)


def test_noise_factor_of_a_worse_gyro_is_estimated() -> None:
    worse = run(Machine(gyro_noise=0.02))
    assert 8.0 < worse["adaptation"]["rate_factor"] <= 16.0
    assert track_error(worse) < 0.03  # the fix noise is not attributed to the tracks


@pytest.mark.parametrize(("noise", "least", "most"), [(0.02, 0.6, 1.6), (0.04, 2.0, 6.0), (0.2, 50.0, 134.5)])
def test_noise_factor_of_worse_fixes_is_estimated(noise: float, least: float, most: float) -> None:
    factors = run(Machine(fix_noise=noise))["adaptation"]["fix_factors"]
    assert least < factors[0] < most
    assert np.all(factors[1:] == 1.0)  # sources without fixes


@pytest.mark.slow
def test_estimate_is_consistent_with_fixes_ten_times_worse_than_stated() -> None:
    """The noise factor may reach 100 and more; a wrong pose must not count as fix noise."""
    nees = []
    for seed in range(3):
        recorded = drive(Machine(duration=120.0, fix_noise=0.2, fix_rate=5, track_error=0.02, seed=seed))
        found, _ = errors_over(recorded.measurements, recorded, parameters())
        nees.append(np.mean(found.between(60.0).nees(2)))
    assert 1.0 < np.mean(nees) < 4.0


def test_noise_factor_of_gaussian_fixes_is_not_below_1() -> None:
    # Student's t alone underestimates Gaussian noise: 0.83 of its variance. The pose is then overconfident.
    factors = [run(Machine(seed=seed))["adaptation"]["fix_factors"][0] for seed in range(5)]
    assert np.mean(factors) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.6])
def test_variance_of_repeated_fixes_at_standstill_is_limited_by_their_common_part(share: float) -> None:
    for count in (1, 2, 10, 500):
        reported = sum(1.0 / standstill_inflation(k, share) for k in range(1, count + 1))
        assert 1.0 / reported == pytest.approx(share + (1.0 - share) / count)


def test_turn_caused_by_a_side_slope_is_not_learned_as_asymmetry() -> None:
    """The variance of the asymmetry on a side slope stays above that on level ground."""
    level, across = (
        float(np.sqrt(run(Machine(roll=roll))["covariance"][ASYMMETRY, ASYMMETRY])) for roll in (1e-6, -0.2)
    )
    assert level < 0.002
    assert 0.003 < across < 0.02


@pytest.mark.parametrize("scale", [0.97, 1.0, 1.03])
def test_the_scale_of_the_gyro_is_found(scale: float) -> None:
    state = run(Machine(gyro_scale=scale, duration=120.0))
    deviation = np.sqrt(state["covariance"][GYRO_SCALE, GYRO_SCALE])
    assert deviation < 0.01  # prior: 0.02
    assert abs(1.0 + state["mean"][GYRO_SCALE] - scale) < 3.0 * deviation


def test_yaw_rates_alone_do_not_correct_the_scale_of_the_gyro() -> None:
    """κ and ε have the same effect as the scale: without fixes the scale stays at its prior."""
    recorded = drive(Machine(gyro_scale=0.97)).measurements
    first = next(k for k, m in enumerate(recorded) if isinstance(m, PoseFix))
    kept = [m for k, m in enumerate(recorded) if k <= first or not isinstance(m, PoseFix)]
    estimator = SlipEstimator(parameters())
    estimator.process_all(kept)
    state = estimator.window.best[estimator.window.count - 1]
    assert state["mean"][GYRO_SCALE] == 0.0
    assert np.sqrt(state["covariance"][GYRO_SCALE, GYRO_SCALE]) == pytest.approx(0.02)


def test_adapted_noise_does_not_depend_on_the_delay_of_fixes() -> None:
    assert_order_does_not_matter(
        parameters(), drive(Machine(track_error=0.1, duration=20.0)).measurements, latest=0.9
    )


def test_yaw_rate_outlier_hardly_changes_the_noise() -> None:
    calm = drive(Machine()).measurements
    k = next(k for k, m in enumerate(calm) if isinstance(m, YawRate) and m.stamp_ns > 40 * 10**9)
    wild = [*calm]
    wild[k] = YawRate(calm[k].source, calm[k].stamp_ns, 30.0, 2.5e-5)
    estimator = SlipEstimator(parameters())
    outcomes = [report.outcome for report, _ in estimator.process_all(wild)]
    state = estimator.window.best[estimator.window.count - 1]
    assert outcomes[k] is Outcome.GATED
    assert track_error(state) < 0.03  # the NIS that adapts the noise is capped
