# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""K and F_max from slip and thrust: exact data, consistent intervals, changes of soil, outliers."""

from dataclasses import replace

import numpy as np
import pytest
from fixtures.soil_samples import Sample, Strength

from trackslip_common.arrays import FloatArray
from trackslip_common.errors import InputError
from trackslip_estimation.slip.motion import Motion
from trackslip_estimation.soil.shear_field import (
    Contact,
    Rolling,
    RollingError,
    fill_mobilised_shares,
    mobilised_share,
    propagate_displacement,
)
from trackslip_estimation.soil.soil_parameters import load_soil_parameters
from trackslip_estimation.soil.strength_posterior import StrengthPosterior
from trackslip_estimation.soil.turn_likelihood import Turn, squared_distances, thrust_curves
from trackslip_estimation.terramechanics.elements import element_positions
from trackslip_estimation.terramechanics.traction import thrust

P = load_soil_parameters()
VEHICLE, STRENGTH = P.vehicle.whole(), P.strength
LENGTH, HALF_TREAD = VEHICLE.contact_length, 0.5 * VEHICLE.tread
SPEED = 0.35  # m/s of the tracks
MODULUS, LIMIT = 0.01, 3640.0
STEP = STRENGTH.interval
NONE = np.zeros(2)
NO_ERROR = RollingError(NONE, NONE, 0.0)


def straight(slip: float, force: float, *, stddev: float = 1e-4, dt: float = STEP) -> Sample:
    """Both tracks with the same slip, in the state TURNING, which uses slips; ``stddev`` of the slip."""
    twist = np.array((SPEED * (1.0 - slip), 0.0, 0.0))
    covariance = np.diag(np.square((stddev * SPEED, 1e-4, 1e-4)))
    tracks, thrusts, variances = np.full(2, SPEED), np.full(2, force), np.full(2, 25.0)
    return Sample(dt, tracks, twist, covariance, thrusts, variances, Motion.TURNING)


def force_of(slip: float, modulus: float = MODULUS, limit: float = LIMIT) -> float:
    return float(thrust(slip, limit, modulus, LENGTH))


def settle(strength: Strength, sample: Sample) -> None:
    """Drive more than a contact length without thrusts, until the soil under it is in its steady state."""
    for _ in range(5):
        strength.update(replace(sample, dt=1.0, thrusts=None))


def drive(strength: Strength, slips: FloatArray, seconds: float, **soil: float) -> StrengthPosterior:
    """Drive straight for ``seconds`` at each slip; the posterior."""
    for slip in slips:
        settle(strength, straight(slip, 0.0))
        for _ in range(round(seconds / STEP)):
            strength.update(straight(slip, force_of(slip, **soil)))
    return strength.posterior


def new_strength(**changes: float) -> Strength:
    """A strength on a smaller grid, which is faster."""
    small = replace(STRENGTH, lowest_modulus=0.002, highest_modulus=0.06, modulus_cells=48, limit_cells=64)
    return Strength(replace(small, **changes), VEHICLE)


@pytest.mark.parametrize("slip", [0.002, 0.0072, 0.05, 0.3, -0.01])
@pytest.mark.parametrize("speed", [SPEED, -SPEED])
def test_steady_straight_motion_equals_equation_3_3(slip: float, speed: float) -> None:
    x_e = element_positions(LENGTH, 64)
    rolling = Rolling(np.array((speed * (1.0 - slip), 0.0, 0.0)), np.full(2, speed))
    contact = Contact(x_e, HALF_TREAD)
    j = np.zeros((2, 64, 2))
    for _ in range(40):
        j = propagate_displacement(j, rolling, contact, STEP)
    q = np.empty((2, 1))
    fill_mobilised_shares(j, rolling, NO_ERROR, contact, np.array((MODULUS,)), q)
    assert q[:, 0] == pytest.approx(np.sign(speed) * force_of(slip, limit=1.0), rel=2e-3)


def test_twist_error_acts_as_a_constant_one() -> None:
    contact, tracks = Contact(element_positions(LENGTH, 16), HALF_TREAD), np.array((0.2, 0.35))
    twist, error = np.array((0.25, 0.01, 0.1)), np.array((0.01, -0.004, 0.02))
    q, other = np.empty((2, 3)), np.empty((2, 3))
    moduli = np.array((0.005, 0.02, 0.08))
    rolling, other_rolling = Rolling(twist, tracks), Rolling(twist + error, tracks)
    settled = propagate_displacement(np.zeros((2, 16, 2)), rolling, contact, 60.0)
    along = error[0] + HALF_TREAD * error[2] * np.array((-1.0, 1.0))
    fill_mobilised_shares(settled, rolling, RollingError(along, error[1:], 0.0), contact, moduli, q)
    moved = propagate_displacement(np.zeros((2, 16, 2)), other_rolling, contact, 60.0)
    fill_mobilised_shares(moved, other_rolling, NO_ERROR, contact, moduli, other)
    np.testing.assert_allclose(q, other, atol=1e-12)


def test_uncertain_load_distribution_covers_the_thrust_it_causes() -> None:
    """With the load's uncertainty the residual is one standard deviation, without it above five."""
    contact, moduli = Contact(element_positions(LENGTH, 16), HALF_TREAD), np.array((MODULUS,))
    rolling, lean = Rolling(np.array((0.25, -0.01, 0.12)), np.array((0.2, 0.35))), 0.3
    j, q = propagate_displacement(np.zeros((2, 16, 2)), rolling, contact, 60.0), np.empty((2, 1))
    fill_mobilised_shares(j, rolling, RollingError(NONE, NONE, lean), contact, moduli, q)
    squares = []
    for stddev in (0.0, lean):
        turn = Turn(j, rolling, 1e-6 * np.eye(3), LIMIT * q[:, 0], np.ones(2), 0.0, stddev)
        curves = thrust_curves(turn, contact, moduli)
        squares.append(float(squared_distances(curves, turn, np.array((LIMIT,)))[0, 0]))
    assert squares[0] > 25.0
    assert squares[1] == pytest.approx(1.0, rel=0.15)


def test_many_short_steps_equal_one_long_step() -> None:
    contact = Contact(element_positions(LENGTH, 16), HALF_TREAD)
    rolling = Rolling(np.array((0.28, 0.02, -0.1)), np.array((0.35, 0.2)))
    once = propagate_displacement(np.zeros((2, 16, 2)), rolling, contact, 20.0)
    often = np.zeros((2, 16, 2))
    for _ in range(100):
        often = propagate_displacement(often, rolling, contact, STEP)
    np.testing.assert_allclose(often[:, :, 0], once[:, :, 0], atol=1e-9)  # linear growth
    np.testing.assert_allclose(often[:, :, 1], once[:, :, 1], atol=0.015)  # curved between the centres


def test_exact_data_recover_both_parameters() -> None:
    certain = replace(STRENGTH, slip_bias_stddev=0.0, thrust_share_stddev=0.002, thrust_scale_stddev=0.0)
    summary = drive(Strength(certain, VEHICLE), np.array((0.003, 0.0072, 0.03, 0.2)), 15.0).summary()
    assert summary.shear_modulus == pytest.approx(MODULUS, rel=0.05)
    assert summary.thrust_limit == pytest.approx(LIMIT, rel=0.01)
    assert summary.identifiable
    assert summary.reason == ""


def test_only_the_ratio_is_observable_from_small_slips() -> None:
    posterior = drive(new_strength(), np.array((0.004, 0.006)), 20.0, modulus=0.03)
    summary = posterior.summary()
    assert not summary.identifiable
    assert summary.reason.startswith("F_max")
    grid = posterior.grid
    ratio = grid.log_moduli[:, None] - grid.log_limits[None, :]
    cells = grid.add_errors(posterior.cells)
    mean = np.sum(cells * ratio)
    assert np.sqrt(np.sum(cells * (ratio - mean) ** 2)) < 0.4
    assert summary.thrust_limit_interval[1] > 2.0 * summary.thrust_limit_interval[0]


@pytest.mark.parametrize("ratio", [0.0, 1e-12, 1e-3, 0.7, 5.0, 39.0, 1e3])
def test_the_mobilised_share_is_exact_to_rounding(ratio: float) -> None:
    assert mobilised_share(ratio) == pytest.approx(-np.expm1(-ratio), rel=1e-14)


def test_shear_modulus_is_unidentifiable_from_slips_below_their_error() -> None:
    strength = new_strength()
    for _ in range(100):
        strength.update(straight(0.25, force_of(0.25, 0.006, 4233.0)))
    for _ in range(200):
        strength.update(straight(0.0016, force_of(0.0016, 0.006, 4233.0), stddev=0.005))
    summary = strength.posterior.summary()
    assert not summary.identifiable
    assert summary.reason.startswith("K")
    low, high = summary.shear_modulus_interval
    assert low < 0.006 < high
    assert summary.thrust_limit == pytest.approx(4233.0, rel=0.05)


@pytest.mark.slow
def test_intervals_have_their_stated_coverage() -> None:
    """80 runs with time-correlated errors of slip and thrust: nine of ten intervals contain the truth."""
    random = np.random.default_rng(5)
    runs, stddev, scatter, covered = 80, 0.003, 0.01, np.zeros(2)
    correlated = dict.fromkeys(("slip_bias_stddev", "thrust_scale_stddev", "thrust_share_stddev"), 0.0)
    small = {"lowest_limit": 0.2, "highest_limit": 0.4, "limit_cells": 40, "elements": 24}
    for _ in range(runs):
        strength = new_strength(**correlated, **small, change_distance=1e6, thrust_stddev=scatter * LIMIT)
        for slip in np.tile((0.0072, 0.03, 0.15), 4):
            error, off = random.standard_normal(2) * (stddev, scatter * LIMIT)
            sample = straight(slip + error, force_of(slip) + off, stddev=stddev, dt=1.0)
            settle(strength, sample)
            for _ in range(round(STRENGTH.correlation_time)):
                strength.update(sample)
        summary = strength.posterior.summary()
        intervals = (summary.shear_modulus_interval, summary.thrust_limit_interval)
        for k, (truth, (low, high)) in enumerate(zip((MODULUS, LIMIT), intervals, strict=True)):
            covered[k] += low <= truth <= high
    assert np.all(covered >= 0.8 * runs)
    assert np.all(covered <= 0.99 * runs)


def test_new_soil_is_found_within_seconds() -> None:
    strength = new_strength()
    drive(strength, np.array((0.0072, 0.2, 0.01, 0.3)), 15.0)
    assert strength.posterior.summary().thrust_limit == pytest.approx(LIMIT, rel=0.05)
    before = strength.posterior.effective_samples
    drive(strength, np.array((0.2,)), 10.0, modulus=0.006, limit=2650.0)
    summary = strength.posterior.summary()
    assert summary.thrust_limit == pytest.approx(2650.0, rel=0.05)
    assert summary.effective_samples < 0.5 * before


def test_one_wrong_sample_has_no_effect() -> None:
    strength = new_strength()
    drive(strength, np.array((0.0072, 0.2)), 20.0)
    before = strength.posterior.summary()
    strength.update(straight(0.2, -9000.0))
    after = strength.posterior.summary()
    assert after.thrust_limit == pytest.approx(before.thrust_limit, rel=0.01)
    assert after.shear_modulus == pytest.approx(before.shear_modulus, rel=0.02)


def test_repeated_samples_of_one_moment_add_no_information() -> None:
    """100 Hz as 5 Hz: the duration of the motion determines the information, not the rate."""
    often, seldom = new_strength(), new_strength()
    sample = straight(0.1, force_of(0.1))
    for _ in range(400):
        often.update(replace(sample, dt=0.01))
    for _ in range(20):
        seldom.update(replace(sample, dt=0.2))
    assert often.posterior.effective_samples == pytest.approx(seldom.posterior.effective_samples)
    np.testing.assert_allclose(often.posterior.cells, seldom.posterior.cells, atol=1e-9)


def test_constant_slip_error_bounds_the_interval_of_k() -> None:
    """With an uncertain rolling radius the interval of K stops shrinking."""
    widths = []
    for correlated in (0.0, 0.002):
        strength = new_strength(slip_bias_stddev=correlated, change_distance=1e6)
        for _ in range(2):
            low, high = drive(strength, np.array((0.0072, 0.2)), 30.0).summary().shear_modulus_interval
            widths.append(np.log(high / low))
    certain_before, certain_after, before, after = widths
    assert certain_after < 0.92 * certain_before
    assert after > 0.8 * before
    assert after > 1.5 * certain_after


def test_one_track_alone_gives_the_thrust_limit() -> None:
    strength = new_strength()
    for slip in (0.0072, 0.2):
        for _ in range(100):
            sample = straight(slip, force_of(slip))
            alone = replace(sample, thrusts=np.array((np.nan, sample.thrusts[1])))
            strength.update(alone)
    assert strength.posterior.summary().thrust_limit == pytest.approx(LIMIT, rel=0.05)


def test_standstill_adds_no_information() -> None:
    strength = new_strength()
    covariance, force = 1e-6 * np.eye(3), np.zeros(2)
    still = Sample(STEP, NONE, np.zeros(3), covariance, force, np.ones(2), Motion.STANDING)
    strength.update(still)
    assert strength.posterior.effective_samples == 0.0
    assert strength.posterior.summary().reason == "too little driving yet"


def test_an_empty_range_is_refused() -> None:
    with pytest.raises(InputError, match=r"highest_modulus: 0\.001 is refused; accepted: > 0\.01"):
        replace(STRENGTH, lowest_modulus=0.01, highest_modulus=0.001)
